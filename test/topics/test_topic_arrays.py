# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""getArrays and toDataFrame of topics in a real Cassandra."""

from __future__ import annotations

import io
import math

import numpy as np
import pandas
import pytest
from geometry_msgs.msg import Twist, Vector3
from std_msgs.msg import Int64, String

from cassandra_ros import Stamp
from cassandra_ros.errors import InvalidKey, InvalidQuery
from cassandra_ros.messages.classes import message_class
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.query.arrays import batch, table_values

T = 1_400_000_000_123_456_789
TEXT = (
    "uint64 big\nint64 low\nfloat32 small\nfloat64 wide\nbool yes\ntime at\nduration long\n"
    "string word\nuint8[] raw\nfloat64[3] pair\nint16[] some\npkg/E[] parts\n"
    + "=" * 80
    + "\nMSG: pkg/E\nstring name\nfloat64 x\nuint64 n\n"
)
KINDS = parse_definition("pkg/Kinds", TEXT, None)


def kinds(n):
    message = message_class(KINDS)()
    message.big, message.low = 2**64 - 1 - n, -(2**63) + n
    message.small = [math.nan, math.inf, 0.1, -0.0][n % 4]
    message.wide = [1e300, -math.inf, math.nan, 0.1][n % 4]
    message.yes = n % 2 == 0
    message.at.secs, message.at.nsecs = 1_400_000_000 + n, 123_456_789
    message.long.secs, message.long.nsecs = -n, 1
    message.word = ["", "Zoë ☃", "a,b"][n % 3]
    message.raw, message.pair, message.some = bytes(range(n)), [n, n / 8, -n], [n] * (n % 3)
    for i in range(n % 3):
        part = message_class(parse_definition("pkg/E", "string name\nfloat64 x\nuint64 n", None))()
        part.name, part.x, part.n = f"part{i}", n + i / 4, 2**64 - 1 - i
        message.parts.append(part)
    return message


def store(rosCas, topic, messages, node="", **options):
    """Write messages at T, T + 1, …"""
    with rosCas.messageWriter(nodeID=node, **options) as writer:
        for n, message in enumerate(messages):
            header = {"type": message._type, "md5sum": message._md5sum, "topic": topic}
            header["message_definition"] = message._full_text
            wire = io.BytesIO()
            message.serialize(wire)
            handle = writer.connect(live_connection(topic, header))
            writer.write(handle, T + n, n, wire.getvalue())
    return rosCas.getTopic(topic)


def test_what_every_format_gives(rosCas):
    """Values, types and order of a DataFrame, beside the messages that were stored."""
    messages = [kinds(n) for n in range(40)]
    for fmt in FORMAT_NAMES:
        topic = store(rosCas, f"/{fmt}", messages, format=fmt)
        frame = topic.toDataFrame()
        assert frame.index.name == "KEY"
        assert frame.index.dtype == "datetime64[ns]"
        assert [key.value for key in frame.index] == list(range(T, T + 40))
        assert {name: str(kind) for name, kind in frame.dtypes.items()} == {
            "big": "uint64",
            "low": "int64",
            "small": "float32",
            "wide": "float64",
            "yes": "bool",
            "at": "datetime64[ns]",
            "long": "timedelta64[ns]",
            **dict.fromkeys(("word", "raw", "pair", "some"), "object"),
            **dict.fromkeys(("parts.name", "parts.x", "parts.n"), "object"),
        }
        for (_, line), message in zip(frame.iterrows(), messages):
            assert (line.big, line.low, line.yes) == (message.big, message.low, message.yes)
            assert np.float32(line.small).tobytes() == np.float32(message.small).tobytes()
            assert np.float64(line.wide).tobytes() == np.float64(message.wide).tobytes()
            assert line["at"].value == message.at.to_nsec()
            assert line.long.value == message.long.to_nsec()
            assert (line.word, line.raw.tobytes()) == (message.word, message.raw)
            assert (line.pair.tolist(), line.some.tolist()) == (message.pair, message.some)
            assert line["parts.name"].tolist() == [part.name for part in message.parts]
            assert line["parts.n"].tolist() == [part.n for part in message.parts]
            assert line["parts.n"].dtype == np.uint64


