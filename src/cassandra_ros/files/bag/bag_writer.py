# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write bags of format 2.0. A topic may have any number of connections, kept byte for byte."""

from __future__ import annotations

import os
import tempfile
from collections import defaultdict
from operator import itemgetter
from struct import Struct
from typing import IO

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.file_writer import FileWriter
from cassandra_ros.keys import SECOND_NS

BAG_CHUNK_BYTES = 768 * 1024
"""Size of a chunk's content above which the chunk is closed, bytes; the default of rosbag."""
_ENTRY = Struct("<III")
"""Entry of an index record: seconds, nanoseconds, offset of the message in its chunk."""
_INFO_BYTES = 1 << 20
"""Size of the chunk info records above which they wait on disk, and that is copied at once, bytes.
"""


class BagWriter(FileWriter):
    """A bag that is being written, see FileWriter. Memory: one chunk and all connections.

    Args:
        path: The bag to write; an existing file is replaced when the bag is closed.
        compression: 'none', 'bz2' or 'lz4'.
        chunk_bytes: Size of a chunk's content above which the chunk is closed, uncompressed bytes.

    Raises:
        BagError: The compression is unknown, or the file cannot be made.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        compression: str = "none",
        chunk_bytes: int = BAG_CHUNK_BYTES,
    ) -> None:
        if compression not in bagformat.COMPRESSIONS:
            names = ", ".join(bagformat.COMPRESSIONS)
            raise BagError(f"{compression!r} is not a compression of bags; known are {names}")
        super().__init__(path)
        self._compression = compression
        self._chunk_bytes = chunk_bytes
        self._used: set[int] = set()
        """Numbers of the connections that have messages; the index lists only these."""
        self._chunk = bytearray()
        # Connection number -> time and offset of each message in the open chunk, for its index.
        self._entries: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        self._chunk_count = 0
        infos = tempfile.SpooledTemporaryFile(_INFO_BYTES)
        self._infos: IO[bytes] = self._resources.enter_context(infos)
        """Chunk info records, which follow all chunks in the file."""
        self._file.write(bagformat.MAGIC + self._file_header(0))

    def write(
        self, number: int, t_ns: int, data: bytes, delay_ns: int = 0, sequence: int = 0
    ) -> None:
        """Append a message, see FileWriter. A bag cannot store delay_ns and sequence."""
        if number not in self._used:
            self._chunk += self._connection_record(number)
            self._used.add(number)
        self._entries[number].append((t_ns, len(self._chunk)))
        self._chunk += bagformat.message_head(number, t_ns, len(data))
        self._chunk += data
        if len(self._chunk) > self._chunk_bytes:
            self._flush_chunk()

    def _finish(self) -> None:
        if self._entries:
            self._flush_chunk()
        index_pos = self._file.tell()
        for number in sorted(self._used):
            self._file.write(self._connection_record(number))
        self._infos.seek(0)
        for infos in iter(lambda: self._infos.read(_INFO_BYTES), b""):
            self._file.write(infos)
        self._file.seek(len(bagformat.MAGIC))
        self._file.write(self._file_header(index_pos))

    def _file_header(self, index_pos: int) -> bytes:
        """Return the first record, always of FILE_HEADER_BYTES: ``_finish`` overwrites it.

        Args:
            index_pos: Offset of the index; 0 = the bag is not complete.
        """
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
        """Write the open chunk with its index records, and begin a new one; raises BagError."""
        compression, size = self._compression.encode("ascii"), len(self._chunk)
        header = ((b"op", bagformat.OP_CHUNK), (b"compression", compression), (b"size", size))
        data = bagformat.compress_chunk(self._compression, bytes(self._chunk))
        try:
            position = self._file.tell()
            self._file.write(bagformat.pack_record(header, data))
            for number, entries in sorted(self._entries.items()):
                self._file.write(_index_record(number, entries))
            self._infos.write(self._info_record(position))
        except OSError as exc:
            raise self._failure(exc) from exc
        self._chunk_count += 1
        self._chunk.clear()
        self._entries.clear()

    def _info_record(self, position: int) -> bytes:
        """Return the chunk info record of the open chunk, which begins at a file offset."""
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
    """Return the index record of a connection in a chunk; sorts its entries (time, offset)."""
    fields = (
        (b"op", bagformat.OP_INDEX),
        (b"conn", number),
        (b"ver", bagformat.INDEX_VERSION),
        (b"count", len(entries)),
    )
    # rosbag merges these lists without sorting them. The sort is stable: messages of equal time
    # keep the order in which they were written.
    entries.sort(key=itemgetter(0))
    data = [_ENTRY.pack(*divmod(t_ns, SECOND_NS), offset) for t_ns, offset in entries]
    return bagformat.pack_record(fields, b"".join(data))
