# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The field by which the messages of a topic are found (key format ``msg_part``)."""

from __future__ import annotations

import hashlib
import json
import struct
from decimal import Decimal
from typing import Any, Iterator

from cassandra_ros.arguments import plain_value
from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import MAX_INDEXED_TEXT_BYTES, nearest_fields, normal_float
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES
from cassandra_ros.messages.stamps import seconds_to_ns
from cassandra_ros.messages.wire.cql_values import Primitive, encode_value, pack_list
from cassandra_ros.messages.wire.wire_plan import wire_plan

_BEYOND = {"int": struct.error, "float": OverflowError}
"""Exception for a number outside the range of its column, by kind: no message has such a value."""


class KeyPart:
    """The key field of a message type: reads it from messages and encodes it for the index.

    Attributes:
        field: Dotted path of the field, as 'header.stamp'.
        digest: Whether the field is an array; the index then holds the md5 of all its elements, as
            text.
        is_time: Whether the field is a time; rows are then sorted by it.
        is_text: Whether the field is a text; any typed text can then be its value.
        cql_type: CQL type of the column that carries the index.

    Raises:
        InvalidKey: There is no such field, or it has more than one value.
    """

    def __init__(self, definition: Definition, field: str) -> None:
        plan, name = wire_plan(definition), definition.type
        column = plan.column(field)
        if column is None:
            hint = nearest_fields(field, sorted(leaf.name for leaf in plan.all_columns))
            raise InvalidKey(f"{name} has no field {field!r} that could be a key; {hint}")
        if column.array or column.kind == "wire":
            why = "it has many values, and a key is one; choose another field for key_part"
            raise InvalidKey(f"field {field} of {name} lies in an array of messages: {why}")
        self.field = field
        self._column = column
        self._pick = plan.picker(field)
        self.digest = column.is_list or column.kind == "array"
        self.is_time = column.kind == "time" and not column.is_list
        self.is_text = column.kind == "text" and not self.digest
        self.cql_type = "text" if self.digest else column.cql_type

    def time(self, wire: bytes) -> int | None:
        """Return the time in a message, ns; None if a column cannot hold it."""
        raw = self._pick(wire)
        return None if raw is None else int.from_bytes(raw, "big", signed=True)

    def value(self, wire: bytes) -> bytes | None:
        """Return the field of a message, encoded so that equal values have equal bytes.

        None: a column cannot hold it (see WirePlan.picker), or it is NaN, which no value equals.
        """
        raw = self._pick(wire)
        return None if raw is None else self._normal(raw)

    def index(self, value: bytes) -> bytes | None:
        """Return the index entry of an encoded value; None if the value is not indexed."""
        if self.digest:
            return hashlib.md5(value).hexdigest().encode("ascii")
        return None if len(value) > MAX_INDEXED_TEXT_BYTES else value

    def encode(self, value: object) -> bytes | None:
        """Encode a Python value to compare it with ``value``; None: no message can have this value.

        Raises:
            InvalidKey: The value is of another type than the field.
        """
        try:
            raw = self._encode(plain_value(value))
        except (TypeError, ValueError, ArithmeticError, struct.error) as exc:
            what = (
                f"field {self.field}, a {self._column.field_type}; {value!r:.80} is no such value"
            )
            raise InvalidKey(f"the key of these messages is their {what}") from exc
        return None if raw is None else self._normal(raw)

    def from_text(self, text: str) -> object:
        """Parse a typed value of the field; InvalidKey: the text is not a value of its type."""
        kind = "list" if self.digest else self._column.kind
        try:
            if kind == "bool":
                return {"true": True, "false": False}[text.strip().lower()]
            # A float would round the nanoseconds of a time.
            exact = Decimal if kind in ("time", "duration") else None
            return text if kind == "text" else json.loads(text, parse_float=exact)
        except (KeyError, ValueError, RecursionError) as exc:
            what = f"no value of the key field {self.field}, a {self._column.field_type}"
            raise InvalidKey(f"{text!r:.80} is {what}") from exc

    def _encode(self, value: object) -> bytes | None:
        """Encode a value as ``encode`` does, but not normalised; it raises what that catches."""
        column = self._column
        if column.is_list:
            texts = [_plain("text", text) for text in _elements(value)]
            return pack_list([encode_value("text", text) for text in texts])
        if column.kind == "array":
            return _array(column.field_type, value)
        try:
            return encode_value(column.cql_type, _plain(column.kind, value))
        except (struct.error, OverflowError) as exc:
            if isinstance(exc, _BEYOND.get(column.kind, ())):
                return None
            raise

    def _normal(self, raw: bytes) -> bytes | None:
        """Return encoded bytes so that equal values have equal ones; None for NaN."""
        is_float = self._column.kind == "float" and not self.digest
        return normal_float(self._column.cql_type, raw) if is_float else raw


def _plain(kind: str, value: Any) -> Primitive:
    """Return a given value as a Python value of a column's kind; times and durations as ns.

    It raises what ``encode`` catches.
    """
    if kind in ("bool", "text"):
        if not isinstance(value, bool if kind == "bool" else str):
            raise TypeError(value)
        return value
    if isinstance(value, (bool, str, bytes)):
        raise TypeError(value)
    if kind == "float":
        return float(value)  # 0.1 means the nearest float32
    if kind == "int":
        if int(value) != value:
            raise ValueError(value)
        return int(value)
    ns = value.to_nsec() if hasattr(value, "to_nsec") else value
    if isinstance(ns, (float, Decimal)):
        ns = seconds_to_ns(ns)
    if isinstance(ns, bool) or not isinstance(ns, int):
        raise TypeError(value)
    return ns


def _array(field_type: str, value: object) -> bytes | None:
    """Encode a primitive array as on the wire; None if it has not the length of a fixed array."""
    base, _, length = field_type[:-1].partition("[")
    if base in ("uint8", "char") and isinstance(value, (bytes, bytearray)):
        raw = bytes(value)
    else:
        values = list(_elements(value))
        raw = struct.pack(f"<{len(values)}{CODES[base]}", *values)
    return raw if not length or len(raw) == int(length) * PRIMITIVE_SIZES[base] else None


def _elements(value: Any) -> Iterator[Any]:
    """Return an iterator over a list; TypeError: it is a text, or no list."""
    if isinstance(value, (str, bytes)):
        raise TypeError(value)
    return iter(value)
