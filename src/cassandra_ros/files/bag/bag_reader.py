# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read bags of format 2.0, chunk by chunk, without message classes.

The index at the end of a bag tells its connections, and where its chunks lie (``BagIndex``). For a
bag that is cut short or was never closed (.bag.active, after a crash of the recorder),
``read_salvage`` makes the index anew from the chunks that can be read. Unlike rosbag reindex, this
does not change the file, and it also keeps the messages before the damage in a damaged chunk.
"""

from __future__ import annotations

import os
import tempfile
from array import array
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import BinaryIO, Mapping, NamedTuple

import numpy as np

from cassandra_ros.errors import BagError, BagTooLarge, BagUnindexed
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.message_file import (
    Allowance,
    ChunkInfo,
    CutChunk,
    MessageFile,
    SalvageReport,
)
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection

_LONGEST_MAGIC = 32
"""Maximum length of the first line of a bag, bytes."""
_PER_CHUNK = 5
"""Number of integers that BagIndex keeps for each chunk."""


class IndexPlace(NamedTuple):
    """The position of the index records in a file, and their number."""

    file: BinaryIO
    """The bag, or the file in which read_salvage has made the index anew."""
    position: int
    """Offset in ``file`` at which the connection records begin; chunk info records follow."""
    data_end: int
    """Offset in the bag before which all its chunks begin, bytes."""
    connections: int
    chunks: int
    """Number of records of each kind."""


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
        self._unusable: dict[int, tuple[str, str]] = {}
        """Connection id in the file -> topic, and why its messages are left out."""
        self._unusable_counts: Counter[int] = Counter()
        """Number of messages of these connections, by connection id in the file."""
        self._chunks = array("Q")
        """For each chunk five numbers: position, start_ns, end_ns, position of its chunk info
        record, number of messages in the chunks before it. A list would take much more memory."""
        place = place or _find_index(file, path)
        self._index, self.chunk_count = place.file, place.chunks
        self._data_end = place.data_end
        self._index.seek(place.position)
        try:
            self._read_connections(place.connections)
            self._read_chunk_infos()
        except BagUnindexed as exc:
            what = f"is cut short: its index ends at byte {os.fstat(file.fileno()).st_size}"
            raise _unindexed_error(path, what) from exc
        self._sort_chunks(place.data_end)
        self.message_count = sum(self.counts.values())
        self.start_ns = min(self._column(1), default=0)
        self.end_ns = max(self._column(2), default=0)

    def _chunk(self, number: int) -> array[int]:
        """Return the five numbers of a chunk, see _chunks."""
        return self._chunks[number * _PER_CHUNK : (number + 1) * _PER_CHUNK]

    def _column(self, place: int) -> array[int]:
        """Return one of these numbers of all chunks."""
        return self._chunks[place::_PER_CHUNK]

    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read the index entry of a chunk. Chunks are numbered from 0 in the order of the file."""
        info_pos, before = self._chunk(chunk)[3:]
        self._index.seek(info_pos)
        info, _ = self._read_chunk_info(f"{self.path}: the chunk info of chunk {chunk + 1}")
        return info._replace(first=before)

    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and the last time in a chunk that the index states, ns."""
        start_ns, end_ns = self._chunk(chunk)[1:3]
        return start_ns, end_ns

    def _read_connections(self, count: int) -> None:
        """Read connection records at the file position; number the connections.

        Raises:
            BagError: A record is damaged, or two have one id and are not equal.
        """
        header_of: dict[int, tuple[str, bytes]] = {}
        where = f"{self.path}: a connection in the index"
        for _ in range(count):
            record = bagformat.read_record(self._index, bagformat.OP_CONNECTION, where)
            number = bagformat.number(record.fields, b"conn", where)
            header = self._data(record.data_bytes, where)
            topic = self._check(record.fields, number, header)
            if header_of.setdefault(number, (topic, header)) != (topic, header):
                raise BagError(f"{self.path} is damaged: it has two different connections {number}")
        # rosbag reads messages of equal times in the order of the connection records. We order
        # them by connection number. If the records are not in the order of their ids, the
        # position of the record becomes the number.
        ascending = list(header_of) == sorted(header_of)
        for place, (file_id, (topic, header)) in enumerate(header_of.items()):
            number = self.numbers[file_id] = file_id if ascending else place
            if file_id not in self._unusable:
                self.connections[number] = Connection(topic, header, number)

    def _check(self, fields: bagformat.Fields, number: int, header: bytes) -> str:
        """Return the topic of a connection record; note if its messages have to be left out."""
        topic = fields.get(b"topic", b"").decode("utf-8", "replace") or f"of connection {number}"
        try:
            return check_connection(fields, number, header)
        except BagError as exc:
            self._unusable[number] = topic, str(exc)
            return topic

    def _read_chunk_infos(self) -> None:
        """Read the chunk info records at the file position into _chunks, in their order.

        Raises:
            BagError: A record is damaged, or there are more than the bag's header counts.
        """
        for _ in range(self.chunk_count):
            info_pos = self._index.tell()
            info, left_out = self._read_chunk_info(f"{self.path}: a chunk info in the index")
            self.counts.update(info.counts)
            self._unusable_counts.update(left_out)
            # _sort_chunks replaces this number by the number of messages in all chunks before.
            before = sum(info.counts.values())
            self._chunks.extend((info.position, info.start_ns, info.end_ns, info_pos, before))
        self.connections = {n: c for n, c in self.connections.items() if n in self.counts}
        if self._has_chunk_info():
            raise BagError(
                f"{self.path} is damaged: its header counts {self.chunk_count} chunks, and its "
                "index lists more; with --salvage (salvage=True) what the bag holds is read"
            )

    def _has_chunk_info(self) -> bool:
        """Return whether a chunk info record is at the current file position."""
        with suppress(BagError):
            bagformat.read_record(self._index, bagformat.OP_CHUNK_INFO, self.path)
            return True
        return False

    def _read_chunk_info(self, where: str) -> tuple[ChunkInfo, Counter[int]]:
        """Read the chunk info record at the current file position; its ``first`` is 0.

        Return also the numbers of messages that are left out, by connection id in the file.
        """
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
        unusable: Counter[int] = Counter()
        for file_id, messages in bagformat.COUNT.iter_unpack(data):
            if file_id not in self.numbers:
                raise BagError(f"{where} counts messages of connection {file_id}, which is missing")
            if messages and file_id in self._unusable:
                unusable[file_id] += messages
            elif messages:
                counts[self.numbers[file_id]] += messages
        return ChunkInfo(position, start_ns, end_ns, counts, 0), unusable

    def _data(self, data_bytes: int, where: str) -> bytes:
        """Read the data of an index record; raises BagError if they are too large."""
        if data_bytes > bagformat.MAX_CONNECTION_BYTES:
            raise BagError(
                f"{where} is damaged: it has {data_bytes} bytes, of which at most "
                f"{bagformat.MAX_CONNECTION_BYTES} are believed"
            )
        return self._index.read(data_bytes)

    def _sort_chunks(self, data_end: int) -> None:
        """Sort _chunks by their positions in the file, and count the messages before each.

        Raises:
            BagError: A chunk lies outside of the data, or two have one position.
        """
        positions = self._column(0)
        chunks, before, last = array("Q"), 0, len(bagformat.MAGIC)
        for place in sorted(range(len(positions)), key=positions.__getitem__):
            *place_and_times, count = self._chunk(place)
            if not last < place_and_times[0] < data_end:
                what = f"its index places a chunk at byte {place_and_times[0]}"
                raise BagError(f"{self.path} is damaged: {what}")
            chunks.extend((*place_and_times, before))
            before, last = before + count, place_and_times[0]
        self._chunks = chunks


def _find_index(file: BinaryIO, name: str) -> IndexPlace:
    """Return the position of the index that the header of a bag states.

    Raises:
        BagUnindexed: The bag has no index, or is cut short before it.
        BagError: As in read_start, or the position is wrong.
    """
    record, file_bytes = read_start(file, name), os.fstat(file.fileno()).st_size
    where = f"{name}: the header"
    index_pos, connections, chunks = (
        bagformat.number(record.fields, key, where)
        for key in (b"index_pos", b"conn_count", b"chunk_count")
    )
    if index_pos == 0:
        raise _unindexed_error(name, "has no index: it is still being recorded, or was not closed")
    if index_pos > file_bytes:
        what = f"is cut short: its index should begin at byte {index_pos}, it has {file_bytes}"
        raise _unindexed_error(name, what)
    if index_pos < record.data_pos + record.data_bytes:
        what = f"its header places the index inside itself; repair it with: rosbag reindex {name}"
        raise BagError(f"{name} is damaged: {what}")
    return IndexPlace(file, index_pos, index_pos, connections, chunks)


def read_start(file: BinaryIO, name: str) -> bagformat.BagRecord:
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
        raise _unindexed_error(name, f"is cut short after {file_bytes} bytes") from exc
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


def _unindexed_error(name: str, what: str) -> BagUnindexed:
    return BagUnindexed(
        f"{name} {what}; with --salvage (salvage=True) what it holds is read; or repair it with: "
        f"rosbag reindex {name}"
    )


def check_connection(fields: bagformat.Fields, number: int, header: bytes) -> str:
    """Return the topic of a connection record.

    Raises:
        BagError: The topic or the connection header is missing, damaged or not UTF-8.
    """
    check_header(header, f"connection {number}")
    try:
        topic = fields.get(b"topic", b"").decode("utf-8")
    except UnicodeDecodeError as exc:
        raise BagError(f"the topic of connection {number} is not UTF-8") from exc
    if not topic:
        raise BagError(f"connection {number} is damaged: it names no topic")
    return topic


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


class _BagDamage(NamedTuple):
    """Damage of a bag."""

    why: str
    """Description, see SalvageReport."""
    at: int
    """Offset in the file of the first byte that cannot be read."""


_CHUNK_OP = b"\x04\0\0\0op=" + bytes([bagformat.OP_CHUNK])
"""The field ``op`` in the header of a chunk, by which chunks are found after damage."""
_BEFORE_OP = (0, 13, 19, 20, 32, 33)
"""Sizes of the fields that may stand before ``op`` in the header of a chunk, bytes: none, ``size``
(13), ``compression`` (19 for bz2 and lz4, 20 for none), or both."""
_CHUNK_HEADER_BYTES = 64
"""Maximum size of the header of a chunk that is searched for, bytes: three fields."""
_SEARCH_BYTES = 1 << 20
"""Number of bytes that are searched at once."""


def _find_chunk(file: BinaryIO, position: int) -> int | None:
    """Return the offset of the next record of a chunk, from an offset on; None = no chunk.

    Args:
        position: Offset from which on chunks are searched. The file position changes.
    """
    size, overlap = os.fstat(file.fileno()).st_size, len(_CHUNK_OP) - 1
    for start in range(position, size, _SEARCH_BYTES):
        file.seek(start)
        data, at = file.read(_SEARCH_BYTES + overlap), -1
        while (at := data.find(_CHUNK_OP, at + 1)) >= 0:
            for before in _BEFORE_OP:
                begin = start + at - before - bagformat.U32.size
                if begin >= position and _is_chunk(file, begin):
                    return begin
    return None


def _is_chunk(file: BinaryIO, position: int) -> bool:
    """Return whether there is a record with the header of a chunk at an offset."""
    file.seek(position)
    raw = file.read(bagformat.U32.size + _CHUNK_HEADER_BYTES)
    size = int.from_bytes(raw[: bagformat.U32.size], "little")
    try:
        fields = bagformat.split_fields(raw[bagformat.U32.size :][:size], "")
        bagformat.number(fields, b"size", "")
    except BagError:
        return False
    compression = fields.get(b"compression", b"").decode("ascii", "replace")
    return compression in bagformat.COMPRESSIONS and fields.get(b"op") == _CHUNK_OP[-1:]


def _readable_records(
    content: bytes,
    where: str,
    connections: dict[int, bytes],
    count: bagformat.CountRecords,
    start_ns: int = 0,
    end_ns: int = MAX_NS,
) -> tuple[int, list[int], Counter[int]]:
    """Read the records of a chunk up to the damage.

    Args:
        connections: Known connection records by connection id; those of the chunk are added.
        count: Counts the records; a record that it refuses ends the reading as damage does.
        start_ns, end_ns: A message at another time is damage.

    Returns:
        Offset of the damage in the content (its size = no damage); first and last time of the
        messages before it, ns (2**63 and 0 = no message); the number of these messages by
        connection id.
    """
    counts: Counter[int] = Counter()
    position, times = 0, [2**63, 0]
    with suppress(BagError):  # the damage that we search for
        while position < len(content):
            count(1)
            kind, fields, start, stop = bagformat.record_at(content, position, where)
            if kind == bagformat.OP_MESSAGE:
                number, t_ns = bagformat.message_of(fields, where)
                if number not in connections or not start_ns <= t_ns <= end_ns:
                    raise BagError(f"{where}: a message of unknown connection or wrong time")
                times = [min(times[0], t_ns), max(times[1], t_ns)]
                counts[number] += 1
            elif kind == bagformat.OP_CONNECTION:
                # Whether topic and header are sound is seen when the new index is read.
                number = bagformat.number(fields, b"conn", where)
                connections.setdefault(number, content[position:stop])
            else:
                raise BagError(f"{where}: a record of kind {kind}")
            position = stop
    return position, times, counts


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
    """Chunk info records of the chunks with messages that can be read, in the order of the file."""

    def run(self) -> None:
        """Collect connections and chunks up to the index or the end of the file.

        After damage this goes on at the next chunk, but not after one that is too large. The result
        is in the fields; ``salvaged.why`` is never empty then.

        Raises:
            BagError: The file is not a bag of format 2.0, or is encrypted, or ends in its header.
        """
        size = os.fstat(self.file.fileno()).st_size
        try:
            start = read_start(self.file, self.path)
        except BagUnindexed as exc:
            why = f"is cut short in its header, after {size} bytes"
            raise BagError(f"{self.path} {why}: there is no message that can be salvaged") from exc
        self._read_connections()
        self.file.seek(start.data_pos + start.data_bytes)
        while (position := self.file.tell()) < size:
            damage = None
            try:
                fields = bagformat.read_header(self.file, self.path)
                kind = bagformat.number(fields, b"op", self.path)
                if kind in (bagformat.OP_CONNECTION, bagformat.OP_CHUNK_INFO):
                    self.salvaged.add("has an index that cannot be read")
                    return
                if kind == bagformat.OP_CHUNK:
                    damage = self._chunk(position, fields, size)
                elif kind == bagformat.OP_INDEX:
                    self.file.seek(self._length(), os.SEEK_CUR)
                    if self.file.tell() > size:  # the chunk before it has been read
                        damage = _BagDamage(f"is cut short after {size} bytes", size)
                else:
                    raise BagError(f"a record of kind {kind}")
            except BagTooLarge as exc:
                why = f"is read up to byte {position} of {size} only ({exc})"
                self.salvaged.add(why, size - position)
                return
            except BagError:
                why = f"is cut short or damaged at byte {position} of {size}"
                damage = _BagDamage(why, position)
            if damage is not None:
                following = _find_chunk(self.file, max(damage.at, position + 1))
                self.salvaged.behind |= following is not None
                end = size if following is None else following
                self.salvaged.add(damage.why, end - damage.at)
                self.file.seek(end)
        if not self.salvaged.why:
            self.salvaged.add("has no index, because it was not closed")

    def _read_connections(self) -> None:
        """Read the connections in the index, as far as it can be read.

        A recorder writes a connection only into the first chunk with a message of it: if that is
        damaged, the index alone has it.
        """
        with suppress(BagError):
            place = _find_index(self.file, self.path)
            self.file.seek(place.position)
            for _ in range(place.connections):
                begin = self.file.tell()
                record = bagformat.read_record(self.file, bagformat.OP_CONNECTION, self.path)
                number = bagformat.number(record.fields, b"conn", self.path)
                if record.data_bytes > bagformat.MAX_CONNECTION_BYTES:
                    return
                self.file.seek(begin)
                nbytes = record.data_pos + record.data_bytes - begin
                self.connections[number] = self.file.read(nbytes)

    def _length(self) -> int:
        """Read the length of the data that follow; 2**32, which is too large, at the file's end."""
        raw = self.file.read(4)
        return int(bagformat.U32.unpack(raw)[0]) if len(raw) == 4 else 2**32

    def _chunk(self, position: int, fields: bagformat.Fields, size: int) -> _BagDamage | None:
        """Collect the messages of a chunk up to the damage; return the damage, None = none.

        Args:
            position: Offset of the chunk. The file position is after its header, and later after
                its data.
            fields: Its header.
            size: Size of the file, bytes.

        Raises:
            BagTooLarge: The allowance refuses the chunk.
            BagError: Its header has no valid size.
        """
        where = f"{self.path}: chunk {len(self.infos) + 1}"
        compression = fields.get(b"compression", b"").decode("utf-8", "replace")
        declared = bagformat.number(fields, b"size", where)
        data_bytes, data_pos = self._length(), self.file.tell()
        # A recorder writes the size when it closes a chunk; before that it is 0.
        whole = 0 < data_bytes <= size - data_pos
        most = self.allowance.most(compression)
        data_bytes = data_bytes if whole else min(size - data_pos, most)
        # Damage may make many headers that state more than the file has: each of them costs.
        taken = min(declared, most) if whole else max(min(declared, most), data_bytes)
        self.allowance.count_chunk(compression, taken, data_bytes, where)
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
        count = partial(self.allowance.count_records, where)
        end, times, counts = _readable_records(content, where, self.connections, count)
        if counts:
            self.infos.append(_chunk_info(position, times, counts))
        if whole and end == len(content):
            return None
        if counts:
            cut = CutChunk(compression, data_pos, len(data), end)
            self.salvaged.cuts[len(self.infos) - 1] = cut
        why = f"is cut short or damaged in the chunk that begins at byte {position} of {size}"
        if large:
            why += f" (it states {declared} bytes of content, --allow-large-chunks reads it)"
        return _BagDamage(why, data_pos + end * (compression == "none"))


