# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Columns of Arrow out of serialised messages, without a Python object for each value.

Messages of one layout are read together (``Stack``): each field is a numpy array over their bytes,
which is copied into the buffer of its column. Where messages have different layouts, each stack
knows the slots of its values in the buffer. A message that shares its layout with few others is a
stack of its own.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Callable, Iterable, Iterator, NamedTuple, Sequence

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import PRIMITIVE_SIZES
from cassandra_ros.messages.wire.field_ends import compile_object_check
from cassandra_ros.messages.wire.message_stacks import (
    DTYPES,
    Int64Array,
    Layout,
    Stack,
    stacker,
)
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.arrays.arrow_types import ArrowField
from cassandra_ros.query.arrays.batch import SizeGroups

if TYPE_CHECKING:
    import pyarrow

LONG_RUN = 32
"""Number of elements of an array from which it is copied by itself, not by indices."""
_MAX_LENGTHS = 2**31
"""No limit on the lengths in a layout: a message alone has to be read whatever it costs."""
_PAIRS = {"time": np.dtype("<u4"), "duration": np.dtype("<i4")}


class _StackSlots(NamedTuple):
    """Messages of one layout, and the slots (indices) of a field's values in the array to make."""

    stack: Stack
    slots: Int64Array
    """(messages, values of the field in a message)."""

    def inside(self, counts: Int64Array, offsets: Int64Array) -> _StackSlots:
        """Return the slots of the elements of arrays at these slots.

        Args:
            counts: Number of elements of each array in a message.
            offsets: Slot of the first element of each array of all messages, by the array's slot.
        """
        return _StackSlots(self.stack, _spread(offsets[self.slots], counts))


class MessageColumns(NamedTuple):
    """The columns of some messages."""

    arrays: list[pyarrow.Array]
    unread: AnyArray
    """Indices of the messages that could not be read: their columns are null."""


def make_columns(
    arrow: Any,
    definition: Definition,
    fields: Sequence[ArrowField],
    groups: SizeGroups,
    count: int,
) -> MessageColumns:
    """Make the columns of some fields.

    Args:
        arrow: The module pyarrow.
        definition: Type of the messages.
        fields: The fields.
        groups: The messages, by size.
        count: Number of messages, those in no group included.
    """
    stacks = [_StackSlots(stack, stack.members[:, None]) for stack in _stacks(definition, groups)]
    readable = np.zeros(count, bool)
    for stack_slots in stacks:
        readable[stack_slots.stack.members] = True
    maker = _ArrayMaker(arrow)
    if readable.all():
        validity = None
    else:
        validity = arrow.py_buffer(np.packbits(readable, bitorder="little"))
    arrays = [maker.make(field, stacks, count, validity) for field in fields]
    return MessageColumns(arrays, np.flatnonzero(~readable))


def _stacks(definition: Definition, groups: SizeGroups) -> Iterator[Stack]:
    """Yield the messages by their layout, without those that cannot be read."""
    check = _object_check(definition)
    for stack in _by_layout(definition, groups):
        try:
            if check is not None:
                check(stack.planes[:, 0].tobytes())
        except struct.error:
            continue
        yield stack


@lru_cache(maxsize=1024)
def _object_check(definition: Definition) -> Callable[[bytes], object] | None:
    return compile_object_check(definition.type, definition.specs)


def _by_layout(definition: Definition, groups: SizeGroups) -> Iterator[Stack]:
    """Yield the messages by their layout; malformed ones are left out."""
    for members, planes in groups:
        stacks, rest = stacker(definition).stacks(planes, members)
        yield from stacks
        for n in rest.tolist():
            alone = planes[:, [int(np.searchsorted(members, n))]]
            try:
                layout = Layout(definition, alone.tobytes(), _MAX_LENGTHS)
            except struct.error:
                continue
            yield Stack(layout, np.array([n], np.int64), alone)


