# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bag format 2.0: records, and chunks with the messages inside.

A record consists of: length of the header, header, length of the data, data. A header is a sequence
of fields: length, name, '=', value. All numbers are little endian. The data of a chunk are records
of messages and connections, compressed (none, bz2, lz4 as ROS frames it).
"""

from __future__ import annotations

import bz2
import os
import struct
from array import array
from contextlib import suppress
from io import BytesIO
from itertools import permutations
from struct import Struct
from typing import BinaryIO, Callable, Dict, Iterable, Iterator, NamedTuple, Sequence, Tuple, Union

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

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


class BagRecord(NamedTuple):
    """The header of a record in a file, and where its data lie."""

    fields: Fields
    data_pos: int
    """Offset in the file at which the data begin."""
    data_bytes: int
    """Size of the data, bytes; the file has so many."""


def split_fields(header: bytes, where: str) -> Fields:
    """Parse a header (without its length). If a name occurs twice, the last value counts.

    Args:
        where: Name of the record in the error text.

    Raises:
        BagError: The header is damaged.
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


def pack_fields(fields: NewFields) -> bytes:
    """Return a header (without its length) with these fields; a number has the size in _WIDTHS."""
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


def read_record(file: BinaryIO, op: int, where: str) -> BagRecord:
    """Read the header of the record at the current file position, and stop before its data.

    Raises:
        BagUnindexed: The file ends inside the record.
        BagError: The record is damaged, or not of the kind ``op``.
    """
    start = file.tell()
    fields = read_header(file, where)
    kind = number(fields, b"op", where)
    if kind != op:
        raise BagError(f"{where} is damaged: at byte {start} stands a record of kind {kind}")
    data_bytes = _length(file, where)
    return BagRecord(fields, file.tell(), data_bytes)


def read_header(file: BinaryIO, where: str) -> Fields:
    """Read the header of the record at the current file position, and stop after it.

    What follows is the length of the data. Errors as in read_record.
    """
    return split_fields(file.read(_length(file, where, MAX_HEADER_BYTES)), where)


def _length(file: BinaryIO, where: str, most: int = 2**32) -> int:
    """Read the length of the header or data that follows, bytes.

    Raises:
        BagUnindexed: The file ends before the end of what follows.
        BagError: The length is more than ``most``.
    """
    raw, file_bytes = file.read(4), os.fstat(file.fileno()).st_size
    length = U32.unpack(raw)[0] if len(raw) == 4 else 0
    if length > most:
        start = file.tell() - 4
        raise BagError(f"{where} is damaged: a header of {length} bytes at byte {start}")
    if len(raw) < 4 or file_bytes - file.tell() < length:
        raise BagUnindexed(
            f"{where} does not fit into the file, which is cut short after {file_bytes} bytes; "
            "with --salvage (salvage=True) what it holds is read"
        )
    return int(length)


COMPRESSIONS = ("none", "bz2", "lz4")
"""Compressions of chunks, as their headers name them."""
_FEED_BYTES = 1 << 16
"""Number of compressed bytes given to the decompressor at once."""
_PIECE_BYTES = 1 << 24
"""Maximum number of bytes that are unpacked at once."""
_DAMAGE = (OSError, EOFError, ValueError, RuntimeError)
"""What the decompressors raise for damaged data; RuntimeError is lz4's."""


def compress_chunk(name: str, data: bytes) -> bytes:
    """Compress the records of a chunk with one of COMPRESSIONS."""
    if name == "bz2":
        return bz2.compress(data)
    if name == "lz4":
        import lz4.frame  # when it is needed: few bags are compressed, and programs start sooner

        # The frame of roslz4, which reads no other: it refuses linked blocks, a frame without
        # checksum, and one that states its size.
        packed: bytes = lz4.frame.compress(
            data,
            block_size=lz4.frame.BLOCKSIZE_MAX1MB,
            block_linked=False,
            content_checksum=True,
            store_size=False,
        )
        return packed
    return data


