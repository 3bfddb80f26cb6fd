# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a robot's store that a replicator follows, of the store at home, and of the network.

The recorder writes to the store of the robot. The account is made at home: what is not there after
the robot has ended is lost.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Callable

from cassandra_ros import RosCassandra
from faults.proxy import Proxy
from faults.store_faults import DISK_MB, NO_ROOM, fill_disk, small_disk
from faults.trial import TOPIC, Place, Publisher, Trial
from faults.world import PROGRAMS, ROOT, Failed, Program, Server, await_true

KILLS = 3, 20
"""Number of kills in the short and in the long form."""
HOUR_SEC = 3600


class _Robot:
    """A robot: its store, recorders and publishers, and replicators of it to home.

    Args:
        trial: The trial, whose server is home.
        server: The Cassandra of the robot; None = that of home.
    """

    publisher: Publisher

    def __init__(self, trial: Trial, server: Server | None = None) -> None:
        self._trial = trial
        self.home = trial.place
        self.server = server or trial.server
        self.place = Place(",".join(self.server.hosts), self.server.port)
        self.space = f"{trial.keyspace}_robot"
        trial.open.callback(trial.drop, self.space, self.server)
        trial.at_end.append(self._copy_rest)
        self._replicators: list[Program] = []
        self._source = ("--keyspace", self.space)
        self.compare: Callable[[], object] = self.equal
        """Compares the stores when all is copied."""

    def record(self) -> None:
        """Start a recorder of the topic, and its publisher."""
        self.recorder()
        self.publisher = self._trial.publisher()

    def recorder(self, *options: object, **env: str) -> Program:
        """Start a recorder of the topic, and wait until it records."""
        return self._trial.recorder(TOPIC, *self._source, *options, place=self.place, **env)

    def recorder_of_all(self) -> None:
        """Start a recorder of all topics of the trial, and wait until it looks for them."""
        words = ("-e", f"{TOPIC}_.*", *self._source)
        self._trial.start_recorder(*words, place=self.place).await_text("services under")

    def follow(
        self,
        *options: object,
        home: Place | None = None,
        name: str = "replicator",
    ) -> Program:
        """Start a replicator.

        Args:
            options: Its further options.
            home: Where it reaches home; None = without a proxy.
            name: Name of its node.
        """
        words = ["--host", self.place.host, "--port", self.place.port, *self._source, *options]
        words += ["--to", self._target(home or self.home), f"__name:={name}"]
        program = self._trial.run(PROGRAMS / "replicator", *words)
        self._replicators.append(program)
        return program

    def await_copied(self) -> None:
        """Wait until the first messages are at home, and then for more of the publisher."""
        self._trial.await_normal()

    def await_more(self) -> None:
        """Wait until messages are at home that are later than the ones there now."""
        self._trial.await_newer()

    def await_all_copied(self) -> None:
        """Wait until by the books nothing waits any more."""

        def copied() -> bool:
            verb = self._trial.verb("copy", "--status", *self._source, place=self.place)
            return verb.process.wait() == 0

        await_true("all is copied", copied, 900)

    def done(self, *words: object, status: int = 0) -> str:
        """Run a verb at the store of the robot; return its output."""
        return self._trial.done(*words, *self._source, status=status, place=self.place)

    def copied(self) -> int:
        """Return how many messages of the robot's store home has, by the books."""
        verb = self._trial.verb("copy", "--status", "--json", *self._source, place=self.place)
        verb.process.wait()
        return sum(each["copied"] for each in json.loads(verb.output))

    def await_refused(self, *reasons: str) -> None:
        """Wait until the reasons of refused topics contain some texts."""

        def refused() -> bool:
            verb = self._trial.verb("copy", "--status", *self._source, place=self.place)
            verb.process.wait()
            return all(reason in verb.output for reason in reasons)

        await_true(f"refused: {reasons}", refused)

    def equal(self) -> None:
        """Compare both stores, which are equal."""
        self.done("verify", "--with", self._target(self.home))

    def await_equal(self) -> None:
        """Wait until both stores are equal."""

        def equal() -> bool:
            words = ("verify", "--with", self._target(self.home), *self._source)
            return self._trial.verb(*words, place=self.place).process.wait() == 0

        await_true("both stores are equal", equal, 900)

    def repair(self) -> None:
        """Compare both stores, and copy what differs again."""
        self.done("verify", "--with", self._target(self.home), "--repair")

    def only_more_at_home(self) -> None:
        """Compare both stores: home has in each bucket at least what the robot has."""
        verb = self._trial.verb(
            *("verify", "--json", "--with", self._target(self.home), *self._source),
            place=self.place,
        )
        verb.process.wait()
        found = json.loads(verb.output)
        if found["refused"] or not found["messages"] + len(found["differences"]):
            raise Failed(f"nothing was compared: {verb.output}")
        fewer = [
            each
            for each in found["differences"]
            if each["there"]["messages"] <= each["here"]["messages"]
        ]
        if fewer:
            raise Failed(f"home does not have all: {verb.output}")

    def _target(self, place: Place) -> str:
        return f"{place.host}:{place.port}/{self._trial.keyspace}"

    def _copy_rest(self) -> None:
        """Wait until nothing waits any more, end the replicators, compare both stores."""
        self.await_all_copied()
        self.compare()
        for program in self._replicators:
            if program.runs:
                program.end()