class _ArrayMaker:
    """Makes arrays of Arrow.

    ``validity`` is everywhere the buffer of bits that says which values are not null; None = all.
    """

    def __init__(self, arrow: Any) -> None:
        self._arrow = arrow

    def make(
        self, field: ArrowField, stacks: Sequence[_StackSlots], size: int, validity: Any = None
    ) -> pyarrow.Array:
        """Make the array of a field with ``size`` values."""
        if field.field.is_array:
            return self._list(field, stacks, size, validity)
        return self._values(field, stacks, size, validity)

    def _values(
        self, field: ArrowField, stacks: Sequence[_StackSlots], size: int, validity: Any = None
    ) -> pyarrow.Array:
        """Make the array of a field's values; of a field that is an array, of its elements."""
        kind = field.value_type(self._arrow)
        if field.children:
            children = [self.make(child, stacks, size) for child in field.children]
            return self._arrow.Array.from_buffers(kind, size, [validity], children=children)
        base = field.field.base
        if base == "string":
            return self._texts(field, stacks, size, validity)
        return number_array(self._arrow, kind, _numbers(field, stacks, size), validity)

    def _list(
        self, field: ArrowField, stacks: Sequence[_StackSlots], size: int, validity: Any
    ) -> pyarrow.Array:
        counts = [_counts(field, stack_slots) for stack_slots in stacks]
        offsets = _offsets(stacks, counts, size)
        ends = self._offset_buffer(offsets)
        total = int(offsets[-1])
        kind = field.type(self._arrow)
        base = field.field.base
        if not field.field.is_primitive or base == "string":
            inner = [stack_slots.inside(n, offsets) for stack_slots, n in zip(stacks, counts)]
            values = self._values(field, inner, total)
        else:
            dtype = np.dtype(np.int64) if base in _PAIRS else np.dtype(base)
            runs = [_array_values(stack_slots.stack, field) for stack_slots in stacks]
            flat = _fill_slots(total, dtype, stacks, counts, offsets, runs)
            if field.is_bytes:
                buffers = [validity, ends, self._arrow.py_buffer(flat)]
                return self._arrow.Array.from_buffers(kind, size, buffers)
            values = number_array(self._arrow, kind.value_type, flat)
        return self._arrow.Array.from_buffers(kind, size, [validity, ends], children=[values])

    def _texts(
        self, field: ArrowField, stacks: Sequence[_StackSlots], size: int, validity: Any
    ) -> pyarrow.Array:
        ranges = [stack_slots.stack.layout.texts.get(field.path, []) for stack_slots in stacks]
        counts = [np.array([text.size for text in texts], np.int64) for texts in ranges]
        offsets = _offsets(stacks, counts, size)
        runs = [_text_bytes(stack_slots.stack, field.path) for stack_slots in stacks]
        data = _fill_slots(int(offsets[-1]), np.dtype(np.uint8), stacks, counts, offsets, runs)
        if not is_utf8(data, offsets):
            data, offsets = escape(data, offsets)
        buffers = [validity, self._offset_buffer(offsets), self._arrow.py_buffer(data)]
        return self._arrow.Array.from_buffers(self._arrow.string(), size, buffers)

    def _offset_buffer(self, offsets: Int64Array) -> Any:
        return self._arrow.py_buffer(offsets.astype(np.int32))


def number_array(arrow: Any, kind: Any, values: AnyArray, validity: Any = None) -> pyarrow.Array:
    """Return numbers, bools or times as an array of Arrow of a type that has their encoding."""
    size = len(values)
    if arrow.types.is_boolean(kind):
        values = np.packbits(values != 0, bitorder="little")
    buffer = arrow.py_buffer(np.ascontiguousarray(values))
    return arrow.Array.from_buffers(kind, size, [validity, buffer])


def _numbers(field: ArrowField, stacks: Sequence[_StackSlots], size: int) -> AnyArray:
    """Return the values of a field of numbers."""
    base = field.field.base
    dtype = np.dtype(np.int64) if base in _PAIRS else np.dtype(base)
    values: AnyArray = np.zeros(size, dtype)
    for stack_slots in stacks:
        numbers = stack_slots.stack.numbers(field.path, base)
        if numbers.size == size:  # the slots of all values are in order
            return numbers.T.reshape(-1).astype(dtype, copy=False)
        _put(values, stack_slots.slots, numbers.T)
    return values


def _put(out: AnyArray, slots: Int64Array, values: AnyArray) -> None:
    """Set values at their slots, which ascend along the rows: (messages, values of a message)."""
    if not slots.size:
        return
    first, last = int(slots[0, 0]), int(slots[-1, -1])
    if last - first + 1 == slots.size:
        out[first : last + 1] = values.reshape(-1)
    else:
        out[slots] = values


