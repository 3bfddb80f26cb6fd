# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""An indexed field of a message type: the value of its shadow column for a message.

An index must never hide a row. Some values cannot be indexed so that the server finds them as the
query language compares them (NaN, long texts, long arrays, values that no column holds exactly).
These are left out, and their rows are marked odd: queries read the odd rows in addition.
"""

from __future__ import annotations

import difflib
import struct
from typing import Callable, List, Optional, Sequence

from cassandra_ros.errors import InvalidName
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.cql_values import CQL_CODES, pack_list, pack_numbers, split_list
from cassandra_ros.messages.wire.layout import FieldColumn, FixedField, element_of
from cassandra_ros.messages.wire.wire_plan import wire_plan

MAX_INDEXED_TEXT_BYTES = 1024
"""Maximum size of an indexed text, bytes. Cassandra refuses rows with indexed texts over 8 KiB."""
MAX_ELEMENTS = 256
"""Maximum number of elements of an indexed array."""

_Split = Callable[[bytes], Optional[List[bytes]]]
"""Function from a column to the encoded values in it; None if they cannot all be indexed."""


class IndexField:
    """One indexed field of a message type.

    Attributes:
        field: Dotted path of the field, as 'linear.x' or 'transforms.child_frame_id'.
        shadow: Name of the column that carries the index.
        element_type: CQL type of one value.
        kind: Kind of one value as in FieldColumn, but never 'array'.
        many: Whether the column is a set of values: the field is an array, or lies in an array of
            messages.
        cql_type: CQL type of the shadow column.

    Raises:
        InvalidName: There is no such field, or it cannot be indexed. The text names similar fields.
    """

    def __init__(self, definition: Definition, field: str, shadow: str) -> None:
        plan = wire_plan(definition)
        column = plan.column(field)
        if column is None or _is_nested(column):
            able = [leaf.name for leaf in plan.all_columns if not _is_nested(leaf)]
            hint = nearest_fields(field, able)
            if column is None:
                raise InvalidName(f"{definition.type} has no field {field!r} to index; {hint}")
            why = "it is an array inside of an array of messages, which its column holds as bytes"
            what = f"field {field} of {definition.type} cannot be indexed"
            raise InvalidName(f"{what}: {why}; {hint}")
        self.field = field
        self.shadow = shadow
        self._pick = plan.picker(field)
        self.many = column.is_list or column.kind == "array"
        self.element_type, self.kind = column.element_type, column.kind
        self._split: _Split = _split_column
        if column.kind == "array":
            one = element_of(column)
            self.element_type, self.kind = one.column.cql_type, one.column.kind
            self._split = _split_numbers(one)
        self.cql_type = f"set<{self.element_type}>" if self.many else self.element_type

    def value(self, wire: bytes) -> tuple[bytes | None, bool]:
        """Return the encoded shadow column of a message (None = unset), and whether the row is odd.

        A row is odd if its field has a value that the column does not hold.
        """
        raw = self._pick(wire)
        if raw is None:
            return None, True
        if not self.many:
            value = self.normal(raw)
            return value, value is None
        values = self._split(raw)
        if values is None:
            return None, True
        # A set is encoded like a list; an empty set would write a tombstone.
        normal_values = [value for value in map(self.normal, values) if value is not None]
        if len(normal_values) < len(values):
            return None, True
        return (pack_list(list(dict.fromkeys(normal_values))) if normal_values else None), False

    def normal(self, raw: bytes) -> bytes | None:
        """Return one encoded value so that equal ones have equal bytes; None: it is not indexed."""
        if self.kind == "float":
            return normal_float(self.element_type, raw)
        return None if len(raw) > MAX_INDEXED_TEXT_BYTES else raw


def normal_float(cql_type: str, raw: bytes) -> bytes | None:
    """Return an encoded float so that equal ones have equal bytes (−0.0 as 0.0); None for NaN."""
    (number,) = struct.unpack(CQL_CODES[cql_type], raw)
    if number != number:
        return None  # NaN is equal to nothing
    return raw if number else bytes(len(raw))


def nearest_fields(field: str, able: Sequence[str]) -> str:
    """Return the fields that may have been meant, as the end of an error text."""
    inside = [name for name in able if name.startswith(field + ".")]
    if inside:
        return f"it is a message, name one of its fields, like {' or '.join(inside[:3])}"
    near = difflib.get_close_matches(field, able, n=3, cutoff=0.5)
    near = near or [name for name in able if name.rsplit(".", 1)[-1] == field.rsplit(".", 1)[-1]]
    return f"did you mean {', '.join(near[:3])}?" if near else f"its fields: {', '.join(able[:20])}"


def _is_nested(column: FieldColumn) -> bool:
    """Return whether a column holds arrays inside an array of messages, or only their number."""
    return column.kind == "wire" or (column.is_list and column.kind == "array")


def _split_column(raw: bytes) -> list[bytes] | None:
    """Return the elements of a list column; None: they are more than MAX_ELEMENTS."""
    return None if int.from_bytes(raw[:4], "big") > MAX_ELEMENTS else split_list(raw)


def _split_numbers(fixed: FixedField) -> _Split:
    """Return the _Split of a column with an array of numbers as on the wire."""
    unit, encode = struct.calcsize("<" + fixed.little), pack_numbers(fixed, True)

    def split(raw: bytes) -> list[bytes] | None:
        count = len(raw) // unit
        if count > MAX_ELEMENTS:
            return None
        packed = encode(struct.unpack(f"<{count}{fixed.little}", raw))
        return None if packed is None else split_list(packed)

    return split
