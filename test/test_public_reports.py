# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What users of rosbag, MCAP and of this package reported: who does what, and what he expects.

One short test for each situation, by the programs and classes that a user has. The tests of a room
go further: they try other formats, damages and places of the same kind.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import shutil
import sys

import numpy as np
import pytest
import rosbag
import rospy
from bag.test_partly_bad import mcap_of
from bag.truth import read_with_rosbag, string_connection, string_wire
from connection.test_fork import in_child
from nav_msgs.msg import Odometry
from nodes.children import await_true, start_client, start_node
from nodes.raw_publisher import RawPublisher, header_of
from nodes.test_player_windows import play  # noqa: F401
from playing.robots import Robot
from proxy import Proxy
from recording.test_spool import (  # noqa: F401
    STEPS,
    both_files_cut,
    first_missing,
    journal,
    page_of_the_definitions,
    waiting,
)
from std_msgs.msg import Bool, Float64, Int64, String, UInt64
from suites import OLD_DUCKDB
from topics.test_run_states import begin

from cassandra_ros import Bag, RosCassandra
from cassandra_ros.cli import cassandra_bag, local_cassandra, player, recorder
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.errors import ConnectionFailed, InvalidOption, TopicNotFound
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.keys import SECOND_NS as SEC
from cassandra_ros.local_server import LocalCluster
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.store.tables.registry import LossKind

T0 = 1_500_000_000 * SEC
STAMP = 1368021980238582676
"""A time whose nanoseconds no float has."""


def write_bag(path, topics=("/imu", "/odom"), count=10):
    """Write numbered texts, one a second, on one topic after the other."""
    path.parent.mkdir(exist_ok=True)
    with BagWriter(path, chunk_bytes=2000) as writer:
        numbers = [writer.connection(string_connection(topic)) for topic in topics]
        for n in range(count):
            writer.write(numbers[n % len(topics)], T0 + n * SEC, string_wire(f"{n:0100}"))
    return path


@pytest.fixture
def store(rosCas):
    """Five messages on /n of a run that is called as a bag, by the robot husky."""
    begin(rosCas, 7, "drive 1.bag", "import").close()
    return rosCas


# 1. Backups


@pytest.mark.parametrize("ending", ["bag", "mcap"])
def test_an_export_of_renamed_topics_and_two_robots_is_equal(call, tmp_path, ending):
    """He exports the whole store and verifies the file, as the page on backups says."""
    path, backup = write_bag(tmp_path / "drive.bag"), tmp_path / f"all.{ending}"
    for robot in ("husky", "jackal"):
        assert call("import", path, "--node-id", robot, "-q") == (0, "", "")
    assert call("rename", "/imu", "/imu/data")[0] == 0
    assert call("export", backup, "-q") == (0, "", "")
    status, out, err = call("verify", backup)
    assert (status, err) == (0, "")
    assert "equal: " in out and "20 messages" in out
    assert call("delete", "/odom", "--node-id", "jackal", "--end", "1500000001", "-y")[0] == 0
    status, out, _ = call("verify", backup)
    assert (status, "1 messages differ" in out) == (1, True)


# 2. Salvage


