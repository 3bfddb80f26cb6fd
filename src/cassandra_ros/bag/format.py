# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Records of the bag format 2.0: magic line, op codes, header fields and their packing.

A record is: length of the header, header, length of the data, data. A header is a sequence of
fields: length, name, '=', value. All numbers are little endian.
"""

from __future__ import annotations

from struct import Struct
from typing import BinaryIO, Dict, Iterable, NamedTuple, Tuple

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

U8 = Struct("<B")
U32 = Struct("<I")
U64 = Struct("<Q")
TIME = Struct("<II")

Fields = Dict[bytes, bytes]


class Record(NamedTuple):
    """Header of a record in a file, and where its data lies."""

    fields: Fields
    data_pos: int
    data_bytes: int


def split_fields(header: bytes, where: str) -> Fields:
    """Take a header apart into its fields; of equal names the last one counts.

    Args:
        header: The header without its own length.
        where: Subject of the error's sentence, with the name of the file.

    Raises:
        BagError: The lengths do not fit together, or a field has no name.
    """
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


def pack_fields(fields: Iterable[Tuple[bytes, bytes]]) -> bytes:
    """Build a header (without its own length) from names and values."""
    return b"".join(
        U32.pack(len(name) + 1 + len(value)) + name + b"=" + value for name, value in fields
    )


def pack_record(fields: Iterable[Tuple[bytes, bytes]], data: bytes) -> bytes:
    """Build a whole record."""
    header = pack_fields(fields)
    return b"".join((U32.pack(len(header)), header, U32.pack(len(data)), data))


def number(fields: Fields, name: bytes, layout: Struct, where: str) -> int:
    """Read a number out of a header.

    Raises:
        BagError: The field is missing or of another size.
    """
    value = fields.get(name)
    if value is None or len(value) != layout.size:
        raise BagError(f"{where} is damaged: its header has no valid field '{name.decode()}'")
    return int(layout.unpack(value)[0])


def time_ns(fields: Fields, name: bytes, where: str) -> int:
    """Read a time out of a header, as nanoseconds.

    Raises:
        BagError: The field is missing, of another size, or beyond what a ROS stamp can hold.
    """
    packed = number(fields, name, U64, where)  # seconds in the lower half
    t_ns = (packed & 0xFFFFFFFF) * SECOND_NS + (packed >> 32)
    if t_ns > MAX_NS:
        raise BagError(f"{where} is damaged: its time lies beyond the year 2106")
    return t_ns


def pack_time(t_ns: int) -> bytes:
    """Write nanoseconds as the seconds and nanoseconds of a ROS time."""
    return TIME.pack(*divmod(t_ns, SECOND_NS))


def read_record(file: BinaryIO, file_bytes: int, op: int, where: str) -> Record:
    """Read the header of the record at the file's position, and stop before its data.

    Raises:
        BagUnindexed: The file ends within the record.
        BagError: It is not a record of this kind.
    """
    start = file.tell()
    header_bytes = _length(file, file_bytes, where)
    if header_bytes > MAX_HEADER_BYTES:
        raise BagError(f"{where} is damaged: a header of {header_bytes} bytes at byte {start}")
    if file_bytes - file.tell() < header_bytes:
        raise cut_short(where, file_bytes)
    fields = split_fields(file.read(header_bytes), where)
    found = number(fields, b"op", U8, where)
    if found != op:
        raise BagError(f"{where} is damaged: at byte {start} stands a record of kind {found}")
    data_bytes = _length(file, file_bytes, where)
    position = file.tell()
    if file_bytes - position < data_bytes:
        raise cut_short(where, file_bytes)
    return Record(fields, position, data_bytes)


def cut_short(where: str, file_bytes: int) -> BagUnindexed:
    """Make the error for a file that ends too early."""
    return BagUnindexed(
        f"{where} does not fit into the file, which is cut short after {file_bytes} bytes; "
        "'rosbag reindex' on the file keeps what can still be read"
    )


def _length(file: BinaryIO, file_bytes: int, where: str) -> int:
    raw = file.read(4)
    if len(raw) < 4:
        raise cut_short(where, file_bytes)
    return int(U32.unpack(raw)[0])
