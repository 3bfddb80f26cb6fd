# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the index of a field holds of a message."""

from __future__ import annotations

import struct

import genpy
import pytest
from geometry_msgs.msg import TransformStamped, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import ChannelFloat32, JointState, PointCloud
from std_msgs.msg import (
    Bool,
    Duration,
    Float32,
    Float32MultiArray,
    Float64,
    Header,
    Int8,
    String,
    Time,
    UInt8MultiArray,
    UInt64,
    UInt64MultiArray,
)
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import InvalidName
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.index_field import MAX_ELEMENTS, MAX_INDEXED_TEXT_BYTES, IndexField

NAN = float("nan")


def field_of(cls, field):
    return IndexField(definition_of(cls), field, "_ix3")


def held(msg, field):
    """The values that the index holds, decoded by the bare driver; None = unset, 'odd' = odd."""
    from cassandra.cqltypes import lookup_casstype_simple

    index = field_of(type(msg), field)
    raw, odd = index.value(serialize(msg))
    if odd:
        assert raw is None
        return "odd"
    if raw is None:
        return None
    types = {
        **{"boolean": "BooleanType", "tinyint": "ByteType", "smallint": "ShortType"},
        **{"int": "Int32Type", "bigint": "LongType", "varint": "IntegerType"},
        **{"float": "FloatType", "double": "DoubleType", "text": "UTF8Type"},
    }
    decode = lookup_casstype_simple(types[index.element_type]).deserialize
    if not index.many:
        return decode(raw, 5)
    (count,) = struct.unpack_from(">i", raw)
    at, values = 4, []
    for _ in range(count):
        (size,) = struct.unpack_from(">i", raw, at)
        values.append(decode(raw[at + 4 : at + 4 + size], 5))
        at += 4 + size
    assert at == len(raw) and len(set(values)) == count
    return set(values)


def transforms(*names, x=0.0):
    made = [TransformStamped(child_frame_id=name) for name in names]
    for each in made:
        each.transform.translation.x = x
    return TFMessage(made)


