# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which columns of a statement can be drawn over time: its numbers, one a message."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from cassandra_ros.arrays.array_types import AnyArray, ArrayType, group_types
from cassandra_ros.arrays.column_values import Values
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.name_resolution import Output
from cassandra_ros.query.rows.projection import Projections
from cassandra_ros.query.tree.field_names import FieldRef
from cassandra_ros.query.tree.syntax import (
    Aggregate,
    KeyOperand,
    Part,
    Path,
    Select,
    Selected,
    Term,
)
from cassandra_ros.query.tree.units import SECONDS, unit_of

MAX_COLUMNS = 24
"""So many lines are drawn of a statement."""


class Column(NamedTuple):
    """A column that is drawn."""

    name: str
    unit: str
    """'' = none is known."""
    what: Union[Term, Aggregate]


class Undrawn(NamedTuple):
    """A column that is not drawn."""

    name: str
    reason: str


class Drawn(NamedTuple):
    """The columns of a statement."""

    columns: Tuple[Column, ...]
    left_out: Tuple[Undrawn, ...]


def drawn_columns(select: Select, tables: Sequence[Table]) -> Drawn:
    """Divide the columns that a statement shows, but for KEY: those that are numbers, and others.

    Raises:
        InvalidQuery: The statement names what the topic has not.
    """
    columns: list[Column] = []
    left_out: list[Undrawn] = []
    for name, found in _columns(select, tables).items():
        output, kind, table, selected = found
        reason = _reason(kind)
        if reason:
            left_out.append(Undrawn(name, reason))
        elif len(columns) == MAX_COLUMNS:
            left_out.append(Undrawn(name, f"more than {MAX_COLUMNS} columns are too many"))
        else:
            what = _what(output, selected)
            unit = "" if table.definition is None else unit_of(what, table.definition)
            columns.append(Column(name, SECONDS if kind.kind == "duration" else unit, what))
    return Drawn(tuple(columns), tuple(left_out))


_Found = Tuple[Output, ArrayType, Table, Optional[Selected]]


def _columns(select: Select, tables: Sequence[Table]) -> dict[str, _Found]:
    """Return, by its name, each column as the first table has it that does."""
    found: dict[str, _Found] = {}
    projections = Projections(replace(select, hidden=()), tables)
    # By what is selected first, for the tables may have fields that others lack.
    for n, selected in enumerate(select.visible):
        if selected is not None and isinstance(selected.what, KeyOperand):
            continue
        for table in tables:
            projection = projections.of(table)
            kinds = group_types(projection, table)[n]
            for output, (name, kind) in zip(projection.groups[n], kinds):
                found.setdefault(name, (output, kind, table, selected))
    return found


def _what(output: Output, selected: Optional[Selected]) -> Union[Term, Aggregate]:
    """Return what gives one column: of a message the one field."""
    if selected is not None and not selected.is_path:
        return selected.what
    if output.ref is None:
        raise AssertionError("what is no term is a field")
    return path_of(output.ref)


def path_of(ref: FieldRef) -> Path:
    """Return the path that names a field."""
    parts = [Part(step.name, step.index, 0) for step in ref.steps]
    parts[-1] = replace(parts[-1], index=ref.index)
    return Path((*parts, *([Part(ref.part, None, 0)] if ref.part else ())), 0)


def _reason(kind: ArrayType) -> str:
    """Say why a column cannot be drawn; '' = it can."""
    if kind.depth:
        return "an array: name one of its elements, or min, max, avg or len of it"
    if kind.kind == "time":
        return "a time: the difference of two is a number"
    return "text" if kind.kind == "string" else ""


def as_floats(found: Values, kind: ArrayType) -> AnyArray:
    """Return the values of a column as float64; NaN where one is missing, or no number."""
    values, missing = found
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
    """Return a value of a result as a number, of a duration its seconds; NaN where it is none."""
    if isinstance(value, (int, float)):
        try:
            return float(value)
        except OverflowError:  # an integer beyond all floats
            return float("inf") if value > 0 else float("-inf")
    to_nsec = getattr(value, "to_nsec", None)
    return float("nan") if to_nsec is None else float(to_nsec()) / SECOND_NS