def _counts(field: ArrowField, stack_slots: _StackSlots) -> Int64Array:
    """Return the number of elements of each array of a field in a message."""
    layout, slots = stack_slots.stack.layout, stack_slots.slots.shape[1]
    if field.field.length is not None:
        return np.full(slots, field.field.length, np.int64)
    if field.field.is_primitive and field.field.base != "string":
        parts = layout.arrays.get(field.path, [])
        return np.repeat(
            [array.length for array in parts], [len(array.ats) for array in parts]
        ).astype(np.int64)
    counts = layout.counts if isinstance(layout, Layout) else {}
    return np.array(counts.get(field.path, []), np.int64)


def _offsets(stacks: Sequence[_StackSlots], counts: Sequence[Int64Array], size: int) -> Int64Array:
    """Return the slot of the first element of each of ``size`` arrays, and that after the last."""
    lengths = np.zeros(size, np.int64)
    for stack_slots, n in zip(stacks, counts):
        lengths[stack_slots.slots] = n
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths)])


def _spread(starts: Int64Array, counts: Int64Array) -> Int64Array:
    """Return the slots of all elements of arrays that begin at some slots: (messages, elements)."""
    within = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    slots: Int64Array = np.repeat(starts, counts, axis=1) + within
    return slots


def _fill_slots(
    total: int,
    dtype: Any,
    stacks: Sequence[_StackSlots],
    counts: Sequence[Int64Array],
    offsets: Int64Array,
    runs: Iterable[AnyArray],
) -> AnyArray:
    """Return the elements of arrays, or the bytes of texts, at their slots.

    Args:
        total: Number of elements of all messages.
        counts: For each stack the number of elements of each array of a message, see _counts.
        offsets: See _offsets.
        runs: For each stack all elements of each message: (messages, elements).
    """
    elements: AnyArray = np.zeros(total, dtype)
    for stack_slots, n, values in zip(stacks, counts, runs):
        if values.size == total:
            return values.reshape(-1).astype(dtype, copy=False)
        if not values.size:
            continue
        starts = offsets[stack_slots.slots]
        if len(n) == 1 and values.shape[1] >= LONG_RUN:
            for start, row in zip(starts[:, 0].tolist(), values):
                elements[start : start + len(row)] = row
        else:
            elements[_spread(starts, n)] = values
    return elements


def _array_values(stack: Stack, field: ArrowField) -> AnyArray:
    """Return the elements of an array of numbers: (messages, elements)."""
    base, parts = field.field.base, stack.layout.arrays.get(field.path, [])
    if len(parts) != 1 or len(parts[0].ats) != 1:
        return np.ascontiguousarray(stack.array(field.path, base).T)
    at, size = int(parts[0].ats[0]), parts[0].length * PRIMITIVE_SIZES[base]
    rows = np.ascontiguousarray(stack.planes[at : at + size].T)
    if base in _PAIRS:
        halves = rows.view(_PAIRS[base]).reshape(len(rows), -1, 2).astype(np.int64)
        return halves[..., 0] * SECOND_NS + halves[..., 1]
    values: AnyArray = rows.view(DTYPES[base])
    return values != 0 if base == "bool" else values


def _text_bytes(stack: Stack, path: str) -> AnyArray:
    """Return the bytes of all texts of a field: (messages, bytes)."""
    parts = [stack.planes[at : at + size] for at, size in stack.layout.texts.get(path, [])]
    data = np.concatenate([stack.planes[:0], *parts]) if len(parts) != 1 else parts[0]
    return np.ascontiguousarray(data.T)


def is_utf8(data: AnyArray, offsets: Int64Array) -> bool:
    """Return whether each of some texts, which lie one after the other, is UTF-8."""
    if not len(data) or data.max() < 0x80:
        return True
    try:
        data.tobytes().decode("utf-8")
    except UnicodeDecodeError:
        return False
    begins = offsets[:-1]
    # No text may begin inside of a character.
    return not ((data[begins[begins < len(data)]] & 0xC0) == 0x80).any()


def escape(data: AnyArray, offsets: Int64Array) -> tuple[AnyArray, Int64Array]:
    r"""Return texts with the bytes that are not UTF-8 escaped, as \xff."""
    raw = data.tobytes()
    texts = [
        raw[begin:end].decode("utf-8", "backslashreplace").encode("utf-8")
        for begin, end in zip(offsets[:-1].tolist(), offsets[1:].tolist())
    ]
    ends = np.cumsum([len(text) for text in texts], dtype=np.int64)
    return np.frombuffer(b"".join(texts), np.uint8), np.concatenate([np.zeros(1, np.int64), ends])
