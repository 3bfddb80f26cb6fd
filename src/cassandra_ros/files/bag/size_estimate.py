# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bytes on disk that the messages of a topic take in each format, from some of its messages.

The messages are encoded as they are stored, and compressed by LZ4 in pieces as large as those that
Cassandra compresses. Index files, the commit log and files that wait for deletion are not included.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import AbstractSet, Iterable, List, Mapping, Sequence, Tuple

import lz4.block
import numpy as np

from cassandra_ros.errors import DefinitionError
from cassandra_ros.files.bag.format import ChunkMessages
from cassandra_ros.files.bag.message_file import MessageFile, connections_of_topics
from cassandra_ros.keys import NAMED_FORMATS, SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.metadata import FORMAT_NAMES, Kind
from cassandra_ros.store.blocks.block_builder import ALONE_BYTES
from cassandra_ros.store.blocks.codec import pack_block
from cassandra_ros.store.tables.lengths import MAX_BLOCK_BYTES, MAX_BLOCK_MESSAGES
from cassandra_ros.store.tables.row_table import INLINE_COLUMN_BYTES, LARGE_MESSAGE_CHUNK_BYTES
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.message_writer import connection_kind, usable_definition
from cassandra_ros.topics.stored_totals import TopicInfo

SAMPLE_BYTES = 2 << 20
"""Maximum number of serialised bytes in the sample of one topic."""
_PARTS = 8
"""Number of places in a stored topic, evenly spaced in time, from which messages are sampled."""
_ROW_PIECE = 16 << 10
_BLOB_PIECE = 64 << 10
"""Sizes of the pieces that Cassandra compresses, bytes: in tables of rows, and in tables of blocks
and of chunks."""
_PIECE_BYTES = 12
"""Size of the checksum of one compressed piece, and of its place in the file, bytes."""
_ROW = struct.Struct(">BHqqBIBqi")
"""Flags and size of a row, ``_t``, ``_seq``, time of writing, ``_conn`` and ``_size``."""
_BATCH_NS = 200_000_000
"""Time in which a recorder fills a batch of rows, ns."""
_CELL = 8
"""Flags of a column in a file: it is written at the time of its row."""
_NUMBER_BYTES = 8
"""Maximum size of a column whose type has a fixed size, bytes."""

Wires = List[Tuple[int, bytes]]
"""Receive time, ns, and serialised bytes of messages."""


@dataclass(eq=False)
class TopicSample:
    """Some messages of one topic and type.

    Attributes:
        topic, type, md5sum: Name and type of the topic.
        definition: Definition of the type; None = it is unusable.
        rate_hz: Mean rate of the topic, Hz; None = unknown.
        mean_bytes: Mean size of all messages of the topic, bytes; 0 = that of the sample.
        stored_format: Format in which the topic is stored; '' = it was read from a file.
        table: Name of the topic's table; '' = it was read from a file.
        count: Number of messages of the topic.
        wires: The sampled messages.
        nbytes: Size of the sampled messages, bytes.
    """

    topic: str
    type: str
    md5sum: str
    definition: Definition | None
    rate_hz: float | None = None
    mean_bytes: float = 0.0
    stored_format: str = ""
    table: str = ""
    count: int = 0
    wires: Wires = field(default_factory=list)
    nbytes: int = 0

    def add_message(self, t_ns: int, wire: bytes, most: int) -> bool:
        """Add a message, unless the sample is full; return whether it was added."""
        if len(self.wires) >= most or (self.wires and self.nbytes + len(wire) > SAMPLE_BYTES):
            return False
        self.wires.append((t_ns, wire))
        self.nbytes += len(wire)
        return True

    @property
    def message_bytes(self) -> float:
        """Mean size of the topic's messages, bytes; 0 = unknown."""
        return self.mean_bytes or (self.nbytes / len(self.wires) if self.wires else 0.0)


def sample_file(reader: MessageFile, topics: Sequence[str] | None, most: int) -> list[TopicSample]:
    """Sample the first messages of each topic and type of a bag or an MCAP, at most ``most``."""
    samples = new_samples(reader, connections_of_topics(reader, topics))
    wanted = dict(samples)
    for chunk in range(reader.chunk_count):
        if not wanted.keys().isdisjoint(reader.chunk_info(chunk).counts):
            sample_chunk(wanted, most, *reader.chunk_content(chunk))
    return list(dict.fromkeys(samples.values()))


