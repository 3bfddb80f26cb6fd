# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One row by its time or its whole key: as few round trips as there can be."""

from __future__ import annotations

from typing import Any, Sequence

from cassandra_ros.store.buckets import slotOf
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory
from cassandra_ros.store.driver_errors import DRIVER_ERRORS, isPassing, translate
from cassandra_ros.store.row_table import MAX_SEQ, MIN_SEQ, RowTable, TableRow, bind, encodeLong

_TRIES = 5


def rowAt(cassandra: Cassandra, table: RowTable, t: int, node: str, seq: int) -> TableRow | None:
    """Read the row of a whole key: one SELECT."""
    return _first(
        cassandra, _ask(cassandra, table, t, node, (seq, seq)), table, t, node, (seq, seq)
    )


def firstAt(
    cassandra: Cassandra,
    directory: Directory,
    tables: Sequence[RowTable],
    t: int,
    nodes: Sequence[str] | None,
) -> TableRow | None:
    """Read the first row with exactly this time, in the order (node, seq, table).

    The nodes that are known to write a table are asked at once, together with the directory;
    those that the directory adds are asked then.

    Args:
        nodes: Only these nodeIDs; None = all.
    """
    every = (MIN_SEQ, MAX_SEQ)
    listings = []
    asked: dict[tuple[str, str], Any] = {}
    for table in tables:
        if nodes is None:
            slot = slotOf(table.bucketOf(t))
            listings.append((table, slot, directory.askNodes(table.name, slot)))
        for node in sorted(table.known_nodes) if nodes is None else nodes:
            asked[(table.name, node)] = _ask(cassandra, table, t, node, every)
    for table, slot, future in listings:
        for node in directory.toldNodes(table.name, slot, future):
            table.known_nodes.add(node)
            if (table.name, node) not in asked:
                asked[(table.name, node)] = _ask(cassandra, table, t, node, every)
    by_name = {table.name: table for table in tables}
    found = [
        _first(cassandra, future, by_name[name], t, node, every)
        for (name, node), future in asked.items()
    ]
    return min((row for row in found if row is not None), key=lambda row: row[:4], default=None)


def _ask(cassandra: Cassandra, table: RowTable, t: int, node: str, seqs: tuple[int, int]) -> Any:
    time = encodeLong(t)
    ends = (time, encodeLong(seqs[0]), time, encodeLong(seqs[1]))
    key = (node.encode("utf-8"), encodeLong(table.bucketOf(t)))
    bound = bind(table.selectRange(table.columns), (*key, *ends))
    bound.fetch_size = 1
    return cassandra.sendRaw(bound)


def _first(
    cassandra: Cassandra,
    future: Any,
    table: RowTable,
    t: int,
    node: str,
    seqs: tuple[int, int],
) -> TableRow | None:
    for left in reversed(range(_TRIES)):
        try:
            rows = future.result().current_rows
            return table.rowFromValues(node, rows[0]) if rows else None
        except DRIVER_ERRORS as exc:
            if not left or not isPassing(exc):
                raise translate(exc, f"reading topic {table.metadata.topic}") from exc
            future = _ask(cassandra, table, t, node, seqs)
    raise AssertionError("the loop above returns or raises")
