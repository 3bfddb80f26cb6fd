# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write bags of format 2.0, any number of connections on a topic, each byte for byte."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections import defaultdict
from contextlib import suppress
from operator import itemgetter
from struct import Struct
from typing import IO

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.chunk import COMPRESSIONS, compress_chunk, message_head
from cassandra_ros.errors import BagError
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection import Connection

CHUNK_BYTES = 768 * 1024
"""A chunk is closed when its content has grown over this, as in rosbag."""
_ENTRY = Struct("<III")
_SPOOL_BYTES = 1 << 20
_BUFFER_BYTES = 1 << 16
"""More than the header, so that its writing cannot fail before there is something to clean up."""


class BagWriter:
    """A bag that is being written; also a context manager.

    The file is OUT.active until close() renames it, as with ``rosbag record``; leaving the
    context by an exception removes it. Memory: one chunk and the connections.

    Args:
        path: The bag to make; an existing one is replaced at the end.
        compression: 'none', 'bz2' or 'lz4'.
        chunk_bytes: Content of a chunk at which it is closed, uncompressed bytes.

    Raises:
        BagError: The compression is unknown, or the file cannot be made.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        compression: str = "none",
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        if compression not in COMPRESSIONS:
            known = ", ".join(COMPRESSIONS)
            raise BagError(f"{compression!r} is not a compression of bags; known are {known}")
        self.path = os.fspath(path)
        self._active = self.path + ".active"
        self._compression = compression
        self._chunk_bytes = chunk_bytes
        self._connections: dict[int, Connection] = {}
        self._used: set[int] = set()
        self._chunk = bytearray()
        # Per connection of the open chunk: time and offset of each message, for its index record.
        self._entries: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        self._chunk_count = 0
        self._infos: IO[bytes] = tempfile.SpooledTemporaryFile(_SPOOL_BYTES)
        self._closed = False
        try:
            self._file: IO[bytes] = open(self._active, "wb", _BUFFER_BYTES)
        except OSError as exc:
            raise BagError(f"{self._active} cannot be written: {exc.strerror}") from exc
        self._file.write(bagformat.MAGIC + self._file_header(0))

    def connection(self, connection: Connection, number: int | None = None) -> int:
        """Add a connection, written as it is before its first message; return its number.

        Args:
            number: Its number in this bag, unique, in [0, 2**32 - 1]; None = the next free one,
                behind all others while there is one. Between equal times the lower number is read
                first.

        Raises:
            BagError: The number is taken.
        """
        if number is None:
            number = max(self._connections, default=-1) + 1
            if number == 2**32:
                number = next(n for n in itertools.count() if n not in self._connections)
        if number in self._connections or not 0 <= number < 2**32:
            raise BagError(f"{self.path}: connection number {number} is taken or out of range")
        self._connections[number] = connection
        return number

    def write(self, number: int, t_ns: int, data: bytes) -> None:
        """Append a serialised message of a connection, received at t_ns, ns since 1970.

        Raises:
            BagError: The disk is full or fails.
        """
        if number not in self._used:
            self._chunk += self._connection_record(number)
            self._used.add(number)
        self._entries[number].append((t_ns, len(self._chunk)))
        self._chunk += message_head(number, t_ns, len(data))
        self._chunk += data
        if len(self._chunk) > self._chunk_bytes:
            self._flush_chunk()

    def close(self) -> None:
        """Write the index and give the file its name; twice is harmless.

        Raises:
            BagError: The disk is full or fails; the unfinished file is removed.
        """
        if self._closed:
            return
        if self._entries:
            self._flush_chunk()
        try:
            index_pos = self._file.tell()
            for number in sorted(self._used):
                self._file.write(self._connection_record(number))
            self._infos.seek(0)
            for part in iter(lambda: self._infos.read(_SPOOL_BYTES), b""):
                self._file.write(part)
            self._file.seek(len(bagformat.MAGIC))
            self._file.write(self._file_header(index_pos))
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self._active, self.path)
        except OSError as exc:
            self.discard()
            raise BagError(f"{self.path} cannot be written: {exc.strerror}") from exc
        self._closed = True
        self._infos.close()

    def discard(self) -> None:
        """Close and remove the unfinished file; a file that was there before stays."""
        if self._closed:
            return
        self._closed = True
        self._infos.close()
        # Closing writes what is buffered, which fails once more where the disk is full.
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            os.unlink(self._active)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _file_header(self, index_pos: int) -> bytes:
        counts = (len(self._used), self._chunk_count) if index_pos else (0, 0)
        fields = (
            (b"op", bagformat.OP_FILE_HEADER),
            (b"index_pos", index_pos),
            (b"conn_count", counts[0]),
            (b"chunk_count", counts[1]),
        )
        padding = bagformat.FILE_HEADER_BYTES - len(bagformat.pack_fields(fields))
        return bagformat.pack_record(fields, b" " * padding)

    def _connection_record(self, number: int) -> bytes:
        connection = self._connections[number]
        topic = connection.topic.encode("utf-8", "surrogateescape")
        fields = ((b"op", bagformat.OP_CONNECTION), (b"topic", topic), (b"conn", number))
        return bagformat.pack_record(fields, connection.header)

    def _flush_chunk(self) -> None:
        compression, size = self._compression.encode("ascii"), len(self._chunk)
        header = ((b"op", bagformat.OP_CHUNK), (b"compression", compression), (b"size", size))
        data = compress_chunk(self._compression, bytes(self._chunk))
        try:
            position = self._file.tell()
            self._file.write(bagformat.pack_record(header, data))
            for number, entries in sorted(self._entries.items()):
                self._file.write(_index_record(number, entries))
            self._infos.write(self._info_record(position))
        except OSError as exc:
            raise BagError(f"{self._active} cannot be written: {exc.strerror}") from exc
        self._chunk_count += 1
        self._chunk.clear()
        self._entries.clear()

    def _info_record(self, position: int) -> bytes:
        times = [t_ns for entries in self._entries.values() for t_ns, _ in entries]
        fields = (
            (b"op", bagformat.OP_CHUNK_INFO),
            (b"ver", bagformat.INDEX_VERSION),
            (b"chunk_pos", position),
            (b"start_time", bagformat.pack_time(min(times))),
            (b"end_time", bagformat.pack_time(max(times))),
            (b"count", len(self._entries)),
        )
        counts = sorted((number, len(entries)) for number, entries in self._entries.items())
        return bagformat.pack_record(fields, b"".join(bagformat.COUNT.pack(*n) for n in counts))


def _index_record(number: int, entries: list[tuple[int, int]]) -> bytes:
    fields = (
        (b"op", bagformat.OP_INDEX),
        (b"conn", number),
        (b"ver", bagformat.INDEX_VERSION),
        (b"count", len(entries)),
    )
    # rosbag merges these lists without sorting them. The sort is stable: equal times stay
    # in the order in which they were written.
    entries.sort(key=itemgetter(0))
    data = [_ENTRY.pack(*divmod(t_ns, SECOND_NS), offset) for t_ns, offset in entries]
    return bagformat.pack_record(fields, b"".join(data))