def decompress_chunk(name: str, data: bytes, size: int, where: str) -> bytes:
    """Return the unpacked content of a chunk. At most ``size`` bytes are unpacked.

    The caller has checked the size with an Allowance.

    Raises:
        BagError: The compression is unknown, or the content is damaged or not ``size`` bytes long.
    """
    if name == "none":
        content = data
    elif name in COMPRESSIONS:
        content = _unpack(name, data, size, where)
    else:
        raise BagError(f"{where} is compressed with {name!r}; known are {', '.join(COMPRESSIONS)}")
    if len(content) != size:
        raise BagError(f"{where} is damaged: it holds {len(content)} bytes, not {size}")
    return content


def _unpack(name: str, data: bytes, size: int, where: str) -> bytes:
    """Return the unpacked content; raises BagError if it is damaged or longer than ``size``."""
    content = BytesIO()  # it grows in place, so the content is never in memory twice
    try:
        for piece in _pieces(name, data):
            content.write(piece)
            if content.tell() > size:
                break
    except _DAMAGE as exc:
        raise BagError(f"{where} is damaged: its compressed data is not valid ({exc})") from exc
    if content.tell() > size:
        raise BagError(f"{where} is damaged: it unpacks to more than {size} bytes")
    return content.getvalue()


def _pieces(name: str, data: bytes) -> Iterator[bytes]:
    """Unpack a chunk of bz2 or lz4 in pieces, so that the caller can stop before memory is full.

    Damaged data raise one of _DAMAGE; data that are cut short end without an error.
    """
    parts = (data[n : n + _FEED_BYTES] for n in range(0, len(data), _FEED_BYTES))
    if name == "lz4":
        import lz4.frame

        unpacker = lz4.frame.LZ4FrameDecompressor()
    else:
        unpacker = bz2.BZ2Decompressor()
    for packed in parts:
        yield unpacker.decompress(packed, _PIECE_BYTES)
        while not (unpacker.needs_input or unpacker.eof):
            yield unpacker.decompress(b"", _PIECE_BYTES)


def unpack_part(name: str, data: bytes, most: int) -> bytes:
    """Unpack the beginning of a chunk that is cut short or damaged, up to the damage.

    Args:
        most: Maximum size of the unpacked bytes. Data that are not compressed are returned whole.
    """
    if name not in ("bz2", "lz4"):  # of an unknown compression nothing can be read
        return data if name == "none" else b""
    content = BytesIO()
    with suppress(*_DAMAGE):
        for piece in _pieces(name, data):
            content.write(piece[: most - content.tell()])
            if content.tell() == most:
                break
    return content.getvalue()


Longs = NDArray[np.int64]
"""An array of 64-bit integers."""


class ChunkMessages(NamedTuple):
    """The messages of a chunk in the order of the chunk: one array element per message."""

    ids: Longs
    """Connection id of each message."""
    times: Longs
    """Time of each message, ns."""
    starts: Longs
    """Offset in the content at which the serialised message begins, bytes."""
    stops: Longs
    """Offset in the content at which the serialised message ends (not included), bytes."""

    @property
    def sizes(self) -> Longs:
        """Size of each serialised message, bytes."""
        return self.stops - self.starts


_COLUMNS = 4

# Each of the two known writers of bags (C++ and Python) always writes the header of a message in
# the same layout, so one unpack and two comparisons read it. Other orders are read by field.
# A layout: the function that unpacks (first bytes, connection id, bytes between, seconds,
# nanoseconds, size of the message), the first bytes, the bytes between. All have the same size.
_CPP = (
    Struct("<13sI17sIII").unpack_from,
    b"\x26\0\0\0\x09\0\0\0conn=",
    b"\x04\0\0\0op=\x02\x0d\0\0\0time=",
)
_MESSAGE_HEAD = Struct("<21sI9sIII")
_PYTHON = (
    _MESSAGE_HEAD.unpack_from,
    b"\x26\0\0\0\x04\0\0\0op=\x02\x09\0\0\0conn=",
    b"\x0d\0\0\0time=",
)
_FIXED_BYTES = _MESSAGE_HEAD.size