@pytest.mark.parametrize(
    ("msg", "field", "value"),
    [
        (Bool(True), "data", True),
        (Int8(-5), "data", -5),
        (UInt64(2**64 - 1), "data", 2**64 - 1),
        (Float64(0.1), "data", 0.1),
        (Float32(float("-inf")), "data", float("-inf")),
        (String("grün"), "data", "grün"),
        (String(""), "data", ""),
        (String("x" * MAX_INDEXED_TEXT_BYTES), "data", "x" * MAX_INDEXED_TEXT_BYTES),
        (String("x" * (MAX_INDEXED_TEXT_BYTES + 1)), "data", "odd"),
        (String("ü" * (MAX_INDEXED_TEXT_BYTES // 2 + 1)), "data", "odd"),
        (Float64(NAN), "data", "odd"),
        (Float32(NAN), "data", "odd"),
        (Time(genpy.Time(7, 8)), "data", 7_000_000_008),
        (Duration(genpy.Duration(-1, 5)), "data", -999_999_995),
        (Odometry(header=Header(stamp=genpy.Time(1, 2))), "header.stamp", 1_000_000_002),
        (transforms("a", "b", "a"), "transforms.child_frame_id", {"a", "b"}),
        (transforms("a", "b", x=-0.0), "transforms.transform.translation.x", {0.0}),
        (transforms("a", x=NAN), "transforms.transform.translation.x", "odd"),
        (transforms("a", "x" * 1025), "transforms.child_frame_id", "odd"),
        (transforms("a", ""), "transforms.child_frame_id", {"a", ""}),
        (transforms(), "transforms.child_frame_id", None),
        (JointState(name=["a", "b"], position=[1.5, 1.5]), "name", {"a", "b"}),
        (JointState(name=["a", "b"], position=[1.5, 1.5]), "position", {1.5}),
        (JointState(), "position", None),
        (JointState(position=[1.0, NAN]), "position", "odd"),
        (UInt8MultiArray(data=b"\x00\xff\xff"), "data", {0, 255}),
        (Float32MultiArray(data=[0.5, -0.0, 0.0]), "data", {0.5, 0.0}),
        (UInt64MultiArray(data=[2**63, 0]), "data", {2**63, 0}),
        (UInt8MultiArray(data=bytes(MAX_ELEMENTS)), "data", {0}),
        (UInt8MultiArray(data=bytes(MAX_ELEMENTS + 1)), "data", "odd"),
        (transforms(*["a"] * MAX_ELEMENTS), "transforms.child_frame_id", {"a"}),
        (transforms(*["a"] * (MAX_ELEMENTS + 1)), "transforms.child_frame_id", "odd"),
        (JointState(name=["a"] * (MAX_ELEMENTS + 1)), "name", "odd"),
        (Odometry(), "pose.covariance", {0.0}),
    ],
)
def test_values(msg, field, value):
    found = held(msg, field)
    assert found == value and type(found) is type(value)


def test_zero_has_one_sign():
    for cls in (Float32, Float64):
        index = field_of(cls, "data")
        assert index.value(serialize(cls(-0.0))) == index.value(serialize(cls(0.0)))


def test_a_set_is_sent_as_the_driver_sends_it():
    from cassandra.cqltypes import SetType, UTF8Type

    index = field_of(TFMessage, "transforms.child_frame_id")
    one = index.value(serialize(transforms("b")))[0]
    assert one == SetType.apply_parameters([UTF8Type]).serialize({"b"}, 5)


@pytest.mark.parametrize(
    ("cls", "field", "wire"),
    [
        (Bool, "data", b"\x02"),
        (String, "data", b"\x02\0\0\0\xff\xfe"),
        (Time, "data", struct.pack("<II", 1, 10**9)),
        (Float64, "data", b"\0"),
        (UInt8MultiArray, "data", b""),
    ],
)
def test_what_no_column_holds_is_odd(cls, field, wire):
    assert field_of(cls, field).value(wire) == (None, True)


@pytest.mark.parametrize(
    ("cls", "field", "element_type", "kind", "many"),
    [
        (Bool, "data", "boolean", "bool", False),
        (Time, "data", "bigint", "time", False),
        (TFMessage, "transforms.header.stamp", "bigint", "time", True),
        (TFMessage, "transforms.child_frame_id", "text", "text", True),
        (JointState, "name", "text", "text", True),
        (JointState, "position", "double", "float", True),
        (UInt8MultiArray, "data", "smallint", "int", True),
        (Odometry, "pose.covariance", "double", "float", True),
    ],
)
def test_types(cls, field, element_type, kind, many):
    index = field_of(cls, field)
    assert (index.field, index.shadow) == (field, "_ix3")
    assert (index.element_type, index.kind, index.many) == (element_type, kind, many)
    assert index.cql_type == (f"set<{element_type}>" if many else element_type)


@pytest.mark.parametrize(
    ("cls", "field", "hint"),
    [
        (Vector3, "xx", "did you mean x"),
        (Odometry, "header", "it is a message, name one of its fields, like header.seq"),
        (Odometry, "header.stamp.secs", "did you mean header.stamp"),
        (TFMessage, "transforms", "like transforms.header.seq"),
        (TFMessage, "child_frame_id", "did you mean transforms.child_frame_id"),
        (TFMessage, "transforms[0].child_frame_id", "did you mean transforms.child_frame_id"),
        (PointCloud, "channels.values", "did you mean channels.name"),
        (Vector3, "zzzzzz", "its fields: x, y, z"),
    ],
)
def test_a_field_that_cannot_be_indexed_names_the_nearest(cls, field, hint):
    with pytest.raises(InvalidName) as caught:
        field_of(cls, field)
    assert hint in str(caught.value)


def test_arrays_in_arrays_say_why():
    with pytest.raises(InvalidName, match="an array inside of an array of messages"):
        field_of(PointCloud, "channels.values")
    assert held(PointCloud(channels=[ChannelFloat32(name="i")]), "channels.name") == {"i"}