def test_salvage_goes_on_where_an_import_ended(call, rosCas, tmp_path):
    """A page of his bag is damaged. He types what the import says, and has each message once."""
    path = write_bag(tmp_path / "drive.bag", count=200)
    content = bytearray(path.read_bytes())
    middle = content.index(b"\x26\0\0\0\x04\0\0\0op=\x02", len(content) // 2)  # a message
    content[middle : middle + 160] = bytes(160)
    path.write_bytes(content)
    status, _, err = call("import", path)
    assert (status, "The same import with --salvage" in err) == (1, True), err
    first = sum(info.count for info in rosCas.info())
    assert 0 < first < 150
    status, _, err = call("import", path, "--salvage")
    assert (status, "before and after the damage" in err) == (1, True), err
    wires = [row.wire for topic in rosCas.getAllTopics() for row in topic.rows()]
    assert len(set(wires)) == len(wires) > 150
    assert string_wire(f"{199:0100}") in wires
    assert [run.name for run in rosCas.runs()] == ["drive.bag"]


# 3. Runs


def names_of(rosCas):
    return sorted((run.name, run.node, sum(run.stored.values())) for run in rosCas.runs())


def test_a_copy_under_another_name_is_the_same_run_and_keeps_its_name(call, rosCas, tmp_path):
    """He imports a copy of a bag that he has stored already."""
    path = write_bag(tmp_path / "first.bag")
    _, out, _ = call("import", path)
    assert "content" not in out
    (run,) = rosCas.runs()
    copy = tmp_path / "copy.bag"
    shutil.copy(path, copy)
    for again, text in ((copy, ", which keeps its name: each"), (path, f"({run.writer}): each")):
        status, out, _ = call("import", again)
        assert status == 0
        assert f"{again} has the content of run first.bag ({run.writer})" in out
        assert f"{text} message is stored once" in out
        assert names_of(rosCas) == [("first.bag", "", 10)]
    for name in (path, copy):
        with Bag(str(name), rosCas=rosCas) as bag:
            assert bag.get_message_count() == 10
    assert call("export", tmp_path / "out.bag", "--run", "copy.bag")[0] == 1
    call("import", copy)
    _, _, err = call("export", tmp_path / "out.bag", "--run", "copy.bag")
    assert "did you mean first.bag" in err


def test_the_same_bag_of_another_robot_is_a_second_run_and_says_so(call, rosCas, tmp_path):
    """He typed a wrong --node-id first, and wants to have only one of them."""
    path = write_bag(tmp_path / "run.bag")
    call("import", path, "--node-id", "husky")
    (first,) = rosCas.runs()
    status, out, _ = call("import", path, "--node-id", "jackal", "--json")
    (answer,) = json.loads(out)["files"]
    assert status == 0
    same, names = answer["notes"]
    assert f"also stored as run {first.writer} of robot husky, so each is there once" in same
    assert f"'cassandra_bag delete --run {first.writer}' deletes those" in same
    assert names.startswith("2 runs are called run.bag: ")
    assert names_of(rosCas) == [("run.bag", "husky", 10), ("run.bag", "jackal", 10)]
    assert call("delete", "--run", first.writer, "-y")[0] == 0
    assert names_of(rosCas) == [("run.bag", "jackal", 10)]


def test_two_files_of_one_name_are_two_runs_that_can_be_told_apart(call, rosCas, tmp_path):
    """Each of his robots writes a file that is called run.bag."""
    for node, count in (("husky", 10), ("jackal", 20)):
        path = write_bag(tmp_path / node / "run.bag", count=count)
        status, out, _ = call("import", path, "--node-id", node)
        assert status == 0
    runs = {run.node: run.writer for run in rosCas.runs()}
    assert f"2 runs are called run.bag: {runs['jackal']} of robot jackal (from {path})" in out
    assert f"--run {runs['jackal']} means this one alone" in out
    count = ("query", "SELECT count(*) FROM imu", "--output", "csv", "--run")
    _, out, err = call(*count, "run.bag")
    assert out.split() == ["count(*)", "15"]
    assert "2 runs are called run.bag: " in err and f"{runs['husky']} of robot husky" in err
    for name in (runs["jackal"], path):
        assert call(*count, name) == (0, "count(*)\r\n10\r\n", "")


# 4. What the player announces


def test_what_is_announced_of_an_event_is_what_is_played(rosCas, play):  # noqa: F811
    """He plays an event of 2 s of a store that has days, and topics without a message then."""
    with Robot(rosCas, 1, "r1") as robot:
        for t in (0, 5, 6, 86_400):
            robot.send("/tick", t, str(t))
        for t in (0, 86_400):
            robot.send("/rare", t, str(t))
    rosCas.addEvent("brake", T0 + 5 * SEC, T0 + 7 * SEC, nodeID="r1")
    heard, said = play(("/tick",), "--event", "brake", "-i")
    assert heard == {"/tick": ["5", "6"]}
    assert "playing 1 topic, 2.0 s\n" in said
    assert "played 2 messages of 1 topic" in said.splitlines()


# 5. Processes


def test_a_fork_connects_by_itself_or_says_what_to_do(rosCas, cassandra):
    """His DataLoader forks, and the workers read by the client that the parent has."""
    rosCas.addTopic("/imu").addData(String("x"), key=T0)

    def read(client):
        return [row.message().data for row in client.getTopic("/imu").rows()]

    def connect_and_read():
        with RosCassandra(cassandra.host, cassandra.port, keyspace=rosCas.keyspace) as mine:
            return read(mine)

    error = in_child(lambda: read(rosCas))  # it comes through pickle
    assert isinstance(error, ConnectionFailed)
    assert "is a fork of" in str(error) and "worker_init_fn" in str(error)
    assert in_child(connect_and_read) == ["x"]
    assert read(rosCas) == ["x"]


# 6. Options that are given twice


def test_each_exclusion_of_a_recorder_counts():
    """He leaves topics out with several -x."""
    line = ["-a", "-x", "/cam/image", "-x", ".*compressed", "-x", "/rosout"]
    parser = recorder.make_parser()
    options = recorder.read_options(parser, parser.parse_args(line))
    topics = ("/cam/image", "/cam/compressed", "/rosout", "/imu")
    assert [options.excludes(topic) for topic in topics] == [True, True, True, False]


# 7. Times


@pytest.fixture(scope="module")
def adder(roscore, cassandra, fresh):
    """Calls the service that adds messages, of a query server on a store."""
    with fresh() as store:
        where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", store.keyspace)
        words = ("__name:=adding", "_allow_writes:=true")
        with start_node(roscore, "query_server", *where, *words) as node:
            node.await_line("serving keyspace")
            with start_client(roscore) as client:
                yield functools.partial(client.call, "/adding/addData"), store


def test_a_stamp_in_yaml_is_stored_to_the_nanosecond(adder):
    """He adds a message with rosservice, and its stamp comes from another message."""
    add, store = adder
    fields = {"topic": "/goals", "type": "geometry_msgs/PoseStamped"}
    assert add(yaml=f"header: {{stamp: {STAMP}}}", **fields)["success"]
    ((_, goal),) = store.getTopic("/goals").items()
    assert goal.header.stamp.to_nsec() == STAMP


def test_milliseconds_as_start_are_refused(store, call):
    """He copies a time of JavaScript; as nanoseconds it is in 1970, and would mean everything."""
    status, out, err = call("cat", "/n", "--start", "1500000002500")
    assert (status, out) == (1, "")
    assert "milliseconds are written in seconds, 1500000002.500" in err


# 8. Bag


def test_a_bag_is_read_from_its_start_time_to_its_end_time(rosCas, call, tmp_path):
    """His script of rosbag reads by the ends of the bag, by topics, and by connections."""
    path = tmp_path / "odd.bag"
    with BagWriter(path) as writer:
        for n, topic in enumerate(("/imu", "imu", "/imu/", "/odd name")):
            number = writer.connection(string_connection(topic, callerid=f"/driver{n}"))
            writer.write(number, STAMP + n * 1001, string_wire(f"{n}"))
    assert call("import", path, "-q") == (0, "", "")
    with Bag(str(path), rosCas=rosCas) as bag, rosbag.Bag(str(path)) as truth:
        start, end = bag.get_start_time(), bag.get_end_time()
        for kind in (float, rospy.Time):
            assert [m.data for _, m, _ in bag.read_messages(None, kind(start), kind(end))] == [
                *("0", "1", "2", "3")
            ]
        for topics in ("/imu", ["imu", "/imu/"], "odd name", "/none"):
            read = [list(map(str, each)) for each in bag.read_messages(topics)]
            assert read == [list(map(str, each)) for each in truth.read_messages(topics)]
        headers = [connection.header for connection in bag._get_connections()]
        assert headers == [connection.header for connection in truth._get_connections()]


# 9. Definitions that others write

PART = f"{'=' * 80}\nMSG: other_msgs/Part\ntime at\nfloat32 value\n"
"""A type that no package here has."""


def import_one(call, tmp_path, wire, **fields):
    """Import a bag of one message; check that the store has it, and return what was said."""
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        number = writer.connection(string_connection("/t", **fields))
        writer.write(number, T0, wire)
    status, _, err = call("import", path, "--format", "ros", "-q")
    assert status == 0
    assert call("verify", path, "-q") == (0, "", "")
    assert call("export", tmp_path / "out.bag", "-q") == (0, "", "")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)
    return err


