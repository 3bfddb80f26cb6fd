# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From the bytes of a column to the value that a query compares and a person reads."""

from __future__ import annotations

import struct
from typing import Any, Callable, Mapping

from cassandra_ros.messages.spec import Field, MessageSpec
from cassandra_ros.messages.wire.layout import Column
from cassandra_ros.messages.wire.lists import durationToNs, splitList, timeToNs
from cassandra_ros.messages.wire.skip import fixedSize

Decoder = Callable[[bytes], Any]

CODES = {
    "bool": "?",
    "int8": "b",
    "byte": "b",
    "uint8": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
    "time": "Q",
    "duration": "q",
}
"""struct codes of primitive types on the wire."""
CQL_CODES = {
    "tinyint": ">b",
    "smallint": ">h",
    "int": ">i",
    "bigint": ">q",
    "float": ">f",
    "double": ">d",
}
_length = struct.Struct("<I").unpack_from


def compileDecoder(column: Column, specs: Mapping[str, MessageSpec]) -> Decoder:
    """Return the function that decodes a column.

    Numbers are int or float, times int nanoseconds, text str (bytes that are not UTF-8 replaced),
    uint8[] and char[] bytes, other arrays lists, arrays of messages in an array lists of dicts,
    arrays of empty messages their number. It raises struct.error and ValueError.
    """
    element = _element(column, specs)
    if not column.is_list:
        return element
    return lambda raw: [element(value) for value in splitList(raw)]


def _element(column: Column, specs: Mapping[str, MessageSpec]) -> Decoder:
    if column.kind == "text":
        return _text
    if column.kind == "bool":
        return lambda raw: raw != b"\0"
    if column.kind in ("array", "wire"):
        base, bracket, length = column.field_type.partition("[")
        field = Field("", base, True, int(length[:-1]) if length[:-1] else None)
        if column.kind == "array":
            return lambda raw: _numbers(field.type, raw)
        return lambda raw: _read_field(raw, 0, field, specs)[0]
    if column.field_type == "uint64":
        return lambda raw: int.from_bytes(raw, "big", signed=True)
    cql_type = column.cql_type.replace("frozen<list<", "").rstrip(">")
    unpack = struct.Struct(CQL_CODES[cql_type]).unpack
    return lambda raw: unpack(raw)[0]


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")


def _numbers(type_: str, raw: bytes) -> Any:
    if type_ in ("uint8", "char"):
        return raw
    code = CODES[type_]
    values = struct.unpack(f"<{len(raw) // struct.calcsize('<' + code)}{code}", raw)
    if type_ == "time":
        return [timeToNs(value) for value in values]
    if type_ == "duration":
        return [durationToNs(value) for value in values]
    return list(values)


def _read_field(
    wire: bytes, at: int, field: Field, specs: Mapping[str, MessageSpec]
) -> tuple[Any, int]:
    if not field.is_array:
        return _read_one(wire, at, field, specs)
    count = field.length
    if count is None:
        (count,) = _length(wire, at)
        at += 4
    if field.type in CODES:
        end = at + count * struct.calcsize("<" + CODES[field.type])
        return _numbers(field.type, wire[at:end]), end
    if not field.is_primitive and fixedSize(field.type, specs) == 0:
        return count, at
    values = []
    one = Field(field.name, field.type)
    for _ in range(count):
        value, at = _read_one(wire, at, one, specs)
        values.append(value)
    return values, at


def _read_one(
    wire: bytes, at: int, field: Field, specs: Mapping[str, MessageSpec]
) -> tuple[Any, int]:
    if field.type == "string":
        end = at + 4 + _length(wire, at)[0]
        return _text(wire[at + 4 : end]), end
    if field.is_primitive:
        (value,) = struct.unpack_from("<" + CODES[field.type], wire, at)
        if field.type in ("time", "duration"):
            value = timeToNs(value) if field.type == "time" else durationToNs(value)
        return value, at + struct.calcsize("<" + CODES[field.type])
    values: dict[str, Any] = {}
    for inner in specs[field.type].fields:
        values[inner.name], at = _read_field(wire, at, inner, specs)
    return values, at