class _HeadLayout(NamedTuple):
    """The bytes before a serialised message, for one order of the header fields."""

    head: NDArray[np.uint8]
    """The bytes, with 0 where a message has a number."""
    mask: NDArray[np.uint8]
    """Mask of head: 0 where it has a number, else 255."""
    numbers: list[slice]
    """Positions of the numbers in head: connection id, seconds and nanoseconds, message size."""


def _layout(order: Sequence[bytes]) -> _HeadLayout:
    """Return the layout of a header with the fields op, conn and time in an order."""
    header = pack_fields((name, OP_MESSAGE * (name == b"op")) for name in order)
    head = U32.pack(len(header)) + header + U32.pack(0)
    ends = [head.index(name) + len(name) for name in (b"conn=", b"time=")]
    numbers = [slice(end, end + size) for end, size in zip((*ends, len(head) - 4), (4, 8, 4))]
    mask = np.full(len(head), 255, np.uint8)
    for place in numbers:
        mask[place] = 0
    return _HeadLayout(np.frombuffer(head, np.uint8), mask, numbers)


_LAYOUTS = [_layout(order) for order in permutations((b"op", b"conn", b"time"))]
"""All orders of the three header fields; Python 2 wrote another order than the two above."""
MIN_AT_ONCE = 16
"""Minimum number of messages that are read with numpy at once; fewer are read one by one."""
NUMPY_MESSAGES_AT_ONCE = 2**20
"""Maximum number of messages that are read with numpy at once. Each needs some 100 bytes."""
COUNTED_AT_ONCE = 1 << 12
"""Number of records that are counted at once."""
CountRecords = Callable[[int], None]
"""Function that counts records of a chunk: it gets their number since the last call, and raises
BagTooLarge if the file has too many."""
_NO_COLUMNS = np.zeros((_COLUMNS, 0), np.int64)


def uncounted(number: int) -> None:
    """Count no records, as a CountRecords: they were counted before, or the file is our own."""


def find_messages(
    content: bytes, where: str, offsets: Longs | None = None, count: CountRecords = uncounted
) -> ChunkMessages:
    """List the messages in the unpacked content of a chunk. Its records must fill it exactly.

    Args:
        offsets: Ascending offsets of the message records that the index states. If they are all
            messages of the content, these are read at once, which is faster. None = not known.
        count: Counts the records while they are read.

    Raises:
        BagError: A record is damaged, or ``count`` refuses their number.
    """
    if offsets is not None and MIN_AT_ONCE <= len(offsets) <= NUMPY_MESSAGES_AT_ONCE:
        messages = _messages_at(content, where, offsets, count)
        if messages is not None:
            count(len(offsets))
            return messages
    numbers = array("q")  # four numbers for each message; a chunk may hold millions of messages
    position, end = 0, len(content)
    last_fixed = end - _FIXED_BYTES
    (read, head, middle), other = _PYTHON, _CPP  # the layout of the last message, and the other
    records = 0
    while position < end:
        records += 1
        if records == COUNTED_AT_ONCE:
            count(records)
            records = 0
        if position <= last_fixed:
            fixed = read(content, position)
            if fixed[0] != head or fixed[2] != middle:
                (read, head, middle), other = other, (read, head, middle)
                fixed = read(content, position)
            if fixed[0] == head and fixed[2] == middle:
                _, file_id, _, secs, nsecs, size = fixed
                start = position + _FIXED_BYTES
                t_ns = secs * SECOND_NS + nsecs
                stop = start + size
                if stop > end or t_ns > MAX_NS:
                    raise BagError(f"{where} is damaged: a message at byte {position} of it")
                numbers.extend((file_id, t_ns, start, stop))
                position = stop
                continue
        position = _other_record(content, position, where, numbers)
    count(records)
    columns = np.frombuffer(numbers, np.int64).reshape(-1, _COLUMNS).T if numbers else _NO_COLUMNS
    return ChunkMessages(*columns)


