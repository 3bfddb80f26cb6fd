# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of many types, real ones and random ones at the edges, and how they are stored.

Every kind lies over four buckets, under two nodeIDs, with equal stamps among them; some rows are
deleted, some come after the indexes were made, and one writer has not closed its buckets.
"""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import diagnostic_msgs.msg
import geometry_msgs.msg
import nav_msgs.msg
import rosbag
import rosgraph_msgs.msg
import sensor_msgs.msg
import std_msgs.msg
import tf2_msgs.msg
from messages.random_wire import SEPARATOR, WireMaker
from query.brute_force import RUN_NAMES, Message, Types

from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.tables.registry import Run

SECOND = 10**9
T0 = 1_400_000_040 * SECOND
"""Where a bucket of a minute begins."""
BUCKET = 60 * SECOND
NODES = ("husky", "husky_2")
BUCKETS = 4
CHUNKED = 530 * 1024
"""Bytes; above 512 KiB a message lies in chunks."""

LONG = "long text, " * 200
VERY_LONG = "Ä very long text; " * 600
TEXTS = [
    *("", "a", "b", "base", "base_link", "base_link_2", "Base_link", "/base_link", "imu"),
    *("it's", "''", '"quoted"', "100%", "under_score", "--", "/* ; */", "?", "%s", "nul\0", " a"),
    *("Zoë", "Zoe\u0308", "☃", "\uffff", "𝄞", "line\nline", "\ufffd", "a\x7f", "NaN", "5"),
    *("x" * 1024, "x" * 1025, LONG, LONG + "!", VERY_LONG, VERY_LONG + "a", VERY_LONG + "b"),
]
FLOATS = [
    *(0.0, -0.0, 1.0, -1.0, 0.1, 0.5, 1.5, 5.0, 3.14159, 1e-3, 16777216.0, 16777218.0, 1e30),
    *(float("nan"), float("inf"), float("-inf"), 1.401298464324817e-45, 3.4028234663852886e38),
]
DOUBLES = [0.1 + 2**-50, 5e-324, 1.7976931348623157e308, 2.0**53, 2.0**53 + 2, 0.10000000149011612]
WHOLE = [0, 1, -1, 2, 5, 100, 127, 128, 255, 2**31 - 1, 2**53, 2**53 + 1, 2**63 - 1, 2**63, 2**64]

EVERY = SEPARATOR.join(
    [
        """std_msgs/Header header
bool flag
int8 i8
uint8 u8
int16 i16
uint16 u16
int32 i32
uint32 u32
int64 i64
uint64 u64
float32 f32
float64 f64
string text
time at
duration span
int32[] ints
uint64[] bigs
float32[] floats
float64[3] fixed
string[] words
bool[] flags
uint8[] bytes
time[] times
every_msgs/Item[] items""",
        """MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id""",
        """MSG: every_msgs/Item
string name
float32 x
int64 n
uint64 u
bool ok
time at
duration span
float64[] w
string[] names
every_msgs/Small[] more""",
        """MSG: every_msgs/Small
int32 a
string b""",
    ]
)
"""A type with fields of every primitive type, and arrays in arrays."""

# Two definitions of one topic: some fields are of the same type, some of another, some missing,
# beside an array of messages that both have, so that a statement unnests it in both.
OLDER = SEPARATOR.join(
    [
        """string name
float64 x
int32 n
string what
float32 only_older
int32[] list
int32[] list_older
string[] loose
mixed_msgs/Item[] items""",
        "MSG: mixed_msgs/Item\nint32 n\nfloat64[] w",
    ]
)
NEWER = SEPARATOR.join(
    [
        """float32 x
