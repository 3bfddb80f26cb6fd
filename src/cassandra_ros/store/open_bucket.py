# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One bucket into which a writer writes: the batch being filled, and counts of stored rows."""

from __future__ import annotations

import math
import struct
import threading
import time
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, chain, repeat, takewhile
from operator import attrgetter
from typing import Callable, Iterable, NamedTuple, Sequence

from cassandra.query import BatchStatement, BatchType, BoundStatement

from cassandra_ros.blocks.block_builder import Block
from cassandra_ros.connection.protocol import EncodedRows, Prepared
from cassandra_ros.tables.directory import BucketTotals
from cassandra_ros.tables.row_encoder import Shadows
from cassandra_ros.tables.row_table import (
    INLINE_COLUMN_BYTES,
    ODD,
    UNSET,
    NewRow,
    RowTable,
    encode_int,
    encode_long,
    encode_own,
    encode_texts,
)

# A batch costs the server some 0.5 ms in addition to its rows. Batches of 500 rows and 256 KiB cost
# it an eighth more, those of 200 rows and 64 KiB a third. None is larger than a chunk.
BATCH_ROWS = 1000
BATCH_BYTES = 512 * 1024
HELD_BYTES = 8 * 1024 * 1024
"""Maximum size of the large messages whose rows wait in a batch, bytes. They stay in memory until
the batch is stored."""
_ROW_OVERHEAD = 60
_OWN = struct.Struct(">iqiqiqii")
"""_t, _seq, _conn and _size, each after its size."""

_time_of, _wire_of = attrgetter("t"), attrgetter("wire")

Again = Callable[[], object]
"""Writes a message again, into the table that its topic has then."""
RowAgain = Callable[[NewRow], object]
"""The same for the message of a given row."""


class Chunks(NamedTuple):
    """The chunks of a large message."""

    number: int
    crc: int
    """Checksum of the whole message."""


@dataclass
class Batch:
    """Rows of one partition that are sent together as one mutation."""

    rows: list[Prepared | NewRow] = field(default_factory=list)
    """Encoded statements, or rows that are encoded when the batch is sent."""
    sizes: list[int] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    again: list[Again | None] = field(default_factory=list)
    runs: list[tuple[Sequence[NewRow], RowAgain]] = field(default_factory=list)
    """Rows that were added together, with one function in place of an ``again`` for each."""
    blocks: list[Block] = field(default_factory=list)
    nbytes: int = 0
    held: int = 0
    """Number of bytes of the messages in chunks, which are not counted in nbytes."""
    odd_rows: int = 0
    largest: int = 0
    """Size of the largest message that is stored in its row, bytes; messages in chunks do not
    count."""
    since: float = field(default_factory=time.monotonic)
    """Monotonic time at which its oldest row was added, s; -inf = send the batch without
    waiting."""

    def rewriters(self) -> list[Again | None]:
        """Return for each message a function that writes it again.

        None if there is no such function.
        """
        runs = [partial(again, row) for rows, again in self.runs for row in rows]
        blocks = (again for block in self.blocks for again in block.rewriters())
        return [*self.again, *runs, *blocks]


