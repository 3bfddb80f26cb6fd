# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""CQL's encoding of values and lists, from the wire and from Python, and back.

A list is an int32 number of elements, then the int32 length and the bytes of each element.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import chain, repeat
from typing import Any, Callable, Sequence, Union

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES, Field, Specs
from cassandra_ros.messages.wire.field_ends import fixed_size
from cassandra_ros.messages.wire.layout import FieldColumn, FixedField

Primitive = Union[bool, int, float, str]
"""Python value of a column that is neither a list nor a blob; times are int nanoseconds."""
Decoder = Callable[[bytes], Any]
"""Function from an encoded column to its Python value."""

CQL_CODES = {
    "boolean": ">?",
    "tinyint": ">b",
    "smallint": ">h",
    "int": ">i",
    "bigint": ">q",
    "float": ">f",
    "double": ">d",
}
"""struct codes of the CQL types of fixed size."""
EMPTY_LIST = b"\0\0\0\0"
"""The encoded list without elements."""
_LOW = 0xFFFFFFFF

_pack_size = struct.Struct(">i").pack
_unpack_size = struct.Struct(">i").unpack_from
_length = struct.Struct("<I").unpack_from


def encode_value(cql_type: str, value: Primitive) -> bytes:
    """Encode a Python value; struct.error, OverflowError, UnicodeEncodeError: it does not fit."""
    if isinstance(value, str):
        return value.encode("utf-8")
    if cql_type == "varint":
        if value < 0:
            raise struct.error("a uint64 is negative")
        return pack_varint(int(value))
    return struct.pack(CQL_CODES[cql_type], value)


def number_encoder(cql_type: str) -> Callable[[Any], bytes]:
    """Return the function that encodes numbers >= 0 of varint, or those of a fixed-size type."""
    return pack_varint if cql_type == "varint" else struct.Struct(CQL_CODES[cql_type]).pack


