# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Make the records of an MCAP one by one, for a file that is only ever appended to; read them.

The library's writer keeps the index of the whole file in memory and takes four times as long for a
small message. What describes the file is packed and parsed by the library all the same.
"""

from __future__ import annotations

import struct
from typing import Mapping, NamedTuple, Sequence

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, McapRecord, Metadata, Schema
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag.mcap_channel import to_channel, unchecked_connection
from cassandra_ros.files.bag.mcap_format import (
    CHUNK,
    CHUNK_SIZE_BYTES,
    ENTRY_BYTES,
    INDEX,
    MAGIC,
    MESSAGE,
    RECORD,
    parse,
    records_of,
)
from cassandra_ros.messages.connection_header import Connection

CHUNK_KIND, INDEX_KIND = int(Opcode.CHUNK), int(Opcode.MESSAGE_INDEX)
METADATA_KIND, END_KIND = int(Opcode.METADATA), int(Opcode.DATA_END)
_HEAD_BYTES = MESSAGE.size - RECORD.size
"""Size of the fields of a message record before the serialised message, bytes."""
_LENGTH_BYTES = 4
"""Size of the length of a text or of a map, bytes."""
_END_BYTES = 4
"""Size of the content of a record DataEnd, bytes."""
_OWN = b"cassandra_ros."
"""First bytes of the names of our metadata records."""
MAX_METADATA_BYTES = 1 << 26
"""Maximum size of a metadata record that is_plausible accepts, bytes."""


class IndexedMessages(NamedTuple):
    """The messages of one channel in a chunk, as a message index lists them."""

    channel: int
    """Channel id."""
    times: Sequence[int]
    """Receive times, ns."""


def begin_file() -> bytes:
    """Return the first bytes of a file."""
    return MAGIC + _pack(Header(Profile.ROS1, "cassandra_ros"))


def end_file() -> bytes:
    """Return the last bytes of a file that has no summary."""
    return _pack(DataEnd(0)) + _pack(Footer(0, 0, 0)) + MAGIC


def metadata(name: str, fields: Mapping[str, str]) -> bytes:
    """Return a metadata record."""
    return _pack(Metadata(name, dict(fields)))


def channel(number: int, connection: Connection) -> bytes:
    """Return schema and channel of a connection, both with one number."""
    text = to_channel(connection)
    schema = Schema(number, text.definition, SchemaEncoding.ROS1, text.type)
    topic, encoding = connection.topic, MessageEncoding.ROS1
    return _pack(schema) + _pack(Channel(number, topic, encoding, text.metadata, number))


def message_head(channel_id: int, sequence: int, t_ns: int, nbytes: int) -> bytes:
    """Return the record of a message before its bytes."""
    return MESSAGE.pack(Opcode.MESSAGE, _HEAD_BYTES + nbytes, channel_id, sequence, t_ns, t_ns)


def chunk(content: bytes, times: tuple[int, int], crc: int) -> list[bytes]:
    """Return the parts of an uncompressed chunk; the last part is ``content``, without a copy.

    Args:
        content: Its records.
        times: Receive times of its first and its last message, ns.
        crc: CRC-32 of the records.
    """
    nbytes = len(content)
    head = RECORD.pack(Opcode.CHUNK, CHUNK.size + CHUNK_SIZE_BYTES + nbytes)
    size = nbytes.to_bytes(CHUNK_SIZE_BYTES, "little")
    return [head, CHUNK.pack(*times, nbytes, crc, 0), size, content]


def index(channel_id: int, entries: Sequence[int]) -> bytes:
    """Return a message index; entries are receive time, ns, and offset of each message in turn."""
    data = struct.pack(f"<{len(entries)}Q", *entries)
    head = RECORD.pack(Opcode.MESSAGE_INDEX, INDEX.size + len(data))
    return head + INDEX.pack(channel_id, len(data)) + data


def read_index(raw: bytes) -> IndexedMessages:
    """Read a message index, without kind and length."""
    channel_id, nbytes = INDEX.unpack_from(raw)
    count = nbytes // ENTRY_BYTES * 2
    return IndexedMessages(channel_id, struct.unpack_from(f"<{count}Q", raw, INDEX.size)[::2])


def chunk_content(raw: bytes) -> tuple[bytes, int]:
    """Return the records of an uncompressed chunk, and the CRC-32 that it states of them.

    Args:
        raw: The chunk without kind and length, of which is_plausible holds.
    """
    return raw[CHUNK.size + CHUNK_SIZE_BYTES :], CHUNK.unpack_from(raw)[3]


def read_metadata(raw: bytes, where: str) -> tuple[str, Mapping[str, str]]:
    """Read name and fields of a metadata record; raises BagError."""
    record = parse(Metadata, raw, where)
    return record.name, record.metadata


def read_channels(content: bytes, where: str) -> dict[int, Connection]:
    """Return the connections before the first message of a chunk, by channel id; raises BagError.

    They have no number: -1, as before they were written.
    """
    schemas: dict[int, Schema] = {}
    connections: dict[int, Connection] = {}
    for record in records_of(content, where):
        raw = content[record.start : record.stop]
        if record.kind == Opcode.SCHEMA:
            schema = parse(Schema, raw, where)
            schemas[schema.id] = schema
        elif record.kind == Opcode.CHANNEL:
            described = parse(Channel, raw, where)
            connection = unchecked_connection(described, schemas.get(described.schema_id), where)
            connections[described.id] = Connection(connection.topic, connection.header)
        else:
            break
    return connections


def is_plausible(kind: int, length: int, raw: bytes, after: int) -> bool:
    """Say whether a record outside of chunks may be one that these functions make.

    Args:
        kind, length: Kind and length of the record.
        raw: The bytes after these: all, or at least the first 40 and, of a record with a name,
            those up to four bytes after the name.
        after: Number of bytes of the file after the record.
    """
    if kind == Opcode.CHUNK and length >= CHUNK.size + CHUNK_SIZE_BYTES <= len(raw):
        start, end, size, _, compression = CHUNK.unpack_from(raw)
        stored = int.from_bytes(raw[CHUNK.size : CHUNK.size + CHUNK_SIZE_BYTES], "little")
        body = length - CHUNK.size - CHUNK_SIZE_BYTES
        return bool(start <= end and not compression and size == stored == body)
    if kind == Opcode.MESSAGE_INDEX and length >= INDEX.size <= len(raw):
        nbytes = INDEX.unpack_from(raw)[1]
        return bool(nbytes == length - INDEX.size and nbytes % ENTRY_BYTES == 0)
    if kind == Opcode.METADATA:
        return (
            raw[4:].startswith(_OWN) and length <= MAX_METADATA_BYTES and length == _two_parts(raw)
        )
    if kind == Opcode.DATA_END:
        return length == _END_BYTES and after == len(end_file()) - RECORD.size - _END_BYTES
    is_ours = kind == Opcode.HEADER and raw[4:].startswith(Profile.ROS1.encode())
    return is_ours and length == _two_parts(raw)


def _two_parts(raw: bytes) -> int:
    """Return the length of a record of two parts, each after its size.

    Return 0 if the first bytes of the record, ``raw``, do not reach the second size.
    """
    first = int.from_bytes(raw[:_LENGTH_BYTES], "little")
    second = raw[_LENGTH_BYTES + first :][:_LENGTH_BYTES]
    return 2 * _LENGTH_BYTES + first + int.from_bytes(second, "little") if second else 0


def _pack(record: McapRecord) -> bytes:
    """Return the bytes of a record by the library; raises BagError if a text is not UTF-8."""
    builder = RecordBuilder()
    try:
        record.write(builder)
    except UnicodeEncodeError as exc:
        raise BagError(f"a name is not text and cannot be written into an MCAP: {exc}") from exc
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # of the library
