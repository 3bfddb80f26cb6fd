# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of a statement's result, from the messages of a batch together.

They have the values that ``Projection.rows`` gives message by message.
"""

from __future__ import annotations

from itertools import compress, repeat
from typing import Sequence

import numpy as np

from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.arrays.array_types import type_of_field
from cassandra_ros.query.arrays.batch import StackedBatch
from cassandra_ros.query.arrays.column_values import ColumnArray
from cassandra_ros.query.arrays.stacked_values import StackedField, read_stacked
from cassandra_ros.query.rows.name_resolution import KEY_PLACE, OWN_WIDTH
from cassandra_ros.query.rows.projection import Projection, itself
from cassandra_ros.query.rows.result_groups import Column, Columns, listed
from cassandra_ros.query.tree.expressions import Get


class ResultColumns:
    """Reads and shows the messages of one table for a statement, many at once.

    Args:
        definition: Definition of the messages.
        projection: The statement in this table.
        fields: The fields that it names, in the order of their values.
        shared: Whether equal times may be one object, because rows are made of several rows.
    """

    def __init__(
        self,
        definition: Definition,
        projection: Projection,
        fields: Sequence[StackedField],
        shared: bool,
    ) -> None:
        self._definition, self._projection, self._fields = definition, projection, fields
        self._shared = shared

    @classmethod
    def of(
        cls, definition: Definition | None, projection: Projection, *, shared: bool
    ) -> ResultColumns | None:
        """Return the reader of a table; None = its messages have to be read one by one.

        That is so if an array of messages is unnested, a field is inside of one, or nothing is
        shown, as of a field without fields.
        """
        if definition is None or projection.unnested or not projection.shown:
            return None
        refs = () if projection.extractor is None else projection.extractor.refs
        columns = {column.name: column for column in wire_plan(definition).all_columns}
        fields = []
        for ref in refs:
            column = columns.get(ref.column)
            if column is None:
                return None
            fields.append(StackedField(ref, column, type_of_field(ref, definition)))
        if not all(field.is_able for field in fields):
            return None
        return cls(definition, projection, fields, shared)

    def read(self, batch: StackedBatch, *, check: bool) -> tuple[StackedBatch, Columns]:
        """Return the messages of a batch that give rows, and the columns of these rows.

        Args:
            batch: The messages.
            check: Whether the condition is checked where the batch is not sure of it.
        """
        projection = self._projection
        values: list[Column] = [*self._own_values(batch), *self._field_values(batch)]
        if check and batch.unsure.any():
            unsure = batch.unsure.tolist()
            passes = [
                not doubtful or projection.check(row) is True
                for doubtful, row in zip(unsure, zip(*map(listed, values)))
            ]
            mask = np.array(passes, bool)
            batch = batch.only(mask)
            values = [
                list(compress(column, passes)) if isinstance(column, list) else column[mask]
                for column in values
            ]
        if projection.computed:
            rows = list(zip(*map(listed, values)))
            values += [list(map(get, rows)) for get in projection.computed]
        return batch, [
            [None] * len(batch) if place is None else self._shown(batch, place, get, values[place])
            for place, get in projection.shown
        ]

    def _shown(self, batch: StackedBatch, place: int, get: Get | None, column: Column) -> Column:
        """Return the values of a column as the result shows them; see ``Projection.shown``."""
        if get is None:
            return _keys(batch) if place == KEY_PLACE else column
        if get is itself:  # a key that is only counted
            return column
        values = listed(column)
        if not self._shared or any(isinstance(value, list) for value in values):
            return list(map(get, values))
        # Times and durations, of which many are equal if they are rounded.
        by_value = {value: get(value) for value in set(values)}
        return [by_value[value] for value in values]

    def _own_values(self, batch: StackedBatch) -> Sequence[Column]:
        """Return the values that are not fields: KEY, NODE, RUN and time."""
        count = len(batch)
        runs: list[object] = [""] * count
        if self._projection.runs:
            runs = []
            for _, writer, messages in batch.owners:
                runs += repeat(batch.table.runs.text(writer), messages)
        return (batch.times, [batch.node] * count, runs, batch.times)

    def _field_values(self, batch: StackedBatch) -> Sequence[Column]:
        """Return the values of all fields; None = missing."""
        if not self._fields:
            return ()
        arrays, rest = read_stacked(self._definition, self._fields, len(batch), batch.groups)
        columns = [_column(field, array) for field, array in zip(self._fields, arrays)]
        if not rest:
            return columns
        lists = [listed(column) for column in columns]
        for n, wire in rest:
            identity = int(batch.times[n]), batch.node, "", int(batch.times[n])
            (row,) = self._projection.wire_values(identity, wire)
            for column, value in zip(lists, row[OWN_WIDTH:]):
                column[n] = value
        return lists


def _column(field: StackedField, array: ColumnArray) -> Column:
    """Return the values of a field: an array if all are numbers, else a list."""
    values, missing = array
    if not field.kind.depth and values.dtype.kind != "O" and not missing.any():
        return values
    objects: list[object]
    if field.kind.depth and field.kind.kind == "uint8":
        objects = [None if row is None else row.tobytes() for row in values]
    elif field.kind.cells:
        objects = [None if row is None else row.tolist() for row in values]
    else:
        objects = values.tolist()
    for n in missing.nonzero()[0].tolist():
        objects[n] = None
    return objects


def _keys(batch: StackedBatch) -> list[object]:
    """Return the row keys of messages."""
    pairs = zip(batch.times.tolist(), batch.seqs.tolist())
    return [Stamp.from_ns(t, batch.node, seq, batch.table.name) for t, seq in pairs]
