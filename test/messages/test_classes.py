# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import struct
import threading
from itertools import islice

import genpy
import pytest
import rosbag
import rospy
import yaml
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR, DefinitionMaker, WireMaker
from std_msgs.msg import Header, String
from suites import search
from visualization_msgs.msg import MarkerArray

from cassandra_ros.errors import CorruptMessage, DefinitionError, TypeMismatch
from cassandra_ros.messages import classes
from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    message_of_yaml,
    raw_class,
    serialize,
    to_yaml,
)
from cassandra_ros.messages.definition import definition_of, parse_definition


def test_installed_class_when_the_md5_agrees():
    assert message_class(installed_definition("std_msgs/String")) is String


def test_generated_class_when_it_does_not():
    definition = parse_definition("std_msgs/String", "string data\nint8 more\nint8 CONST=7")
    generated = message_class(definition)
    assert generated is not String
    assert generated is message_class(definition)
    assert generated.CONST == 7
    assert generated._full_text == definition.text
    message = deserialize(generated, serialize(generated(data="x", more=5)))
    assert (message.data, message.more) == ("x", 5)
    assert isinstance(message, genpy.Message)


def test_same_md5_under_another_name_is_another_class():
    text = installed_definition("std_msgs/String").text
    other = parse_definition("pkg/Text", text, String._md5sum)
    assert message_class(other) is not String
    assert message_class(other)._type == "pkg/Text"


def test_nested_classes_know_their_own_definition():
    text = "Inner inner" + SEPARATOR + "MSG: pkg/Inner\nstring A=# \\b\nint8 TWO=2\nHeader header"
    text += SEPARATOR + "MSG: std_msgs/Header\n" + installed_definition("std_msgs/Header").text
    definition = parse_definition("pkg/Outer", text)
    inner = type(message_class(definition)().inner)
    assert inner._md5sum == definition.md5sums["pkg/Inner"]
    assert definition_of(inner).md5sum == inner._md5sum
    assert parse_definition("pkg/Inner", inner._full_text, inner._md5sum)
    assert (inner.A, inner.TWO) == ("# \\b", 2)
    assert type(inner().header)._md5sum == Header._md5sum


