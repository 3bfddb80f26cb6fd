# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Arrays of fields beside message objects and beside the language, without a database."""

from __future__ import annotations

import itertools
import math
import struct
import tracemalloc
from collections import namedtuple
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import PRIMITIVES, DefinitionMaker, WireMaker, installedTypes
from query.rows import attribute, plain
from suites import FEW_FORMATS, search, sparing

from cassandra_ros.errors import CorruptMessage, InvalidQuery
from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    serialize,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.query.arrays import batch as batches
from cassandra_ros.query.arrays import table_values
from cassandra_ros.query.arrays.batch import row_batches
from cassandra_ros.query.arrays.field_arrays import as_arrays, gather_fields
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.rows.projection import Projection
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.parse import parse_select

SEEDS = st.integers(0, 2**32)
EVERY = "\n".join(
    [
        *(f"{kind} one_{kind}" for kind in PRIMITIVES),
        *(f"{kind}[] any_{kind}" for kind in PRIMITIVES),
        *(f"{kind}[3] three_{kind}" for kind in PRIMITIVES),
    ]
)

COUNTER = itertools.count()
"""Rows of one time are in the order in which they were made."""
Topic = namedtuple("Topic", "name tables")


class Table:
    """What arrays need of a TopicTable."""

    def __init__(self, definition, fmt="ros", name="table", named=False):
        self.name, self.definition, self.named = name, definition, named
        self.storage = format_class(fmt)(definition.type, definition.md5sum, definition)
        self.by_field = self.storage.BY_FIELD
        self.columns = tuple(self.storage.getColValidationClasses())
        self.runs = None


class Row:
    """What arrays need of a StoredRow."""

    node, topic = "robot", "/topic"

    def __init__(self, table, wire, t=0, held=None):
        self.table, self.t, self.size, self.name = table, t, len(wire), f"name {t}"
        self.columns, self.odd, self.raw = table.storage.encode_wire(wire)
        if held is not None:
            self.columns = [c for n, c in zip(table.columns, self.columns) if n in held]
        self.bytes, self.key, self.seq = wire, t, next(COUNTER)
        self.seen = 0

    @property
    def wire(self):
        self.seen += 1
        if self.bytes is None:
            raise CorruptMessage("no message")
        return self.bytes


def gather(rows, fields=None, where=None, tables=None):
    tables = tables or list({row.table.name: row.table for row in rows}.values())
    topic = Topic("/topic", tables)
    return as_arrays(gather_fields(topic, fields, where, partial(row_batches, rows)))


def read_in_batches_of(count, monkeypatch):
    """Few messages are a batch, and are converted together."""
    monkeypatch.setattr(batches, "ROW_BATCH_MESSAGES", count)
    monkeypatch.setattr(table_values, "OTHER_MESSAGES", count)
    monkeypatch.setattr(table_values, "STACKED_MESSAGES", count)


def shown(value):
    """What an array holds, as plain Python has it."""
    if value is np.ma.masked:
        return None
    if isinstance(value, np.ma.MaskedArray) and value.ndim > 1:
        return [None if element.mask.all() else shown(element) for element in value]
    if isinstance(value, np.ma.MaskedArray):
        return [shown(element) for element in value]
    if isinstance(value, np.ndarray):
        return (
            [shown(element) for element in value.tolist()]
            if value.dtype != object
            else [shown(element) for element in value]
        )
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (bytes, list, tuple)):
        return [shown(element) for element in value]
    return plain(value)


def same(left, right):
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(same, left, right))
    if isinstance(left, float) and math.isnan(left):
        return isinstance(right, float) and math.isnan(right)
    return left == right and isinstance(left, bool) == isinstance(right, bool)


def isNothing(ref, definition):
    """A field inside an array of fixed length 0: it has no bytes, and its number is unknown."""
    msg_type, lengths = definition.type, []
    for step in ref.steps:
        field = next(f for f in definition.specs[msg_type].fields if f.name == step.name)
        msg_type = field.type
        lengths.append(field.length)
    return 0 in lengths and len(ref.arrays) > 0


def check(definition, wires, fmt):
    """All fields of some messages, beside those of the message objects."""
    table = Table(definition, fmt)
    found = gather([Row(table, wire, t) for t, wire in enumerate(wires)])
    assert found.pop("KEY").tolist() == list(range(len(wires)))
    messages = [deserialize(message_class(definition), wire) for wire in wires]
    fields = all_fields(definition)
    assert list(found) == [ref.name for ref in fields]
    for ref in fields:
        if isNothing(ref, definition):
            continue
        expected = [shown(attribute(message, ref.column)) for message in messages]
        assert same(shown(found[ref.name]), expected), (definition.type, ref.name)
    return found


