# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two robots and a home: they copy themselves home while links, nodes and robots fail.

make demo ARGS=--fleet runs it, doc/fleet.md describes it.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from faults.proxy import Proxy
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
    stop_cluster,
)

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.stores.copying.copy_status import copy_status

POLL_SEC = 1.0
ATTEMPTS = 5
"""Maximum number of times that a question is asked."""
EVENT = "sharp turn"
EVENTS = f"""\
events:
  - name: {EVENT}
    topic: /encoder
    where: "twist.twist.angular.z < -0.8"
    hold: 0.5s
"""


@dataclass
class Robot:
    """A robot: its bag, its own Cassandra, a shell of its computer, and what runs there."""

    name: str
    drive: Drive
    rate: float
    """Speed at which the bag is played: both drives take about as long."""
    cluster: LocalCluster
    shell: Shell
    options: list[str] = field(default_factory=list)
    """Options of its recorder."""
    programs: dict[str, Program] = field(default_factory=dict)

    def stored(self) -> int:
        """Return the number of messages in its own store."""
        with self._store() as store:
            return sum(topic.countTopicData() for topic in store.getAllTopics())

    def copied(self) -> int:
        """Return the number of messages that home has acknowledged, by the books."""
        with self._store() as store:
            return sum(topic.copied for topic in copy_status(store.catalog))

    def _store(self) -> RosCassandra:
        settings = self.cluster.settings
        return RosCassandra(settings.host, settings.port, keyspace="ros", cqlshrc=os.devnull)