def test_a_type_that_is_defined_twice_is_read(call, rosCas, tmp_path):
    """His converter appends a type each time that it is used; rosbag reads it."""
    once = f"Part[] parts\nPart last\n{PART}"
    fields = {"type": "other_msgs/Whole", "message_definition": once + PART}
    fields["md5sum"] = parse_definition("other_msgs/Whole", once).md5sum
    assert import_one(call, tmp_path, bytes(4 + 8) + b"\0\0\x80?", **fields) == ""
    assert rosCas.getTopic("/t").getData(T0).last.value == 1.0


def test_a_wrong_md5sum_is_told_once_and_the_message_is_read(call, rosCas, tmp_path):
    """His driver states an md5sum by hand; rosbag warns and reads."""
    err = import_one(call, tmp_path, string_wire("hello"), md5sum="0" * 32)
    assert err.count("\n") == 1 and String._md5sum in err
    assert rosCas.getTopic("/t").getData(T0).data == "hello"


# 10. Files of which a part is bad


def test_a_bad_connection_is_named_and_all_others_are_imported(call, tmp_path):
    """A driver of his writes no md5sum; all other topics of the bag are right."""
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        each = [string_connection("/good"), string_connection("/bad", md5sum="")]
        for n, connection in enumerate(each):
            writer.write(writer.connection(connection), 10**18 + n, string_wire("x"))
    for options in ([], ["--salvage"]):
        status, out, err = call("import", path, *options)
        assert (status, err.count("\n")) == (1, 1)
        assert "1 messages of topic /bad are not stored: " in err and "states no md5sum" in err
        assert "1 message of 1 topic is in keyspace" in out
    assert call("import", path, "--topics", "/good", "-q") == (0, "", "")
    assert call("verify", path, "--topics", "/good")[0] == 0
    assert call("verify", path)[0] == 1


