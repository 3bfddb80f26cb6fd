# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Single rows: of known keys, the next ones asked for ahead; the first row at a time."""

from __future__ import annotations

from collections import deque
from typing import Deque, Iterable, Iterator, NamedTuple, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory, slotOf
from cassandra_ros.store.paging import Asked
from cassandra_ros.store.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    Order,
    RowTable,
    TableRow,
    bind,
    encode_ends,
)

AHEAD = 16


class Wanted(NamedTuple):
    """A row to be fetched."""

    table: RowTable
    position: Position


def fetchRows(
    cassandra: Cassandra, wanted: Iterable[Wanted], ahead: int = AHEAD
) -> Iterator[TableRow]:
    """Yield the rows in the order asked for; one that was deleted meanwhile is left out.

    Args:
        cassandra: The connection.
        wanted: The keys.
        ahead: How many are on their way at once.
    """
    asked: Deque[tuple[Wanted, Asked]] = deque()
    for key in wanted:
        order = key.table.storedOrder(key.position.t, key.position.seq)
        asked.append((key, _ask(cassandra, key, order, order)))
        if len(asked) >= ahead:
            yield from _answer(*asked.popleft())
    while asked:
        yield from _answer(*asked.popleft())


def firstAt(
    cassandra: Cassandra,
    directory: Directory,
    tables: Sequence[RowTable],
    t: int,
    nodes: Sequence[str] | None,
) -> TableRow | None:
    """Read the first row with exactly this time, in the order (node, seq, table).

    The nodes that are known to write a table are asked first: one round trip. Only where they
    have nothing the directory is asked for others, so no row is missed; of two nodes with the
    very same time one that this process has not met yet comes behind.

    Args:
        cassandra: The connection.
        directory: Lists the nodes.
        tables: Those of a topic.
        t: Key time, ns.
        nodes: Only these nodeIDs; None = all.
    """
    known = [(t_, n) for t_ in tables for n in sorted(t_.known_nodes if nodes is None else nodes)]
    row = _best(cassandra, known, t)
    if row is not None or nodes is not None:
        return row
    others: list[tuple[RowTable, str]] = []
    for table in tables:
        slot = slotOf(table.bucketOf(t))
        found = {node for _, node in directory.nodes(table.name, slot, slot)}
        others.extend((table, node) for node in sorted(found - table.known_nodes))
        table.known_nodes |= found
    return _best(cassandra, others, t)


def _best(cassandra: Cassandra, places: list[tuple[RowTable, str]], t: int) -> TableRow | None:
    keys = [Wanted(table, Position(t, node, 0, table.name)) for table, node in places]
    low, high = (t, MIN_SEQ), (t, MAX_SEQ)
    asked = [(key, _ask(cassandra, key, low, high, page_rows=1)) for key in keys]
    rows = [row for each in asked for row in _answer(*each)]
    return min(rows, key=lambda row: row[:4], default=None)


def _ask(
    cassandra: Cassandra, key: Wanted, low: Order, high: Order, page_rows: int | None = None
) -> Asked:
    table, (t, node, _, _, name) = key
    place = (node.encode("utf-8"), table.partitionOf(t, name))
    bound = bind(table.selectRange(table.columns), (*place, *encode_ends(low, high)), page_rows)
    return cassandra.ask(lambda last: bound, f"reading topic {table.metadata.topic}")


def _answer(key: Wanted, asked: Asked) -> Iterator[TableRow]:
    table, position = key
    for values in asked.page()[:1]:
        if not table.isRest(values):
            yield table.rowFromValues(position.node, values, position.name)
