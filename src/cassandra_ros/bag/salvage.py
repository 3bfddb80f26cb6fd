# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rebuild the index of a bag from its chunks, up to the first damage.

For a bag that is cut short, damaged, or was never closed (.bag.active, after a crash of the
recorder). Unlike rosbag reindex, this does not change the file, and it also keeps the messages
before the damage in the damaged chunk.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.allowance import Allowance
from cassandra_ros.bag.bag_index import IndexPlace, check_connection, read_start
from cassandra_ros.bag.chunk import decompress_chunk, message_of, record_at, unpack_part
from cassandra_ros.errors import BagError, BagTooLarge


class CutChunk(NamedTuple):
    """The damaged chunk of a bag."""

    number: int
    compression: str
    data_pos: int
    data_bytes: int
    content_bytes: int
    """Size of the unpacked content before the damage, bytes."""


@dataclass
class SalvageReport:
    """The damage of a bag, and how much of the bag can be read."""

    messages: int = 0
    """Number of messages that can be read."""
    why: str = ""
    """Description of the damage; '' = all chunks are complete."""
    lost_bytes: int = 0
    """Maximum number of bytes of the file that cannot be read; 0 if only the index is missing.

    A damaged compressed chunk counts with all its bytes, although some of them can be read.
    """
    cut: CutChunk | None = None
    """The damaged chunk, if messages before the damage can be read."""

    def end(self, why: str, lost_bytes: int = 0) -> None:
        """Note the damage, and how many bytes of the file cannot be read."""
        self.why = why
        self.lost_bytes = lost_bytes

    def told(self, path: str) -> str:
        """Return a sentence about the damage and what can be read; '' if nothing is damaged."""
        if not self.why:
            return ""
        left = (
            f"at most {self.lost_bytes} bytes after them are lost"
            if self.lost_bytes
            else ("no message that the file holds is lost")
        )
        return f"{path} {self.why}: {self.messages} messages up to there are read, {left}"


