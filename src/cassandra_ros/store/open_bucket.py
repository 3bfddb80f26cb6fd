# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One bucket that a writer has open: the batch that is being filled, and what was stored."""

from __future__ import annotations

import threading
import time
import zlib
from dataclasses import dataclass, field
from typing import Callable, Sequence

from cassandra.query import BatchStatement, BatchType, BoundStatement

from cassandra_ros.store.blocks.builder import Block
from cassandra_ros.store.directory import BucketTotals
from cassandra_ros.store.row_table import (
    INLINE_COLUMN_BYTES,
    ODD,
    UNSET,
    NewRow,
    RowTable,
    Shadows,
    encode_int,
    encode_long,
    encode_own,
    encode_texts,
)

# Each batch costs the server about 0.5 ms beside its rows: 200 rows and 64 KiB cost an eighth more.
BATCH_ROWS = 500
BATCH_BYTES = 256 * 1024
_ROW_OVERHEAD = 60

Again = Callable[[], object]
"""Writes a message anew, into the table that its topic has then."""


@dataclass
class Batch:
    """Rows of one partition on their way: one mutation, whatever their number."""

    rows: list[tuple[bool, bytes, Sequence[bytes | None]]] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    again: list[Again | None] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    nbytes: int = 0
    odd_rows: int = 0
    since: float = field(default_factory=time.monotonic)

    def rewriters(self) -> list[Again | None]:
        """Return for each message what writes it anew, None where nobody can."""
        return [*self.again, *(again for block in self.blocks for again in block.rewriters())]


class OpenBucket:
    """State of one partition of one writer; guarded by the writer's lock.

    Of a table whose rows are found by name it is made for one row, and the directory knows none.
    ``totals`` and ``in_air`` also change on the driver's thread, under ``self.mutex``.

    Args:
        table, node, bucket, name: Which partition.
        known: The directory lists it for this writer already.
        shadows: The indexes that all rows of this state are given; others that the table gets
            later wait for the next bucket.
        filled: Of their columns those that earlier rows of the writer have, too.
    """

    def __init__(
        self,
        table: RowTable,
        node: str,
        bucket: int,
        known: bool,
        name: str = "",
        *,
        shadows: Shadows | None = None,
        filled: frozenset[str] = frozenset(),
    ) -> None:
        self.table = table
        self.node = node
        self.bucket = bucket
        self.must_recount = known
        """The bucket has rows that this state has not seen, so its totals are not final."""
        self.totals = BucketTotals()
        self.in_air = 0
        self.mutex = threading.Lock()
        self.batch = Batch()
        self.touched = self.marked = time.monotonic()
        self.changed = False
        self._place = table.place(node, name if table.named else bucket)
        self._shadows = shadows
        self.filled = filled
        names = shadows.names if shadows is not None else ()
        if table.packed:
            self._plain = full = table.insert_block()
        else:
            self._plain, full = table.insert(names, full=False), table.insert(names)
        self._plain_id, self._full_id = self._plain.query_id, full.query_id
        # Found from the values by the first row, then the same for all of the bucket.
        self._routing_key: bytes | None = None

    def key(self, t: int, seq: int) -> tuple[bytes, ...]:
        """Encode the primary key of a row in this bucket."""
        return (*self._place, encode_long(t), encode_long(seq))

    def add(self, row: NewRow, again: Again | None, chunks: int = 0) -> None:
        """Add a row to the batch, with its message inside or in so many chunks."""
        columns, odd, wire, batch = row.columns, row.odd, row.wire, self.batch
        if chunks:
            columns = [None if len(c or b"") > INLINE_COLUMN_BYTES else c for c in columns]
            odd = odd or None in columns
        if self._shadows is not None:
            values, lost = self._shadows.values(wire)
            columns = (*columns, *(UNSET if value is None else value for value in values))
            odd = odd or lost
        if not batch.rows:
            batch.since = time.monotonic()
        head = encode_own(row.t, row.seq, row.conn, len(wire))
        if not (chunks or odd or row.raw is not None):
            batch.rows.append((True, self._plain_id, (*self._place, *head, *columns)))
            batch.nbytes += len(wire) + _ROW_OVERHEAD
        else:
            flag = ODD if odd else None
            own: Sequence[bytes | None] = (None, None, flag, row.raw)
            if chunks:
                own = (encode_int(chunks), encode_long(zlib.crc32(wire)), flag, None)
            rest = (UNSET if value is None else value for value in (*own, *columns))
            full = (*self._place, *head, *rest)
            batch.rows.append((True, self._full_id, full))
            batch.nbytes += _ROW_OVERHEAD + sum(len(v) for v in full if v is not UNSET)
            batch.odd_rows += odd
        batch.sizes.append(len(wire))
        batch.times.append(row.t)
        batch.again.append(again)

    def add_block(self, block: Block, chunks: int = 0) -> None:
        """Add a block to the batch, its one message in so many chunks."""
        batch, sizes = self.batch, [len(wire) for wire in block.wires]
        if not batch.rows:
            batch.since = time.monotonic()
        values = (
            *self._place,
            *encode_own(block.t, block.seq, block.conn, sum(sizes)),
            encode_long(block.times[-1]),
            encode_int(len(sizes)),
            block.data or UNSET,
            encode_long(block.crc),
            encode_int(chunks) if chunks else UNSET,
            ODD if block.odd else UNSET,
            None,  # whatever was deleted is there again, as a row that is written anew
            encode_texts(block.nan) if block.nan else UNSET,
            *(UNSET if value is None else value for value in block.zones),
        )
        batch.rows.append((True, self._plain_id, values))
        batch.nbytes += _ROW_OVERHEAD + len(block.data) + 12 * len(block.zones)
        batch.odd_rows += block.odd
        batch.blocks.append(block)
        batch.sizes += sizes
        batch.times += (block.times[0], block.times[-1])

    def is_full(self) -> bool:
        """Say whether the batch should be sent now."""
        return len(self.batch.rows) >= BATCH_ROWS or self.batch.nbytes >= BATCH_BYTES

    def take(self) -> tuple[Batch, BatchStatement]:
        """Take the filled batch; return it with the statement that stores it."""
        batch, self.batch = self.batch, Batch()
        statement = BatchStatement(BatchType.UNLOGGED)
        statement.is_idempotent = True
        # What BatchStatement.add does row by row, at once (cassandra.md: 10 to 6 µs a row).
        statement._statements_and_parameters = batch.rows
        if self._routing_key is None:
            bound = BoundStatement(self._plain)
            bound.values = list(batch.rows[0][2])
            self._routing_key = bound.routing_key
        statement.routing_key = self._routing_key
        statement.keyspace = self._plain.keyspace
        with self.mutex:
            self.in_air += 1
        return batch, statement

    def stored(self, batch: Batch, large: bool) -> None:
        """Count a batch that was acknowledged."""
        with self.mutex:
            self.in_air -= 1
            totals = self.totals
            totals.rows += len(batch.sizes)
            totals.bytes += sum(batch.sizes)
            totals.t_min = min(totals.t_min, *batch.times)
            totals.t_max = max(totals.t_max, *batch.times)
            totals.odd += batch.odd_rows
            if not large:
                totals.largest = max(totals.largest, *batch.sizes)
            self.changed = True

    def failed(self) -> None:
        """Note that a batch was given up: some of its rows may lie there or not."""
        with self.mutex:
            self.in_air -= 1
            self.must_recount = True
            self.changed = True