def test_all_but_the_messages_that_are_too_late_are_imported(call, tmp_path):
    """A clock of his was wrong: three messages of an MCAP are later than ROS 1 can say."""
    times = [T0, T0 + 1, 2**32 * SEC, 2**63, 2**64 - 1]
    status, out, err = call("import", mcap_of(tmp_path / "a.mcap", times=times))
    assert (status, err.count("\n")) == (1, 1)
    assert "3 messages of topic /late are not stored" in err and "2106" in err
    assert "42 messages of 2 topics are in keyspace" in out
    status, out, _ = call("verify", tmp_path / "a.mcap")
    assert (status, "3 messages differ" in out and "42 are equal" in out) == (1, True)


# 11. Types


def test_a_new_topic_has_the_type_of_its_message_whatever_the_master_remembers(adder, roscore):
    """He adds a String; another node has advertised an Int64 under that name."""
    add, store = adder
    wrong = {"type": "std_msgs/String", "yaml": "data: x"}
    with RawPublisher(roscore.uri, "/known", header_of(Int64)):
        answer = add(topic="/known", **wrong)
        assert answer["success"], answer["message"]
        assert not add(topic="/known2", key_text="noon", **wrong)["success"]
    (table,) = store.getTopic("/known").tables
    assert table.metadata.msg_type == "std_msgs/String"
    assert next(iter(store.getTopic("/known").items()))[1].data == "x"
    assert not store.existTopic("/known2")


@pytest.mark.suite("all", "playing/test_stream.py asks it without a node")
def test_a_topic_of_several_types_is_played_with_its_first(rosCas, play):  # noqa: F811
    """The type of a topic changed; the page says that the player takes the first."""
    with rosCas.messageWriter() as writer:
        for n, message in enumerate((String("text"), Int64(5))):
            connection = api_connection("/status", definition_of(type(message)), "/x")
            writer.write(writer.connect(connection), T0 + n, n, serialize(message))
    heard, said = play(("/status",), "-i")
    assert heard == {"/status": ["text"]}
    assert "only std_msgs/String" in said


# 12. SQL


@pytest.fixture(scope="module")
def early(fresh):
    """Topics i and f, one a second and 8.646 ms after the other."""
    with fresh() as store:
        for name, later in (("/i", 0), ("/f", 8_646_000)):
            topic = store.addTopic(name, msg_type="std_msgs/Int64", nodeID="r1")
            for n in range(3):
                topic.addData(Int64(n), key=T0 + n * SEC + later)
        yield store


@pytest.mark.parametrize(
    ("output", "expected"),
    [("table", "-0.008646"), ("csv", "-8646000"), ("json", "-8646000")],
)
def test_a_time_below_zero_is_printed_as_by_the_query_language(call, early, output, expected):
    """He subtracts the times of two topics."""
    statement = "SELECT i.KEY - f.KEY AS d FROM i JOIN f ON i.data = f.data WHERE i.data = 1"
    status, out, err = call("sql", statement, "--output", output, keyspace=early.keyspace)
    assert (status, err) == (0, "")
    assert expected in out and "day" not in out


def test_differences_of_times_can_be_computed_with(call, early):
    """He wants their mean, a part of them, and those that are larger than some time."""
    mean = "avg(f.KEY - i.KEY)"
    if OLD_DUCKDB:
        mean = "to_microseconds(CAST(avg(epoch_us(f.KEY - i.KEY)) AS BIGINT))"
    statement = f"""SELECT {mean} / 2 AS half, count(*) AS n FROM i JOIN f
        ON i.data = f.data WHERE f.KEY - i.KEY > INTERVAL 5 MILLISECOND"""
    status, out, _ = call("sql", statement, "--json", keyspace=early.keyspace)
    assert (status, json.loads(out)) == (0, [{"half": 4_323_000, "n": 3}])


