# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import struct
import tracemalloc
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR, DefinitionMaker, WireMaker, installedTypes

from cassandra_ros.errors import CorruptMessage, DefinitionError
from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    serialize,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.tree.echo import echo_printer
from cassandra_ros.messages.tree.tree_encoder import tree_encoder
from cassandra_ros.messages.tree.tree_reader import Budget, tree_reader

SEEDS = st.integers(0, 2**32)


class Found(NamedTuple):
    tree: dict
    shortened: bool


def read(definition, wire, characters=1 << 24, byte=1, elements=1 << 24, text=1 << 24):
    budget = Budget(characters, byte, elements, text)
    tree = tree_reader(definition).read(wire, budget)
    return None if tree is None else Found(tree, budget.shortened)


def treeOf(definition, wire):
    found = read(definition, wire)
    assert not found.shortened
    return found.tree


def check(definition, seed):
    """The tree builds the message, and prints as genpy prints it."""
    wire = WireMaker(definition, seed, signalling=False).make()
    tree = treeOf(definition, wire)
    assert tree_encoder(definition)(tree) == wire
    printed = echo_printer(definition)(tree)
    try:
        cls = message_class(definition)
    except DefinitionError:
        return
    assert printed == str(deserialize(cls, wire))


def test_every_installed_type_is_built_and_printed():
    for seed, msg_type in enumerate(installedTypes()):
        check(installed_definition(msg_type), seed)


@settings(deadline=None)
@given(msg_type=st.sampled_from(installedTypes()), seed=SEEDS)
def test_installed_types(msg_type, seed):
    check(installed_definition(msg_type), seed)


@settings(deadline=None)
@given(seed=SEEDS)
def test_random_types(seed):
    check(parse_definition(*DefinitionMaker(seed).make()), seed)


