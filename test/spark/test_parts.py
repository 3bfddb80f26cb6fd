# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The partitions of Spark hold each message once, with the values of toArrow; without Spark."""

from __future__ import annotations

import pickle
import struct
import sys

import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker
from messages.test_message_stacks import manyWires
from suites import search, sparing

from cassandra_ros import CassandraRosError
from cassandra_ros.client.spark import topic as spark_topic
from cassandra_ros.client.spark import topic_frame
from cassandra_ros.client.spark.part_plan import BucketRange, pack, plan_parts
from cassandra_ros.client.spark.part_reader import (
    FrameSelection,
    PartReader,
    StoreLogin,
    spark_batch,
    spark_schema,
)
from cassandra_ros.errors import (
    InvalidKey,
    InvalidOption,
    MissingDependency,
    RunNotFound,
    StoreUnavailable,
)
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.read import Whose
from cassandra_ros.store.rows import writer

T0 = 1_600_000_000 * SECOND_NS
FORMATS = ("packed", "ros", "json")


def store(
    ros_cas, topic, definition, wires, fmt="packed", node="r1", writer_id=1, step=SECOND_NS // 4
):
    """Store messages, some in each bucket of one second."""
    with ros_cas.messageWriter(nodeID=node, writer_id=writer_id, format=fmt) as writer:
        handle = writer.connect(api_connection(topic, definition, "/x"), bucket_ns=SECOND_NS)
        for n, wire in enumerate(wires):
            writer.write(handle, T0 + n * step, n, wire)


def login_of(ros_cas):
    place = ros_cas.cassandra
    return StoreLogin.read(place.hosts[0], place.port, ros_cas.keyspace, {})


def parts_of(ros_cas, name, start=None, end=None, nodes=None, run=None, part_bytes=1000):
    keyspace = ros_cas.catalog.keyspace
    tables = ros_cas.getTopic(name).tables
    whose = Whose(nodes, keyspace.runs.writers(run))
    return plan_parts(keyspace, tables, (start, end), whose, part_bytes, 10**9)


def read_parts(ros_cas, name, fields=None, where=None, part_bytes=1000, **bounds):
    """Return what all executors read, as a table, and the number of partitions."""
    selection = FrameSelection(name, fields, where, bounds.get("run"))
    schema = selection.reader(ros_cas.getTopic(name)).schema
    parts = parts_of(ros_cas, name, part_bytes=part_bytes, **bounds)
    reader = PartReader(login_of(ros_cas), selection, parts, schema)
    reader = pickle.loads(pickle.dumps(reader))  # noqa: S301 - as Spark sends it to executors
    batches = list(reader([pa.RecordBatch.from_pydict({"id": [n]}) for n in range(len(parts))]))
    for batch in batches:
        batch.validate(full=True)
    return pa.Table.from_batches(batches, spark_schema(schema)), len(parts)


def expected(ros_cas, name, *args, **options):
    reader = ros_cas.getTopic(name).toArrow(*args, **options)
    schema = spark_schema(reader.schema)
    return pa.Table.from_batches([spark_batch(batch, schema) for batch in reader], schema)


def rows(table):
    return sorted(map(repr, table.to_pylist()))


bucket = st.tuples(st.integers(0, 30), st.sampled_from([1, 2, 7]), st.integers(0, 50))


@given(
    robots=st.dictionaries(st.sampled_from(["", "a", "b"]), st.lists(bucket, min_size=1)),
    part_bytes=st.integers(1, 200),
)
def test_each_time_of_a_bucket_is_in_one_part(robots, part_bytes):
    buckets = {
        node: [BucketRange(n * length, (n + 1) * length - 1, size) for n, length, size in listed]
        for node, listed in robots.items()
    }
    parts = pack(buckets, part_bytes)
    times = [(p.node, t) for part in parts for p in part for t in range(p.low, p.high + 1)]
    assert len(times) == len(set(times))
    for node, listed in buckets.items():
        assert {(node, t) for b in listed for t in range(b.low, b.high + 1)} <= set(times)
    assert all(parts)
    assert all(len({piece.node for piece in part}) == len(part) for part in parts)


def test_parts_are_no_larger_than_asked_for():
    buckets = {node: [BucketRange(n, n, 10) for n in range(100)] for node in "ab"}
    parts = pack(buckets, 35)
    assert [sum(p.high - p.low + 1 for p in part) for part in parts] == [3] * 66 + [2]
    assert len(parts[33]) == 2  # the last of one robot, and the first of the other


