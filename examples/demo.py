#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Record a real robot into a real Cassandra, ask it, get it back: all of it, in two minutes.

Starts a Cassandra, a roscore and the recorder, plays the bag of a Clearpath Husky, compares what
was recorded with it, asks over services, in Python and in CQL, imports and exports the bag, plays
what is stored, records that again and compares it, shows all in the viewer, and leaves nothing
running; with --view all goes on until Ctrl-C. Pictures and the exported bag go to --out.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Iterator

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import LocalCluster, NodeStatus, free_port

HERE = Path(__file__).resolve().parent
BAG = HERE / "data" / "husky_gps_data.bag"
# roscore's own rosout node writes to the plain names, so these two are played with a prefix. A
# remapping would not do: it would also rename the player's own log topic, and roscpp numbers all
# messages of a topic that it logs to anew (header.seq).
PREFIX = "/husky"
RENAMED = {topic: PREFIX + topic for topic in ("/rosout", "/rosout_agg")}
LIVE, COPY, AGAIN = "husky_live", "husky_import", "husky_again"
RUN = ["rosrun", "cassandra_ros"]
SMALL_HEAP = "400M"
"""Java heap of each of several nodes on one machine."""
PATIENCE_SEC = 600
"""Maximum time for a program to start or to end, s. A recorder stores first what still waits in its
buffer, and a loaded machine is slow."""
TELL_SEC = 10.0
"""Interval between two lines that say what is being waited for, s."""
DRIVE_SEC = 10.0
"""Time in which the bag is played at four times its speed, about, s."""