@settings(deadline=None)
@given(seed=SEEDS, cut=st.integers(0, 400), surplus=st.binary(max_size=5), data=st.data())
def test_broken_messages_are_corrupt_or_read(seed, cut, surplus, data):
    definition = parse_definition(*DefinitionMaker(seed).make())
    wire = bytearray(WireMaker(definition, seed, odd=True).make())
    if wire:
        wire[data.draw(st.integers(0, len(wire) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for broken in (bytes(wire), bytes(wire[:cut]) + surplus):
        for limits in ({"characters": 65536}, {"elements": 1}, {"text": 0, "elements": 0}):
            try:
                found = read(definition, broken, **limits)
            except CorruptMessage as exc:
                assert definition.type in str(exc)
                continue
            if found is None:
                continue
            echo_printer(definition)(found.tree)
            try:
                assert len(tree_encoder(definition)(found.tree)) <= len(broken) * 4 or found[1]
            except CorruptMessage:
                pass


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(), max_size=5)
    | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@settings(deadline=None)
@given(seed=SEEDS, value=VALUES, data=st.data())
def test_trees_that_are_no_message_are_corrupt(seed, value, data):
    definition = parse_definition(*DefinitionMaker(seed).make())
    build = tree_encoder(definition)
    tree = treeOf(definition, WireMaker(definition, seed, signalling=False).make())
    place, key = None, None
    inner = tree
    while isinstance(inner, (dict, list)) and inner:
        if place is not None and data.draw(st.booleans()):
            break
        place = inner
        key = data.draw(st.sampled_from(list(inner) if type(inner) is dict else range(len(inner))))
        inner = inner[key]
    if place is not None:
        place[key] = value
    for changed in (tree, value):
        try:
            wire = build(changed)
        except CorruptMessage as exc:
            assert definition.type in str(exc)
        else:
            treeOf(definition, wire)


def test_a_tree_is_plain_values_by_the_definitions_names():
    definition = parse_definition(
        "p/T", "time t\nduration[] d\nuint8[] b\nchar[2] c\nint8[] from\nstring[1] s\nbool f"
    )
    wire = (
        struct.pack("<II", 7, 8)
        + struct.pack("<Iii", 1, -1, 5)
        + struct.pack("<I2s2s", 2, b"\0\1", b"\2\xff")
        + struct.pack("<Ib", 1, -1)
        + struct.pack("<I", 3)
        + "é!".encode()
        + b"\1"
    )
    tree = {
        "t": {"secs": 7, "nsecs": 8},
        "d": [{"secs": -1, "nsecs": 5}],
        "b": b"\0\1",
        "c": b"\2\xff",
        "from": [-1],
        "s": ["é!"],
        "f": True,
    }
    assert treeOf(definition, wire) == tree
    assert tree_encoder(definition)(tree) == wire
    assert "from_: [-1]\n" in echo_printer(definition)(tree)


@pytest.mark.parametrize(
    ("text", "good", "bad"),
    [
        ("uint8 x", [0, 255], [-1, 256, 1.0, True, "1", None, [1], b"1", 10**500]),
        ("int64 x", [-(2**63)], [2**63, float("nan")]),
        ("bool x", [True, False], [0, 1, "true", None]),
        ("float32 x", [1, 0.1, float("inf")], [1e39, True, "nan", None, 10**400]),
        ("float64 x", [1, 1e308], [False, 10**400, {}]),
        ("string x", ["", "a\0"], ["\ud800", 1, None, b"a", []]),
        ("uint8[] x", [b"", [1, 255]], [[256], [True], [1.0], "AQ==", 5, {"a": 1}]),
        ("char[2] x", [b"ab", [1, 2]], [b"a", [1, 2, 3]]),
        ("bool[] x", [[], [True]], [[1], True, "ab"]),
        ("int16[2] x", [[1, 2]], [[1], [1, 2, 3], [1, True], "ab"]),
        ("time x", [{"secs": 1, "nsecs": 999_999_999}], [{"secs": 1, "nsecs": 10**9}, 1, None]),
        ("time x", [{"nsecs": 1, "secs": 0}], [{"secs": -1, "nsecs": 0}, {"secs": 1}, [1, 2]]),
        ("duration x", [{"secs": -1, "nsecs": 0}], [{"secs": 0, "nsecs": -1}]),
        ("duration[1] x", [[{"secs": 0, "nsecs": 0}]], [[], [{"secs": True, "nsecs": 0}]]),
        ("string[2] x", [["a", "b"]], [["a"], ["a", 1], "ab"]),
        ("E x" + SEPARATOR + "MSG: p/E\n", [{}], [[], "", None, {"a": 1}]),
        (
            "F[2] x" + SEPARATOR + "MSG: p/F\nE e" + SEPARATOR + "MSG: p/E\n",
            [[{"e": {}}] * 2],
            [[{"e": {}}], {}, [{"e": {}}, None]],
        ),
    ],
)
def test_values_of_a_field(text, good, bad):
    definition = parse_definition("p/T", text)
    build = tree_encoder(definition)
    for value in good:
        build({"x": value})
    for value in bad:
        with pytest.raises(CorruptMessage, match="p/T"):
            build({"x": value})
    for tree in ({}, {"x": good[0], "y": 1}, [good[0]], None, "x", {"y": good[0]}):
        with pytest.raises(CorruptMessage, match="p/T"):
            build(tree)


def test_a_budget_bounds_what_is_read():
    definition = parse_definition("p/T", "P[] a" + SEPARATOR + "MSG: p/P\nfloat64 x\nfloat64[3] y")
    wire = struct.pack("<I", 5000) + struct.pack("<4d", 0, 0, 0, 0) * 5000
    tree = treeOf(definition, wire)
    least = len("{'x':0,'y':[0,0,0]},") * 5000
    assert read(definition, wire, characters=least) is not None
    assert len(echo_printer(definition)(tree)) > least
    assert read(definition, wire, characters=20_000) is None


def test_long_arrays_and_strings_become_rostopics_words():
    definition = parse_definition(
        "p/T",
        "P[] a\nstring s\nuint8[] b\nfloat64[9] f\nstring[] n" + SEPARATOR + "MSG: p/P\ntime[] t",
    )
    wire = (
        struct.pack("<II", 1, 4)
        + bytes(32)
        + struct.pack("<I", 9)
        + "Grüße ☃".encode()[:9]
        + struct.pack("<I", 3)
        + b"abc"
        + bytes(72)
        + struct.pack("<I", 0)
    )
    assert read(definition, wire, elements=2, text=8) == (
        {
            "a": [{"t": "<array type: time, length: 4>"}],
            "s": "<string length: 7>",
            "b": "<array type: uint8, length: 3>",
            "f": "<array type: float64, length: 9>",
            "n": [],
        },
        True,
    )  # fmt: skip
    found = read(definition, wire, elements=0)
    assert (found.tree["a"], found.tree["n"]) == ("<array type: p/P, length: 1>", [])


def test_rostopic_prints_long_arrays_alike():
    from rostopic import create_value_transform

    definition = installed_definition("sensor_msgs/JointState")
    message = message_class(definition)(name=["a", "b"], position=[1.0, 2.0])
    message.header.frame_id = "Zoë"
    found = read(definition, serialize(message), elements=0, text=0)
    expected = str(create_value_transform(True, True)(message))
    # rostopic also replaces what is empty.
    expected = expected.replace('"<array type: float64, length: 0>"', "[]")
    assert echo_printer(definition)(found.tree) == expected


@pytest.mark.parametrize("count", [1000, 2**32 - 1])
def test_messages_without_bytes_are_not_counted_into_memory(count):
    inner = "MSG: p/I\nE[] e" + SEPARATOR + "MSG: p/E\n"
    definition = parse_definition("p/T", "I[] i" + SEPARATOR + inner)
    wire = struct.pack("<I", 3000) + struct.pack("<I", count) * 3000
    tracemalloc.start()
    try:
        found = read(definition, wire, characters=65536, elements=65536)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found is None if count == 1000 else found.shortened
    assert peak < 8 << 20


def test_fixed_arrays_are_counted_before_they_are_read():
    definition = parse_definition("p/T", "P[4000] p" + SEPARATOR + "MSG: p/P\nuint8[4000] x")
    wire = bytes(16_000_000)
    assert read(definition, wire, characters=65536, elements=65536) is None
    assert read(definition, wire, elements=3999).tree == {"p": "<array type: p/P, length: 4000>"}


def test_a_definition_of_64_levels():
    names = [f"MSG: p/T{i}\nT{i + 1}[] a" for i in range(1, 63)]
    definition = parse_definition("p/T", SEPARATOR.join(["T1[] a", *names, "MSG: p/T63\nint8 x"]))
    wire = struct.pack("<I", 1) * 63 + b"\5"
    tree = treeOf(definition, wire)
    assert tree_encoder(definition)(tree) == wire
    assert echo_printer(definition)(tree).endswith("\n" + 250 * " " + "- \n" + 252 * " " + "x: 5")


@settings(deadline=None)
@given(
    text=st.text(st.characters(codec="utf-8"), max_size=200)
    | st.text("aB1~ ", min_size=66, max_size=90)  # yaml breaks lines at 80
)
def test_strings_are_quoted_as_by_genpy(text):
    definition = installed_definition("diagnostic_msgs/DiagnosticStatus")
    message = message_class(definition)(name=text, message=text[:9])
    definitions = installed_definition("sensor_msgs/JointState")
    names = message_class(definitions)(name=[text[:30], text, ""])
    for one, known in ((message, definition), (names, definitions)):
        assert echo_printer(known)(treeOf(known, serialize(one))) == str(one)
