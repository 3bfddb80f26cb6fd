# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of many messages of one layout at once: a permutation of their bytes.

Where the lengths of all strings and arrays are the same, each byte of a row is a byte of the
message or a constant; only times are computed. What ``walk`` does field by field one ``take`` of
numpy then does for all messages of a batch, and its inverse gives the messages of a page.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import Fixed, Segment, Tail, layout
from cassandra_ros.messages.wire.stacked import Bytes, Places, Stack, by_size, stacker

MIN_ROWS = 8
"""Of fewer messages of a layout each is quicker walked by itself, ..."""
MAX_BYTES = 2048
"""... and larger ones: most of those is an array, which is copied as quickly."""
MAX_KEPT = 64
"""Permutations of a type that are kept, and ..."""
MAX_PIECES = 4096
"""... values in the columns of a message that is permuted: each element of a list is one."""
_BYTE_VALUES = np.arange(256, dtype=np.uint8)
_length = struct.Struct("<I").unpack_from
_pack_size = struct.Struct(">i").pack


class _Stamp(NamedTuple):
    """A time or duration."""

    at: int
    """In the message."""
    to: int
    """In the row."""
    code: str


class _Value(NamedTuple):
    """A value of a column, or of an element of a list."""

    size: int
    runs: Tuple[Tuple[int, int], ...]
    """Where its bytes lie in the message, and how many; -1 - value for a constant."""
    stamp: Optional[Tuple[int, str]] = None
    """Where a time lies, and the code of its halves; it is computed."""


class _Unfit(ValueError):
    """The layout has no permutation."""


class Permutation:
    """Turns messages of the layout of one of them into rows: each column's size, then its bytes."""

    def __init__(self, segments: Sequence[Segment], wire: bytes) -> None:
        self._wire = wire
        self._runs: List[Tuple[int, int]] = []
        """Of the bytes of a row: from where to where in the message and the constants behind it."""
        self._size = self._pieces = 0
        self._stamps: List[_Stamp] = []
        self._bools: List[int] = []
        self._texts: List[Tuple[int, int]] = []
        at = 0
        for segment in segments:
            at = self._segment(segment, at, None)
        if at != len(wire) or not self._runs:
            raise _Unfit
        self._from = np.concatenate([np.arange(first, last) for first, last in self._runs])
        times = [stamp.at for stamp in self._stamps]
        self._time_at: Places = np.array(times, np.int64)[:, None] + np.arange(8)
        self._bool_at: Places = np.array(self._bools, np.int64)
        texts = [np.arange(at, end) for at, end in self._texts]
        self._text_at: Places = np.concatenate(texts) if texts else np.zeros(0, np.int64)
        del self._wire, self._runs, self._bools, self._texts

    # ---------------------------------------------------------------- messages to rows

    def rows(self, wires: Bytes) -> Tuple[Bytes, NDArray[np.bool_]]:
        """Return the rows of messages, (messages, bytes), and which of them are exact."""
        count, size = wires.shape
        good = np.ones(count, np.bool_)
        if len(self._bool_at):
            good &= (wires[:, self._bool_at] <= 1).all(axis=1)
        if len(self._text_at):
            good &= (wires[:, self._text_at] < 128).all(axis=1)
        constants = np.broadcast_to(_BYTE_VALUES, (count, 256))
        rows = np.concatenate((wires, constants), axis=1).take(self._from, axis=1)
        if self._stamps:
            raw = np.ascontiguousarray(wires[:, self._time_at])
            for n, (_, to, code) in enumerate(self._stamps):
                parts = raw[:, n].view(code)
                secs, nsecs = parts[:, 0].astype(np.int64), parts[:, 1].astype(np.int64)
                good &= (nsecs >= 0) & (nsecs < SECOND_NS)
                ns = (secs * SECOND_NS + nsecs).astype(">i8")
                rows[:, to : to + 8] = ns.view(np.uint8).reshape(count, 8)
        return rows, good

    # ---------------------------------------------------------------- layout

    def _segment(self, segment: Segment, at: int, out: Optional[List[_Value]]) -> int:
        """Note the columns of a segment, or list their values; return where it ends."""
        for fixed in segment.fixed:
            value = self._fixed(fixed, at)
            at += struct.calcsize("<" + fixed.little)
            if out is None:
                self._column(value)
            else:
                out.append(value)
        if segment.tail is not None:
            at = self._tail(segment.tail, at, out)
        return at

    def _fixed(self, fixed: Fixed, at: int) -> _Value:
        size = struct.calcsize("<" + fixed.little)
        if fixed.special == "uint64":
            raise _Unfit  # as many bytes as its value needs
        if fixed.special in ("time", "duration"):
            code = "<u4" if fixed.special == "time" else "<i4"
            return _Value(8, (), stamp=(at, code))
        if fixed.special == "bool":
            self._bools.append(at)
        if fixed.little[-1] == "s":
            return _Value(size, ((at, size),))
        zeros = ((-1, 1),) * (fixed.cql_size - size)
        return _Value(fixed.cql_size, (*zeros, *((at + size - 1 - n, 1) for n in range(size))))

    def _tail(self, tail: Tail, at: int, out: Optional[List[_Value]]) -> int:
        count, start = tail.length, at
        if tail.has_count:
            (count,) = _length(self._wire, at)
            at += 4
        if tail.kind == "elements":
            if out is not None:
                raise _Unfit
            return self._elements(tail, count or 0, at)
        if tail.kind == "texts":
            values = []
            for _ in range(count or 0):
                (size,) = _length(self._wire, at)
                values.append(self._text(at + 4, size))
                at += 4 + size
            self._list(values)
            return at
        if tail.kind == "wire":
            at = tail.skip(self._wire, start)
            value = _Value(at - start, ((start, at - start),))
        elif tail.kind == "text":
            value = self._text(at, count or 0)
            at += value.size
        else:
            value = _Value((count or 0) * tail.unit, ((at, (count or 0) * tail.unit),))
            at += value.size
        if out is None:
            self._column(value)
        else:
            out.append(value)
        return at

    def _text(self, at: int, size: int) -> _Value:
        if at + size > len(self._wire):
            raise _Unfit
        self._texts.append((at, at + size))
        return _Value(size, ((at, size),))

    def _elements(self, tail: Tail, count: int, at: int) -> int:
        if count * len(tail.columns) > MAX_PIECES:
            raise _Unfit
        elements: List[List[_Value]] = []
        for _ in range(count):
            values: List[_Value] = []
            for segment in tail.element:
                at = self._segment(segment, at, values)
            elements.append(values)
        for n in range(len(tail.columns)):
            self._list([values[n] for values in elements])
        return at

    # ---------------------------------------------------------------- rows

    def _list(self, values: Sequence[_Value]) -> None:
        size = 4 + sum(4 + value.size for value in values)
        self._constant(_pack_size(size) + _pack_size(len(values)))
        for value in values:
            self._column(value)

    def _column(self, value: _Value) -> None:
        self._pieces += 1
        if self._pieces > MAX_PIECES:
            raise _Unfit
        self._constant(_pack_size(value.size))
        if value.stamp is not None:
            self._stamps.append(_Stamp(value.stamp[0], self._size, value.stamp[1]))
            self._constant(bytes(8))  # it is computed
        for first, length in value.runs:
            self._add(first, length)

    def _constant(self, data: bytes) -> None:
        for byte in data:
            self._add(-1 - byte, 1)

    def _add(self, first: int, length: int) -> None:
        if first < 0:
            first = len(self._wire) - 1 - first
        self._runs.append((first, first + length))
        self._size += length