class FleetDemo:
    """The steps, the processes that they started, and what they found out."""

    def __init__(self, stack: ExitStack) -> None:
        self.stack = stack
        self.findings: list[tuple[str, str]] = []
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fleet_demo_")))

    def note(self, what: str, figure: str) -> None:
        """Keep a figure for the closing table."""
        self.findings.append((what, figure))

    def servers(self) -> None:
        say("A home of three Cassandra nodes, and two robots, each with a Cassandra and a roscore")
        begin = time.monotonic()
        self.home = self.start_cluster("home", "127.0.0.1", nodes=3)
        self.home_shell = self.start_master("home", self.home)
        rules = self.folder / "events.yaml"
        rules.write_text(EVENTS, encoding="utf-8")
        husky = ("husky", "husky_gps_data.bag", 1.0, "127.0.1.1", ["--config", str(rules)])
        turtle = ("turtle", "turtlesim_tf.bag", 0.5, "127.0.2.1", [])
        self.husky, self.turtle = self.robots = [
            self.start_robot(*each) for each in (husky, turtle)
        ]
        self.note("five Cassandras ready after", f"{time.monotonic() - begin:.1f} s")
        settings = self.husky.cluster.settings
        # All bytes between husky and home pass it. It stands for husky's radio.
        self.link = self.stack.enter_context(
            Proxy((settings.host, settings.port), ("127.0.0.1", free_port()))
        )
        self.stores = self.folder / "stores"
        turtle_place = f"{self.turtle.cluster.settings.host}:{self.turtle.cluster.settings.port}"
        self.stores.write_text(
            f"[home]\nplace = {self.place_of_home}\n"
            f"[husky]\nplace = {self.link.host}:{self.link.port}\n"
            f"[turtle]\nplace = {turtle_place}\n",
            encoding="utf-8",
        )

    def start_cluster(self, name: str, host: str, nodes: int = 1) -> LocalCluster:
        """Start a Cassandra."""
        hosts = [host[:-1] + str(number) for number in range(1, nodes + 1)]
        cluster = LocalCluster(
            self.folder / name / "cassandra",
            nodes=nodes,
            host=host,
            port=port_or(9042, *hosts),
            heap=SMALL_HEAP,
            say=print,
            progress=Progress().tell,
        )
        self.stack.callback(stop_cluster, cluster)
        print(f"{name}$ local_cassandra start --nodes {nodes} --host {host}", flush=True)
        cluster.start(die_with_us=True)
        return cluster

    def start_master(self, name: str, cluster: LocalCluster) -> Shell:
        """Start a roscore; return a shell of its machine."""
        folder = self.folder / name
        port = free_port()
        shell = Shell(os.environ, folder, self.stack, name)
        shell.env.update(
            PYTHONUNBUFFERED="1",
            CASSANDRA_ROS_HOST=",".join(node.address for node in cluster.nodes),
            CASSANDRA_ROS_PORT=str(cluster.settings.port),
            CASSANDRA_ROS_KEYSPACE="ros",
            CASSANDRA_ROS_CQLSHRC="",
            ROS_MASTER_URI=f"http://127.0.0.1:{port}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(folder / "ros"),
            ROS_LOG_DIR=str(folder / "ros" / "log"),
        )
        shell.spawn("roscore", ["roscore", "-p", str(port)], r"started core service \[/rosout\]")
        return shell

    def start_robot(self, name: str, bag: str, rate: float, host: str, options: list[str]) -> Robot:
        """Start the Cassandra and the roscore of a robot."""
        cluster = self.start_cluster(name, host)
        shell = self.start_master(name, cluster)
        drive = Drive(HERE / "data" / bag, f"/{name}")
        return Robot(name, drive, rate, cluster, shell, options)

    @property
    def place_of_home(self) -> str:
        """Home's nodes, as --to takes them."""
        nodes = ",".join(node.address for node in self.home.nodes)
        return f"{nodes}:{self.home.settings.port}"

    def drive(self) -> None:
        say("Both robots record while they drive, and copy themselves home")
        for robot in self.robots:
            topics = robot.drive.recorded
            # Husky has /diagnostics of its own, which are to be compared.
            options = ["--node-id", robot.name, "--no-diagnostics", "--format", "packed"]
            command = [*RUN, "recorder", *options, *robot.options, *topics]
            ready = rf"recording {len(topics)} topics"
            robot.programs["recorder"] = robot.shell.spawn("recorder", command, ready)
            self.replicate(robot)
        for robot in self.robots:
            logs, others = robot.drive.play_commands(robot.rate)
            robot.programs["rosbag"] = robot.shell.begin("rosbag", others)
            if robot is self.husky:  # turtle logs later
                robot.programs["rosbag_logs"] = robot.shell.begin("rosbag_logs", logs)
        for robot in self.robots:
            self.await_copied(robot, 1)

    def replicate(self, robot: Robot) -> None:
        """Start a replicator: turtle's on the robot, husky's at home, at the end of the link."""
        command = [*RUN, "replicator", "--no-diagnostics", "--to", self.place_of_home]
        shell = robot.shell
        if robot is self.husky:
            command += ["--host", self.link.host, "--port", str(self.link.port)]
            shell = self.home_shell
        robot.programs["replicator"] = shell.spawn("replicator", command, "services under")

    def await_copied(self, robot: Robot, count: int) -> None:
        """Wait until home has acknowledged a number of messages of a robot."""
        begin, progress = time.monotonic(), Progress()
        while (copied := robot.copied()) < count:
            seconds = time.monotonic() - begin
            if seconds > PATIENCE_SEC:
                text = robot.programs["replicator"].text()
                raise SystemExit(f"demo: home has {copied} of {count} messages:\n{text}")
            progress.tell(f"home has {copied} messages of {robot.name}", seconds)
            time.sleep(POLL_SEC)
        print(f"home has {copied} messages of {robot.name}", flush=True)

    def cut_link(self) -> None:
        say("The link to husky is cut, and a node of home is killed")
        self.home_shell.echo("# no byte comes from husky, or goes there")
        self.link.cut()
        victim = self.home.status()[1]
        kill(victim.pid, "node 2 of home", self.home_shell)
        self.ask(missing="husky")
        before = self.turtle.copied()
        if before < self.turtle.stored():
            self.await_copied(self.turtle, before + 1)
        waiting = self.husky.stored() - self.husky.copied()
        self.note("without link and one of three nodes", f"{waiting:,} messages of husky waited")

    def leave(self) -> None:
        say("turtle leaves before all is copied: it is switched off; link and node are back")
        kill(self.turtle.programs["replicator"].process.pid, "its replicator", self.turtle.shell)
        self.home_shell.echo("# the link is back")
        self.link.mend()
        self.home_shell.echo("local_cassandra start    # node 2 again")
        self.home.start(die_with_us=True)
        # What is recorded now waits on the robot, however fast the copies before were.
        logs, _ = self.turtle.drive.play_commands(rate=4)
        self.turtle.shell.run(*logs)
        for name in ("rosbag", "rosbag_logs"):
            self.husky.programs[name].wait()
        self.turtle.programs["rosbag"].wait()
        for robot in self.robots:
            time.sleep(1.0)
            robot.shell.echo("kill -INT recorder")
            recorder = robot.programs["recorder"]
            if recorder.stop():
                raise SystemExit(f"demo: the recorder lost messages:\n{recorder.text()}")
            print(recorder.text().splitlines()[-1], flush=True)
        waiting = self.turtle.stored() - self.turtle.copied()
        self.note("while turtle was away", f"{waiting:,} of its messages waited")
        kill(self.turtle.cluster.status()[0].pid, "its Cassandra", self.turtle.shell)
        self.ask(missing="turtle")

    def come_back(self) -> None:
        say("turtle comes back, and all goes home")
        begin = time.monotonic()
        self.turtle.shell.echo("local_cassandra start")
        self.turtle.cluster.start(die_with_us=True)
        self.replicate(self.turtle)
        for robot in self.robots:
            self.await_copied(robot, robot.drive.count)
        self.note("all at home after", f"{time.monotonic() - begin:.1f} s")
        for robot in self.robots:
            robot.shell.echo("kill -INT replicator")
            if robot.programs["replicator"].stop():
                raise SystemExit(f"demo: {robot.programs['replicator'].text()}")
            robot.shell.run("cassandra_bag", "copy", "--status", shown=4)

    def verify(self) -> None:
        say("Is every message home, once?")
        for robot in self.robots:
            with_home = ["verify", "--with", self.place_of_home]
            text = robot.shell.run("cassandra_bag", *with_home)
            match = re.search(r"^equal: .* (\d+) messages in (\d+) buckets", text, re.MULTILINE)
            assert match is not None, text
            figure = f"{int(match[1]):,} messages in {match[2]} buckets"
            self.note(f"{robot.name} and home, equal", figure)
            bag = ["verify", robot.drive.path, "--content", "--node-id", robot.name]
            text = self.home_shell.run("cassandra_bag", *bag, *robot.drive.maps)
            self.note(f"{robot.name}'s bag and home, equal in content", robot.drive.equal(text))

    def ask_all(self) -> None:
        say("A question to all stores")
        begin = time.monotonic()
        text = self.ask()
        seconds = time.monotonic() - begin
        for robot in self.robots:
            assert f"{robot.name}: {robot.drive.count} messages\n" in text, text
        found = len(re.findall(f"^event {EVENT} of husky", text, re.MULTILINE))
        assert found, text
        self.note("events found", f"{found} of name {EVENT!r}")
        self.note("a question over all stores", f"{seconds:.1f} s, program start included")

    def ask(self, missing: str = "") -> str:
        """Ask all stores as one; the store that is away has to be named.

        On a busy machine another one may answer too late; it is named, too, and asked again.
        """
        command = [sys.executable, HERE / "ask_fleet.py", "home", "husky", "turtle"]
        options = ["--file", self.stores, "--event", EVENT]
        expected = [missing] if missing else []
        for _ in range(ATTEMPTS):
            text = self.home_shell.run(*command, *options, status=None)
            names = re.findall("^missing: ([a-z]+):", text, re.MULTILINE)
            if names == expected:
                break
        else:
            raise SystemExit(f"demo: {names} did not answer, expected: {expected}")
        if missing:
            self.note(f"asked without {missing}", f"the others answer, {missing} is named")
        return text

    def table(self) -> None:
        say("What was recorded, copied and verified")
        clusters = (self.home, self.husky.cluster, self.turtle.cluster)
        taken = sum(each.memory_bytes for cluster in clusters for each in cluster.status())
        heap = self.home.settings.java_heap_mb
        figure = f"{taken / 2**20:.0f} MiB of five nodes, each with a heap of {heap} MiB"
        self.note("memory of Cassandra at the end", figure)
        print_table(self.findings)


def run(stack: ExitStack) -> None:
    """Run all steps; the stack ends what they have started."""
    demo = FleetDemo(stack)
    for step in (
        demo.servers,
        demo.drive,
        demo.cut_link,
        demo.leave,
        demo.come_back,
        demo.verify,
        demo.ask_all,
        demo.table,
    ):
        step()
