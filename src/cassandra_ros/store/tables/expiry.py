# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lifetime of stored rows that expire, and when rows were written, for copies of them."""

from __future__ import annotations

from typing import Iterable

from cassandra_ros.keys import Position
from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.tables.row_table import KEYS, RowTable, bind, decode_long
from cassandra_ros.store.tables.schema import Schema

STEPS = 100
"""Number of steps of a table's TTL to which remaining lifetimes are rounded up."""
_PAGE_ROWS = 5000
_LIFETIME = 'TTL("_conn")'
"""The remaining lifetime of a column that each row has and that is never updated."""
_WRITTEN = 'WRITETIME("_conn")'
"""The write time of this column."""


def rounded(lifetime: int, ttl: int) -> int:
    """Round a row's remaining lifetime up to the next step, seconds; at most the ttl."""
    step = max(1, ttl // STEPS)
    return min(ttl, -(-max(1, lifetime) // step) * step)


def left_in_bucket(table: RowTable, node: str, bucket: int) -> int:
    """Return the maximum remaining lifetime of a bucket's rows, seconds.

    It is 0 if the bucket has no rows, or if they do not expire.
    """
    names, partition_key = f"{KEYS}, {_LIFETIME}", table.partition_key(node, bucket)
    rows = table.select_range(names, partition_key, page_rows=_PAGE_ROWS).rows()
    return max((decode_long(values[2]) for values in rows), default=0)


def left_by_name(table: RowTable) -> dict[Position, int]:
    """Return the remaining lifetime of each row of a table whose rows have names, seconds.

    It is 0 for rows that do not expire. All are in memory.
    """
    return _by_name(table, _LIFETIME)


def written_by_name(table: RowTable) -> dict[Position, int]:
    """Return the server time at which each row of such a table was written, us; all in memory."""
    return _by_name(table, _WRITTEN)


def _by_name(table: RowTable, column: str) -> dict[Position, int]:
    """Return a number of each row; ``column`` is CQL."""

    def read(rows: Iterable[RawRow]) -> dict[Position, int]:
        return {_position(values[:-1], table.name): decode_long(values[-1]) for values in rows}

    return table.collect(bind(table.select_names(column), (), _PAGE_ROWS), read)


def _position(values: RawRow, table: str) -> Position:
    """Return the position of a row from the values of select_names."""
    node, name, t, seq, _, _, _, *received = values
    # Two columns where equal messages are stored once, whose ``_t`` and ``_seq`` are 0.
    t, seq = received or (t, seq)
    texts = (node or b"").decode(), (name or b"").decode()
    return Position(decode_long(t), texts[0], decode_long(seq), table, texts[1])


def set_lifetime(schema: Schema, table: str, seconds: int) -> None:
    """Set the lifetime of rows that are written into a table from now on, s; 0 = for ever."""
    with schema.lock() as lock:
        lock.change(
            f"ALTER TABLE {schema.qualified(table)} WITH default_time_to_live = {int(seconds)}",
            what=f"setting how long the rows of table {table} stay",
        )
