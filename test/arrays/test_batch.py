# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Batches hold what the messages are, however rows were cut into them."""

from __future__ import annotations

import gc
import weakref
from itertools import groupby
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.query.arrays import batch
from cassandra_ros.query.arrays.batch import (
    RowParts,
    StackedBatch,
    group_by_size,
    join_groups,
    only_keys,
    row_batches,
)
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.rows.projection import Projection
from cassandra_ros.query.tree.parse import parse_select

DEFINITION = parse_definition("pkg/A", "int8 x\nstring text", None)
READABLE, CORRUPT, DELETED = "readable", "corrupt", "deleted"


class Runs:
    def text(self, writer):
        return f"run {writer}"


def table_of(name, named=False, by_field=False):
    columns = ("x", "text") if by_field else ("_data",)
    return SimpleNamespace(
        name=name,
        definition=DEFINITION,
        msg_type="pkg/A",
        named=named,
        by_field=by_field,
        columns=columns,
        runs=Runs(),
    )


def wire_of(x, text):
    return bytes([x]) + len(text).to_bytes(4, "little") + text.encode()


class Row:
    """A stored message; of format ``ros`` with its columns."""

    topic = "/t"

    def __init__(self, table, t, node, writer, x, text, state=READABLE, unset=False):
        self.table, self.t, self.key, self.node = table, t, t, node
        self.seq, self.name = writer << 32 | t, f"name {t}" if table.named else ""
        self.x, self.text, self.state, self.size = x, text, state, 5 + len(text)
        self.columns = ()
        if table.by_field:
            self.columns = (bytes([x]), None if unset else text.encode())

    @property
    def wire(self):
        if self.state == DELETED:
            raise MessageNotFound("gone")
        if self.state == CORRUPT:
            raise CorruptMessage("no message")
        return wire_of(self.x, self.text)


ROWS = st.lists(
    st.tuples(
        st.sampled_from(["one", "two"]),
        st.sampled_from("ab"),
        st.integers(1, 2),
        st.integers(0, 127),
        st.text("ab", max_size=2),
        st.sampled_from([READABLE] * 6 + [CORRUPT, DELETED]),
        st.booleans(),
    ),
    max_size=40,
)


@search(100)
@given(rows=ROWS, size=st.integers(1, 7), named=st.booleans(), by_field=st.booleans())
def test_batches_of_rows_hold_their_messages(rows, size, named, by_field):
    tables = {name: table_of(name, named, by_field) for name in ("one", "two")}
    rows = [Row(tables[name], t, *rest) for t, (name, *rest) in enumerate(rows)]
    parts = {
        name: RowParts(table, ("x", "text") if by_field else None, ("x", "text"))
        for name, table in tables.items()
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "ROW_BATCH_MESSAGES", size)
        batches = list(row_batches(rows, lambda table: parts[table.name]))
    assert all(1 <= len(each) <= size for each in batches)
    for name, table in tables.items():
        # Of format ``ros`` a message is read only if a column is unset.
        own = [row for row in rows if row.table is table]
        read = [row for row in own if not by_field or None in row.columns]
        expected = [row for row in own if row not in read or row.state != DELETED]
        lost = [row for row in read if row.state == CORRUPT]
        mine = [each for each in batches if each.table is table]
        identities = [i for each in mine for i in each.identities(runs=True)]
        assert identities == [
            (row.name if named else row.t, row.node, f"run {row.seq >> 32}", row.t)
            for row in expected
        ]
        assert [s for each in mine for s in each.seqs] == [row.seq for row in expected]
        cells = [tuple(c) if c else c for each in mine for c in each.cells(parts[name])]
        assert cells == [
            None if row in lost else (bytes([row.x]), row.text.encode()) for row in expected
        ]
        wires = [None if row in lost or by_field else row.wire for row in expected]
        assert [wire for each in mine for wire in each.wires] == wires
        assert planes_of(join_groups(mine)) == {
            n: wire for n, wire in enumerate(wires) if wire is not None
        }


