# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of fields of many serialised messages, as genpy would read them, a field at a time."""

from __future__ import annotations

import struct
from itertools import chain, repeat
from typing import Any, Callable, Iterable, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES

Cells = NDArray[np.uint8]
"""Bytes of many messages: (messages, size)."""
Places = NDArray[np.int64]
"""Where in the bytes the messages are, each at the same field."""
Column = Iterator[Any]
"""The values of a field, message after message."""

MAX_PERIOD = 16
"""Elements of an array whose strings are looked at as if each had its own, which stays."""
_BYTES = ("uint8", "char")
_U4 = np.dtype("<u4")


class Unfit(Exception):
    """These messages have to be made one by one; some may be none."""


class Wires:
    """Serialised messages, all in one buffer."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def cut(self, ats: Places, size: int) -> Cells:
        """Return so many bytes from each place on: (places, size)."""
        every: NDArray[Any] = np.ndarray(
            (len(self.data) - size + 1,), f"V{size}", self.data, 0, (1,)
        )
        return every[ats].view(np.uint8).reshape(len(ats), size)

    def lengths(self, ats: Places) -> Places:
        """Read the length of a string or array at each place."""
        every: NDArray[Any] = np.ndarray((len(self.data) - 3,), _U4, self.data, 0, (1,))
        return every[ats].astype(np.int64)

    def slices(self, ats: Places, ends: Places) -> List[bytes]:
        """Return the bytes from each place to its end."""
        data = self.data
        return [data[at:end] for at, end in zip(ats.tolist(), ends.tolist())]


class Columns:
    """The columns of a message's fields.

    Attributes:
        objects: How many objects and tuples are in those of a message, on the average.
    """

    def __init__(self) -> None:
        self.every: List[Column] = []
        self.objects = 0.0

    def add(self, values: Iterable[Any], objects: float = 0) -> None:
        """Add a column."""
        self.every.append(iter(values))
        self.objects += objects


class Group(NamedTuple):
    """Messages, or elements of the arrays of messages, one after the other."""

    wires: Wires
    ats: Places
    """Where they have been read to."""
    ends: Places
    """Where the messages end in which they lie."""
    period: int
    """So many make the same sequence again and again, if arrays are like each other."""

    def checked(self, ats: Places) -> Places:
        """Return places if they lie in their messages; else raises Unfit."""
        if (ats > self.ends).any():
            raise Unfit
        return ats


class Run:
    """Fields of fixed size, one behind the other."""

    def __init__(self) -> None:
        self.size = 0
        self._readers: List[Callable[[Cells, int], Iterable[Any]]] = []

    def add(self, type_: str, length: Optional[int]) -> None:
        """Add a field of a primitive type; length: of an array, None = it is none."""
        at, code = self.size, CODES[type_]
        self.size += PRIMITIVE_SIZES[type_] * (1 if length is None else length)
        if length is None:
            self._readers.append(_scalar(type_, at))
        else:
            self._readers.append(_array(type_, code, at, length))

    def read(self, group: Group, out: Columns) -> Places:
        """Append the columns of the fields; return where they end."""
        ends = group.checked(group.ats + self.size)
        cells = group.wires.cut(group.ats, self.size)
        for reader in self._readers:
            out.add(reader(cells, self.size))
        return ends

    def skip(self, wires: Wires, ats: Places) -> Places:
        """Return where they end."""
        return ats + self.size


def _scalar(type_: str, at: int) -> Callable[[Cells, int], Iterable[Any]]:
    if type_ == "bool":
        return lambda cells, size: (cells[:, at] != 0).tolist()
    dtype = np.dtype("<" + CODES[type_])
    return lambda cells, size: np.ndarray((len(cells),), dtype, cells, at, (size,)).tolist()


def _array(type_: str, code: str, at: int, length: int) -> Callable[[Cells, int], Iterable[Any]]:
    unit = length * PRIMITIVE_SIZES[type_]

    def read(cells: Cells, size: int) -> Iterable[Any]:
        if not length:
            return [[] if type_ == "bool" else () for _ in cells]
        return _tuples(type_, cells, f"<{at}x{length}{code}{size - at - unit}x")

    def read_bytes(cells: Cells, size: int) -> Iterable[Any]:
        found = struct.iter_unpack(f"<{at}x{length}s{size - at - length}x", cells.data)
        return chain.from_iterable(found)

    return read_bytes if type_ in _BYTES else read


def _tuples(type_: str, cells: Cells, layout: str) -> Iterable[Any]:
    """Return what genpy makes of arrays: lists of bools, tuples of other numbers."""
    found = struct.iter_unpack(layout, cells.data)
    return map(list, found) if type_ == "bool" else found


class Numbers:
    """An array of primitives with its length."""

    def __init__(self, type_: str) -> None:
        self._type = type_
        self._unit, self._code = PRIMITIVE_SIZES[type_], CODES[type_]

    def read(self, group: Group, out: Columns) -> Places:
        """Append its column; return where it ends."""
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
            found = map(self._one, repeat(group.wires.data), begins.tolist(), lengths.tolist())
            out.add(map(list, found) if self._type == "bool" else found, 1)
        return ends

    def _one(self, data: bytes, at: int, length: int) -> Tuple[Any, ...]:
        return struct.unpack_from(f"<{length}{self._code}", data, at)

    def skip(self, wires: Wires, ats: Places) -> Places:
        """Return where it ends."""
        return ats + 4 + self._unit * wires.lengths(ats)


class Text:
    """A string with its length."""

    def read(self, group: Group, out: Columns) -> Places:
        """Append its column; return where it ends."""
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

    def skip(self, wires: Wires, ats: Places) -> Places:
        """Return where it ends."""
        return ats + 4 + wires.lengths(ats)


def _same(wires: Wires, begins: Places, ends: Places) -> Optional[bytes]:
    """Return the bytes that stand at all places; None: they differ."""
    size = int(ends[0] - begins[0])
    if not (ends - begins == size).all():
        return None
    if not size:
        return b""
    cells = wires.cut(begins, size)
    return cells[0].tobytes() if (cells == cells[0]).all() else None


def _decode(raw: bytes) -> str:
    return raw.decode("utf-8", "rosmsg")  # as genpy: what is no UTF-8 is told of, and kept
