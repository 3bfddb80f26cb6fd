# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import struct
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR, DefinitionMaker, WireMaker, installedTypes
from suites import search

from cassandra_ros.errors import CorruptMessage, InvalidExpression
from cassandra_ros.messages.classes import deserialize, installed_definition, message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.field_ends import MAX_SURPLUS, compile_object_check
from cassandra_ros.messages.wire.wire_plan import WirePlan, wire_plan

SEEDS = st.integers(0, 2**32)


def checkExact(plan, wire, may_be_odd=False):
    """Either the columns give the bytes back, or the walk says that they do not."""
    columns, odd = plan.walk(wire)
    assert len(columns) == len(plan.columns)
    assert odd or None not in columns
    if not odd:
        if plan.complete:
            assert plan.build(columns) == wire
    else:
        assert may_be_odd
    for i, column in enumerate(columns):
        if column is not None:
            plan.value(i, column)
    scalars, _ = plan.walk_scalars(wire)
    for column, scalar, found in zip(plan.columns, scalars, columns):
        assert scalar == (found if column.is_scalar else None)
    return columns, odd


def test_every_installed_type():
    names = installedTypes()
    for number, name in enumerate(names):
        plan = wire_plan(installed_definition(name))
        for seed in range(number, number + 12):
            checkExact(plan, WireMaker(plan.definition, seed).make())
            checkExact(plan, WireMaker(plan.definition, seed, odd=True).make(), may_be_odd=True)


@search(300)
@given(SEEDS)
def test_random_definitions(seed):
    plan = WirePlan(parse_definition(*DefinitionMaker(seed).make()))
    checkExact(plan, WireMaker(plan.definition, seed).make())
    checkExact(plan, WireMaker(plan.definition, seed, odd=True).make(), may_be_odd=True)


