# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Types of the values of a field in a table: the primitive type, and the arrays around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.name_resolution import ResultColumn
from cassandra_ros.query.rows.projection import Projection, Projections
from cassandra_ros.query.rows.result_groups import analyse_select
from cassandra_ros.query.tree.expressions import INTEGER
from cassandra_ros.query.tree.field_names import Array, FieldRef
from cassandra_ros.query.tree.syntax import Select

if TYPE_CHECKING:
    AnyType = np.dtype[Any]

AnyArray = NDArray[Any]
Typed = Tuple[str, "ArrayType"]
"""Name and type of a column."""

MIXED = "mixed"
"""Kind of values of several types that no numeric type holds exactly."""
_MANTISSA = {"float32": 24, "float64": 53}
"""Number of bits of the integers that a float type holds exactly."""


@dataclass(frozen=True)
class ArrayType:
    """The type of a column."""

    kind: str
    """Primitive ROS type; 'mixed' if the definitions of a topic disagree, 'sum' for computed
    integers of any size."""
    depth: int = 0
    """Number of arrays around a value."""
    length: int | None = None
    """Number of elements of the array, if there is one array, of fixed length."""

    @property
    def dtype(self) -> AnyType:
        """Type in numpy of one value; times and durations are integer nanoseconds."""
        if self.kind in ("time", "duration"):
            return np.dtype(np.int64)
        return np.dtype(object if self.kind in ("string", MIXED, INTEGER) else self.kind)

    @property
    def cells(self) -> bool:
        """Whether each row holds an array of its own, as an object."""
        return self.depth > 1 or (self.depth == 1 and self.length is None)


def _type_of(output: ResultColumn, table: Table, unnested: Sequence[Array]) -> ArrayType:
    """Return the type of a column, without the arrays of messages that are unnested."""
    ref, definition = output.ref, table.definition
    if ref is None or definition is None:
        return ArrayType(output.kind)
    return type_of_field(ref, definition, unnested)


def type_of_field(
    ref: FieldRef, definition: Definition, unnested: Sequence[Array] = ()
) -> ArrayType:
    """Return the type of a field, without the arrays of messages that are unnested."""
    fields, msg_type = [], definition.type
    for step in ref.steps:
        fields.append(next(f for f in definition.specs[msg_type].fields if f.name == step.name))
        msg_type = fields[-1].type
    lengths = [
        field.length
        for n, (step, field) in enumerate(zip(ref.steps, fields))
        if step.many and step.index is None and ref.steps[: n + 1] not in unnested
    ]
    if ref.is_array:
        lengths.append(fields[-1].length)
    # nsecs over a second are carried to the seconds, which may then exceed 32 bits.
    kind = "int64" if ref.part else ref.type
    return ArrayType(kind, len(lengths), lengths[0] if len(lengths) == 1 else None)


def group_types(projection: Projection, table: Table) -> list[list[Typed]]:
    """Return name and type of the columns of a table, for each selected path."""
    unnested = projection.unnested
    return [[(o.name, _type_of(o, table, unnested)) for o in group] for group in projection.groups]


def column_types(select: Select, tables: Sequence[Table]) -> list[Typed]:
    """Return name and type of each column of the result of a statement on a topic's tables.

    A column that no table has is MIXED.
    """
    select = replace(analyse_select(select, tables), hidden=())
    projections = Projections(select, tables)
    types = dict(unite_columns([group_types(projections.of(table), table) for table in tables]))
    names = chain.from_iterable(projections.names)
    return [(name, types.get(name, ArrayType(MIXED))) for name in names]


def unite_columns(tables: Sequence[Sequence[Sequence[Typed]]]) -> list[Typed]:
    """Return name and type of all tables' columns, path by path; of each table see group_types."""
    columns: list[Typed] = []
    for groups in zip(*tables):
        names: dict[str, list[ArrayType]] = {}
        for name, kind in chain.from_iterable(groups):
            names.setdefault(name, []).append(kind)
        columns += [(name, unite_types(kinds)) for name, kinds in names.items()]
    return columns


def unite_types(types: Sequence[ArrayType]) -> ArrayType:
    """Return a type that holds the values of all given types exactly."""
    common = types[0]
    for other in types[1:]:
        if other.depth != common.depth:
            return ArrayType(MIXED)
        if other.length != common.length:
            common, other = replace(common, length=None), replace(other, length=None)
        if other.kind != common.kind:
            common = replace(common, kind=_wider(common.kind, other.kind))
    return common


def _wider(kind: str, other: str) -> str:
    """Return the kind of numbers that holds two other kinds exactly, or MIXED."""
    try:
        wider = np.promote_types(kind, other)
        whole = [d for d in map(np.dtype, (kind, other)) if d.kind in "iu"]
    except TypeError:
        return MIXED
    exact = wider.kind != "f" or all(8 * d.itemsize <= _MANTISSA[wider.name] for d in whole)
    return wider.name if exact and "bool" not in (kind, other) else MIXED
