# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows that are found by a name: the versions of one, and the list of all.

Names have no order in Cassandra. Whoever wants all of them gets their keys first: a scan of the
whole table, and some 300 bytes of memory a message.
"""

from __future__ import annotations

import heapq
from typing import Any, Iterator, NamedTuple, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import MAX_SEQ, MIN_SEQ, RowTable, TableRow, bind, encodeLong

KEY_PAGE_ROWS = 5000
VERSION_PAGE_ROWS = 16

_EVERY = tuple(encodeLong(v) for v in (-(2**63), MIN_SEQ, 2**63 - 1, MAX_SEQ))


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
    patience = Patience(f"listing the names of topic {table.metadata.topic}")
    while True:
        bound = bind(table.selectNames(), ())
        bound.fetch_size = KEY_PAGE_ROWS
        try:
            rows = cassandra.sendRaw(bound).result()
            found = (_namedKey(values, table.name) for values in rows)
            return [key for key in found if nodes is None or key.position.node in nodes]
        except DRIVER_ERRORS as exc:
            patience.wait(exc)


def _namedKey(values: Sequence[Any], table: str) -> NamedKey:
    node, name, t, seq, size, nchunks, odd, *received = values
    number = int.from_bytes
    t, seq = received or (t, seq)
    at, counter = (number(value or b"", "big", signed=True) for value in (t, seq))
    return NamedKey(
        Position(at, (node or b"").decode(), counter, table, (name or b"").decode()),
        number(size or b"", "big"),
        nchunks is not None,
        odd is not None,
    )


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
    patience = Patience(f"reading topic {table.metadata.topic}")
    key = (node.encode("utf-8"), name.encode("utf-8"))
    ends = list(_EVERY)
    while True:
        bound = bind(table.selectRange(table.columns, reverse=reverse), (*key, *ends))
        bound.fetch_size = VERSION_PAGE_ROWS
        try:
            for values in cassandra.sendRaw(bound).result():
                yield table.rowFromValues(node, values, name)
                # Where a later page fails the rest is asked for from here.
                at = 2 if reverse else 0
                step = -1 if reverse else 1
                seq = int.from_bytes(values[1], "big", signed=True) + step
                ends[at : at + 2] = [values[0], encodeLong(seq)]
            return
        except DRIVER_ERRORS as exc:
            patience.wait(exc)
