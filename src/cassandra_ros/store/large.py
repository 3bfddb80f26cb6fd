# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large messages: their bytes in chunks, all of them acknowledged before the row that commits them.

They are checked when they are read.
"""

from __future__ import annotations

import threading
import zlib
from collections import deque
from typing import Callable, Deque, Iterable, Iterator

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.flight import Flight, Outcome
from cassandra_ros.store.open_bucket import OpenBucket
from cassandra_ros.store.paging import RawRow
from cassandra_ros.store.row_table import (
    CHUNK_BYTES,
    INLINE_COLUMN_BYTES,
    NewRow,
    RowTable,
    TableRow,
    bind,
    encode_int,
)
from cassandra_ros.store.schema import Schema

_PAGE_CHUNKS = 4


def is_large(size: int) -> bool:
    """Say whether a message of this many bytes is stored in chunks."""
    return size > CHUNK_BYTES


def chunk_count(size: int) -> int:
    """Return how many chunks a message of this many bytes has."""
    return -(-size // CHUNK_BYTES)


def checksum(wire: bytes) -> int:
    """CRC-32 of a whole message, unsigned."""
    return zlib.crc32(wire) & 0xFFFFFFFF


def pieces(wire: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (number, bytes) of each chunk of a message."""
    view = memoryview(wire)
    for number in range(chunk_count(len(wire))):
        yield number, bytes(view[number * CHUNK_BYTES : (number + 1) * CHUNK_BYTES])


def read_chunks(table: RowTable, row: TableRow) -> bytes:
    """Read the bytes of a large message.

    Raises:
        CorruptMessage: Chunks are missing, or size or checksum do not agree with the row.
    """

    def data_of(rows: Iterable[RawRow]) -> list[bytes]:
        parts: list[bytes] = []
        for number, data in rows:
            if number != encode_int(len(parts)) or len(parts) >= row.nchunks:
                break
            parts.append(data or b"")
        return parts

    bound = bind(table.select_chunks(), table.key_of(row), _PAGE_CHUNKS)
    parts = table.collect(bound, data_of, "reading a large message of")
    wire = b"".join(parts)
    if len(parts) != row.nchunks or len(wire) != row.size or checksum(wire) != row.crc:
        raise CorruptMessage(
            f"the message of topic {table.metadata.topic} at {row.t} is incomplete: "
            f"{len(parts)} of {row.nchunks} chunks, {len(wire)} of {row.size} bytes"
            f"{'' if len(wire) != row.size else ', wrong checksum'}; repair the cluster, or "
            "import or record it again"
        )
    return wire


class LargeMessages:
    """Sends messages that are kept in chunks; guarded by the writer's lock but for wait.

    Args:
        schema: Makes the chunk table when it is first needed.
        flight: Sends the chunks.
        send: Sends the batch of a bucket; told whether its row is one of a large message.
        lost: Told (table, messages, error) of what was given up.
    """

    def __init__(
        self,
        schema: Schema,
        flight: Flight,
        send: Callable[[OpenBucket, bool], None],
        lost: Callable[[RowTable, int, BaseException], None],
    ) -> None:
        self._schema = schema
        self._flight = flight
        self._send = send
        self._lost = lost
        self._ready: Deque[Callable[[], None]] = deque()
        self._count = 0
        self._changed = threading.Condition()

    def send(self, bucket: OpenBucket, new: NewRow) -> None:
        """Send the chunks of a message; its row follows by commit, when all of them are stored."""
        table = bucket.table
        if not table.has_chunks:
            self._schema.ensure_chunk_table(table.name, table.metadata)
            table.has_chunks = True
        small = [
            c if c is not None and len(c) <= INLINE_COLUMN_BYTES else None for c in new.columns
        ]
        wire, odd = new.wire, new.odd or None in small
        own = (chunk_count(len(wire)), checksum(wire), odd, None)

        def row() -> None:
            # Alone in its batch: its size is not one of a row with the message inside.
            if bucket.batch.rows:
                self._send(bucket, False)
            with bucket.mutex:
                bucket.in_air -= 1
            bucket.add(new, small, own)
            self._send(bucket, True)

        table.insert_chunk()  # prepared before anything is counted: it may fail
        outcome = self._outcome(bucket, chunk_count(len(wire)), row)
        with bucket.mutex:
            bucket.in_air += 1
        with self._changed:
            self._count += 1
        self._send_chunks(table, bucket.key(new.t, new.seq), wire, outcome)
        self.commit()

    def _send_chunks(
        self, table: RowTable, key: tuple[bytes, ...], wire: bytes, outcome: Outcome
    ) -> None:
        statement, told = table.insert_chunk(), 0
        try:
            for number, data in pieces(wire):
                bound = bind(statement, (*key, encode_int(number), data))
                told += 1  # whatever happens in submit, it tells the outcome
                self._flight.submit(bound, len(data), outcome)
        except BaseException as exc:
            for _ in range(chunk_count(len(wire)) - told):
                outcome(exc)
            raise

    def _outcome(self, bucket: OpenBucket, chunks: int, row: Callable[[], None]) -> Outcome:
        left, failures, mutex = [chunks], [], threading.Lock()

        def outcome(exc: BaseException | None) -> None:
            with mutex:
                left[0] -= 1
                if exc is not None:
                    failures.append(exc)
                if left[0]:
                    return
            if failures:
                bucket.failed()
                self._lost(bucket.table, 1, failures[0])
            else:
                # Not sent from here: this is the driver's thread, and sending may block.
                self._ready.append(row)
            with self._changed:
                self._count -= 1
                self._changed.notify_all()

        return outcome

    def commit(self) -> None:
        """Send the rows of messages whose chunks are all stored."""
        while self._ready:
            self._ready.popleft()()

    def wait(self) -> None:
        """Return when the chunks of every message are stored or given up."""
        with self._changed:
            while self._count:
                self._changed.wait()
