# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Indexes on topics that are being recorded, filled, truncated: no row is missed, none appears."""

from __future__ import annotations

import json
import os
import signal
import time

import pytest
from geometry_msgs.msg import TransformStamped, Vector3
from sensor_msgs.msg import Image, JointState, PointCloud
from std_msgs.msg import Float32, Float64, String, UInt8MultiArray
from suites import sparing
from tf2_msgs.msg import TFMessage
from topics.by_index import by_index, check, directory_rows, filled
from topics.clients import children
from topics.writing_process import T0, VALUES

from cassandra_ros.errors import InvalidName, InvalidOption, StoreUnavailable, TopicNotFound
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.index_field import MAX_ELEMENTS
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.rows import writer as writer_module
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.schema import TableListing
from cassandra_ros.topics import indexes

SEC = 10**9
NAN = float("nan")


def store(rosCas, name, messages, bucket_ns=SEC, step_ns=100_000_000, **options):
    """Store messages one after the other, as a recording that has ended."""
    with rosCas.messageWriter(**options) as writer:
        handle = writer.connect(
            api_connection(name, definition_of(type(messages[0])), "/w"), bucket_ns=bucket_ns
        )
        for number, message in enumerate(messages):
            writer.write(handle, T0 + number * step_ns, number, serialize(message))
    return rosCas.getTopic(name)


def texts(count):
    return [String(data=VALUES[number % len(VALUES)]) for number in range(count)]


def check_texts(rosCas, topic):
    return sum(check(rosCas, topic, "data", data, *VALUES))


def data(message):
    return [message.data]


def frames(message):
    return {transform.child_frame_id for transform in message.transforms}


@pytest.mark.suite("all", "it starts many programs")
def test_made_while_another_process_records(rosCas, cassandra, keyspace):
    topic = store(rosCas, "/t", texts(3000), step_ns=10_000_000)  # 30 buckets
    with children(1, cassandra, keyspace) as (child,):
        child.say("write", "values", "/t")
        assert child.answer() == {}
        time.sleep(0.5)
        compared, told = [], []

        def progress(done, total):
            told.append((done, total))
            # Seldom at last: while this reads, the child writes, and there is more to fill.
            if len(told) in (1, 13, 25, 49, 97, 193, 385):
                compared.append(check_texts(rosCas, topic))

        assert topic.createIndex("data", progress) >= 3000
        assert filled(rosCas, topic, "data")[0] >= 30
        for _ in range(3):
            time.sleep(0.5)
            compared.append(check_texts(rosCas, topic))
            topic.createIndex("data")
        assert len(compared) >= 6 and compared == sorted(compared)
        assert all(done <= total for done, total in told)
        child.say("end")
        ended = child.answer()
    assert ended["lost"] == 0 and ended["failure"] == ""
    # What the writer had open before the index was there is filled when it is closed.
    topic.createIndex("data")
    done, every = filled(rosCas, topic, "data")
    assert done == every
    assert check_texts(rosCas, topic) == topic.countTopicData() == 3000 + ended["stats_stored"]
    long = sum(row.odd for row in directory_rows(rosCas, topic.tables[0]))
    assert long == sum(len(message.data) == 2000 for _, message in topic.items())


