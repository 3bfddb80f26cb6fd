# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows that are found by a name: the versions of one, and the list of all.

Names have no order in Cassandra. Whoever wants all of them gets their keys first: a scan of the
whole table, and some 300 bytes of memory a message.
"""

from __future__ import annotations

import heapq
from typing import Iterator, NamedTuple, Sequence

from cassandra.query import BoundStatement

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.paging import RawRow, retried
from cassandra_ros.store.row_table import (
    FIRST,
    LAST,
    RowTable,
    TableRow,
    bind,
    decodeLong,
    encode_ends,
)

KEY_PAGE_ROWS = 5000
VERSION_PAGE_ROWS = 16


class NamedKey(NamedTuple):
    """What the list of names tells of a row."""

    position: Position
    size: int
    chunked: bool
    odd: bool


def listNames(cassandra: Cassandra, table: RowTable, nodes: Sequence[str] | None) -> list[NamedKey]:
    """List the keys of all rows of a table, in no order.

    Args:
        cassandra: The connection.
        table: One whose rows are found by name.
        nodes: Only these nodeIDs; None = all.
    """

    def read() -> list[NamedKey]:
        # In no order: where a page fails, all of them are read again.
        rows = cassandra.sendRaw(bind(table.selectNames(), (), KEY_PAGE_ROWS)).result()
        found = (_namedKey(values, table.name) for values in rows)
        return [key for key in found if nodes is None or key.position.node in nodes]

    return retried(f"listing the names of topic {table.metadata.topic}", read)


def _namedKey(values: RawRow, table: str) -> NamedKey:
    node, name, t, seq, size, nchunks, odd, *received = values
    t, seq = received or (t, seq)
    node_name, key_name = (node or b"").decode(), (name or b"").decode()
    position = Position(decodeLong(t), node_name, decodeLong(seq), table, key_name)
    return NamedKey(position, decodeLong(size), nchunks is not None, odd is not None)


def versions(
    cassandra: Cassandra,
    table: RowTable,
    name: str,
    nodes: Sequence[str],
    *,
    reverse: bool = False,
) -> Iterator[TableRow]:
    """Yield the rows of a name, of several nodes, in the order of time or newest first."""
    streams = [_versionsOf(cassandra, table, name, node, reverse) for node in nodes]
    return heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)


def _versionsOf(
    cassandra: Cassandra, table: RowTable, name: str, node: str, reverse: bool
) -> Iterator[TableRow]:
    statement = table.selectRange(table.columns, reverse=reverse)
    place = (node.encode("utf-8"), name.encode("utf-8"))

    def rest(last: RawRow | None) -> BoundStatement:
        ends = encode_ends(FIRST, LAST, last, reverse=reverse)
        return bind(statement, (*place, *ends), VERSION_PAGE_ROWS)

    asked = cassandra.ask(rest, f"reading topic {table.metadata.topic}")
    for values in asked.rows(ahead=False):
        yield table.rowFromValues(node, values, name)
