# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of messages of any size to rows and back, if only texts and arrays of numbers vary.

Such a message consists of a few segments: bytes of fixed size, then a text or array with the same
bytes in message and row. The fixed bytes of all messages are permuted together, the rest is copied.
"""

from __future__ import annotations

import struct
from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.messages.wire.layout import Segment
from cassandra_ros.messages.wire.message_stacks import ByteArray, Int64Array, windows
from cassandra_ros.messages.wire.permutation import NoPermutation, Permutation

_Good = NDArray[np.bool_]


class _Segment(NamedTuple):
    """One segment: its fixed bytes, and the variable field after them."""

    permutation: Optional[Permutation]
    """Permutation of the fixed bytes; None if there are no fixed bytes."""
    unit: int
    """Size of an element of the variable field, bytes; 0 = no variable field."""
    is_text: bool

    def convert(self, data: ByteArray, ats: Int64Array, back: bool) -> Tuple[ByteArray, _Good, int]:
        """Permute the fixed bytes at some offsets; return also the number of bytes read at each."""
        if self.permutation is None:
            return np.zeros((len(ats), 0), np.uint8), np.ones(len(ats), np.bool_), 0
        size = self.permutation.row_size if back else self.permutation.wire_size
        found = windows(data, size)[ats]
        return (*(self.permutation.wires if back else self.permutation.rows)(found), size)

    def size(self, back: bool) -> int:
        """Return the number of bytes before the variable data, length prefix included."""
        fixed = self.permutation
        own = 0 if fixed is None else fixed.row_size if back else fixed.wire_size
        return own + (4 if self.unit else 0)


class SegmentPermuter:
    """Converts messages of one type to rows, and rows to messages.

    Raises:
        NoPermutation: Fields other than texts and arrays of numbers vary in size.
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        self._segments: List[_Segment] = []
        for fixed, tail in segments:
            if tail is not None and (tail.kind not in ("text", "bytes") or not tail.has_count):
                raise NoPermutation
            size = sum(struct.calcsize("<" + each.little) for each in fixed)
            permutation = Permutation((Segment(fixed, None),), bytes(size)) if fixed else None
            unit = 0 if tail is None else tail.unit
            self._segments.append(
                _Segment(permutation, unit, tail is not None and tail.kind == "text")
            )
        if not self._segments:
            raise NoPermutation

    def rows(self, wires: Sequence[bytes]) -> List[Optional[bytes]]:
        """Return for each message its columns, each after its size.

        None: convert it by ``walk``.
        """
        sizes = np.fromiter(map(len, wires), np.int64, len(wires))
        ends = np.cumsum(sizes)
        return self._convert(b"".join(wires), ends - sizes, ends, back=False)

    def wires(self, data: bytes, starts: Int64Array, ends: Int64Array) -> List[Optional[bytes]]:
        """Return the messages of rows from ``starts`` to ``ends``; None for a malformed row."""
        return self._convert(data, starts, ends, back=True)

    def _convert(
        self, data: bytes, starts: Int64Array, ends: Int64Array, back: bool
    ) -> List[Optional[bytes]]:
        every, ats, good = np.frombuffer(data, np.uint8), starts, np.ones(len(starts), np.bool_)
        parts: List[List[bytes]] = []
        for segment in self._segments:
            good &= ats + segment.size(back) <= ends
            if not good.any():
                return [None] * len(starts)
            # A malformed message is not read further, but keeps its index.
            ats = np.where(good, ats, ats[good][0])
            converted, fine, size = segment.convert(every, ats, back)
            good &= fine
            ats = ats + size
            if segment.unit:
                prefixes, sizes, fine = _lengths(every, ats, segment.unit, back)
                good &= fine
                converted = np.concatenate((converted, prefixes), axis=1)
                froms = ats + 4
                ats = froms + sizes
            if converted.shape[1]:
                parts.append(split_rows(converted))
            if segment.unit:
                places = zip(froms.tolist(), np.minimum(ats, ends).tolist())
                parts.append([data[at:to] for at, to in places])
                if segment.is_text and not back:
                    good &= np.fromiter(map(bytes.isascii, parts[-1]), np.bool_, len(good))
        good &= ats == ends
        found = map(b"".join, zip(*parts))
        return [each if fine else None for each, fine in zip(found, good.tolist())]


def _lengths(
    data: ByteArray, ats: Int64Array, unit: int, back: bool
) -> Tuple[ByteArray, Int64Array, _Good]:
    """Read the length prefixes at some offsets; return them converted, and the sizes in bytes.

    On the wire a length prefix counts elements, in a row bytes.
    """
    found = np.ascontiguousarray(windows(data, 4)[ats])
    if back:
        sizes = found.view(">i4")[:, 0].astype(np.int64)
        good = (sizes >= 0) & (sizes % unit == 0)
        prefixes = (sizes // unit).astype("<u4")
    else:
        sizes = found.view("<u4")[:, 0].astype(np.int64) * unit
        good = sizes < 2**31
        prefixes = sizes.astype(">u4")
    return prefixes.view(np.uint8).reshape(len(ats), 4), sizes, good


def split_rows(rows: ByteArray) -> List[bytes]:
    """Return the bytes of each row as a list."""
    size, data = rows.shape[1], rows.tobytes()
    return [data[at : at + size] for at in range(0, len(data), size)]