@search(24, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 2**32),
    fmt=st.sampled_from(FORMATS),
    part_bytes=st.sampled_from([1, 2000, 10**6]),
)
def test_parts_hold_what_toArrow_gives(fresh, seed, fmt, part_bytes):
    definition = parse_definition(*DefinitionMaker(seed).make())
    wires = manyWires(definition, seed)[:40]
    with fresh() as ros_cas:
        store(ros_cas, "/a", definition, wires, fmt)
        store(ros_cas, "/a", definition, wires[:9], fmt, "", 2)
        table, count = read_parts(ros_cas, "/a", part_bytes=part_bytes)
        assert table.num_rows == len(wires) + len(wires[:9])
        # Ten messages with bytes are in three buckets or more.
        assert count > 1 or part_bytes > 1 or sum(map(bool, wires)) < 10
        same = rows(table) == rows(expected(ros_cas, "/a"))
    assert same  # a comparison of such texts by pytest would take gigabytes


TYPES = "uint8 a\nuint16 b\nuint32 c\nuint64 d\nuint64[] e\nuint8[] f\ntime t\nduration w\n"
TYPES += "float64 x\nIn[] s\n" + "=" * 80 + "\nMSG: t/In\nuint32 v\nfloat32 y\ntime[2] z\n"
LAST_SEC = 2**32 - 1


def typed(n):
    top = 2**64 - 1
    wire = struct.pack("<BHIQIQQ", 255, 65535, 2**32 - 1, top, 2, top, n)
    wire += struct.pack("<I3sIIii", 3, b"\xff\0\x01", LAST_SEC, 999_999_999, -(2**31), 1)
    return wire + struct.pack("<dIIfIIII", n / 3, 1, 2**32 - 1, 0.5, 1, 2, LAST_SEC, 3)


@pytest.fixture(scope="module")
def stored(fresh):
    definition = parse_definition("t/Numbers", TYPES, None)
    other = parse_definition("t/Other", "float64 x\nstring said\n", None)
    with fresh() as ros_cas:
        for name, fmt in (("/numbers", "packed"), ("/columns", "ros")):
            for node, writer_id in (("r1", 1), ("r2", 2), ("", 3)):
                wires = [typed(n) for n in range(50)]
                store(ros_cas, name, definition, wires, fmt, node, writer_id)
        wires = [struct.pack("<dI2s", n, 2, b"hi") for n in range(7)]
        store(ros_cas, "/numbers", other, wires, "binary", "r2", 4, step=3 * SECOND_NS)
        ros_cas.addTopic("/maps", "ros", msg_type="std_msgs/String", key_format="manual")
        ros_cas.addTopic("/bare", "ros", msg_type="std_msgs/String")
        yield ros_cas


@pytest.mark.parametrize("part_bytes", sparing([1, 500, 10**9], kept=[500, 10**9]))
@pytest.mark.parametrize("name", ["/numbers", "/columns"])
def test_numbers_and_times_are_exact(stored, name, part_bytes):
    table, count = read_parts(stored, name, part_bytes=part_bytes)
    assert rows(table) == rows(expected(stored, name))
    assert (count == 1) == (part_bytes == 10**9)
    found = next(row for row in table.to_pylist() if row["d"] is not None)
    assert (found["a"], found["b"], found["c"]) == (255, 65535, 2**32 - 1)
    assert found["d"] == found["e"][0] == 2**64 - 1
    assert found["f"] == b"\xff\0\x01"
    assert found["t"] == LAST_SEC * SECOND_NS + 999_999_999
    assert found["w"] == -(2**31) * SECOND_NS + 1
    times = [SECOND_NS + 2, LAST_SEC * SECOND_NS + 3]
    assert found["s"] == [{"v": 2**32 - 1, "y": 0.5, "z": times}]