def new_samples(reader: MessageFile, numbers: AbstractSet[int]) -> dict[int, TopicSample]:
    """Return samples without messages by connection, one for each topic and type of a file."""
    seconds = (reader.end_ns - reader.start_ns) / SECOND_NS
    samples: dict[tuple[str, Kind], TopicSample] = {}
    sample_of: dict[int, TopicSample] = {}
    """Connection number -> sample; connections of one topic and type have one sample."""
    for number in sorted(numbers):
        connection = reader.connections[number]
        key = (connection.topic, connection_kind(connection))
        if key not in samples:
            definition, _ = usable_definition(connection, FALLBACK_FORMAT)
            samples[key] = TopicSample(
                connection.topic, connection.type, connection.md5sum, definition
            )
        sample_of[number] = samples[key]
        samples[key].count += reader.counts[number]
    for sample in samples.values():
        sample.rate_hz = sample.count / seconds if seconds > 0 else None
    return sample_of


def sample_chunk(
    samples: dict[int, TopicSample], most: int, content: bytes, messages: ChunkMessages
) -> None:
    """Add the messages of a chunk to samples by connection; drop the samples that are full.

    Args:
        most: Maximum number of messages in a sample.
        content, messages: The result of ``chunk_content``.
    """
    numbers = np.unique(messages.ids).tolist() if samples else ()
    for number in filter(samples.__contains__, numbers):
        for row in np.flatnonzero(messages.ids == number).tolist():
            wire = content[messages.starts[row] : messages.stops[row]]
            if not samples[number].add_message(int(messages.times[row]), wire, most):
                del samples[number]
                break


def sample_topic(topic: CassandraTopic, infos: Sequence[TopicInfo], most: int) -> list[TopicSample]:
    """Sample the messages of a stored topic, a sample for each of its tables that has messages.

    Args:
        infos: Numbers of the topic's messages, by table and robot.
        most: Maximum number of messages in a sample.
    """
    samples = []
    for table in topic.tables:
        filled = [info for info in infos if info.table == table.name and info.count]
        count = sum(info.count for info in filled)
        if not count:
            continue
        metadata = table.metadata
        sample = TopicSample(
            topic.name,
            metadata.msg_type,
            metadata.md5sum,
            table.definition,
            rate_hz=sum(info.rate_hz or 0.0 for info in filled) or None,
            mean_bytes=sum(info.bytes for info in filled) / count,
            stored_format=metadata.format,
            table=table.name,
            count=count,
        )
        _fill(sample, topic, filled, most)
        samples.append(sample)
    return samples


