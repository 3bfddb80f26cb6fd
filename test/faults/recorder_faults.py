# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a recorder and of what happens around it in ROS."""

from __future__ import annotations

import os
import sys
import time

from faults.trial import TOPIC, Trial
from faults.world import ROOT, await_true


def recorder_killed(trial: Trial) -> None:
    """The recorder is killed with SIGKILL, and another one is started."""
    _killed(trial, "ros")


def recorder_killed_packed(trial: Trial) -> None:
    """The same in format packed, whose messages wait up to 0.5 s for the others of their block."""
    _killed(trial, "packed")


def recorder_killed_with_journal(trial: Trial) -> None:
    """The same with --journal: the next recorder stores what the killed one had received."""
    _killed(trial, "ros", "--journal")


def _killed(trial: Trial, form: str, *options: str) -> None:
    recorder, publisher = trial.record("--format", form, *options)
    publisher.await_share(trial.random.uniform(0.2, 0.8))
    trial.await_current(publisher)
    trial.kills.append(recorder.kill())
    trial.recorder(TOPIC, "--format", form, *options)
    trial.await_normal(trial.kills[0])


def recorder_killed_in_schema_change(trial: Trial) -> None:
    """The recorder is killed while it holds the schema lock, which runs out after 120 s."""
    recorder = trial.recorder(TOPIC)
    trial.publisher()
    await_true("the recorder holds the schema lock", trial.schema_is_locked)
    trial.kills.append(recorder.kill())
    trial.outlast_lock()
    trial.recorder(TOPIC)
    trial.await_normal(trial.kills[0])


def clock_set_back(trial: Trial) -> None:
    """The wall clock of the recorder is set back by an hour."""
    _clock_set(trial, -3600)


def clock_set_forward(trial: Trial) -> None:
    """The wall clock of the recorder is set forward by a day."""
    _clock_set(trial, 86_400)


def _clock_set(trial: Trial, seconds: int) -> None:
    clock = trial.folder / "clock"
    clock.write_text("0")
    path = [str(ROOT / "test/faults/wall_clock"), trial.world.env["PYTHONPATH"]]
    _, publisher = trial.record(
        PYTHONPATH=os.pathsep.join(path), CASSANDRA_ROS_FAULTS_CLOCK=str(clock)
    )
    publisher.await_share(0.4)
    clock.write_text(str(seconds))
    publisher.await_share(0.4)


def simulated_clock_set_back(trial: Trial) -> None:
    """The recorder follows /clock, and the simulated time goes back by an hour."""
    trial.master = trial.world.start_master()
    trial.open.callback(trial.master.end)
    trial.master.set_param("/use_sim_time", True)
    offset = trial.folder / "offset"
    offset.write_text("0")
    trial.run(sys.executable, "-m", "faults.clock", offset)
    _, publisher = trial.record()
    publisher.await_share(0.4)
    offset.write_text("-3600")
    publisher.await_share(0.4)


def two_recorders(trial: Trial) -> None:
    """Two recorders, of two robots, make the same new topic at the same moment."""
    trial.robots = ["one", "two"]
    publisher = trial.publisher(subscribers=2)
    # With the same name of a ROS node the master would shut one of them down.
    commands = [(TOPIC, "--node-id", name, f"__name:=recorder_{name}") for name in trial.robots]
    for recorder in [trial.start_recorder(*command) for command in commands]:
        recorder.await_text("recording 1 topic")
    publisher.await_share(1.0)


def type_changes(trial: Trial) -> None:
    """The publisher ends, and another one publishes another type on the same topic."""
    half = trial.messages // 2
    trial.recorder(TOPIC)
    trial.publisher(messages=half).await_share(1.0)
    trial.publisher(first=half, kind="KeyValue").await_share(0.5)


def many_topics(trial: Trial) -> None:
    """200 topics begin at the same moment (short form: 50)."""
    trial.topics = 50 if trial.short else 200
    recorder = trial.start_recorder("-e", f"{TOPIC}_.*")
    recorder.await_text("services under")
    trial.publisher().await_share(1.0)


def roscore_killed(trial: Trial) -> None:
    """The ROS master is killed and started again at its address, and a new publisher comes."""
    trial.master = trial.world.start_master()
    trial.open.callback(lambda: trial.master.end())
    half = trial.messages // 2
    trial.recorder(TOPIC)
    first = trial.publisher(messages=half)
    first.await_share(0.5)
    trial.master.kill()
    trial.master = trial.world.start_master(trial.master.port)
    restarted = time.time_ns()
    first.await_share(0.5)
    trial.publisher(first=half).await_share(0.5)
    trial.await_normal(restarted)


def truncated(trial: Trial) -> None:
    """The topic is truncated while it is recorded."""
    _removed(trial, "delete", TOPIC, "--messages", "--yes", "--json")


def messages_deleted(trial: Trial) -> None:
    """All messages so far are deleted while the topic is recorded."""
    _removed(trial, "delete", TOPIC, "--start", "1", "--yes", "--json")


def topic_deleted(trial: Trial) -> None:
    """The topic is deleted while it is recorded."""
    _removed(trial, "delete", TOPIC, "--yes", "--json")


def _removed(trial: Trial, *words: str) -> None:
    _, publisher = trial.record()
    publisher.await_share(0.4)
    trial.removed_by(trial.done(*words))
    trial.await_normal()


def renamed(trial: Trial) -> None:
    """The topic is renamed while it is recorded."""
    _, publisher = trial.record()
    publisher.await_share(0.4)
    trial.done("rename", TOPIC, f"{TOPIC}_renamed")
    trial.await_normal()


def converted(trial: Trial) -> None:
    """The topic is converted while it is recorded, which is refused."""
    _, publisher = trial.record()
    publisher.await_share(0.4)
    trial.done("convert", TOPIC, "--format", "packed", status=1)
    trial.await_normal()


def indexed(trial: Trial) -> None:
    """An index is made, completed and removed while the topic is recorded."""
    _, publisher = trial.record()
    publisher.await_share(0.3)
    trial.done("index", TOPIC, "data")
    publisher.await_share(0.3)
    trial.done("index", TOPIC, "data")
    trial.done("index", TOPIC, "data", "--remove")
    trial.await_normal()


def keyspace_dropped(trial: Trial) -> None:
    """The keyspace is dropped while it is recorded into."""
    _, publisher = trial.record()
    publisher.await_share(0.4)
    with trial.store() as store:
        list(store.select(f"DROP KEYSPACE {trial.keyspace}"))
    trial.gone_before_ns = time.time_ns()
    trial.await_normal()


FAULTS = (
    recorder_killed,
    recorder_killed_packed,
    recorder_killed_with_journal,
    clock_set_back,
    clock_set_forward,
    simulated_clock_set_back,
    two_recorders,
    type_changes,
    many_topics,
    roscore_killed,
    truncated,
    messages_deleted,
    topic_deleted,
    renamed,
    converted,
    indexed,
    keyspace_dropped,
)