string name
uint64 n
int32 what
time only_newer
float64[] list
bool b
int32[] loose
mixed_msgs/Item[] items""",
        "MSG: mixed_msgs/Item\nfloat64 w\nint32 n\nint32[] list_newer",
    ]
)


class EdgeMaker(WireMaker):
    """Random messages whose values are few and near to one another: many are equal."""

    def _integer(self, code):
        bits = 8 * struct.calcsize("<" + code)
        low = -(1 << bits - 1) if code.islower() else 0
        high = low + (1 << bits) - 1
        near = [value for value in WHOLE if low <= value <= high]
        return struct.pack("<" + code, self.random.choice([*near, low, high, high - 1]))

    def _float32(self):
        if self.random.random() < 0.2:
            return super()._float32()
        value = self.random.choice(FLOATS)
        if self.random.random() < 0.3 and value == value and 0 < abs(value) < 1e30:
            bits = struct.unpack("<I", struct.pack("<f", value))[0]
            return struct.pack("<I", bits + self.random.choice([-1, 1]))  # one ulp beside it
        return struct.pack("<f", value)

    def _float64(self):
        if self.random.random() < 0.2:
            return super()._float64()
        return struct.pack("<d", self.random.choice(FLOATS + DOUBLES))

    def _string(self):
        if self.odd and self.random.random() < 0.3:
            return super()._string()
        # Long ones are the rare ones.
        text = self.random.choice(TEXTS if self.random.random() < 0.15 else TEXTS[:-7]).encode()
        return struct.pack("<I", len(text)) + text

    def _time(self):
        if self.random.random() < 0.3:
            return super()._time()
        offset = self.random.choice([0, 0, 1, 2, 59, 60])
        return struct.pack("<II", T0 // SECOND + offset, self._nsecs())


@dataclass(frozen=True)
class Kind:
    """Messages of one topic.

    Attributes:
        types: The definitions that the topic has had, oldest first.
        topic: The topic of the bag with the real ones.
        indexes: Fields to be indexed.
        count: How many random messages there are.
        big: Each makes the bytes of one message of over 512 KiB.
    """

    types: tuple[Types, ...]
    topic: str = ""
    indexes: tuple[str, ...] = ()
    count: int = 40
    real: int = 25
    big: tuple[Any, ...] = ()


def _types(made):
    return (Types(made._type, made._full_text),)


def _big_image():
    return serialized(sensor_msgs.msg.Image(height=7, encoding="rgb8", data=b"\7" * CHUNKED))


def _big_tf():
    transform = geometry_msgs.msg.TransformStamped(child_frame_id="x" * CHUNKED)
    transform.transform.translation.x = 0.1
    return serialized(tf2_msgs.msg.TFMessage([transform] * 2))


def _big_every():
    types = KINDS["every"].types[0]
    message = types.root(flag=True, i32=5, u64=2**64 - 1, f32=0.1, f64=-0.0, text="base_link")
    message.bytes, message.ints, message.words = b"\x07" * CHUNKED, [5, 2], ["a", "b"]
    message.items = [types.classes["every_msgs/Item"](name=name, x=0.5) for name in "ab"]
    return serialized(message)


def _big_text():
    return serialized(std_msgs.msg.String("ä" * (CHUNKED // 2) + "'"))


def _big_odd_text():
    return struct.pack("<I", CHUNKED) + b"\xff" * CHUNKED


KINDS = {
    "every": Kind(
        (Types("every_msgs/Every", EVERY),),
        indexes=("f32", "f64", "i32", "u64", "text", "flag", "at", "ints", "words", "items.x"),
        count=65,
        big=(_big_every,),
    ),
    "imu": Kind(
        _types(sensor_msgs.msg.Imu),
        "/imu/data",
        ("header.frame_id", "header.stamp", "orientation.x", "angular_velocity_covariance"),
    ),
    "scan": Kind(
        _types(sensor_msgs.msg.LaserScan),
        indexes=("range_min", "header.frame_id", "ranges", "header.seq"),
    ),
    "tf": Kind(
        _types(tf2_msgs.msg.TFMessage),
        "/tf",
        (
            *("transforms.child_frame_id", "transforms.transform.translation.x"),
            *("transforms.header.stamp", "transforms.header.seq"),
        ),
        big=(_big_tf,),
    ),
    "odometry": Kind(
        _types(nav_msgs.msg.Odometry),
        "/encoder",
        ("pose.pose.position.x", "child_frame_id", "header.seq", "pose.covariance"),
    ),
    "diagnostics": Kind(
        _types(diagnostic_msgs.msg.DiagnosticArray),
        "/diagnostics",
        ("status.name", "status.level", "header.seq"),
    ),
    "joints": Kind(
        _types(sensor_msgs.msg.JointState), "/joint_states", ("name", "position", "header.stamp")
    ),
    "log": Kind(_types(rosgraph_msgs.msg.Log), "/rosout", ("level", "msg", "topics", "line")),
    "image": Kind(
        _types(sensor_msgs.msg.Image),
        indexes=("height", "encoding", "data", "is_bigendian"),
        big=(_big_image,),
    ),
    "string": Kind(
        _types(std_msgs.msg.String), indexes=("data",), count=60, big=(_big_text, _big_odd_text)
    ),
    "uint64": Kind(_types(std_msgs.msg.UInt64), indexes=("data",), count=60),
    "mixed": Kind(
        (Types("mixed_msgs/Mixed", OLDER), Types("mixed_msgs/Mixed", NEWER)),
        indexes=("x", "n", "name"),
    ),
}


def serialized(message):
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


class Stored:
    """Messages of a kind in a keyspace, once in each format, and as objects of genpy.

    Args:
        name: Of the kind.
        bag: A bag with real messages.
    """

    def __init__(self, name, bag):
        self.name, self.kind = name, KINDS[name]
        self._numbers = random.Random(name)
        wires = self._wires(bag)
        self._numbers.shuffle(wires)
        self._rows = []
        t = T0
        for n, (types, wire, readable) in enumerate(wires):
            if self._numbers.random() < 0.8:
                t = T0 + n * BUCKETS * BUCKET // len(wires)
            value = types.root().deserialize(wire) if readable else None
            writer = self._numbers.randrange(3)
            # The second node has been about for a third of the time.
            node = self._numbers.choice(NODES if n * 3 < len(wires) else NODES[:1])
            message = Message(t, node, (writer + 1, n), types, value)
            self._rows.append((message, wire))
        times = [message.t for message, _ in self._rows]
        # One stretch that begins and ends inside of buckets, and one whole bucket.
        self._removed = [
            (times[len(times) // 5], times[len(times) // 4]),
            (T0 + 2 * BUCKET, T0 + 3 * BUCKET - 1),
        ]
        self.messages = [
            message
            for message, _ in self._rows
            if not any(low <= message.t <= high for low, high in self._removed)
        ]

    def _wires(self, bag):
        kind, found = self.kind, []
        if kind.topic:
            with rosbag.Bag(str(bag)) as opened:
                real = [raw[1] for _, raw, _ in opened.read_messages(kind.topic, raw=True)]
            found += [(kind.types[0], wire, True) for wire in real[:: len(real) // kind.real + 1]]
        for number in range(kind.count):
            types = kind.types[number % len(kind.types)]
            definition = parse_definition(types.name, types.text)
            maker = EdgeMaker(definition, self._numbers.random(), odd=number % 7 == 3)
            found.append((types, maker.make(), True))
        for types in kind.types:
            wire = next(wire for t, wire, _ in reversed(found) if t is types and len(wire) > 4)
            found.append((types, wire + b"more", True))
            found.append((types, wire[:-1], False))
        return found + [(kind.types[0], make(), True) for make in kind.big]

    def topic(self, format):
        return f"/{format}/{self.name}"

    def store(self, store, format):
        """Write the messages: a part before the indexes are made, a part after, one not closed.

        Returns:
            The writer that is still open.
        """
        writer = None
        for number in range(3):
            name = RUN_NAMES.get(number + 1)
            run = None if name is None else Run("", number + 1, "recording", name=name)
            writer = store.messageWriter(writer_id=number + 1, format=format, run=run)
            for message, wire in self._rows:
                if message.seq[0] == number + 1:
                    handle = self._connect(writer, message, format)
                    writer.write(handle, message.t, message.seq[1], wire)
            if number == 2:
                writer.flush()
                break
            writer.close()
            topic = store.getTopic(self.topic(format))
            if number == 0:
                self._remove(topic, *self._removed[0])
                for field in self.kind.indexes if format != "packed" else ():
                    topic.createIndex(field)
        for low, high in self._removed:
            self._remove(topic, low, high)
        return writer

    def _connect(self, writer, message, format):
        types = message.types
        header = {"type": types.name, "md5sum": types.md5sum, "message_definition": types.text}
        connection = live_connection(self.topic(format), header)
        return writer.connect(connection, BUCKET, node=message.node, span_ns=BUCKET)

    @staticmethod
    def _remove(topic, low, high):
        topic.removeData(Stamp.from_ns(low), Stamp.from_ns(high))