def _fill(
    sample: TopicSample, topic: CassandraTopic, infos: Sequence[TopicInfo], most: int
) -> None:
    """Add messages from several times of a topic to the sample of one of its tables.

    Args:
        infos: Numbers of the messages in the table, at least one.
        most: Maximum number of messages in the sample.
    """
    if infos[0].key in NAMED_FORMATS:
        starts: Sequence[Stamp | None] = [None]
    else:
        first = min(info.first_ns or 0 for info in infos)
        last = max(info.last_ns or 0 for info in infos)
        step = (last - first) // _PARTS
        starts = [Stamp.from_ns(first + n * step) for n in range(_PARTS if step else 1)]
    seen = set()
    for start in starts:
        for row in topic.rows(key=start, limit=-(-most // len(starts))):
            if row.table.name != sample.table or row.identity in seen:
                continue
            seen.add(row.identity)
            if not sample.add_message(row.received, row.wire, most):
                return


@dataclass(frozen=True)
class FormatSize:
    """Bytes that one message of a topic takes in one format, without copies on other nodes."""

    plain: float
    """Size before Cassandra compresses it, bytes."""
    disk: float
    """Size on disk after compression, bytes."""


def estimate(sample: TopicSample, block_sec: float) -> Mapping[str, FormatSize | None]:
    """Return ``format_size`` of each format."""
    return {name: format_size(sample, name, block_sec) for name in FORMAT_NAMES}


def format_size(sample: TopicSample, name: str, block_sec: float) -> FormatSize | None:
    """Return the size of a message of a topic in a format; None = the format cannot hold it.

    Args:
        block_sec: Format ``packed``: time that a recorder fills a block at most, s; ``math.inf`` =
            until it is full, as an import does.
    """
    try:
        encoder = format_class(name)(sample.type, sample.md5sum, sample.definition)
    except DefinitionError:
        return None
    parts = _blocks(encoder, sample, block_sec) if encoder.PACKED else _rows(encoder, sample)
    return _mean(sample, parts)


def _mean(sample: TopicSample, parts: Iterable[tuple[bytes, int]]) -> FormatSize | None:
    """Return the mean size of a message from the encoded bytes of the sample; None = it is empty.

    Args:
        parts: Bytes as they lie in a file, and _ROW_PIECE or _BLOB_PIECE.
    """
    # Files of rows and of blobs are compressed apart. A piece is full before it is compressed.
    waiting = {_ROW_PIECE: bytearray(), _BLOB_PIECE: bytearray()}
    plain = disk = 0
    for data, piece in parts:
        plain += len(data)
        waiting[piece] += data
        while len(waiting[piece]) >= piece:
            disk += _compressed_size(bytes(waiting[piece][:piece]), piece)
            del waiting[piece][:piece]
    for piece, rest in waiting.items():
        disk += _compressed_size(bytes(rest), piece) if rest else 0
    if not sample.wires:
        return None
    scale = sample.message_bytes * len(sample.wires) / sample.nbytes if sample.nbytes else 1.0
    return FormatSize(plain / len(sample.wires) * scale, disk / len(sample.wires) * scale)


def _compressed_size(data: bytes, piece: int) -> int:
    """Return the size on disk of one piece; it is not compressed where that saves too little."""
    size = len(lz4.block.compress(data, store_size=False))
    worth = 1.1 if piece == _BLOB_PIECE else 1.0  # min_compress_ratio of store/tables/schema.py
    return _PIECE_BYTES + (size if size * worth < len(data) else len(data))


def _rows(encoder: CassandraTopic_, sample: TopicSample) -> Iterable[tuple[bytes, int]]:
    """Yield the rows of a sample, and the chunks of large messages, see _mean."""
    for n, (t_ns, wire) in enumerate(sample.wires):
        columns, _, raw = encoder.encode_wire(wire)
        chunked = len(wire) > LARGE_MESSAGE_CHUNK_BYTES
        values = [*columns, None if chunked else raw]
        most = INLINE_COLUMN_BYTES if chunked else max(len(v or b"") for v in values)
        yield (
            _row(t_ns, n, len(wire), [v for v in values if v is None or len(v) <= most]),
            _ROW_PIECE,
        )
        if chunked:
            yield wire, _BLOB_PIECE


def _blocks(
    encoder: CassandraTopic_, sample: TopicSample, block_sec: float
) -> Iterable[tuple[bytes, int]]:
    """Yield the blocks of a sample, as BlockBuilder would make them, see _mean."""
    at = 0
    rate = sample.rate_hz or float(MAX_BLOCK_MESSAGES)
    most = max(1, round(min(MAX_BLOCK_MESSAGES, rate * block_sec)))
    while at < len(sample.wires):
        stop, nbytes = at + 1, len(sample.wires[at][1])
        while stop < min(at + most, len(sample.wires)):
            nbytes += len(sample.wires[stop][1])
            if nbytes > MAX_BLOCK_BYTES or len(sample.wires[stop][1]) > ALONE_BYTES:
                break
            stop += 1
        times = [t_ns for t_ns, _ in sample.wires[at:stop]]
        wires = [wire for _, wire in sample.wires[at:stop]]
        zones = encoder.zones(wires)[0]
        if len(wires[0]) > LARGE_MESSAGE_CHUNK_BYTES:
            data, chunks = b"", wires[0]
        else:
            data, chunks = pack_block(sorted(times), list(range(at, stop)), wires, None), b""
        yield _row(times[0], at, nbytes, [*zones, data]), _BLOB_PIECE
        yield chunks, _BLOB_PIECE
        at = stop


def _row(t_ns: int, seq: int, size: int, values: Sequence[bytes | None]) -> bytes:
    """Return bytes like those of a row in a file: its key, and each column that is set."""
    written = t_ns // _BATCH_NS % 2**32  # the rows of a batch are written at one time
    head = _ROW.pack(0x24, 40, t_ns, seq, _CELL, written, _CELL, 1, size % 2**31)
    return head + b"".join(_cell(value) for value in values if value is not None)


def _cell(value: bytes) -> bytes:
    """Return a column as in a file: a number without its length, other values after theirs."""
    size = len(value)
    if size <= _NUMBER_BYTES:
        length = b""
    else:
        length = size.to_bytes(1 + (size > 127) + (size > 16383) + (size > 2**21), "big")
    return bytes([_CELL]) + length + value
