# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values for the shadow column of rows that were stored before their index was made.

A value is written with the timestamp of its row, so a row that is deleted meanwhile stays deleted,
and with the row's remaining time to live.
"""

from __future__ import annotations

from typing import Iterator, NamedTuple, Sequence

from cassandra.query import BatchStatement, BatchType

from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.rows.writer import WRITE_BATCH_BYTES, WRITE_BATCH_ROWS
from cassandra_ros.store.tables.row_table import (
    ODD,
    RowTable,
    TableRow,
    bind,
    decode_long,
    encode_int,
)

PAGE_ROWS = 1000
PAGE_BYTES = 2 * 1024 * 1024
"""Maximum number of rows in a page, and its approximate maximum size in bytes."""
LATER_SEC = 1
"""Minimum time that a value stays longer than its row, s, because an index must not lose a row that
has not expired. After that readers skip the value."""


class WrittenRow(NamedTuple):
    """A stored row with its write time."""

    row: TableRow
    timestamp: bytes
    """Write time, encoded microseconds."""
    ttl: int | None
    """Remaining time to live when its page was read, s; None = it does not expire."""


class ShadowUpdate(NamedTuple):
    """A row and the value that it gets in the shadow column."""

    written: WrittenRow
    value: bytes | None
    """Encoded value; None = the index cannot hold the row's value, and the row is marked odd."""


class Backfill:
    """Reads the rows of a table (of a time key) and writes the values of one shadow column."""

    def __init__(self, table: RowTable, shadow: str) -> None:
        self._table = table
        self._set_value, self._set_odd = table.update(shadow), table.update("_odd")

    def pages(self, node: str, bucket: int, largest: int) -> Iterator[list[WrittenRow]]:
        """Yield the rows of a bucket by pages.

        Args:
            largest: Size of the largest message that is stored in its row, bytes.
        """
        size = max(1, min(PAGE_ROWS, PAGE_BYTES // (largest + 64)))
        table = self._table
        names = f'{table.listing()}, WRITETIME("_conn"), TTL("_conn")'
        request = table.select_range(names, table.partition_key(node, bucket), page_rows=size)
        # Back-filling must not slow down recorders, so no page is requested ahead.
        for page in request.pages(ahead=False):
            yield [self._written_row(node, values) for values in page if not table.is_rest(values)]

    def _written_row(self, node: str, values: RawRow) -> WrittenRow:
        """Return a row from the values of a listing and the two columns that follow it."""
        *columns, timestamp, ttl = values
        row = self._table.row_from_values(node, tuple(columns))
        return WrittenRow(row, timestamp or b"", None if ttl is None else decode_long(ttl))

    def write(self, updates: Sequence[ShadowUpdate]) -> None:
        """Write the values for rows of one bucket; return when they are acknowledged."""
        batches = [self._batch(group) for group in _batches(updates)]
        for request in [self._table.send(batch, "indexing") for batch in batches]:
            request.page()

    def _batch(self, updates: Sequence[ShadowUpdate]) -> BatchStatement:
        batch = BatchStatement(BatchType.UNLOGGED)
        batch.is_idempotent = True
        for (row, timestamp, ttl), value in updates:
            ttl_sec = 0 if ttl is None else ttl + LATER_SEC
            statement = self._set_odd if value is None else self._set_value
            head = (timestamp, encode_int(ttl_sec), ODD if value is None else value)
            batch.add(bind(statement, (*head, *self._table.key_of(row))))
        return batch


def _batches(updates: Sequence[ShadowUpdate]) -> Iterator[list[ShadowUpdate]]:
    """Divide updates into groups for one batch each."""
    group: list[ShadowUpdate] = []
    size = 0
    for update in updates:
        group.append(update)
        size += 100 + len(update.value or b"")
        if len(group) >= WRITE_BATCH_ROWS or size >= WRITE_BATCH_BYTES:
            yield group
            group, size = [], 0
    if group:
        yield group
