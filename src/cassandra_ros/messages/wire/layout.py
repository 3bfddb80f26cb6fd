# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Layout of a message on the wire, and the column that holds each field.

A message is a sequence of segments. A segment is fields of fixed size, then at most one field of
variable size, whose length prefix belongs to the fixed part. Each segment is read and written
with one struct.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Iterator, NamedTuple

from cassandra_ros.messages.spec import Field, Specs
from cassandra_ros.messages.wire.field_ends import Skip, compile_field_skip, fixed_size


@dataclass(frozen=True)
class FieldColumn:
    """A column of format ``ros``, which holds one field."""

    name: str
    """Path of the field, as 'transform.translation.x' or 'transforms.child_frame_id'."""
    cql_type: str
    kind: str
    """Kind of value in the column, or in each element of its list:

    'int', 'float', 'bool', 'text', 'time', 'duration' (both in ns), 'array' (a blob of the
    elements as on the wire, without their number) or 'wire' (a blob of the whole field as on the
    wire; for an array of empty messages only their number).
    """
    field_type: str
    """ROS type of the field, as 'float64[9]'; in an array of messages, its type in one element."""
    is_list: bool = False
    """Whether the column is a frozen list: string[], or a field in an array of messages."""
    array: str = ""
    """Path of the array of messages whose elements the list follows, or ''."""

    @property
    def element_type(self) -> str:
        """CQL type of one value; for a list, of one element."""
        return self.cql_type[len("frozen<list<") : -2] if self.is_list else self.cql_type

    @property
    def is_scalar(self) -> bool:
        """Whether the column holds a single value, not a list or array."""
        return not self.is_list and self.kind not in ("array", "wire")


class FixedField(NamedTuple):
    """A field of fixed size."""

    column: FieldColumn
    little: str
    """struct code on the wire."""
    big: str
    """struct code of the same value in CQL."""
    cql_size: int
    special: str = ""
    """'time', 'duration', 'bool' or 'uint64' if more than the byte order changes between wire and
    CQL; else ''."""


@dataclass(frozen=True)
class VariableField:
    """A field of variable size (or an array of messages), which ends a segment."""

    kind: str
    """'bytes' (an array of numbers), 'text', 'texts' (string[]), 'elements' (an array of messages
    with a column for each of their fields) or 'wire' (any other array, see FieldColumn)."""
    skip: Skip
    """Function that finds the end of the field, its length prefix included."""
    columns: tuple[FieldColumn, ...]
    """Columns of the field, or of the fields of its elements."""
    unit: int = 1
    """Size of an element, bytes; for 'bytes' and 'text'."""
    length: int | None = None
    """Number of elements of a fixed array; None if the message carries it."""
    element: tuple[Segment, ...] = ()
    """Layout of one element; for 'elements'."""

    @property
    def has_count(self) -> bool:
        """Whether the fixed part of the segment ends with the length prefix of this field."""
        return self.length is None and self.kind != "wire"


class Segment(NamedTuple):
    """Fields of fixed size, then at most one field of variable size."""

    fixed: tuple[FixedField, ...]
    tail: VariableField | None


# ROS type -> struct code on the wire, struct code in CQL, CQL type, kind, special
_SCALARS = {
    "bool": ("B", "B", "boolean", "bool", "bool"),
    "int8": ("b", "b", "tinyint", "int", ""),
    "uint8": ("B", "h", "smallint", "int", ""),
    "int16": ("h", "h", "smallint", "int", ""),
    "uint16": ("H", "i", "int", "int", ""),
    "int32": ("i", "i", "int", "int", ""),
    "uint32": ("I", "q", "bigint", "int", ""),
    "int64": ("q", "q", "bigint", "int", ""),
    "uint64": ("Q", "Q", "varint", "int", "uint64"),
    # Floats are copied as integers: a Python float would change signalling NaNs to quiet ones.
    "float32": ("I", "I", "float", "float", ""),
    "float64": ("Q", "Q", "double", "float", ""),
    "time": ("Q", "q", "bigint", "time", "time"),
    "duration": ("q", "q", "bigint", "duration", "duration"),
}


def layout(
    msg_type: str, specs: Specs, prefix: str = "", inside: bool = False
) -> tuple[Segment, ...]:
    """Return the segments of a checked message type; ``prefix`` and ``inside`` as in _items."""
    segments: list[Segment] = []
    fixed: list[FixedField] = []
    for item in _items(msg_type, specs, prefix, inside):
        if isinstance(item, FixedField):
            fixed.append(item)
        else:
            segments.append(Segment(tuple(fixed), item))
            fixed = []
    if fixed:
        segments.append(Segment(tuple(fixed), None))
    return tuple(segments)


def columns_of(segments: tuple[Segment, ...]) -> Iterator[tuple[FieldColumn, int | None]]:
    """Yield all columns in wire order with their size in CQL in bytes, None if it varies."""
    for segment in segments:
        for fixed in segment.fixed:
            yield fixed.column, None if fixed.special == "uint64" else fixed.cql_size
        if segment.tail is not None:
            yield from ((column, None) for column in segment.tail.columns)


def element_of(column: FieldColumn) -> FixedField:
    """Return the layout of one element of a primitive array, and the column that would hold it."""
    return _fixed(column.name, Field(column.name, column.field_type.partition("[")[0]))


def _items(
    msg_type: str, specs: Specs, prefix: str, inside: bool
) -> Iterator[FixedField | VariableField]:
    """Yield the fields of the message at path ``prefix`` ('' or 'a.b.') in wire order.

    If ``inside`` (an element of an array of messages), arrays are stored as blobs.
    """
    for field in specs[msg_type].fields:
        name = prefix + field.name
        if field.is_array:
            yield from _array(name, field, specs, inside)
        elif field.type == "string":
            column = FieldColumn(name, "text", "text", "string")
            yield VariableField("text", compile_field_skip(field, specs), (column,))
        elif field.is_primitive:
            yield _fixed(name, field)
        else:
            yield from _items(field.type, specs, name + ".", inside)


def _fixed(name: str, field: Field) -> FixedField:
    little, big, cql_type, kind, special = _SCALARS[field.base]
    column = FieldColumn(name, cql_type, kind, field.type)
    return FixedField(column, little, big, struct.calcsize(">" + big), special)


def _array(
    name: str, field: Field, specs: Specs, inside: bool
) -> Iterator[FixedField | VariableField]:
    """Yield an array field, or nothing if it has no bytes on the wire."""
    length, unit = field.length, fixed_size(field.type, specs)
    skip = compile_field_skip(field, specs)
    if length is not None and 0 in (length, unit):
        return  # an array without bytes gets no column
    column = FieldColumn(name, "blob", "wire", field.full_type)
    if unit and field.is_primitive:
        column = replace(column, kind="array")
        if length is None:
            yield VariableField("bytes", skip, (column,), unit)
        else:
            yield FixedField(column, f"{length * unit}s", f"{length * unit}s", length * unit)
    elif inside or unit == 0:
        yield VariableField("wire", skip, (column,), length=length)
    elif field.is_primitive:
        column = FieldColumn(name, "frozen<list<text>>", "text", field.full_type, True)
        yield VariableField("texts", skip, (column,), length=length)
    else:
        element = layout(field.type, specs, name + ".", True)
        columns = tuple(
            replace(c, cql_type=f"frozen<list<{c.cql_type}>>", is_list=True, array=name)
            for c, _ in columns_of(element)
        )
        yield VariableField("elements", skip, columns, length=length, element=element)