@pytest.mark.parametrize("fmt", ["ros", "json"])
def test_rows_of_elements(rosCas, fmt):
    """The same as the statement, with and without a condition on the elements."""
    topic = store(rosCas, "/kinds", [kinds(n) for n in range(20)], format=fmt)
    fields = ["KEY", "parts.name", "parts.n", "low"]
    for where, params in [
        (None, []),
        ("parts.name = 'part1'", []),
        ("parts.x > ? AND low < 0", [10]),
        ("parts.name = ? OR KEY < ?", ["part1", T + 8]),
        ("low > ?", [-(2**63) + 15]),
    ]:
        statement = f"SELECT {', '.join(fields)} FROM /kinds" + (f" WHERE {where}" if where else "")
        rows = rosCas.executeCQL(statement, params)
        found = topic.getArrays(fields, where=None if where is None else (where, params))
        assert found["parts.n"].dtype == np.uint64
        lines = list(zip(*(array.tolist() for array in found.values())))
        assert lines == [(row[0].ns, *row[1:]) for row in rows]
        assert lines


def test_stretches_nodes_and_conditions(rosCas):
    numbers = [Int64(n) for n in range(10)]
    topic = store(rosCas, "/n", numbers, "r1", format="ros")
    store(rosCas, "/n", numbers[:5], "r2", format="ros")

    def data(*arguments, **options):
        return topic.getArrays("data", *arguments, **options)["data"].tolist()

    assert data() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 6, 7, 8, 9]
    assert topic.getArrays("NODE")["NODE"].tolist()[:3] == ["r1", "r2", "r1"]
    assert data(nodeID="r2") == [0, 1, 2, 3, 4]
    assert data(T + 8) == [8, 9]
    assert data(None, Stamp.from_ns(T + 1)) == [0, 0, 1, 1]
    assert data(T + 3, T + 4, "data != 3", "r1") == [4]
    assert data(where=("data in ?", [[2, 9]])) == [2, 2, 9]
    assert data(where="data = 77") == []
    assert topic.getArrays("data", where="data = 77")["data"].dtype == np.int64
    assert topic.toDataFrame("data", T + 100).shape == (0, 1)
    assert topic.toDataFrame("data", T + 100).index.dtype == "datetime64[ns]"
    with pytest.raises(InvalidQuery, match="did you mean data"):
        topic.toDataFrame(["date"])
    with pytest.raises(InvalidQuery, match="did you mean data"):
        data(where="date = 1")
    with pytest.raises(InvalidKey):
        data("yesterday")


