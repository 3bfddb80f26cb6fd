# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of many messages as numpy arrays: no Python object is kept for a number."""

from __future__ import annotations

import re
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Iterator,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

import numpy as np

from cassandra_ros.arguments import check_list
from cassandra_ros.arrays.array_types import MIXED, ArrayType, unite_columns
from cassandra_ros.arrays.table_values import TableValues
from cassandra_ros.arrays.values import cast_values, empty_values, join_values
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.names import Findings
from cassandra_ros.query.parse import parse_condition, parse_select
from cassandra_ros.query.protocols import Row, Source, Table
from cassandra_ros.query.syntax import Aggregate, KeyOperand, Operand, Select, Selected

if TYPE_CHECKING:
    from cassandra_ros.arrays.array_types import AnyArray

Where = Union[None, str, Tuple[str, Sequence[object]]]
"""A condition, or a condition with the values of its ``?``."""
Fields = Union[None, str, Sequence[str]]
"""Names of fields; None = all."""
Columns = Callable[[Table], Sequence[str]]
"""Which columns of a table are needed."""
ReadRows = Callable[[Columns], Iterator[Row]]
"""Reads the stored rows that satisfy the condition."""

_PLAIN_TOPIC = re.compile(r"/[A-Za-z][A-Za-z0-9_/]*")


class FieldArray(NamedTuple):
    """The values of a field."""

    kind: ArrayType
    values: AnyArray
    missing: Optional[AnyArray]
    """A bool for each row: the message has no such value. None where all have it."""


def gather_fields(
    topic: Source[Row], fields: Fields, where: Where, read: ReadRows
) -> dict[str, FieldArray]:
    """Gather fields from the rows of a topic.

    Args:
        topic: Whose rows.
        fields: As a SELECT statement names them, KEY and NODE included; None = all fields.
        where: Which messages ``read`` gives, and which elements of the arrays that are unnested.
        read: Reads the rows.

    Raises:
        InvalidName: fields is no list of names.
        InvalidQuery: A field or the condition cannot be understood, or is not in the topic.
    """
    text: Any = where
    params: Sequence[object] = ()
    if isinstance(where, (tuple, list)) and len(where) == 2:
        text, params = where
    if text is not None:
        parse_condition(text, params)  # by itself: it must not end before its end
    select = _statement(topic.name, fields, text, params)
    findings = Findings(select.text)
    tables = {table.name: TableValues(select, table, findings) for table in topic.tables}
    findings.check()

    def columns(table: Table) -> Sequence[str]:
        known = tables.get(table.name)
        return table.columns if known is None else known.needed

    number, latest = 0, ""
    for row in read(columns):
        name = row.table.name
        if name not in tables:  # made since
            tables[name] = TableValues(select, row.table, Findings(select.text))
        if latest and (number or name != latest):
            number += 1
        latest = name
        tables[name].add(row, number)
    for table in tables.values():
        table.flush()
    return _united(select, list(tables.values()))


def read_arrays(
    topic: Source[Row], fields: Fields, where: Where, read: ReadRows
) -> dict[str, AnyArray]:
    """Return fields as arrays, those of which values are missing as masked ones.

    Arguments and errors are those of gather_fields.
    """
    return {
        name: _plain(array) for name, array in gather_fields(topic, fields, where, read).items()
    }


def _plain(array: FieldArray) -> AnyArray:
    many = array.values.ndim > 1
    if array.missing is None or (array.values.dtype.kind == "O" and not many):
        return array.values
    mask = array.missing
    if many:
        mask = np.broadcast_to(mask[:, None], array.values.shape)
    masked: AnyArray = np.ma.MaskedArray(array.values, mask)  # type: ignore[no-untyped-call]
    return masked


def _statement(
    topic: str, fields: Fields, where: Optional[str], params: Sequence[object]
) -> Select:
    """Parse what was asked for as the statement that it is."""
    names = ["*"] if fields is None else check_list("fields", fields, "['linear.x']")
    for name in names:
        if not isinstance(name, str):
            raise InvalidQuery(str(name), 0, f"a field is text, not {type(name).__name__}")
    shown = topic if _PLAIN_TOPIC.fullmatch(topic) else '"' + topic.replace('"', '""') + '"'
    # In lines of their own no comment hides what follows, and an error shows the one alone.
    text = f"SELECT {', '.join(names)}\nFROM {shown}"  # noqa: S608 (read by our own grammar)
    select = parse_select(text if where is None else f"{text} WHERE (\n{where}\n)", params)
    called: dict[str, Operand] = {}
    for column in select.columns or ():
        what = column.what
        if isinstance(what, Aggregate):
            reason = f"{what.text} is one value, no field; executeCQL answers it"
            raise InvalidQuery(select.text, what.position, reason)
        other = called.setdefault(column.text, what)
        if other.text != what.text:
            reason = f"both {what.text} and {other.text} are called {column.text}"
            raise InvalidQuery(select.text, what.position, reason)
    return select


def _united(select: Select, tables: Sequence[TableValues]) -> dict[str, FieldArray]:
    if not tables:
        columns = select.columns or (Selected(KeyOperand(0)),)
        return {column.text: _nothing(column) for column in columns}
    filled = [table for table in tables if table.count]
    order = None
    if len(filled) > 1:
        order = np.argsort(np.concatenate([table.order for table in filled]), kind="stable")
    kinds = dict(unite_columns([table.groups for table in tables]))
    return {name: _column(name, kind, filled, order) for name, kind in kinds.items()}


def _nothing(column: Selected) -> FieldArray:
    """Return no value, of a topic that has no type yet."""
    kind = ArrayType("time" if isinstance(column.what, KeyOperand) else MIXED)
    return FieldArray(kind, np.empty(0, kind.dtype), None)


def _column(
    name: str, kind: ArrayType, tables: Sequence[TableValues], order: Optional[AnyArray]
) -> FieldArray:
    parts = []
    for table in tables:
        found = table.take(name)
        if found is None:
            parts.append(empty_values(kind, table.count))
        else:
            parts.append(cast_values(found[1], found[0], kind))
    values, missing = join_values(parts, kind)
    if order is not None:
        values, missing = values[order], None if missing is None else missing[order]
    return FieldArray(kind, values, missing)
