# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The MCAP file format (https://mcap.dev/spec): records, and the messages in a chunk.

The library mcap parses the records that describe the file. We read messages and indexes ourselves,
because the library's StreamReader makes an object of each message and each index entry, and reads
the whole file to list its chunks. For 400,000 messages it needed 2.1 s of processor time, this
module 0.75 s including the hash; to open the file 0.35 s instead of 0.015 s.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from contextlib import suppress
from io import BytesIO
from struct import Struct
from typing import BinaryIO, Iterator, NamedTuple, TypeVar

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, Metadata, Schema, Statistics
from numpy.lib.stride_tricks import sliding_window_view

from cassandra_ros.errors import BagError, BagTooLarge
from cassandra_ros.files.bag.format import (
    COUNTED_AT_ONCE,
    MIN_AT_ONCE,
    NUMPY_MESSAGES_AT_ONCE,
    CountRecords,
    Longs,
    uncounted,
)
from cassandra_ros.keys import MAX_NS

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""
COMPRESSIONS = ("none", "lz4", "zstd")
RECORD = Struct("<BQ")
"""Kind of a record, and number of bytes that follow."""
CHUNK = Struct("<QQQII")
"""Head of a chunk: first and last time, size, checksum, length of the name of its compression. The
name follows, then the size of the compressed records."""
MESSAGE = Struct("<BQHIQQ")
"""Record of a message before its bytes: kind, length, channel, sequence, log and publish time."""
_HEAD = np.dtype(
    [
        ("kind", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("time", "<u8"),
        ("sent", "<u8"),
    ]
)
"""The fields of MESSAGE, for numpy."""
INDEX = Struct("<HI")
"""Head of a message index: channel, and number of bytes that follow."""
ENTRY_BYTES = 16
"""Size of an entry of a message index, bytes: time, and offset of the message in the chunk."""
_MAX_NAME_BYTES = 64
"""Maximum size of the name of a compression, bytes. A longer one is damage."""
CHUNK_SIZE_BYTES = 8
"""Size of the field with the size of the compressed records of a chunk, bytes."""
_CRC_BYTES = 4
_FOOTER_BYTES = 20
_READ_BYTES = 1 << 20
"""Number of bytes of the summary that are read at once."""
_HALF = 2**63
"""Half of the range of the times in the format, ns."""
MAX_DESCRIPTION_BYTES = 1 << 24
"""Maximum size of a record that describes the file (header, schema, channel, statistics), bytes.
Real ones have at most some 100 KB: the definition of a message."""
Parsed = TypeVar("Parsed", Channel, Footer, Header, Metadata, Schema, Statistics)


TOO_LATE = -1
"""Time of a message whose log_time lies after the last time of ROS 1, in the year 2106."""
CUT = 0
"""Kind of a McapRecord that marks the end of a file that is cut short. No real record has it."""


class McapRecord(NamedTuple):
    """The position of a record in a file, or in the unpacked content of a chunk."""

    kind: int
    """Opcode, or CUT."""
    start: int
    """Offset of the first byte after kind and length."""
    stop: int
    """Offset of the first byte after the record."""


class ChunkHead(NamedTuple):
    """The fields before the compressed records of a chunk."""

    start_ns: int
    end_ns: int
    """First and last time in the chunk, as the file states them, ns."""
    size: int
    """Size of the unpacked records, as the file states it, bytes."""
    crc: int
    """Checksum of the unpacked records; 0 = the writer did not compute one."""
    compression: str


class Messages(NamedTuple):
    """The messages of a chunk in the order of the chunk: one array element per message."""

    channels: Longs
    """Channel id of each message."""
    sequences: Longs
    """Sequence number of each message."""
    times: Longs
    """log_time of each message, ns; TOO_LATE = after the last time of ROS 1."""
    delays: Longs
    """publish_time minus log_time of each message, ns; modulo 2**64, so every value fits."""
    starts: Longs
    """Offset at which the serialised message begins, bytes."""
    stops: Longs
    """Offset at which the serialised message ends (not included), bytes."""

    def in_time(self) -> Messages:
        """Return the messages without those that are too late for ROS 1."""
        late = self.times == TOO_LATE
        return Messages(*(column[~late] for column in self)) if late.any() else self


def walk(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file, but not those inside chunks.

    The caller may move the file position between two records. The last record is the footer. If the
    file is cut short or still being written, it is a record of kind CUT, which reaches from the end
    of the last complete record to the end of the file.
    """
    file_bytes = os.fstat(file.fileno()).st_size
    position, kind = len(MAGIC), 0
    while kind != Opcode.FOOTER:
        file.seek(position)
        head = file.read(RECORD.size)
        kind, length = RECORD.unpack(head) if len(head) == RECORD.size else (CUT, 0)
        start = position + RECORD.size
        if kind == CUT or start + length > file_bytes:
            yield McapRecord(CUT, position, file_bytes)
            return
        position = start + length
        yield McapRecord(kind, start, position)
    file.seek(position)
    if file.read(len(MAGIC)) != MAGIC:
        yield McapRecord(CUT, position, file_bytes)


def parse(kind: type[Parsed], raw: bytes, where: str) -> Parsed:
    """Parse a record by the library mcap.

    Raises:
        BagError: The record is damaged.
    """
    try:
        record: Parsed = kind.read(ReadDataStream(BytesIO(raw)))
        return record
    except (McapError, struct.error, ValueError, OverflowError, MemoryError) as exc:
        why = str(exc) or "it ends too early"
        raise BagError(f"{where} is damaged: {kind.__name__.lower()} record: {why}") from exc


def check_summary(file: BinaryIO, footer: McapRecord, path: str) -> None:
    """Check the summary section of a file with the crc in its footer, if there is one.

    Raises:
        BagError: The crc is wrong.
    """
    file.seek(footer.start)
    fields = parse(Footer, file.read(_FOOTER_BYTES), path)
    if not fields.summary_crc:
        return
    # A damaged summary_start may be larger than the file, or too large for seek.
    file.seek(min(fields.summary_start or footer.start - RECORD.size, footer.stop))
    crc, remaining = 0, footer.start + _FOOTER_BYTES - _CRC_BYTES - file.tell()
    while remaining > 0:
        data = file.read(min(remaining, _READ_BYTES))
        crc, remaining = zlib.crc32(data, crc), remaining - len(data)
    if crc != fields.summary_crc:
        raise BagError(
            f"{path} is damaged: the crc of its summary is wrong; write the file anew with: "
            f"mcap recover {path} -o RECOVERED.mcap"
        )


def read_chunk_head(
    file: BinaryIO, record: McapRecord, where: str, cut: bool = False
) -> tuple[ChunkHead, McapRecord]:
    """Read the fields before the compressed records of a chunk.

    Args:
        cut: The file ends inside the chunk.

    Returns:
        The fields, and the position of the compressed records.

    Raises:
        BagError: The fields are damaged.
    """
    file.seek(record.start)
    raw = file.read(CHUNK.size)
    if len(raw) == CHUNK.size:
        start_ns, end_ns, size, crc, name_bytes = CHUNK.unpack(raw)
        rest = file.read(min(name_bytes, _MAX_NAME_BYTES) + CHUNK_SIZE_BYTES)
        name, length = rest[:name_bytes], int.from_bytes(rest[name_bytes:], "little")
        start = record.start + CHUNK.size + name_bytes + CHUNK_SIZE_BYTES
        # Later versions of the format may add fields after the last one.
        fits = (start + length >= record.stop) if cut else (start + length <= record.stop)
        is_whole = len(rest) == name_bytes + CHUNK_SIZE_BYTES
        if is_whole and fits and start_ns <= end_ns:
            compression = name.decode("ascii", "replace") or "none"
            head = ChunkHead(start_ns, end_ns, size, crc, compression)
            return head, McapRecord(record.kind, start, min(start + length, record.stop))
    raise BagError(f"{where} is damaged: the head of the chunk at byte {record.start}")


def count_of_index(file: BinaryIO, record: McapRecord, where: str) -> tuple[int, int]:
    """Return the channel id of a message index and the number of messages that it lists.

    Raises:
        BagError: The index is damaged.
    """
    file.seek(record.start)
    raw = file.read(INDEX.size)
    if len(raw) == INDEX.size:
        channel, index_bytes = INDEX.unpack(raw)
        if record.start + INDEX.size + index_bytes <= record.stop:
            return channel, index_bytes // ENTRY_BYTES
    raise BagError(f"{where} is damaged: the message index at byte {record.start}")


def decompress(head: ChunkHead, data: bytes, where: str) -> bytes:
    """Return the unpacked records of a chunk, checked with their crc.

    At most ``head.size`` bytes are unpacked. The caller has checked this size with an Allowance.

    Raises:
        BagError: The chunk is damaged, or its compression is unknown.
    """
    try:
        content = _unpack(head, data)
    except KeyError:
        raise BagError(
            f"{where} is compressed with {head.compression!r}; known are {', '.join(COMPRESSIONS)}"
        ) from None
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError, MemoryError) as exc:
        raise BagError(f"{where} is damaged: its compressed data is not valid ({exc})") from exc
    if len(content) != head.size:
        raise BagError(f"{where} is damaged: it does not unpack to {head.size} bytes")
    if head.crc and zlib.crc32(content) != head.crc:
        raise BagError(f"{where} is damaged: its crc is wrong")
    return content


def unpack_part(head: ChunkHead, data: bytes, count: CountRecords) -> bytes:
    """Return the complete records that can be unpacked at the beginning of a damaged chunk.

    The caller has checked ``head.size`` with an Allowance. No more records are returned than
    ``count`` permits. Return b'' if the chunk can be unpacked to its end and its crc is wrong.
    """
    content, end = b"", 0
    damage = (BagError, KeyError, zstandard.ZstdError, RuntimeError, EOFError, MemoryError)
    with suppress(*damage):
        if head.compression == "zstd":
            content = zstandard.ZstdDecompressor().stream_reader(data).read(head.size)
        else:
            content = _unpack(head, data)
        if head.crc and len(content) == head.size and zlib.crc32(content) != head.crc:
            return b""  # it is damaged at an unknown position
        for record in records_of(content, ""):
            count(1)
            end = record.stop
    return content[:end]


def _unpack(head: ChunkHead, data: bytes) -> bytes:
    """Return the unpacked records of a chunk, or content of another size if ``head.size`` is wrong.

    Raises:
        KeyError: The compression is unknown. Damaged data raise the errors of the libraries.
    """
    if head.compression == "none":
        return data
    if head.compression == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        # One byte more, so that the caller sees that there is more.
        return bytes(unpacker.decompress(data, max_length=head.size + 1))
    if head.compression == "zstd":
        if zstandard.frame_content_size(data) not in (-1, head.size):
            return b""  # the decompressor would ignore max_output_size
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=head.size)
    raise KeyError(head.compression)


def records_of(content: bytes, where: str) -> Iterator[McapRecord]:
    """Yield the records in some bytes.

    Raises:
        BagError: A record runs over the end.
    """
    position, end = 0, len(content)
    while position < end:
        record = record_at(content, where, position)
        position = record.stop
        yield record


def record_at(content: bytes, where: str, position: int) -> McapRecord:
    """Return the record at an offset of some bytes; raises BagError if it runs over the end."""
    start, end = position + RECORD.size, len(content)
    kind, length = RECORD.unpack_from(content, position) if start <= end else (0, end)
    if start + length > end:
        raise BagError(f"{where} is damaged: a record at byte {position} of it runs over")
    return McapRecord(kind, start, start + length)


def offsets_of_indexes(raw: bytes) -> Longs | None:
    """Return the offsets of message records that message indexes list, ascending.

    Return None if an index is damaged. The messages can be found without it.

    Args:
        raw: All message indexes of a chunk, with their kinds and lengths.
    """
    offsets_by_index: list[Longs] = [np.zeros(0, np.int64)]
    with suppress(BagError, ValueError, struct.error):
        for record in records_of(raw, ""):
            _, index_bytes = INDEX.unpack_from(raw, record.start)
            count = index_bytes // ENTRY_BYTES * 2
            entries = np.frombuffer(raw, "<u8", count, record.start + INDEX.size)
            offsets_by_index.append(entries[1::2].astype(np.int64))
        return np.sort(np.concatenate(offsets_by_index))
    return None


def _messages_at(
    content: bytes, where: str, offsets: Longs, count: CountRecords
) -> Messages | None:
    """Read the messages at these offsets, at once by numpy.

    Return None if there is no message at one of them, if there are other messages in the chunk, or
    if a time lies after MAX_NS: then the caller reads the records one by one.

    Args:
        offsets: Ascending, at least one.
        count: Counts the other records; the caller counts the messages.
    """
    if offsets[0] < 0 or offsets[-1] > len(content) - MESSAGE.size:
        return None
    rows = sliding_window_view(np.frombuffer(content, np.uint8), MESSAGE.size)[offsets]
    heads = rows.view(_HEAD)[:, 0]
    most = max(heads["time"].max(), heads["sent"].max())
    if (heads["kind"] != Opcode.MESSAGE).any() or most > MAX_NS or heads["length"].max() > 2**32:
        return None
    stops = offsets + RECORD.size + heads["length"].astype(np.int64)
    starts = offsets + MESSAGE.size
    # Gap n lies before message n, the last one before the end of the content.
    begins, ends = np.append(offsets, len(content)), np.insert(stops, 0, 0)
    if (stops < starts).any() or (begins < ends).any():
        return None
    gaps = np.flatnonzero(begins != ends).tolist()
    contents_of_gaps = (content[ends[gap] : begins[gap]] for gap in gaps)
    if not all(_without_message(gap, where, count) for gap in contents_of_gaps):
        return None
    channels, sequences = heads["channel"].astype(np.int64), heads["sequence"].astype(np.int64)
    times, sent = heads["time"].astype(np.int64), heads["sent"].astype(np.int64)
    return Messages(channels, sequences, times, sent - times, starts, stops)


def _without_message(content: bytes, where: str, count: CountRecords) -> bool:
    """Return whether some bytes consist of records, and none of these is a message.

    Raises:
        BagTooLarge: ``count`` refuses their number.
    """
    try:
        for record in records_of(content, where):
            count(1)
            if record.kind == Opcode.MESSAGE:
                return False
    except BagTooLarge:
        raise
    except BagError:
        return False
    return True


def find_messages(
    content: bytes, where: str, offsets: Longs | None = None, count: CountRecords = uncounted
) -> Messages:
    """List the messages in the unpacked records of a chunk.

    Args:
        offsets: Ascending offsets of the message records that the index states. If they are all
            messages of the content, these are read at once, which is faster. None = not known.
        count: Counts the records while they are read.

    Raises:
        BagError: A record is damaged, or ``count`` refuses their number.
    """
    if offsets is not None and MIN_AT_ONCE <= len(offsets) <= NUMPY_MESSAGES_AT_ONCE:
        indexed = _messages_at(content, where, offsets, count)
        if indexed is not None:
            count(len(offsets))
            return indexed
    numbers = array("q")  # six numbers for each message
    position, end, last = 0, len(content), len(content) - MESSAGE.size
    read, size = MESSAGE.unpack_from, MESSAGE.size
    records = 0
    while position < end:
        records += 1
        if records == COUNTED_AT_ONCE:
            count(records)
            records = 0
        if position > last or content[position] != Opcode.MESSAGE:
            # The caller has read schemas and channels.
            position = record_at(content, where, position).stop
            continue
        _, length, channel, sequence, t_ns, sent_ns = read(content, position)
        # A length that is too small for the fields of a message is damage, too.
        stop = position + RECORD.size + length
        if stop > end or stop < position + size:
            raise BagError(f"{where} is damaged: a message at byte {position} of it")
        delay_ns = (sent_ns - t_ns + _HALF) % (2 * _HALF) - _HALF
        time_ns = t_ns if t_ns <= MAX_NS else TOO_LATE
        numbers.extend((channel, sequence, time_ns, delay_ns, position + size, stop))
        position = stop
    count(records)
    columns = len(Messages._fields)
    if not numbers:
        return Messages(*np.zeros((columns, 0), np.int64))
    return Messages(*np.frombuffer(numbers, np.int64).reshape(-1, columns).T)