def _followed(trial: Trial, server: Server | None = None) -> _Robot:
    """Return a robot that is recorded and copied home."""
    robot = _Robot(trial, server)
    robot.record()
    robot.follow()
    robot.await_copied()
    return robot


def replicator_killed(trial: Trial) -> None:
    """The replicator is killed 20 times (short form: 3), and started again."""
    robot = _Robot(trial)
    robot.record()
    replicator = robot.follow()
    robot.await_copied()
    count = KILLS[not trial.short]
    for _ in range(count):
        robot.publisher.await_share(0.6 / count)
        time.sleep(trial.random.random())
        replicator.kill()
        trial.outlast_lock()
        replicator = robot.follow()
    robot.await_copied()


def replicators_at_once(trial: Trial) -> None:
    """Two replicators copy from one store to the same other one all the time."""
    robot = _Robot(trial)
    robot.record()
    robot.follow()
    robot.follow(name="replicator_2")
    robot.publisher.await_share(0.6)
    robot.await_copied()


def home_killed(trial: Trial) -> None:
    """Cassandra at home is killed with SIGKILL 20 times (short form: 3), and started again."""
    _killed(trial, _followed(trial, _started(trial, trial.folder / "robot")), trial.server)


def robot_store_killed(trial: Trial) -> None:
    """Cassandra of the robot is killed with SIGKILL 20 times (short form: 3), and started again."""
    robot = _followed(trial, _started(trial, trial.folder / "robot"))
    _killed(trial, robot, robot.server)


def _killed(trial: Trial, robot: _Robot, server: Server) -> None:
    """Kill a server at random moments, each time after messages were copied since its start."""
    count = KILLS[not trial.short]
    for _ in range(count):
        time.sleep(trial.random.uniform(0, 5))
        server.kill()
        robot.publisher.await_share(0.4 / count)
        server.start()
        robot.await_more()
    robot.await_copied()


def link_cut(trial: Trial) -> None:
    """The network between robot and home is cut, and later carries nothing for 20 s."""
    robot = _Robot(trial)
    robot.record()
    home = trial.place
    proxy = trial.open.enter_context(Proxy((home.host, home.port), ("127.0.0.1", 0)))
    robot.follow(home=Place(proxy.host, proxy.port))
    robot.await_copied()
    proxy.cut()
    robot.publisher.await_share(0.3)
    proxy.mend()
    robot.await_copied()
    proxy.silence(new=True)
    time.sleep(trial.seconds(5, 20))
    proxy.end_silence()
    robot.await_copied()


def home_full(trial: Trial) -> None:
    """The disk at home is full; later there is room again, and Cassandra is stopped and started."""
    folder = small_disk(trial, DISK_MB)
    robot_server = trial.server
    trial.server = _started(trial, folder / "home")
    robot = _followed(trial, robot_server)
    ballast = fill_disk(folder)
    log = trial.server.cluster.nodes[0].log
    await_true("Cassandra misses room", lambda: NO_ROOM in log.read_text(errors="replace"))
    robot.publisher.await_share(0.3)
    ballast.unlink()
    trial.server.cluster.stop()
    trial.server.start()
    robot.await_copied()


