# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""toArrow gives the messages of a topic in every format, lazily and with their columns chosen."""

from __future__ import annotations

import random
import struct
import time

import pyarrow as pa
import pytest
from geometry_msgs.msg import TransformStamped
from nodes.children import await_true
from std_msgs.msg import Header, String
from suites import FEW_FORMATS, sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import InvalidName
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.query.arrays.row_columns import RowColumns
from cassandra_ros.topics.row_reader import FollowingReader

T0 = 1_600_000_000 * SECOND_NS


def transforms(n):
    found = TFMessage()
    for child in range(n % 4):
        one = TransformStamped(child_frame_id=f"leg{child}")
        one.header.stamp = Stamp.from_ns(T0 + n)
        one.transform.translation.x = n + child / 4
        found.transforms.append(one)
    return found


def fill(rosCas, fmt, count=40):
    topic = rosCas.addTopic("/tf", fmt, msg_type="tf2_msgs/TFMessage", nodeID="r1")
    for n in range(count):
        topic.addData(transforms(n), key=Stamp.from_ns(T0 + n * SECOND_NS))
    rosCas.catalog.adder.close()
    return topic


@pytest.mark.parametrize("fmt", ["ros", "binary"])
def test_keys_in_the_messages_are_the_keys_of_whole_pages(rosCas, fmt):
    """Their rows hold the receive time, too."""
    topic = rosCas.addTopic(
        "/h", fmt, msg_type="std_msgs/Header", key_format="msg_part", key_part="stamp"
    )
    for n in range(120):
        topic.addData(Header(seq=n, stamp=Stamp.from_ns(T0 + n)))
    rosCas.catalog.adder.close()
    table = topic.toArrow().read_all()
    assert table["KEY"].cast(pa.int64()).to_pylist() == [T0 + n for n in range(120)]
    assert table["seq"].to_pylist() == list(range(120))


@pytest.mark.parametrize("fmt", sparing(sorted(FORMAT_NAMES), FEW_FORMATS))
def test_every_format_gives_the_same_table(rosCas, fmt):
    topic = fill(rosCas, fmt)
    reader = topic.toArrow()
    table = reader.read_all()
    assert table.schema.names == ["KEY", "NODE", "RUN", "transforms"]
    assert table["KEY"].cast(pa.int64()).to_pylist() == [T0 + n * SECOND_NS for n in range(40)]
    assert set(table["NODE"].to_pylist()) == {"r1"}
    for n, found in enumerate(table["transforms"].to_pylist()):
        children = [
            (each["child_frame_id"], each["transform"]["translation"]["x"]) for each in found
        ]
        assert children == [(f"leg{k}", n + k / 4) for k in range(n % 4)]
        assert all(each["header"]["stamp"].value == T0 + n for each in found)


@pytest.mark.parametrize("fmt", FEW_FORMATS)
def test_only_the_named_columns_come(rosCas, fmt):
    topic = fill(rosCas, fmt, 9)
    low, high = T0 + 2 * SECOND_NS, T0 + 5 * SECOND_NS
    names = ["KEY", "transforms.transform.translation.x"]
    table = topic.toArrow(names, low, high).read_all()
    inner = pa.struct([("translation", pa.struct([("x", pa.float64())]))])
    wanted = [
        ("KEY", pa.timestamp("ns")),
        ("transforms", pa.list_(pa.struct([("transform", inner)]))),
    ]
    assert table.schema.equals(pa.schema(wanted))
    assert table.num_rows == 4
    assert (
        topic.toArrow(["NODE"], where="transforms.child_frame_id = 'leg2'").read_all().num_rows == 2
    )


def test_an_unknown_column_is_refused(rosCas):
    with pytest.raises(InvalidName, match=r"transform.translatoin.*did you mean translation"):
        fill(rosCas, "ros", 1).toArrow(["transforms.transform.translatoin"])


def test_two_types_of_a_topic_are_united(rosCas):
    rosCas.addTopic("/x", "packed").addData(String("a"), key=1)
    rosCas.addTopic("/x", "packed").addData(String("b"), key=2)
    with rosCas.messageWriter(format="packed") as writer:
        handle = writer.connect(api_connection("/x", definition_of(Header), "/n"))
        writer.write(handle, 3, 1, serialize(Header(seq=7)))
    rosCas.catalog.adder.close()
    table = rosCas.getTopic("/x").toArrow().read_all().sort_by("KEY")
    assert table["data"].to_pylist() == ["a", "b", None]
    assert table["seq"].to_pylist() == [None, None, 7]


def test_messages_with_names_have_these_as_keys(rosCas):
    topic = rosCas.addTopic("/map", key_format="manual", msg_type="std_msgs/String")
    topic.addData(String("x"), key="kitchen")
    table = topic.toArrow().read_all()
    assert table["KEY"].to_pylist() == ["kitchen"]
    for name, count in [("kitchen", 1), ("cellar", 0), ("\ud800", 0), ("x" * 100_000, 0)]:
        assert topic.toArrow(where=("KEY = ?", [name])).read_all().num_rows == count
        assert len(topic.getArrays("data", where=("KEY = ?", [name]))["data"]) == count


def test_a_topic_without_a_type_has_no_rows(rosCas):
    topic = rosCas.addTopic("/new")
    assert topic.toArrow().read_all().num_rows == 0


