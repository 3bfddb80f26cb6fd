# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Records of the bag format 2.0: magic line, op codes, header fields and their packing.

A record is: length of the header, header, length of the data, data. A header is a sequence of
fields: length, name, '=', value. All numbers are little endian.
"""

from __future__ import annotations

import os
from struct import Struct
from typing import BinaryIO, Dict, Iterable, NamedTuple, Tuple, Union

from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.keys import MAX_NS, SECOND_NS

MAGIC = b"#ROSBAG V2.0\n"
FILE_HEADER_BYTES = 4096
"""Header and padding of the first record, together; written again in place at the end."""
INDEX_VERSION = 1

OP_MESSAGE = 2
OP_FILE_HEADER = 3
OP_INDEX = 4
OP_CHUNK = 5
OP_CHUNK_INFO = 6
OP_CONNECTION = 7

MAX_HEADER_BYTES = 1 << 20
"""Longest header of a record that is believed; real ones have tens of bytes."""

MAX_CONNECTION_BYTES = 1 << 24
"""Maximum size of the data of a record in the index, bytes: the header of a connection, whose
longest part is the definition (some 100 KB in real bags), or the counts of one chunk."""

U32 = Struct("<I")
COUNT = Struct("<II")
"""Number of a connection, and its messages in a chunk."""
_TIME = Struct("<II")
_WIDTHS = {
    **dict.fromkeys((b"conn", b"ver", b"count", b"size", b"conn_count", b"chunk_count"), 4),
    **dict.fromkeys((b"index_pos", b"chunk_pos", b"time", b"start_time", b"end_time"), 8),
    b"op": 1,
}
"""Bytes of the fields that are numbers; a time is one with its seconds in the lower half."""

Fields = Dict[bytes, bytes]
NewFields = Iterable[Tuple[bytes, Union[bytes, int]]]


class Record(NamedTuple):
    """Header of a record in a file, and where its data lies."""

    fields: Fields
    data_pos: int
    data_bytes: int


def split_fields(header: bytes, where: str) -> Fields:
    """Take a header (without its own length) apart; of equal names the last one counts."""
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
    """Build a header (without its own length) from names and values."""
    parts = []
    for name, value in fields:
        raw = value.to_bytes(_WIDTHS[name], "little") if isinstance(value, int) else value
        parts.append(U32.pack(len(name) + 1 + len(raw)) + name + b"=" + raw)
    return b"".join(parts)


def pack_record(fields: NewFields, data: bytes) -> bytes:
    """Build a whole record."""
    header = pack_fields(fields)
    return b"".join((U32.pack(len(header)), header, U32.pack(len(data)), data))


def number(fields: Fields, name: bytes, where: str) -> int:
    """Read a number out of a header; BagError where it is missing or of another size."""
    value = fields.get(name, b"")
    if len(value) != _WIDTHS[name]:
        raise BagError(f"{where} is damaged: its header has no valid field '{name.decode()}'")
    return int.from_bytes(value, "little")


def time_ns(fields: Fields, name: bytes, where: str) -> int:
    """Read a time out of a header, as nanoseconds; BagError also where no ROS stamp holds it."""
    nsecs, secs = divmod(number(fields, name, where), 1 << 32)
    t_ns = secs * SECOND_NS + nsecs
    if t_ns > MAX_NS:
        raise BagError(f"{where} is damaged: its time lies beyond the year 2106")
    return t_ns


def pack_time(t_ns: int) -> bytes:
    """Write nanoseconds as the seconds and nanoseconds of a ROS time."""
    return _TIME.pack(*divmod(t_ns, SECOND_NS))


def read_record(file: BinaryIO, op: int, where: str) -> Record:
    """Read the header of the record at the file's position, and stop before its data.

    Raises:
        BagUnindexed: The file ends within the record.
        BagError: It is not a record of this kind.
    """
    start = file.tell()
    fields = read_header(file, where)
    found = number(fields, b"op", where)
    if found != op:
        raise BagError(f"{where} is damaged: at byte {start} stands a record of kind {found}")
    data_bytes = _length(file, where)
    return Record(fields, file.tell(), data_bytes)


def read_header(file: BinaryIO, where: str) -> Fields:
    """Read the header of the record at the file's position; raises as read_record does."""
    return split_fields(file.read(_length(file, where, MAX_HEADER_BYTES)), where)


def _length(file: BinaryIO, where: str, most: int = 2**32) -> int:
    """Read how many bytes follow; so many are in the file."""
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
