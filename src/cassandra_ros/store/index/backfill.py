# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values into the shadow column of rows that are stored already.

A value is written with the timestamp of its row, so that a row that was deleted meanwhile stays
deleted, and with what is left of the row's time to live.
"""

from __future__ import annotations

from typing import Any, Iterator, NamedTuple, Sequence

from cassandra.query import BatchStatement, BatchType

from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.names import quoteName
from cassandra_ros.store.open_bucket import BATCH_BYTES, BATCH_ROWS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import (
    MIN_SEQ,
    RowTable,
    TableRow,
    bind,
    decodeLong,
    encodeInt,
    encodeLong,
)

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
    """Reads the rows of one table and writes their values of one index.

    Args:
        cassandra: The connection.
        table: One whose rows lie by time.
        shadow: The column that carries the index.
    """

    def __init__(self, cassandra: Cassandra, table: RowTable, shadow: str) -> None:
        self._cassandra = cassandra
        self._table = table
        self._select = cassandra.prepare(
            f'SELECT {table.listing(table.columns)}, WRITETIME("_conn"), TTL("_conn") '
            f'FROM {table.qualified} WHERE "_node" = ? AND "_bucket" = ? '
            'AND ("_t", "_seq") >= (?, ?)'
        )
        update = f"UPDATE {table.qualified} USING TIMESTAMP ? AND TTL ? SET "
        where = ' = ? WHERE "_node" = ? AND "_bucket" = ? AND "_t" = ? AND "_seq" = ?'
        self._set_value = cassandra.prepare(f"{update}{quoteName(shadow)}{where}")
        self._set_odd = cassandra.prepare(f'{update}"_odd"{where}')

    def pages(self, node: str, bucket: int, largest: int) -> Iterator[list[Written]]:
        """Read the rows of a bucket.

        Args:
            largest: Bytes of the largest message that lies in its row.
        """
        low = (-(2**63), MIN_SEQ)
        size = max(1, min(PAGE_ROWS, PAGE_BYTES // (largest + 64)))
        while True:
            page, following = self._page(node, bucket, low, size)
            yield page
            if following is None:
                return
            low = following

    def _page(
        self, node: str, bucket: int, low: tuple[int, int], size: int
    ) -> tuple[list[Written], tuple[int, int] | None]:
        """Return rows, and where the next page begins."""
        patience = Patience(f"reading topic {self._table.metadata.topic}")
        place = (node.encode("utf-8"), encodeLong(bucket))
        while True:
            bound = bind(self._select, (*place, *map(encodeLong, low)))
            bound.fetch_size = size
            try:
                result = self._cassandra.sendRaw(bound).result()
                every, more = result.current_rows, result.has_more_pages
            except DRIVER_ERRORS as exc:
                patience.wait(exc)
                continue
            make = self._table.rowFromValues
            rows = [
                Written(make(node, values[:-2]), values[-2], _ttl(values[-1]))
                for values in every
                if not self._table.isRest(values)
            ]
            if not (every and more):
                return rows, None
            t, seq = map(decodeLong, every[-1][:2])
            return rows, (t, seq + 1)

    def write(self, updates: Sequence[Update]) -> None:
        """Write the values of rows of one bucket; return when they are acknowledged."""
        sent = [(part, self._send(part)) for part in _parts(updates)]
        for part, future in sent:
            patience = Patience(f"indexing topic {self._table.metadata.topic}")
            while True:
                try:
                    future.result()
                    break
                except DRIVER_ERRORS as exc:
                    patience.wait(exc)
                    future = self._send(part)

    def _send(self, updates: Sequence[Update]) -> Any:
        batch = BatchStatement(BatchType.UNLOGGED)
        batch.is_idempotent = True
        for (row, timestamp, ttl), value in updates:
            left = 0 if ttl is None else ttl + LATER_SEC
            statement = self._set_odd if value is None else self._set_value
            head = (timestamp, encodeInt(left), b"\x01" if value is None else value)
            batch.add(bind(statement, (*head, *self._table.keyOf(row))))
        return self._cassandra.sendRaw(batch)


def _ttl(value: bytes | None) -> int | None:
    return None if value is None else int.from_bytes(value, "big", signed=True)


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