def test_classes_are_made_once_by_many_threads():
    definition = parse_definition("pkg/Many", "int8 x\nstring[] y")
    made = []
    threads = [
        threading.Thread(target=lambda: made.append(message_class(definition))) for _ in "ab"
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made[0] is made[1]


@search(120)
@given(st.integers(0, 2**32))
def test_generated_classes_read_and_write_what_genpy_can_hold(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    generated = message_class(definition)
    wire = WireMaker(definition, seed, signalling=False).make()
    assert serialize(deserialize(generated, wire)) == wire


def test_unusable_definitions_keep_the_bytes():
    cls = raw_class("pkg/Broken", "0" * 32)
    assert cls is raw_class("pkg/Broken", "0" * 32)
    message = deserialize(cls, b"\1\2")
    assert (message._type, message._md5sum, message._buff) == ("pkg/Broken", "0" * 32, b"\1\2")
    assert serialize(message) == b"\1\2"
    assert message == deserialize(cls, b"\1\2")
    assert message != deserialize(cls, b"\1")
    assert "2 bytes of pkg/Broken" in to_yaml(message)


def test_any_msg_is_serialised_as_it_is():
    message = rospy.AnyMsg()
    message.deserialize(b"abc")
    assert serialize(message) == b"abc"


@pytest.mark.parametrize("cut", [0, 3, 4, 7])
def test_short_buffers_are_corrupt_though_genpy_takes_them(cut):
    wire = serialize(String("abcd"))
    with pytest.raises(CorruptMessage, match="std_msgs/String"):
        deserialize(String, wire[:cut])


def test_surplus_bytes_are_ignored_as_in_ros():
    assert deserialize(String, serialize(String("abcd")) + b"x").data == "abcd"


def test_arrays_that_count_too_far_are_corrupt():
    definition = parse_definition(
        "pkg/Many", "Some[] x" + SEPARATOR + "MSG: pkg/Some\nNone[] y" + SEPARATOR + "MSG: pkg/None"
    )
    cls = message_class(definition)
    fine = struct.pack("<III", 2, 1000, 3)
    assert len(deserialize(cls, fine).x[0].y) == 1000
    for counts in ([1, 2**32 - 1], [2**32 - 1], [3, 2**20, 2**20, 2**20]):
        with pytest.raises(CorruptMessage):
            deserialize(cls, struct.pack(f"<{len(counts)}I", *counts))


def test_fields_that_cannot_be_serialised():
    with pytest.raises(TypeMismatch, match="std_msgs/Header"):
        serialize(Header(seq="one"))
    with pytest.raises(TypeMismatch):
        serialize(Header(seq=-1))
    with pytest.raises(TypeMismatch, match="int"):
        serialize(5)


def test_yaml_is_what_rostopic_echo_prints():
    message = Header(seq=5, stamp=genpy.Time(1, 2), frame_id='a"b')
    assert yaml.safe_load(to_yaml(message)) == {
        "seq": 5,
        "stamp": {"secs": 1, "nsecs": 2},
        "frame_id": 'a"b',
    }


def test_types_of_the_bags_that_are_installed_nowhere(bags):
    with rosbag.Bag(str(bags / "husky_gps_data.bag")) as bag:
        messages = islice(bag.read_messages(raw=True), 0, None, 10)
        for topic, (name, wire, md5sum, _, cls), _ in messages:
            definition = parse_definition(name, cls._full_text, md5sum)
            ours = deserialize(message_class(definition), wire)
            assert serialize(ours) == wire
            assert to_yaml(ours) == str(cls().deserialize(wire)), topic


def test_an_installed_package_that_is_broken_is_passed_over(tmp_path, monkeypatch):
    folder = tmp_path / "broken_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder.parent / "__init__.py").write_text("")
    (folder / "_Thing.py").write_text("class Other: pass")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(DefinitionError, match="not installed"):
        installed_definition("broken_msgs/Thing")
    definition = parse_definition("broken_msgs/Thing", "int8 x")
    assert message_class(definition)(5).x == 5
    assert classes.message_class(definition)._type == "broken_msgs/Thing"


TIMES = """time stamp
time[] stamps
duration[2] two
duration length
Part[] parts
Part one
================================================================================
MSG: pkg/Part
time at
int32 n
"""
WHOLE = st.integers(0, 2**32 * 10**9 - 1)
SIGNED = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


@given(WHOLE, st.lists(WHOLE, max_size=3), SIGNED, SIGNED)
def test_times_in_yaml_are_exact_to_the_nanosecond(t, others, length, second):
    """As integers of nanoseconds, in messages, arrays and fixed arrays, by name or in order."""
    cls = message_class(parse_definition("pkg/Times", TIMES))
    named = f"{{stamp: {t}, stamps: {others}, length: {length}, two: [{length}, {second}], "
    named += f"one: {{at: {t}}}}}"
    ordered = f"[{t}, {others}, [{length}, {second}], {length}, [[{second % 10**9}, 7]], [{t}, 0]]"
    for text in (named, ordered):
        msg = message_of_yaml(cls, text)
        assert msg.stamp.to_nsec() == msg.one.at.to_nsec() == t
        assert [each.to_nsec() for each in msg.stamps] == others
        assert [each.to_nsec() for each in msg.two] == [length, second]
        assert msg.length.to_nsec() == length


def test_times_of_messages_in_arrays_are_exact_in_yaml():
    text = "{markers: [{lifetime: 1368021980238582677, header: {stamp: 1368021980238582676}}]}"
    (marker,) = message_of_yaml(MarkerArray, text).markers
    assert marker.header.stamp.to_nsec() == 1368021980238582676
    assert marker.lifetime.to_nsec() == 1368021980238582677


@pytest.mark.parametrize("stamp", ["1.5", "-1", str(2**32 * 10**9), "soon", "[1]", "true"])
def test_what_is_no_time_is_refused_in_yaml(stamp):
    with pytest.raises(TypeMismatch):
        message_of_yaml(Header, f"stamp: {stamp}")
