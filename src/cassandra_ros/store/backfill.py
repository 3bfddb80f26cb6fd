# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values into the shadow column of rows that are stored already.

A value is written with the timestamp of its row, so that a row that was deleted meanwhile stays
deleted, and with what is left of the row's time to live.
"""

from __future__ import annotations

from typing import Iterator, NamedTuple, Sequence

from cassandra.query import BatchStatement, BatchType

from cassandra_ros.connection.paging import RawRow
from cassandra_ros.store.open_bucket import BATCH_BYTES, BATCH_ROWS
from cassandra_ros.tables.row_table import ODD, RowTable, TableRow, bind, decode_long, encode_int

PAGE_ROWS = 1000
PAGE_BYTES = 2 * 1024 * 1024
LATER_SEC = 1
"""How much longer than its row a value stays, at least: an index must not lose a row before it
expires. Readers leave out what is left of it then."""


class Written(NamedTuple):
    """A stored row, and when it was written."""

    row: TableRow
    timestamp: bytes
    """Microseconds, encoded."""
    ttl: int | None
    """Seconds that it had left when its page was read; None = it stays."""


class Update(NamedTuple):
    """What a row gets."""

    written: Written
    value: bytes | None
    """None = the row has a value that the index cannot hold, and is marked odd."""


class Backfill:
    """Reads the rows of a table, which lie by time, and writes the values of one shadow column."""

    def __init__(self, table: RowTable, shadow: str) -> None:
        self._table = table
        self._set_value, self._set_odd = table.update(shadow), table.update("_odd")

    def pages(self, node: str, bucket: int, largest: int) -> Iterator[list[Written]]:
        """Read the rows of a bucket, whose largest message in a row has so many bytes."""
        size = max(1, min(PAGE_ROWS, PAGE_BYTES // (largest + 64)))
        table = self._table
        names = f'{table.listing()}, WRITETIME("_conn"), TTL("_conn")'
        asked = table.select_range(names, table.place(node, bucket), page_rows=size)
        # What is back-filled competes with who records: nothing is asked for ahead.
        for page in asked.pages(ahead=False):
            yield [self._written(node, each) for each in page if not table.is_rest(each)]

    def _written(self, node: str, values: RawRow) -> Written:
        *own, timestamp, ttl = values
        row = self._table.row_from_values(node, tuple(own))
        return Written(row, timestamp or b"", None if ttl is None else decode_long(ttl))

    def write(self, updates: Sequence[Update]) -> None:
        """Write the values of rows of one bucket; return when they are acknowledged."""
        batches = [self._batch(part) for part in _parts(updates)]
        for sent in [self._table.send(batch, "indexing") for batch in batches]:
            sent.page()

    def _batch(self, updates: Sequence[Update]) -> BatchStatement:
        batch = BatchStatement(BatchType.UNLOGGED)
        batch.is_idempotent = True
        for (row, timestamp, ttl), value in updates:
            left = 0 if ttl is None else ttl + LATER_SEC
            statement = self._set_odd if value is None else self._set_value
            head = (timestamp, encode_int(left), ODD if value is None else value)
            batch.add(bind(statement, (*head, *self._table.key_of(row))))
        return batch


def _parts(updates: Sequence[Update]) -> Iterator[list[Update]]:
    """Divide updates into batches of bearable size."""
    part: list[Update] = []
    size = 0
    for update in updates:
        part.append(update)
        size += 100 + len(update.value or b"")
        if len(part) >= BATCH_ROWS or size >= BATCH_BYTES:
            yield part
            part, size = [], 0
    if part:
        yield part
