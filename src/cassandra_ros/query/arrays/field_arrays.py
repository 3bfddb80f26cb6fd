# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of many messages as numpy arrays, without a Python object for each number.

``as_frame`` makes a pandas.DataFrame of them. pandas and pyarrow are imported when the first one is
made, because nothing else needs them.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple, Sequence, Tuple, Union

import numpy as np

from cassandra_ros.arguments import check_list
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.installation import optional_module
from cassandra_ros.query.arrays.array_types import MIXED, AnyArray, ArrayType, unite_columns
from cassandra_ros.query.arrays.batch import ReadBatches
from cassandra_ros.query.arrays.column_values import empty_values, join_values, rows_of, stack_cells
from cassandra_ros.query.arrays.table_values import TableValues
from cassandra_ros.query.plan.bounds import plan_of
from cassandra_ros.query.protocols import Row, Source, Table
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.rows.result_groups import analyse_select
from cassandra_ros.query.tree.expressions import INTEGER
from cassandra_ros.query.tree.parse import parse_condition, parse_select
from cassandra_ros.query.tree.syntax import Aggregate, KeyOperand, Select, Selected, Term
from cassandra_ros.read import EVERYBODY, Read, Whose

Where = Union[None, str, Tuple[str, Sequence[object]]]
"""A condition, or a condition and the values of its ``?``."""
Fields = Union[None, str, Sequence[str]]
"""Names of fields; None = all fields."""
_PLAIN_TOPIC = re.compile(r"/[A-Za-z][A-Za-z0-9_/]*")


class FieldArray(NamedTuple):
    """The values of a field."""

    kind: ArrayType
    values: AnyArray
    missing: AnyArray
    """A bool for each row: the message has no such value."""


def gather_fields(
    topic: Source[Row],
    fields: Fields,
    where: Where,
    read: ReadBatches,
    *,
    whose: Whose = EVERYBODY,
) -> dict[str, FieldArray]:
    """Gather fields from the messages of a topic.

    Args:
        topic: The topic.
        fields: Fields as a SELECT statement names them, KEY, NODE and RUN included; None = all.
        where: Condition that ``read`` applies to messages; here it selects unnested elements.
        read: Reads the messages that satisfy the condition, in any order.
        whose: The robot and the runs whose messages ``read`` returns.

    Raises:
        InvalidName: ``fields`` is not a list of names.
        InvalidQuery: A field or the condition is malformed, or not in the topic.
    """
    text: Any = where
    params: Sequence[object] = ()
    if isinstance(where, (tuple, list)) and len(where) == 2:
        text, params = where
    if text is not None:
        parse_condition(text, params)  # parsed alone, so that it cannot close the bracket around it
    statement = _statement(topic, fields, text, params)
    select, _ = plan_of(statement, topic.tables, Read(whose=whose))
    findings = Findings(select.text)
    tables = {table.name: TableValues(select, table, findings) for table in topic.tables}
    findings.check()

    def values_of(table: Table) -> TableValues:
        if table.name not in tables:  # the table was created during the read
            tables[table.name] = TableValues(select, table, Findings(select.text))
        return tables[table.name]

    for batch in read(lambda table: values_of(table).parts):
        values_of(batch.table).add(batch)
    for values in tables.values():
        values.flush()
    return _join_tables(select, list(tables.values()))


def as_arrays(fields: dict[str, FieldArray]) -> dict[str, AnyArray]:
    """Return gathered fields as arrays; a field with missing values as a masked array.

    ``fields`` is emptied, which frees each column after its conversion: only one exists twice.
    """
    return {name: _mask(*fields.pop(name)) for name in list(fields)}


def _mask(kind: ArrayType, values: AnyArray, missing: AnyArray) -> AnyArray:
    """Return the values of a field, masked where they are missing; objects have None there."""
    many = values.ndim > 1
    if kind.depth == 1 and not many and not missing.any():
        # Stacked only here, where all messages are known: the shape must not depend on one batch.
        return stack_cells(values, kind)
    if not missing.any() or (values.dtype.kind == "O" and not many):
        return values
    mask = np.broadcast_to(missing[:, None], values.shape) if many else missing
    masked_array: AnyArray = np.ma.MaskedArray(values, mask)  # type: ignore[no-untyped-call]
    return masked_array


