# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows into Cassandra: batched by bucket, bounded in flight, counted, never silently lost."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from typing import Callable

from cassandra_ros.errors import CassandraRosError, StoreUnavailable, TopicNotFound, WriteFailed
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.counting import recount
from cassandra_ros.store.directory import HEARTBEAT_SEC, BucketTotals, Directory, SlotNotes
from cassandra_ros.store.driver_errors import is_table_gone, translate
from cassandra_ros.store.flight import Flight
from cassandra_ros.store.large import LargeMessages, is_large
from cassandra_ros.store.open_bucket import Batch, OpenBucket
from cassandra_ros.store.row_table import NewRow, RowTable
from cassandra_ros.store.schema import Schema

_log = logging.getLogger(__name__)

TICK_SEC = 0.02
IDLE_SEC = 10.0
REOPEN_SEC = 30.0
"""After so long without a heartbeat a bucket is marked open anew before it is written to."""

LossCallback = Callable[[str, int, CassandraRosError], None]
"""Takes (topic, rows, why) of what was given up; called on any thread."""


@dataclass
class WriteStats:
    """What became of the rows of one table so far."""

    stored: int = 0
    bytes: int = 0
    """Serialised bytes of the stored messages."""
    lost: int = 0
    reason: str = ""
    """Why the first lost ones were lost."""