class Demo:
    """The steps, the processes that they started, and what they found out."""

    def __init__(self, out: Path, stack: ExitStack, secure: bool = False, nodes: int = 1) -> None:
        self.out = out
        self.secure = secure
        self.nodes = nodes
        self.stack = stack
        self.env = dict(os.environ, PYTHONUNBUFFERED="1")
        self.findings: list[tuple[str, str]] = []
        self.home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="husky_demo_")))

    # ------------------------------------------------------------ processes

    def say(self, text: str) -> None:
        """Head a step."""
        print(f"\n=== {text}", flush=True)

    def run(self, *command: object, shown: int | None = None) -> str:
        """Run a command as a user would; print it and what it prints; fail when it fails."""
        words = [str(word) for word in command]
        print(f"$ {_shell(words)}", flush=True)
        done = subprocess.run(
            words, env=self.env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
        )
        lines = done.stdout.rstrip().splitlines()
        cut = lines if shown is None or len(lines) <= shown else [*lines[:shown], "..."]
        print("\n".join(cut), flush=True)
        if done.returncode:
            raise SystemExit(f"demo: {words[2] if words[0] == 'rosrun' else words[0]} failed")
        return done.stdout

    def spawn(self, name: str, command: list[str], ready: str) -> Node:
        """Start a program that stays, and wait for a line that says it is ready."""
        print(f"$ {_shell(command)} &", flush=True)
        node = Node(name, command, self.env, self.home)
        self.stack.callback(node.stop)
        node.wait_for(ready)
        return node

    def note(self, what: str, figure: str) -> None:
        """Keep a figure for the closing table."""
        self.findings.append((what, figure))

    # ------------------------------------------------------------ steps

    def servers(self) -> None:
        self.say("A Cassandra and a roscore of our own")
        port = _port_or(9042)
        heap = SMALL_HEAP if self.nodes > 1 else None
        cluster = LocalCluster(
            self.home / "cassandra",
            nodes=self.nodes,
            port=port,
            heap=heap,
            secure=self.secure,
            say=print,
            progress=_Progress().tell,
        )
        self.cluster = cluster
        self.stack.callback(self.stop_cluster)
        start = time.monotonic()
        cluster.start(die_with_us=True)
        self.note("Cassandra ready after", f"{time.monotonic() - start:.1f} s")
        master = _port_or(11311)
        self.env.update(
            CASSANDRA_ROS_HOST=",".join(node.address for node in cluster.nodes),
            CASSANDRA_ROS_PORT=str(port),
            CASSANDRA_ROS_KEYSPACE=LIVE,
            CASSANDRA_ROS_CQLSHRC=str(cluster.security.cqlshrc) if self.secure else "",
            ROS_MASTER_URI=f"http://127.0.0.1:{master}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(self.home / "ros"),
            ROS_LOG_DIR=str(self.home / "ros" / "log"),
        )
        self.spawn("roscore", ["roscore", "-p", str(master)], r"started core service \[/rosout\]")

    def stop_cluster(self) -> None:
        """Stop Cassandra, also a node that hangs."""
        try:
            self.cluster.stop()
        except ServerError as exc:
            print(f"demo: {exc}", flush=True)
            for status in self.cluster.status():
                if status.pid:
                    os.kill(status.pid, signal.SIGKILL)

    def record(self) -> None:
        self.say("Record the robot's 24 topics while it drives (four times as fast)")
        topics = [RENAMED.get(topic, topic) for topic in _topics()]
        # The robot has /diagnostics of its own, which are to be compared.
        options = ["--node-id", "husky", "--no-diagnostics"]
        command = [*RUN, "recorder", *options, "--format", "ros", *topics]
        recorder = self.spawn("recorder", command, rf"recording {len(topics)} topics")
        play = ["rosbag", "play", "-q", "-r", "4", "-d", "2", "--wait-for-subscribers"]
        play += ["--queue", "100000", str(BAG)]
        logs = Node(
            "rosbag", [*play, "--prefix", PREFIX, "--topics", *RENAMED], self.env, self.home
        )
        self.stack.callback(logs.stop)
        print(f"$ {_shell(logs.command)} &", flush=True)
        with self.one_node_killed():
            self.run(*play, "--topics", *(topic for topic in _topics() if topic not in RENAMED))
        if logs.process.wait(PATIENCE_SEC):
            raise SystemExit(f"demo: rosbag failed:\n{logs.text()}")
        time.sleep(1.0)
        print("$ kill -INT recorder", flush=True)
        if recorder.stop():
            raise SystemExit(f"demo: the recorder lost messages:\n{recorder.text()}")
        print(recorder.text())
        renames = [word for a, b in RENAMED.items() for word in ("--map", f"{a}:={b}")]
        text = self.run(*RUN, "cassandra_bag", "verify", BAG, "--content", *renames)
        self.note("recorded live, equal in content", _equal(text))

    @contextmanager
    def one_node_killed(self) -> Iterator[None]:
        """Kill one of several nodes in the middle of the drive, and start it again afterwards."""
        if self.nodes < 2:
            yield
            return
        victim = self.cluster.status()[1]
        killer = threading.Timer(DRIVE_SEC / 2, self.kill, (victim,))
        killer.start()
        try:
            yield
        finally:
            killer.cancel()
            killer.join()
        print(f"$ local_cassandra start    # node {victim.node.number} again", flush=True)
        self.cluster.start(die_with_us=True)
        self.note("recorded with", f"node {victim.node.number} of {self.nodes} killed and back")

    def kill(self, victim: NodeStatus) -> None:
        """Kill the server of a node."""
        print(f"$ kill -9 {victim.pid}    # node {victim.node.number}", flush=True)
        os.kill(victim.pid, signal.SIGKILL)

    def ask(self) -> None:
        self.say("Ask the past over services")
        self.spawn("query_server", [*RUN, "query_server"], "services under /cassandra_ros")
        call = ["rosservice", "call"]
        name = "/cassandra_ros/"
        newest = "{topic: /fix, key_text: '2100-01-01', nearest: before, omit_data: true}"
        begin = time.monotonic()
        answer = self.run(*call, name + "getData", newest, shown=30)
        first = re.search(r"secs: (\d+)\n\s*nsecs:\s*(\d+)", answer)
        assert first is not None and "success: True" in answer, answer
        time_range = (
            f"{{topic: /imu/data, key: {{secs: {int(first[1]) - 5}}}, limit: 3, omit_data: true, "
            "omit_yaml: true}"
        )
        answer = self.run(*call, name + "range", time_range, shown=45)
        assert answer.count("topic: ") == 3 and "success: True" in answer, answer
        cql = "select KEY, latitude, longitude from /fix where status.status >= 0 limit 3"
        answer = self.run(*call, name + "executeCQL", f'{{statement: "{cql}"}}')
        assert "success: True" in answer, answer
        self.note("three service calls", f"{time.monotonic() - begin:.1f} s, command line included")

    def read(self) -> None:
        self.say("Read it in Python: the paper's listing")
        store = ["--port", self.env["CASSANDRA_ROS_PORT"], "--keyspace", LIVE]
        self.run(sys.executable, HERE / "listing.py", *store)
        self.say("Draw the track from two CQL queries")
        picture = self.out / "track.png"
        text = self.run(sys.executable, HERE / "track.py", *store, "--out", picture)
        self.note("track drawn from CQL", text.partition(": ")[2].strip())

    def bags(self) -> None:
        self.say("Import the bag, export it, compare exactly")
        self.env["CASSANDRA_ROS_KEYSPACE"] = COPY
        begin = time.monotonic()
        self.run(*RUN, "cassandra_bag", "import", BAG, shown=8)
        self.note("import of the bag", f"{time.monotonic() - begin:.1f} s, program start included")
        self.run(*RUN, "cassandra_bag", "info", shown=8)
        text = self.run(*RUN, "cassandra_bag", "verify", BAG)
        self.note("imported, equal in all", _equal(text))
        exported = self.out / "exported.bag"
        self.run(*RUN, "cassandra_bag", "export", "-f", exported, shown=8)
        text = self.run(*RUN, "cassandra_bag", "verify", exported)
        self.note("exported again, equal in all", _equal(text))

    def replay(self) -> None:
        self.say("Play what is stored, record it again, compare (four times as fast)")
        topics = [RENAMED.get(topic, topic) for topic in _topics()]
        options = ["--keyspace", AGAIN, "--node-id", "husky", "--no-diagnostics"]
        command = [*RUN, "recorder", *options, *topics]
        recorder = self.spawn("recorder_again", command, rf"recording {len(topics)} topics")
        renames = [f"{a}:={b}" for a, b in RENAMED.items()]
        play = [*RUN, "player", "-r", "4", "--wait-for-subscribers", "--queue", "0"]
        begin = time.monotonic()
        self.run(*play, *renames)
        self.note("played, 38 s of it at -r 4", f"{time.monotonic() - begin:.1f} s")
        print("$ kill -INT recorder", flush=True)
        if recorder.stop():
            raise SystemExit(f"demo: the recorder lost messages:\n{recorder.text()}")
        print(recorder.text().splitlines()[-1])
        maps = [word for rename in renames for word in ("--map", rename)]
        verify = [*RUN, "cassandra_bag", "verify", self.out / "exported.bag"]
        text = self.run(*verify, "--keyspace", AGAIN, "--content", *maps)
        self.note("played and recorded again, equal", _equal(text))

    def see(self) -> None:
        self.say("See it in a browser, and take a window of it as a bag")
        begin = time.monotonic()
        port = str(_port_or(8080))
        self.viewer = self.spawn("viewer", [*RUN, "viewer", "--port", port], r"http://\S+")
        self.url = re.findall(r"http://[^\s,]+", self.viewer.text())[0].rstrip("/")
        topics = json.loads(self.fetch("/api/topics"))["topics"]
        self.note("viewer", f"{len(topics)} topics after {time.monotonic() - begin:.1f} s")
        window = self.out / "window.bag"
        fixes = {"topics": "/fix", "start": "2013-05-08T14:06:30Z", "end": "2013-05-08T14:06:40Z"}
        window.write_bytes(self.fetch("/window.bag", **fixes))
        text = self.run("rosbag", "info", "-y", "-k", "messages", window)
        self.note("ten seconds of fixes, by URL", f"{int(text)} messages")

    def fetch(self, path: str, **parameters: str) -> bytes:
        """Return what the viewer answers."""
        query = urllib.parse.urlencode(parameters, safe="/:")
        address = self.url + path + (f"?{query}" if query else "")
        print(f"$ {_shell(['curl', address])}", flush=True)
        with urllib.request.urlopen(address, timeout=PATIENCE_SEC) as answer:  # noqa: S310 (our own viewer)
            return answer.read()

    def table(self) -> None:
        self.say("What was recorded, asked and verified")
        taken = sum(status.memory_bytes for status in self.cluster.status())
        heap = self.cluster.settings.java_heap_mb
        self.note(
            "memory of Cassandra at the end",
            f"{taken / 2**20:.0f} MiB on {self.nodes} node(s), each with a heap of {heap} MiB",
        )
        width = max(len(what) for what, _ in self.findings)
        for what, figure in self.findings:
            print(f"{what:{width}}  {figure}")
        print(f"{'pictures and bags':{width}}  {os.path.relpath(self.out)}")

    def leave_open(self) -> None:
        """Let the viewer run until Ctrl-C."""
        print(f"\nSee it: {self.url}/ (Ctrl-C ends it)", flush=True)
        with suppress(KeyboardInterrupt):
            self.viewer.process.wait()


