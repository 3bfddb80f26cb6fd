# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Many messages made at once are those that genpy makes one by one, to the last type."""

from __future__ import annotations

import random
import struct

import genpy
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, fuzzed, installedTypes
from sensor_msgs.msg import Imu
from std_msgs.msg import Header, String
from suites import search
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import CorruptMessage, DefinitionError
from cassandra_ros.messages import classes
from cassandra_ros.messages.classes import (
    deserialize,
    deserialize_all,
    message_class,
    raw_class,
    serialize,
)
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.messages.wire.fields import CannotBatch
from cassandra_ros.messages.wire.objects import ObjectMaker

SEEDS = st.integers(0, 2**32)
COUNT = 30
TYPES = installedTypes()


def contents(value):
    """What a message consists of, comparable, with the type of every value."""
    if isinstance(value, (genpy.Message, genpy.rostime.TVal)):
        inner = [contents(getattr(value, name)) for name in value.__slots__]
        return type(value), inner, hasattr(value, "_connection_header")
    if isinstance(value, (list, tuple)):
        return type(value), [contents(each) for each in value]
    return type(value), struct.pack("<d", value) if isinstance(value, float) else value


def manyWires(definition, seed):
    """Messages of few shapes, so that many share one, or of a shape each."""
    rng = random.Random(seed)
    odd, fresh = rng.random() < 0.5, rng.random() < 0.3
    makers = [WireMaker(definition, rng.randrange(2**32), odd) for _ in range(COUNT)]
    kept = [maker.make() for maker in makers[: rng.choice([1, 2, 5])]]
    return [maker.make() if fresh else rng.choice(kept) for maker in makers]


def together(cls, wires):
    """Make messages together, or say that they cannot be."""
    made = ObjectMaker(cls, definition_of(cls))
    sizes = np.array([len(wire) for wire in wires], np.int64)
    return made.make(b"".join(wires), np.cumsum(sizes) - sizes, sizes)


def check(cls, wires):
    """Compare with genpy; return whether they were made together."""
    expected = [contents(deserialize(cls, wire)) for wire in wires]
    assert [contents(each) for each in deserialize_all(cls, wires)] == expected
    try:
        assert [contents(each) for each in together(cls, wires)] == expected
    except CannotBatch:
        return False
    return True


@search(40)
@given(SEEDS)
def test_messages_of_random_definitions_made_together(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    check(message_class(definition), manyWires(definition, seed))


@search(120)
@given(st.sampled_from(TYPES), SEEDS)
def test_messages_of_installed_types_made_together(msg_type, seed):
    try:
        definition = classes.installed_definition(msg_type)
    except DefinitionError:
        return
    cls = genpy.message.get_message_class(msg_type)
    if cls is not None:
        check(cls, manyWires(definition, seed))


@search(40)
@given(SEEDS)
@example(3)
def test_what_is_no_message_is_corrupt_also_among_others(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    cls, rng = message_class(definition), random.Random(seed)
    wires = manyWires(definition, seed)
    for n in rng.sample(range(COUNT), 3):
        wires[n] = fuzzed(wires[n], rng.randrange(2**32))
    try:
        expected = [contents(deserialize(cls, wire)) for wire in wires]
    except CorruptMessage as exc:
        with pytest.raises(CorruptMessage) as found:
            list(deserialize_all(cls, wires))
        assert str(found.value) == str(exc)
        with pytest.raises(CannotBatch):
            together(cls, wires)
    else:
        assert [contents(each) for each in deserialize_all(cls, wires)] == expected


@pytest.mark.parametrize("cls", [Imu, TFMessage, Header, String])
def test_common_types_are_made_together(cls):
    maker = WireMaker(definition_of(cls), 1)
    assert check(cls, [maker.make() for _ in range(100)])


def test_no_object_is_in_two_messages():
    message = TFMessage(transforms=[genpy.message.get_message_class(t)() for t in TF])
    one, other, *_ = list(deserialize_all(TFMessage, [serialize(message)] * COUNT))
    one.transforms[0].transform.rotation.w = 4.0
    one.transforms[0].header.stamp.secs = 5
    assert other == message
    assert one.transforms[1:] == other.transforms[1:]


TF = ["geometry_msgs/TransformStamped"] * 3


def test_times_of_the_message_itself_are_canonical_and_others_are_not():
    definition = parse_definition(
        "pkg/Times", "time t\nduration d\ntime[] ts\nstd_msgs/Header h" + HEADER
    )
    wire = struct.pack("<IIiiIIIIIII", 1, 2 * 10**9, -1, -1, 1, 1, 2 * 10**9, 7, 1, 2 * 10**9, 0)
    assert check(message_class(definition), [wire] * COUNT)
    (found, *_) = together(message_class(definition), [wire] * COUNT)
    assert (found.t.secs, found.ts[0].secs, found.h.stamp.secs) == (3, 1, 1)


HEADER = "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"


def test_classes_that_genpy_did_not_make_are_left_to_themselves():
    class Own(String):
        def deserialize(self, data):
            self.data = "own"
            return self

    with pytest.raises(CannotBatch):
        ObjectMaker(Own, definition_of(Own))
    assert [m.data for m in deserialize_all(Own, [serialize(String("a"))] * COUNT)] == [
        "own"
    ] * COUNT
    raw = raw_class("pkg/Broken", "0" * 32)
    assert [m._buff for m in deserialize_all(raw, [b"ab"] * COUNT)] == [b"ab"] * COUNT


def test_few_and_none():
    wire = serialize(String("a"))
    assert list(deserialize_all(String, [])) == []
    assert list(deserialize_all(String, [wire])) == [String("a")]


def test_arrays_of_very_different_lengths_are_not_walked_together():
    many = TFMessage(transforms=[genpy.message.get_message_class(TF[0])() for _ in range(2000)])
    wires = [serialize(TFMessage())] * COUNT + [serialize(many)]
    assert not check(TFMessage, wires)
