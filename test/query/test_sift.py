# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What zones and sifts leave out of blocks never matches; of plain fields it is all that does not.

No database: what the server would check of a block is looked up in its zones.
"""

from __future__ import annotations

import math
import operator
import random
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import WireMaker
from query.brute_force import Message, Types, Writer
from query.kinds import KINDS, T0, EdgeMaker, serialized
from query.random_statements import ORDERED, Asker, numbersBeside
from query.test_every_plan import EDGES, TYPES
from query.test_terms import decode, rank
from suites import FURTHER, random_statements, sparing

from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire import message_stacks
from cassandra_ros.messages.wire.zones import zone_map
from cassandra_ros.query.plan.block_filter import compile_sift
from cassandra_ros.query.plan.pushdown import Pushdown
from cassandra_ros.query.rows.projection import Projections
from cassandra_ros.query.rows.result_groups import analyse_select
from cassandra_ros.query.tree.parse import parse_select
from cassandra_ros.store.blocks.codec import pack_block, unpack_block

SIGNS = {"=": operator.eq, "<=": operator.le, ">=": operator.ge}
KINDS_HERE = ("every", "tf", "diagnostics", "scan", "joints", "log", "mixed", "uint64", "string")


class Table(SimpleNamespace):
    """What the language needs of a table; as there, each is another one."""

    __hash__ = object.__hash__


def tableOf(types):
    definition = parse_definition(types.name, types.text)
    return Table(
        name=types.md5sum,
        definition=definition,
        named=False,
        by_field=False,
        packed=True,
        index_fields={},
        columns=("_data",),
        longest_text=0,
        runs=SimpleNamespace(called=lambda text: frozenset()),
    )


def blockOf(wires):
    numbers = list(range(len(wires)))
    return unpack_block(pack_block(numbers, numbers, wires), len(wires), sum(map(len, wires)))


def rowsOf(wires, table):
    same = {"node": "", "name": "", "run": "", "table": table, "columns": (), "topic": "/topic"}
    return [SimpleNamespace(t=T0 + n, key=n, wire=wire, **same) for n, wire in enumerate(wires)]


def similar(types, numbers, count):
    """Messages of few sizes: some are malformed, and some have too many bytes."""
    definition = parse_definition(types.name, types.text)
    few = [EdgeMaker(definition, numbers.random(), odd=n == 2).make() for n in range(3)]
    few.append(WireMaker(definition, numbers.random()).make())
    wires = []
    for _ in range(count):
        wire = bytearray(numbers.choice(few))
        for _ in range(numbers.choice([0, 1, 4])):
            if wire:
                at = numbers.randrange(len(wire))
                wire[at] = numbers.choice([0, 1, 0xFF, wire[at] ^ 1 << numbers.randrange(8)])
        wires.append(bytes(wire) + b"x" * (numbers.random() < 0.05))
    return wires


def serverKeeps(query, zones, columns):
    """Say whether Cassandra would answer with a block of these zones."""
    names = list(columns)

    def passes(term):
        column, sign, raw = term
        held = zones.values[names.index(column)]
        if held is None:
            return False
        kind = columns[column]
        if kind in ("text", "boolean"):
            return SIGNS[sign](held, raw)
        return SIGNS[sign](rank(decode(kind, held)), rank(decode(kind, raw)))

    return all(map(passes, query[0]))


def bucketOf(zones):
    return SimpleNamespace(rows=100, odd=int(zones.odd), closed=True, filled=frozenset())


def isKept(select, table, wires):
    """Say whether a block of these messages is read at all."""
    zones, columns = table.zone_map.measure(wires), table.zone_map.columns
    chosen = Pushdown(select.condition, "filter").choose(table, [bucketOf(zones)])
    if chosen is None:
        return True
    odd = [query for query in chosen if query[0][0][0] == "_odd"]
    others = [query for query in chosen if query not in odd]
    return bool(odd and zones.odd) or any(serverKeeps(q, zones, columns) for q in others)


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@pytest.mark.search
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
@pytest.mark.parametrize("name", sparing(KINDS_HERE, kept=["tf", "mixed", "string"]))
def test_nothing_that_matches_is_left_out(name, caplog):
    caplog.set_level("ERROR", "cassandra_ros")
    kind, numbers = KINDS[name], random.Random(name)
    packs = []
    for types in kind.types:
        table = tableOf(types)
        table.zone_map = zone_map(table.definition)
        packs += [(types, table, similar(types, numbers, 60)) for _ in range(3)]
    messages = []
    for types, _, wires in packs:
        for wire in wires[:25]:
            try:
                messages.append(Message(T0, "", (0, 1), types, types.root().deserialize(wire)))
            except Exception:  # noqa: BLE001, S112 (genpy's many kinds: these bytes are no message)
                continue
    blocks = [(table, wires, blockOf(wires), rowsOf(wires, table)) for _, table, wires in packs]
    tables = list({table.name: table for table, *_ in blocks}.values())
    seen = {"sifted": 0, "skipped": 0, "matching": 0}

    @random_statements(120, least=80 if FURTHER else 1)
    @given(Asker(kind.types, messages, kind.indexes).statements(), st.integers(0, 2**32))
    def check(statement, seed):
        writer = Writer(seed)
        select = parse_select(writer.statement(statement, "/topic"), writer.params)
        select = analyse_select(select, tables)
        projections = Projections(select, tables)
        table, wires, block, rows = blocks[seed % len(blocks)]
        expected = [any(projections.of(table).hits(row)) for row in rows]
        seen["matching"] += any(expected)
        projection = projections.of(table)
        for row in rows[seed % 7 :: 7]:  # the quick way to a row of the result gives the same one
            slow = replace(projection)
            vars(slow)["compiled"] = None  # as if there was no quick way
            assert repr(list(projection.rows(row))) == repr(list(slow.rows(row)))
        sift = compile_sift(select.condition, table.definition)
        mask, unsure = (None, None) if sift is None else sift(block)
        for n, hit in enumerate(expected):
            if unsure is not None and not unsure[n]:
                assert hit == (mask is None or mask[n]), (select.text, writer.params, wires[n])
        if mask is not None:
            assert mask.dtype == bool and len(mask) == len(wires)
            lost = [n for n, hit in enumerate(expected) if hit and not mask[n]]
            assert not lost, (select.text, writer.params, [wires[n] for n in lost])
            seen["sifted"] += 1
        for at in range(0, len(wires), 4):
            if not isKept(select, table, wires[at : at + 4]):
                assert not any(expected[at : at + 4]), (select.text, writer.params)
                seen["skipped"] += 1

    check()
    # With few statements it may happen that zones leave out no block.
    assert min(seen["sifted"], seen["matching"], seen["skipped"] if FURTHER else 1) > 0, seen


ZERO_TO_TWO = [0, 1, 2, 0.5, -0.0, True, False, math.nan, math.inf]


@pytest.mark.parametrize("name", sorted(EDGES))
def test_of_plain_numbers_all_that_does_not_match_is_left_out(name):
    table = tableOf(TYPES)
    wires = [serialized(TYPES.root(**{name: edge})) for edge in EDGES[name]] * 4
    block, rows = blockOf(wires), rowsOf(wires, table)
    beside = {repr(v): v for edge in EDGES[name] for v in (edge, *numbersBeside(edge))}
    values = [*beside.values(), *ZERO_TO_TWO[2:5], math.nan, 3.4028235e38, 1e39, 2**64, -(10**310)]
    for value in values:
        for sign in ORDERED:
            checkExact(f"{name} {sign} ?", [value], table, block, rows)
    for some in (values[:3], values[::2], [math.nan, values[0]], [math.nan]):
        checkExact(f"{name} in ?", [some], table, block, rows)


def checkExact(condition, params, table, block, rows):
    select = parse_select(f"select KEY from topic where {condition}", params)
    projection = Projections(select, [table]).of(table)
    expected = numpy.array([any(projection.hits(row)) for row in rows])
    found, unsure = compile_sift(select.condition, table.definition)(block)
    assert expected.all() if found is None else (found == expected).all(), (condition, params)
    return unsure


KINDS_OF_FIELD = Types(
    "sift_msgs/Kinds",
    "bool flag\ntime at\nduration span\nint32[] ints\ntime[2] both\nstring[] words",
)


@pytest.mark.parametrize(
    "condition",
    [
        *(f"flag {sign} {value}" for sign in ORDERED for value in ("true", "false", 1, 0.5, 2)),
        *(f"at {sign} {ns}" for sign in ORDERED for ns in (0, 5_000_000_007, 5.5, 2**70, -1)),
        *(f"span {sign} {ns}" for sign in ORDERED for ns in (0, -1, -3_000_000_000, 2**70)),
        *("at.secs = 5", "at.nsecs > 6", "span.secs < 0", "span.nsecs >= 999999999"),
        *("ints[0] = 5", "ints[1] > 4", "ints[9] = 0", "ints contains 5", "ints contains 5.5"),
        *(
            "both[1] = 5000000007",
            "both[1].secs = 5",
            "words[0] = 'a'",
            "words contains 'bb'",
            "words contains ''",
        ),
        *("ANY(ints) < 5", "ANY(ints) != 4", "ALL(ints) >= 4", "0 < ALL(ints)", "ALL(ints) = 5"),
        *("ANY(both) > 5.5", "ALL(both) < 5.5", "min(ints) = 0"),
        *("flag = true and at.secs = 5", "flag = false or ints[0] = 5", "words[1] in ('a', 'b')"),
    ],
)
def test_of_other_plain_fields_too(condition, monkeypatch):
    monkeypatch.setattr(message_stacks, "MIN_STACKED", 1)
    table, numbers = tableOf(KINDS_OF_FIELD), random.Random(1)
    wires = []
    for _ in range(120):
        made = KINDS_OF_FIELD.root(flag=numbers.random() < 0.5)
        made.at.secs, made.at.nsecs = numbers.choice([(0, 0), (5, 7), (5, 5 * 10**8)])
        made.span.secs, made.span.nsecs = numbers.choice([(0, 0), (-3, 0), (-1, 999999999)])
        made.ints = [numbers.choice([4, 5, 0])] * numbers.randrange(3)
        made.both[1].secs, made.both[1].nsecs = numbers.choice([(5, 7), (6, 7)])
        made.words = [numbers.choice(["a", "b", "bb", ""]) for _ in range(numbers.randrange(2))]
        wires.append(serialized(made))
    unsure = checkExact(condition, (), table, blockOf(wires), rowsOf(wires, table))
    # The minimum is compared as any element is; of heads alone nobody knows what follows them.
    of_heads = not set(re.findall("[a-z]+", condition)) & {"ints", "both", "words"}
    assert unsure.any() == ("min(" in condition or of_heads)


def test_what_is_not_understood_leaves_out_nothing():
    definition = parse_definition(TYPES.name, TYPES.text)
    for text in (
        "f + 1 > 2",
        "f < d",
        "abs(f) = 1",
        "not f = 1",
        "f is null",
        "KEY > 5",
        "f = 1 or not d = 1",
        "NODE = 'x' or f = 1",
    ):
        condition = parse_select(f"select KEY from topic where {text}", ()).condition
        assert compile_sift(condition, definition) is None
    both = parse_select("select KEY from topic where f = 1 and not d = 1", ()).condition
    block = blockOf([serialized(TYPES.root(f=n, d=1)) for n in (0, 1)] * 20)
    assert compile_sift(both, definition)(block).mask.tolist() == [False, True] * 20


NESTED = "sift_msgs/Item[] items\n" + "=" * 80 + "\nMSG: sift_msgs/Item\nstring name\nfloat64[] w"


@pytest.mark.parametrize("condition", ["items.w[1] = 5", "items[1].w[1] = 5", "items.w contains 5"])
def test_arrays_in_elements_of_any_size_are_not_sifted_by_the_first(condition):
    types = Types("sift_msgs/Nested", NESTED)
    item, table = types.classes["sift_msgs/Item"], tableOf(types)
    made = types.root(items=[item(name="a", w=[1, 2]), item(name="bb", w=[3, 5])])
    wires = [serialized(made)] * 20
    select = parse_select(f"select KEY from topic where {condition}", ())
    assert all(any(Projections(select, [table]).of(table).hits(r)) for r in rowsOf(wires, table))
    sift = compile_sift(select.condition, table.definition)
    assert sift is None or sift(blockOf(wires)).mask is None


def test_texts_in_one_element_are_not_looked_for_in_the_first():
    text = NESTED.replace("string name", "string[] names")
    types = Types("sift_msgs/Named", text)
    item, table = types.classes["sift_msgs/Item"], tableOf(types)
    made = types.root(items=[item(names=["a", "b", "c"]), item(names=["d"])])
    wires = [serialized(made)] * 20
    select = parse_select("select KEY from topic where items[1].names contains 'd'", ())
    assert all(any(Projections(select, [table]).of(table).hits(r)) for r in rowsOf(wires, table))
    sift = compile_sift(select.condition, table.definition)
    assert sift is None or sift(blockOf(wires)).mask is None


DEEP = "\n".join(
    [
        "sift_msgs/Item[] items\nint32[] ints\nstring text",
        "=" * 80,
        "MSG: sift_msgs/Item\nsift_msgs/Small[] more",
        "=" * 80,
        "MSG: sift_msgs/Small\nint32 a",
    ]
)


@pytest.mark.parametrize(
    "condition",
    [
        *("ANY(ints) NOT IN (7)", "ALL(ints) NOT IN (6)", "ANY(ints) NOT BETWEEN 5 AND 5"),
        *("items.more[1].a = 9", "items[1].more[0].a = 9", "items[0].more[1].a = 3"),
        *("text = '\ufffd'", "text in ('\ufffd', 'b')"),
    ],
)
def test_messages_that_match_are_never_sifted_out(condition, monkeypatch):
    """Elements beside others, an element of an element, and a text that is not UTF-8."""
    monkeypatch.setattr(message_stacks, "MIN_STACKED", 1)
    types = Types("sift_msgs/Deep", DEEP)
    item, small = (types.classes[f"sift_msgs/{name}"] for name in ("Item", "Small"))
    made = types.root(ints=[5, 4], text="#")
    made.items = [item(more=[small(1), small(3)]), item(more=[small(9), small(9)])]
    wires = [serialized(made).replace(b"#", b"\xff")] * 20
    table = tableOf(types)
    select = parse_select(f"select KEY from topic where {condition}", ())
    assert all(any(Projections(select, [table]).of(table).hits(r)) for r in rowsOf(wires, table))
    sift = compile_sift(select.condition, table.definition)
    assert sift is None or sift(blockOf(wires)).mask is None
