# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs get another name, labels and robot afterwards: their messages, losses, events and places."""

from __future__ import annotations

import json
import threading
from collections import Counter

import pytest
import rosbag
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Int32, String
from suites import sparing

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import InvalidName, RunNotFound, SchemaConflict
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables import replacement
from cassandra_ros.store.tables.registry import Loss, LossKind, Registry, Run
from cassandra_ros.topics.event_finder import Events
from cassandra_ros.topics.upkeep import conversion

SEC = 10**9
T0 = 1_500_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Clients of these tests read the comments anew at once."""
    monkeypatch.setattr(replacement, "SETTLE_SEC", 0.05)
    monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.03)


def write_bag(path, first, count=40):
    """A bag with small messages, a large one, and poses; stamps are equal in pairs."""
    with rosbag.Bag(str(path), "w") as bag:
        for n in range(count):
            t = rospy.Time(T0 + n // 2)
            bag.write("/n", Int32(first + n), t)
            pose = PoseStamped()
            pose.header.stamp, pose.header.frame_id = t, "map"
            pose.pose.position.x = float(first + n)
            bag.write("/pose", pose, t)
        bag.write("/large", Image(data=bytes(range(256)) * 8192), rospy.Time(T0))
    return path


def stored(rosCas, topic, **whose):
    """Messages of a topic in their order, with their bytes."""
    rows = rosCas.getTopic(topic).rows(**whose)
    return [(row.t, row.node, row.seq, row.wire) for row in rows]


def all_stored(rosCas, **whose):
    return {topic.name: stored(rosCas, topic.name, **whose) for topic in rosCas.getAllTopics()}


@pytest.fixture(params=sparing(["ros", "packed"], kept=["packed"]))
def two_runs(fresh, tmp_path, request):
    """A keyspace with the runs a.bag and b.bag, without robot."""
    with fresh() as rosCas:
        for name, first in (("a", 0), ("b", 1000)):
            bag = write_bag(tmp_path / f"{name}.bag", first)
            import_bag(rosCas, str(bag), format=request.param)
        yield rosCas


def moved(rows, node):
    return sorted((t, node, seq, wire) for t, _, seq, wire in rows)


@pytest.mark.suite("test", "two imports, and a conversion of three topics")
def test_a_run_gets_another_robot_and_keeps_all_else(two_runs):
    rosCas = two_runs
    (run,) = [run for run in rosCas.runs() if run.name == "a.bag"]
    rosCas.addEvent("bump", T0 * SEC, (T0 + 1) * SEC, run="a.bag", labels={"k": "v"})
    registry = rosCas.catalog.keyspace.registry
    registry.put_loss(Loss("/n", "", run.writer, LossKind.BUFFER_FULL, 5, 6, 7))
    rosCas.upkeep.indexPlaces()
    before, others = all_stored(rosCas, run="a.bag"), all_stored(rosCas, run="b.bag")
    told = []
    (changed,) = rosCas.upkeep.setRuns(
        "a.bag",
        name="corridor",
        nodeID="husky",
        labels={"site": "lab"},
        progress=lambda topic, done, total: told.append((topic, done <= total)),
    )
    assert (changed.name, changed.node, changed.writer) == ("corridor", "husky", run.writer)
    assert changed.public_labels == {"site": "lab"}
    assert (changed.kind, changed.started, changed.ended) == (run.kind, run.started, run.ended)
    assert (changed.stored, changed.state) == (run.stored, "ended")
    assert {topic for topic, _ in told} == {"/n", "/pose", "/large"}
    assert all(fits for _, fits in told)
    after = all_stored(rosCas, nodeID="husky")
    assert {t: sorted(rows) for t, rows in after.items()} == {
        topic: moved(rows, "husky") for topic, rows in before.items()
    }
    assert all_stored(rosCas, nodeID="") == others
    assert all_stored(rosCas, run="b.bag") == others
    assert sum(map(len, all_stored(rosCas).values())) == 2 * 81
    assert [e.node for e in rosCas.events("bump")] == ["husky"]
    assert [loss.node for loss in rosCas.losses()] == ["husky"]
    assert [r.name for r in rosCas.runs() if r.node == "husky"] == ["corridor"]
    assert len(rosCas.runs()) == 2
    states = {p.node: p.state for p in rosCas.upkeep.placesIndex(run="corridor")}
    assert states == {"husky": "indexed"}
    assert rosCas.upkeep.check().found == 0
    # A repetition changes nothing.
    assert rosCas.upkeep.setRuns("corridor", nodeID="husky")[0] == changed


class Killed(BaseException):
    pass


STEPS = [
    (conversion.Conversion, "_begin"),
    (conversion.TableCopy, "compare"),
    (replacement, "finish"),
    (replacement, "drop"),
    (Events, "move"),
    (Registry, "move_run"),
    (Registry, "forget_run"),
]


@pytest.mark.suite("all", "seven kills, each with a repetition")
@pytest.mark.parametrize(("owner", "step"), STEPS, ids=[step for _, step in STEPS])
@pytest.mark.parametrize("is_after", [False, True])
def test_a_killed_change_is_ended_by_a_repetition(two_runs, monkeypatch, owner, step, is_after):
    rosCas = two_runs
    rosCas.addEvent("bump", T0 * SEC, run="a.bag")
    before, others = all_stored(rosCas, run="a.bag"), all_stored(rosCas, run="b.bag")
    real = getattr(owner, step)

    def killed(*args, **options):
        if is_after:
            real(*args, **options)
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(owner, step, killed)
        # What the killed process cannot do any more.
        patched.setattr(conversion.Conversion, "_give_up", lambda self, new: None)
        with pytest.raises(Killed):
            rosCas.upkeep.setRuns("a.bag", nodeID="husky", name="corridor", labels={"k": "v"})
    now = all_stored(rosCas, run="a.bag")
    for topic, rows in before.items():
        assert sorted((t, seq, wire) for t, _, seq, wire in now[topic]) == sorted(
            (t, seq, wire) for t, _, seq, wire in rows
        )
    node = "turtle" if is_after else "husky"  # another robot than before, or the same call again
    rosCas.upkeep.setRuns("a.bag", nodeID=node, name="corridor", labels={"k": "v"})
    assert {t: sorted(rows) for t, rows in all_stored(rosCas, nodeID=node).items()} == {
        topic: moved(rows, node) for topic, rows in before.items()
    }
    assert all_stored(rosCas, nodeID="") == others
    assert sorted((run.name, run.node, len(run.public_labels)) for run in rosCas.runs()) == [
        ("b.bag", "", 0),
        ("corridor", node, 1),
    ]
    assert [event.node for event in rosCas.events("bump")] == [node]
    listing = rosCas.catalog.keyspace.schema.listing(fresh=True)
    assert set(listing.every) == set(listing.visible), "an earlier table was left"


@pytest.mark.suite("all", "reads for as long as a change lasts")
def test_others_read_each_message_once_meanwhile(two_runs, cassandra):
    """A read that stands at a moved message may see those of its time twice, or not (setRuns)."""

    def counted(rows):
        return Counter((t, seq, wire) for t, _, seq, wire in rows)

    rosCas = two_runs
    expected = counted(stored(rosCas, "/n"))
    moving = set(counted(stored(rosCas, "/n", run="a.bag")))
    done, wrong = threading.Event(), []
    with RosCassandra(cassandra.host, cassandra.port, keyspace=rosCas.keyspace) as other:

        def read():
            while not done.is_set():
                found = counted(stored(other, "/n"))
                others = (found - expected) + (expected - found)
                times = {t for t, _, _ in others}
                if len(times) > 1 or not moving.issuperset(others) or max(found.values()) > 2:
                    wrong.append(others)

        reader = threading.Thread(target=read)
        reader.start()
        rosCas.upkeep.setRuns("a.bag", nodeID="husky")
        done.set()
        reader.join()
    assert wrong == []


def test_names_of_messages_stay(fresh):
    with fresh() as rosCas:
        rosCas.addTopic("/s", key_format="manual", msg_type="std_msgs/String")
        for writer_id, node, names in ((5, "a", "xy"), (6, "b", "z"), (7, "c", "x")):
            run = Run(node, writer_id, "recording", f"run {node}")
            with rosCas.messageWriter(writer_id=writer_id, nodeID=node, run=run) as writer:
                connection = api_connection("/s", definition_of(String), "/node")
                handle = writer.connect(connection)
                for n, name in enumerate(names):
                    writer.write(handle, T0 * SEC, n, serialize(String(node + name)), name)
        rosCas.upkeep.setRuns("run a", nodeID="b")
        topic = rosCas.getTopic("/s")
        assert topic.getData("x", nodeID="b").data == "ax"
        assert sorted(row.name for row in topic.rows(nodeID="b")) == ["x", "y", "z"]
        assert [row.name for row in topic.rows(nodeID="a")] == []
        # A name that the robot has, too: both are versions of it.
        rosCas.upkeep.setRuns("run c", nodeID="b")
        texts = [row.message().data for row in topic.rows(nodeID="b") if row.name == "x"]
        assert sorted(texts) == ["ax", "cx"]


def test_runs_of_a_folder_and_what_is_refused(two_runs, tmp_path):
    rosCas = two_runs
    runs = rosCas.upkeep.setRuns(f"{tmp_path}/", labels={"site": "lab"})
    assert {run.name for run in runs} == {"a.bag", "b.bag"}
    assert all(run.public_labels == {"site": "lab"} for run in rosCas.runs())
    rosCas.upkeep.setRuns(str(tmp_path / "a.bag"), labels={"site": None})
    assert sorted(len(run.public_labels) for run in rosCas.runs()) == [0, 1]
    with pytest.raises(RunNotFound, match=r"a\.bag"):
        rosCas.upkeep.setRuns("a.bga", name="x")
    too_long = "n" * 300
    for wrong in (
        {"name": too_long},
        {"nodeID": too_long},
        {"labels": {"a": too_long}},
        {"labels": {"content": None}},
        {"labels": {"a": 1}},
    ):
        with pytest.raises(InvalidName):
            rosCas.upkeep.setRuns("a.bag", **wrong)
    with rosCas.messageWriter(writer_id=9, run=Run("", 9, "recording", "live")):
        with pytest.raises(SchemaConflict, match="run live goes on"):
            rosCas.upkeep.setRuns("live", name="x")


@pytest.mark.suite("test", "an import, a move, an import")
def test_a_file_that_is_imported_again_after_its_run_was_moved(fresh, tmp_path):
    with fresh() as rosCas:
        bag = write_bag(tmp_path / "a.bag", 0)
        writer = import_bag(rosCas, str(bag)).writer_id
        rosCas.upkeep.setRuns("a.bag", nodeID="husky")
        assert import_bag(rosCas, str(bag), nodeID="husky").writer_id == writer
        assert len(stored(rosCas, "/n")) == 40
        report = import_bag(rosCas, str(bag))
        assert report.writer_id != writer
        assert any("robot husky" in note for note in report.notes)
        assert len(stored(rosCas, "/n", run=writer)) == 40


@pytest.mark.suite("test", "two imports and a move")
def test_a_row_that_was_read_before_a_move_gives_its_bytes_after_it(two_runs):
    rows = list(two_runs.getTopic("/large").rows(run="a.bag", columns=lambda table: ()))
    two_runs.upkeep.setRuns("a.bag", nodeID="husky")
    assert [len(row.wire) > 2_000_000 for row in rows] == [True]


def test_the_verb(two_runs, cassandra, tmp_path, capsys):
    where = ("--host", cassandra.host, "--port", str(cassandra.port))
    where = (*where, "--keyspace", two_runs.keyspace)

    def call(*words):
        status = cassandra_bag.main(["runs", *words, *where])
        return status, capsys.readouterr().out

    words = ("--name", "corridor", "--node-id", "husky", "--label", "site=lab")
    status, out = call("set", str(tmp_path / "a.bag"), *words)
    assert status == 0
    assert [line.split()[:1] + line.split()[2:3] for line in out.splitlines()[1:]] == [
        ["corridor", "husky"]
    ]
    status, out = call("set", "corridor", "--remove-label", "site", "--json")
    assert (status, json.loads(out)[0]["labels"]) == (0, {})
    assert len(stored(two_runs, "/n", nodeID="husky")) == 40
    for wrong in (("set",), ("set", "corridor"), ("--node-id", "x"), ("set", "c", "--graph")):
        with pytest.raises(SystemExit):
            call(*wrong)