@pytest.mark.suite("all", "it starts many programs")
def test_two_processes_make_the_same_index_at_once(rosCas, cassandra, keyspace):
    topic = store(rosCas, "/t", texts(1500), step_ns=10_000_000)
    with children(2, cassandra, keyspace) as pair:
        for child in pair:
            child.say("index", "/t", "data")
        answers = [child.answer() for child in pair]
    assert not any("error" in answer for answer in answers), answers
    assert sum(answer["filled"] for answer in answers) == 1500
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    (table,) = topic.tables
    assert dict(table.metadata.indexes) == {"data": "_ix0"}
    assert check_texts(rosCas, topic) == 1500
    done, every = filled(rosCas, topic, "data")
    assert done == every == 15


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_killed_in_the_middle_and_repeated(rosCas, cassandra, keyspace):
    topic = store(rosCas, "/t", texts(6000), step_ns=10_000_000)
    with children(1, cassandra, keyspace, ended_by=-signal.SIGKILL) as (child,):
        child.say("index", "/t", "data", "createIndex", 5)
        for bucket in range(1, 6):
            assert json.loads(child.hear())["done"] == 100 * bucket
        # It has filled the fifth bucket, and not marked it yet.
        child.process.kill()
        child.process.wait()
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    done, every = filled(rosCas, topic, "data")
    assert (done, every) == (4, 60)
    assert check_texts(rosCas, topic) == 6000
    assert topic.createIndex("data") == 5600
    assert filled(rosCas, topic, "data") == (every, every)
    assert check_texts(rosCas, topic) == 6000
    assert topic.createIndex("data") == 0


@pytest.mark.suite("all", "it starts many programs")
def test_removed_while_another_process_records(rosCas, cassandra, keyspace):
    topic = store(rosCas, "/t", texts(50))
    topic.createIndex("data")
    with children(1, cassandra, keyspace) as (child,):
        child.say("write", "values", "/t")
        child.answer()
        time.sleep(0.5)
        topic.removeIndex("data")
        time.sleep(0.5)
        assert topic.getMeta["indexes"] == []
        child.say("end")
        ended = child.answer()
    assert ended["lost"] == 0 and ended["failure"] == ""
    assert topic.countTopicData() == 50 + ended["stats_stored"]
    with pytest.raises(InvalidName, match="has no index on 'data'; it has none"):
        topic.removeIndex("data")
    # Its column is never used again: what is in it was written without being asked.
    topic.createIndex("data")
    assert dict(topic.tables[0].metadata.indexes) == {"data": "_ix1"}
    assert check_texts(rosCas, topic) == 50 + ended["stats_stored"]


@pytest.fixture
def unhurried(monkeypatch):
    """Writers do nothing by themselves with the buckets that they have open."""
    monkeypatch.setattr(writer_module, "HEARTBEAT_SEC", 3600.0)


def test_a_writer_in_this_process_takes_it_up_with_the_next_bucket(rosCas, unhurried):
    topic = store(rosCas, "/t", texts(5))
    writer = rosCas.messageWriter(writer_id=5)
    handle = writer.connect(api_connection("/t", definition_of(String), "/w"))
    wire = [serialize(message) for message in texts(40)]
    for number in range(20):
        writer.write(handle, T0 + SEC * 50 + number, number, wire[number])
    topic.createIndex("data")
    for number in range(20, 30):  # the same bucket
        writer.write(handle, T0 + SEC * 50 + number, number, wire[number])
    for number in range(30, 40):  # another one
        writer.write(handle, T0 + SEC * 60 + number, number, wire[number])
    writer.flush()
    rows = {row.bucket: row for row in directory_rows(rosCas, handle.table) if row.writer == 5}
    bucket = handle.table.bucket_of(T0)
    assert rows[bucket + 50].filled == frozenset()
    assert rows[bucket + 60].filled == {"_ix0"}
    assert check_texts(rosCas, topic) == 45
    writer.close()
    assert check_texts(rosCas, topic) == 45
    assert topic.createIndex("data") == 30
    assert check_texts(rosCas, topic) == 45


def test_an_import_that_is_repeated_fills_only_what_it_filled_before(rosCas, monkeypatch):
    again = {"writer_id": 77}
    topic = store(rosCas, "/t", texts(20), **again)
    topic.tables[0].metadata  # noqa: B018 - known without an index
    topic.createIndex("data")
    store(rosCas, "/t", texts(30), **again)  # three buckets, two of them known and filled
    assert filled(rosCas, topic, "data") == (3, 3)
    assert check_texts(rosCas, topic) == 30
    # A client that has not heard of the index takes the mark away before it writes.
    table, schema = topic.tables[0], rosCas.catalog.keyspace.schema
    listed = table.metadata
    topic.removeIndex("data")
    with schema.lock() as lock:
        schema.set_comment(table.name, listed, lock)
    old = TableListing({table.name: listed.with_(indexes={})})
    with monkeypatch.context() as deaf:  # a change that a server pushes may be late, and comes then
        deaf.setattr(schema, "listing", lambda *, fresh=False: old)
        store(rosCas, "/t", texts(10), **again)
    schema.tables(fresh=True)
    assert filled(rosCas, topic, "data") == (2, 3)