class OpenBucket:
    """State of one partition of one writer; guarded by the writer's lock.

    In a table whose rows have names there is one such object for each row, and the directory does
    not list it. ``totals`` and ``in_air`` also change on the driver's thread, under ``self.mutex``.

    Args:
        table, node, bucket, name: The partition.
        known: Whether the directory already lists the bucket for this writer.
        shadows: Indexes for which the rows get values. An index that is made later counts from the
            next bucket on.
        filled: Shadow columns that earlier rows of the writer in the bucket have too.
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
        """Whether the bucket has rows that this object did not count, so its totals are not
        final."""
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
        bound = BoundStatement(self._plain)
        bound.values = list(self._place)
        self._routing_key = bound.routing_key
        values = len(self._plain.column_metadata)
        self._prefix = _statement_head(self._plain_id, values, self._place)

    def key(self, t: int, seq: int) -> tuple[bytes, ...]:
        """Encode the primary key of a row in this bucket."""
        return (*self._place, encode_long(t), encode_long(seq))

    def add(self, row: NewRow, again: Again | None, chunks: Chunks | None = None) -> None:
        """Add a row to the batch, with its message in the row or in chunks."""
        batch = self.batch
        if not batch.rows:
            batch.since = time.monotonic()
        if chunks:
            batch.held += len(row.wire)
        else:
            batch.largest = max(batch.largest, len(row.wire))
        if row.columns is None and self._shadows is None and not chunks:
            batch.rows.append(row)
            batch.nbytes += len(row.wire) + _ROW_OVERHEAD
        else:
            batch.rows.append(self._statement(row, chunks))
        batch.sizes.append(len(row.wire))
        batch.times.append(row.t)
        batch.again.append(again)

    def add_run(self, rows: Sequence[NewRow], again: RowAgain) -> int:
        """Add the first of some rows without columns; return how many, 0 if the table has indexes.

        Args:
            again: Writes the message of one of these rows again.
        """
        batch = self.batch
        if self._shadows is not None:
            return 0
        if not batch.rows:
            batch.since = time.monotonic()
        rows = rows[: BATCH_ROWS - len(batch.rows)]
        sizes = list(map(len, map(_wire_of, rows)))
        room = BATCH_BYTES - batch.nbytes
        if sum(sizes) + _ROW_OVERHEAD * len(rows) > room:
            ends = accumulate(size + _ROW_OVERHEAD for size in sizes)
            count = 1 + sum(1 for _ in takewhile(room.__gt__, ends))
            rows, sizes = rows[:count], sizes[:count]
        batch.rows += rows
        batch.nbytes += sum(sizes) + _ROW_OVERHEAD * len(rows)
        batch.sizes += sizes
        batch.largest = max(batch.largest, *sizes)
        batch.times += map(_time_of, rows)
        batch.runs.append((rows, again))
        return len(rows)

    def _statement(self, row: NewRow, chunks: Chunks | None = None) -> Prepared:
        """Return the statement that stores a row, and count the row in the batch."""
        wire = row.wire
        if row.columns is None:
            columns, odd, raw = self.table.encoder.encode_wire(wire)
        else:
            columns, odd, raw = row.columns, row.odd, row.raw
        if chunks:
            columns = [None if len(c or b"") > INLINE_COLUMN_BYTES else c for c in columns]
            odd = odd or None in columns
        if self._shadows is not None:
            values, lost = self._shadows.values(wire)
            columns = (*columns, *(UNSET if value is None else value for value in values))
            odd = odd or lost
        head = encode_own(row.t, row.seq, row.conn, len(wire))
        if not (chunks or odd or raw is not None):
            self.batch.nbytes += len(wire) + _ROW_OVERHEAD
            return True, self._plain_id, (*self._place, *head, *columns)
        flag = ODD if odd else None
        own: Sequence[bytes | None] = (None, None, flag, raw)
        if chunks:
            own = (encode_int(chunks.number), encode_long(chunks.crc), flag, None)
        rest = (UNSET if value is None else value for value in (*own, *columns))
        full = (*self._place, *head, *rest)
        self.batch.nbytes += _ROW_OVERHEAD + sum(len(v) for v in full if v is not UNSET)
        self.batch.odd_rows += odd
        return True, self._full_id, full

    def add_block(self, block: Block, chunks: Chunks | None = None) -> None:
        """Add a block to the batch; if it is one large message, this may be in chunks."""
        batch, sizes = self.batch, list(map(len, block.wires))
        if not batch.rows:
            batch.since = time.monotonic()
        if chunks:
            batch.held += len(block.wire)
        else:  # the block has already waited to be filled
            batch.since, batch.largest = -math.inf, max(batch.largest, *sizes)
        values = (
            *self._place,
            *encode_own(block.t, block.seq, block.conn, sum(sizes)),
            encode_long(block.times[-1]),
            encode_int(len(sizes)),
            block.data or UNSET,
            encode_long(block.crc),
            encode_int(chunks.number) if chunks else UNSET,
            ODD if block.odd else UNSET,
            None,  # a row that is written again brings its deleted messages back
            encode_texts(block.nan) if block.nan else UNSET,
            *(UNSET if value is None else value for value in block.zones),
        )
        batch.rows.append((True, self._plain_id, values))
        batch.nbytes += _ROW_OVERHEAD + len(block.data) + 12 * len(block.zones)
        batch.odd_rows += len(sizes) * block.odd
        batch.blocks.append(block)
        batch.sizes += sizes
        batch.times += (block.times[0], block.times[-1])

    def is_full(self) -> bool:
        """Return whether the batch should be sent now."""
        batch = self.batch
        large = batch.nbytes >= BATCH_BYTES or batch.held >= HELD_BYTES
        return large or len(batch.rows) >= BATCH_ROWS

    def take(self) -> tuple[Batch, BatchStatement]:
        """Return the filled batch with the statement that stores it, and begin a new batch."""
        rows = self._encoded()
        batch = self.drop()
        statement = BatchStatement(BatchType.UNLOGGED)
        statement.is_idempotent = True
        # Does at once what BatchStatement.add does row by row (10 to 6 µs a row).
        statement._statements_and_parameters = rows
        statement.routing_key = self._routing_key
        statement.keyspace = self._plain.keyspace
        self.begin_request()
        return batch, statement

    def drop(self) -> Batch:
        """Return the filled batch, and begin a new one."""
        batch, self.batch = self.batch, Batch()
        return batch

    def begin_request(self) -> None:
        """Count a batch or a large message in chunks that is being sent."""
        with self.mutex:
            self.in_air += 1

    def end_chunks(self) -> None:
        """Note that all chunks of a large message are acknowledged; its row can be added now."""
        with self.mutex:
            self.in_air -= 1

    def _encoded(self) -> EncodedRows:
        """Encode the rows of the batch that are not encoded yet, most of them together."""
        rows = self.batch.rows
        later = [row for row in rows if isinstance(row, NewRow)]
        others = (
            [row for row in rows if not isinstance(row, NewRow)] if len(later) < len(rows) else []
        )
        every = self.table.encoder.encode_together([row.wire for row in later]) if later else ()
        columns = [each for each in every if each is not None]
        if len(columns) < len(later):
            for row, each in zip(later, every):
                if each is None:
                    self.batch.nbytes -= len(row.wire) + _ROW_OVERHEAD  # _statement adds it again
                    others.append(self._statement(row))
            later = [row for row, each in zip(later, every) if each is not None]
        self.batch.rows = []  # not needed any more; releases their memory
        parts = chain.from_iterable(zip(repeat(self._prefix), _own_columns(later), columns))
        return EncodedRows(b"".join(parts), len(later), others)

    def stored(self, batch: Batch) -> None:
        """Add an acknowledged batch to the counts."""
        with self.mutex:
            self.in_air -= 1
            totals = self.totals
            totals.rows += len(batch.sizes)
            totals.bytes += sum(batch.sizes)
            totals.t_min = min(totals.t_min, *batch.times)
            totals.t_max = max(totals.t_max, *batch.times)
            totals.odd += batch.odd_rows
            totals.largest = max(totals.largest, batch.largest)
            self.changed = True

    def take_totals(self) -> BucketTotals:
        """Return the counts of stored rows, and note that the directory gets them."""
        self.changed = False
        return self.totals

    def mark(self) -> None:
        """Note that the bucket was just marked in the directory."""
        self.marked = time.monotonic()

    def require_recount(self) -> None:
        """Note that other clients may have deleted rows, so that the totals are not final."""
        self.must_recount = True

    def failed(self) -> None:
        """Note that a batch was given up; some of its rows may have been stored."""
        with self.mutex:
            self.in_air -= 1
            self.must_recount = True
            self.changed = True


def _own_columns(rows: Sequence[NewRow]) -> Iterable[bytes]:
    """Encode our own columns of all formats, each after its size."""
    if not rows:
        return ()
    times, seqs, conns, wires, *_ = zip(*rows)
    eight = repeat(8)
    return map(_OWN.pack, eight, times, eight, seqs, eight, conns, repeat(4), map(len, wires))


def _statement_head(query_id: bytes, values: int, first: Sequence[bytes]) -> bytes:
    """Encode the beginning of a prepared statement in a batch: its id and its first values."""
    sized = b"".join(encode_int(len(value)) + value for value in first)
    return struct.pack(f">BH{len(query_id)}sH", 1, len(query_id), query_id, values) + sized