@pytest.mark.parametrize("fmt", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
@search(100)
@given(seed=SEEDS, odd=st.booleans())
def test_every_kind_of_field(fmt, seed, odd):
    definition = parse_definition("pkg/Every", EVERY, None)
    maker = WireMaker(definition, seed, odd=odd, signalling=False)
    found = check(definition, [maker.make() for _ in range(5)], fmt)
    for kind in PRIMITIVES:
        wanted = {"byte": "int8", "char": "uint8", "time": "int64", "duration": "int64"}
        dtype = np.dtype(object if kind == "string" else wanted.get(kind, kind))
        assert found[f"one_{kind}"].dtype == dtype
        assert found[f"three_{kind}"].dtype == dtype
        assert found[f"three_{kind}"].shape == (5, 3)
        rows = found[f"any_{kind}"]
        lengths = {len(array) for array in rows}
        assert rows.shape == ((5,) if len(lengths) > 1 else (5, *lengths))
        assert rows.dtype == (dtype if len(lengths) == 1 else object)
        assert {array.dtype for array in rows} == {dtype}


@pytest.mark.suite("all", "a search over random types")
@pytest.mark.parametrize("fmt", ["ros", "binary"])
@search(200)
@given(seed=SEEDS, odd=st.booleans())
def test_random_types(fmt, seed, odd):
    definition = parse_definition(*DefinitionMaker(seed, depth=3).make())
    maker = WireMaker(definition, seed, odd=odd, signalling=False)
    check(definition, [maker.make() for _ in range(3)], fmt)


def test_installed_types():
    for number, msg_type in enumerate(installedTypes()):
        definition = installed_definition(msg_type)
        maker = WireMaker(definition, number, odd=True, signalling=False)
        check(definition, [maker.make() for _ in range(2)], "ros")


def language(rows, select):
    """The rows of a statement, as the query language gives them."""
    projection = Projection.compile(select, rows[0].table, Findings(select.text))
    return [[shown(value) for value in line] for row in rows for line in projection.rows(row)]


@search(400)
@given(seed=SEEDS, data=st.data())
def test_rows_per_element_are_those_of_the_language(seed, data):
    """Fields inside of arrays, with conditions on some of them, of random types."""
    definition = parse_definition(*DefinitionMaker(seed, depth=3).make())
    every = [ref for ref in all_fields(definition) if not isNothing(ref, definition)]
    if not every:
        return
    fmt = data.draw(st.sampled_from(["ros", "binary"]))
    asked = data.draw(st.lists(st.sampled_from(every), min_size=1, max_size=3))
    tested = data.draw(st.none() | st.sampled_from(every))
    fields = ["KEY", *(data.draw(indexed(ref)) for ref in asked)]
    where = None if tested is None else f"{tested.name} IS NOT NULL"
    if tested is not None and not tested.is_array and data.draw(st.booleans()):
        if tested.type == "string":
            where = f"{tested.name} > 'b'"
        elif tested.type not in ("time", "duration", "bool"):
            where = f"{tested.name} >= 1"
    text = f"SELECT {', '.join(fields)} FROM /topic" + (f" WHERE ({where})" if where else "")
    maker = WireMaker(definition, seed, odd=data.draw(st.booleans()), signalling=False)
    table = Table(definition, fmt)
    rows = [Row(table, maker.make(), t) for t in range(4)]
    try:
        select = parse_select(text)
        findings = Findings(text)
        projection = Projection.compile(select, table, findings)
        findings.check()
        expected = language(rows, select)
    except InvalidQuery:
        with pytest.raises(InvalidQuery):
            gather(rows, fields, where)
        return
    if where:  # the condition on whole messages is the reader's
        keys = {line[0] for line in expected}
        rows = [row for row in rows if row.t in keys]
    found = gather(rows, fields, where, [table])
    columns = [shown(array) for array in found.values()]
    assert [output.name for output in projection.groups[0]] == ["KEY"]
    assert same([list(line) for line in zip(*columns)], unique(expected, projection))


def unique(lines, projection):
    """Rows without the columns that were asked for twice."""
    names = [output.name for group in projection.groups for output in group]
    first = [names.index(name) for name in dict.fromkeys(names)]
    return [[line[n] for n in first] for line in lines]


@st.composite
def indexed(draw, ref):
    """The name of a field, with an index somewhere or none; of a time perhaps its secs."""
    parts = ref.name.split(".")
    many = [n for n, step in enumerate(ref.steps) if step.many]
    if many and draw(st.booleans()):
        parts[draw(st.sampled_from(many))] += f"[{draw(st.integers(0, 2))}]"
    if ref.is_array and draw(st.booleans()):
        parts[-1] += f"[{draw(st.integers(0, 4))}]"
    if ref.type in ("time", "duration") and draw(st.booleans()):
        parts.append(draw(st.sampled_from(["secs", "nsecs"])))
    return ".".join(parts)


INT64 = parse_definition("pkg/A", "int64 x\nint32[] some\nfloat32 f", None)


def wire_of(x, some=(), f=0.0):
    return struct.pack(f"<qI{len(some)}if", x, len(some), *some, f)


def test_what_is_missing_is_masked():
    table = Table(INT64)
    rows = [Row(table, wire_of(1, [7, 8])), Row(table, wire_of(2, [9]))]
    found = gather(rows, ["some[1]", "x AS number", "KEY AS t", "NODE"])
    assert list(found) == ["some[1]", "number", "t", "NODE"]
    assert isinstance(found["some[1]"], np.ma.MaskedArray)
    assert found["some[1]"].tolist() == [8, None]
    assert found["some[1]"].dtype == np.int32
    assert type(found["number"]) is np.ndarray
    assert found["t"].tolist() == [0, 0]
    assert found["NODE"].tolist() == ["robot", "robot"]


def test_computed_integers_are_int64_where_they_fit():
    table = Table(INT64)
    rows = [Row(table, wire_of(x, [1] * n)) for x, n in ((1, 0), (-(2**63), 2))]
    found = gather(rows, ["len(some) AS n", "sum(some)", "x - 1", "x / 2", "x * 1ns", "KEY + 1s"])
    assert [each.dtype.kind for each in found.values()] == list("iiOfii")
    assert shown(found["n"]) == [0, 2]
    assert shown(found["sum(some)"]) == [None, 2]
    assert shown(found["x - 1"]) == [0, -(2**63) - 1]
    assert shown(found["x * 1ns"]) == [1, -(2**63)]
    with pytest.raises(InvalidQuery, match="beyond int64"):
        gather(rows, ["x * 1s"])


def test_comments_hide_nothing():
    rows = [Row(Table(INT64), wire_of(1))]
    assert gather(rows, ["x -- the number"], "x = 1 -- one")["x"].tolist() == [1]


def test_names_as_keys(monkeypatch):
    monkeypatch.setattr(batches, "ROW_BATCH_MESSAGES", 1)
    table = Table(INT64, named=True)
    rows = [Row(table, wire_of(1), t) for t in (5, 6)]
    assert gather(rows, "KEY, x")["KEY"].tolist() == ["name 5", "name 6"]


def test_nothing_has_types_all_the_same():
    found = gather([], None, tables=[Table(parse_definition("pkg/Every", EVERY, None))])
    assert found["KEY"].dtype == np.int64
    assert found["one_uint64"].dtype == np.uint64
    assert found["three_float32"].shape == (0, 3)
    assert found["three_float32"].dtype == np.float32
    assert found["any_float32"].dtype == object
    assert {len(array) for array in found.values()} == {0}


OTHERS = {
    # definition: type of x beside int64, and whether 5 is x there
    "int8 x": (np.int64, True),
    "uint32 x": (np.int64, True),
    "float64 x": (object, True),
    "uint64 x": (object, True),
    "string x": (object, False),
    "bool x": (object, False),
    "int64[] x": (object, False),
    "int64[2] x": (object, False),
    "int64 y": (np.int64, False),
}


@pytest.mark.parametrize("text", OTHERS)
def test_several_definitions(text):
    """Rows of two types in turn: in the order of their keys, and in a type that holds both."""
    dtype, is_five = OTHERS[text]
    other = Table(parse_definition("pkg/B", text, None), "binary", "other")
    if is_five:
        code = {"int8": "b", "uint32": "I", "float64": "d", "uint64": "Q"}[text.split()[0]]
        wires = [struct.pack("<" + code, 5)] * 3
    else:
        wires = [WireMaker(other.definition, seed).make() for seed in range(3)]
    table = Table(INT64)
    big = 2**63 - 1
    rows = [
        *(Row(table, wire_of(big - n), n) for n in range(3)),
        *(Row(other, wires[n], 10 + 2 * n) for n in range(3)),
        *(Row(table, wire_of(n), 11 + 2 * n) for n in range(3)),
    ]
    found = gather(rows, ["KEY", "x", "f"])
    assert found["KEY"].tolist() == [0, 1, 2, 10, 11, 12, 13, 14, 15]
    assert found["x"].dtype == dtype
    assert shown(found["x"])[:3] == [big, big - 1, big - 2]
    assert shown(found["x"])[4::2] == [0, 1, 2]
    expected = [None, None, None]
    if "x" in text:
        message = message_class(other.definition)
        expected = [shown(deserialize(message, wire).x) for wire in wires]
    assert same(shown(found["x"])[3::2], expected)
    assert shown(found["f"]) == [0.0] * 3 + [None, 0.0] * 3
    assert found["f"].dtype == np.float32


def test_fixed_arrays_of_two_definitions():
    three, four = (
        Table(parse_definition("pkg/A", f"float64[{n}] x", None), name=str(n)) for n in "34"
    )
    rows = [Row(three, struct.pack("<3d", 1, 2, 3)), Row(four, struct.pack("<4d", 1, 2, 3, 4))]
    found = gather(rows, ["x"])["x"]
    assert found.dtype == object
    assert shown(found) == [[1, 2, 3], [1, 2, 3, 4]]


LENGTHS = ([4] * 6, [0] * 6, [4], [4, 4, 4, 3, 3, 3], [3, 4] * 3, [])
"""Number of elements in each message."""


@pytest.mark.parametrize("fmt", FORMAT_NAMES)
@pytest.mark.parametrize("batch", [3, 4096])
def test_arrays_of_one_length_have_two_dimensions(fmt, batch, monkeypatch):
    """However many messages are read together: what counts is all that are returned."""
    read_in_batches_of(batch, monkeypatch)
    definition = parse_definition("pkg/Scan", "float32[] ranges\nstring[] names", None)
    make, table = message_class(definition), Table(definition, fmt)
    for lengths in LENGTHS:
        messages = [
            make(ranges=[n + i / 4 for i in range(size)], names=[f"{n}.{i}" for i in range(size)])
            for n, size in enumerate(lengths)
        ]
        rows = [Row(table, serialize(message), n) for n, message in enumerate(messages)]
        found = gather(rows, ["ranges", "names"], tables=[table])
        same_length = len(set(lengths)) == 1
        shape = (len(lengths), lengths[0]) if same_length else (len(lengths),)
        assert found["ranges"].shape == found["names"].shape == shape
        assert found["ranges"].dtype == (np.float32 if same_length else object)
        assert found["names"].dtype == object
        for name, array in found.items():
            assert type(array) is np.ndarray
            # One by one they are the same in both shapes.
            assert shown(list(array)) == [getattr(message, name) for message in messages]
        assert {array.dtype for array in found["ranges"]} <= {np.dtype(np.float32)}


@pytest.mark.parametrize("other", ["float64[] x\nbool b", "float64[3] x", "float32[3] x"])
def test_arrays_of_two_definitions_have_two_dimensions_where_their_lengths_agree(other):
    tables = [
        Table(parse_definition("pkg/A", text, None), name=text) for text in ("float32[] x", other)
    ]

    def row(table, values, t):
        make = message_class(table.definition)
        return Row(table, serialize(make(x=values)), t)

    second = row(tables[1], [4, 5, 6], 2)
    found = gather([row(tables[0], [1, 2, 3], 1), second], ["x"])["x"]
    assert found.dtype == (np.float64 if "float64" in other else np.float32)
    assert found.tolist() == [[1, 2, 3], [4, 5, 6]]
    found = gather([row(tables[0], [1, 2], 1), second], ["x"])["x"]
    assert (found.shape, found.dtype) == ((2,), object)
    assert shown(found) == [[1, 2], [4, 5, 6]]


def test_arrays_that_some_messages_lack_lie_in_objects():
    """None is an answer of its own, which no row of numbers can be."""
    table, other = Table(INT64), Table(parse_definition("pkg/B", "int8 y", None), name="other")
    rows = [Row(table, wire_of(1, [7, 8])), Row(other, b"\1", 1), Row(table, wire_of(2, [9, 9]), 2)]
    found = gather(rows, ["some"])["some"]
    assert (found.shape, found.dtype) == ((3,), object)
    assert shown(found) == [[7, 8], None, [9, 9]]


def test_a_message_that_cannot_be_read_is_missing(caplog):
    table = Table(INT64)
    broken = Row(table, wire_of(1), 2)
    broken.columns, broken.bytes = [None] * 3, None
    rows = [Row(table, wire_of(1), 1), broken, Row(table, wire_of(3), 3)]
    found = gather(rows, ["x", "some", "some[0]"])
    assert shown(found["x"]) == [1, None, 3]
    assert shown(found["some"]) == [[], None, []]
    assert shown(found["some[0]"]) == [None] * 3
    assert "cannot be read" in caplog.text


def test_columns_are_used_where_there_are_any():
    """No row of format ros is asked for its bytes, also where only some columns were read."""
    table = Table(INT64)
    whole = [Row(table, wire_of(n, [n], n / 8)) for n in range(3)]
    some = [Row(table, wire_of(n, [n], n / 8), held=("x", "f")) for n in range(3)]
    for rows in (whole, some):
        found = gather(rows, ["f", "x"])
        assert found["f"].tolist() == [0, 0.125, 0.25]
        assert found["x"].tolist() == [0, 1, 2]
        assert not sum(row.seen for row in rows)


def test_only_the_columns_that_are_needed_are_read():
    asked = []
    table = Table(INT64)
    binary = Table(INT64, "binary", "binary")

    def read(parts):
        asked.append([parts(each).columns for each in (table, binary)])
        return []

    topic = Topic("/topic", [table, binary])
    for fields in (["f", "x"], ["KEY"], ["some[3]"]):
        gather_fields(topic, fields, None, read)
    assert asked == [[["x", "f"], None], [[], []], [["some"], None]]


@pytest.mark.parametrize(
    ("fields", "where", "text"),
    [
        (["y"], None, "has no field y"),
        ([], None, "expected"),
        (["count(*)"], None, "count(*) is one value"),
        (["distinct x"], None, "DISTINCT stands in a statement"),
        (["x FROM /other"], None, "FROM"),
        (["x FROM /topic WHERE x = 7 --"], None, "FROM"),
        ([5], None, "not int"),
        (["x"], "y = 1", "has no field y"),
        (["x"], "x = ", "expected"),
        (["x"], "x = 1) OR (x = 2", "')'"),
        (["x"], "x = 1 LIMIT 1", "LIMIT"),
        (["x"], ("x = ?", []), "1 parameters"),
        (["x"], ("x = ?", 1, 2), "a statement is text"),
        (["x AS a", "f AS a"], None, "both f and x are called a"),
    ],
)
def test_what_cannot_be_asked(fields, where, text):
    with pytest.raises(InvalidQuery) as wrong:
        gather([Row(Table(INT64), wire_of(1))], fields, where)
    assert text in str(wrong.value)


class Many:
    """Rows that are made while they are read, as a cursor does."""

    def __init__(self, table, count):
        self.table, self.count = table, count

    def __iter__(self):
        for n in range(self.count):
            yield Row(self.table, wire_of(n << 20, [n] * 4, n), n)


@pytest.mark.suite("all", "large messages, to see how much memory they take")
@pytest.mark.parametrize("fmt", ["ros", "binary"])
def test_no_python_object_is_kept_for_a_number(fmt, monkeypatch):
    """An int or float takes 24 bytes, and 8 more in a list; here it is its own 4 or 8."""
    read_in_batches_of(200, monkeypatch)
    count = 60_000
    table = Table(INT64, fmt)
    topic = Topic("/topic", [table])
    fields = ["KEY", "x", "f", "some[2]"]
    size = 8 + 8 + 4 + 4
    gather(list(Many(table, 10)), fields)
    tracemalloc.start()
    try:
        found = gather_fields(topic, fields, None, partial(row_batches, Many(table, count)))
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sum(array.values.nbytes for array in found.values()) == count * size
    # Half of what objects for one of the four fields would take: threads of the tests take some.
    margin = count * 32 // 2
    assert kept < count * size + margin
    # Beside the result: one column twice while it is joined, and a batch.
    batch = batches.ROW_BATCH_MESSAGES * 1500
    assert peak < count * (size + 8) + batch + margin, (peak / count, batch / count)


def test_batches_are_bounded_in_bytes(monkeypatch):
    sizes = []
    flush = table_values.TableValues.flush
    monkeypatch.setattr(
        table_values.TableValues, "flush", lambda self: (sizes.append(self._bytes), flush(self))
    )
    table = Table(parse_definition("pkg/Blob", "uint8[] data", None))
    wire = struct.pack("<I", 2**20) + bytes(2**20)
    found = gather([Row(table, wire[: 4 + 2**20]) for _ in range(20)], ["data"])
    assert len(found["data"]) == 20
    assert max(sizes) <= batches.ROW_BATCH_BYTES + 2**20
    assert len([size for size in sizes if size]) == 3
