# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fields of many messages at once are what walking each of them gives."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker
from suites import search

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition, message_class, serialize
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire import message_stacks
from cassandra_ros.messages.wire.cql_values import compile_decoder
from cassandra_ros.messages.wire.message_stacks import by_size, stacker
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.messages.wire.zones import ZoneMap, zone_map

SEEDS = st.integers(0, 2**32)


def manyWires(definition, seed, count=40):
    """Messages of which many have the same size; some are malformed or have too many bytes."""
    rng = random.Random(seed)
    kept = [WireMaker(definition, rng.randrange(2**32), odd=True).make() for _ in range(3)]
    wires = []
    for _ in range(count):
        wire = bytearray(rng.choice(kept))
        if wire and rng.random() < 0.5:
            wire[rng.randrange(len(wire))] = rng.randrange(256)
        if rng.random() < 0.1:
            wire += bytes(rng.randrange(3))
        wires.append(bytes(wire[: rng.randint(0, len(wire))] if rng.random() < 0.05 else wire))
    return wires


def sameNumbers(found, expected):
    return all(a == b or (a != a and b != b) for a, b in zip(found, expected)) and len(
        found
    ) == len(expected)


def checkStack(definition, stack, wires):
    plan = wire_plan(definition)
    for column in plan.all_columns:
        read = plan.reader([column.name])
        if column.kind in ("array", "wire"):
            continue
        every = [read(wires[n])[0] for n in stack.members.tolist()]
        if column.kind == "text":
            texts = [t for each in every for t in (each if column.is_list else [each])]
            found = [raw.decode("utf-8", "replace") for raw in stack.texts(column.name)]
            assert sorted(set(found)) == sorted(set(texts))
            continue
        values = stack.numbers(column.name, column.field_type).T.tolist()
        assert len(values) == len(every)
        for found, each in zip(values, every):
            assert sameNumbers(found, each if column.is_list else [each])


