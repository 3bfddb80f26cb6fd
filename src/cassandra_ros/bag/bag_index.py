# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index at the end of a bag: its connections, and where its chunks lie."""

from __future__ import annotations

import os
from array import array
from collections import Counter
from typing import BinaryIO, NamedTuple

from cassandra_ros.bag import format as bagformat
from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.messages.connection_header import Connection

_LONGEST_MAGIC = 32
"""Maximum length of the first line of a bag, bytes."""
_PER_CHUNK = 5
"""Number of integers that BagIndex keeps for each chunk."""


class ChunkInfo(NamedTuple):
    """The entry of the index for one chunk."""

    position: int
    """Offset in the file at which the record of the chunk begins, bytes."""
    start_ns: int
    end_ns: int
    counts: dict[int, int]
    """Number of messages in the chunk by connection number; every value is at least 1."""
    first: int
    """Number of messages in all chunks before this one."""


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