def test_pivot_is_a_statement(call, early):
    """It reads only, as SELECT does."""
    words = ("sql", "PIVOT i ON data USING count(*) GROUP BY NODE", "--output", "csv")
    status, out, err = call(*words, keyspace=early.keyspace)
    assert (status, out, err) == (0, "NODE,0,1,2\r\nr1,1,1,1\r\n", "")


# 13. Values


def test_scalars_of_numpy_are_values(rosCas):
    """He takes the values of conditions, events and metadata from arrays."""
    switch, number = rosCas.addTopic("/b", msg_type="std_msgs/Bool"), rosCas.addTopic("/f")
    by_field = rosCas.addTopic("/k", key_format="msg_part", key_part="data")
    for n in range(4):
        switch.addData(Bool(n % 2 == 1), key=n)
        number.addData(Float64(n / 2), key=n)
        by_field.addData(Bool(n % 2 == 1))
    for value in (np.bool_(True), np.array(True), True):
        rows = rosCas.executeCQL("SELECT data FROM /b WHERE data = ?", [value])
        assert list(rows) == [(True,), (True,)]
        assert len(list(rosCas.sql("SELECT data FROM b WHERE data = ?", [value]))) == 2
        assert len(switch.getData(0, 9, where=("data = ?", [value]))) == 2
        assert by_field.getData(value).data is True
        event = rosCas.addEvent("bump", T0, values={"on": value}, labels={})
        assert event.values == {"on": True}
    for half in (np.float32(0.5), np.float64(0.5), np.float16(0.5)):
        for condition in ("data = ?", "data IN (?)"):
            rows = rosCas.executeCQL(f"SELECT data FROM /f WHERE {condition}", [half])
            assert list(rows) == [(0.5,)]
        assert list(rosCas.sql("SELECT data FROM f WHERE data = ?", [half])) == [(0.5,)]
        assert rosCas.addEvent("x", T0, values={"v": half}).values == {"v": 0.5}
    for one in (np.int8(1), np.uint64(1), np.int64(1)):
        assert list(rosCas.executeCQL("SELECT data FROM /f WHERE data = ?", [one])) == [(1.0,)]
        assert list(rosCas.sql("SELECT data FROM f WHERE data = ?", [one])) == [(1.0,)]
        assert rosCas.addEvent("x", T0, values={"v": [one]}).values == {"v": [1]}
        number.setMeta(seats=one)
        assert number.getMeta["seats"] == 1


# 14. and 15. The spool after a kill, and damage


@pytest.mark.suite("all", "it records for some seconds, to fill several files")
@pytest.mark.parametrize("damage", [page_of_the_definitions, both_files_cut, first_missing])
def test_what_damaged_files_of_a_spool_had_is_told(call, rosCas, journal, damage):  # noqa: F811
    """The recorder was killed with its machine: a page is empty, files are short or missing."""
    (run,) = journal.runs()
    files = sorted(run.glob("*.mcap"))
    damage(files[0], files[1], files[-1])
    status, out, err = call("spool", "drain", "-y", run.name, "--spool-dir", journal.path)
    assert (status, "messages are missing, " in err) == (1, True)
    stored = [topic.countTopicData() for topic in rosCas.getAllTopics()]
    lost = STEPS * 55 - sum(stored)
    assert lost > 0 and f"{lost} messages of the spool are lost" in out
    (row,) = rosCas.runs()
    assert sum(row.lost.values()) == lost
    losses = [loss for loss in rosCas.losses() if loss.kind == LossKind.SPOOL_DAMAGED]
    assert sum(loss.count for loss in losses) == lost
    assert {loss.topic for loss in losses} == {"/a", "/b"}


# 16. A quota


def test_only_what_is_not_copied_is_a_loss(call, rosCas, cassandra, keyspaces):
    """His robot makes room, and its home has all messages but the last ones."""
    with keyspaces.lend() as home, rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/n", definition_of(Int64), "/driver"))
        for n in range(14):
            if n == 10:
                writer.flush()
                place = f"{cassandra.host}:{cassandra.port}/{home}"
                assert call("copy", "--to", place, "-q") == (0, "", "")
            writer.write(handle, T0 + n, n, serialize(Int64(n)))
        writer.close()
        assert call("retention", "--max-size", "1", "--copied", "first", "-y")[0] == 0
    assert rosCas.getTopic("/n").countTopicData() == 0
    (loss,) = rosCas.losses()
    assert (loss.kind, loss.count) == (LossKind.NO_ROOM, 4)
    assert (loss.first_ns, loss.last_ns) == (T0 + 10, T0 + 13)


