# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows into Cassandra: batched by bucket, limited in flight, counted; no loss is silent.

``RowWriter`` has an ``OpenBucket`` for each bucket that it writes to. There a ``Batch`` is filled.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, chain, repeat, takewhile
from operator import attrgetter
from typing import Callable, Iterable, NamedTuple, Sequence, Union

from cassandra.query import BatchStatement, BatchType, BoundStatement

from cassandra_ros.errors import (
    CassandraRosError,
    KeyspaceNotFound,
    StoreUnavailable,
    TopicNotFound,
    WriteFailed,
)
from cassandra_ros.store.blocks.block_builder import (
    FULL,
    BlockBuilder,
    BlockLimits,
    Builders,
    KeyTime,
    MessageAgain,
    NewBlock,
)
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.driver_errors import is_passing, is_table_gone, translate
from cassandra_ros.store.connection.protocol import EncodedRows, Prepared
from cassandra_ros.store.connection.requests import Flight, Outcome, Patience
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.checksum import crc32
from cassandra_ros.store.tables.directory import HEARTBEAT_SEC, BucketTotals, Directory
from cassandra_ros.store.tables.row_table import (
    INLINE_COLUMN_BYTES,
    LARGE_MESSAGE_CHUNK_BYTES,
    ODD,
    UNSET,
    NewRow,
    RowTable,
    Shadows,
    bind,
    encode_int,
    encode_long,
    encode_own,
    encode_texts,
)
from cassandra_ros.store.tables.schema import Schema

_log = logging.getLogger(__name__)

TICK_SEC = 0.02
"""Interval at which the writer's thread looks for batches to send, s."""
IDLE_SEC = 10.0
"""Time without rows after which a bucket is closed, s."""
REOPEN_SEC = 30.0
"""Time without a heartbeat after which a bucket is marked open again before it is written to, s."""

# A batch costs the server some 0.5 ms in addition to its rows. Batches of 500 rows and 256 KiB cost
# it an eighth more, those of 200 rows and 64 KiB a third. None is larger than a chunk.
WRITE_BATCH_ROWS = 1000
"""Number of rows from which a batch is sent."""
WRITE_BATCH_BYTES = 512 * 1024
"""Size of the rows from which a batch is sent, bytes."""
BATCHED_LARGE_BYTES = 8 * 1024 * 1024
"""Maximum size of the large messages whose rows wait in a batch, bytes. They stay in memory until
the batch is stored."""
_ROW_OVERHEAD = 60
"""Approximate size of a row in a batch in addition to its message, bytes."""
_OWN = struct.Struct(">iqiqiqii")
"""_t, _seq, _conn and _size, each after its size."""

_time_of, _wire_of = attrgetter("t"), attrgetter("wire")

GONE = (TopicNotFound, KeyspaceNotFound)
"""The errors of a table that was dropped, alone or with its keyspace."""

Again = Callable[[], object]
"""Writes a message again, into the table that its topic has then. Called without the writer's lock,
by ``flush`` or on the writer's thread."""
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
    """Number of serialised bytes of each message, of those in blocks and in chunks too."""
    times: list[int] = field(default_factory=list)
    """Key times, ns: of each row, of blocks the first and the last."""
    again: list[Again | None] = field(default_factory=list)
    """Functions for the rows that were added one by one."""
    runs: list[tuple[Sequence[NewRow], RowAgain]] = field(default_factory=list)
    """Rows that were added together, with one function in place of an ``again`` for each."""
    blocks: list[NewBlock] = field(default_factory=list)
    nbytes: int = 0
    """Approximate size of the statement, bytes."""
    held: int = 0
    """Number of bytes of the messages in chunks, which are not counted in nbytes."""
    odd_rows: int = 0
    """Number of messages that are marked odd; of a block that is marked so all."""
    largest: int = 0
    """Size of the largest message that is stored in its row, bytes; messages in chunks do not
    count."""
    since: float = field(default_factory=time.monotonic)
    """Monotonic time at which its oldest row was added, s; -inf = send the batch without
    waiting."""

    def rewriters(self) -> list[Again | None]:
        """Return for each message, in no order, a function that writes it again, or None."""
        runs = [partial(again, row) for rows, again in self.runs for row in rows]
        blocks = (again for block in self.blocks for again in block.rewriters())
        return [*self.again, *runs, *blocks]