def planes_of(groups):
    """Return the messages of groups, by their numbers."""
    return {
        n: planes[:, k].tobytes()
        for members, planes in groups
        for k, n in enumerate(members.tolist())
    }


def test_joined_batches_count_unreadable_messages():
    table = table_of("one")
    first = [Row(table, 0, "a", 1, 7, "x"), Row(table, 1, "a", 1, 7, "x", CORRUPT)]
    parts = RowParts(table, None)
    batches = [parts.read(first), parts.read([Row(table, 2, "a", 1, 8, "yy")])]
    assert planes_of(join_groups(batches)) == {0: wire_of(7, "x"), 2: wire_of(8, "yy")}


def test_keys_alone_are_read_without_a_message():
    table = table_of("one")
    rows = [Row(table, 5, "a", 1, 7, "x", CORRUPT), Row(table, 6, "a", 1, 7, "x", DELETED)]
    (only,) = row_batches(rows, only_keys)
    assert only.times.tolist() == [5, 6]
    assert only.size == 0
    assert not list(only.groups)


def test_rows_are_let_go_when_they_are_a_batch():
    """They hold whole messages: eight MiB of them, with all columns."""
    table = table_of("one")
    kept = weakref.WeakSet()

    def rows():
        for t in range(5):
            row = Row(table, t, "a", 1, 7, "x")
            kept.add(row)
            yield row

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "ROW_BATCH_MESSAGES", 3)
        for _ in row_batches(rows(), lambda table: RowParts(table, None)):
            gc.collect()
            assert len(kept) <= 1  # the last one that was read


def test_rows_with_all_columns_come_beside_rows_with_some_or_none():
    """The store gives a message in place of its columns if it was made with others."""
    table = table_of("one", by_field=True)
    parts = RowParts(table, ("text",))
    rows = [Row(table, t, "a", 1, 7, "x") for t in range(4)]
    rows[1].columns, rows[2].columns, rows[3].columns = (), (b"x",), (None,)
    assert [list(cells) for cells in parts.read(rows).cells(parts)] == [[b"x"]] * 4


CONDITIONS = [
    "x > 100",
    "NOT x > 100",
    "text = 'a'",
    "x IS NULL",
    "NODE = 'a' AND x < 9",
    "KEY > 3",
]


@search(100)
@given(
    messages=st.lists(
        st.one_of(st.none(), st.tuples(st.integers(0, 127), st.text("ab", max_size=2))), min_size=1
    ),
    where=st.sampled_from(CONDITIONS),
    data=st.data(),
)
def test_a_batch_of_messages_that_lie_together_is_checked_where_the_store_is_not_sure(
    messages, where, data
):
    """Messages of which it is sure stay, whatever the condition says."""
    table = table_of("one")
    count = len(messages)
    unsure = data.draw(
        st.one_of(st.none(), st.lists(st.booleans(), min_size=count, max_size=count))
    )
    wires = [None if message is None else wire_of(*message) for message in messages]
    block = StackedBatch(
        table,
        "a",
        np.arange(count),
        (7 + np.arange(count) // 3) << 32,
        list(group_by_size(wires)),
        unsure=None if unsure is None else np.array(unsure),
    )
    assert block.wires == wires
    select = parse_select(f"SELECT KEY FROM /t WHERE {where}", ())
    findings = Findings(select.text)
    projection = Projection.compile(select, table, findings)
    found = block.passing(projection)
    sure = [False] * count if unsure is None else [not doubt for doubt in unsure]
    expected = [
        t
        for t, (wire, is_sure) in enumerate(zip(wires, sure))
        if is_sure or projection.passes((t, "a", "", t), wire)
    ]
    assert found.times.tolist() == expected
    assert found.wires == [wires[t] for t in expected]
    writers = [7 + t // 3 for t in expected]
    assert found.owners == [("a", writer, len(list(same))) for writer, same in groupby(writers)]