def _chunk_info(position: int, times: list[int], counts: Counter[int]) -> bytes:
    """Return the chunk info record of a chunk, with what _readable_records has found in it."""
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
    """Read what can be read of the chunks of a bag, and make an index of them.

    Reading ends at a chunk that the allowance refuses. The caller must close the file of the
    returned index.

    Raises:
        BagError: The file is not a bag of format 2.0, or no message can be read.
    """
    scan = _Scan(file, path, allowance)
    scan.run()
    if not scan.infos:
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
        left_out: Messages of connections without a valid topic or header, see MessageFile.
        message_count: Number of messages in the bag.
        chunk_count: Number of chunks in the bag.
        start_ns, end_ns: Times of the first and the last message, ns; 0 in an empty bag.
        salvaged: The damage that was found when the bag was opened with ``salvage``, if any.

    Args:
        salvage: If the bag is cut short, damaged or was not closed, read the messages before the
            damage and in the chunks after it. All chunks are read to find it. An undamaged bag is
            read as usual.
        large_chunks: Also read chunks and bags that an Allowance refuses by default. A bag that
            was made to do harm can then fill the memory.

    Raises:
        BagUnindexed: The bag was not closed properly, or is cut short.
        BagTooLarge: A chunk would unpack to more bytes or records than the Allowance permits
            (raised when the chunk is read).
        BagError: The file cannot be opened, is not a bag of format 2.0, is encrypted, or its index
            is damaged; with salvage: no message can be read.
    """

    def __init__(
        self, path: str | os.PathLike[str], salvage: bool = False, large_chunks: bool = False
    ) -> None:
        name, self.salvaged = os.fspath(path), SalvageReport()
        self._large_chunks = large_chunks
        self._cut_counts: dict[int, dict[int, int]] = {}
        """Number of messages that can be read of the damaged chunks that the bag's index lists."""
        try:
            with ExitStack() as opened:
                file = opened.enter_context(open(name, "rb"))
                if salvage:
                    self._salvage(file, name, opened)
                else:
                    self._begin(file, name)
                for file_id, count in self._unusable_counts.items():
                    self.leave_out(*self._unusable[file_id], count)
                opened.pop_all()
        except OSError as exc:
            raise BagError(f"{name} cannot be read: {exc.strerror}") from exc

    def _begin(self, file: BinaryIO, name: str, place: IndexPlace | None = None) -> None:
        """Read an index, and begin to count anew; ``_salvage`` may call it a second time."""
        super().__init__(file, name, place)
        self._allowance = Allowance(os.fstat(file.fileno()).st_size, self._large_chunks)
        self._counted = bytearray(self.chunk_count)
        """One byte per chunk: 1 = the allowance has counted its size, which it does only once."""
        self._records_counted = bytearray(self.chunk_count)
        """The same for the records of each chunk."""

    def _salvage(self, file: BinaryIO, name: str, opened: ExitStack) -> None:
        """Read the bag's own index, and which chunks are damaged; or make the index anew.

        The own index gives the messages after the damage the positions that they have in the
        undamaged bag, so that they are the same rows as those of an import without salvage.

        Args:
            opened: Closes the file of a new index, if opening the bag fails.

        Raises:
            BagError: As read_salvage.
        """
        try:
            self._begin(file, name)
            self._find_damaged_chunks()
        except BagError:
            allowance = Allowance(os.fstat(file.fileno()).st_size, self._large_chunks)
            self.salvaged, place = read_salvage(file, name, allowance)
            opened.enter_context(place.file)
            self._cut_counts.clear()  # of the chunks of the bag's own index
            self._begin(file, name, place)
        self.salvaged.messages = self.message_count
        if self.salvaged.why and not self.message_count:
            raise BagError(f"{name} {self.salvaged.why}: there is no message that can be salvaged")

    def _find_damaged_chunks(self) -> None:
        """Read all chunks; note what can be read of those that are damaged.

        Raises:
            BagError: The index is wrong: a chunk has messages that the index does not list.
        """
        missing: Counter[int] = Counter()
        ends = [*self._column(0), self._data_end][1:]
        size = os.fstat(self._file.fileno()).st_size
        for chunk, end in enumerate(ends):
            try:
                self.chunk_content(chunk)
                continue
            except BagError as exc:
                why = f" ({exc})" if isinstance(exc, BagTooLarge) else ""
            position, listed = self._chunk(chunk)[0], self.chunk_info(chunk).counts
            cut, counts = self._readable_part(chunk, end)
            if any(count > listed.get(number, 0) for number, count in counts.items()):
                raise BagError(f"{self._where(chunk)} has messages that the index does not list")
            self.salvaged.cuts[chunk], self._cut_counts[chunk] = cut, counts
            self.salvaged.damaged.add(chunk)
            self.salvaged.behind |= chunk + 1 < self.chunk_count
            unread_bytes = cut.data_bytes - cut.content_bytes * (cut.compression == "none")
            place = f"the chunk that begins at byte {position} of {size}"
            self.salvaged.add(f"is damaged in {place}{why}", unread_bytes or end - position)
            missing.update(listed)
            missing.subtract(counts)
        self.counts.subtract(missing)
        self.salvaged.missing = sum(missing.values())
        self.message_count -= self.salvaged.missing

    def _readable_part(self, chunk: int, end: int) -> tuple[CutChunk, dict[int, int]]:
        """Find the messages before the damage in a chunk, which ends before an offset in the file.

        Return the part of the chunk, and the number of its messages by connection number; -1 stands
        for connections that the index does not have.
        """
        start_ns, end_ns = self.chunk_times(chunk)
        try:
            compression, size, data_bytes = self._chunk_header(chunk)
            data_pos = self._file.tell()
            data_bytes = min(data_bytes, max(0, end - data_pos))
            self._allow(chunk, compression, size, data_bytes)
            content = bagformat.unpack_part(compression, self._file.read(data_bytes), size)
        except (BagError, OSError):  # not even its header, or too large
            return CutChunk("none", self._chunk(chunk)[0], 0, 0), {}
        connections = dict.fromkeys(self.numbers, b"")
        where = self._where(chunk)
        count = partial(self._allowance.count_records, where)
        stop, _, counts = _readable_records(content, where, connections, count, start_ns, end_ns)
        usable = {i: n for i, n in counts.items() if i not in self._unusable}
        numbered = {self.numbers.get(file_id, -1): count for file_id, count in usable.items()}
        return CutChunk(compression, data_pos, data_bytes, stop), numbered

    def _allow(self, chunk: int, compression: str, size: int, data_bytes: int) -> None:
        """Count the unpacked size of a chunk, unless that was done; raises BagTooLarge."""
        if not self._counted[chunk]:
            self._allowance.count_chunk(compression, size, data_bytes, self._where(chunk))
            self._counted[chunk] = 1

    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read the index entry of a chunk, see MessageFile; of a damaged one what can be read."""
        info = super().chunk_info(chunk)
        return info._replace(counts=self._cut_counts.get(chunk, info.counts))

    def close(self) -> None:
        """Close the file. A second call does nothing."""
        self._file.close()
        self._index.close()

    def chunk_content(self, chunk: int) -> tuple[bytes, bagformat.ChunkMessages]:
        """Read a chunk. Return its content and the list of its messages, see MessageFile."""
        # From _chunk_header on, each read begins where the one before it has ended.
        where, counts = self._where(chunk), self.chunk_info(chunk).counts
        compression, size, data_bytes = self._chunk_header(chunk)
        if compression == "none" and size != data_bytes:
            raise BagError(f"{where} is damaged: it states both {size} and {data_bytes} bytes")
        cut = self.salvaged.cuts.get(chunk)
        if cut is None:
            self._allow(chunk, compression, size, data_bytes)
        try:
            data = self._file.read(data_bytes)
        except OSError as exc:
            raise BagError(f"{where} cannot be read: {exc.strerror}") from exc
        if cut is not None:
            size = cut.content_bytes
            content = bagformat.unpack_part(compression, data, size)[:size]
            offsets = None
        else:
            content = bagformat.decompress_chunk(compression, data, size, where)
            offsets = self._offsets(counts)
        first = cut is None and not self._records_counted[chunk]
        count = partial(self._allowance.count_records, where) if first else bagformat.uncounted
        messages = bagformat.find_messages(content, where, offsets, count)
        self._records_counted[chunk] = 1
        if self._unusable:
            usable = ~np.isin(messages.ids, list(self._unusable))
            messages = bagformat.ChunkMessages(*(column[usable] for column in messages))
        present, inverse, messages_per_id = np.unique(
            messages.ids, return_inverse=True, return_counts=True
        )
        numbers = [self.numbers.get(file_id, -1) for file_id in present.tolist()]
        ids = np.array(numbers, np.int64)[inverse]
        if dict(zip(numbers, messages_per_id.tolist())) != counts:
            raise BagError(
                f"{where} is damaged: its {len(ids)} messages are not those that the index "
                f"lists; repair it with: rosbag reindex {self.path}"
            )
        return content, messages._replace(ids=ids)

    def _offsets(self, counts: Mapping[int, int]) -> bagformat.Longs | None:
        """Read the offsets of messages from the index records at the file position, ascending.

        Return None if they do not list all messages of the chunk, or if searching the chunk for
        its messages is faster.

        Args:
            counts: Number of messages of the chunk by connection: one index record for each.
        """
        count = sum(counts.values())
        if count < bagformat.MIN_AT_ONCE * max(1, len(counts)):
            return None
        offsets_by_index: list[bagformat.Longs] = []
        try:
            for _ in counts:
                record = bagformat.read_record(self._file, bagformat.OP_INDEX, self.path)
                if record.data_bytes > 12 * count:
                    return None
                entries = np.frombuffer(self._file.read(record.data_bytes), "<u4")
                offsets_by_index.append(entries[2::3].astype(np.int64))
        except (BagError, OSError, ValueError):
            return None
        offsets = np.concatenate(offsets_by_index)
        return np.sort(offsets) if len(offsets) == count else None

    def _chunk_header(self, chunk: int) -> tuple[str, int, int]:
        """Read the header of a chunk, and stop before its data.

        Return the compression, the size of the content and the size of the data, bytes. Of a
        damaged chunk the second is not known: it is that of the data.

        Raises:
            BagError: The header is damaged.
        """
        where, cut = self._where(chunk), self.salvaged.cuts.get(chunk)
        if cut is not None:
            self._file.seek(cut.data_pos)
            return cut.compression, cut.data_bytes, cut.data_bytes
        self._file.seek(self._chunk(chunk)[0])
        fields, _, data_bytes = bagformat.read_record(self._file, bagformat.OP_CHUNK, where)
        compression = fields.get(b"compression", b"").decode("utf-8", "replace")
        return compression, bagformat.number(fields, b"size", where), data_bytes

    def _where(self, chunk: int) -> str:
        return f"{self.path}: chunk {chunk + 1} of {self.chunk_count}"
