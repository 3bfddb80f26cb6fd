# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a robot's store that a replicator follows, of the store at home, and of the network.

The recorder writes to the store of the robot. The account is made at home: what is not there after
the robot has ended is lost.
"""

from __future__ import annotations

import time
from pathlib import Path

from faults.proxy import Proxy
from faults.store_faults import DISK_MB, NO_ROOM, fill_disk, small_disk
from faults.trial import TOPIC, Place, Trial
from faults.world import PROGRAMS, Program, Server, await_true

KILLS = 3, 20
"""Number of kills in the short and in the long form."""


class _Robot:
    """A robot: its store, recorder and publisher, and replicators of it to home.

    Args:
        trial: The trial, whose server is home.
        server: The Cassandra of the robot; None = that of home.
    """

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
        trial.recorder(TOPIC, *self._source, place=self.place)
        self.publisher = trial.publisher()

    def follow(self, home: Place | None = None, name: str = "replicator") -> Program:
        """Start a replicator.

        Args:
            home: Where it reaches home; None = without a proxy.
            name: Name of its node.
        """
        words = ["--host", self.place.host, "--port", self.place.port, *self._source]
        words += ["--to", self._target(home or self.home), f"__name:={name}"]
        program = self._trial.run(PROGRAMS / "replicator", *words)
        self._replicators.append(program)
        return program

    def await_copied(self) -> None:
        """Wait until the first messages are at home, and then for more of the publisher."""
        self._trial.await_normal()

    def done(self, *words: object) -> None:
        """Run a verb at the store of the robot."""
        self._trial.done(*words, *self._source, place=self.place)

    def _target(self, place: Place) -> str:
        return f"{place.host}:{place.port}/{self._trial.keyspace}"

    def _copy_rest(self) -> None:
        """Wait until nothing waits any more, end the replicators, compare both stores."""

        def copied() -> bool:
            verb = self._trial.verb("copies", *self._source, place=self.place)
            return verb.process.wait() == 0

        await_true("all is copied", copied, 900)
        for program in self._replicators:
            if program.runs:
                program.end()
        self.done("verify", "--with", self._target(self.home))


def replicator_killed(trial: Trial) -> None:
    """The replicator is killed 20 times (short form: 3), and started again."""
    robot = _Robot(trial)
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
    robot.follow()
    robot.follow(name="replicator_2")
    robot.publisher.await_share(0.6)
    robot.await_copied()


def home_killed(trial: Trial) -> None:
    """Cassandra at home is killed with SIGKILL and started again."""
    robot = _Robot(trial, _started(trial, trial.folder / "robot"))
    robot.follow()
    robot.await_copied()
    robot.publisher.await_share(0.2)
    trial.server.kill()
    robot.publisher.await_share(0.2)
    trial.server.start()
    robot.await_copied()


def robot_store_killed(trial: Trial) -> None:
    """Cassandra of the robot is killed with SIGKILL and started again."""
    robot = _Robot(trial, _started(trial, trial.folder / "robot"))
    robot.follow()
    robot.await_copied()
    robot.publisher.await_share(0.2)
    robot.server.kill()
    robot.publisher.await_share(0.2)
    robot.server.start()
    robot.await_copied()


def link_cut(trial: Trial) -> None:
    """The network between robot and home is cut, and later carries nothing for 20 s."""
    robot = _Robot(trial)
    home = trial.place
    proxy = trial.open.enter_context(Proxy((home.host, home.port), ("127.0.0.1", 0)))
    robot.follow(Place(proxy.host, proxy.port))
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
    robot = _Robot(trial, robot_server)
    robot.follow()
    robot.await_copied()
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
    robot = _Robot(trial)
    robot.follow()
    robot.await_copied()
    robot.done("rename", TOPIC, f"{TOPIC}_renamed")
    robot.publisher.await_share(0.3)
    trial.done("rename", TOPIC, f"{TOPIC}_renamed")


FAULTS = (
    replicator_killed,
    replicators_at_once,
    home_killed,
    robot_store_killed,
    link_cut,
    home_full,
    topic_renamed_on_both_sides,
)
