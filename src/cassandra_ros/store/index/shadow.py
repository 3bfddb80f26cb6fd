# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows by the value of an indexed column (a shadow column with a storage-attached index)."""

from __future__ import annotations

from typing import Iterator, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory
from cassandra_ros.store.fetch import Wanted
from cassandra_ros.store.paging import RawRow, retried
from cassandra_ros.store.row_table import FIRST, LAST, RowTable, bind, decodeLong, encodeLong

FEW_ROWS = 1000
"""So many are asked for in one query over the whole table and put in order here."""
PAGE_ROWS = 5000


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
        rows = [key for key in rows if nodes is None or key.position.node in nodes]
        yield from sorted(rows, key=_place)
        return
    by_time: dict[int, set[str]] = {}
    for row in directory.buckets(table.name, FIRST[0], LAST[0], nodes):
        by_time.setdefault(row.bucket, set()).add(row.node)
    for bucket in sorted(by_time):
        found: list[Wanted] = []
        for node in by_time[bucket]:
            place = (node.encode("utf-8"), encodeLong(bucket))
            found += _ask(cassandra, table, shadow, place, value)[0]
        yield from sorted(found, key=_place)


def _ask(
    cassandra: Cassandra,
    table: RowTable,
    shadow: str,
    place: tuple[bytes, ...],
    value: bytes,
    limit: int | None = None,
) -> tuple[list[Wanted], bool]:
    """Return keys, and whether there are more."""
    statement = table.selectShadow(shadow, bucket=bool(place))
    bound = bind(statement, (*place, value), limit or PAGE_ROWS)

    def read() -> tuple[list[Wanted], bool]:
        result = cassandra.sendRaw(bound).result()
        rows = result.current_rows if limit else list(result)
        return [_wanted(table, values) for values in rows], result.has_more_pages

    return retried(f"reading topic {table.metadata.topic}", read)


def _wanted(table: RowTable, values: RawRow) -> Wanted:
    node, t, seq = values
    position = Position(decodeLong(t), (node or b"").decode(), decodeLong(seq), table.name)
    return Wanted(table, position)


def _place(key: Wanted) -> Position:
    return key.position
