# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of many messages of one layout to columns at once, as a permutation of their bytes.

If all strings and arrays have the same lengths, each byte of a row is a byte of the message or a
constant; only times are computed. One numpy ``take`` then does for a batch of messages what
``walk`` does field by field, and the inverse gives the messages of a page of rows.
"""

from __future__ import annotations

import struct
from typing import NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.wire.layout import FixedField, Segment, VariableField
from cassandra_ros.messages.wire.message_stacks import ByteArray, Int64Array

MAX_VALUES = 4096
"""Maximum number of values in the columns of a permuted message; a list element is one value."""
_BYTE_VALUES = np.arange(256, dtype=np.uint8)
_length = struct.Struct("<I").unpack_from
_pack_size = struct.Struct(">i").pack


class _TimeField(NamedTuple):
    """A time or duration field."""

    at: int
    """Offset in the message, bytes."""
    to: int
    """Offset in the row, bytes."""
    code: str
    """numpy type of its halves."""


class _Value(NamedTuple):
    """A value of a column, or of an element of a list."""

    size: int
    """Size in the row, bytes."""
    runs: tuple[tuple[int, int], ...]
    """Offset and number of its bytes in the message, run by run; offset -1 - byte is a constant."""
    stamp: tuple[int, str] | None = None
    """Offset of a time in the message and numpy code of its halves; the value is computed."""


class NoPermutation(ValueError):
    """The layout has no permutation."""


class Permutation:
    """Converts messages with the layout of a given one to rows and back.

    A row is its columns, each after its size.

    Attributes:
        wire_size: Size of a message, bytes.
        row_size: Size of its row, bytes.

    Raises:
        NoPermutation: The layout has none.
        struct.error: The given message ends too early.
    """

    def __init__(self, segments: Sequence[Segment], wire: bytes) -> None:
        self._wire, self.wire_size = wire, len(wire)
        self._runs: list[tuple[int, int]] = []
        """Ranges of source bytes of a row, in the message followed by the 256 byte constants."""
        self._size = self._value_count = 0
        """Size of the row so far, bytes, and number of its values."""
        self._stamps: list[_TimeField] = []
        self._bools: list[int] = []
        """Offsets of the bools in the message."""
        self._texts: list[tuple[int, int]] = []
        """Offsets of the texts in the message, and those after them."""
        at = 0
        for segment in segments:
            at = self._segment(segment, at, None)
        if at != len(wire) or not self._runs:
            raise NoPermutation
        self._from = np.concatenate([np.arange(first, last) for first, last in self._runs])
        times = [stamp.at for stamp in self._stamps]
        self._time_at: Int64Array = np.array(times, np.int64)[:, None] + np.arange(8)
        self._bool_at: Int64Array = np.array(self._bools, np.int64)
        texts = [np.arange(at, end) for at, end in self._texts]
        self._text_at: Int64Array = np.concatenate(texts) if texts else np.zeros(0, np.int64)
        self.row_size = self._size
        self._invert()
        del self._wire, self._runs, self._bools, self._texts, self._size

    def rows(self, wires: ByteArray) -> tuple[ByteArray, NDArray[np.bool_]]:
        """Return the rows of messages, (messages, bytes), and which rows are exact."""
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

    def _invert(self) -> None:
        """Compute the offset in a row of each byte of the message, and the constants of rows."""
        size = self.wire_size
        constant = self._from >= size
        for stamp in self._stamps:
            constant[stamp.to : stamp.to + 8] = False
        self._constant_at = np.flatnonzero(constant)
        self._constants = (self._from[self._constant_at] - size).astype(np.uint8)
        varying = self._from < size
        self._back = np.zeros(size, np.int64)
        self._back[self._from[varying]] = np.flatnonzero(varying)
        lost = np.ones(size, np.bool_)  # bytes of length prefixes
        lost[self._from[varying]] = False
        lost[self._time_at.ravel()] = False
        self._lost = np.flatnonzero(lost)
        self._lengths = np.frombuffer(self._wire, np.uint8)[self._lost]

    def wires(self, rows: ByteArray) -> tuple[ByteArray, NDArray[np.bool_]]:
        """Return the messages of rows, (rows, bytes), and which rows have this layout."""
        constants = rows.take(self._constant_at, axis=1)
        good: NDArray[np.bool_] = np.equal(constants, self._constants).all(axis=1)
        wires = rows.take(self._back, axis=1)
        wires[:, self._lost] = self._lengths
        for at, to, code in self._stamps:
            ns = np.ascontiguousarray(rows[:, to : to + 8]).view(">i8")[:, 0].astype(np.int64)
            secs, limits = ns // SECOND_NS, np.iinfo(code)
            good &= (secs >= limits.min) & (secs <= limits.max)
            parts = np.stack((secs, ns - secs * SECOND_NS), axis=1).astype(code)
            wires[:, at : at + 8] = parts.view(np.uint8)
        return wires, good

    def _segment(self, segment: Segment, at: int, out: list[_Value] | None) -> int:
        """Add the columns of a segment, or append its values to ``out``.

        Return the offset after it.
        """
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

    def _fixed(self, fixed: FixedField, at: int) -> _Value:
        """Return the value of a field of fixed size; a row has the bytes of a number reversed."""
        size = struct.calcsize("<" + fixed.little)
        if fixed.special == "uint64":
            raise NoPermutation  # a varint has no fixed size
        if fixed.special in ("time", "duration"):
            code = "<u4" if fixed.special == "time" else "<i4"
            return _Value(8, (), stamp=(at, code))
        if fixed.special == "bool":
            self._bools.append(at)
        if fixed.little[-1] == "s":
            return _Value(size, ((at, size),))
        zeros = ((-1, 1),) * (fixed.cql_size - size)
        return _Value(fixed.cql_size, (*zeros, *((at + size - 1 - n, 1) for n in range(size))))

    def _tail(self, tail: VariableField, at: int, out: list[_Value] | None) -> int:
        """Add the columns of a variable field, as _segment; return the offset after it."""
        count, start = tail.length, at
        if tail.has_count:
            (count,) = _length(self._wire, at)
            at += 4
        if tail.kind == "elements":
            if out is not None:
                raise NoPermutation
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
        """Return the value of a text, which ``rows`` checks to be ASCII, so that it is UTF-8."""
        if at + size > len(self._wire):
            raise NoPermutation
        self._texts.append((at, at + size))
        return _Value(size, ((at, size),))

    def _elements(self, tail: VariableField, count: int, at: int) -> int:
        """Add the lists of an array of messages; return the offset after it."""
        if count * len(tail.columns) > MAX_VALUES:
            raise NoPermutation
        elements: list[list[_Value]] = []
        for _ in range(count):
            values: list[_Value] = []
            for segment in tail.element:
                at = self._segment(segment, at, values)
            elements.append(values)
        for n in range(len(tail.columns)):
            self._list([values[n] for values in elements])
        return at

    def _list(self, values: Sequence[_Value]) -> None:
        """Add a column that is a list."""
        size = 4 + sum(4 + value.size for value in values)
        self._constant(_pack_size(size) + _pack_size(len(values)))
        for value in values:
            self._column(value)

    def _column(self, value: _Value) -> None:
        """Add a value after its size: a column, or an element of a list."""
        self._value_count += 1
        if self._value_count > MAX_VALUES:
            raise NoPermutation
        self._constant(_pack_size(value.size))
        if value.stamp is not None:
            self._stamps.append(_TimeField(value.stamp[0], self._size, value.stamp[1]))
            self._constant(bytes(8))  # the time is computed
        for first, length in value.runs:
            self._add(first, length)

    def _constant(self, data: bytes) -> None:
        for byte in data:
            self._add(-1 - byte, 1)

    def _add(self, first: int, length: int) -> None:
        """Add a run of bytes to the row, see _Value.runs."""
        if first < 0:
            first = len(self._wire) - 1 - first
        self._runs.append((first, first + length))
        self._size += length
