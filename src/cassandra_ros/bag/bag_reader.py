# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read bags of format 2.0, chunk by chunk, without message classes.

The index at the end of a bag tells its connections, and where its chunks lie (``BagIndex``). For a
bag that is cut short, damaged, or was never closed (.bag.active, after a crash of the recorder),
``read_salvage`` makes the index anew from the chunks, up to the first damage. Unlike rosbag
reindex, this does not change the file, and it also keeps the messages before the damage in the
damaged chunk.
"""

from __future__ import annotations

import os
import tempfile
from array import array
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import BinaryIO, Mapping, NamedTuple

import numpy as np

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.message_file import (
    Allowance,
    ChunkInfo,
    CutChunk,
    MessageFile,
    SalvageReport,
)
from cassandra_ros.errors import BagError, BagTooLarge, BagUnindexed
from cassandra_ros.messages.connection_header import Connection

_LONGEST_MAGIC = 32
"""Maximum length of the first line of a bag, bytes."""
_PER_CHUNK = 5
"""Number of integers that BagIndex keeps for each chunk."""


class IndexPlace(NamedTuple):
    """The position of the index records in a file, and their number."""

    file: BinaryIO
    position: int
    data_end: int
    """Offset in the bag before which all its chunks begin, bytes."""
    connections: int
    chunks: int


class BagIndex:
    """The index of an open bag: its connections and the positions of its chunks; see BagReader.

    Args:
        file: The bag.
        path: Name of the bag in error texts.
        place: Position of the index records; None = the position that the bag's header states.
    """

    def __init__(self, file: BinaryIO, path: str, place: IndexPlace | None = None) -> None:
        self.path = path
        self.connections: dict[int, Connection] = {}
        self.counts: Counter[int] = Counter()
        self._file = file
        self.numbers: dict[int, int] = {}
        """Connection id in the file -> connection number in this object."""
        # For each chunk: position, start_ns, end_ns, position of its chunk info record, number of
        # messages in the chunks before it.
        self._chunks = array("Q")
        place = place or _find_index(file, path)
        self._index, self.chunk_count = place.file, place.chunks
        self._index.seek(place.position)
        try:
            self._read_connections(place.connections)
            self._read_chunk_infos()
        except BagUnindexed as exc:
            what = f"is cut short: its index ends at byte {os.fstat(file.fileno()).st_size}"
            raise _unindexed(path, what) from exc
        self._sort_chunks(place.data_end)
        self.message_count = sum(self.counts.values())
        self.start_ns = min(self._column(1), default=0)
        self.end_ns = max(self._column(2), default=0)

    def _chunk(self, number: int) -> array[int]:
        return self._chunks[number * _PER_CHUNK : (number + 1) * _PER_CHUNK]

    def _column(self, place: int) -> array[int]:
        return self._chunks[place::_PER_CHUNK]

    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read the index entry of a chunk. Chunks are numbered from 0 in the order of the file."""
        info_pos, before = self._chunk(chunk)[3:]
        self._index.seek(info_pos)
        info = self._read_chunk_info(f"{self.path}: the chunk info of chunk {chunk + 1}")
        return info._replace(first=before)

    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and the last time in a chunk that the index states, ns."""
        start_ns, end_ns = self._chunk(chunk)[1:3]
        return start_ns, end_ns

    def _read_connections(self, count: int) -> None:
        found: dict[int, tuple[str, bytes]] = {}
        where = f"{self.path}: a connection in the index"
        for _ in range(count):
            record = bagformat.read_record(self._index, bagformat.OP_CONNECTION, where)
            number = bagformat.number(record.fields, b"conn", where)
            header = self._data(record.data_bytes, where)
            topic = check_connection(record.fields, number, header, self.path)
            if found.setdefault(number, (topic, header)) != (topic, header):
                raise BagError(f"{self.path} is damaged: it has two different connections {number}")
        # rosbag reads messages of equal times in the order of the connection records. We order
        # them by connection number. If the records are not in the order of their ids, the
        # position of the record becomes the number.
        ascending = list(found) == sorted(found)
        for place, (number, (topic, header)) in enumerate(found.items()):
            kept = self.numbers[number] = number if ascending else place
            self.connections[kept] = Connection(topic, header, kept)

    def _read_chunk_infos(self) -> None:
        for _ in range(self.chunk_count):
            info_pos = self._index.tell()
            info = self._read_chunk_info(f"{self.path}: a chunk info in the index")
            self.counts.update(info.counts)
            # _sort_chunks replaces this number by the number of messages in all chunks before.
            before = sum(info.counts.values())
            self._chunks.extend((info.position, info.start_ns, info.end_ns, info_pos, before))
        self.connections = {n: c for n, c in self.connections.items() if n in self.counts}
        if self._has_chunk_info():
            raise BagError(
                f"{self.path} is damaged: its header counts {self.chunk_count} chunks, and its "
                "index lists more; import --salvage stores what the bag holds"
            )

    def _has_chunk_info(self) -> bool:
        """Return whether a chunk info record is at the current file position."""
        with suppress(BagError):
            bagformat.read_record(self._index, bagformat.OP_CHUNK_INFO, self.path)
            return True
        return False

    def _read_chunk_info(self, where: str) -> ChunkInfo:
        """Read the chunk info record at the current file position; its ``first`` is 0."""
        fields, _, data_bytes = bagformat.read_record(self._index, bagformat.OP_CHUNK_INFO, where)
        version = bagformat.number(fields, b"ver", where)
        if version != bagformat.INDEX_VERSION:
            raise BagError(f"{where} has the unknown version {version}")
        position = bagformat.number(fields, b"chunk_pos", where)
        start_ns = bagformat.time_ns(fields, b"start_time", where)
        end_ns = bagformat.time_ns(fields, b"end_time", where)
        count = bagformat.number(fields, b"count", where)
        data = self._data(data_bytes, where)
        if len(data) != count * bagformat.COUNT.size:
            raise BagError(f"{where} is damaged: {len(data)} bytes for {count} connections")
        counts: Counter[int] = Counter()
        for file_id, messages in bagformat.COUNT.iter_unpack(data):
            if file_id not in self.numbers:
                raise BagError(f"{where} counts messages of connection {file_id}, which is missing")
            if messages:
                counts[self.numbers[file_id]] += messages
        return ChunkInfo(position, start_ns, end_ns, counts, 0)

    def _data(self, data_bytes: int, where: str) -> bytes:
        """Read the data of an index record."""
        if data_bytes > bagformat.MAX_CONNECTION_BYTES:
            raise BagError(
                f"{where} is damaged: it has {data_bytes} bytes, of which at most "
                f"{bagformat.MAX_CONNECTION_BYTES} are believed"
            )
        return self._index.read(data_bytes)

    def _sort_chunks(self, data_end: int) -> None:
        positions = self._column(0)
        chunks, before, last = array("Q"), 0, len(bagformat.MAGIC)
        for place in sorted(range(len(positions)), key=positions.__getitem__):
            *known, count = self._chunk(place)
            if not last < known[0] < data_end:
                what = f"its index places a chunk at byte {known[0]}"
                raise BagError(f"{self.path} is damaged: {what}")
            chunks.extend((*known, before))
            before, last = before + count, known[0]
        self._chunks = chunks


def _find_index(file: BinaryIO, name: str) -> IndexPlace:
    """Return the position of the index that the header of a bag states."""
    record, file_bytes = read_start(file, name), os.fstat(file.fileno()).st_size
    where = f"{name}: the header"
    index_pos, connections, chunks = (
        bagformat.number(record.fields, key, where)
        for key in (b"index_pos", b"conn_count", b"chunk_count")
    )
    if index_pos == 0:
        raise _unindexed(name, "has no index: it is still being recorded, or was not closed")
    if index_pos > file_bytes:
        what = f"is cut short: its index should begin at byte {index_pos}, it has {file_bytes}"
        raise _unindexed(name, what)
    if index_pos < record.data_pos + record.data_bytes:
        what = f"its header places the index inside itself; repair it with: rosbag reindex {name}"
        raise BagError(f"{name} is damaged: {what}")
    return IndexPlace(file, index_pos, index_pos, connections, chunks)


def read_start(file: BinaryIO, name: str) -> bagformat.Record:
    """Read the first record of a bag of format 2.0, and check that we can read the bag.

    Raises:
        BagUnindexed: The file ends inside this record.
        BagError: The file is not a bag of format 2.0, or it is encrypted.
    """
    file.seek(0)
    file_bytes = os.fstat(file.fileno()).st_size
    _check_magic(file.readline(_LONGEST_MAGIC), file_bytes, name)
    where = f"{name}: the header"
    try:
        record = bagformat.read_record(file, bagformat.OP_FILE_HEADER, where)
    except BagUnindexed as exc:
        raise _unindexed(name, f"is cut short after {file_bytes} bytes") from exc
    encryptor = record.fields.get(b"encryptor", b"")
    if encryptor not in (b"", b"rosbag/NoEncryptor"):
        raise BagError(
            f"{name} is encrypted ({encryptor.decode('utf-8', 'replace')}); "
            f"make a readable copy with: rosbag decrypt {name}"
        )
    return record


def _check_magic(magic: bytes, file_bytes: int, name: str) -> None:
    if magic == bagformat.MAGIC:
        return
    if not file_bytes:
        raise BagError(f"{name} is empty, so it is not a bag")
    if magic.startswith((b"#ROSBAG V1.", b"#ROSRECORD V1.")):
        version = magic.decode("ascii", "replace").split("V")[-1].strip()
        raise BagError(
            f"{name} is a bag of the old format {version}; convert it to format 2.0 first: "
            f"rosbag filter {name} NEW.bag True"
        )
    raise BagError(f"{name} is not a bag of format 2.0: it does not begin with '#ROSBAG V2.0'")


def _unindexed(name: str, what: str) -> BagUnindexed:
    return BagUnindexed(
        f"{name} {what}; import --salvage stores what it holds, or repair it with: "
        f"rosbag reindex {name}"
    )


def check_connection(fields: bagformat.Fields, number: int, header: bytes, name: str) -> str:
    """Return the topic of a connection record.

    Raises:
        BagError: The topic or the connection header is missing, damaged or not UTF-8.
    """
    topic = _topic(fields, number, name)
    check_header(header, f"{name}: connection {number} (topic {topic})")
    return topic


def _topic(fields: bagformat.Fields, number: int, name: str) -> str:
    raw = fields.get(b"topic")
    try:
        if raw:
            return raw.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise BagError(f"{name}: the topic of connection {number} is not UTF-8") from exc
    raise BagError(f"{name} is damaged: connection {number} names no topic")


def check_header(header: bytes, where: str) -> None:
    """Check that a connection header can be parsed and states type and md5sum.

    Raises:
        BagError: The header is damaged, or one of the two fields is missing or not UTF-8.
    """
    fields = bagformat.split_fields(header, where)
    for name in (b"type", b"md5sum"):
        try:
            present = bool(fields.get(name, b"").decode("utf-8"))
        except UnicodeDecodeError:
            present = False
        if not present:
            raise BagError(f"{where} is damaged: its header states no {name.decode()}")


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
            content = (
                bagformat.decompress_chunk(compression, data, declared, where) if whole else b""
            )
        except BagError:
            whole = False
        if not whole:
            content = bagformat.unpack_part(compression, data, min(declared or most, most))
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
                kind, fields, start, stop = bagformat.record_at(content, position, where)
                if kind == bagformat.OP_MESSAGE:
                    number, t_ns = bagformat.message_of(fields, where)
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

    def chunk_content(self, chunk: int) -> tuple[bytes, bagformat.ChunkMessages]:
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
            size = cut.content_bytes
            content = bagformat.unpack_part(compression, data, size)[:size]
            offsets = None
        else:
            content = bagformat.decompress_chunk(compression, data, size, where)
            offsets = self._offsets(counts)
        messages = bagformat.find_messages(content, where, offsets)
        present, inverse, each = np.unique(messages.ids, return_inverse=True, return_counts=True)
        numbers = [self.numbers.get(file_id, -1) for file_id in present.tolist()]
        ids = np.array(numbers, np.int64)[inverse]
        if dict(zip(numbers, each.tolist())) != counts:
            raise BagError(
                f"{where} is damaged: its {len(ids)} messages are not those that the index "
                f"lists; repair it with: rosbag reindex {self.path}"
            )
        return content, messages._replace(ids=ids)

    def _offsets(self, counts: Mapping[int, int]) -> bagformat.Longs | None:
        """Read the offsets of messages from the index records at the current file position.

        Return None if they do not list all messages of the chunk, or if searching the chunk for
        its messages is faster.
        """
        count = sum(counts.values())
        if count < bagformat.MIN_AT_ONCE * max(1, len(counts)):
            return None
        found: list[bagformat.Longs] = []
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