# 17. The words of a command


@pytest.mark.parametrize("order", [["-y", "RUN"], ["RUN", "-y"]])
def test_words_may_come_in_any_order(order):
    """He types -y before the run."""
    options = cassandra_bag.make_parser().parse_args(["spool", "drain", *order])
    assert (options.action, options.runs, options.yes) == ("drain", ["RUN"], True)


def test_an_event_may_be_called_as_an_option(store, cassandra, monkeypatch, capsys):
    """A button of his joystick is called -x."""
    monkeypatch.setenv("CASSANDRA_ROS_HOST", cassandra.host)
    monkeypatch.setenv("CASSANDRA_ROS_PORT", str(cassandra.port))
    monkeypatch.setenv("CASSANDRA_ROS_KEYSPACE", store.keyspace)
    assert cassandra_bag.main(["event", "add", "--start", "1500000000", "-q", "--", "-x"]) == 0
    (event,) = store.events("-x")
    assert cassandra_bag.main(["event", "delete", "--dry-run", "--json", "--", "-x"]) == 0
    assert json.loads(capsys.readouterr().out)["deleted"] == [event.key]
    assert cassandra_bag.main(["event", "delete", "-y", "--", "-x"]) == 0
    assert list(store.events()) == []


# 18. A recorder without a store


@pytest.mark.suite("all", "it starts recorders, whose store is away")
@pytest.mark.parametrize(
    ("host", "reason"),
    [("127.0.0.1", "no Cassandra answers at"), ("robot-store.invalid", "no host of this name")],
)
def test_without_a_store_a_recorder_records_and_says_so(
    roscore, cassandra, keyspace, call, rosCas, tmp_path, host, reason
):
    """His robot boots before its store, or he mistyped the host; he stores the rest elsewhere."""
    spool = tmp_path / "spool"
    with contextlib.ExitStack() as stack:
        numbers = stack.enter_context(RawPublisher(roscore.uri, "/n", header_of(UInt64)))
        proxy = stack.enter_context(Proxy(cassandra.host, cassandra.port))
        proxy.cut()
        words = ("--host", host, "--port", proxy.port, "--keyspace", keyspace)
        node = start_node(roscore, "recorder", "/n", *words, "--spool-dir", spool)
        child = stack.enter_context(node)
        warning = child.await_line(f"no store yet, messages wait in the spool {spool}: {reason}")
        assert host in warning and "local_cassandra start" in warning
        child.await_line("recording 1 topic")
        numbers.await_subscribers().publish(*(n.to_bytes(8, "little") for n in range(300)))
        client = stack.enter_context(start_client(roscore))
        await_true(lambda: client.call("/recorder/status")["spooled_messages"] == 300)
        assert child.end() == 0, child.output
    assert f"300 messages in the spool {spool}: the next recorder for this store" in child.output
    copied = tmp_path / "copied"
    shutil.copytree(spool, copied)
    status, _, err = call("spool", "drain", *os.listdir(spool), "--spool-dir", copied)
    assert (status, err) == (0, "")
    assert [message.data for _, message in rosCas.getTopic("/n").items()] == list(range(300))


# 19. Names that are not there


@pytest.mark.parametrize(
    "line",
    [
        ("query", "SELECT KEY FROM n WHERE NODE = 'huskey'"),
        ("query", "SELECT KEY FROM n", "--node-id", "huskey"),
        ("sql", "SELECT data FROM n WHERE NODE = 'huskey'"),
        ("cat", "/n", "--node-id", "huskey"),
        ("info", "--node-id", "huskey"),
        ("delete", "/n", "--node-id", "huskey", "-y"),
    ],
)
def test_an_unknown_robot_is_told_with_the_nearest(store, call, line):
    """He mistypes the name of a robot."""
    err = call(*line)[2]
    assert "is of robot 'huskey'; did you mean husky?" in err


@pytest.mark.parametrize("verb", ["query", "sql"])
def test_an_unknown_run_is_told_with_the_nearest(store, call, verb):
    """He mistypes the name of a run."""
    err = call(verb, "SELECT data FROM n WHERE RUN = 'drive.bag'")[2]
    assert "there is no run 'drive.bag' in keyspace" in err and "did you mean drive 1.bag?" in err


