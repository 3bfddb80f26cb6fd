# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Records of the bag format 2.0: magic line, op codes, header fields and their packing.

A record consists of: length of the header, header, length of the data, data. A header is a sequence
of fields: length, name, '=', value. All numbers are little endian.
"""

from __future__ import annotations

import os
from struct import Struct
from typing import BinaryIO, Dict, Iterable, NamedTuple, Tuple, Union

from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.keys import MAX_NS, SECOND_NS

MAGIC = b"#ROSBAG V2.0\n"
FILE_HEADER_BYTES = 4096
"""Size of the first record including its padding, bytes. It is overwritten when the bag closes."""
INDEX_VERSION = 1
"""Version of the index records that we read and write."""

OP_MESSAGE = 2
OP_FILE_HEADER = 3
OP_INDEX = 4
OP_CHUNK = 5
OP_CHUNK_INFO = 6
OP_CONNECTION = 7

MAX_HEADER_BYTES = 1 << 20
"""Maximum size of a record's header, bytes. Real headers have tens of bytes."""

MAX_CONNECTION_BYTES = 1 << 24
"""Maximum size of the data of an index record, bytes: a connection header, whose longest part is
the message definition (some 100 KB in real bags), or the message counts of one chunk."""

U32 = Struct("<I")
COUNT = Struct("<II")
"""Connection id, and number of its messages in a chunk."""
_TIME = Struct("<II")
_WIDTHS = {
    **dict.fromkeys((b"conn", b"ver", b"count", b"size", b"conn_count", b"chunk_count"), 4),
    **dict.fromkeys((b"index_pos", b"chunk_pos", b"time", b"start_time", b"end_time"), 8),
    b"op": 1,
}
"""Sizes of the header fields that are numbers, bytes; a time has its seconds in the lower half."""

Fields = Dict[bytes, bytes]
"""Name -> value of the fields of a header."""
NewFields = Iterable[Tuple[bytes, Union[bytes, int]]]
"""Names and values of the fields of a header that is to be written."""


class Record(NamedTuple):
    """The header of a record in a file, and the position and size of its data, bytes."""

    fields: Fields
    data_pos: int
    data_bytes: int


def split_fields(header: bytes, where: str) -> Fields:
    """Parse a header (without its length). If a name occurs twice, the last value counts."""
    fields: Fields = {}
    position, end = 0, len(header)
    while position < end:
        start = position + 4
        stop = start + (U32.unpack_from(header, position)[0] if start <= end else end)
        name, equals, value = header[start:stop].partition(b"=")
        if stop > end or not equals:
            raise BagError(f"{where} is damaged: a field of its header runs over the end")
        fields[name] = value
        position = stop
    return fields


def pack_fields(fields: NewFields) -> bytes:
    """Return a header (without its length) with these fields."""
    parts = []
    for name, value in fields:
        raw = value.to_bytes(_WIDTHS[name], "little") if isinstance(value, int) else value
        parts.append(U32.pack(len(name) + 1 + len(raw)) + name + b"=" + raw)
    return b"".join(parts)


def pack_record(fields: NewFields, data: bytes) -> bytes:
    """Return a complete record with these header fields and data."""
    header = pack_fields(fields)
    return b"".join((U32.pack(len(header)), header, U32.pack(len(data)), data))


def number(fields: Fields, name: bytes, where: str) -> int:
    """Return a number from a header.

    Raises:
        BagError: The field is missing or has the wrong size.
    """
    value = fields.get(name, b"")
    if len(value) != _WIDTHS[name]:
        raise BagError(f"{where} is damaged: its header has no valid field '{name.decode()}'")
    return int.from_bytes(value, "little")


def time_ns(fields: Fields, name: bytes, where: str) -> int:
    """Return a time from a header, ns.

    Raises:
        BagError: The field is missing, has the wrong size, or its time is too large for ROS 1.
    """
    nsecs, secs = divmod(number(fields, name, where), 1 << 32)
    t_ns = secs * SECOND_NS + nsecs
    if t_ns > MAX_NS:
        raise BagError(f"{where} is damaged: its time lies beyond the year 2106")
    return t_ns


def pack_time(t_ns: int) -> bytes:
    """Return the 8 bytes of a ROS time (seconds, nanoseconds) for a time in ns."""
    return _TIME.pack(*divmod(t_ns, SECOND_NS))


def read_record(file: BinaryIO, op: int, where: str) -> Record:
    """Read the header of the record at the current file position, and stop before its data.

    Raises:
        BagUnindexed: The file ends inside the record.
        BagError: The record is not of the kind ``op``.
    """
    start = file.tell()
    fields = read_header(file, where)
    found = number(fields, b"op", where)
    if found != op:
        raise BagError(f"{where} is damaged: at byte {start} stands a record of kind {found}")
    data_bytes = _length(file, where)
    return Record(fields, file.tell(), data_bytes)


def read_header(file: BinaryIO, where: str) -> Fields:
    """Read the header of the record at the current file position; errors as in read_record."""
    return split_fields(file.read(_length(file, where, MAX_HEADER_BYTES)), where)


def _length(file: BinaryIO, where: str, most: int = 2**32) -> int:
    """Read the length of the header or data that follows, and check that the file is so long."""
    raw, file_bytes = file.read(4), os.fstat(file.fileno()).st_size
    length = U32.unpack(raw)[0] if len(raw) == 4 else 0
    if length > most:
        start = file.tell() - 4
        raise BagError(f"{where} is damaged: a header of {length} bytes at byte {start}")
    if len(raw) < 4 or file_bytes - file.tell() < length:
        raise BagUnindexed(
            f"{where} does not fit into the file, which is cut short after {file_bytes} bytes; "
            "import --salvage stores what can still be read"
        )
    return int(length)
