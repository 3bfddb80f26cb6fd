# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index at the end of a bag: its connections, and where its chunks lie."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from struct import Struct
from typing import BinaryIO, NamedTuple

from cassandra_ros.bag import format as bagformat
from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.messages.connection import Connection

_COUNT = Struct("<II")
_LONGEST_MAGIC = 32


class ChunkInfo(NamedTuple):
    """What the index says about one chunk."""

    position: int
    """Byte of the file at which the record of the chunk begins."""
    start_ns: int
    end_ns: int
    counts: dict[int, int]
    """Messages by number of the connection; none is 0."""
    first: int
    """Messages in the chunks before it."""


@dataclass
class BagIndex:
    """What opening a bag leaves in memory: 40 bytes a chunk, and the connections."""

    connections: dict[int, Connection] = field(default_factory=dict)
    """By number, in the order that decides between equal times."""
    numbers: dict[int, int] = field(default_factory=dict)
    """Id in the file -> number."""
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by number."""
    chunks: array[int] = field(default_factory=lambda: array("Q"))
    """Position, start_ns, end_ns, position of the chunk info, messages before; of each chunk."""
    message_count: int = 0

    PER_CHUNK = 5

    def __len__(self) -> int:
        return len(self.chunks) // self.PER_CHUNK


def _read_file_header(file: BinaryIO, file_bytes: int, name: str) -> tuple[int, int, int]:
    """Read the magic line and the first record.

    Returns:
        Position of the index, number of connections, number of chunks.
    """
    _check_magic(file.readline(_LONGEST_MAGIC), file_bytes, name)
    where = f"{name}: the header"
    try:
        record = bagformat.read_record(file, file_bytes, bagformat.OP_FILE_HEADER, where)
    except BagUnindexed as exc:
        raise BagUnindexed(_reindex(name, f"is cut short after {file_bytes} bytes")) from exc
    fields = record.fields
    encryptor = fields.get(b"encryptor", b"")
    if encryptor not in (b"", b"rosbag/NoEncryptor"):
        raise BagError(
            f"{name} is encrypted ({encryptor.decode('utf-8', 'replace')}); "
            f"make a readable copy with: rosbag decrypt {name}"
        )
    index_pos = bagformat.number(fields, b"index_pos", bagformat.U64, where)
    connections = bagformat.number(fields, b"conn_count", bagformat.U32, where)
    chunks = bagformat.number(fields, b"chunk_count", bagformat.U32, where)
    if index_pos == 0:
        raise BagUnindexed(
            _reindex(name, "has no index: it is still being recorded, or was not closed")
        )
    if index_pos > file_bytes:
        what = f"is cut short: its index should begin at byte {index_pos}, it has {file_bytes}"
        raise BagUnindexed(_reindex(name, what))
    if index_pos < record.data_pos + record.data_bytes:
        raise BagError(_reindex(name, "is damaged: its header places the index inside itself"))
    return index_pos, connections, chunks


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


def _reindex(name: str, what: str) -> str:
    return f"{name} {what}; repair it with: rosbag reindex {name}"


def read_index(file: BinaryIO, file_bytes: int, name: str) -> BagIndex:
    """Read the header and the whole index of a bag, from the file's beginning.

    Raises:
        BagUnindexed: The bag was not closed, or is cut short: the index, or a part of it, lacks.
        BagError: It is no bag of format 2.0, it is encrypted, or its index contradicts itself.
    """
    index_pos, connection_count, chunk_count = _read_file_header(file, file_bytes, name)
    file.seek(index_pos)
    index = BagIndex()
    try:
        _read_connections(file, file_bytes, connection_count, name, index)
        _read_chunk_infos(file, file_bytes, chunk_count, name, index)
    except BagUnindexed as exc:
        what = f"is cut short: its index ends at byte {file_bytes}"
        raise BagUnindexed(_reindex(name, what)) from exc
    _sort_chunks(index, index_pos, name)
    return index


def _read_connections(
    file: BinaryIO, file_bytes: int, count: int, name: str, index: BagIndex
) -> None:
    found: dict[int, tuple[str, bytes]] = {}
    where = f"{name}: a connection in the index"
    for _ in range(count):
        record = bagformat.read_record(file, file_bytes, bagformat.OP_CONNECTION, where)
        number = bagformat.number(record.fields, b"conn", bagformat.U32, where)
        header = file.read(record.data_bytes)
        topic = _topic(record.fields, number, name)
        _check_header(header, f"{name}: connection {number} (topic {topic})")
        if found.setdefault(number, (topic, header)) != (topic, header):
            raise BagError(f"{name} is damaged: it has two different connections {number}")
    # Number decides between equal times. Where the records stand in another order, that is
    # the one in which rosbag reads, so the place in it is taken for the number.
    ascending = list(found) == sorted(found)
    for place, (number, (topic, header)) in enumerate(found.items()):
        index.numbers[number] = number if ascending else place
        connection = Connection(topic, header, index.numbers[number])
        index.connections[index.numbers[number]] = connection


def _topic(fields: bagformat.Fields, number: int, name: str) -> str:
    raw = fields.get(b"topic")
    try:
        if raw:
            return raw.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise BagError(f"{name}: the topic of connection {number} is not UTF-8") from exc
    raise BagError(f"{name} is damaged: connection {number} names no topic")


def _check_header(header: bytes, where: str) -> None:
    fields = bagformat.split_fields(header, where)
    for name in (b"type", b"md5sum"):
        try:
            present = bool(fields.get(name, b"").decode("utf-8"))
        except UnicodeDecodeError:
            present = False
        if not present:
            raise BagError(f"{where} is damaged: its header states no {name.decode()}")


def _read_chunk_infos(
    file: BinaryIO, file_bytes: int, count: int, name: str, index: BagIndex
) -> None:
    where = f"{name}: a chunk info in the index"
    for _ in range(count):
        info_pos = file.tell()
        info = read_chunk_info(file, file_bytes, index.numbers, where)
        index.counts.update(info.counts)
        # The sum stands here until the chunks are in order.
        before = sum(info.counts.values())
        index.message_count += before
        index.chunks.extend((info.position, info.start_ns, info.end_ns, info_pos, before))


def read_chunk_info(
    file: BinaryIO, file_bytes: int, numbers: dict[int, int], where: str
) -> ChunkInfo:
    """Read the chunk info record at the file's position; its ``first`` is 0.

    Raises:
        BagError: The record is damaged or counts messages of an unknown connection.
    """
    record = bagformat.read_record(file, file_bytes, bagformat.OP_CHUNK_INFO, where)
    version = bagformat.number(record.fields, b"ver", bagformat.U32, where)
    if version != bagformat.INDEX_VERSION:
        raise BagError(f"{where} has the unknown version {version}")
    position = bagformat.number(record.fields, b"chunk_pos", bagformat.U64, where)
    start_ns = bagformat.time_ns(record.fields, b"start_time", where)
    end_ns = bagformat.time_ns(record.fields, b"end_time", where)
    count = bagformat.number(record.fields, b"count", bagformat.U32, where)
    data = file.read(record.data_bytes)
    if len(data) != count * _COUNT.size:
        raise BagError(f"{where} is damaged: {len(data)} bytes for {count} connections")
    counts: dict[int, int] = {}
    for file_id, messages in _COUNT.iter_unpack(data):
        if file_id not in numbers:
            raise BagError(f"{where} counts messages of connection {file_id}, which is missing")
        if messages:
            counts[numbers[file_id]] = counts.get(numbers[file_id], 0) + messages
    return ChunkInfo(position, start_ns, end_ns, counts, 0)


def _sort_chunks(index: BagIndex, index_pos: int, name: str) -> None:
    width = index.PER_CHUNK
    rows = index.chunks
    order = sorted(range(len(index)), key=rows[::width].__getitem__)
    chunks, before, last = array("Q"), 0, len(bagformat.MAGIC)
    for place in order:
        position, start_ns, end_ns, info_pos, count = rows[place * width : (place + 1) * width]
        if not last < position < index_pos:
            raise BagError(f"{name} is damaged: its index places a chunk at byte {position}")
        chunks.extend((position, start_ns, end_ns, info_pos, before))
        before, last = before + count, position
    index.chunks = chunks