class RowWriter:
    """Writes rows of any number of tables under one writer id. Thread-safe.

    Args:
        schema: Makes chunk tables when they are first needed.
        writer_id: 31 bits; the upper half of every ``_seq`` that is written.
        linger_sec: How long a batch may wait to be filled.
        give_up_after_sec: How long one request is tried.
        on_loss: Called with (topic, rows, error) for rows that were given up, on another
            thread; without it the next call of add, flush or close raises WriteFailed.
    """

    def __init__(
        self,
        cassandra: Cassandra,
        schema: Schema,
        directory: Directory,
        writer_id: int,
        *,
        linger_sec: float = 0.2,
        give_up_after_sec: float = 60.0,
        on_loss: LossCallback | None = None,
    ) -> None:
        self._schema = schema
        self._directory = directory.patient(give_up_after_sec)
        self._writer_id = writer_id
        self._linger_sec = linger_sec
        self._on_loss = on_loss
        self._flight = Flight(cassandra.send_raw, give_up_after_sec)
        self._buckets: dict[tuple[str, str, int], OpenBucket] = {}
        self._slots = SlotNotes(self._directory)
        self._lock = threading.RLock()
        self._large = LargeMessages(schema, self._flight, self._send, self._lost)
        self.stats: dict[str, WriteStats] = {}
        """Table name → what became of its rows."""
        self.gone: set[str] = set()
        """Tables that were dropped while they were written to."""
        self._counting = threading.Lock()
        self._error: CassandraRosError | None = None
        self._closing = threading.Event()
        self._ticker = threading.Thread(target=self._tick, name="cassandra_ros-writer", daemon=True)
        self._ticker.start()

    # ---------------------------------------------------------------- rows in

    def add(self, table: RowTable, node: str, row: NewRow) -> None:
        """Take one row; blocks while too much is in the air.

        Raises:
            WriteFailed: Earlier rows were given up (only without on_loss).
        """
        with self._lock:
            self._raise_error()
            try:
                if table.named:
                    bucket = self._name_bucket(table, node, row.name)
                else:
                    bucket = self._bucket(table, node, table.bucket_of(row.t))
                if not is_large(len(row.wire)):
                    odd, raw = row.odd, row.raw
                    own = (None, None, odd, raw) if odd or raw is not None else None
                    bucket.add(row, row.columns, own)
                    if table.named or bucket.is_full():
                        self._send(bucket)
                    return
                if bucket.batch.rows:
                    self._send(bucket)
                self._large.send(bucket, row)
            except TopicNotFound:
                self.gone.add(table.name)
                raise

    def _name_bucket(self, table: RowTable, node: str, name: str) -> OpenBucket:
        # The directory only tells which nodes there are: the table itself lists its names.
        self._slots.note(table, node, 0)
        self.stats.setdefault(table.name, WriteStats())
        return OpenBucket(table, node, 0, True, name)

    def _bucket(self, table: RowTable, node: str, number: int) -> OpenBucket:
        key = (table.name, node, number)
        bucket = self._buckets.get(key)
        now = time.monotonic()
        if bucket is None:
            bucket = self._open(table, node, number)
            self._buckets[key] = bucket
        elif now - bucket.marked > REOPEN_SEC:
            self._reopen(bucket, late=True)
        bucket.touched = now
        return bucket

    def _open(self, table: RowTable, node: str, number: int) -> OpenBucket:
        # The indexes of now: a bucket that is opened before one is made is filled without it.
        table.metadata = self._schema.latest(table.name, table.metadata)
        shadows = table.shadows()
        found = self._directory.find(table.name, node, number)
        mine = [row.filled for row in found if row.writer == self._writer_id]
        filled = frozenset(shadows.names if shadows else ()).intersection(*mine)
        bucket = OpenBucket(table, node, number, bool(mine), shadows=shadows, filled=filled)
        self._reopen(bucket)
        self.stats.setdefault(table.name, WriteStats())
        return bucket

    def _reopen(self, bucket: OpenBucket, late: bool = False) -> None:
        # Others took the writer for dead: they may have deleted, and closed the bucket since.
        bucket.must_recount = bucket.must_recount or late
        table, node, number = bucket.table, bucket.node, bucket.bucket
        self._slots.note(table, node, number)
        place = (table.name, node, number, self._writer_id)
        self._directory.mark(place, table.metadata.ttl, bucket.filled)
        bucket.marked = time.monotonic()

    def _send(self, bucket: OpenBucket, large: bool = False) -> None:
        batch, statement = bucket.take()

        def outcome(exc: BaseException | None) -> None:
            if exc is None:
                bucket.stored(batch, large)
                self._count(bucket.table, batch)
            else:
                bucket.failed()
                self._lost(bucket.table, len(batch.rows), exc)

        self._flight.submit(statement, batch.nbytes, outcome)

    # ---------------------------------------------------------------- outcomes

    def _count(self, table: RowTable, batch: Batch) -> None:
        # The driver's, the retry and the calling thread come by here.
        with self._counting:
            stats = self.stats[table.name]
            stats.stored += len(batch.sizes)
            stats.bytes += sum(batch.sizes)

    def _lost(self, table: RowTable, rows: int, exc: BaseException) -> None:
        topic = table.metadata.topic
        error = WriteFailed(
            f"{rows} messages of topic {topic} could not be stored: {translate(exc, 'writing')}"
        )
        error.__cause__ = exc
        with self._counting:
            stats = self.stats[table.name]
            stats.lost += rows
            stats.reason = stats.reason or str(error)
            if is_table_gone(exc):
                self.gone.add(table.name)
        if self._on_loss is not None:
            self._on_loss(topic, rows, error)
        elif self._error is None:
            self._error = error

    def _raise_error(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    # ---------------------------------------------------------------- time

    def _tick(self) -> None:
        beat = time.monotonic()
        while not self._closing.wait(TICK_SEC):
            try:
                now = time.monotonic()
                with self._lock:
                    self._large.commit()
                    self._send_old(now)
                if now - beat > HEARTBEAT_SEC:
                    beat = now
                    self._heartbeats(now)
            except CassandraRosError as exc:
                # The directory is behind, never wrong: its buckets still count as open.
                _log.warning("the directory of buckets could not be updated: %s", exc)

    def _send_old(self, now: float) -> None:
        for bucket in list(self._buckets.values()):
            if bucket.batch.rows and now - bucket.batch.since > self._linger_sec:
                if now - bucket.marked > REOPEN_SEC:
                    self._reopen(bucket, late=True)  # this process stood still
                self._send(bucket)

    def _heartbeats(self, now: float) -> None:
        with self._lock:
            buckets = list(self._buckets.items())
        for key, bucket in buckets:
            idle = now - bucket.touched > IDLE_SEC
            if idle or bucket.changed:
                with self._lock:
                    if idle and not bucket.in_air and not bucket.batch.rows:
                        self._close_or_leave(bucket)
                        del self._buckets[key]
                    else:
                        self._mark(bucket)

    def _mark(self, bucket: OpenBucket) -> None:
        bucket.changed = False
        self._slots.note(bucket.table, bucket.node, bucket.bucket)
        self._put(bucket, bucket.totals, closed=False)
        bucket.marked = time.monotonic()

    def _close(self, bucket: OpenBucket) -> None:
        totals = bucket.totals
        if bucket.must_recount:
            counted = recount(bucket.table, bucket.node, bucket.bucket)
            totals = counted.get(self._writer_id, BucketTotals())
        self._put(bucket, totals, closed=True)

    def _put(self, bucket: OpenBucket, totals: BucketTotals, closed: bool) -> None:
        table = bucket.table
        place = (table.name, bucket.node, bucket.bucket, self._writer_id)
        self._directory.mark(place, table.metadata.ttl, bucket.filled, totals, closed=closed)

    # ---------------------------------------------------------------- end

    def flush(self) -> None:
        """Return when every row that was taken is acknowledged or counted as lost.

        Raises:
            WriteFailed: Rows were given up (only without on_loss).
        """
        self._large.wait()
        with self._lock:
            self._large.commit()
            for bucket in self._buckets.values():
                if bucket.batch.rows:
                    self._send(bucket)
            self._flight.wait()
            self._raise_error()

    def close(self) -> None:
        """Flush, close the buckets in the directory, end the threads. Twice is harmless.

        Raises:
            WriteFailed: Rows were given up (only without on_loss).
        """
        if self._closing.is_set():
            return
        try:
            self.flush()
        finally:
            self._closing.set()
            self._ticker.join()
            self._flight.close()
        self._close_all()

    def _close_or_leave(self, bucket: OpenBucket) -> None:
        if bucket.table.name in self.gone:
            return  # its directory went with it, and each try would wait for the table
        try:
            self._close(bucket)
        except StoreUnavailable:
            raise
        except CassandraRosError as exc:
            _log.warning("a bucket of topic %s stays open: %s", bucket.table.metadata.topic, exc)

    def _close_all(self) -> None:
        try:
            for bucket in self._buckets.values():
                self._close_or_leave(bucket)
        except StoreUnavailable as exc:
            # Nothing is lost: buckets that stay open are counted live by the next reader.
            _log.warning("buckets stay open in the directory: %s", exc)
        self._buckets.clear()
