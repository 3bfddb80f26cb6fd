# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The field by which the messages of a topic are found (key format ``msg_part``)."""

from __future__ import annotations

import hashlib
import json
import struct
from decimal import Decimal
from typing import Any, Callable, Optional

from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import MAX_TEXT_BYTES, nearestFields, normalFloat
from cassandra_ros.messages.wire.lists import packList, packVarint
from cassandra_ros.messages.wire.plan import Column, wirePlan
from cassandra_ros.messages.wire.values import CODES, CQL_CODES

Encode = Callable[[Any], Optional[bytes]]


class KeyPart:
    """One field of a message type: its value in a message, and what finds it in an index.

    Args:
        definition: Of the type.
        field: Dotted path of the field, as 'header.stamp'.

    Attributes:
        digest: The field is an array, and the index holds the md5 of the whole.
        is_time: The field is a time: rows lie by it, in its order.
        is_text: The field is a text: whatever a person types can be its value.
        cql_type: Of the column that carries the index.

    Raises:
        InvalidKey: There is no such field, or it is not one value.
    """

    def __init__(self, definition: Definition, field: str) -> None:
        plan = wirePlan(definition)
        columns = {column.name: column for column in plan.all_columns}
        column = columns.get(field)
        if column is None:
            raise InvalidKey(
                f"{definition.type} has no field {field!r} that could be a key; "
                f"{nearestFields(field, sorted(columns))}"
            )
        if column.array or column.kind == "wire":
            raise InvalidKey(
                f"field {field} of {definition.type} lies in an array of messages: it has many "
                "values, and a key is one; choose another field for key_part"
            )
        self.field = field
        self._column = column
        self._pick = plan.picker(field)
        self.digest = column.is_list or column.kind == "array"
        self._encode = _encoder(column)
        self.is_time = column.kind == "time" and not column.is_list
        self.is_text = column.kind == "text" and not self.digest
        self.cql_type = "text" if self.digest else column.cql_type

    def time(self, wire: bytes) -> int | None:
        """Return the time in a message, ns; None where it has none that columns can hold."""
        raw = self._pick(wire)
        return None if raw is None else int.from_bytes(raw, "big", signed=True)

    def value(self, wire: bytes) -> bytes | None:
        """Return the value in a message, such that equal values are equal bytes."""
        raw = self._pick(wire)
        return None if raw is None else self._normal(raw)

    def index(self, value: bytes) -> bytes | None:
        """Return what the index holds of a value; None where it holds nothing."""
        if self.digest:
            return hashlib.md5(value).hexdigest().encode("ascii")
        return None if len(value) > MAX_TEXT_BYTES else value

    def encode(self, value: Any) -> bytes | None:
        """Return the value that somebody asks for as ``value`` does; None: no message has it.

        Raises:
            InvalidKey: It is of another kind than the field.
        """
        try:
            raw = self._encode(value)
        except (TypeError, ValueError, ArithmeticError, struct.error) as exc:
            raise InvalidKey(
                f"the key of these messages is their field {self.field}, a "
                f"{self._column.field_type}; {value!r:.80} is none"
            ) from exc
        return None if raw is None else self._normal(raw)

    def fromText(self, text: str) -> Any:
        """Read a value of the field that a person typed.

        Raises:
            InvalidKey: The text is none.
        """
        kind = "list" if self.digest else self._column.kind
        try:
            if kind == "bool":
                return {"true": True, "false": False}[text.strip().lower()]
            if kind == "text":
                return text
            return json.loads(text)
        except (KeyError, ValueError, RecursionError) as exc:
            raise InvalidKey(
                f"{text!r:.80} is no value of the key field {self.field}, a "
                f"{self._column.field_type}"
            ) from exc

    def _normal(self, raw: bytes) -> bytes | None:
        if self._column.kind != "float" or self.digest:
            return raw
        return normalFloat(self._column.cql_type, raw)


def _encoder(column: Column) -> Encode:
    if column.is_list:
        return lambda value: packList([_text(text) for text in _elements(value)])
    if column.kind == "array":
        return _array(column.field_type)
    if column.kind == "int":
        return _integer(column)
    if column.kind == "float":
        return _float(column)
    return {"bool": _bool, "text": _text, "time": _duration, "duration": _duration}[column.kind]


def _integer(column: Column) -> Encode:
    code = CQL_CODES.get(column.cql_type)

    def encode(value: Any) -> bytes | None:
        number = int(value)
        if isinstance(value, (bool, str, bytes)) or number != value:
            raise ValueError(value)
        if code is None:
            return packVarint(number) if number >= 0 else None
        try:
            return struct.pack(code, number)
        except struct.error:
            return None

    return encode


def _float(column: Column) -> Encode:
    code = CQL_CODES[column.cql_type]

    def encode(value: Any) -> bytes | None:
        if isinstance(value, (bool, str, bytes)):
            raise TypeError(value)
        try:
            return struct.pack(code, float(value))  # 0.1 means the float32 that is nearest
        except OverflowError:
            return None

    return encode


def _bool(value: Any) -> bytes:
    if not isinstance(value, bool):
        raise TypeError(value)
    return b"\1" if value else b"\0"


def _text(value: Any) -> bytes:
    if not isinstance(value, str):
        raise TypeError(value)
    return value.encode("utf-8")


def _duration(value: Any) -> bytes:
    ns = value.to_nsec() if hasattr(value, "to_nsec") else value
    if isinstance(ns, float):
        ns = round(Decimal(repr(ns)) * 10**9)
    if isinstance(ns, bool) or not isinstance(ns, int):
        raise TypeError(value)
    return struct.pack(">q", ns)


def _array(field_type: str) -> Encode:
    base, _, length = field_type.partition("[")
    count = int(length[:-1]) if length[:-1] else None

    def encode(value: Any) -> bytes | None:
        if base in ("uint8", "char") and isinstance(value, (bytes, bytearray)):
            raw = bytes(value)
            number = len(raw)
        else:
            values = list(_elements(value))
            number = len(values)
            raw = struct.pack(f"<{number}{CODES[base]}", *values)
        return raw if count in (None, number) else None

    return encode


def _elements(value: Any) -> Any:
    if isinstance(value, (str, bytes)):
        raise TypeError(value)
    return iter(value)
