# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Field values of many serialised messages, as genpy would read them, one field at a time."""

from __future__ import annotations

import struct
from itertools import chain, repeat
from typing import Any, Callable, Iterable, Iterator, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES

ByteRows = NDArray[np.uint8]
"""Bytes of many messages: (messages, bytes)."""
Offsets = NDArray[np.int64]
"""Offsets in the buffer, one for each message, all of the same field."""
FieldValues = Iterator[Any]
"""Values of a field, message after message."""

MAX_PERIOD = 16
"""Maximum period of elements whose strings are compared, to decode equal ones only once."""
_BYTES = ("uint8", "char")
_U4 = np.dtype("<u4")


class CannotBatch(Exception):
    """These messages cannot be made together, but only one by one; some may be malformed."""


class Wires:
    """Serialised messages in one buffer."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def cut(self, ats: Offsets, size: int) -> ByteRows:
        """Return ``size`` bytes from each offset on: (offsets, size).

        ValueError, IndexError: they would end after the buffer.
        """
        views: NDArray[Any] = np.ndarray(
            (len(self.data) - size + 1,), f"V{size}", self.data, 0, (1,)
        )
        return views[ats].view(np.uint8).reshape(len(ats), size)

    def lengths(self, ats: Offsets) -> Offsets:
        """Return the length of the string or array at each offset; errors as in ``cut``."""
        views: NDArray[Any] = np.ndarray((len(self.data) - 3,), _U4, self.data, 0, (1,))
        return views[ats].astype(np.int64)

    def slices(self, ats: Offsets, ends: Offsets) -> list[bytes]:
        """Return the bytes from each offset to its end."""
        data = self.data
        return [data[at:end] for at, end in zip(ats.tolist(), ends.tolist())]


class ColumnList:
    """The columns of a message's fields.

    Attributes:
        objects: Average number of objects and tuples in the columns of one message.
    """

    def __init__(self) -> None:
        self.columns: list[FieldValues] = []
        self.objects = 0.0

    def add(self, values: Iterable[Any], objects: float = 0) -> None:
        """Add a column."""
        self.columns.append(iter(values))
        self.objects += objects


class ElementGroup(NamedTuple):
    """Messages, or elements of the arrays of messages, in sequence."""

    wires: Wires
    ats: Offsets
    """Offset up to which each message is read."""
    ends: Offsets
    """Offset at which the message that contains it ends."""
    period: int
    """Number of elements in each whole message, if all have the same number; else that of all. So
    elements that are a multiple of it apart are at the same place in their messages."""

    def checked(self, ats: Offsets) -> Offsets:
        """Return the offsets if all lie within their messages; else raise CannotBatch."""
        if (ats > self.ends).any():
            raise CannotBatch
        return ats


class FixedFields:
    """Adjacent fields of fixed size."""

    def __init__(self) -> None:
        self.size = 0
        self._readers: list[Callable[[ByteRows, int], Iterable[Any]]] = []

    def add(self, type_: str, length: int | None) -> None:
        """Add a field of a primitive type; length: of a fixed array, None = a single value."""
        at, code = self.size, CODES[type_]
        self.size += PRIMITIVE_SIZES[type_] * (1 if length is None else length)
        if length is None:
            self._readers.append(_scalar(type_, at))
        else:
            self._readers.append(_array(type_, code, at, length))

    def read(self, group: ElementGroup, out: ColumnList) -> Offsets:
        """Append the columns of the fields; return the offsets after them."""
        ends = group.checked(group.ats + self.size)
        cells = group.wires.cut(group.ats, self.size)
        for reader in self._readers:
            out.add(reader(cells, self.size))
        return ends

    def skip(self, wires: Wires, ats: Offsets) -> Offsets:
        """Return the offsets after the fields."""
        return ats + self.size


def _scalar(type_: str, at: int) -> Callable[[ByteRows, int], Iterable[Any]]:
    """Return the reader of a number at an offset in the fields: (their bytes, size) -> values."""
    if type_ == "bool":
        return lambda cells, size: (cells[:, at] != 0).tolist()
    dtype = np.dtype("<" + CODES[type_])
    return lambda cells, size: np.ndarray((len(cells),), dtype, cells, at, (size,)).tolist()


def _array(type_: str, code: str, at: int, length: int) -> Callable[[ByteRows, int], Iterable[Any]]:
    """Return the reader of a fixed array at an offset, as _scalar."""
    unit = length * PRIMITIVE_SIZES[type_]

    def read(cells: ByteRows, size: int) -> Iterable[Any]:
        if not length:
            return [[] if type_ == "bool" else () for _ in cells]
        return _tuples(type_, cells, f"<{at}x{length}{code}{size - at - unit}x")

    def read_bytes(cells: ByteRows, size: int) -> Iterable[Any]:
        arrays = struct.iter_unpack(f"<{at}x{length}s{size - at - length}x", cells.data)
        return chain.from_iterable(arrays)

    return read_bytes if type_ in _BYTES else read


def _tuples(type_: str, cells: ByteRows, layout: str) -> Iterable[Any]:
    """Return arrays as genpy makes them: lists of bools, tuples of other numbers."""
    arrays = struct.iter_unpack(layout, cells.data)
    return map(list, arrays) if type_ == "bool" else arrays


class PrimitiveArray:
    """An array of primitives with a length prefix."""

    def __init__(self, type_: str) -> None:
        self._type = type_
        self._unit, self._code = PRIMITIVE_SIZES[type_], CODES[type_]

    def read(self, group: ElementGroup, out: ColumnList) -> Offsets:
        """Append its column; return the offsets after it."""
        lengths = group.wires.lengths(group.ats)
        begins = group.ats + 4
        ends = group.checked(begins + self._unit * lengths)
        if self._type in _BYTES:
            out.add(group.wires.slices(begins, ends))
        elif lengths[0] and (lengths == lengths[0]).all():
            length = int(lengths[0])
            cells = group.wires.cut(begins, length * self._unit)
            out.add(_tuples(self._type, cells, f"<{length}{self._code}"), 1)
        else:
            arrays = map(self._one, repeat(group.wires.data), begins.tolist(), lengths.tolist())
            out.add(map(list, arrays) if self._type == "bool" else arrays, 1)
        return ends

    def _one(self, data: bytes, at: int, length: int) -> tuple[Any, ...]:
        return struct.unpack_from(f"<{length}{self._code}", data, at)

    def skip(self, wires: Wires, ats: Offsets) -> Offsets:
        """Return the offsets after it."""
        return ats + 4 + self._unit * wires.lengths(ats)


class TextField:
    """A string with its length prefix."""

    def read(self, group: ElementGroup, out: ColumnList) -> Offsets:
        """Append its column; return the offsets after it."""
        wires, begins = group.wires, group.ats + 4
        ends = group.checked(begins + wires.lengths(group.ats))
        period = group.period
        if period <= MAX_PERIOD and len(begins) > period:
            same = [_same(wires, begins[n::period], ends[n::period]) for n in range(period)]
            if None not in same:
                out.add([_decode(raw or b"") for raw in same] * (len(begins) // period))
                return ends
        out.add(map(_decode, wires.slices(begins, ends)))
        return ends

    def skip(self, wires: Wires, ats: Offsets) -> Offsets:
        """Return the offsets after it."""
        return ats + 4 + wires.lengths(ats)


def _same(wires: Wires, begins: Offsets, ends: Offsets) -> bytes | None:
    """Return the bytes that are the same at all offsets; None if they differ."""
    size = int(ends[0] - begins[0])
    if not (ends - begins == size).all():
        return None
    if not size:
        return b""
    cells = wires.cut(begins, size)
    return cells[0].tobytes() if (cells == cells[0]).all() else None


def _decode(raw: bytes) -> str:
    return raw.decode("utf-8", "rosmsg")  # as genpy: bytes that are not UTF-8 are logged and kept
