# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fields of many messages at once, as numpy arrays over the bytes of the messages.

Messages of equal size mostly have one layout: the fields lie at the same offsets. One of them is
walked, and the others have its layout if the lengths of all their strings and arrays are the same.
The caller walks messages of rare layouts one by one.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Iterable, NamedTuple, Protocol, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES, Field, Specs
from cassandra_ros.messages.wire.field_ends import fixed_size, short_buffer

ByteArray = NDArray[np.uint8]
"""Bytes of messages. As planes: row k holds byte k of every message."""
Int64Array = NDArray[np.int64]
"""Offsets in bytes, or indices of messages."""
NumberArray = NDArray[Any]
"""Values of a numeric field."""


class Planes(Protocol):
    """A matrix (size, messages) of bytes; an array, or one that decodes its rows when read."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of a message, and number of messages."""

    @property
    def size(self) -> int:
        """Number of bytes."""

    @property
    def T(self) -> ByteArray:  # noqa: N802 - numpy's name
        """The messages one after the other: (messages, size)."""

    def __len__(self) -> int: ...

    def __getitem__(self, key: Any) -> Any: ...


def planes_of(stored: ByteArray, rises: NDArray[np.bool_] | None) -> Planes:
    """Return the planes of a group of a block; ``rises``: which are stored as differences."""
    return stored if rises is None else RisingPlanes(stored, rises)


