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
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Iterator

from stage import (
    HERE,
    PATIENCE_SEC,
    RUN,
    SMALL_HEAP,
    Drive,
    Program,
    Progress,
    Shell,
    kill,
    port_or,
    print_table,
    say,
    shell_text,
    stop_cluster,
)

from cassandra_ros.local_server import LocalCluster

BAG = HERE / "data" / "husky_gps_data.bag"
LIVE, COPY, AGAIN = "husky_live", "husky_import", "husky_again"
DRIVE_SEC = 10.0
"""Time in which the bag is played at four times its speed, about, s."""
HEARD_SEC = 60.0
"""Maximum time until the recorder has heard the last message, s."""


class Demo:
    """The steps, the processes that they started, and what they found out."""

    def __init__(self, out: Path, stack: ExitStack, secure: bool = False, nodes: int = 1) -> None:
        self.out = out
        self.secure = secure
        self.nodes = nodes
        self.stack = stack
        self.findings: list[tuple[str, str]] = []
        self.home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="husky_demo_")))
        self.shell = Shell(dict(os.environ, PYTHONUNBUFFERED="1"), self.home, stack)
        self.drive = Drive(BAG, "/husky")

    def note(self, what: str, figure: str) -> None:
        """Keep a figure for the closing table."""
        self.findings.append((what, figure))

    def servers(self) -> None:
        say("A Cassandra and a roscore of our own")
        port = port_or(9042)
        heap = SMALL_HEAP if self.nodes > 1 else None
        cluster = LocalCluster(
            self.home / "cassandra",
            nodes=self.nodes,
            port=port,
            heap=heap,
            secure=self.secure,
            say=print,
            progress=Progress().tell,
        )
        self.cluster = cluster
        self.stack.callback(stop_cluster, cluster)
        start = time.monotonic()
        cluster.start(die_with_us=True)
        self.note("Cassandra ready after", f"{time.monotonic() - start:.1f} s")
        master = port_or(11311)
        self.shell.env.update(
            CASSANDRA_ROS_HOST=",".join(node.address for node in cluster.nodes),
            CASSANDRA_ROS_PORT=str(port),
            CASSANDRA_ROS_KEYSPACE=LIVE,
            CASSANDRA_ROS_CQLSHRC=str(cluster.security.cqlshrc) if self.secure else "",
            ROS_MASTER_URI=f"http://127.0.0.1:{master}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(self.home / "ros"),
            ROS_LOG_DIR=str(self.home / "ros" / "log"),
        )
        self.shell.spawn(
            "roscore", ["roscore", "-p", str(master)], r"started core service \[/rosout\]"
        )

    def record(self) -> None:
        say("Record the robot's 24 topics while it drives (four times as fast)")
        topics = self.drive.recorded
        # The robot has /diagnostics of its own, which are to be compared.
        options = ["--node-id", "husky", "--no-diagnostics"]
        command = [*RUN, "recorder", *options, "--format", "ros", *topics]
        recorder = self.shell.spawn("recorder", command, rf"recording {len(topics)} topics")
        rosout, others = self.drive.play_commands(rate=4)
        logs = self.shell.begin("rosbag", rosout)
        with self.one_node_killed():
            self.shell.run(*others)
        logs.wait()
        self.await_heard()
        print(self.end(recorder))
        verify = ["cassandra_bag", "verify", BAG, "--content", *self.drive.maps]
        text = self.shell.run(*verify)
        self.note("recorded live, equal in content", self.drive.equal(text))

    def await_heard(self) -> None:
        """Wait until the recorder has heard all that was played: a busy machine takes a moment."""
        deadline, heard = time.monotonic() + HEARD_SEC, 0
        while heard < self.drive.count and time.monotonic() < deadline:
            status = self.shell.output("rosservice", "call", "/recorder/status")
            heard = sum(map(int, re.findall(r"received: (\d+)", status)))

    def end(self, recorder: Program, *keyspace: str) -> str:
        """End a recorder and return what it printed.

        On a busy machine a cluster may take minutes to make the tables. What it has not taken when
        the recorder ends lies on disk, and is stored here.
        """
        self.shell.echo("kill -INT recorder")
        if recorder.stop():
            raise SystemExit(f"demo: the recorder lost messages:\n{recorder.text()}")
        if re.search(r"^\d+ messages? in the spool", recorder.text(), re.MULTILINE):
            self.shell.run("cassandra_bag", "spool", "drain", *keyspace)
        return recorder.text()

    @contextmanager
    def one_node_killed(self) -> Iterator[None]:
        """Kill one of several nodes in the middle of the drive, and start it again afterwards."""
        if self.nodes < 2:
            yield
            return
        victim = self.cluster.status()[1]
        what = f"node {victim.node.number}"
        killer = threading.Timer(DRIVE_SEC / 2, kill, (victim.pid, what, self.shell))
        killer.start()
        try:
            yield
        finally:
            killer.cancel()
            killer.join()
        self.shell.echo(f"local_cassandra start    # {what} again")
        self.cluster.start(die_with_us=True)
        self.note("recorded with", f"node {victim.node.number} of {self.nodes} killed and back")

    def ask(self) -> None:
        say("Ask the past over services")
        self.shell.spawn("query_server", [*RUN, "query_server"], "services under /cassandra_ros")
        call = ["rosservice", "call"]
        name = "/cassandra_ros/"
        newest = "{topic: /fix, key_text: '2100-01-01', nearest: before, omit_data: true}"
        begin = time.monotonic()
        answer = self.shell.run(*call, name + "getData", newest, shown=30)
        first = re.search(r"secs: (\d+)\n\s*nsecs:\s*(\d+)", answer)
        assert first is not None and "success: True" in answer, answer
        time_range = (
            f"{{topic: /imu/data, key: {{secs: {int(first[1]) - 5}}}, limit: 3, omit_data: true, "
            "omit_yaml: true}"
        )
        answer = self.shell.run(*call, name + "range", time_range, shown=45)
        assert answer.count("topic: ") == 3 and "success: True" in answer, answer
        cql = "select KEY, latitude, longitude from /fix where status.status >= 0 limit 3"
        answer = self.shell.run(*call, name + "executeCQL", f'{{statement: "{cql}"}}')
        assert "success: True" in answer, answer
        self.note("three service calls", f"{time.monotonic() - begin:.1f} s, command line included")

    def read(self) -> None:
        say("Read it in Python: the paper's listing")
        store = ["--port", self.shell.env["CASSANDRA_ROS_PORT"], "--keyspace", LIVE]
        self.shell.run(sys.executable, HERE / "listing.py", *store)
        say("Draw the track from two CQL queries")
        picture = self.out / "track.png"
        text = self.shell.run(sys.executable, HERE / "track.py", *store, "--out", picture)
        self.note("track drawn from CQL", text.partition(": ")[2].strip())

    def bags(self) -> None:
        say("Import the bag, export it, compare exactly")
        self.shell.env["CASSANDRA_ROS_KEYSPACE"] = COPY
        begin = time.monotonic()
        self.shell.run("cassandra_bag", "import", BAG, shown=8)
        self.note("import of the bag", f"{time.monotonic() - begin:.1f} s, program start included")
        self.shell.run("cassandra_bag", "info", shown=8)
        text = self.shell.run("cassandra_bag", "verify", BAG)
        self.note("imported, equal in all", self.drive.equal(text))
        exported = self.out / "exported.bag"
        self.shell.run("cassandra_bag", "export", "-f", exported, shown=8)
        text = self.shell.run("cassandra_bag", "verify", exported)
        self.note("exported again, equal in all", self.drive.equal(text))

    def replay(self) -> None:
        say("Play what is stored, record it again, compare (four times as fast)")
        topics = self.drive.recorded
        options = ["--keyspace", AGAIN, "--node-id", "husky", "--no-diagnostics"]
        command = [*RUN, "recorder", *options, *topics]
        recorder = self.shell.spawn("recorder_again", command, rf"recording {len(topics)} topics")
        renames = [f"{a}:={b}" for a, b in self.drive.renamed.items()]
        play = [*RUN, "player", "-r", "4", "--wait-for-subscribers", "--queue", "0"]
        begin = time.monotonic()
        self.shell.run(*play, *renames)
        self.note("played, 38 s of it at -r 4", f"{time.monotonic() - begin:.1f} s")
        self.await_heard()
        print(self.end(recorder, "--keyspace", AGAIN).splitlines()[-1])
        verify = ["cassandra_bag", "verify", self.out / "exported.bag"]
        text = self.shell.run(*verify, "--keyspace", AGAIN, "--content", *self.drive.maps)
        self.note("played and recorded again, equal", self.drive.equal(text))

    def see(self) -> None:
        say("See it in a browser, and take a window of it as a bag")
        begin = time.monotonic()
        port = str(port_or(8080))
        self.viewer = self.shell.spawn("viewer", [*RUN, "viewer", "--port", port], r"http://\S+")
        address = re.search(r"(http://[^\s?]+)/(?:\?token=(\S+))?", self.viewer.text())
        assert address is not None
        self.url, self.token = address[1], address[2] or ""
        topics = json.loads(self.fetch("/api/topics"))["topics"]
        self.note("viewer", f"{len(topics)} topics after {time.monotonic() - begin:.1f} s")
        window = self.out / "window.bag"
        fixes = {"topics": "/fix", "start": "2013-05-08T14:06:30Z", "end": "2013-05-08T14:06:40Z"}
        window.write_bytes(self.fetch("/window.bag", **fixes))
        text = self.shell.run("rosbag", "info", "-y", "-k", "messages", window)
        self.note("ten seconds of fixes, by URL", f"{int(text)} messages")

    def fetch(self, path: str, **parameters: str) -> bytes:
        """Return what the viewer answers."""
        # With --secure, or if you log in to another store, it asks for a token.
        parameters.update({"token": self.token} if self.token else {})
        query = urllib.parse.urlencode(parameters, safe="/:")
        address = self.url + path + (f"?{query}" if query else "")
        self.shell.echo(shell_text(["curl", address]))
        with urllib.request.urlopen(address, timeout=PATIENCE_SEC) as answer:  # noqa: S310 (our own viewer)
            return answer.read()

    def table(self) -> None:
        say("What was recorded, asked and verified")
        taken = sum(status.memory_bytes for status in self.cluster.status())
        heap = self.cluster.settings.java_heap_mb
        self.note(
            "memory of Cassandra at the end",
            f"{taken / 2**20:.0f} MiB on {self.nodes} node(s), each with a heap of {heap} MiB",
        )
        self.note("pictures and bags", os.path.relpath(self.out))
        print_table(self.findings)

    def leave_open(self) -> None:
        """Let the viewer run until Ctrl-C."""
        query = f"?token={self.token}" if self.token else ""
        print(f"\nSee it: {self.url}/{query} (Ctrl-C ends it)", flush=True)
        with suppress(KeyboardInterrupt):
            self.viewer.process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=HERE.parent / "demo-output")
    parser.add_argument("--view", action="store_true", help="let the viewer run until Ctrl-C")
    parser.add_argument("--secure", action="store_true", help="log in with a password, over TLS")
    text = "number of Cassandra nodes; of three one is killed meanwhile (default: 1)"
    parser.add_argument("--nodes", type=int, choices=(1, 3), default=1, help=text)
    text = "two robots that copy themselves home, instead of one; goes alone"
    parser.add_argument("--fleet", action="store_true", help=text)
    args = parser.parse_args()
    if args.fleet and (args.view or args.secure or args.nodes > 1):
        parser.error("--fleet goes without --view, --secure and --nodes")
    if shutil.which("rosrun") is None:
        sys.exit("demo: rosrun is not on the path; run: make demo")
    # Also where a shell started this in the background and SIGINT is ignored, here and, by
    # inheritance, in every node.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    if args.fleet:
        sys.path.append(str(HERE.parent / "test"))  # for the proxy of the fault table
        import fleet_demo

        with ExitStack() as stack:
            fleet_demo.run(stack)
        print("\nNothing is left running.")
        return 0
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