@dataclass
class _Scan:
    """Reads a bag, chunk by chunk, and collects the records of a new index."""

    file: BinaryIO
    path: str
    allowance: Allowance
    salvaged: SalvageReport = field(default_factory=SalvageReport)
    connections: dict[int, bytes] = field(default_factory=dict)
    """Connection record by connection id in the file."""
    infos: list[bytes] = field(default_factory=list)
    """Chunk info records."""

    def run(self) -> None:
        """Collect connections and chunks up to the index, the end of the file or the damage."""
        start = read_start(self.file, self.path)
        self.file.seek(start.data_pos + start.data_bytes)
        size = os.fstat(self.file.fileno()).st_size
        while not self.salvaged.why and (position := self.file.tell()) < size:
            try:
                fields = bagformat.read_header(self.file, self.path)
                kind = bagformat.number(fields, b"op", self.path)
                if kind in (bagformat.OP_CONNECTION, bagformat.OP_CHUNK_INFO):
                    return  # the index
                if kind == bagformat.OP_CHUNK:
                    self._chunk(position, fields, size)
                elif kind == bagformat.OP_INDEX:
                    data_bytes = self._length()
                    self.file.seek(data_bytes, os.SEEK_CUR)
                    if self.file.tell() > size:  # the chunk before it has been read
                        self.salvaged.end(f"is cut short after {size} bytes")
                else:
                    raise BagError(f"a record of kind {kind}")
            except BagTooLarge as exc:
                why = f"is read up to byte {position} of {size} only ({exc})"
                self.salvaged.end(why, size - position)
            except BagError:
                why = f"is cut short or damaged at byte {position} of {size}"
                self.salvaged.end(why, size - position)
        if not self.salvaged.why:
            self.salvaged.end("has no index, for it was not closed")

    def _length(self) -> int:
        raw = self.file.read(4)
        return int(bagformat.U32.unpack(raw)[0]) if len(raw) == 4 else 2**32

    def _chunk(self, position: int, fields: bagformat.Fields, size: int) -> None:
        where = f"{self.path}: chunk {len(self.infos) + 1}"
        compression = fields.get(b"compression", b"").decode("utf-8", "replace")
        declared = bagformat.number(fields, b"size", where)
        data_bytes, data_pos = self._length(), self.file.tell()
        # A recorder writes the size when it closes a chunk; before that it is 0.
        whole = 0 < data_bytes <= size - data_pos
        most = self.allowance.most(compression)
        data_bytes = data_bytes if whole else min(size - data_pos, most)
        self.allowance.take(compression, min(declared, most), data_bytes, where)
        data = self.file.read(data_bytes)
        large, whole = declared > most, whole and declared <= most
        try:
            content = decompress_chunk(compression, data, declared, where) if whole else b""
        except BagError:
            whole = False
        if not whole:
            content = unpack_part(compression, data, min(declared or most, most))
        end, times, counts = self._records(content, where)
        if counts:
            self.infos.append(_chunk_info(position, times, counts))
            self.salvaged.messages += sum(counts.values())
        if not whole or end < len(content):
            if counts:
                number = len(self.infos) - 1
                self.salvaged.cut = CutChunk(number, compression, data_pos, len(data), end)
            why = f"is cut short or damaged in the chunk that begins at byte {position} of {size}"
            if large:
                why += f" (it states {declared} bytes of content, --allow-large-chunks reads it)"
            self.salvaged.end(why, size - data_pos - end * (compression == "none"))

    def _records(self, content: bytes, where: str) -> tuple[int, list[int], Counter[int]]:
        """Read the records of a chunk up to the damage.

        Returns:
            Offset of the damage in the content, first and last time of the messages before it, ns,
            and the number of these messages by connection id.
        """
        counts: Counter[int] = Counter()
        position, times = 0, [2**63, 0]
        try:
            while position < len(content):
                kind, fields, start, stop = record_at(content, position, where)
                if kind == bagformat.OP_MESSAGE:
                    number, t_ns = message_of(fields, where)
                    if number not in self.connections:
                        raise BagError(f"{where}: a message of unknown connection {number}")
                    times = [min(times[0], t_ns), max(times[1], t_ns)]
                    counts[number] += 1
                elif kind == bagformat.OP_CONNECTION:
                    number = bagformat.number(fields, b"conn", where)
                    header = content[start:stop]
                    check_connection(fields, number, header, self.path)
                    self.connections.setdefault(number, content[position:stop])
                else:
                    raise BagError(f"{where}: a record of kind {kind}")
                position = stop
        except BagError:
            pass  # the damage that we search for
        return position, times, counts


def _chunk_info(position: int, times: list[int], counts: Counter[int]) -> bytes:
    return bagformat.pack_record(
        (
            (b"op", bagformat.OP_CHUNK_INFO),
            (b"ver", bagformat.INDEX_VERSION),
            (b"chunk_pos", position),
            (b"start_time", bagformat.pack_time(times[0])),
            (b"end_time", bagformat.pack_time(times[1])),
            (b"count", len(counts)),
        ),
        b"".join(bagformat.COUNT.pack(number, count) for number, count in counts.items()),
    )


def read_salvage(
    file: BinaryIO, path: str, allowance: Allowance
) -> tuple[SalvageReport, IndexPlace]:
    """Read the chunks of a bag up to the first damage, and make an index of them.

    A chunk that the allowance refuses counts as damage. The caller must close the file of the
    returned index.

    Raises:
        BagError: The file is not a bag of format 2.0, or no message can be read.
    """
    scan = _Scan(file, path, allowance)
    scan.run()
    if not scan.infos and scan.salvaged.why:
        raise BagError(f"{path} {scan.salvaged.why}: there is no message that can be salvaged")
    connections = [record for _, record in sorted(scan.connections.items())]
    index = tempfile.TemporaryFile()
    index.write(b"".join([*connections, *scan.infos]))
    file_bytes = os.fstat(file.fileno()).st_size
    return scan.salvaged, IndexPlace(index, 0, file_bytes, len(connections), len(scan.infos))
