# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Columns of Arrow out of some columns of rows of format ``ros``, without the messages.

Columns that do not hold their field exactly are cut out of the message before.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any, Iterator, Mapping, Sequence

import numpy as np

from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.arrays.arrow_columns import escape, is_utf8, number_array
from cassandra_ros.query.arrays.arrow_types import ArrowField
from cassandra_ros.query.arrays.batch import Cells
from cassandra_ros.query.arrays.column_values import BIG_ENDIAN, as_uint64, join_fixed, numbers_of
from cassandra_ros.query.protocols import Table

if TYPE_CHECKING:
    import pyarrow

LARGEST_SHARE = 0.5
"""Largest share of the columns of a table that is read alone: whole rows are made together."""


Column = Sequence[bytes]
"""A column of some messages."""


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

    def make(self, cells: Sequence[Cells]) -> list[pyarrow.Array]:
        """Make the arrays of the fields from the columns ``names`` of some messages.

        The values of an unreadable message are null.

        Raises:
            CorruptMessage: A column does not have the size of its type.
        """
        readable = [own_cells for own_cells in cells if own_cells is not None]
        raws = list(zip(*readable)) or [()] * len(self.names)
        arrays = [self._array(field, raws, len(readable)) for field in self._fields]
        if len(readable) == len(cells):
            return arrays
        numbers = count()
        places = [None if own_cells is None else next(numbers) for own_cells in cells]
        indices = self._arrow.array(places, self._arrow.int64())
        return [array.take(indices) for array in arrays]

    def _array(self, field: ArrowField, raws: Sequence[Column], size: int) -> pyarrow.Array:
        arrow, kind = self._arrow, field.type(self._arrow)
        if field.children:
            children = [self._array(child, raws, size) for child in field.children]
            return arrow.Array.from_buffers(kind, size, [None], children=children)
        column = self._columns[field.path]
        values = raws[self._places[field.path]]
        if column.kind in ("text", "array"):
            data = np.frombuffer(b"".join(values), np.uint8)
            sizes = np.fromiter(map(len, values), np.int64, size)
            return self._pieces(field, kind, data, sizes)
        if field.field.base == "uint64":
            return number_array(arrow, kind, as_uint64(values))
        numbers = join_fixed(values, np.dtype(BIG_ENDIAN[column.cql_type]))
        return number_array(arrow, kind, numbers.astype(kind.to_pandas_dtype()))

    def _pieces(self, field: ArrowField, kind: Any, data: AnyArray, sizes: Any) -> pyarrow.Array:
        """Return texts, bytes or arrays of numbers out of all their bytes, of these sizes."""
        arrow, size = self._arrow, len(sizes)
        is_plain = not field.field.is_array or field.is_bytes
        numbers = data if is_plain else numbers_of(field.field.base, data.tobytes())
        unit = max(1, len(data) // max(1, len(numbers)))
        ends = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes // unit)])
        if field.field.base == "string" and not is_utf8(data, ends):
            data, ends = escape(data, ends)  # cut out of a message: no column holds such a text
        offsets = arrow.py_buffer(ends.astype(np.int32))
        if is_plain:
            return arrow.Array.from_buffers(kind, size, [None, offsets, arrow.py_buffer(data)])
        children = [number_array(arrow, kind.value_type, numbers)]
        return arrow.Array.from_buffers(kind, size, [None, offsets], children=children)


def _leaves(fields: Sequence[ArrowField]) -> Iterator[str | None]:
    """Yield the paths of all fields that are no messages; None for an array of messages."""
    for field in fields:
        if field.children and not field.field.is_array:
            yield from _leaves(field.children)
        else:
            yield None if field.children else field.path
