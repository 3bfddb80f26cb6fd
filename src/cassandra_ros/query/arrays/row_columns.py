# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Columns of Arrow out of some columns of rows of format ``ros``, without the messages.

Only rows whose columns hold these fields exactly: the caller reads the messages of the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterator, Mapping, Sequence

import numpy as np

from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.arrays.arrow_columns import number_array
from cassandra_ros.query.arrays.arrow_types import ArrowField
from cassandra_ros.query.arrays.column_values import BIG_ENDIAN, as_uint64, join_fixed, numbers_of
from cassandra_ros.query.protocols import Row, Table

if TYPE_CHECKING:
    import pyarrow

LARGEST_SHARE = 0.5
"""Largest share of the columns of a table that is read alone: whole rows are made together."""

Raws = Sequence[bytes]


class RowColumns:
    """Reads some fields of one table from their columns.

    Args:
        arrow: The module pyarrow.
        fields: The fields.
        columns: The column of each field that is not a message, by its path.
        names: Columns of the table, in their order.

    Attributes:
        names: The columns that must be read, in the same order.
    """

    def __init__(
        self,
        arrow: Any,
        fields: Sequence[ArrowField],
        columns: Mapping[str, FieldColumn],
        names: Sequence[str],
    ) -> None:
        self._arrow = arrow
        self._fields = fields
        self._columns = columns
        self.names = [name for name in names if name in columns]
        self._places = {name: n for n, name in enumerate(self.names)}
        self._table_width = len(names)
        self._table_places = [list(names).index(name) for name in self.names]
        """Index of each of these columns among all columns of the table."""

    @classmethod
    def of(cls, arrow: Any, table: Table, fields: Sequence[ArrowField]) -> RowColumns | None:
        """Return the reader of some fields; None = they need the messages, or most columns."""
        if not table.by_field or table.definition is None or not fields:
            return None
        by_name = {column.name: column for column in wire_plan(table.definition).all_columns}
        columns = {}
        for path in _leaves(fields):
            column = None if path is None else by_name.get(path)
            if column is None or column.is_list or column.kind == "wire":
                return None
            columns[column.name] = column
        names = table.columns
        few = len(columns) <= LARGEST_SHARE * len(names)
        return cls(arrow, fields, columns, names) if few and columns.keys() <= set(names) else None

    def columns_of(self, row: Row) -> Raws | None:
        """Return the bytes of the fields' columns in a row; None = the message is needed."""
        columns = row.columns
        if len(columns) == self._table_width:
            columns = tuple(columns[n] for n in self._table_places)
        if len(columns) != len(self.names) or None in columns:
            return None
        return columns  # type: ignore[return-value]  # no column is None

    def make(self, rows: Sequence[Raws]) -> list[pyarrow.Array]:
        """Make the arrays of the fields from what ``columns_of`` returned for some rows.

        Raises:
            CorruptMessage: A column does not have the size of its type.
        """
        raws = list(zip(*rows))
        return [self._array(field, raws, len(rows)) for field in self._fields]

    def _array(self, field: ArrowField, raws: Sequence[Raws], count: int) -> pyarrow.Array:
        arrow, kind = self._arrow, field.type(self._arrow)
        if field.children:
            children = [self._array(child, raws, count) for child in field.children]
            return arrow.Array.from_buffers(kind, count, [None], children=children)
        column = self._columns[field.path]
        values = raws[self._places[field.path]]
        if column.kind in ("text", "array"):
            data = np.frombuffer(b"".join(values), np.uint8)
            sizes = np.fromiter(map(len, values), np.int64, count)
            return self._pieces(field, kind, data, sizes)
        if field.field.base == "uint64":
            return number_array(arrow, kind, as_uint64(values))
        numbers = join_fixed(values, np.dtype(BIG_ENDIAN[column.cql_type]))
        return number_array(arrow, kind, numbers.astype(kind.to_pandas_dtype()))

    def _pieces(self, field: ArrowField, kind: Any, data: AnyArray, sizes: Any) -> pyarrow.Array:
        """Return texts, bytes or arrays of numbers out of all their bytes, of these sizes."""
        arrow, count = self._arrow, len(sizes)
        is_plain = not field.field.is_array or field.is_bytes
        numbers = data if is_plain else numbers_of(field.field.base, data.tobytes())
        unit = max(1, len(data) // max(1, len(numbers)))
        ends = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes // unit)])
        offsets = arrow.py_buffer(ends.astype(np.int32))
        if is_plain:
            return arrow.Array.from_buffers(kind, count, [None, offsets, arrow.py_buffer(data)])
        children = [number_array(arrow, kind.value_type, numbers)]
        return arrow.Array.from_buffers(kind, count, [None, offsets], children=children)


def _leaves(fields: Sequence[ArrowField]) -> Iterator[str | None]:
    """Yield the paths of all fields that are no messages; None for an array of messages."""
    for field in fields:
        if field.children and not field.field.is_array:
            yield from _leaves(field.children)
        else:
            yield None if field.children else field.path