def _started(trial: Trial, folder: Path) -> Server:
    """Start a Cassandra of this trial alone."""
    server = Server(folder)
    trial.open.callback(server.stop)
    return server.start()


def topic_renamed_on_both_sides(trial: Trial) -> None:
    """The topic is renamed on the robot, its copy is refused; then it is renamed at home, too."""
    robot = _followed(trial)
    robot.done("rename", TOPIC, f"{TOPIC}_renamed")
    robot.publisher.await_share(0.3)
    trial.done("rename", TOPIC, f"{TOPIC}_renamed")


def topic_removed_at_robot(trial: Trial) -> None:
    """The topic is truncated and then deleted on the robot; what home had before stays there."""
    robot = _followed(trial)
    robot.compare = robot.only_more_at_home
    for options in (["--messages"], []):
        # All that the books tell of is deleted here and stays there.
        before = robot.copied()
        trial.removed_by(robot.done("delete", TOPIC, *options, "--yes", "--json"))
        trial.removed_count -= before
        robot.await_copied()


def deletions_repeated(trial: Trial) -> None:
    """The same with --with-deletions: all that the robot deletes is deleted at home, too."""
    robot = _Robot(trial)
    robot.record()
    robot.follow("--with-deletions")
    robot.await_copied()
    for options in (["--messages"], []):
        trial.removed_by(robot.done("delete", TOPIC, *options, "--yes", "--json"))
        robot.await_copied()
    robot.compare = robot.await_equal


def topic_removed_at_home(trial: Trial) -> None:
    """The topic is truncated and then deleted at home; verify --repair copies it again."""
    robot = _followed(trial)
    robot.compare = robot.repair
    for options in (["--messages"], []):
        trial.done("delete", TOPIC, *options, "--yes")
        robot.await_copied()


def topic_converted(trial: Trial) -> None:
    """The topic is converted on the robot and at home while it is copied, which is refused."""
    robot = _followed(trial)
    words = ("convert", TOPIC, "--format", "packed")
    robot.done(*words, status=1)
    trial.done(*words, status=1)
    robot.await_copied()


def other_topics_at_home(trial: Trial) -> None:
    """Home has topics of another type and key under two names: refused until they are removed."""
    trial.topics = 3
    with RosCassandra(trial.place.host, trial.place.port, keyspace=trial.keyspace) as home:
        home.addTopic(f"{TOPIC}_0", msg_type="diagnostic_msgs/KeyValue")
        home.addTopic(f"{TOPIC}_1", msg_type="std_msgs/String", key_format="hash")
    robot = _Robot(trial)
    robot.recorder_of_all()
    robot.publisher = trial.publisher()
    robot.follow()
    robot.await_refused(
        "type std_msgs/String", "diagnostic_msgs/KeyValue [", "key format time here, and hash there"
    )
    await_true("the third topic is copied", robot.copied)
    trial.done("delete", f"{TOPIC}_0", f"{TOPIC}_1", "--yes")


def clocks_differ(trial: Trial) -> None:
    """The clocks of two robots are an hour behind and ahead of those of home and replicator."""
    trial.robots = ["behind", "ahead"]
    robot = _Robot(trial)
    path = [str(ROOT / "test/faults/wall_clock"), trial.world.env["PYTHONPATH"]]
    for name, seconds in zip(trial.robots, (-HOUR_SEC, HOUR_SEC)):
        clock = trial.folder / name
        clock.write_text(str(seconds))
        robot.recorder(
            *("--node-id", name, f"__name:=recorder_{name}"),
            PYTHONPATH=os.pathsep.join(path),
            CASSANDRA_ROS_FAULTS_CLOCK=str(clock),
        )
    robot.publisher = trial.publisher(subscribers=2)
    robot.follow()
    robot.publisher.await_share(1.0)


FAULTS = (
    replicator_killed,
    replicators_at_once,
    home_killed,
    robot_store_killed,
    link_cut,
    home_full,
    topic_renamed_on_both_sides,
    topic_removed_at_robot,
    deletions_repeated,
    topic_removed_at_home,
    topic_converted,
    other_topics_at_home,
    clocks_differ,
)
