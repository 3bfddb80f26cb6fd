# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows by the value of an indexed column (a shadow column with a storage-attached index)."""

from __future__ import annotations

from typing import Any, Iterator, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.fetch import Wanted
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import RowTable, bind, encodeLong

FEW_ROWS = 1000
"""So many are asked for in one query over the whole table and put in order here."""


def keysByShadow(
    cassandra: Cassandra,
    directory: Directory,
    table: RowTable,
    shadow: str,
    value: bytes,
    nodes: Sequence[str] | None,
) -> Iterator[Wanted]:
    """Yield the keys of the rows whose shadow column has a value, in the order of time.

    Args:
        cassandra: The connection.
        directory: Lists the buckets, where there are too many rows to be put in order here.
        table: One in the order of time.
        shadow: Name of the column.
        value: In CQL's encoding.
        nodes: Only these nodeIDs; None = all.
    """
    rows, more = _ask(cassandra, table, shadow, (), value, FEW_ROWS)
    if not more:
        yield from sorted(
            (key for key in rows if nodes is None or key.position.node in nodes),
            key=lambda key: key.position,
        )
        return
    buckets = directory.buckets(table.name, -(2**63), 2**63 - 1, nodes)
    by_time: dict[int, set[str]] = {}
    for row in buckets:
        by_time.setdefault(row.bucket, set()).add(row.node)
    for bucket in sorted(by_time):
        found: list[Wanted] = []
        for node in by_time[bucket]:
            place = (node.encode("utf-8"), encodeLong(bucket))
            found += _ask(cassandra, table, shadow, place, value, None)[0]
        yield from sorted(found, key=lambda key: key.position)


def _ask(
    cassandra: Cassandra,
    table: RowTable,
    shadow: str,
    place: tuple[bytes, ...],
    value: bytes,
    limit: int | None,
) -> tuple[list[Wanted], bool]:
    """Return keys, and whether there are more."""
    patience = Patience(f"reading topic {table.metadata.topic}")
    bound = bind(table.selectShadow(shadow, bucket=bool(place)), (*place, value))
    bound.fetch_size = limit or 5000
    while True:
        try:
            result = cassandra.sendRaw(bound).result()
            rows = result.current_rows if limit else list(result)
            return [_wanted(table, values) for values in rows], result.has_more_pages
        except DRIVER_ERRORS as exc:
            patience.wait(exc)


def _wanted(table: RowTable, values: Sequence[Any]) -> Wanted:
    node, t, seq = values
    at = int.from_bytes(t, "big", signed=True)
    number = int.from_bytes(seq, "big", signed=True)
    return Wanted(table, Position(at, (node or b"").decode(), number, table.name))
