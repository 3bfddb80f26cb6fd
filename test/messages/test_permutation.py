# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of many messages at once are, byte for byte, those of each that is walked."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker
from messages.test_message_stacks import manyWires
from suites import search

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.permuter import MAX_CACHED, MIN_ROWS, permuter
from cassandra_ros.messages.wire.wire_plan import wire_plan

SEEDS = st.integers(0, 2**32)


def walked(plan, wire):
    """Return the columns of a message, each after its size; None if one is inexact."""
    columns, odd = plan.walk(wire)
    return None if odd else b"".join(struct.pack(">i", len(c)) + c for c in columns)


def check(definition, wires):
    """Return how many were permuted."""
    plan, count = wire_plan(definition), 0
    if not plan.complete:
        return 0  # of more fields than a row has columns: format ros does not permute them
    rows = permuter(definition).rows(wires)
    assert len(rows) == len(wires)
    for wire, row in zip(wires, rows):
        assert row is None or row == walked(plan, wire)
        count += row is not None
    checkBack(definition, [walked(plan, wire) for wire in wires], wires)
    return count


def built(plan, row):
    """Return the message of a row; None if its bytes are no message."""
    columns = cut(row)
    try:
        return None if columns is None else plan.build(columns)
    except CorruptMessage:
        return None


def cut(row):
    """The columns of a row, None where its end is missing."""
    columns = []
    while row:
        if len(row) < 4:
            return None
        (size,) = struct.unpack_from(">i", row)
        if len(row) < 4 + size:
            return None
        columns.append(row[4 : 4 + size] if size >= 0 else None)
        row = row[4 + max(0, size) :]
    return columns


def checkBack(definition, rows, wires):
    """Return how many messages were made of rows together, which are those of each row."""
    kept = [(row, len(wire)) for row, wire in zip(rows, wires) if row is not None]
    if not kept:
        return 0
    # As in an answer: something lies between them.
    data, starts = b"", []
    for row, _ in kept:
        starts.append(len(data) + 3)
        data += b"abc" + row
    starts = np.array(starts, np.int64)
    ends = starts + [len(row) for row, _ in kept]
    sizes = np.array([size for _, size in kept], np.int64)
    plan, count = wire_plan(definition), 0
    for (row, _), wire in zip(kept, permuter(definition).wires(data, starts, ends, sizes)):
        assert wire is None or wire == built(plan, row)
        count += wire is not None
    return count


