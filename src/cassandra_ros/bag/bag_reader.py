# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read bags of format 2.0, chunk by chunk, without message classes."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack
from typing import BinaryIO, Mapping

import numpy as np

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.allowance import Allowance
from cassandra_ros.bag.bag_index import BagIndex, IndexPlace
from cassandra_ros.bag.chunk import (
    MIN_AT_ONCE,
    ChunkMessages,
    Longs,
    decompress_chunk,
    find_messages,
    unpack_part,
)
from cassandra_ros.bag.message_file import MessageFile
from cassandra_ros.bag.salvage import SalvageReport, read_salvage
from cassandra_ros.errors import BagError


class BagReader(BagIndex, MessageFile):
    """A bag that is open for reading; also a context manager.

    Memory: 40 bytes for each chunk of the bag. While a chunk is read, also the chunk packed and
    unpacked, and about 200 bytes for each of its messages.

    Attributes:
        connections: Connections by number, in the order of the index. Like rosbag, we leave out
            connections without messages.
        counts: Number of messages by connection number.
        message_count: Number of messages in the bag.
        chunk_count: Number of chunks in the bag.
        start_ns, end_ns: Times of the first and the last message, ns; 0 in an empty bag.
        salvaged: The damage that was found when the bag was opened with ``salvage``, if any.

    Args:
        salvage: If the bag is cut short, damaged or was not closed, read the messages before the
            damage. All chunks are read to find it. An undamaged bag is read as usual.
        large_chunks: Also read chunks and bags that an Allowance refuses by default. A bag that
            was made to do harm can then fill the memory.

    Raises:
        BagUnindexed: The bag was not closed properly, or is cut short.
        BagTooLarge: A chunk would unpack to more bytes than the Allowance permits (raised when the
            chunk is read).
        BagError: The file cannot be opened, is not a bag of format 2.0, is encrypted, or its index
            is damaged; with salvage: no message can be read.
    """

    def __init__(
        self, path: str | os.PathLike[str], salvage: bool = False, large_chunks: bool = False
    ) -> None:
        name, self.salvaged = os.fspath(path), SalvageReport()
        try:
            with ExitStack() as opened:
                file = opened.enter_context(open(name, "rb"))
                file_bytes = os.fstat(file.fileno()).st_size
                allowance = Allowance(file_bytes, large_chunks)
                place = self._salvage(file, name, allowance) if salvage else None
                if place is not None:
                    opened.enter_context(place.file)
                super().__init__(file, name, place)
                self._allowance = Allowance(file_bytes, large_chunks)
                self._counted = bytearray(self.chunk_count)
                """One byte per chunk: 1 = the allowance has counted it, so not counted again."""
                opened.pop_all()
        except OSError as exc:
            raise BagError(f"{name} cannot be read: {exc.strerror}") from exc

    def _salvage(self, file: BinaryIO, name: str, allowance: Allowance) -> IndexPlace | None:
        """Return a rebuilt index of a damaged bag, or None if the bag's own index is valid."""
        found, place = read_salvage(file, name, allowance)
        if not found.why:
            try:
                BagIndex(file, name)
                place.file.close()
                return None
            except BagError:
                found.end("has an index that cannot be read")
        self.salvaged = found
        return place

    def close(self) -> None:
        """Close the file. A second call does nothing."""
        self._file.close()
        self._index.close()

    def compressions(self) -> dict[str, int]:
        """Return the number of chunks by compression. This reads the header of every chunk."""
        return dict(Counter(self._chunk_header(i)[0] for i in range(self.chunk_count)))

    def chunk_content(self, chunk: int) -> tuple[bytes, ChunkMessages]:
        """Read a chunk. Return its content and the list of its messages, see MessageFile."""
        where, counts = self._where(chunk), self.chunk_info(chunk).counts
        compression, size, data_bytes = self._chunk_header(chunk)
        if compression == "none" and size != data_bytes:
            raise BagError(f"{where} is damaged: it states both {size} and {data_bytes} bytes")
        if not self._counted[chunk]:
            self._allowance.take(compression, size, data_bytes, where)
            self._counted[chunk] = 1
        try:
            data = self._file.read(data_bytes)
        except OSError as exc:
            raise BagError(f"{where} cannot be read: {exc.strerror}") from exc
        cut = self.salvaged.cut
        if cut is not None and cut.number == chunk:
            content = unpack_part(compression, data, cut.content_bytes)[: cut.content_bytes]
            offsets = None
        else:
            content = decompress_chunk(compression, data, size, where)
            offsets = self._offsets(counts)
        messages = find_messages(content, where, offsets)
        present, inverse, each = np.unique(messages.ids, return_inverse=True, return_counts=True)
        numbers = [self.numbers.get(file_id, -1) for file_id in present.tolist()]
        ids = np.array(numbers, np.int64)[inverse]
        if dict(zip(numbers, each.tolist())) != counts:
            raise BagError(
                f"{where} is damaged: its {len(ids)} messages are not those that the index "
                f"lists; repair it with: rosbag reindex {self.path}"
            )
        return content, messages._replace(ids=ids)

    def _offsets(self, counts: Mapping[int, int]) -> Longs | None:
        """Read the offsets of messages from the index records at the current file position.

        Return None if they do not list all messages of the chunk, or if searching the chunk for
        its messages is faster.
        """
        count = sum(counts.values())
        if count < MIN_AT_ONCE * max(1, len(counts)):
            return None
        found: list[Longs] = []
        try:
            for _ in counts:
                record = bagformat.read_record(self._file, bagformat.OP_INDEX, self.path)
                if record.data_bytes > 12 * count:
                    return None
                entries = np.frombuffer(self._file.read(record.data_bytes), "<u4")
                found.append(entries[2::3].astype(np.int64))
        except (BagError, OSError, ValueError):
            return None
        offsets = np.concatenate(found)
        return np.sort(offsets) if len(offsets) == count else None

    def _chunk_header(self, chunk: int) -> tuple[str, int, int]:
        where, cut = self._where(chunk), self.salvaged.cut
        if cut is not None and cut.number == chunk:
            self._file.seek(cut.data_pos)
            return cut.compression, cut.data_bytes, cut.data_bytes
        self._file.seek(self._chunk(chunk)[0])
        fields, _, data_bytes = bagformat.read_record(self._file, bagformat.OP_CHUNK, where)
        compression = fields.get(b"compression", b"").decode("utf-8", "replace")
        return compression, bagformat.number(fields, b"size", where), data_bytes

    def _where(self, chunk: int) -> str:
        return f"{self.path}: chunk {chunk + 1} of {self.chunk_count}"