def test_batches_are_read_when_they_are_taken(rosCas, monkeypatch):
    topic = fill(rosCas, "packed", 5)
    reads, read = [], FollowingReader.batches
    monkeypatch.setattr(FollowingReader, "batches", lambda *a: reads.append(a) or read(*a))
    reader = topic.toArrow()
    assert not reads
    assert reader.read_next_batch().num_rows == 5
    assert len(reads) == 1


NUMBERS = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"}
NUMBERS.update({"int64": "q", "uint64": "Q", "float32": "f", "float64": "d", "bool": "B"})
PAIRS = ("time", "duration")
KINDS = (*NUMBERS, *PAIRS)
EACH = [f"{kind} one_{kind}\n{kind}[] many_{kind}\n{kind}[2] two_{kind}\n" for kind in KINDS]
EVERYTHING = (
    "".join(EACH) + "string text\nt/In sub\n" + "=" * 80 + "\nMSG: t/In\nstring text\nbool b\n"
)
TEXTS = [b"", b"map", "ä".encode(), b"\xff", b"a\0b"]


def value(rng, kind):
    if kind in PAIRS:
        first = rng.randrange(2**31) if kind == "time" else rng.randrange(-5, 5)
        nanoseconds = rng.choice([0, 1, 999_999_999, 1_500_000_000])  # the last is unusual
        return struct.pack("<Ii" if kind == "time" else "<ii", first, nanoseconds)
    if kind == "bool":
        return bytes([rng.choice([0, 1, 1, 0, 2])])
    size = struct.calcsize(NUMBERS[kind])
    return rng.getrandbits(8 * size).to_bytes(size, "little")


def everything(n):
    rng = random.Random(n)
    parts = []
    for kind in KINDS:
        count = rng.choice([0, 1, 3, 20_000 if n == 3 else 2])
        parts.append(value(rng, kind))
        parts.append(struct.pack("<I", count) + b"".join(value(rng, kind) for _ in range(count)))
        parts += [value(rng, kind), value(rng, kind)]
    for _ in range(2):
        text = rng.choice(TEXTS)
        parts.append(struct.pack("<I", len(text)) + text)
    return b"".join(parts) + value(rng, "bool")


@pytest.mark.suite("all", "make test asks others of its kind")
def test_columns_of_format_ros_give_what_the_messages_give(rosCas, monkeypatch):
    """Also of messages of which a column does not hold the field, and of one with long arrays."""
    definition = parse_definition("t/Everything", EVERYTHING, None)
    for fmt in ("ros", "binary"):
        with rosCas.messageWriter(format=fmt, nodeID="r1", writer_id=5) as writer:
            handle = writer.connect(api_connection(f"/{fmt}", definition, "/x"))
            for n in range(60):
                writer.write(handle, T0 + n * SECOND_NS, n, everything(n))
    made, make = [], RowColumns.make
    monkeypatch.setattr(
        RowColumns, "make", lambda self, rows: made.append(len(rows)) or make(self, rows)
    )
    names = [field.name for field in definition.specs["t/Everything"].fields]
    for name in [*names, "sub.text", "one_int8 text many_bool"]:
        asked = ["KEY", "RUN", *name.split()]
        found = rosCas.getTopic("/ros").toArrow(asked).read_all()
        wanted = rosCas.getTopic("/binary").toArrow(asked).read_all()
        assert found.schema.equals(wanted.schema)
        assert repr(found.to_pydict()) == repr(wanted.to_pydict()), name
    assert sum(made) > 20 * len(names)


@pytest.mark.parametrize("fmt", ["binary", "packed", "ros"])
def test_fields_that_differ_by_case_stay_apart_in_all_definitions(rosCas, fmt):
    kinds = {
        1: ("t/A", "int32 Value\nstring value\n", struct.pack("<iI", 7, 1) + b"a"),
        2: (
            "t/B",
            "string value\nfloat64 VALUE\n",
            struct.pack("<I", 1) + b"b" + struct.pack("<d", 0.5),
        ),
    }
    with rosCas.messageWriter(format=fmt) as writer:
        for key, (name, text, data) in kinds.items():
            definition = parse_definition(name, text, None)
            writer.write(writer.connect(api_connection("/x", definition, "/n")), key, key, data)
    rows = rosCas.getTopic("/x").toArrow().read_all().sort_by("KEY").to_pylist()
    columns = {
        value: column
        for row in rows
        for column, value in row.items()
        if column not in ("KEY", "NODE", "RUN") and value is not None
    }
    assert set(columns) == {7, "a", "b", 0.5}
    assert columns["a"] == columns["b"]
    assert len(set(columns.values())) == 3


def test_the_definition_that_was_stored_first_keeps_its_columns(rosCas):
    topics = [f"/x{n}" for n in range(6)]

    def store(field, key):
        definition = parse_definition("t/A", f"int32 {field}\n", None)
        with rosCas.messageWriter(format="binary") as writer:
            for topic in topics:
                handle = writer.connect(api_connection(topic, definition, "/n"))
                writer.write(handle, key, key, struct.pack("<i", key))

    store("value", 1)
    first_sec = int(time.time())
    await_true(lambda: int(time.time()) > first_sec)  # the dates of tables are in seconds
    store("Value", 2)
    for topic in topics:
        table = rosCas.getTopic(topic).toArrow().read_all().sort_by("KEY")
        assert table["value"].to_pylist() == [1, None], topic
        assert table["Value_1"].to_pylist() == [None, 2], topic