@search(300)
@given(SEEDS, st.data())
def test_fuzzed_buffers_are_exact_or_odd(seed, data):
    if data.draw(st.booleans(), "installed type"):
        names = installedTypes()
        plan = wire_plan(installed_definition(names[seed % len(names)]))
    else:
        plan = WirePlan(parse_definition(*DefinitionMaker(seed).make()))
    wire = bytearray(WireMaker(plan.definition, seed).make())
    for _ in range(data.draw(st.integers(0, 4), "bits") if wire else 0):
        wire[data.draw(st.integers(0, len(wire) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    cut = data.draw(st.integers(0, len(wire)), "cut")
    fuzzed = bytes(wire[:cut]) + data.draw(st.binary(max_size=9), "surplus")
    checkExact(plan, fuzzed, may_be_odd=True)
    read = plan.reader([c.name for c in plan.all_columns])
    for action in (read, lambda raw: deserialize(message_class(plan.definition), raw)):
        try:
            action(fuzzed)
        except CorruptMessage:
            pass


@search(200)
@given(SEEDS, st.data())
def test_fuzzed_columns_build_or_are_corrupt(seed, data):
    plan = WirePlan(parse_definition(*DefinitionMaker(seed).make()))
    columns, _ = plan.walk(WireMaker(plan.definition, seed).make())
    if columns:
        i = data.draw(st.integers(0, len(columns) - 1))
        changed = data.draw(st.none() | st.binary(max_size=20))
        if data.draw(st.booleans()):
            changed = columns[i][: data.draw(st.integers(0, 9))]
        columns[i] = changed
    try:
        assert isinstance(plan.build(columns), bytes)
    except CorruptMessage as exc:
        assert plan.definition.type in str(exc)
    for i, column in enumerate(columns):
        try:
            plan.value(i, column or b"")
        except CorruptMessage as exc:
            assert plan.columns[i].name in str(exc)


def test_counts_that_lie_cost_nothing():
    others = ["MSG: pkg/E\nstring s\nint8 x", "MSG: pkg/N", "MSG: pkg/F\nint32 a\nint32 b"]
    for text in ("E[] x", "N[] x", "F[] x", "string[] x", "float64[] x", "string x", "uint8[] x"):
        plan = WirePlan(parse_definition("pkg/T", SEPARATOR.join([text, *others])))
        wire = b"\xff\xff\xff\xff" + b"\0" * 50
        tracemalloc.start()
        plan.walk(wire)
        plan.walk_scalars(wire)
        try:
            plan.reader(["x"])(wire)
        except (CorruptMessage, InvalidExpression):
            pass
        assert tracemalloc.get_traced_memory()[1] < 200_000
        tracemalloc.stop()


def column_types(text, *others):
    plan = WirePlan(parse_definition("pkg/T", SEPARATOR.join([text, *others])))
    return {column.name: column.cql_type for column in plan.columns}


def test_types_of_columns():
    text = "\n".join(
        f"{name} {name}_"
        for name in "bool int8 byte uint8 char int16 uint16 int32 uint32 int64 uint64".split()
        + "float32 float64 string time duration".split()
    )
    assert (
        list(column_types(text).values())
        == (
            "boolean tinyint tinyint smallint smallint smallint int int bigint bigint varint "
            "float double text bigint bigint"
        ).split()
    )
    assert column_types("float64[9] a\nuint8[] b\nbool[] c\ntime[2] d\nstring[] e\nint8[0] f") == {
        "a": "blob",
        "b": "blob",
        "c": "blob",
        "d": "blob",
        "e": "frozen<list<text>>",
    }


def test_arrays_of_messages_are_structs_of_lists():
    inner = "MSG: pkg/E\nint32 x\nstring s\nuint64 u\nP p\nfloat32[] f\nstring[] t\nP[] q\nN[] n"
    others = [inner, "MSG: pkg/P\nfloat64 y", "MSG: pkg/N"]
    assert column_types("E[] es\nN[] ns\nN n\nN[3] m\nE e", *others) == {
        "es.x": "frozen<list<int>>",
        "es.s": "frozen<list<text>>",
        "es.u": "frozen<list<varint>>",
        "es.p.y": "frozen<list<double>>",
        "es.f": "frozen<list<blob>>",
        "es.t": "frozen<list<blob>>",
        "es.q": "frozen<list<blob>>",
        "es.n": "frozen<list<blob>>",
        "ns": "blob",
        "e.x": "int",
        "e.s": "text",
        "e.u": "varint",
        "e.p.y": "double",
        "e.f": "blob",
        "e.t": "frozen<list<text>>",
        "e.q.y": "frozen<list<double>>",
        "e.n": "blob",
    }


def test_arrays_and_lists_are_described():
    plan = wire_plan(installed_definition("tf2_msgs/TFMessage"))
    column = next(c for c in plan.columns if c.name == "transforms.header.stamp")
    assert (column.kind, column.field_type, column.array) == ("time", "time", "transforms")
    assert column.is_list
    assert not column.is_scalar


ODD = {
    "bool": (b"\2", True),
    "time": (struct.pack("<II", 1, 10**9), 2 * 10**9),
    "duration": (struct.pack("<ii", 1, -1), 10**9 - 1),
    "string": (b"\2\0\0\0a\xff", "a\ufffd"),
}


@pytest.mark.parametrize("type_", ODD)
def test_what_no_column_can_hold(type_):
    wire, value = ODD[type_]
    plan = WirePlan(parse_definition("pkg/T", f"int8 a\n{type_} b\nint8 c"))
    wire = b"\1" + wire + b"\2"
    columns, odd = plan.walk(wire)
    assert odd
    assert columns == [b"\1", None, b"\2"]
    assert plan.reader(["b", "c"])(wire) == [value, 2]
    with pytest.raises(CorruptMessage, match="column b is missing"):
        plan.build(columns)


@pytest.mark.parametrize("type_", ODD)
def test_what_no_list_can_hold(type_):
    wire, value = ODD[type_]
    for fields in (f"{type_} b", f"{type_} b\nstring s"):
        plan = WirePlan(parse_definition("pkg/T", "E[] e" + SEPARATOR + "MSG: pkg/E\n" + fields))
        element = wire + b"\0\0\0\0" * fields.endswith("\nstring s")
        whole = b"\2\0\0\0" + element * 2
        columns, odd = plan.walk(whole)
        assert odd
        assert columns[0] is None
        assert None not in columns[1:]
        assert plan.reader(["e.b"])(whole) == [[value, value]]


def test_surplus_bytes_keep_the_columns():
    plan = WirePlan(parse_definition("pkg/T", "int8 a\nstring s"))
    assert plan.walk(b"\1\1\0\0\0xyz") == ([b"\1", b"x"], True)
    assert plan.walk(b"\1\1\0\0") == ([None, None], True)
    assert plan.walk(b"") == ([None, None], True)


def test_empty_messages():
    plan = wire_plan(installed_definition("std_msgs/Empty"))
    assert plan.columns == ()
    assert plan.walk(b"") == ([], False)
    assert plan.build([]) == b""
    assert plan.walk(b"x") == ([], True)


def test_floats_keep_every_bit():
    plan = WirePlan(
        parse_definition(
            "pkg/T", "float32 a\nfloat64 b\nP[] p" + SEPARATOR + "MSG: pkg/P\nfloat32 x"
        )
    )
    wire = struct.pack("<IQII", 0x7F800001, 0x7FF0000000000001, 1, 0xFFA00001)
    columns, odd = plan.walk(wire)
    assert not odd
    assert columns[0] == b"\x7f\x80\0\1"
    assert plan.build(columns) == wire


def test_more_fields_than_columns():
    fields = "\n".join(f"int32 x{i}\nfloat32[] a{i}" for i in range(40))
    plan = WirePlan(parse_definition("pkg/T", fields + "\nstring s"))
    assert not plan.complete
    assert [c.name for c in plan.columns] == [*(f"x{i}" for i in range(40)), "s"]
    assert [c.name for c in plan.all_columns if c not in plan.columns] == [
        f"a{i}" for i in range(40)
    ]
    wire = WireMaker(plan.definition, 1).make()
    columns, odd = checkExact(plan, wire)
    assert not odd
    assert plan.reader(["s"])(wire) == [plan.value(40, columns[40])]
    with pytest.raises(CorruptMessage):
        plan.build(columns)
    many = WirePlan(parse_definition("pkg/T", "\n".join(f"int32 x{i}" for i in range(65))))
    assert [c.name for c in many.all_columns if c not in many.columns] == ["x64"]
    assert WirePlan(parse_definition("pkg/T", "\n".join(f"int8 x{i}" for i in range(64)))).complete


def test_a_field_that_does_not_exist():
    with pytest.raises(InvalidExpression, match="no field 'y'"):
        wire_plan(installed_definition("std_msgs/String")).reader(["y"])


def test_plans_are_compiled_once():
    assert wire_plan(installed_definition("std_msgs/String")) is wire_plan(
        installed_definition("std_msgs/String")
    )


def test_objects_without_bytes_are_counted_with_what_they_hold():
    """An array of messages of 1,000 empty ones each takes four bytes."""
    inner = ["MSG: pkg/A\nE[1000] e", "MSG: pkg/E\n"]
    definition = parse_definition("pkg/T", SEPARATOR.join(["A[] a", *inner]))
    check = compile_object_check(definition.type, definition.specs)
    check(struct.pack("<I", MAX_SURPLUS // 1001))
    with pytest.raises(struct.error, match="too many empty messages"):
        check(struct.pack("<I", MAX_SURPLUS // 1001 + 1))