class _Progress:
    """Lines that say what is being waited for, one in a while."""

    def __init__(self) -> None:
        self._told = time.monotonic()

    def tell(self, what: str, seconds: float) -> None:
        """Say what is being waited for, and since how many seconds."""
        if min(seconds, time.monotonic() - self._told) >= TELL_SEC:
            self._told = time.monotonic()
            print(f"{what}: {seconds:.0f} s", flush=True)


class Node:
    """A program in the background; its output goes to a file."""

    def __init__(self, name: str, command: list[str], env: dict[str, str], home: Path) -> None:
        self.name = name
        self.command = command
        self.log = home / f"{name}.log"
        with self.log.open("wb") as sink:
            self.process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT
            )

    def text(self) -> str:
        """Return what it has printed."""
        return self.log.read_text(errors="replace").rstrip()

    def wait_for(self, pattern: str) -> None:
        """Wait for a line."""
        deadline = time.monotonic() + PATIENCE_SEC
        while not re.search(pattern, self.text()):
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"demo: {self.name} did not start:\n{self.text()}")
            time.sleep(0.1)

    def stop(self) -> int:
        """Interrupt it and wait for its end; return its exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(PATIENCE_SEC)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


def _topics() -> list[str]:
    from cassandra_ros.bag.bag_reader import BagReader

    with BagReader(BAG) as bag:
        return sorted({connection.topic for connection in bag.connections.values()})


def _equal(text: str) -> str:
    found = re.search(r"^equal: .* (\d+) messages", text, re.MULTILINE)
    assert found is not None, text
    return f"{int(found[1]):,} of {_messages():,} messages"


def _messages() -> int:
    from cassandra_ros.bag.bag_reader import BagReader

    with BagReader(BAG) as bag:
        return bag.message_count


def _port_or(wanted: int) -> int:
    from cassandra_ros.local_server.ports import is_free

    return wanted if is_free("127.0.0.1", wanted) else free_port()


def _shell(words: list[str]) -> str:
    import shlex

    words = [os.path.relpath(w) if w.startswith(str(HERE.parent)) else w for w in words]
    return " ".join(w if ":=" in w else shlex.quote(w) for w in words)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=HERE.parent / "demo-output")
    parser.add_argument("--view", action="store_true", help="let the viewer run until Ctrl-C")
    parser.add_argument("--secure", action="store_true", help="log in with a password, over TLS")
    text = "number of Cassandra nodes; of three one is killed meanwhile (default: 1)"
    parser.add_argument("--nodes", type=int, choices=(1, 3), default=1, help=text)
    args = parser.parse_args()
    if shutil.which("rosrun") is None:
        sys.exit("demo: rosrun is not on the path; run: make demo")
    # Also where a shell started this in the background and SIGINT is ignored, here and, by
    # inheritance, in every node.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    args.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        demo = Demo(args.out.resolve(), stack, args.secure, args.nodes)
        for step in (
            demo.servers,
            demo.record,
            demo.ask,
            demo.read,
            demo.bags,
            demo.replay,
            demo.see,
            demo.table,
        ):
            step()
        if args.view:
            demo.leave_open()
    print("\nNothing is left running.")
    if not args.view:
        print(f"The viewer was at {demo.url}/; to see it: make demo ARGS=--view")
    return 0


if __name__ == "__main__":
    sys.exit(main())