def _messages_at(
    content: bytes, where: str, offsets: Longs, count: CountRecords
) -> ChunkMessages | None:
    """Read the messages at these offsets, at once by numpy.

    Return None if they are not all messages of the chunk, if their headers have different orders of
    fields, or if a time lies after MAX_NS: then the caller reads the records one by one.

    Args:
        offsets: Ascending, at least one.
        count: Counts the other records; the caller counts the messages.
    """
    if offsets[0] < 0 or offsets[-1] > len(content) - _FIXED_BYTES:
        return None
    heads = sliding_window_view(np.frombuffer(content, np.uint8), _FIXED_BYTES)[offsets]
    for layout in _LAYOUTS:
        if not ((heads ^ layout.head) & layout.mask).any():
            break
    else:
        return None
    numbers = np.hstack([heads[:, place] for place in layout.numbers])
    ids, secs, nsecs, sizes = numbers.view("<u4").astype(np.int64).T
    starts, times = offsets + _FIXED_BYTES, secs * SECOND_NS + nsecs
    if times.max() > MAX_NS or not _is_filled(content, where, offsets, starts + sizes, count):
        return None
    return ChunkMessages(ids, times, starts, starts + sizes)


def _is_filled(content: bytes, where: str, begins: Longs, ends: Longs, count: CountRecords) -> bool:
    """Return whether some records, with only connection records in the gaps, fill the content.

    Args:
        begins, ends: Offsets of the records and of their ends.
        count: Counts the records in the gaps.

    Raises:
        BagError: A record in a gap is damaged, or ``count`` refuses their number.
    """
    # Gap n lies before record n, the last one before the end of the content.
    begins, ends = np.append(begins, len(content)), np.insert(ends, 0, 0)
    messages_in_gaps = array("q")
    for gap in np.flatnonzero(begins != ends).tolist():
        position, end = int(ends[gap]), int(begins[gap])
        while position < end and not messages_in_gaps:
            position = _other_record(content, position, where, messages_in_gaps)
            count(1)
        if position != end or messages_in_gaps:
            return False
    return True


def _other_record(content: bytes, position: int, where: str, numbers: array[int]) -> int:
    """Read a connection record, or a message in another layout; return the offset of its end.

    Args:
        numbers: Gets the four numbers of the message, see find_messages.

    Raises:
        BagError: The record is damaged, or of another kind.
    """
    op, fields, start, stop = record_at(content, position, where)
    if op == OP_MESSAGE:
        numbers.extend((*message_of(fields, where), start, stop))
    elif op != OP_CONNECTION:
        # Connection records are skipped: the index at the end of the bag repeats them.
        place = f"{where} (byte {position} of its content)"
        raise BagError(f"{place} is damaged: a record of kind {op}")
    return stop


def record_at(content: bytes, position: int, where: str) -> tuple[int, Fields, int, int]:
    """Read the record at an offset of a chunk's content.

    Returns:
        Kind of the record, its header fields, and the offsets of the begin and end of its data.

    Raises:
        BagError: The record is damaged or runs over the end of the content.
    """
    place = f"{where} (byte {position} of its content)"
    try:
        data_size_at = position + 4 + int(U32.unpack_from(content, position)[0])
        start = data_size_at + 4
        stop = start + int(U32.unpack_from(content, data_size_at)[0])
    except struct.error:
        stop = len(content) + 1
    if stop > len(content):
        raise BagError(f"{place} is damaged: a record runs over the end")
    if data_size_at - position > MAX_HEADER_BYTES:
        raise BagError(f"{place} is damaged: a header of {data_size_at - position} bytes")
    fields = split_fields(content[position + 4 : data_size_at], place)
    return number(fields, b"op", place), fields, start, stop


def message_of(fields: Fields, where: str) -> tuple[int, int]:
    """Return the connection id and the time, ns, in the header of a message; raises BagError."""
    return number(fields, b"conn", where), time_ns(fields, b"time", where)


def message_head(number: int, t_ns: int, size: int) -> bytes:
    """Return the bytes that precede a serialised message of ``size`` bytes in a chunk."""
    secs, nsecs = divmod(t_ns, SECOND_NS)
    _, head, middle = _PYTHON
    return _MESSAGE_HEAD.pack(head, number, middle, secs, nsecs, size)
