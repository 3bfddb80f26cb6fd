# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The first row at a time: as few round trips as there can be."""

from __future__ import annotations

from typing import Any, Sequence

from cassandra_ros.store.buckets import slotOf
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import MAX_SEQ, MIN_SEQ, RowTable, TableRow, bind, encodeLong


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


def _best(cassandra: Cassandra, asked: list[tuple[RowTable, str]], t: int) -> TableRow | None:
    futures = [_ask(cassandra, table, t, node) for table, node in asked]
    rows = [
        _first(cassandra, future, table, t, node) for (table, node), future in zip(asked, futures)
    ]
    return min((row for row in rows if row is not None), key=lambda row: row[:4], default=None)


def _ask(cassandra: Cassandra, table: RowTable, t: int, node: str) -> Any:
    time = encodeLong(t)
    ends = (time, encodeLong(MIN_SEQ), time, encodeLong(MAX_SEQ))
    key = (node.encode("utf-8"), encodeLong(table.bucketOf(t)))
    bound = bind(table.selectRange(table.columns), (*key, *ends))
    bound.fetch_size = 1
    return cassandra.sendRaw(bound)


def _first(
    cassandra: Cassandra, future: Any, table: RowTable, t: int, node: str
) -> TableRow | None:
    patience = Patience(f"reading topic {table.metadata.topic}")
    while True:
        try:
            rows = future.result().current_rows
            rows = [row for row in rows if not table.isRest(row)]
            return table.rowFromValues(node, rows[0]) if rows else None
        except DRIVER_ERRORS as exc:
            patience.wait(exc)
            future = _ask(cassandra, table, t, node)
