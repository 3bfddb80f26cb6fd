# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import json
import math
import struct
import tracemalloc
from functools import partial

import pytest
from formats.storages import check_kept_beside, check_refused, storage_of
from messages.random_wire import SEPARATOR

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition, message_class, serialize
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.json import CassandraTopic_json

json_format = partial(storage_of, CassandraTopic_json)


def test_the_text_is_rosbridges():
    storage = json_format("sensor_msgs/CompressedImage")
    message = message_class(storage.definition)(format="png", data=b"\x89PNG\r\n")
    message.header.frame_id = 'Zoë "cam" \u2028\0'
    message.header.stamp.secs = 7
    wire = serialize(message)
    (text,), odd, raw = storage.encode_wire(wire)
    assert (odd, raw) == (False, None)
    assert text.decode() == (
        '{"header":{"seq":0,"stamp":{"secs":7,"nsecs":0},"frame_id":"Zoë \\"cam\\" \u2028\\u0000"},'
        '"format":"png","data":"iVBORw0K"}'
    )
    assert storage.decode_wire((text,), None) == wire


def test_kinds_of_fields():
    storage = json_format(
        parse_definition(
            "p/T",
            "char[2] c\nuint8[] b\nint8[] from\nuint64 u\nint64 i\nbool[1] f\nduration[] d\n"
            "float32 g\nE e\nE[] a" + SEPARATOR + "MSG: p/E\n",
        )
    )
    wire = b"".join(
        [
            b"\0\xff" + struct.pack("<I", 0) + struct.pack("<Ib", 1, -1),
            struct.pack("<QqB", 2**64 - 1, -(2**63), 1),
            struct.pack("<Iii", 1, -1, 5) + struct.pack("<f", 0.1) + struct.pack("<I", 2),
        ]
    )
    (text,), odd, raw = storage.encode_wire(wire)
    assert (odd, raw) == (False, None)
    assert text.decode() == (
        '{"c":"AP8=","b":"","from":[-1],"u":18446744073709551615,"i":-9223372036854775808,'
        '"f":[true],"d":[{"secs":-1,"nsecs":5}],"g":0.10000000149011612,"e":{},"a":[{},{}]}'
    )
    assert storage.decode_wire((text,), None) == wire
    listed = text.replace(b'"AP8="', b"[0, 255]")  # rosbridge reads lists too
    assert storage.decode_wire((listed,), None) == wire


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_floats_that_are_not_finite_are_null(value):
    storage = json_format("sensor_msgs/LaserScan")
    message = message_class(storage.definition)(ranges=[1.0, value], angle_min=value)
    encoded = storage.encode(message)
    assert (encoded.odd, encoded.raw) == (True, serialize(message))
    found = json.loads(encoded.columns[0])
    assert (found["ranges"], found["angle_min"]) == ([1.0, None], None)
    with pytest.raises(CorruptMessage, match="LaserScan"):
        storage.decode_wire(encoded.columns, None)


@pytest.mark.parametrize(
    ("text", "wire"),
    [
        ("string x", b"\1\0\0\0\xff"),
        ("string x", b"\1\0\0\0a surplus"),
        ("bool x", b"\2"),
        ("time x", struct.pack("<II", 1, 10**9)),
        ("duration x", struct.pack("<ii", 1, -1)),
        ("float32 x", struct.pack("<I", 0x7F800001)),
    ],
)
def test_what_the_text_cannot_say_is_kept_beside_it(text, wire):
    check_kept_beside(CassandraTopic_json, text, wire)


def test_a_string_like_null_is_exact():
    storage = json_format("std_msgs/String")
    encoded = storage.encode(message_class(storage.definition)(data="null"))
    assert encoded == ((b'{"data":"null"}',), False, None)


HOSTILE = [
    "",
    "null",
    "[]",
    '{"data":1}',
    "[" * 65000,
    '{"":' * 16000,
    "1" * 5000,
    "\ufeff{}",
    '{"layout":{"dim":[],"data_offset":0},"data":[NaN]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[Infinity]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[null]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[true]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[1e999]}',
    '{"layout":{"dim":[],"data_offset":0},"data":"AAAA"}',
    '{"layout":{"dim":[],"data_offset":0},"data":[' + "1" * 400 + "]}",
    '{"layout":{"dim":[],"data_offset":0.0},"data":[]}',
    '{"layout":{"dim":[],"data_offset":-1},"data":[]}',
    '{"layout":{"dim":[],"data_offset":4294967296},"data":[]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[],"more":1}',
    '{"layout":{"dim":[{"label":"\\ud800","size":0,"stride":0}],"data_offset":0},"data":[]}',
    '{"layout":{"dim":[],"data_offset":0},"data":[]}' + " " * 65536,
]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_texts_that_are_no_message(text):
    check_refused(CassandraTopic_json, text)


@pytest.mark.parametrize(
    "data", ["iVBO Rw0K", "iVBORw0K!", "iVB-Rw0K", "iVB_Rw0K", "iVBORw0", "iVBORw0K\\n", "é"]
)
def test_a_text_that_is_not_base64_is_refused(data):
    """A damaged text gives no message, rather than one with other bytes."""
    storage = json_format("sensor_msgs/CompressedImage")
    header = '{"seq":0,"stamp":{"secs":7,"nsecs":0},"frame_id":""}'
    text = f'{{"header":{header},"format":"png","data":"{data}"}}'
    with pytest.raises(CorruptMessage, match="CompressedImage"):
        storage.decode_wire((text.encode(),), None)
    sound = text.replace(data, "iVBORw0K")
    assert storage.decode_wire((sound.encode(),), None).endswith(b"\x89PNG\r\n")


def test_arrays_are_shortened_before_strings():
    storage = json_format("diagnostic_msgs/DiagnosticStatus")
    value = message_class(installed_definition("diagnostic_msgs/KeyValue"))
    make = message_class(storage.definition)

    def shown(**fields):
        return json.loads(storage.encode(make(**fields)).columns[0])

    many = [value(key="k" * 100)] * 1000
    found = shown(name="n" * 60_000, values=many)
    assert (len(found["name"]), found["values"]) == (
        60_000,
        "<array type: diagnostic_msgs/KeyValue, length: 1000>",
    )
    found = shown(name="n" * 60_000, message="m" * 60_000, hardware_id="id")
    assert [found[key] for key in ("name", "message", "hardware_id")] == [
        "<string length: 60000>",
        "<string length: 60000>",
        "id",
    ]
    found = shown(values=[value(key="k" * 600)] * 200)
    assert found["values"] == "<array type: diagnostic_msgs/KeyValue, length: 200>"
    found = shown(values=[value(key="k" * 6000)] * 15)
    assert found["values"] == "<array type: diagnostic_msgs/KeyValue, length: 15>"


def test_a_type_whose_shortest_text_is_too_long_has_none():
    text = "\n".join(f"float64 {'x' * 200}{i}" for i in range(400))
    storage = json_format(parse_definition("p/T", text))
    wire = bytes(3200)
    assert storage.encode_wire(wire) == ((None,), True, wire)


@pytest.mark.suite("all", "large messages, to see how much memory they take")
def test_large_messages_are_not_turned_into_objects():
    storage = json_format("nav_msgs/Path")
    pose = struct.pack("<IIII", 0, 0, 0, 0) + bytes(56)
    wire = bytes(16) + struct.pack("<I", 200_000) + pose * 200_000
    tracemalloc.start()
    try:
        encoded = storage.encode_wire(wire)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert json.loads(encoded.columns[0])["poses"] == (
        "<array type: geometry_msgs/PoseStamped, length: 200000>"
    )
    assert peak < 4 << 20