@search(120)
@given(seed=SEEDS)
def test_stacked_fields_are_those_of_each_message(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    plan = wire_plan(definition)
    read = plan.reader([c.name for c in plan.all_columns])
    wires = manyWires(definition, seed)
    seen = []
    for members, planes in by_size(wires):
        stacks, rest = stacker(definition).stacks(planes, members)
        seen += rest.tolist()
        for stack in stacks:
            seen += stack.members.tolist()
            checkStack(definition, stack, wires)
    assert sorted(seen) == list(range(len(wires)))
    for wire in wires:  # nothing that is no message is stacked
        layout = stacker(definition)._layout(np.frombuffer(wire, np.uint8), 10**6)
        try:
            read(wire)
        except CorruptMessage:
            assert layout is None
        else:
            assert layout is not None


def bound(zones, table, name, prefix, column):
    raw = zones.values[list(table.columns).index(prefix + name)]
    return None if raw is None else compile_decoder(column, {})(raw)


@search(200)
@given(seed=SEEDS, ordered=st.booleans())
def test_zones_bound_every_value(seed, ordered):
    definition = parse_definition(*DefinitionMaker(seed).make())
    zone = zone_map(definition)
    wires = manyWires(definition, seed)
    if ordered:
        wires.sort(key=len)
    checkZones(definition, zone, wires)
    checkZones(definition, zone, wires[:1])  # walked by itself


def test_a_message_of_many_values_is_not_walked_each_time(monkeypatch):
    definition = installed_definition("geometry_msgs/PoseArray")
    made, pose = (
        message_class(installed_definition(f"geometry_msgs/Pose{s}"))() for s in ("Array", "")
    )
    zone_map.cache_clear()
    zone, walks, walk = zone_map(definition), [], ZoneMap._add_one
    monkeypatch.setattr(ZoneMap, "_add_one", lambda *args: (walks.append(1), walk(*args))[1])
    for number, poses in enumerate((3, 30, 3000, 3000, 3000)):
        pose.position.x, made.poses = -float(number), [pose] * poses
        zones = dict(zip(zone.columns, zone.measure([serialize(made)]).values))
        assert zones["_min.poses.position.x"] == struct.pack(">d", -float(number) or -0.0)
        assert len(walks) == min(number + 1, 3)


def checkZones(definition, zone, wires):
    zones = zone.measure(wires)
    assert len(zones.values) == len(zone.columns)
    names, gone = list(zone.fields), False
    read = wire_plan(definition).reader(names)
    values, nan = {name: [] for name in names}, set()
    for wire in wires:
        try:
            row = read(wire)
        except CorruptMessage:
            gone = True
            continue
        for (name, column), value in zip(zone.fields.items(), row):
            for each in value if column.is_list else [value]:
                nan.add(name) if each != each else values[name].append(each)
    assert zones.odd or not gone
    assert zones.nan == tuple(sorted(nan))
    for name, column in zone.fields.items():
        one = wire_plan(definition).column(name)
        one = type(one)(one.name, one.element_type, one.kind, one.field_type)
        low, high = (bound(zones, zone, name, prefix, one) for prefix in ("_min.", "_max."))
        if not values[name]:
            assert low is None and high is None
            continue
        if column.kind != "text":
            assert (low, high) == (min(values[name]), max(values[name]))
        elif not zones.odd or high is not None:
            assert low <= min(values[name]) and max(values[name]) <= high
            assert len(low.encode()) <= 64 and len(high.encode()) <= 64


@pytest.mark.parametrize("tail", ["", "z", "\U0010ffff", "\U0010ffff\U0010ffff", "é" * 40])
def test_long_texts_are_bounded_by_their_beginning(tail):
    definition = installed_definition("std_msgs/String")
    for start in ("x" * 59, "x" * 60, "x" * 64, "é" * 31, "𝄞" * 16):
        wires = [struct.pack("<I", len(t)) + t for t in [(start + tail).encode(), b"y"]]
        for these in (wires, wires[:1] * 20):
            checkZones(definition, zone_map(definition), these)


def test_zeros_are_bounded_by_both():
    definition = installed_definition("std_msgs/Float64")
    for values in ([0.0], [-0.0], [-0.0, 0.0] * 10, [float("nan"), 0.0] * 10):
        zones = zone_map(definition).measure([struct.pack("<d", v) for v in values])
        assert list(zones.values) == [struct.pack(">d", v) for v in (-0.0, 0.0)]
    only = zone_map(definition).measure([struct.pack("<d", float("nan"))] * 20)
    assert list(only.values) == [None, None] and only.nan == ("data",) and not only.odd


def test_equal_messages_are_not_walked_one_by_one(monkeypatch):
    walks = []
    whole = message_stacks.Layout.__init__
    monkeypatch.setattr(
        message_stacks.Layout,
        "__init__",
        lambda self, *args: (walks.append(1), whole(self, *args))[1],
    )
    definition = installed_definition("tf2_msgs/TFMessage")
    made = message_class(definition)()
    transform = message_class(installed_definition("geometry_msgs/TransformStamped"))()
    transform.header.frame_id, transform.child_frame_id = "odom", "base"
    made.transforms = [transform] * 3
    planes = np.tile(np.frombuffer(serialize(made), np.uint8)[:, None], (1, 500))
    stacker.cache_clear()
    for _ in range(3):
        stacks, rest = stacker(definition).stacks(planes, np.arange(500))
        assert len(stacks) == 1 and not len(rest)
        assert stacks[0].texts("transforms.child_frame_id") == [b"base"]
        assert stacks[0].numbers("transforms.transform.rotation.w", "float64").shape == (3, 500)
    assert len(walks) == 1


def test_a_large_message_of_many_lengths_is_left_to_who_skips_them():
    # A scan with several echoes has an array for each beam: to look at all took 10 ms a message.
    definition = installed_definition("sensor_msgs/MultiEchoLaserScan")
    echo = message_class(installed_definition("sensor_msgs/LaserEcho"))
    made = message_class(definition)()
    made.range_max, made.ranges = 30.0, [echo([1.0] * (n % 3)) for n in range(1500)]
    wire = serialize(made)
    planes = np.frombuffer(wire, np.uint8)[:, None]
    stacks, rest = stacker(definition).stacks(planes, np.arange(1))
    assert (stacks, rest.tolist()) == ([], [0])
    # One of many messages with the same layout is examined for all.
    stacks, rest = stacker(definition).stacks(np.repeat(planes, 100, axis=1), np.arange(100))
    assert len(stacks) == 1 and not len(rest)
    for count in (1, 100):
        zones = zone_map(definition).measure([wire] * count)
        bounds = dict(zip(zone_map(definition).columns, zones.values))
        assert bounds["_max.range_max"] == struct.pack(">f", 30.0) and not zones.odd


@given(SEEDS, SEEDS)
@search(120)
def test_what_messages_begin_with_is_found_in_those_of_any_size(kind, seed):
    definition = parse_definition(*DefinitionMaker(kind).make())
    wires = manyWires(definition, seed)
    groups = [(planes, members) for members, planes in by_size(wires)]
    head, plan = stacker(definition).head, wire_plan(definition)
    for stack in (stacker(definition).heads_of(wires), stacker(definition).heads(groups)):
        assert sorted(stack.members.tolist()) == [
            n for n, wire in enumerate(wires) if len(wire) >= head.size
        ]
        for column in plan.all_columns:
            if column.name not in head:
                continue
            read = plan.reader([column.name])
            found = stack.numbers(column.name, column.field_type)[0].tolist()
            for n, value in zip(stack.members.tolist(), found):
                try:
                    (expected,) = read(wires[n])
                except CorruptMessage:
                    continue
                assert sameNumbers([value], [expected]), column.name