def pack_varint(value: int) -> bytes:
    """Encode a value >= 0 as a CQL varint: two's complement in as few bytes as possible."""
    return value.to_bytes(value.bit_length() // 8 + 1, "big")


def pack_list(values: Sequence[bytes]) -> bytes:
    """Encode a list of encoded elements."""
    sizes = map(_pack_size, map(len, values))
    return _pack_size(len(values)) + b"".join(chain.from_iterable(zip(sizes, values)))


def split_list(raw: bytes) -> list[bytes]:
    """Return the encoded elements of a list; struct.error: the bytes are not a list."""
    (count,) = _unpack_size(raw, 0)
    values, end = [], 4
    for _ in range(count):
        at = end + 4
        end = at + _unpack_size(raw, end)[0]
        if not at <= end <= len(raw):
            raise struct.error("a list column has a malformed element")
        values.append(raw[at:end])
    if end != len(raw):
        raise struct.error("a list column has surplus bytes")
    return values


def pack_equal(size: int) -> Callable[[Sequence[bytes]], bytes]:
    """Return the encoder of a non-empty list whose encoded elements all have this size in bytes."""
    prefix = _pack_size(size)
    return lambda values: _pack_size(len(values)) + prefix + prefix.join(values)


def split_equal(size: int) -> Callable[[bytes], list[bytes]]:
    """Return the inverse of pack_equal; the function raises struct.error."""
    encode, unit = pack_equal(size), size + 4

    def split(raw: bytes) -> list[bytes]:
        if raw == EMPTY_LIST:
            return []
        values = [raw[at : at + size] for at in range(8, len(raw), unit)]
        if len(raw) % unit != 4 or encode(values) != raw:  # the last element may be cut short
            raise struct.error("a list column has a malformed element")
        return values

    return split


def unpack_numbers(fixed: FixedField) -> Callable[[bytes], Sequence[int]]:
    """Return the inverse of pack_numbers; the function raises struct.error and OverflowError."""
    if fixed.special == "uint64":
        return lambda raw: [_varint(value) for value in split_list(raw)]
    size, unpack = fixed.cql_size, struct.Struct(">i" + fixed.big).iter_unpack

    def split(raw: bytes) -> Sequence[int]:
        (count,) = _unpack_size(raw, 0)
        if len(raw) != 4 + count * (size + 4):
            raise struct.error("a list column has a malformed element")
        if not count:
            return ()
        sizes, values = zip(*unpack(raw[4:]))
        if sizes.count(size) != count:
            raise struct.error("a list column has a malformed element")
        return values

    convert = FROM_NS.get(fixed.special)
    return split if convert is None else lambda raw: list(map(convert, split(raw)))


def pack_numbers(fixed: FixedField, strict: bool) -> Callable[[Sequence[int]], bytes | None]:
    """Return the encoder of a list of numbers as on the wire.

    If strict, it returns None for a list with a number that the column cannot hold exactly.
    """
    size, special, convert = fixed.cql_size, fixed.special, TO_NS.get(fixed.special)
    if special == "uint64":
        return lambda values: pack_list([pack_varint(value) for value in values])
    pack = struct.Struct(">i" + fixed.big).pack

    def encode(values: Sequence[int]) -> bytes | None:
        if strict and special and not _are_exact(special, values):
            return None
        numbers = values if convert is None else map(convert, values)
        return _pack_size(len(values)) + b"".join(map(pack, repeat(size), numbers))

    return encode


def _are_exact(special: str, values: Sequence[int]) -> bool:
    """Return whether all bytes are bools, or all times and durations have nsecs below 10**9."""
    if special == "bool":
        return max(values, default=0) <= 1
    return all(0 <= value >> 32 < SECOND_NS for value in values)


def _time_to_ns(value: int) -> int:
    return (value & _LOW) * SECOND_NS + (value >> 32)


def _duration_to_ns(value: int) -> int:
    seconds = value & _LOW
    return (seconds - ((seconds & 0x80000000) << 1)) * SECOND_NS + (value >> 32)


def _ns_to_time(ns: int) -> int:
    seconds, rest = divmod(ns, SECOND_NS)
    if seconds >> 32:
        raise struct.error("a time is out of range")
    return rest << 32 | seconds


def _ns_to_duration(ns: int) -> int:
    seconds, rest = divmod(ns, SECOND_NS)
    if not -0x80000000 <= seconds <= 0x7FFFFFFF:
        raise struct.error("a duration is out of range")
    return rest << 32 | (seconds & _LOW)


TO_NS = {"time": _time_to_ns, "duration": _duration_to_ns}
"""Functions from a time as on the wire, read as one uint64 or int64, to ns; inverse of FROM_NS."""
FROM_NS = {"time": _ns_to_time, "duration": _ns_to_duration}


def compile_decoder(column: FieldColumn, specs: Specs) -> Decoder:
    """Return the function from a column to the value that queries compare and results show.

    Numbers are int or float, times int nanoseconds, text str (bytes that are not UTF-8 replaced),
    uint8[] and char[] bytes, other arrays lists, arrays of messages in an array lists of dicts,
    arrays of empty messages their number of elements. It raises struct.error and ValueError.
    """
    if column.is_list:
        element = compile_decoder(
            replace(column, cql_type=column.element_type, is_list=False), specs
        )
        return lambda raw: [element(value) for value in split_list(raw)]
    if column.kind == "text":
        return _text
    if column.kind == "bool":
        return lambda raw: raw != b"\0"
    if column.kind in ("array", "wire"):
        base, _, length = column.field_type[:-1].partition("[")
        if column.kind == "array":
            return lambda raw: _array(base, raw)
        field = Field("", base, True, int(length) if length else None)
        return lambda raw: _read(raw, 0, field, specs)[0]
    if column.field_type == "uint64":
        return _varint
    unpack = struct.Struct(CQL_CODES[column.element_type]).unpack
    return lambda raw: unpack(raw)[0]


def _varint(raw: bytes) -> int:
    return int.from_bytes(raw, "big", signed=True)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")


def _array(type_: str, raw: bytes) -> bytes | list[Any]:
    if type_ in ("uint8", "char"):
        return raw
    values = struct.unpack(f"<{len(raw) // PRIMITIVE_SIZES[type_]}{CODES[type_]}", raw)
    return list(map(TO_NS[type_], values)) if type_ in TO_NS else list(values)


def _read(wire: bytes, at: int, field: Field, specs: Specs) -> tuple[Any, int]:
    """Read a field as on the wire; return its value and the offset after it."""
    count = field.length if field.is_array else 1
    if count is None:
        (count,) = _length(wire, at)
        at += 4
    if field.type in CODES:
        end = at + count * PRIMITIVE_SIZES[field.type]
        values = _array(field.type, wire[at:end])
        return (values if field.is_array else values[0]), end
    if field.is_array and not field.is_primitive and fixed_size(field.type, specs) == 0:
        return count, at
    elements: list[Any] = []
    for _ in range(count):
        if field.type == "string":
            start = at + 4
            at = start + _length(wire, at)[0]
            elements.append(_text(wire[start:at]))
        else:
            message = {}
            for inner in specs[field.type].fields:
                message[inner.name], at = _read(wire, at, inner, specs)
            elements.append(message)
    return (elements if field.is_array else elements[0]), at