@search(200)
@given(seed=SEEDS)
def test_rows_are_those_of_each_message(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    check(definition, manyWires(definition, seed))
    wire = WireMaker(definition, seed, odd=False).make()
    rng = random.Random(seed)
    changed = []
    for _ in range(30):
        each = bytearray(wire)
        for _ in range(rng.randint(0, 3)):
            if each:
                each[rng.randrange(len(each))] = rng.choice((0, 1, 2, 0x7F, 0x80, 0xFF))
        changed.append(bytes(each))
    check(definition, changed)


@search(200)
@given(seed=SEEDS)
def test_messages_of_rows_that_somebody_changed_are_those_that_are_built(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    plan, rng = wire_plan(definition), random.Random(seed)
    wire = WireMaker(definition, seed, odd=False).make()
    row = walked(plan, wire) if plan.complete else None
    if not row:
        return
    rows = [row] * MIN_ROWS
    for _ in range(30):
        each = bytearray(row)
        for _ in range(rng.randint(1, 3)):
            each[rng.randrange(len(each))] = rng.choice((0, 1, 2, 0x7F, 0x80, 0xFF))
        rows.append(bytes(each) + b"\0\0\0\0" * (rng.random() < 0.1))
    rng.shuffle(rows)
    checkBack(definition, rows, [wire] * len(rows))


@pytest.mark.parametrize(
    "type_",
    [
        "sensor_msgs/Imu",
        "tf2_msgs/TFMessage",
        "geometry_msgs/TransformStamped",
        "nav_msgs/Odometry",
        "sensor_msgs/JointState",
        "sensor_msgs/LaserScan",
        "std_msgs/String",
        "rosgraph_msgs/Log",
    ],
)
def test_messages_of_one_layout_are_permuted(type_):
    definition = installed_definition(type_)
    plan, rng = wire_plan(definition), random.Random(1)
    for _ in range(20):
        wire = WireMaker(definition, rng.randrange(2**32), odd=False).make()
        if len(wire) <= 2048 and walked(plan, wire) is not None and wire.isascii():
            assert check(definition, [wire] * MIN_ROWS) == MIN_ROWS
            rows = [walked(plan, wire)] * MIN_ROWS
            assert checkBack(definition, rows, [wire] * MIN_ROWS) == MIN_ROWS
        assert check(definition, [wire] * (MIN_ROWS - 1)) == 0


def test_what_no_column_holds_is_left_to_be_walked():
    definition = installed_definition("std_msgs/Header")

    def header(secs=1, nsecs=0, frame=b"abc"):
        return struct.pack("<IIII", 7, secs, nsecs, len(frame)) + frame

    good = [header(n, 10**9 - 1 - n) for n in range(MIN_ROWS)]
    odd = [header(1, 10**9), header(2**32 - 1, 2**32 - 1), header(frame=b"\xff\xfe\xfd")]
    rows = permuter(definition).rows([*good, *odd, header(2**32 - 1), header() + b"x", b""])
    assert [row is None for row in rows] == [False] * len(good) + [True] * 3 + [False, True, True]


def test_of_texts_and_arrays_that_vary_messages_of_any_size_are_permuted():
    definition = installed_definition("sensor_msgs/LaserScan")
    maker = WireMaker(definition, 1, odd=False)
    wires, plan = [maker.make() for _ in range(100)], wire_plan(definition)
    rows = [walked(plan, wire) for wire in wires]
    assert len(set(map(len, wires))) > 30
    plain = sum(wire[16 : 16 + wire[12]].isascii() for wire in wires)
    assert 50 < check(definition, wires) == plain
    assert checkBack(definition, rows, wires) == sum(row is not None for row in rows)


def test_rows_of_several_layouts_are_each_turned_back():
    definition = installed_definition("tf2_msgs/TFMessage")
    maker, plan = WireMaker(definition, 1, odd=False), wire_plan(definition)
    few = [w for w in (maker.make() for _ in range(40)) if len(w) <= 2048 and walked(plan, w)][:5]
    wires = few * MIN_ROWS
    assert checkBack(definition, [walked(plan, wire) for wire in wires], wires) == len(wires)


def test_more_layouts_than_are_kept_are_turned_back():
    definition = parse_definition("a/B", "string[] names")
    plan = wire_plan(definition)

    def wire(*names):
        parts = (struct.pack("<I", len(name)) + name.encode() for name in names)
        return struct.pack("<I", len(names)) + b"".join(parts)

    def turned(*wires):
        every = [each for each in wires for _ in range(MIN_ROWS)]
        return checkBack(definition, [walked(plan, each) for each in every], every)

    turned(wire("a", "bcd"))
    for size in range(MAX_CACHED - 1):
        turned(wire("x" * (10 + size)))
    assert turned(wire("a", "bcd"), wire("ab", "cd"), wire("abc", "d")) == 3 * MIN_ROWS


def test_of_rows_that_end_before_their_columns_no_message_is_made():
    count = 2 * MIN_ROWS
    starts = np.arange(count, dtype=np.int64) * 20 + 20
    made = permuter(installed_definition("std_msgs/UInt64"))
    data = bytes(20 * count)
    assert made.wires(data, starts, starts - 8, np.full(count, 8)) == [None] * count


def test_types_with_columns_of_any_size_are_walked():
    definition = installed_definition("std_msgs/UInt64")
    assert permuter(definition).rows([bytes(8)] * 20) == [None] * 20