@pytest.mark.parametrize(
    "line",
    [
        ("query", "SELECT data FROM n WHERE EVENT 'brkae'"),
        ("sql", "SELECT data FROM n WHERE 'brkae' IN EVENT"),
        ("cat", "/n", "--event", "brkae"),
        ("event", "end", "brkae"),
        ("event", "delete", "-y", "brkae"),
    ],
)
def test_an_unknown_event_is_told_with_the_nearest(store, call, line):
    """He mistypes the name of an event."""
    store.addEvent("brake", T0)
    err = call(*line)[2]
    assert "there is no event 'brkae' in keyspace" in err and "did you mean brake?" in err


def test_a_place_where_no_robot_was_says_so(call, rosCas):
    """He gives a latitude and a longitude where metres are meant."""
    odometry = rosCas.addTopic("/odom", msg_type="nav_msgs/Odometry")
    for n in range(3):
        message = Odometry()
        message.header.frame_id, message.pose.pose.orientation.w = "odom", 1
        odometry.addData(message, key=T0 + n * SEC)
    status, _, err = call("query", "SELECT KEY FROM odom WHERE NEAR(42.37, -71.14, 20, 'odom')")
    assert "no robot was within 20 m of (42.37, -71.14) in frame odom" in err
    assert "no latitude and longitude" in err


# 20. Commands that are not what was meant


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("drive 1.bag", "it is the name of a run: --run 'drive 1.bag' (in Python run=)"),
        ("/data/drive 1.bag", "it is the name of a run: --run 'drive 1.bag' (in Python run=)"),
        ("husky", "it is a robot: --node-id husky (in Python nodeID=)"),
        ("other.bag", "a file is stored with 'cassandra_bag import'"),
        ("other.mcap", "a file is stored with 'cassandra_bag import'"),
        ("/m", "did you mean /n?"),
    ],
)
def test_a_name_that_is_no_topic_says_what_it_is(store, call, cassandra, monkeypatch, name, text):
    """He gives a file, a run or a robot where a topic is meant, as rosbag play takes a file."""
    with pytest.raises(TopicNotFound) as caught:
        store.getTopic(name)
    assert f"topic {name!r} is not stored" in str(caught.value) and text in str(caught.value)
    for words in (["info", name], ["rename", name, "/x"], ["delete", name, "-y"]):
        status, _, err = call(*words)
        assert (status, text in err) == (1, True), err
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", store.keyspace)
    monkeypatch.setattr(sys, "argv", ["player", *where, name])
    with pytest.raises(TopicNotFound, match="is not stored") as caught:
        player.main()
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("verb", "text"),
    [
        ("exprot", "there is no verb 'exprot': did you mean export?"),
        ("improt", "there is no verb 'improt': did you mean import?"),
        ("play", "there is no verb 'play'"),
    ],
)
def test_a_misspelt_verb_names_the_nearest(call, verb, text):
    """He mistypes a verb, and gets a line, not all verbs."""
    status, _, err = call(verb, "x")
    last = err.splitlines()[-1]
    assert (status, last.startswith(f"cassandra_bag: {text}")) == (2, True)
    assert len(last) < 100 and last.endswith("(see cassandra_bag --help)")


@pytest.mark.parametrize(
    "line",
    [
        "query SELECT a.py b.py FROM /n",
        "query select count(*) from /n --json",
        "sql SELECT NODE FROM n",
        "plot SELECT data FROM /n -o x.png",
    ],
)
def test_a_statement_without_quotes(store, call, line):
    """His shell makes words of a statement, and a star becomes names of files."""
    status, _, err = call(*line.split())
    assert (status, "put the statement in quotes" in err) == (2, True), err


def test_verify_of_an_exported_window_names_start_and_end(store, call, tmp_path):
    """He exports a time range and verifies the file."""
    window = ("--start", "1500000001", "--end", "1500000003")
    assert call("export", tmp_path / "w.bag", *window, "-q") == (0, "", "")
    status, out, _ = call("verify", tmp_path / "w.bag")
    assert (status, "compare that part: --start T --end T" in out) == (1, True)
    for options in ([], ["--content"]):
        assert call("verify", tmp_path / "w.bag", *window, *options, "-q") == (0, "", "")


