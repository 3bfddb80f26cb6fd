# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Columns of Arrow hold what the message objects hold, whatever the type and the layouts."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker
from messages.test_message_stacks import manyWires
from suites import search

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import deserialize, message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.field_ends import MAX_SURPLUS
from cassandra_ros.query.arrays.arrow_columns import make_columns
from cassandra_ros.query.arrays.arrow_types import adapt, fields_of, unite_schemas, wanted_columns
from cassandra_ros.query.arrays.batch import StackedBatch, group_by_size, join_groups
from cassandra_ros.query.arrays.row_columns import RowColumns


def columns_of(definition, wires, wanted=None):
    """Columns of some messages as a struct array; validated, as another program would."""
    fields = fields_of(definition, wanted)
    made = make_columns(pa, definition, fields, group_by_size(wires), len(wires))
    for field, array in zip(fields, made.arrays):
        array.validate(full=True)
        assert array.type == field.type(pa)
    return fields, made


def expected(message, fields):
    found = {}
    for field in fields:
        value = getattr(message, field.field.name, None)
        if value is None:
            value = getattr(message, field.field.name + "_")
        found[field.name] = expected_value(value, field)
    return found


def expected_value(value, field):
    if field.is_bytes:
        return bytes(value)
    if field.field.is_array:
        return [one(each, field) for each in value]
    return one(value, field)


def one(value, field):
    base = field.field.base
    if field.children:
        return expected(value, field.children)
    if base in ("time", "duration"):
        return value.secs * 10**9 + value.nsecs
    if base == "bool":
        return bool(value)
    return value


def plain(array):
    """Python values of an array, times as integer ns."""
    if pa.types.is_struct(array.type):
        parts = [plain(array.field(n)) for n in range(array.type.num_fields)]
        names = [field.name for field in array.type]
        return [dict(zip(names, values)) for values in zip(*parts)]
    if pa.types.is_list(array.type):
        values, ends = plain(array.values), array.offsets.to_pylist()
        return [values[a:b] for a, b in zip(ends, ends[1:])]
    if pa.types.is_timestamp(array.type):
        return array.cast(pa.int64()).to_pylist()
    return array.to_pylist()


def same(one, two):
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(same(one[name], two[name]) for name in one)
    if isinstance(one, list):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(two, str) and "\N{REPLACEMENT CHARACTER}" in two:
        return "\\x" in one  # genpy replaces the bytes that are escaped here
    if isinstance(one, float):
        return struct.pack("<d", one) == struct.pack("<d", two) or (one != one and two != two)
    return one == two