class Permuter:
    """Gives the columns of messages of one type, of those that share their layout with others."""

    def __init__(self, definition: Definition) -> None:
        self._stacker = stacker(definition)
        self._segments = layout(definition.type, definition.specs)
        self._kept: Dict[Tuple[int, bytes], Optional[Permutation]] = {}

    def rows(self, wires: Sequence[bytes]) -> List[Optional[bytes]]:
        """Return of each message its columns, each one's size before it; None: it is to be walked.

        So are all that walk does not find to be exact.
        """
        found: List[Optional[bytes]] = [None] * len(wires)
        for members, planes in by_size(wires):
            if len(members) < MIN_ROWS or len(planes) > MAX_BYTES:
                continue
            for stack in self._stacker.stacks(planes, members)[0]:
                permutation = self._permutation(stack)
                if permutation is None or len(stack.members) < MIN_ROWS:
                    continue
                rows, good = permutation.rows(np.ascontiguousarray(stack.planes.T))
                size, data = rows.shape[1], rows.tobytes()
                for n, (at, fine) in enumerate(zip(stack.members.tolist(), good.tolist())):
                    if fine:
                        found[at] = data[n * size : (n + 1) * size]
        return found

    def _permutation(self, stack: Stack) -> Optional[Permutation]:
        key = len(stack.planes), stack.layout.lengths.tobytes()
        kept = self._kept  # other threads may begin a new one meanwhile
        if key in kept:
            return kept[key]
        try:
            made: Optional[Permutation] = Permutation(self._segments, stack.planes[:, 0].tobytes())
        except (_Unfit, struct.error):
            made = None
        if len(kept) >= MAX_KEPT:
            kept = self._kept = {}
        kept[key] = made
        return made


permuter = lru_cache(maxsize=512)(Permuter)
"""Returns the permuter of a definition, made once per type and md5."""