BOUNDS = [
    {},
    {"nodes": ("r1",)},
    {"nodes": ("r2", "")},
    {"nodes": ()},
    {"nodes": ("absent",)},
    {"start": T0 + 1, "end": T0 + 3 * SECOND_NS},
    {"start": "2020-09-13T12:26:41Z"},
    {"end": T0 - 1},
    {"run": 2, "start": T0 + SECOND_NS // 2},
    {"run": 4, "nodes": ("r1",)},
]
WHERES = [None, "x > 3 AND x < 9", ("x = ?", [2.0]), "d > 1 AND NOT x < 15"]


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("bounds", BOUNDS)
def test_what_is_pushed_is_what_a_filter_leaves(stored, bounds):
    """Times, robots, runs and conditions that the executors ask for, against those of toArrow."""
    fields = ["KEY", "NODE", "RUN", "x", "s.v"]
    nodes = bounds.get("nodes", (None,))
    ends = (bounds.get("start", 0), bounds.get("end", "2100-01-01"))
    for where in WHERES:
        table, _ = read_parts(stored, "/numbers", fields, where, part_bytes=300, **bounds)
        every = [
            expected(stored, "/numbers", fields, *ends, where, node, bounds.get("run"))
            for node in nodes
        ]
        assert rows(table) == sorted(row for each in every for row in rows(each))
        assert table.column_names == [*fields[:4], "s"]


@pytest.mark.parametrize("fmt", FORMATS)
def test_messages_of_buckets_that_are_written_to_are_read(rosCas, monkeypatch, fmt):
    """The directory has no number of their messages before the first heartbeat."""
    monkeypatch.setattr(writer, "HEARTBEAT_SEC", 1e9)
    definition = parse_definition("t/One", "float64 x\n", None)
    with rosCas.messageWriter(nodeID="r1", writer_id=1, format=fmt) as recorder:
        handle = recorder.connect(api_connection("/a", definition, "/x"), bucket_ns=SECOND_NS)
        for number in range(12):
            recorder.write(handle, T0 + number * SECOND_NS // 4, number, struct.pack("<d", number))
            if number % 5 == 4:
                recorder.flush()
        recorder.flush()
        (table,) = rosCas.getTopic("/a").tables
        rows_now = rosCas.catalog.keyspace.directory.find(table.name, "r1", table.bucket_of(T0))
        assert [row.closed for row in rows_now] == [False]
        while_open, _ = read_parts(rosCas, "/a")
        assert while_open["x"].to_pylist() == list(range(12))
        some, _ = read_parts(rosCas, "/a", start=T0 + 2 * SECOND_NS)
        assert some["x"].to_pylist() == list(range(8, 12))
    closed, _ = read_parts(rosCas, "/a")
    assert rows(closed) == rows(while_open) == rows(expected(rosCas, "/a"))


def test_large_messages(rosCas):
    definition = parse_definition("t/Large", "uint8[] data\n", None)
    wires = [(3_000_000).to_bytes(4, "little") + bytes([n]) * 3_000_000 for n in range(4)]
    store(rosCas, "/camera", definition, wires, "packed")
    table, count = read_parts(rosCas, "/camera")
    assert sorted(table["data"].to_pylist()) == [bytes([n]) * 3_000_000 for n in range(4)]


def test_names_instead_of_times(stored):
    from std_msgs.msg import String

    topic = stored.getTopic("/maps")
    for name in ("hall", "kitchen"):
        topic.addData(String(name.upper()), key=name)
    table, count = read_parts(stored, "/maps")
    assert count == 1
    assert sorted(zip(*table.select(["KEY", "data"]).to_pydict().values())) == [
        ("hall", "HALL"),
        ("kitchen", "KITCHEN"),
    ]
    with pytest.raises(InvalidKey, match="names"):
        parts_of(stored, "/maps", start=T0)


def test_a_topic_without_messages_has_columns(stored):
    table, count = read_parts(stored, "/bare")
    assert (count, table.num_rows, table.column_names) == (0, 0, ["KEY", "NODE", "RUN", "data"])


@pytest.mark.parametrize(
    ("bounds", "error"),
    [
        ({"start": "2300-01-01"}, InvalidKey),
        ({"end": -1}, InvalidKey),
        ({"start": "soon"}, InvalidKey),
        ({"start": 1_600_000_000}, InvalidKey),
        ({"run": "absent"}, RunNotFound),
    ],
)
def test_bounds_that_cannot_be(stored, bounds, error):
    with pytest.raises(error):
        parts_of(stored, "/numbers", **bounds)


def test_another_type_in_the_meantime(rosCas):
    first = parse_definition("t/One", "float64 x\n", None)
    store(rosCas, "/a", first, [bytes(8)])
    selection = FrameSelection("/a", None, None, None)
    schema = selection.reader(rosCas.getTopic("/a")).schema
    reader = PartReader(login_of(rosCas), selection, parts_of(rosCas, "/a"), schema)
    store(rosCas, "/a", parse_definition("t/Two", "int8 y\n", None), [bytes(1)], writer_id=2)
    with pytest.raises(StoreUnavailable, match="make it anew"):
        list(reader([pa.RecordBatch.from_pydict({"id": [0]})]))


def test_no_password_is_shown():
    phrase = "1-2-3-4-5"
    login = StoreLogin.read("10.0.0.1", None, None, {"username": "ann", "password": phrase})
    assert (login.keyspace, login.port, login.username) == ("ros", 9042, "ann")
    assert login.password == phrase
    assert phrase not in repr(login) + str(vars(PartReader(login, None, [], None)))


@pytest.mark.parametrize(
    ("option", "text"), [("ssl_context", "cqlshrc"), ("clock", "username, password")]
)
def test_options_that_executors_cannot_have(option, text):
    with pytest.raises(InvalidOption, match=text):
        StoreLogin.read(None, None, None, {option: object()})


def test_the_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyspark", None)
    monkeypatch.setattr(topic_frame, "_TOO_NEW", (9, 9))  # as in Python 3.8 to 3.11
    with pytest.raises(MissingDependency, match=r"(?s)pyspark.*requirements/spark\.txt") as caught:
        spark_topic(None, "/imu")
    assert isinstance(caught.value, CassandraRosError)


def test_a_new_python_is_named(monkeypatch):
    monkeypatch.setattr(topic_frame, "_TOO_NEW", (3, 8))
    with pytest.raises(MissingDependency, match=r"Python 3\.8 to 3\.11"):
        spark_topic(None, "/imu")