@search(120)
@given(seed=st.integers(0, 2**32))
def test_columns_hold_what_message_objects_hold(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    wires = manyWires(definition, seed)
    fields, made = columns_of(definition, wires)
    cls, unread = message_class(definition), set(made.unread.tolist())
    rows = list(zip(*map(plain, made.arrays))) if fields else []
    for n, (wire, row) in enumerate(zip(wires, rows)):
        try:
            message = deserialize(cls, wire)
        except CorruptMessage:
            continue  # a column may still be read
        assert n not in unread
        assert same(dict(zip([field.name for field in fields], row)), expected(message, fields))


@search(40)
@given(seed=st.integers(0, 2**32))
def test_some_columns_are_those_of_all(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    wires = manyWires(definition, seed)
    every, whole = columns_of(definition, wires)
    for field, array in zip(every, whole.arrays):
        inner = field.children[-1].name.lower() if field.children else None
        wanted = {field.name.lower(): {inner: {}} if inner else {}}
        (only,), made = columns_of(definition, wires, wanted)
        kept = adapt(pa, array, only.type(pa)) if inner else array
        assert same(plain(made.arrays[0]), plain(kept))


MANY = 2 * MAX_SURPLUS


def test_a_message_that_counts_too_many_empty_messages_cannot_be_read():
    """Four bytes may mean gigabytes of elements; here, should they be read, only megabytes."""
    text = f"Empty[] e\nInner[] i\nint32 x\n{'=' * 80}\nMSG: a/Empty\nint8[0] n\n"
    text += f"{'=' * 80}\nMSG: a/Inner\nEmpty[] e\n"
    definition = parse_definition("a/B", text, None)
    counts = [(2, 3, 1), (MANY, 0, 2), (0, MANY, 3), (4, 0, 4)] * 5
    counts += [(0, MANY, n) for n in range(10)]  # of one layout
    wires = [struct.pack("<IIIi", e, 1, inner, x) for e, inner, x in counts]
    fields, made = columns_of(definition, wires)
    readable = [max(e, inner) < 5 for e, inner, _ in counts]
    assert made.unread.tolist() == [n for n, can in enumerate(readable) if not can]
    rows = zip(*(array.to_pylist() for array in made.arrays))
    for can, (e, inner, x), row in zip(readable, counts, rows):
        empty = {"n": []}
        expected_row = ([empty] * e, [{"e": [empty] * inner}], x) if can else (None, None, None)
        assert row == expected_row


def test_blocks_are_joined_in_their_order():
    definition = parse_definition("a/B", "int32 x\nstring s\n", None)
    parts = [[struct.pack("<iI", n, len(t)) + t for n, t in enumerate(texts)] for texts in TEXTS]
    blocks = [
        StackedBatch(None, "", times, times, list(group_by_size(part)))
        for part, times in [(part, np.zeros(len(part), np.int64)) for part in parts]
    ]
    count = sum(map(len, parts))
    made = make_columns(pa, definition, fields_of(definition, None), join_groups(blocks), count)
    assert made.arrays[1].to_pylist() == [t.decode() for texts in TEXTS for t in texts]


TEXTS = [[b"a" * (n % 3) for n in range(20)], [b"b"] * 9, [b"", b"xyz"]]


def test_a_message_that_cannot_be_read_is_null():
    definition = parse_definition("a/B", "int32 x\nint32[] v\nstring s\n", None)
    fine = struct.pack("<iIiI", 7, 1, 8, 1) + b"t"
    fields, made = columns_of(definition, [fine, None, fine[:9], fine])
    assert made.unread.tolist() == [1, 2]
    assert [array.to_pylist() for array in made.arrays] == [
        [7, None, None, 7],
        [[8], None, None, [8]],
        ["t", None, None, "t"],
    ]


def test_columns_of_rows_may_be_cut_out_of_their_messages():
    """Then a text need not be UTF-8, a bool may be 2, and a message may be unreadable."""
    definition = parse_definition("a/B", "string text\nint32 x\nbool b\nint32 y\n", None)
    table = SimpleNamespace(by_field=True, definition=definition, columns=("text", "x", "b", "y"))
    fields = fields_of(definition, wanted_columns([["text"], ["b"]]))
    reader = RowColumns.of(pa, table, fields)
    assert reader.names == ["text", "b"]
    made = reader.make([(b"fine", b"\1"), None, (b"a\xff", b"\2"), (b"", b"\0")])
    assert [array.to_pylist() for array in made] == [
        ["fine", None, "a\\xff", ""],
        [True, None, True, False],
    ]
    assert [array.to_pylist() for array in reader.make([None])] == [[None], [None]]


def test_text_that_is_not_utf8_is_escaped():
    definition = parse_definition("a/B", "string s\n", None)
    texts = [b"\xff", "ä".encode(), b"\xc3", b"\xa4", b""]
    wires = [struct.pack("<I", len(text)) + text for text in texts]
    _, made = columns_of(definition, wires)
    assert made.arrays[0].to_pylist() == ["\\xff", "ä", "\\xc3", "\\xa4", ""]


def test_names_are_unique_without_regard_to_case():
    text = (
        "int32 x\nint32 X\nint32 key\nB b\n" + "=" * 80 + "\nMSG: a/B\nint8 y\nint8 Y\nint8 y_1\n"
    )
    definition = parse_definition("a/A", text, None)
    fields = fields_of(definition, None)
    assert [field.name for field in fields] == ["x", "X_1", "key_1", "b"]
    assert [field.name for field in fields[3].children] == ["y", "Y_1", "y_1_1"]


def test_messages_without_fields_have_no_column():
    text = "int32 x\nEmpty e\nEmpty[] many\n" + "=" * 80 + "\nMSG: a/Empty\n"
    fields = fields_of(parse_definition("a/A", text, None), None)
    assert [field.name for field in fields] == ["x"]


SCHEMAS = [
    pa.schema([("a", pa.int32()), ("s", pa.struct([("x", pa.float32()), ("t", pa.string())]))]),
    pa.schema([("a", pa.float64()), ("s", pa.struct([("x", pa.float64())])), ("b", pa.bool_())]),
    pa.schema([("A", pa.uint8()), ("s", pa.struct([("x", pa.list_(pa.int8()))]))]),
]


def test_definitions_are_united_by_name():
    united = unite_schemas(pa, SCHEMAS[:2])
    inner = pa.struct([("x", pa.float64()), ("t", pa.string())])
    assert united == pa.schema([("a", pa.float64()), ("s", inner), ("b", pa.bool_())])
    array = pa.array([{"x": 0.5, "t": "u"}, None], SCHEMAS[0].field("s").type)
    assert adapt(pa, array, inner).to_pylist() == [{"x": 0.5, "t": "u"}, None]
    array = pa.array([{"x": 0.5}], SCHEMAS[1].field("s").type)
    assert adapt(pa, array, inner).to_pylist() == [{"x": 0.5, "t": None}]


def test_types_that_have_nothing_in_common_become_json():
    united = unite_schemas(pa, SCHEMAS)
    assert united.field("a").type == pa.float64()
    inner = united.field("s").type
    assert inner.field("x").type == pa.string()
    array = pa.array([{"x": [1, 2]}, {"x": None}], SCHEMAS[2].field("s").type)
    assert adapt(pa, array, inner).to_pylist() == [
        {"x": "[1, 2]", "t": None},
        {"x": None, "t": None},
    ]
