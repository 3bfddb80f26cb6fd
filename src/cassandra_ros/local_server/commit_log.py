# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The end of the commit log of a node that was killed.

The segments of cassandra.yaml are written section by section. A section begins with the
position of the next one and a CRC of that, and its messages are acknowledged after all of it was
written and synced. A SIGKILL or a power cut in the middle of a write leaves a section whose end is
missing, and Cassandra refuses to start: "bad position but valid CRC".
"""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_NAME = re.compile(r"CommitLog-\d+-(\d+)\.log\Z")
_HEADER = struct.Struct(">iqH")  # version, id, length of the parameters; then these and a CRC
_CRC_BYTES = 4
_MARKER = struct.Struct(">II")  # position of the next section, CRC
_CRC_INPUT = struct.Struct(">IIi")  # lower and upper half of the id, position


def cut_torn_end(folder: Path) -> str:
    """Cut off a section that was not written whole; return a note about that, or ''.

    Only the last section of the whole log is cut off: one with another after it was written whole
    once, and Cassandra tells what happened to it. No server may be using the folder.

    Raises:
        OSError: A file cannot be read or written.
    """
    segments = {int(m[1]): path for path in folder.glob("*.log") if (m := _NAME.match(path.name))}
    for number in sorted(segments, reverse=True):
        path = segments[number]
        with path.open("r+b") as segment:
            size = path.stat().st_size
            sections = _sections(segment, size)
            if not sections:
                continue  # it was made in advance
            position, end = sections[-1]
            if end <= size:
                return ""
            segment.truncate(position)
            return (
                f"cut {size - position} bytes off the end of {path}: a write that was not complete "
                "when the node was killed, and so was not acknowledged"
            )
    return ""


def _sections(segment: BinaryIO, size: int) -> list[tuple[int, int]]:
    """Return for each section of a segment its position, and that of the next one.

    The last one may be after the end of the file. A segment that was made in advance has none.
    """
    head = segment.read(_HEADER.size)
    if len(head) < _HEADER.size:
        return []
    _, number, length = _HEADER.unpack(head)
    position = _HEADER.size + length + _CRC_BYTES
    sections = []
    while position + _MARKER.size <= size:
        segment.seek(position)
        end, crc = _MARKER.unpack(segment.read(_MARKER.size))
        crc_input = _CRC_INPUT.pack(number & 0xFFFFFFFF, number >> 32, position)
        if crc != zlib.crc32(crc_input) or end <= position:
            break
        sections.append((position, end))
        position = end
    return sections
