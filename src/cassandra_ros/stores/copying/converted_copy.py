# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages copied into a table of another format: decoded here, and encoded anew.

Only messages that are not there yet are written: blocks that begin at other messages than before
would hold some of them twice. So that two copies do not see the same gap and fill it in different
ways, a lock in the target keeps the other one out of the same table and node.
"""

from __future__ import annotations

import time
from typing import Callable, Iterator

from cassandra_ros.keys import split_seq, writer_of
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.rows.verbatim import Part
from cassandra_ros.store.tables.side_tables import SchemaLock
from cassandra_ros.stores.copying.table_pair import TablePair
from cassandra_ros.topics.message_writer import Handle, MessageWriter
from cassandra_ros.topics.stored_row import StoredRow

Choose = Callable[[Read], Iterator[StoredRow]]
"""Function that reads messages of the source, and yields those that are copied, in order."""
RENEW_SEC = 20.0
"""Interval at which the lock is renewed, s."""


class ConvertedCopy:
    """Copies messages of one node into a table of another format. A context manager.

    While it is entered it holds the lock of the table and the node in the target.

    Args:
        sent: Called with the size of each message before it is written; it may wait.
        choose: Reads the messages that are copied; None = all are.

    Attributes:
        taken: Bucket and writer → number of the messages that ``choose`` has yielded, and of their
            bytes, whether they were written now or were there before.
        messages: Number of messages that were written.
        bytes: Number of their serialised bytes.
    """

    def __init__(
        self,
        pair: TablePair,
        node: str,
        sent: Callable[[int], None],
        choose: Choose | None = None,
    ) -> None:
        self._pair, self._node, self._sent = pair, node, sent
        self._choose = choose or self._all_messages
        self.taken: dict[tuple[int, int], tuple[int, int]] = {}
        name = f"copy {pair.target.name} {node}"
        self._lock = SchemaLock(pair.there.cassandra, pair.there.name, name)
        self._writers: dict[int, MessageWriter] = {}
        self._handles: dict[tuple[int, int], Handle] = {}
        self._renewed = time.monotonic()
        self.messages = self.bytes = 0

    def __enter__(self) -> ConvertedCopy:
        self._lock.__enter__()
        return self

    def __exit__(self, failure: object, *exc_info: object) -> None:
        try:
            for writer in self._writers.values():
                writer.close()
        finally:
            self._lock.__exit__(failure, *exc_info)

    def copy(self, bucket_part: Part) -> None:
        """Write the messages of a bucket that are not there yet; return when they are stored.

        Args:
            bucket_part: Its ``keys`` and ``since_us`` do not matter.

        Raises:
            SchemaConflict: The lock has run out, and another copy may hold it.
        """
        length, bucket = self._pair.source.bucket_ns, int(bucket_part.where)
        low = max(bucket * length, bucket_part.ends[0][0])
        high = min((bucket + 1) * length - 1, bucket_part.ends[1][0], LAST_NS)
        read = Read(TimeRange(low, high), Whose((bucket_part.node,), bucket_part.writers))
        keys_there = {(row.t, row.seq) for row in self._pair.rows_there(read)}
        rows = self._count_rows(bucket, self._choose(read))
        self._write(row for row in rows if (row.t, row.seq) not in keys_there)

    def copy_names(self, whose: Whose) -> None:
        """Write the messages with names that are not there yet; return when they are stored."""
        # A position has the name of its table, which is another one there.
        keys = list_names(self._pair.target, None)
        positions_there = {key.position._replace(table="") for key in keys}
        read = Read(whose=whose.both(Whose((self._node,))))
        rows = self._pair.here.rows.read([self._pair.source], read)
        self._write(row for row in rows if row.position._replace(table="") not in positions_there)

    def _all_messages(self, read: Read) -> Iterator[StoredRow]:
        return self._pair.here.rows.read([self._pair.source], read)

    def _count_rows(self, bucket: int, rows: Iterator[StoredRow]) -> Iterator[StoredRow]:
        """Yield the rows of a bucket, and count them in ``taken``."""
        for row in rows:
            key = bucket, writer_of(row.seq)
            count, nbytes = self.taken.get(key, (0, 0))
            self.taken[key] = count + 1, nbytes + row.size
            yield row

    def _write(self, rows: Iterator[StoredRow]) -> None:
        """Write messages under their own writer ids and counters; return when they are stored.

        Raises:
            SchemaConflict: The lock has run out, and another copy may hold it.
        """
        for row in rows:
            now = time.monotonic()
            if now - self._renewed > RENEW_SEC:
                self._lock.renew()
                self._renewed = now
            self._sent(row.size)
            writer, counter = self._writer(writer_of(row.seq)), split_seq(row.seq)[1]
            writer.write(self._handle(writer, row), row.received, counter, row.wire, row.name)
            self.messages += 1
            self.bytes += row.size
        for writer in self._writers.values():
            writer.flush()

    def _writer(self, writer_id: int) -> MessageWriter:
        writer = self._writers.get(writer_id)
        if writer is None:
            writer = self._writers[writer_id] = MessageWriter(
                self._pair.there, writer_id, ttl=None, given=True
            )
        return writer

    def _handle(self, writer: MessageWriter, row: StoredRow) -> Handle:
        """Return the handle of a row's connection in the target, which keeps its number."""
        key = (writer.writer_id, row.conn)
        handle = self._handles.get(key)
        if handle is None:
            self._pair.connect(row.conn)
            handle = Handle(row.connection, self._pair.target, row.conn, row.node, None)
            handle = self._handles[key] = writer.ready(handle)
        return handle
