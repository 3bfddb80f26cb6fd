# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a message or field ends on the wire, and how many objects genpy would make of it."""

from __future__ import annotations

import struct
from typing import Callable, Dict, List, Mapping, Union

from cassandra_ros.messages.shape import object_counts
from cassandra_ros.messages.spec import PRIMITIVE_SIZES, Field, MessageSpec

Skip = Callable[[bytes, int], int]
"""(wire bytes, offset of a field) -> offset behind it; raises struct.error where they end."""

WIRE_ERRORS = (struct.error,)
"""What reading past the end of a buffer raises."""
MAX_SURPLUS = 1 << 20
"""Objects that a message may have beyond one for each byte."""

_length = struct.Struct("<I").unpack_from

_Part = Union[int, Skip]
"""A number of bytes, or the function that finds it."""
_Memo = Dict[str, List[_Part]]


def short_buffer() -> struct.error:
    """Return the error to raise where a buffer ends too early."""
    return struct.error("the buffer ends before the message does")


def compile_skip(msg_type: str, specs: Mapping[str, MessageSpec]) -> Skip:
    """Return the function that finds the end of a message of a checked definition."""
    return _chain(_message_parts(msg_type, specs, {}))


def compile_field_skip(field: Field, specs: Mapping[str, MessageSpec]) -> Skip:
    """Return the function that finds the end of one field, count of an array included."""
    return _chain(_field_parts(field, specs, {}))


def fixed_size(msg_type: str, specs: Mapping[str, MessageSpec]) -> int | None:
    """Return the bytes that every message of a type takes, None when they vary."""
    return _size(_message_parts(msg_type, specs, {}))


def compile_object_check(
    msg_type: str, specs: Mapping[str, MessageSpec]
) -> Callable[[bytes], object] | None:
    """Return the check that a message would not become too many objects; it raises struct.error.

    An array of empty messages takes four bytes, whatever it counts; genpy makes an object of each.
    None: the type has no such array, and the size of a message bounds its objects.
    """
    objects = object_counts(msg_type, specs)
    if objects is None:
        return None

    def check(wire: bytes) -> None:
        left = len(wire) + MAX_SURPLUS

        def message(name: str, at: int) -> int:
            """Count the objects in the arrays of a message; return where it ends."""
            nonlocal left
            for field in specs[name].fields:
                if field.is_primitive:
                    at = compile_field_skip(field, specs)(wire, at)
                    continue
                count = field.length if field.is_array else 1
                if count is None:
                    (count,) = _length(wire, at)
                    at += 4
                if field.is_array:
                    left -= count * objects[field.type]
                    if left < 0:
                        raise struct.error("an array counts too many empty messages")
                    if fixed_size(field.type, specs) == 0:
                        continue
                for _ in range(count):
                    at = message(field.type, at)
            return at

        message(msg_type, 0)

    return check


def _message_parts(name: str, specs: Mapping[str, MessageSpec], memo: _Memo) -> list[_Part]:
    if name not in memo:
        parts: list[_Part] = []
        for field in specs[name].fields:
            for part in _field_parts(field, specs, memo):
                if parts and isinstance(part, int) and isinstance(parts[-1], int):
                    parts[-1] += part
                else:
                    parts.append(part)
        memo[name] = parts
    return memo[name]


def _field_parts(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> list[_Part]:
    if field.length == 0:
        return [0]
    if field.type == "string":
        element: list[_Part] = [_skip_string]
    elif field.is_primitive:
        element = [PRIMITIVE_SIZES[field.type]]
    else:
        element = _message_parts(field.type, specs, memo)
    if not field.is_array:
        return element
    size = _size(element)
    if size is None:
        return [_skip_elements(_chain(element), field.length)]
    return [_skip_fixed(size)] if field.length is None else [size * field.length]


def _size(parts: list[_Part]) -> int | None:
    sizes = [part for part in parts if isinstance(part, int)]
    return sum(sizes) if len(sizes) == len(parts) else None


def _chain(parts: list[_Part]) -> Skip:
    skips = [_skip_bytes(p) if isinstance(p, int) else p for p in parts]
    if len(skips) == 1:
        return skips[0]

    def skip(wire: bytes, at: int) -> int:
        for part in skips:
            at = part(wire, at)
        return at

    return skip


def _skip_bytes(size: int) -> Skip:
    def skip(wire: bytes, at: int) -> int:
        at += size
        if at > len(wire):
            raise short_buffer()
        return at

    return skip


def _skip_string(wire: bytes, at: int) -> int:
    at += 4 + _length(wire, at)[0]
    if at > len(wire):
        raise short_buffer()
    return at


def _skip_fixed(size: int) -> Skip:
    def skip(wire: bytes, at: int) -> int:
        at += 4 + _length(wire, at)[0] * size
        if at > len(wire):
            raise short_buffer()
        return at

    return skip


def _skip_elements(element: Skip, length: int | None) -> Skip:
    def skip(wire: bytes, at: int) -> int:
        count = length
        if count is None:
            (count,) = _length(wire, at)
            at += 4
        for _ in range(count):
            at = element(wire, at)
        return at

    return skip
