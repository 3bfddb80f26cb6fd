# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages inside the content of one chunk."""

from __future__ import annotations

from struct import Struct
from typing import List, NamedTuple

from cassandra_ros.bag import format as bagformat
from cassandra_ros.errors import BagError
from cassandra_ros.keys import MAX_NS


class ChunkMessage(NamedTuple):
    """Place of one message in the content of its chunk."""

    file_id: int
    """Number of the connection as the file has it."""
    t_ns: int
    start: int
    """The serialised message is content[start:stop]."""
    stop: int


# Both known writers of bags give the header of a message always the same layout, so one unpack
# and two comparisons read it; every other order of the fields is read field by field.
_CPP = Struct("<13sI17sIII")
_CPP_HEAD = b"\x26\0\0\0\x09\0\0\0conn="
_CPP_MIDDLE = b"\x04\0\0\0op=\x02\x0d\0\0\0time="
_PYTHON = Struct("<21sI9sIII")
_PYTHON_HEAD = b"\x26\0\0\0\x04\0\0\0op=\x02\x09\0\0\0conn="
_PYTHON_MIDDLE = b"\x0d\0\0\0time="
_FIXED_BYTES = _CPP.size
_MESSAGE_HEAD = Struct(f"<{len(_PYTHON_HEAD)}sI{len(_PYTHON_MIDDLE)}sIII")


def findMessages(content: bytes, where: str) -> List[ChunkMessage]:
    """List the messages of a chunk in their order.

    Args:
        content: The unpacked content of the chunk.
        where: Subject of the error's sentence.

    Raises:
        BagError: The records do not fill the content exactly, or one is damaged.
    """
    found: List[ChunkMessage] = []
    position, end = 0, len(content)
    last_fixed = end - _FIXED_BYTES
    read_cpp, read_python = _CPP.unpack_from, _PYTHON.unpack_from
    while position < end:
        if position <= last_fixed:
            head, file_id, middle, secs, nsecs, size = read_cpp(content, position)
            known = head == _CPP_HEAD and middle == _CPP_MIDDLE
            if not known:
                head, file_id, middle, secs, nsecs, size = read_python(content, position)
                known = head == _PYTHON_HEAD and middle == _PYTHON_MIDDLE
            if known:
                start = position + _FIXED_BYTES
                t_ns = secs * 1_000_000_000 + nsecs
                stop = start + size
                if stop > end or t_ns > MAX_NS:
                    raise BagError(f"{where} is damaged: a message at byte {position} of it")
                found.append(ChunkMessage(file_id, t_ns, start, stop))
                position = stop
                continue
        position = _otherRecord(content, position, where, found)
    return found


def _otherRecord(content: bytes, position: int, where: str, found: List[ChunkMessage]) -> int:
    """Read a connection record, or a message in another layout; return where it ends."""
    place = f"{where} (byte {position} of its content)"
    header_start = position + 4
    if header_start > len(content):
        raise BagError(f"{place} is damaged: a record runs over the end")
    data_size_at = header_start + int(bagformat.U32.unpack_from(content, position)[0])
    start = data_size_at + 4
    if start > len(content):
        raise BagError(f"{place} is damaged: a record runs over the end")
    stop = start + int(bagformat.U32.unpack_from(content, data_size_at)[0])
    if stop > len(content):
        raise BagError(f"{place} is damaged: a record runs over the end")
    fields = bagformat.splitFields(content[header_start:data_size_at], place)
    op = bagformat.number(fields, b"op", bagformat.U8, place)
    if op == bagformat.OP_MESSAGE:
        file_id = bagformat.number(fields, b"conn", bagformat.U32, place)
        t_ns = bagformat.timeNs(fields, b"time", place)
        found.append(ChunkMessage(file_id, t_ns, start, stop))
    elif op != bagformat.OP_CONNECTION:
        # The index at the end holds the connections; their copies in the chunks repeat it.
        raise BagError(f"{place} is damaged: a record of kind {op}")
    return stop


def messageHead(number: int, t_ns: int, size: int) -> bytes:
    """Build what stands before the bytes of a message in a chunk."""
    secs, nsecs = divmod(t_ns, 1_000_000_000)
    return _MESSAGE_HEAD.pack(_PYTHON_HEAD, number, _PYTHON_MIDDLE, secs, nsecs, size)