def test_deleting_meanwhile_leaves_the_bucket_to_the_next_time(rosCas):
    topic = store(rosCas, "/t", texts(30))

    def progress(done, total):
        if done == 10:
            assert topic.removeData(T0, T0 + 2) == 1

    assert topic.createIndex("data", progress) == 20
    assert filled(rosCas, topic, "data") == (2, 3)
    assert check_texts(rosCas, topic) == 29
    rows = rosCas.cassandra.execute(f'SELECT "_t" FROM {topic.tables[0].qualified}')
    assert len(rows) == 29


@pytest.mark.parametrize("applied", [True, False])
def test_a_bucket_is_marked_whose_transaction_has_no_answer(rosCas, monkeypatch, applied):
    topic = store(rosCas, "/t", texts(30))
    put, answers = Directory.put_recount, []

    def lost(*arguments):
        answers.append(len(answers) % 2 and put(*arguments))
        if len(answers) % 2:
            if applied:
                assert put(*arguments)
            raise StoreUnavailable("no answer")
        return answers[-1]

    monkeypatch.setattr(Directory, "put_recount", lost)
    assert topic.createIndex("data") == 30
    assert answers == [0, not applied] * 3
    assert filled(rosCas, topic, "data") == (3, 3)
    assert check_texts(rosCas, topic) == 30


def test_a_writer_that_died_is_filled_and_may_come_back(rosCas, unhurried, monkeypatch):
    writer = rosCas.messageWriter(writer_id=5)
    handle = writer.connect(api_connection("/t", definition_of(String), "/w"))
    wire = [serialize(message) for message in texts(20)]
    for number in range(10):
        writer.write(handle, T0 + number, number, wire[number])
    writer.flush()
    topic = rosCas.getTopic("/t")
    assert topic.createIndex("data") == 0
    monkeypatch.setattr(indexes, "STALE_SEC", -1.0)
    assert topic.createIndex("data") == 10
    (row,) = directory_rows(rosCas, handle.table)
    assert row.closed and row.filled == {"_ix0"} and (row.rows, row.odd) == (10, 2)
    assert check_texts(rosCas, topic) == 10
    # It only stood still, and goes on without the index in the bucket that it has open.
    (bucket,) = writer._rows._buckets.values()
    bucket.marked -= 100
    for number in range(10, 20):
        writer.write(handle, T0 + number, number, wire[number])
    writer.flush()
    assert directory_rows(rosCas, handle.table)[0].filled == frozenset()
    assert check_texts(rosCas, topic) == 20
    writer.close()
    assert check_texts(rosCas, topic) == 20