def _statement(
    topic: Source[Row], fields: Fields, where: str | None, params: Sequence[object]
) -> Select:
    """Return the statement that selects these fields, analysed.

    Raises:
        InvalidName, InvalidQuery: See gather_fields.
    """
    names = ["*"] if fields is None else check_list("fields", fields, "['linear.x']")
    for field in names:
        if not isinstance(field, str):
            raise InvalidQuery(str(field), 0, f"a field is text, not {type(field).__name__}")
    name = topic.name
    topic_name = name if _PLAIN_TOPIC.fullmatch(name) else '"' + name.replace('"', '""') + '"'
    # On lines of their own: so no comment hides what follows, and errors show only the user's line.
    text = f"SELECT {', '.join(names)}\nFROM {topic_name}"  # noqa: S608 (read by our own grammar)
    select = parse_select(text if where is None else f"{text} WHERE (\n{where}\n)", params)
    if select.distinct:
        reason = "DISTINCT stands in a statement, not before fields; executeCQL answers it"
        raise InvalidQuery(select.text, len("SELECT "), reason)
    tables = topic.tables
    select = analyse_select(select, tables)
    by_name: dict[str, Term] = {}
    for column in select.columns or ():
        what = column.what
        if isinstance(what, Aggregate):
            reason = f"{what.text} is one value, no field; executeCQL answers it"
            raise InvalidQuery(select.text, what.position, reason)
        other = by_name.setdefault(column.text, what)
        if other.text != what.text:
            reason = f"both {what.text} and {other.text} are called {column.text}"
            raise InvalidQuery(select.text, what.position, reason)
    return select


def _join_tables(select: Select, tables: Sequence[TableValues]) -> dict[str, FieldArray]:
    """Return the gathered fields of all tables, in the order of time, node, _seq and table."""
    if not tables:  # the topic has no message type yet
        columns = select.columns or (Selected(KeyOperand(0)),)
        kinds = {c.text: "time" if isinstance(c.what, KeyOperand) else MIXED for c in columns}
        return {
            n: FieldArray(ArrayType(k), *empty_values(ArrayType(k), 0)) for n, k in kinds.items()
        }
    filled = [table for table in tables if table.count]
    order = _order_of(filled)
    arrays = {}
    for name, kind in dict(unite_columns([table.groups for table in tables])).items():
        values, missing = join_values([table.pop_column(name, kind) for table in filled], kind)
        if order is not None:
            values, missing = values[order], missing[order]
        if kind.kind == INTEGER:
            kind, values = _as_int64(values, missing)
        arrays[name] = FieldArray(kind, values, missing)
    return arrays


def _as_int64(values: AnyArray, missing: AnyArray) -> tuple[ArrayType, AnyArray]:
    """Return computed integers as int64, or as Python integers if one does not fit."""
    try:
        return ArrayType("int64"), np.where(missing, 0, values).astype(np.int64)
    except OverflowError:
        return ArrayType(MIXED), values


def _order_of(tables: Sequence[TableValues]) -> AnyArray | None:
    """Return the order of rows by time, node, _seq and table; None: they are in order."""
    keys = [(values.name, keys) for values in tables for keys in values.take_keys()]
    if not keys:
        return None
    times = np.concatenate([row_keys.times for _, row_keys in keys])
    if (times[1:] > times[:-1]).all():
        return None
    seqs = np.concatenate([row_keys.seqs for _, row_keys in keys])
    owned = [(node, name, n) for name, row_keys in keys for node, n in row_keys.nodes]
    nodes, names, counts = zip(*owned)
    node_ranks, table_ranks = (
        np.repeat(np.unique(texts, return_inverse=True)[1], counts) for texts in (nodes, names)
    )
    order: AnyArray = np.lexsort((table_ranks, seqs, node_ranks, times))
    return None if (order[1:] > order[:-1]).all() else order


_UNITS = {"time": "M8[ns]", "duration": "m8[ns]"}


def as_frame(fields: dict[str, FieldArray]) -> Any:
    """Return gathered fields, KEY among them, as a DataFrame with index KEY.

    KEY is taken out of ``fields``, and the arrays may be changed and become part of the frame.
    """
    pandas = optional_module("pandas", "toDataFrame")
    key = fields.pop("KEY")
    times = key.kind.kind == "time"
    index = pandas.Index(key.values.view("M8[ns]") if times else key.values, name="KEY")
    columns = {name: _series(pandas, array) for name, array in fields.items()}
    return pandas.DataFrame(columns, index=index)


def _series(pandas: Any, array: FieldArray) -> Any:
    """Return the values of one column, with missing values in pandas' form for the type."""
    kind, values, missing = array
    if kind.depth:
        return rows_of(values, missing)
    if kind.kind in _UNITS:
        values = values.view(_UNITS[kind.kind])
        values[missing] = np.array("NaT", values.dtype)
    elif missing.any() and values.dtype.kind in "iu":
        return pandas.arrays.IntegerArray(values, missing)
    elif missing.any() and values.dtype.kind == "b":
        return pandas.arrays.BooleanArray(values, missing)
    elif values.dtype.kind == "f":
        values[missing] = np.nan
    return values
