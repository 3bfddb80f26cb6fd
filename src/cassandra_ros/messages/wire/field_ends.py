# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""End offsets of messages and fields on the wire, and the number of objects genpy would make."""

from __future__ import annotations

import struct
from typing import Callable, List, NamedTuple, Sequence, Union

from cassandra_ros.messages.shape import object_counts
from cassandra_ros.messages.spec import PRIMITIVE_SIZES, Field, Specs

Skip = Callable[[bytes, int], int]
"""(wire bytes, offset of a field) -> offset after it; raises struct.error if the bytes end
early."""

MAX_SURPLUS = 1 << 20
"""Maximum number of objects in a message in addition to one object per byte."""

_length = struct.Struct("<I").unpack_from


class _CountedField(NamedTuple):
    """A string, or an array of elements of fixed size."""

    unit: int
    """Size of each counted element, bytes."""

    def end(self, wire: bytes, at: int) -> int:
        """Return the offset after it."""
        return at + 4 + self.unit * int(_length(wire, at)[0])


_FieldSizes = List[Union[int, _CountedField, Skip]]
"""Sizes of adjacent fields: bytes, counted fields, and functions that find an end offset. These may
return an offset after the end of the buffer."""


def short_buffer() -> struct.error:
    """Return the error to raise if a buffer ends too early."""
    return struct.error("the buffer ends before the message does")


def compile_skip(msg_type: str, specs: Specs) -> Skip:
    """Return the function that finds the end of a message of a checked definition."""
    return _chain(_sizes_of(specs[msg_type].fields, specs))


def compile_field_skip(field: Field, specs: Specs) -> Skip:
    """Return the function that finds the end of one field, length prefix included."""
    return _chain(_sizes_of([field], specs))


def fixed_size(type_: str, specs: Specs) -> int | None:
    """Return the size in bytes of every value of a type, None if it varies."""
    return _size(_sizes_of([Field("", type_)], specs))


def compile_object_check(msg_type: str, specs: Specs) -> Callable[[bytes], object] | None:
    """Return the check that a message does not mean too many objects; it raises struct.error.

    An array of empty messages takes four bytes whatever its count, but genpy makes an object for
    each element. None: the type has no such array, so that its size limits the number of objects.
    """
    objects = object_counts(msg_type, specs)
    if objects is None:
        return None

    def check(wire: bytes) -> None:
        allowance = len(wire) + MAX_SURPLUS

        def message(name: str, at: int) -> int:
            """Count the objects in the arrays of a message; return the offset after the message."""
            nonlocal allowance
            for field in specs[name].fields:
                if field.is_primitive:
                    at = compile_field_skip(field, specs)(wire, at)
                    continue
                count = field.length if field.is_array else 1
                if count is None:
                    (count,) = _length(wire, at)
                    at += 4
                if field.is_array:
                    allowance -= count * objects[field.type]
                    if allowance < 0:
                        raise struct.error("an array counts too many empty messages")
                    if fixed_size(field.type, specs) == 0:
                        continue
                for _ in range(count):
                    at = message(field.type, at)
            return at

        message(msg_type, 0)

    return check


def _sizes_of(fields: Sequence[Field], specs: Specs) -> _FieldSizes:
    """Return the sizes of fields; adjacent fixed sizes are added up."""
    sizes: _FieldSizes = []
    for field in fields:
        for size in _sizes_of_field(field, specs):
            if sizes and isinstance(size, int) and isinstance(sizes[-1], int):
                sizes[-1] += size
            else:
                sizes.append(size)
    return sizes


def _sizes_of_field(field: Field, specs: Specs) -> _FieldSizes:
    """Return the sizes of a field; of a message those of its fields."""
    if field.type == "string":
        element: _FieldSizes = [_CountedField(1)]
    elif field.is_primitive:
        element = [PRIMITIVE_SIZES[field.type]]
    else:
        element = _sizes_of(specs[field.type].fields, specs)
    if not field.is_array:
        return element
    size = _size(element)
    if field.length == 0:
        return [0]
    if size is None:
        return [_skip_elements(element, field.length)]
    return [_CountedField(size)] if field.length is None else [size * field.length]


def _size(sizes: _FieldSizes) -> int | None:
    """Return the sum of sizes in bytes; None if one is not fixed."""
    fixed = [size for size in sizes if isinstance(size, int)]
    return sum(fixed) if len(fixed) == len(sizes) else None


def _chain(sizes: _FieldSizes) -> Skip:
    """Return the function that skips adjacent fields and checks that the bytes reach so far."""
    if all(isinstance(size, (int, _CountedField)) for size in sizes):
        return _plain_chain(sizes)
    skips = [_skip_of(size) for size in sizes]

    def skip(wire: bytes, at: int) -> int:
        for size in skips:
            at = size(wire, at)
        if at > len(wire):
            raise short_buffer()
        return at

    return skip


def _plain_chain(sizes: _FieldSizes) -> Skip:
    """Return the skip function of the usual case, only fixed sizes and counted fields: one loop."""
    pairs, before = [], 0
    for size in sizes:
        if isinstance(size, int):
            before += size
        elif isinstance(size, _CountedField):
            pairs.append((before, size.unit))
            before = 4
    last = before

    def skip(wire: bytes, at: int) -> int:
        for bytes_before, unit in pairs:
            at += bytes_before
            at += unit * _length(wire, at)[0]
        at += last
        if at > len(wire):
            raise short_buffer()
        return at

    return skip


def _skip_of(size: int | _CountedField | Skip) -> Skip:
    if isinstance(size, _CountedField):
        return size.end
    return (lambda wire, at: at + size) if isinstance(size, int) else size


def _skip_elements(element: _FieldSizes, length: int | None) -> Skip:
    """Return the function that skips an array of elements of variable size; length: a fixed one."""
    # A single element function reads a count, which fails after the end of the bytes by itself. A
    # chain checks for the end.
    first = element[0]
    step = _chain(element) if len(element) > 1 or isinstance(first, int) else _skip_of(first)

    def skip(wire: bytes, at: int) -> int:
        count = length
        if count is None:
            (count,) = _length(wire, at)
            at += 4
        for _ in range(count):
            at = step(wire, at)
        return at

    return skip