@pytest.mark.parametrize("fmt", ["packed", "ros", "binary"])
def test_lengths_of_arrays_of_all_that_is_read(rosCas, monkeypatch, fmt):
    """Two dimensions where all that is returned has one length, in however many batches."""
    monkeypatch.setattr(batch, "ROW_BATCH_MESSAGES", 16)
    monkeypatch.setattr(table_values, "OTHER_MESSAGES", 16)
    monkeypatch.setattr(table_values, "STACKED_MESSAGES", 16)
    definition = parse_definition("pkg/Scan", "float32[] ranges\nfloat32[] intensities", None)
    scans = [message_class(definition)(ranges=[n] * (4 + n // 40)) for n in range(60)]
    topic = store(rosCas, "/scan", scans[:40], "r1", format=fmt)
    store(rosCas, "/scan", scans[40:], "r2", format=fmt)
    for options, numbers, length in [
        ({"nodeID": "r1"}, range(40), 4),
        ({"nodeID": "r2"}, range(40, 60), 5),
        ({"where": "ranges[0] < 33"}, range(33), 4),
        ({"where": "len(ranges) = 5"}, range(40, 60), 5),
    ]:
        found = topic.getArrays(["ranges", "intensities"], **options)
        assert found["ranges"].dtype == found["intensities"].dtype == np.float32
        assert sorted(found["ranges"].tolist()) == [[n] * length for n in numbers]
        assert found["intensities"].shape == (len(numbers), 0)
        frame = topic.toDataFrame(["ranges"], **options)
        assert sorted(cell.tolist() for cell in frame.ranges) == [[n] * length for n in numbers]
    found = topic.getArrays(["ranges", "intensities"])
    assert (found["ranges"].shape, found["ranges"].dtype) == ((60,), object)
    assert sorted(map(list, found["ranges"])) == [scan.ranges for scan in scans]
    assert found["intensities"].shape == (60, 0)
    assert topic.getArrays("ranges", where="ranges[0] > 99")["ranges"].shape == (0,)


def test_what_is_missing_in_a_frame(rosCas):
    """Integers stay integers where another definition of the topic lacks them."""
    topic = store(rosCas, "/x", [kinds(1), kinds(2)], format="ros")
    store(rosCas, "/x", [Int64(5)], format="ros")
    frame = topic.toDataFrame(
        ["big", "small", "yes", "at", "long", "word", "some[1]", "pair", "data"]
    )
    assert {name: str(kind) for name, kind in frame.dtypes.items()} == {
        "big": "UInt64",
        "small": "float32",
        "yes": "boolean",
        "at": "datetime64[ns]",
        "long": "timedelta64[ns]",
        "word": "object",
        "some[1]": "Int16",
        "pair": "object",
        "data": "Int64",
    }
    frame = frame.sort_values("data", na_position="first")
    assert frame.big.tolist() == [2**64 - 2, 2**64 - 3, pandas.NA]
    assert frame["some[1]"].tolist() == [pandas.NA, 2, pandas.NA]
    assert frame.data.tolist() == [pandas.NA, pandas.NA, 5]
    last = frame.iloc[-1]
    assert last[["big", "small", "yes", "at", "long", "word", "pair"]].isna().all()
    assert frame["at"].iloc[0].value == 1_400_000_001_123_456_789


def test_keys_that_are_no_times(rosCas):
    rooms = rosCas.addTopic("/rooms", key_format="manual")
    for name in ("kitchen", "hall", "kitchen"):
        rooms.addData(String(name.upper()), key=name)
    frame = rooms.toDataFrame()
    assert sorted(zip(frame.index, frame.data)) == [
        ("hall", "HALL"),
        ("kitchen", "KITCHEN"),
        ("kitchen", "KITCHEN"),
    ]
    assert rooms.toDataFrame(key="hall").data.tolist() == ["HALL"]
    assert rooms.getArrays("KEY", where="KEY = 'hall'")["KEY"].tolist() == ["hall"]
    parts = rosCas.addTopic("/parts", key_format="msg_part", key_part="linear.x")
    for x in (1.0, 2.0, 1.0):
        parts.addData(Twist(linear=Vector3(x=x, y=3 * x)))
    assert parts.getArrays("linear.y", key=1.0)["linear.y"].tolist() == [3, 3]
    found = parts.getArrays("linear.y", key=2.0, where="linear.y > 7")
    assert found["linear.y"].tolist() == []


def test_large_messages(rosCas):
    """Scalars of a message in chunks come from its row, arrays from the chunks."""
    definition = parse_definition("pkg/Image", "time at\nuint8[] data\nint32 x", None)
    message = message_class(definition)()
    message.at.secs, message.x, message.data = 7, -5, bytes(range(256)) * 4096
    topic = store(rosCas, "/image", [message], format="ros")
    assert topic.getArrays(["at", "x"])["at"].tolist() == [7 * 10**9]
    found = topic.getArrays(["x", "data", "data[255]"])
    assert (found["x"].tolist(), found["data[255]"].tolist()) == ([-5], [255])
    assert found["data"][0].tobytes() == message.data


@pytest.mark.parametrize("format_name", ["ros", "json"])
def test_fields_that_are_called_as_our_own_words(rosCas, format_name):
    text = "float64 KEY\npkg/N NODE\n" + "=" * 80 + "\nMSG: pkg/N\nint32[] KEY\n"
    message = message_class(parse_definition("pkg/Named", text, None))(KEY=0.5)
    message.NODE.KEY = [1, 2]
    topic = store(rosCas, "/named", [message], node="r1", format=format_name)
    names = ["KEY", '"KEY"', '"NODE".KEY']
    found = rosCas.executeCQL("select * from named")
    assert (list(found.columns), found) == (names, [(Stamp.from_ns(T), 0.5, [1, 2])])
    assert rosCas.executeCQL(f"select {', '.join(names)}, NODE from named") == [(*found[0], "r1")]
    arrays = topic.getArrays(["KEY", '"NODE".KEY[1]', '"KEY"'])
    assert [values.tolist() for values in arrays.values()] == [[T], [2], [0.5]]
    frame = topic.toDataFrame()
    assert (frame.index.name, list(frame.columns)) == ("KEY", names[1:])
    assert frame.index[0] == pandas.Timestamp(T) and frame['"KEY"'].iloc[0] == 0.5
    assert list(topic.toDataFrame(["NODE", *names[1:]]).columns) == ["NODE", *names[1:]]
    rosCas.executeCQL('create index on named ("KEY")')
    assert rosCas.executeCQL('select NODE from named where "KEY" = 0.5') == [("r1",)]
    rosCas.executeCQL('drop index on named ("KEY")')
    assert list(topic.getMeta["indexes"]) == []


def test_a_topic_without_a_type_has_nothing(rosCas):
    topic = rosCas.addTopic("/empty")
    assert topic.getArrays(["x", "KEY"])["x"].tolist() == []
    assert topic.toDataFrame(["x"]).shape == (0, 1)
    assert topic.toDataFrame().shape[0] == 0