class RisingPlanes:
    """Planes of which some are stored as differences, and decoded when they are read.

    Most readers need few fields, so few planes.

    Args:
        stored: The matrix as it is stored.
        rises: For each row whether it is stored as differences.
    """

    def __init__(self, stored: ByteArray, rises: NDArray[np.bool_]) -> None:
        self._stored, self._rises = stored, rises

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of a message, and number of messages."""
        return self._stored.shape

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self._stored.size

    def __len__(self) -> int:
        return len(self._stored)

    def __getitem__(self, key: Any) -> ByteArray:
        """Return rows by a slice or indices of any shape, or with (:, key) columns."""
        if not isinstance(key, tuple):
            return _decode(self._stored[key], self._rises[key])
        columns = key[1]
        cells: ByteArray = self._stored[:, columns].copy()
        rising = self._stored[self._rises]
        if isinstance(columns, (int, np.integer)):
            rising = rising[:, : columns + 1]
            cells[self._rises] = np.add.reduce(rising, axis=1, dtype=np.uint8)
        else:
            cells[self._rises] = np.add.accumulate(rising, axis=1, dtype=np.uint8)[:, columns]
        return cells

    @property
    def T(self) -> ByteArray:  # noqa: N802 - numpy's name
        """The messages one after the other: (messages, size)."""
        return self[:].T

    def copy_to(self, out: ByteArray) -> None:
        """Write all planes into a matrix of their shape."""
        out[:] = self._stored
        out[self._rises] = np.add.accumulate(self._stored[self._rises], axis=1, dtype=np.uint8)


def copy_planes(planes: Planes, out: ByteArray) -> None:
    """Write planes into a matrix of their shape, without a copy beside it."""
    if isinstance(planes, RisingPlanes):
        planes.copy_to(out)
    else:
        out[:] = planes[:]


def _decode(stored: ByteArray, rises: NDArray[np.bool_]) -> ByteArray:
    """Return rows of which some are stored as differences."""
    if not rises.any():
        return stored
    rows: ByteArray = stored.copy()
    rows[rises] = np.add.accumulate(stored[rises], axis=-1, dtype=np.uint8)
    return rows


MIN_STACKED = 8
"""Minimum number of messages of one layout. Fewer are faster walked one by one, unless large."""
STACKED_ALONE_BYTES = 4096
"""Size from which a message is large, bytes: a single large message is treated as a stack too."""
MAX_LAYOUTS_TRIED = 8
"""Maximum number of layouts tried for messages of one size."""
MAX_CACHED_SIZES = 128
"""Maximum number of message sizes whose layouts are cached for one type."""
MAX_CACHED_LAYOUTS = 4
"""Maximum number of layouts cached for one message size."""
LENGTHS_EACH = 16
"""Maximum number of lengths of strings and arrays in a layout, for each message that may share
it."""
MAX_OFFSETS_ONE_BY_ONE = 64
"""Maximum number of offsets of a field that are read one by one."""
MAX_CACHED_WEIGHT = 4096
"""Maximum number of length bytes and element offsets in a cached layout."""
DTYPES = {
    name: np.dtype("u1" if name == "bool" else "<" + code.replace("?", "B"))
    for name, code in CODES.items()
}
"""numpy type of each primitive type on the wire; a time or duration is one integer."""
_PARTS = {"time": np.dtype("<u4"), "duration": np.dtype("<i4")}
_NOWHERE: Int64Array = np.zeros(0, np.int64)
_length = struct.Struct("<I").unpack_from


class TextRange(NamedTuple):
    """Offset and size of the bytes of a string, in bytes, after the length prefix."""

    at: int
    size: int


class ArrayOffsets(NamedTuple):
    """Offsets of an array of primitives, one in each message that contains it, and its length."""

    ats: Int64Array
    length: int


class Layout:
    """Offsets of all fields in a message, by dotted path.

    A field inside an array of messages has several offsets, in wire order.

    Args:
        most: Maximum number of lengths. struct.error: there are more, or the bytes are malformed.

    Attributes:
        texts: Strings, by path.
        arrays: Arrays of numbers, by path.
        counts: Numbers of elements of each string[] and array of messages without a fixed length,
            by path, one for each occurrence in wire order.
        end: Size of the message, bytes.
        prefixes: Offsets of the bytes of all length prefixes.
        lengths: Bytes at these offsets.
        weight: Number of length bytes and element offsets, see MAX_CACHED_WEIGHT.
    """

    def __init__(self, definition: Definition, wire: bytes, most: int) -> None:
        self._wire = wire
        self._most = most
        self._specs = definition.specs
        self._offsets: dict[str, list[Int64Array]] = {}
        self._length_offsets: list[int] = []
        self.texts: dict[str, list[TextRange]] = {}
        self.arrays: dict[str, list[ArrayOffsets]] = {}
        self.counts: dict[str, list[int]] = {}
        self.end = self._message(definition.type, "", 0)
        if self.end > len(wire):
            raise short_buffer()
        prefixes = np.array(self._length_offsets, np.int64)[:, None] + np.arange(4)
        self.prefixes: Int64Array = prefixes.ravel()
        self.lengths: ByteArray = np.frombuffer(wire, np.uint8)[self.prefixes]
        self._numbers = {
            path: ats[0] if len(ats) == 1 else np.concatenate(ats)
            for path, ats in self._offsets.items()
        }
        self.weight = len(self.prefixes) + sum(map(len, self._numbers.values()))
        del self._wire, self._offsets, self._length_offsets

    def numbers(self, path: str) -> Int64Array:
        """Return the offsets of a number, bool or time; empty if its array of messages is empty."""
        return self._numbers.get(path, _NOWHERE)

    def fits(self, planes: Planes) -> NDArray[np.bool_]:
        """Return for each message whether it has this layout; all must have the same size."""
        same: NDArray[np.bool_] = (planes[self.prefixes] == self.lengths[:, None]).all(axis=0)
        return same

    def _message(self, msg_type: str, prefix: str, at: int) -> int:
        """Record the offsets of a message's fields; return the offset after it.

        Raises struct.error.
        """
        for field in self._specs[msg_type].fields:
            path = prefix + field.name
            if field.type == "string":
                at = self._strings(field, path, at)
            elif field.is_array:
                at = self._array(field, path, at)
            elif field.is_primitive:
                self._offsets.setdefault(path, []).append(np.array([at], np.int64))
                at += PRIMITIVE_SIZES[field.type]
            else:
                at = self._message(field.type, path + ".", at)
        return at

    def _count(self, at: int) -> int:
        """Record a length prefix and return the length; struct.error: too many, or bytes end."""
        self._length_offsets.append(at)
        if len(self._length_offsets) > self._most:
            raise struct.error("more lengths than are worth looking at")
        (count,) = _length(self._wire, at)
        return int(count)

    def _strings(self, field: Field, path: str, at: int) -> int:
        """Record a string or an array of strings; return the offset after it."""
        count = 1
        if field.is_array and field.length is None:
            count, at = self._count(at), at + 4
            self.counts.setdefault(path, []).append(count)
        elif field.length is not None:
            count = field.length
        for _ in range(count):
            size = self._count(at)
            self.texts.setdefault(path, []).append(TextRange(at + 4, size))
            at += 4 + size
        return at

    def _array(self, field: Field, path: str, at: int) -> int:
        """Record an array of numbers or messages; return the offset after it."""
        count = field.length
        if count is None:
            count, at = self._count(at), at + 4
            if not field.is_primitive:
                self.counts.setdefault(path, []).append(count)
        size = _size_of(field.type, self._specs)
        if size is None:
            for _ in range(count):
                at = self._message(field.type, path + ".", at)
            return at
        end = at + count * size
        if end > len(self._wire):
            raise short_buffer()
        if field.is_primitive:
            elements = ArrayOffsets(np.array([at], np.int64), count)
            self.arrays.setdefault(path, []).append(elements)
        elif count and size:
            self._fixed(field.type, path + ".", np.arange(at, end, size))
        return end

    def _fixed(self, msg_type: str, prefix: str, ats: Int64Array) -> None:
        """Record the offsets of the fields of all elements of an array of fixed-size messages."""
        for field in self._specs[msg_type].fields:
            path, size = prefix + field.name, _size_of(field.type, self._specs) or 0
            count = 1 if field.length is None else field.length
            if field.is_array and field.is_primitive:
                self.arrays.setdefault(path, []).append(ArrayOffsets(ats, count))
            elif field.is_primitive:
                self._offsets.setdefault(path, []).append(ats)
            elif count and size:
                inner = ats[:, None] + np.arange(count) * size
                self._fixed(field.type, path + ".", inner.ravel())
            ats = ats + count * size


class Head:
    """Offsets of the numbers that are the same in all messages of a type.

    These are the numbers before the first string or variable array.

    Attributes:
        size: Number of bytes before that string or array.
        texts, arrays, lengths: Empty; they make a Head usable like a Layout.
    """

    def __init__(self, definition: Definition) -> None:
        self._specs = definition.specs
        self._ats: dict[str, Int64Array] = {}
        self.texts: dict[str, list[TextRange]] = {}
        self.arrays: dict[str, list[ArrayOffsets]] = {}
        self.lengths: ByteArray = np.zeros(0, np.uint8)
        self.size, _ = self._message(definition.type, "", 0)

    def __contains__(self, path: str) -> bool:
        return path in self._ats

    def numbers(self, path: str) -> Int64Array:
        """Return the offset of a number, bool or time."""
        return self._ats[path]

    def _message(self, msg_type: str, prefix: str, at: int) -> tuple[int, bool]:
        """Record the offsets of a message's fields of fixed offset.

        Return the offset after them, and whether these are all fields.
        """
        for field in self._specs[msg_type].fields:
            path, size = prefix + field.name, _size_of(field.type, self._specs)
            if field.is_array:
                if size is None or field.length is None:
                    return at, False
                at += size * field.length
            elif field.is_primitive:
                if size is None:
                    return at, False
                self._ats[path] = np.array([at], np.int64)
                at += size
            else:
                at, whole = self._message(field.type, path + ".", at)
                if not whole:
                    return at, False
        return at, True


def _size_of(type_: str, specs: Specs) -> int | None:
    """Return the size of every value of a type, bytes; None if it varies, as of a string."""
    size = PRIMITIVE_SIZES.get(type_)
    return fixed_size(type_, specs) if size is None or type_ == "string" else size


class Stack(NamedTuple):
    """Messages of one layout, or the heads of messages of one type."""

    layout: Layout | Head
    members: Int64Array
    """Indices of the messages, as the caller numbers them."""
    planes: Planes

    @property
    def is_whole(self) -> bool:
        """Whether the layout says what each byte of the messages is."""
        return isinstance(self.layout, Layout) and self.layout.end == self.planes.shape[0]

    def numbers(self, path: str, base: str, chosen: slice = slice(None)) -> NumberArray:
        """Return a primitive field: (offsets, messages). Times are in ns, a bool is 0 or 1."""
        return read_numbers(self.planes, self.layout.numbers(path)[chosen], base)

    def array(self, path: str, base: str) -> NumberArray:
        """Return the elements of an array of numbers: (elements, messages)."""
        unit = PRIMITIVE_SIZES[base]
        parts = [
            (array.ats[:, None] + np.arange(array.length) * unit).ravel()
            for array in self.layout.arrays.get(path, [])
        ]
        return read_numbers(self.planes, np.concatenate([_NOWHERE, *parts]), base)

    def element(self, path: str, index: int, base: str) -> NumberArray:
        """Return one element of an array of numbers that occurs once in a message: (1, messages).

        (0, messages) if the array is too short.
        """
        arrays = self.layout.arrays.get(path, [])
        ats = [e.ats + index * PRIMITIVE_SIZES[base] for e in arrays if index < e.length]
        return read_numbers(self.planes, ats[0] if ats else _NOWHERE, base)

    def texts(self, path: str) -> list[bytes]:
        """Return the distinct values of a string, or of all strings of an array."""
        texts: dict[bytes, None] = {}
        for at, size in dict.fromkeys(self.layout.texts.get(path, [])):
            rows = self.planes[at : at + size]
            if (rows == rows[:, :1]).all():
                texts[rows[:, 0].tobytes()] = None
            else:
                data = rows.T.tobytes()
                texts.update(dict.fromkeys(data[n : n + size] for n in range(0, len(data), size)))
        return list(texts)


class Stacker:
    """Finds the layouts of messages of one type.

    Threads share it: another thread may clear the cache meanwhile, which costs only time.

    Attributes:
        head: Offsets that all messages of the type share, whatever their size.
    """

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self.head = Head(definition)
        self._cache: dict[int, tuple[Layout, ...]] = {}

    def stacks(self, planes: Planes, members: Int64Array) -> tuple[list[Stack], Int64Array]:
        """Group messages of equal size by their layout.

        Args:
            planes: (size, messages).
            members: Index of each message.

        Returns:
            The stacks, and the indices of the remaining messages, which must be walked one by one
            and may be malformed.
        """
        size, count = planes.shape
        least = 1 if size >= STACKED_ALONE_BYTES else MIN_STACKED
        stacks: list[Stack] = []
        rest: list[Int64Array] = []
        indices: Int64Array = np.arange(count)
        for _ in range(MAX_LAYOUTS_TRIED):
            if len(indices) < max(1, least):
                break
            layout = self._layout(planes[:, indices[0]], LENGTHS_EACH * len(indices))
            subset = planes if len(indices) == count else planes[:, indices]
            fits = np.arange(len(indices)) == 0 if layout is None else layout.fits(subset)
            if layout is not None and fits.all():
                return [*stacks, Stack(layout, members[indices], subset)], _join(rest)
            alike = indices[fits]
            if layout is not None and len(alike) >= least:
                stacks.append(Stack(layout, members[alike], subset[:, fits]))
            else:
                rest.append(members[alike])
            indices = indices[~fits]
        return stacks, _join([*rest, members[indices]])

    def heads(self, groups: Iterable[tuple[Planes, Int64Array]]) -> Stack:
        """Return the heads of messages of any size as one stack; shorter messages are left out.

        Args:
            groups: Planes and indices of the messages of each size.
        """
        size = self.head.size
        long = [(planes[:size], members) for planes, members in groups if len(planes) >= size]
        if not long:
            return Stack(self.head, _NOWHERE, np.zeros((size, 0), np.uint8))
        planes = np.concatenate([planes for planes, _ in long], axis=1)
        return Stack(self.head, np.concatenate([members for _, members in long]), planes)

    def heads_of(self, wires: Sequence[bytes]) -> Stack:
        """Return the heads of serialised messages as one stack; shorter ones are left out."""
        size = self.head.size
        members = np.flatnonzero(np.fromiter(map(len, wires), np.int64, len(wires)) >= size)
        data = np.frombuffer(b"".join([w[:size] for w in wires if len(w) >= size]), np.uint8)
        return Stack(self.head, members, data.reshape(len(members), size).T)

    def _layout(self, wire: ByteArray, most: int) -> Layout | None:
        """Return the layout of a message.

        None: it is malformed, or has more than ``most`` lengths.
        """
        layouts = self._cache.get(len(wire), ())
        for layout in layouts:
            if layout.fits(wire[:, None])[0]:
                return layout
        try:
            layout = Layout(self._definition, wire.tobytes(), most)
        except struct.error:
            return None
        if layout.weight <= MAX_CACHED_WEIGHT:
            if len(self._cache) >= MAX_CACHED_SIZES:
                self._cache.clear()
            self._cache[len(wire)] = (layout, *layouts[: MAX_CACHED_LAYOUTS - 1])
        return layout


stacker = lru_cache(maxsize=512)(Stacker)
"""Returns the stacker of a definition, made once per type and md5."""


def as_planes(wires: Sequence[bytes]) -> ByteArray:
    """Return messages of equal size as planes; the bytes are joined once, not copied further."""
    data = np.frombuffer(b"".join(wires), np.uint8)
    return data.reshape(len(wires), len(data) // len(wires)).T


def by_size(wires: Sequence[bytes]) -> Iterable[tuple[Int64Array, ByteArray]]:
    """Yield the indices and the planes of the messages of each size."""
    if len(set(map(len, wires))) == 1:
        yield np.arange(len(wires)), as_planes(wires)
        return
    sizes = np.fromiter(map(len, wires), np.int64, len(wires))
    order = np.argsort(sizes, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(sizes[order])) + 1):
        if len(members):
            yield members, as_planes([wires[n] for n in members.tolist()])


def read_numbers(planes: Planes, ats: Int64Array, base: str) -> NumberArray:
    """Return the numbers at some offsets of all messages: (offsets, messages).

    See Stack.numbers.
    """
    unit, messages = PRIMITIVE_SIZES[base], planes.shape[1]
    numbers: NumberArray
    array = planes if isinstance(planes, np.ndarray) else None
    if array is not None and len(ats) <= MAX_OFFSETS_ONE_BY_ONE and array.T.flags.c_contiguous:
        # The messages are adjacent in memory: each number is read in place.
        numbers = np.empty((len(ats), messages), f"<u{unit}")
        for row, at in zip(numbers, ats.tolist()):
            row[:] = np.ndarray((messages,), row.dtype, array.T, at, (len(array),))
    else:
        rows = planes[ats[:, None] + np.arange(unit)]
        numbers = np.ascontiguousarray(rows.transpose(0, 2, 1)).view(f"<u{unit}")[..., 0]
        numbers = np.ascontiguousarray(numbers)
    if base in _PARTS:
        halves = numbers.view(_PARTS[base]).reshape(*numbers.shape, 2).astype(np.int64)
        return halves[..., 0] * SECOND_NS + halves[..., 1]
    values: NumberArray = numbers.view(DTYPES[base])
    return (values != 0).view(np.uint8) if base == "bool" else values


def _join(parts: Sequence[Int64Array]) -> Int64Array:
    return np.sort(np.concatenate(parts)) if parts else _NOWHERE