class OpenBucket:
    """State of one partition of one writer; guarded by the writer's lock.

    In a table whose rows have names there is one such object for each row, and the directory does
    not list it. What the outcomes of requests change on other threads (``totals``, ``in_air``,
    ``changed``, ``must_recount``) they change under ``self.mutex``.

    Args:
        table, node, bucket, name: The partition.
        must_recount: Whether the rows of the bucket are counted when it is closed, because this
            writer has rows in it whose number is not known.
        shadows: Indexes for which the rows get values. An index that is made later counts from the
            next bucket on.
        filled: Shadow columns that earlier rows of the writer in the bucket have too.
    """

    def __init__(
        self,
        table: RowTable,
        node: str,
        bucket: int,
        must_recount: bool,
        name: str = "",
        *,
        shadows: Shadows | None = None,
        filled: frozenset[str] = frozenset(),
    ) -> None:
        self.table = table
        self.node = node
        self.bucket = bucket
        self.must_recount = must_recount
        """Whether the bucket has rows that this object did not count, so its totals are not
        final."""
        self.totals = BucketTotals()
        """Counts of the rows that were acknowledged."""
        self.in_air = 0
        """Number of batches, and of large messages in chunks, that have no outcome yet."""
        self.mutex = threading.Lock()
        self.batch = Batch()
        """Rows that have not been sent."""
        self.touched = time.monotonic()
        """Monotonic time at which the last row came, s."""
        self.marked = self.touched
        """Monotonic time at which the bucket was marked in the directory last, s."""
        self.changed = False
        """Whether the directory lacks some of the counts."""
        self._partition_key = table.partition_key(node, name if table.named else bucket)
        self._shadows = shadows
        self.filled = filled
        names = shadows.names if shadows is not None else ()
        self._plain, full = layout_of(table).inserts(names)
        # Statements with few columns, and with all: most rows need only the first.
        self._plain_id, self._full_id = self._plain.query_id, full.query_id
        bound = BoundStatement(self._plain)
        bound.values = list(self._partition_key)
        self._routing_key = bound.routing_key
        values = len(self._plain.column_metadata)
        self._prefix = _statement_head(self._plain_id, values, self._partition_key)

    def key(self, t: int, seq: int) -> tuple[bytes, ...]:
        """Encode the primary key of a row in this bucket."""
        return (*self._partition_key, encode_long(t), encode_long(seq))

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
        """Add the first of some rows without columns, as many as the batch takes; return how many.

        It is 0 if the table has indexes: then each row must be added by ``add``.

        Args:
            rows: At least one. None is too large for its row.
            again: Writes the message of one of these rows again.
        """
        batch = self.batch
        if self._shadows is not None:
            return 0
        if not batch.rows:
            batch.since = time.monotonic()
        rows = rows[: WRITE_BATCH_ROWS - len(batch.rows)]
        sizes = list(map(len, map(_wire_of, rows)))
        room = WRITE_BATCH_BYTES - batch.nbytes
        if sum(sizes) + _ROW_OVERHEAD * len(rows) > room:
            # Up to the row that makes the batch full, so it may be a row larger than the limit.
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
            return True, self._plain_id, (*self._partition_key, *head, *columns)
        flag = ODD if odd else None
        flags: Sequence[bytes | None] = (None, None, flag, raw)
        if chunks:
            flags = (encode_int(chunks.number), encode_long(chunks.crc), flag, None)
        rest = (UNSET if value is None else value for value in (*flags, *columns))
        full = (*self._partition_key, *head, *rest)
        self.batch.nbytes += _ROW_OVERHEAD + sum(len(v) for v in full if v is not UNSET)
        self.batch.odd_rows += odd
        return True, self._full_id, full

    def add_block(self, block: NewBlock, chunks: Chunks | None = None) -> None:
        """Add a block to the batch; if it is one large message, this may be in chunks."""
        batch, sizes = self.batch, list(map(len, block.wires))
        if not batch.rows:
            batch.since = time.monotonic()
        if chunks:
            batch.held += len(block.wire)
        else:  # the block has already waited to be filled
            batch.since, batch.largest = -math.inf, max(batch.largest, *sizes)
        values = (
            *self._partition_key,
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
        large = batch.nbytes >= WRITE_BATCH_BYTES or batch.held >= BATCHED_LARGE_BYTES
        return large or len(batch.rows) >= WRITE_BATCH_ROWS

    def finish_batch(self) -> tuple[Batch, BatchStatement]:
        """Return the filled batch with the statement that stores it, and begin a new batch."""
        rows = self._encode()  # it still counts in the batch that the next line replaces
        batch = self.drop_batch()
        statement = BatchStatement(BatchType.UNLOGGED)
        statement.is_idempotent = True
        # Does at once what BatchStatement.add does row by row (10 to 6 µs a row).
        statement._statements_and_parameters = rows
        statement.routing_key = self._routing_key
        statement.keyspace = self._plain.keyspace
        self.begin_request()
        return batch, statement

    def drop_batch(self) -> Batch:
        """Return the filled batch, and begin a new one."""
        batch, self.batch = self.batch, Batch()
        return batch

    def begin_request(self) -> None:
        """Count a batch or a large message in chunks that is being sent."""
        with self.mutex:
            self.in_air += 1

    def end_chunks(self) -> None:
        """Note that all chunks of a large message are acknowledged and its row is added now."""
        with self.mutex:
            self.in_air -= 1

    def _encode(self) -> EncodedRows:
        """Encode the rows of the batch that are not encoded yet, most of them together."""
        rows = self.batch.rows
        new = [row for row in rows if isinstance(row, NewRow)]
        statements = (
            [row for row in rows if not isinstance(row, NewRow)] if len(new) < len(rows) else []
        )
        encoded = self.table.encoder.encode_together([row.wire for row in new]) if new else ()
        columns = [cells for cells in encoded if cells is not None]
        if len(columns) < len(new):
            for row, cells in zip(new, encoded):
                if cells is None:
                    self.batch.nbytes -= len(row.wire) + _ROW_OVERHEAD  # _statement adds it again
                    statements.append(self._statement(row))
            new = [row for row, cells in zip(new, encoded) if cells is not None]
        self.batch.rows = []  # not needed any more; releases their memory
        parts = chain.from_iterable(zip(repeat(self._prefix), _own_columns(new), columns))
        return EncodedRows(b"".join(parts), len(new), statements)

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
        """Return the counts of stored rows, and note that the directory gets them.

        The result goes on counting: it may be a little ahead, as an open bucket's counts may be.
        """
        self.changed = False
        return self.totals

    def mark(self) -> None:
        """Note that the bucket was just marked in the directory."""
        self.marked = time.monotonic()

    def check_marked(self) -> None:
        """Require a recount if it was marked so long ago that others may have closed the bucket."""
        if time.monotonic() - self.marked > REOPEN_SEC:
            self.require_recount()

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
    """Encode our own columns of rows without chunks, ``_odd`` and ``_raw``, each after its size."""
    if not rows:
        return ()
    times, seqs, conns, wires, *_ = zip(*rows)
    eight = repeat(8)
    return map(_OWN.pack, eight, times, eight, seqs, eight, conns, repeat(4), map(len, wires))


def _statement_head(query_id: bytes, values: int, first: Sequence[bytes]) -> bytes:
    """Encode the beginning of a prepared statement in a batch: its id and its first values.

    Args:
        values: Number of all its values.
    """
    sized = b"".join(encode_int(len(value)) + value for value in first)
    return struct.pack(f">BH{len(query_id)}sH", 1, len(query_id), query_id, values) + sized


_New = Union[NewRow, NewBlock]
LossCallback = Callable[[str, int, CassandraRosError], None]
"""Takes (topic, number of messages, error) of lost messages. It is called on any thread, also on
that of a call of the writer, with its locks: it must not block, nor call the writer."""


@dataclass
class WriteStats:
    """Numbers of the stored and lost rows of one table."""

    stored: int = 0
    bytes: int = 0
    """Number of serialised bytes of the stored messages."""
    lost: int = 0
    reason: str = ""
    """Error text of the first loss; '' = no row was lost."""
    hidden: int = 0
    """Number of stored messages that were missing when their bucket was counted at the end: deleted
    meanwhile, or under an earlier deletion with a later time. Only buckets that the writer had used
    before are counted."""

    def store(self, messages: int, nbytes: int) -> None:
        """Count messages as stored."""
        self.stored += messages
        self.bytes += nbytes

    def lose(self, messages: int, reason: str) -> None:
        """Count messages as lost."""
        self.lost += messages
        self.reason = self.reason or reason

    def add(self, other: WriteStats) -> None:
        """Count what another writer, or the table of another part of the topic, counted."""
        self.store(other.stored, other.bytes)
        self.lose(other.lost, other.reason)
        self.hidden += other.hidden


class RowWriter:
    """Writes rows of any number of tables under one writer id. Thread-safe.

    A thread of its own sends batches that have waited for linger_sec, marks the open buckets in the
    directory, closes idle ones, and writes messages again whose table was dropped.

    Args:
        schema: Makes chunk tables when they are first needed.
        writer_id: 31 bits; the upper half of every ``_seq`` that is written.
        linger_sec: How long a batch may wait to be filled, s.
        block_sec: How long a block may wait to be filled, s; None = until it is full.
        limits: Maximum size of a block.
        give_up_after_sec: How long one request is retried, s.
        on_loss: Called for rows that were given up; without it the next call of add, flush or close
            raises WriteFailed.
        on_beat: Called every HEARTBEAT_SEC, on the writer's thread.
    """

    def __init__(
        self,
        cassandra: Cassandra,
        schema: Schema,
        directory: Directory,
        writer_id: int,
        *,
        linger_sec: float = 0.2,
        block_sec: float | None = None,
        limits: BlockLimits = FULL,
        give_up_after_sec: float = 60.0,
        on_loss: LossCallback | None = None,
        on_beat: Callable[[], None] | None = None,
    ) -> None:
        self._cassandra, self._schema = cassandra, schema
        self.patience = Patience(give_up_after_sec)
        """How long one request is retried."""
        self._directory = directory.patient(self.patience)
        self._writer_id = writer_id
        self._linger_sec, self._block_sec = linger_sec, block_sec
        self._on_loss, self._on_beat = on_loss, on_beat
        self._flight = Flight(cassandra.send_raw, self.patience, cassandra.outage)
        self._buckets: dict[tuple[str, str, int], OpenBucket] = {}
        # Taken after the lock of a builder, never before it.
        self._lock = threading.RLock()
        self._ready: deque[Callable[[], None]] = deque()
        """Functions that send the rows of large messages whose chunks are all stored."""
        self.stats: dict[str, WriteStats] = {}
        """Table name → numbers of its stored and lost rows."""
        self.gone: set[str] = set()
        """Names of tables that were dropped while they were written to."""
        self._builders = Builders(limits, self.add_block, self._raise_error, self.gone)
        self._homeless: deque[tuple[RowTable, Again]] = deque()
        """Rows that these tables did not take, with the functions that write them again."""
        self.gives_back = False
        """Whether rows that a silent store does not take are written again, not lost.

        The functions that write them again then keep them elsewhere."""
        self._moving = threading.Lock()
        """Held while messages are written again, so that ``flush`` waits for those on their way."""
        self._moves = 0
        """How many messages were written again so far."""
        self._counting = threading.Lock()
        """Guards the numbers in stats, which any thread changes."""
        self._error: CassandraRosError | None = None
        """Error of the first loss that no call has raised yet, if there is no on_loss."""
        self._closing = threading.Event()
        self._ticker = threading.Thread(target=self._tick, name="cassandra_ros-writer", daemon=True)
        self._ticker.start()

    def add(self, table: RowTable, node: str, row: NewRow, again: Again | None = None) -> None:
        """Take one row; blocks while too many bytes are in flight.

        Args:
            again: Called later if the table is dropped before the row is stored, to write the
                message into another table; without it the row is lost.

        Raises:
            TopicNotFound, KeyspaceNotFound: The table was dropped, or is being replaced; the row
                was not taken.
            WriteFailed: Earlier rows were given up, and there is no on_loss; this one was not
                taken.
            StoreUnavailable: The program has to end, and the store does not answer. The row may
                have been counted as lost, or queued to be written again.
        """
        with self._lock:
            if self._error is not None:
                self._raise_error()
            try:
                if table.named:
                    bucket = self._name_bucket(table, node, row.name)
                else:
                    bucket = self._bucket(table, node, row.t // table.bucket_ns)
                if len(row.wire) > LARGE_MESSAGE_CHUNK_BYTES:
                    self._send_large(bucket, row, again)
                    return
                bucket.add(row, again)
                if table.named or bucket.is_full():
                    self._send(bucket)
            except GONE:
                self.gone.add(table.name)
                raise

    def add_run(self, table: RowTable, node: str, rows: Sequence[NewRow], again: RowAgain) -> int:
        """Take rows of one bucket whose columns are made later, like add.

        Args:
            rows: None of them is too large for its row.

        Returns:
            The number of rows taken; pass the others to add, which may raise.

        Raises:
            StoreUnavailable: See add.
        """
        at = 0
        with self._lock:
            while at < len(rows) and self._error is None:
                try:
                    bucket = self._bucket(table, node, rows[0].t // table.bucket_ns)
                except GONE:
                    break
                count = bucket.add_run(rows[at:], again)
                at += count
                if bucket.is_full():
                    self._send(bucket)
                elif not count:
                    break
        return at

    def builder(
        self,
        table: RowTable,
        node: str,
        conn: int,
        key_time: KeyTime | None,
        again: MessageAgain,
    ) -> BlockBuilder:
        """Return the builder for the messages of a connection in a table of blocks."""
        self.stats.setdefault(table.name, WriteStats())
        return self._builders.get(table, node, conn, key_time, again)

    def add_block(self, builder: BlockBuilder, block: NewBlock) -> None:
        """Take a block; if that fails its messages are counted as lost, or written again later.

        Of the errors only those that are not this package's are raised.
        """
        table, was_added = builder.table, False
        try:
            if table.name in self.gone:
                raise TopicNotFound(f"topic {table.metadata.topic} was removed")
            with self._lock:
                bucket = self._bucket(table, builder.node, block.t // table.bucket_ns)
                waiting = bucket.batch.nbytes
                if block.in_chunks:
                    self._send_large(bucket, block)
                    return
                if waiting and waiting + len(block.data) > WRITE_BATCH_BYTES:
                    self._send(bucket)
                bucket.add_block(block)
                was_added = True
                if bucket.is_full():
                    self._send(bucket)
        except BaseException as exc:
            # Also after Ctrl-C. From the first chunk on the chunks' outcomes decide.
            is_ours = isinstance(exc, CassandraRosError)
            if not was_added and (is_ours or not block.in_chunks):
                self._fail(table, block.rewriters(), block.times, exc)
            if not is_ours:
                raise

    def _name_bucket(self, table: RowTable, node: str, name: str) -> OpenBucket:
        """Return a new object for the partition of one row that has a name."""
        self._check_taking(table)
        # The directory only lists the nodes: the table itself lists its names.
        self._directory.note(table, node, 0)
        self.stats.setdefault(table.name, WriteStats())
        return OpenBucket(table, node, 0, True, name)

    def _bucket(self, table: RowTable, node: str, number: int) -> OpenBucket:
        """Return the open bucket for a row that comes now; the caller holds the lock.

        Raises:
            TopicNotFound, KeyspaceNotFound: The table was dropped or is being replaced.
        """
        key = (table.name, node, number)
        bucket = self._buckets.get(key)
        now = time.monotonic()
        if bucket is None:
            bucket = self._buckets[key] = self._open(table, node, number)
        elif now - bucket.marked > REOPEN_SEC:
            self._reopen(bucket, late=True)
        bucket.touched = now
        return bucket

    def _check_taking(self, table: RowTable) -> None:
        """Raise TopicNotFound if another table has replaced this one or is about to."""
        if not self._schema.takes_rows(table.name):
            topic = table.metadata.topic
            raise TopicNotFound(f"topic {topic} is converted: messages go into another table")

    def _open(self, table: RowTable, node: str, number: int) -> OpenBucket:
        """Return a bucket that is marked as open in the directory, before its first row is sent."""
        self._check_taking(table)
        # The present indexes: a bucket that is opened before an index is made has no values for it.
        table.follow(self._schema.latest(table.name, table.metadata))
        shadows = table.shadows()
        # Only columns that earlier rows of this writer have, too, are filled in all of its rows.
        entries = self._directory.find(table.name, node, number)
        earlier = [row.filled for row in entries if row.writer == self._writer_id]
        filled = frozenset(shadows.names if shadows else ()).intersection(*earlier)
        bucket = OpenBucket(table, node, number, bool(earlier), shadows=shadows, filled=filled)
        self._reopen(bucket)
        self.stats.setdefault(table.name, WriteStats())
        return bucket

    def _reopen(self, bucket: OpenBucket, late: bool = False) -> None:
        """Mark a bucket as open; late: it was marked so long ago that REOPEN_SEC have passed."""
        # Other clients took this writer for dead: they may have deleted rows and closed the bucket.
        if late:
            self._check_taking(bucket.table)
            bucket.require_recount()
        self._put(bucket, None)

    def _send(self, bucket: OpenBucket) -> None:
        """Send the batch of a bucket, under the lock; wait while too much is on its way."""
        batch, statement = bucket.finish_batch()

        def outcome(exc: BaseException | None) -> None:
            if exc is None:
                bucket.stored(batch)
                self._count(bucket.table, batch)
            else:
                bucket.failed()
                self._fail(bucket.table, batch.rewriters(), batch.times, exc)

        self._flight.submit(statement, batch.nbytes, outcome)

    def _send_large(self, bucket: OpenBucket, new: _New, again: Again | None = None) -> None:
        """Send the chunks of a message; its row follows when all of them are acknowledged.

        From begin_request on the outcomes decide whether the message is lost: each chunk must have
        one, also those that an error leaves unsent.
        """
        table = bucket.table
        self._schema.ensure_chunk_table(table)
        statement = table.insert_chunk()  # may fail, so it comes before anything is counted
        # Here and not when the row is made: then its bytes would have left the processor's cache.
        crc = new.crc if isinstance(new, NewBlock) else crc32(new.wire)
        chunks, count = Chunks(-(-len(new.wire) // LARGE_MESSAGE_CHUNK_BYTES), crc), 0
        outcome, wire = self._chunk_outcome(bucket, new, again, chunks), memoryview(new.wire)
        bucket.begin_request()
        try:
            for number in range(chunks.number):
                data = wire[
                    number * LARGE_MESSAGE_CHUNK_BYTES : (number + 1) * LARGE_MESSAGE_CHUNK_BYTES
                ]
                bound = bind(statement, (*bucket.key(new.t, new.seq), encode_int(number), data))
                count += 1  # submit calls outcome in any case
                self._flight.submit(bound, len(data), outcome)
        except BaseException as exc:
            for _ in range(chunks.number - count):
                outcome(exc)
            raise
        self._commit()

    def _chunk_outcome(
        self, bucket: OpenBucket, new: _New, again: Again | None, chunks: Chunks
    ) -> Outcome:
        """Return the outcome of each chunk of a message: the last one decides about the row."""
        pending, mutex = [chunks.number], threading.Lock()
        failures: list[BaseException] = []

        def outcome(exc: BaseException | None) -> None:
            with mutex:
                pending[0] -= 1
                if exc is not None:
                    failures.append(exc)
                if pending[0]:
                    return
            if failures:
                bucket.failed()
                worst = max(failures, key=is_table_gone)
                rewriters = new.rewriters() if isinstance(new, NewBlock) else [again]
                self._fail(bucket.table, rewriters, [new.t], worst)
            else:
                # This is the driver's thread, and sending may block: the row is sent later.
                self._ready.append(lambda: self._add_row(bucket, new, again, chunks))

        return outcome

    def _add_row(self, bucket: OpenBucket, new: _New, again: Again | None, chunks: Chunks) -> None:
        """Add the row of a large message to the batch, together with other rows.

        A request of its own would cost the server a sixth of what an image costs.
        """
        bucket.end_chunks()
        if isinstance(new, NewBlock):
            bucket.add_block(new, chunks)
        else:
            bucket.add(new, again, chunks)
        if bucket.table.named or bucket.is_full():
            self._send(bucket)

    def _commit(self) -> None:
        """Add the rows of large messages whose chunks are all stored; the caller holds the lock."""
        while self._ready:
            self._ready.popleft()()

    @property
    def pending_bytes(self) -> int:
        """Approximate number of bytes that wait here to be stored."""
        batches = (bucket.batch for bucket in list(self._buckets.values()))
        waiting = self._builders.nbytes + sum(batch.nbytes + batch.held for batch in batches)
        return self._flight.nbytes + waiting

    def _count(self, table: RowTable, batch: Batch) -> None:
        """Count an acknowledged batch."""
        # Called on the driver's thread, on those of retries, and on the caller's.
        with self._counting:
            self.stats[table.name].store(len(batch.sizes), sum(batch.sizes))

    def _fail(
        self,
        table: RowTable,
        rows: Sequence[Again | None],
        times: Sequence[int],
        exc: BaseException,
    ) -> None:
        """Count rows as lost, or queue those that can be written again; called on any thread.

        Args:
            rows: For each message the function that writes it again, or None.
            times: Key times, ns, of which the first and the last are reported.
        """
        lost = len(rows)
        if isinstance(exc, GONE) or is_table_gone(exc):
            # The dropped table has none of them left, so writing them again makes no doubles.
            self.gone.add(table.name)
            lost -= self._write_later(table, rows)
        elif self.gives_back and (isinstance(exc, StoreUnavailable) or is_passing(exc)):
            lost -= self._write_later(table, rows)
        if lost:
            self._lose(table, lost, exc, times)

    def _write_later(self, table: RowTable, rows: Sequence[Again | None]) -> int:
        """Queue the rows that can be written again; return their number."""
        homeless = [(table, again) for again in rows if again is not None]
        self._homeless.extend(homeless)
        return len(homeless)

    def _move_on(self) -> int:
        """Write rows again whose table was dropped or which a silent store did not take.

        Returns:
            How many messages were written again so far, by any thread.
        """
        with self._moving:
            while self._homeless:
                table, again = self._homeless.popleft()
                try:
                    again()
                except CassandraRosError as exc:
                    self._lose(table, 1, exc)
                self._moves += 1
            return self._moves

    def _lose(
        self, table: RowTable, rows: int, exc: BaseException, times: Sequence[int] = ()
    ) -> None:
        """Count messages as lost, and report them; ``times`` as in _fail, () = unknown."""
        topic = table.metadata.topic
        why = translate(exc, "writing", self._cassandra.outage.nodes())
        key_times = times if times and not table.metadata.own_time else (0,)
        error = WriteFailed(
            f"{rows} messages of topic {topic} could not be stored: {why}",
            first_ns=min(key_times),
            last_ns=max(key_times),
        )
        error.__cause__ = exc
        with self._counting:
            self.stats[table.name].lose(rows, str(error))
        if self._on_loss is not None:
            self._on_loss(topic, rows, error)
        elif self._error is None:
            self._error = error

    def _raise_error(self) -> None:
        """Raise, once, the error of rows that were given up without an on_loss."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _tick(self) -> None:
        """Do what is due until the writer is closed: the writer's thread."""
        beat = time.monotonic()
        while not self._closing.wait(TICK_SEC):
            try:
                now = time.monotonic()
                self._move_on()
                if self._block_sec is not None:
                    self._builders.seal(now - self._block_sec)
                with self._lock:
                    self._commit()
                    self._send_old(now)
                if now - beat > HEARTBEAT_SEC:
                    beat = now
                    if self._on_beat is not None:
                        self._on_beat()
                    self._heartbeats(now)
            except CassandraRosError as exc:
                # The directory is late but not wrong: its buckets still count as open.
                # A program that ends while the store is silent reports that itself.
                ending = self._cassandra.outage.left_sec <= 0
                level = logging.DEBUG if ending else logging.WARNING
                _log.log(level, "the directory of buckets could not be updated: %s", exc)
                if self._cassandra.closed:
                    return  # the connection was closed without closing this writer

    def _send_old(self, now: float) -> None:
        """Send the batches that have waited for linger_sec; the caller holds the lock."""
        for bucket in list(self._buckets.values()):
            if bucket.batch.rows and now - bucket.batch.since > self._linger_sec:
                self._send_late(bucket, now)

    def _send_late(self, bucket: OpenBucket, now: float) -> None:
        """Send a batch that may have waited for long, if the process was suspended."""
        if now - bucket.marked > REOPEN_SEC:
            try:
                self._reopen(bucket, late=True)
            except (*GONE, StoreUnavailable) as exc:
                if isinstance(exc, StoreUnavailable) and not self.gives_back:
                    raise
                batch = bucket.drop_batch()
                self._fail(bucket.table, batch.rewriters(), batch.times, exc)
                return
        self._send(bucket)

    def _heartbeats(self, now: float) -> None:
        """Mark the buckets with new counts in the directory, and close idle ones."""
        with self._lock:
            buckets = list(self._buckets.items())
        for key, bucket in buckets:
            idle = now - bucket.touched > IDLE_SEC
            if idle or bucket.changed:
                with self._lock:
                    bucket.check_marked()
                    if idle and not bucket.in_air and not bucket.batch.rows:
                        self._close_or_leave(bucket)
                        del self._buckets[key]
                    else:
                        self._put(bucket, bucket.take_totals())

    def _put(self, bucket: OpenBucket, totals: BucketTotals | None, closed: bool = False) -> None:
        """Mark a bucket in the directory; see Directory.mark."""
        table, node, number = bucket.table, bucket.node, bucket.bucket
        if not closed:
            self._directory.note(table, node, number)
        key = (table.name, node, number, self._writer_id)
        self._directory.mark(key, table.metadata.ttl, bucket.filled, totals, closed=closed)
        bucket.mark()

    def flush(self) -> None:
        """Return when every row that was taken is acknowledged or counted as lost."""
        moves = -1
        # Until none was written again: what was may wait in a batch now.
        while moves != (moves := self._move_on()):
            self._builders.seal()
            with self._lock:
                self._flight.wait()  # for chunks, after which their rows are sent
                self._commit()
                now = time.monotonic()
                for bucket in self._buckets.values():
                    if bucket.batch.rows:
                        self._send_late(bucket, now)
                self._flight.wait()
        self._raise_error()

    def close(self) -> None:
        """Flush, close the buckets in the directory, and end the thread.

        A second call does nothing.
        """
        if self._closing.is_set():
            return
        try:
            self.flush()
        finally:
            self._closing.set()
            if not self.gives_back:  # else it may wait for the silent store
                self._ticker.join()
            self._flight.wait()
        if self.gives_back:
            return  # the buckets stay open, for the one that stores what was given back
        try:
            for bucket in self._buckets.values():
                self._close_or_leave(bucket)
        except StoreUnavailable as exc:
            # Nothing is lost: the next reader counts buckets that stayed open.
            _log.warning("buckets stay open in the directory: %s", exc)
        self._buckets.clear()

    def _close_or_leave(self, bucket: OpenBucket) -> None:
        """Close a bucket in the directory, after a recount if its totals are not final.

        After an error it stays open, and the next reader counts it.

        Raises:
            StoreUnavailable: The store does not answer.
        """
        if bucket.table.name in self.gone:
            return  # its directory was deleted with it, and each try would wait for the table
        bucket.check_marked()
        totals, hidden = bucket.totals, 0
        try:
            if bucket.must_recount:
                recounts = layout_of(bucket.table).recount(bucket.node, bucket.bucket)
                totals = recounts.get(self._writer_id, BucketTotals())
                if self._cassandra.finds_all_written:
                    hidden = max(0, bucket.totals.rows - totals.rows)
            self._put(bucket, totals, closed=True)
            self.stats[bucket.table.name].hidden += hidden
        except StoreUnavailable:
            raise
        except CassandraRosError as exc:
            _log.warning("a bucket of topic %s stays open: %s", bucket.table.metadata.topic, exc)