@pytest.mark.suite("test", "an index made, filled and dropped")
@pytest.mark.parametrize(
    "form",
    sparing([form for form in FORMAT_NAMES if not format_class(form).PACKED], kept=["ros"]),
)
def test_every_format(rosCas, form):
    numbers = [0.0, -0.0, NAN, 1.5, float("inf"), float("-inf"), 0.1, 1.5]
    names = [["a", "b"], ["b"], [], ["x" * 1100, "a"], ["a"] * 300]
    tfs = [TFMessage([TransformStamped(child_frame_id=name) for name in row]) for row in names]
    options = {"format": form, "step_ns": SEC // 3}
    made = {
        "/double": store(rosCas, "/double", [Float64(x) for x in numbers], **options),
        "/float": store(rosCas, "/float", [Float32(x) for x in numbers], **options),
        "/text": store(rosCas, "/text", texts(10), **options),
        "/tf": store(rosCas, "/tf", tfs, **options),
    }
    fields = {"/tf": "transforms.child_frame_id"}
    for name, topic in made.items():
        assert topic.createIndex(fields.get(name, "data")) == topic.countTopicData()
    # What comes now is indexed as it is stored, in buckets of its own.
    for name, messages in (("/double", [Float64(x) for x in numbers]), ("/tf", tfs)):
        topic = made[name]
        for number, message in enumerate(messages):
            topic.addData(message, key=T0 + SEC * 1000 * (number + 1))
    rosCas.catalog.adder.close()
    for name, topic in made.items():
        done, every = filled(rosCas, topic, fields.get(name, "data"))
        assert done == every
    for name in ("/double", "/float"):
        counts = check(rosCas, made[name], "data", data, 0.0, 1.5, float("inf"))
        assert counts == [n * (2 if name == "/double" else 1) for n in (2, 2, 1)]
    check_texts(rosCas, made["/text"])
    wanted = ("a", "b", "x" * 1100, "c")
    assert check(rosCas, made["/tf"], fields["/tf"], frames, *wanted) == [6, 4, 2, 0]
    assert [m.data for _, m in made["/text"].items()] == [m.data for m in texts(10)]


def test_a_message_that_one_of_three_indexes_cannot_hold_is_found(rosCas):
    fields = ["header.seq", "name", "position"]
    topic = rosCas.addTopic("/j", "binary", msg_type="sensor_msgs/JointState", index=fields)
    for number, names in enumerate([["a"], ["a"] * (MAX_ELEMENTS + 1), ["b"]]):
        topic.addData(JointState(name=names), key=T0 + number)
    rosCas.catalog.adder.close()
    found = rosCas.executeCQL("select KEY from /j where name CONTAINS 'a'")
    assert [key.ns for (key,) in found] == [T0, T0 + 1]


def test_large_messages_are_read_from_their_chunks(rosCas):
    topic = rosCas.addTopic("/big", msg_type="std_msgs/UInt8MultiArray")
    for number in range(4):
        msg = UInt8MultiArray(data=os.urandom(600_000 if number % 2 else 10))
        msg.layout.data_offset = number // 2
        topic.addData(msg, key=T0 + number)
    rosCas.catalog.adder.close()
    assert topic.createIndex("layout.data_offset") == 4
    offsets = ("layout.data_offset", lambda m: [m.layout.data_offset], 1)
    assert check(rosCas, topic, *offsets) == [2]
    # The long arrays are odd, the short ones in the index.
    assert topic.createIndex("data") == 4
    (row,) = directory_rows(rosCas, topic.tables[0])
    assert row.filled == {"_ix0", "_ix1"} and (row.rows, row.odd) == (4, 2)
    topic.addData(msg, key=T0 + 3600 * SEC)
    assert check(rosCas, topic, *offsets) == [3]


def test_a_message_whose_chunks_are_gone_is_odd(rosCas):
    topic = rosCas.addTopic("/big")
    topic.addData(UInt8MultiArray(data=bytes(600_000)), key=T0)
    rosCas.catalog.adder.close()
    (table,) = topic.tables
    rosCas.cassandra.execute(f'TRUNCATE {rosCas.keyspace}."{table.name}_c"')
    assert topic.createIndex("layout.data_offset") == 1
    assert directory_rows(rosCas, table)[0].odd == 1


@pytest.mark.suite("all", "make test asks others of its kind")
def test_several_indexes_of_one_topic(rosCas):
    names = [["a", "b"], ["b"], []]
    states = [
        JointState(name=names[n % 3], position=[float(n)] * (n % 3), velocity=[NAN] * (n % 2))
        for n in range(30)
    ]
    topic = store(rosCas, "/joints", states)
    fields = ["name", "position", "velocity", "header.seq"]
    for field in fields:
        assert topic.createIndex(field) == 30
    assert topic.getMeta["indexes"] == sorted(fields)
    (table,) = topic.tables
    assert dict(table.metadata.indexes) == {f: f"_ix{n}" for n, f in enumerate(fields)}
    topic = store(rosCas, "/joints", states, nodeID="other")
    position = ("position", lambda m: set(m.position), 4.0, 7.0, 8.0, 9.0)
    assert check(rosCas, topic, *position) == [2, 2, 2, 0]
    assert check(rosCas, topic, "name", lambda m: m.name, "b") == [40]
    topic.removeIndex("position")
    assert topic.getMeta["indexes"] == ["header.seq", "name", "velocity"]
    assert check(rosCas, topic, "name", lambda m: m.name, "b") == [40]


def test_with_the_topic(rosCas):
    topic = rosCas.addTopic("/v", msg_type="geometry_msgs/Vector3", index=["x", "y"])
    assert topic.getMeta["indexes"] == ["x", "y"]
    topic.addData(Vector3(1, 2, 3), key=T0)
    assert directory_rows(rosCas, topic.tables[0])[0].filled == {"_ix0", "_ix1"}
    assert len(by_index(rosCas, topic, "y", lambda m: [], [2.0])[2.0]) == 1
    # The missing ones of a stored topic.
    rosCas.addTopic("/v", index=["z", "x"])
    assert topic.getMeta["indexes"] == ["x", "y", "z"]
    assert check(rosCas, topic, "z", lambda m: [m.z], 3.0) == [1]
    # A type that comes later.
    later = rosCas.addTopic("/later", index=["data"])
    assert later.getMeta["indexes"] == ["data"]
    with pytest.raises(TopicNotFound, match="give index= to addTopic"):
        later.createIndex("data")
    later.addData(String(data="a"), key=T0)
    assert dict(later.tables[0].metadata.indexes) == {"data": "_ix0"}
    with pytest.raises(InvalidName, match="did you mean data"):
        rosCas.addTopic("/no", msg_type="std_msgs/String", index=["dat"])
    assert not rosCas.existTopic("/no")


def test_a_truncated_topic_keeps_its_indexes(rosCas):
    topic = store(rosCas, "/t", texts(20))
    topic.createIndex("data")
    topic.removeIndex("data")
    topic.createIndex("data")
    rosCas.truncateTopic("/t")
    (table,) = topic.tables
    assert dict(table.metadata.indexes) == {"data": "_ix1"} and table.metadata.next_shadow == 2
    shadows = [c for c in rosCas.catalog.keyspace.schema.columns(table.name) if c.startswith("_ix")]
    assert shadows == ["_ix1"]
    store(rosCas, "/t", texts(20))
    assert filled(rosCas, topic, "data") == (2, 2)
    assert check_texts(rosCas, topic) == 20


def test_another_definition_gets_the_indexes_that_it_can_have(rosCas):
    topic = store(rosCas, "/t", texts(10))
    topic.createIndex("data")
    store(rosCas, "/t", [Float64(x) for x in (1.0, 2.0, NAN)])
    store(rosCas, "/t", [Vector3(1, 2, 3)])
    by_type = {table.metadata.msg_type: table for table in topic.tables}
    assert dict(by_type["std_msgs/Float64"].metadata.indexes) == {"data": "_ix0"}
    assert dict(by_type["geometry_msgs/Vector3"].metadata.indexes) == {}
    (row,) = directory_rows(rosCas, by_type["std_msgs/Float64"])
    assert row.filled == {"_ix0"} and row.odd == 1
    assert topic.createIndex("z") == 1
    assert set(topic.getMeta["indexes"]) == {"data", "z"}
    # In another format, too.
    store(rosCas, "/t", texts(1), format="json")
    made = next(t for t in topic.tables if t.metadata.format == "json")
    assert dict(made.metadata.indexes) == {"data": "_ix0"}


def test_the_index_of_the_key(rosCas, monkeypatch):
    topic = rosCas.addTopic("/key", key_format="msg_part", key_part="data")
    # All of them in one bucket, whatever the time.
    monkeypatch.setattr(rosCas.catalog.adder, "_clock", lambda: T0)
    for text in ("a", "b", "x" * 2000, "a"):
        topic.addData(String(data=text))
    rosCas.catalog.adder.close()
    (row,) = directory_rows(rosCas, topic.tables[0])
    assert row.filled == {"_ix0"} and row.odd == 1
    assert check(rosCas, topic, "data", data, "a") == [2]
    with pytest.raises(InvalidOption, match="it is the key_part"):
        topic.removeIndex("data")
    # Rows that are not listed as filled: the back-fill goes through them.
    (table,) = topic.tables
    place = (table.name, row.node, row.bucket, row.writer)
    rosCas.catalog.keyspace.directory.mark(place, 0)
    rosCas.catalog.keyspace.directory.mark(place, 0, (), rosCas_totals(row), closed=True)
    assert topic.createIndex("data") == 4
    assert directory_rows(rosCas, table)[0].filled == {"_ix0"}
    assert topic.getData("b").data == "b"


def rosCas_totals(row):
    from cassandra_ros.store.tables.directory import BucketTotals

    return BucketTotals(row.rows, row.bytes, row.largest, row.t_min, row.t_max, row.odd)


def test_what_cannot_be_indexed_says_why(rosCas):
    topic = store(rosCas, "/tf", [TFMessage()])
    for field, hint in (
        ("transforms.child_frame", "did you mean transforms.child_frame_id"),
        ("transforms", "it is a message, name one of its fields"),
        ("child_frame_id", "did you mean transforms.child_frame_id"),
    ):
        with pytest.raises(InvalidName, match=hint):
            topic.createIndex(field)
    with pytest.raises(InvalidName, match="did you mean channels.name"):
        store(rosCas, "/cloud", [PointCloud()]).createIndex("channels.values")
    with pytest.raises(InvalidName, match="did you mean step, data"):
        store(rosCas, "/image", [Image()]).createIndex("datastep")
    topic.createIndex("transforms.child_frame_id")
    with pytest.raises(InvalidName, match="did you mean transforms.child_frame_id"):
        topic.removeIndex("transforms.child_frame")
    for key_format in ("hash", "manual"):
        named = rosCas.addTopic(f"/{key_format}", key_format=key_format, msg_type="std_msgs/String")
        with pytest.raises(InvalidOption, match="kept under names"):
            named.createIndex("data")
        with pytest.raises(InvalidOption, match="kept under names"):
            rosCas.addTopic("/n", key_format=key_format, msg_type="std_msgs/String", index=["data"])
    part = {"key_format": "msg_part", "key_part": "name"}
    joints = rosCas.addTopic("/joints", msg_type="sensor_msgs/JointState", **part)
    with pytest.raises(InvalidOption, match="whole arrays"):
        joints.createIndex("name")
    assert joints.tables[0].index_fields == {}


def test_of_other_keys(rosCas):
    """A key of the message's own time: rows have a column more."""
    topic = rosCas.addTopic(
        "/tf", msg_type="sensor_msgs/JointState", key_format="msg_part", key_part="header.stamp"
    )
    for number in range(10):
        state = JointState(name=["ab"[number % 2]])
        state.header.stamp.secs = 1000 + number
        topic.addData(state)
    rosCas.catalog.adder.close()
    assert topic.createIndex("name") == 10
    state.header.stamp.secs = 10**6
    topic.addData(state)
    assert check(rosCas, topic, "name", lambda m: m.name, "b") == [6]
    assert topic.getData(key=1003.0).name == ["b"]


def test_times_are_indexed(rosCas):
    states = [JointState() for _ in range(10)]
    for number, state in enumerate(states):
        state.header.stamp.secs = number // 2
        state.header.stamp.nsecs = 10**9 if number == 9 else 5
    topic = store(rosCas, "/s", states)
    topic.createIndex("header.stamp")
    stamps = ("header.stamp", lambda m: [m.header.stamp.to_nsec()], 3 * SEC + 5)
    assert check(rosCas, topic, *stamps) == [2]
    assert sum(row.odd for row in directory_rows(rosCas, topic.tables[0])) == 1