def test_an_unknown_option_names_the_help_of_the_verb(call):
    """He types an option of another verb."""
    status, _, err = call("verify", "x.bag", "--follow")
    assert status == 2
    assert "unrecognized arguments: --follow" in err and "(see cassandra_bag verify --help)" in err


def test_an_event_is_ended_by_its_name_once(store, call):
    """He ends an event that has ended, and one of several of its name."""
    first = store.addEvent("brake", T0)
    status, out, _ = call("event", "end", "brake", "--end", "1500000002")
    assert (status, out) == (0, f"event brake is ended; its key is {first.key}\n")
    status, _, err = call("event", "end", "brake", "--end", "1500000003")
    assert status == 1
    assert "event 'brake' has ended already, at 2017-07-14T02:40:02.000Z" in err
    assert f"give its key: {first.key}" in err
    assert call("event", "end", first.key, "--end", "1500000004", "-q") == (0, "", "")
    keys = [store.addEvent("brake", T0 + n).key for n in (1, 2)]
    status, _, err = call("event", "end", "brake")
    assert status == 1
    which = "2 events 'brake' last; to set the end of one of them, give its key: "
    assert which + ", ".join(keys) in err
    mine = store.addEvent("brake", T0, nodeID="husky")
    assert call("event", "end", "brake", "--node-id", "jackal")[0] == 1
    assert call("event", "end", mine.key)[0] == 0
    assert "there is no event 'bump'" in call("event", "end", "bump")[2]


def test_a_run_that_goes_on_is_not_deleted_and_says_when_it_counts_as_ended(rosCas):
    """His program was killed; a moment later he writes its bag again, or deletes it."""
    with begin(rosCas, 8, "x"):
        with pytest.raises(InvalidOption, match=f"killed, try again in {STALE_SEC:.0f} s"):
            rosCas.upkeep.delete(run=8)


def test_another_address_of_the_local_cassandra_is_told(tmp_path, capsys):
    """He starts it with --port; the programs would look for it at the usual one."""
    local_cassandra._say_address(LocalCluster(tmp_path / "a"))
    assert capsys.readouterr().out == ""
    local_cassandra._say_address(LocalCluster(tmp_path / "b", host="127.0.0.5", port=9999))
    said = "programs find it with:\n  export CASSANDRA_ROS_HOST=127.0.0.5 CASSANDRA_ROS_PORT=9999\n"
    assert capsys.readouterr().out == said


def test_a_stored_topic_that_ros_cannot_name_is_remapped():
    """A topic of his MCAP has a blank, which no ROS name has."""
    words = strip_remappings(["/a", "/my topic:=/mine", "cam-1:=cam", "/scan:=/old", "-l"])
    selection = player.read_selection(player.make_parser().parse_args(words))
    assert selection.topics == ["/a"]
    assert selection.remap == {"/my topic": "/mine", "cam-1": "cam"}
    words = strip_remappings(["/my topic:=/mine"])
    assert player.read_selection(player.make_parser().parse_args(words)).topics is None


# 21. Output


@pytest.mark.parametrize(
    ("verb", "ending", "beginning"),
    [
        ("query", "csv", b"data\r\n"),
        ("query", "json", b"["),
        ("query", "parquet", b"PAR1"),
        ("sql", "csv", b"data\r\n"),
    ],
)
def test_the_ending_of_the_file_chooses_the_format(store, call, tmp_path, verb, ending, beginning):
    """He writes a result into x.csv, without --output."""
    path = tmp_path / f"x.{ending}"
    assert call(verb, "SELECT data FROM n", "-O", path) == (0, "", "")
    assert path.read_bytes().startswith(beginning)


def test_delete_of_a_run_prints_only_what_it_deletes(store, call):
    """His store has many topics, and the run had one."""
    for n in range(5):
        store.addTopic(f"/other{n}", msg_type="std_msgs/Int64").addData(Int64(n), key=T0)
    for options in (["--dry-run"], ["-y"]):
        status, out, _ = call("delete", "--run", "drive 1.bag", *options)
        assert status == 0
        assert [line.split()[0] for line in out.splitlines()] == ["topic", "/n", "5"]


def test_a_store_of_a_century_has_a_length_in_years(rosCas, call):
    """One of his clocks began in 1970, and another one is in 2100."""
    topic = rosCas.addTopic("/n", msg_type="std_msgs/Int64")
    for key in (5 * SEC, 4_102_444_800 * SEC):
        topic.addData(Int64(1), key=key)
    status, out, _ = call("info")
    assert status == 0
    assert re.search(r"duration: +130\.0 years \(4102444795s\)", out), out
