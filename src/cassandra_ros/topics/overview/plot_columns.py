# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Columns of a statement that can be drawn over time: one number per message."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType, group_types
from cassandra_ros.query.arrays.column_values import ColumnArray
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.name_resolution import ResultColumn
from cassandra_ros.query.rows.projection import Projections
from cassandra_ros.query.tree.field_names import FieldRef
from cassandra_ros.query.tree.syntax import (
    Aggregate,
    FieldPath,
    KeyOperand,
    PathPart,
    Select,
    Selected,
    Term,
)
from cassandra_ros.query.tree.units import SECONDS, unit_of

MAX_COLUMNS = 24
"""Maximum number of lines drawn for one statement."""


class Column(NamedTuple):
    """A column that is drawn."""

    name: str
    unit: str
    """Unit of its values; '' = unknown."""
    what: Term | Aggregate


class OmittedColumn(NamedTuple):
    """A column that is not drawn, and the reason."""

    name: str
    reason: str


class PlotColumns(NamedTuple):
    """The columns of a statement, divided into those that are drawn and those that are not."""

    columns: tuple[Column, ...]
    left_out: tuple[OmittedColumn, ...]


def drawn_columns(select: Select, tables: Sequence[Table]) -> PlotColumns:
    """Divide the columns of a statement, without KEY, into those that can be drawn and others.

    Raises:
        InvalidQuery: The statement names a field that the topic does not have.
    """
    columns: list[Column] = []
    left_out: list[OmittedColumn] = []
    for name, source in _columns(select, tables).items():
        output, kind, table, selected = source
        reason = _reason(kind)
        if reason:
            left_out.append(OmittedColumn(name, reason))
        elif len(columns) == MAX_COLUMNS:
            left_out.append(OmittedColumn(name, f"more than {MAX_COLUMNS} columns are too many"))
        else:
            what = _what(output, selected)
            unit = "" if table.definition is None else unit_of(what, table.definition)
            columns.append(Column(name, SECONDS if kind.kind == "duration" else unit, what))
    return PlotColumns(tuple(columns), tuple(left_out))


_ColumnSource = Tuple[ResultColumn, ArrayType, Table, Optional[Selected]]
"""A column in a table, its type there, the table, and its item in the statement (None = ``*``)."""


def _columns(select: Select, tables: Sequence[Table]) -> dict[str, _ColumnSource]:
    """Return each column by its name, as it is in the first table that has it."""
    columns: dict[str, _ColumnSource] = {}
    projections = Projections(replace(select, hidden=()), tables)
    # In the order of the selection, because a table may have fields that others lack.
    for n, selected in enumerate(select.visible):
        if selected is not None and isinstance(selected.what, KeyOperand):
            continue
        for table in tables:
            projection = projections.of(table)
            kinds = group_types(projection, table)[n]
            for output, (name, kind) in zip(projection.groups[n], kinds):
                columns.setdefault(name, (output, kind, table, selected))
    return columns


def _what(output: ResultColumn, selected: Selected | None) -> Term | Aggregate:
    """Return the term of one column; of SELECT * the path of its field."""
    if selected is not None and not selected.is_path:
        return selected.what
    if output.ref is None:
        raise AssertionError("what is not a term is a field")
    return path_of(output.ref)


def path_of(ref: FieldRef) -> FieldPath:
    """Return the path that names a field."""
    parts = [PathPart(step.name, step.index, 0) for step in ref.steps]
    parts[-1] = replace(parts[-1], index=ref.index)
    return FieldPath((*parts, *([PathPart(ref.part, None, 0)] if ref.part else ())), 0)


def _reason(kind: ArrayType) -> str:
    """Return the reason for which a column cannot be drawn; '' = it can."""
    if kind.depth:
        return "an array: name one of its elements, or min, max, avg or len of it"
    if kind.kind == "time":
        return "a time: the difference of two is a number"
    return "text" if kind.kind == "string" else ""


def as_floats(column: ColumnArray, kind: ArrayType) -> AnyArray:
    """Return the values of a column as float64; NaN for missing values and for other types."""
    values, missing = column
    if values.dtype.kind == "O":
        floats = np.fromiter(map(as_float, values.tolist()), np.float64, len(values))
    else:
        floats = values.astype(np.float64)
        if kind.kind == "duration":
            floats /= SECOND_NS
    if missing.any():
        floats[missing] = np.nan
    return floats


def as_float(value: object) -> float:
    """Return a result value as a number, a duration in seconds; NaN for any other type."""
    if isinstance(value, (int, float)):
        try:
            return float(value)
        except OverflowError:  # an integer larger than any float
            return float("inf") if value > 0 else float("-inf")
    to_nsec = getattr(value, "to_nsec", None)
    return float("nan") if to_nsec is None else float(to_nsec()) / SECOND_NS
