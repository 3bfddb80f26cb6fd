# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of some fields of one table, gathered in arrays while its messages are read.

Batches of messages are converted to arrays together: all messages of a layout at once
(``stacked_values``), or column by column (``column_values``). Only a field without a column of its
own (an array inside an array of messages, say) is decoded value by value.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from typing import Iterator, Mapping, NamedTuple, Sequence

import numpy as np

from cassandra_ros.errors import CassandraRosError, CorruptMessage, InvalidQuery
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType, group_types
from cassandra_ros.query.arrays.batch import Batch, Cells, RowParts, join_groups
from cassandra_ros.query.arrays.column_values import (
    ColumnArray,
    Convert,
    Raws,
    cast_values,
    compile_convert,
    count_elements,
    empty_values,
    from_decoded,
    join_values,
    none_missing,
    objects_of,
)
from cassandra_ros.query.arrays.stacked_values import StackedField, read_stacked
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.name_resolution import KEY_PLACE, NODE_PLACE, Findings, RowValues
from cassandra_ros.query.rows.projection import Projection
from cassandra_ros.query.tree.field_names import FieldRef
from cassandra_ros.query.tree.syntax import Select

STACKED_MESSAGES = 16384
"""Number of messages that are converted together; large, so that messages of rare sizes meet."""
OTHER_MESSAGES = 4096
"""The same for messages whose fields are converted column by column, or decoded."""
CONVERTED_BYTES = 2 * 1024 * 1024
"""Size of the messages from which they are converted, bytes."""


class ColumnSource(NamedTuple):
    """The column that holds a field, and how its values are converted."""

    name: str
    """Name of the column."""
    convert: Convert
    inside: bool
    """Whether the column is a list whose elements become rows."""


class RowKeys(NamedTuple):
    """Keys of converted rows: of the messages, or of their elements that become rows."""

    times: AnyArray
    """Row keys, ns."""
    seqs: AnyArray
    nodes: Sequence[tuple[str, int]]
    """nodeIDs, and for each the number of consecutive rows."""


class TableValues:
    """Gathers the values of a statement's columns (fields, KEY, …) from messages of one table.

    Before its values are taken, ``flush`` converts the last messages.

    Attributes:
        groups: Name and type of the columns of each selected path.
        name: Name of the table.
        parts: What has to be read of the table's rows.
        count: Number of converted rows: values of each output.
    """

    def __init__(self, select: Select, table: Table, findings: Findings) -> None:
        self.name = table.name
        self._table, self._text = table, select.text
        self._projection = Projection.compile(select, table, findings)
        self.groups = group_types(self._projection, table)
        self._outputs = [output for group in self._projection.groups for output in group]
        self._kinds = [kind for group in self.groups for _, kind in group]
        self._arrays = [".".join(s.name for s in array) for array in self._projection.unnested]
        """Paths of the arrays that are unnested."""
        plan = None if table.definition is None else wire_plan(table.definition)
        columns = {} if plan is None else {column.name: column for column in plan.all_columns}
        # Source of each output; None: the output has no column of its own.
        self._sources = [
            None if output.ref is None else self._source(output.ref, kind, columns)
            for output, kind in zip(self._outputs, self._kinds)
        ]
        condition = Projection.compile(replace(select, columns=()), table, Findings(select.text))
        self._tests_elements = bool(condition.unnested)
        """Whether some unnested elements of a message may not satisfy the condition."""
        self._by_column = (
            len(self._arrays) <= 1
            and not self._tests_elements
            and all(
                source or (output.ref is None and output.compute is None)
                for output, source in zip(self._outputs, self._sources)
            )
        )
        """Whether the messages are converted column by column; else all fields are decoded."""
        self._stacked = self._stacked_fields(columns)
        names = dict.fromkeys(source.name for source in self._sources if source is not None)
        self._in_columns = table.by_field and names.keys() <= set(table.columns)
        """Whether the table has a column for each field."""
        self._names = [n for n in table.columns if n in names] if self._in_columns else list(names)
        """Names of the columns that are read, or cut out of the messages, if ``_by_column``."""
        self.parts = self._parts()
        self.renew()

    def renew(self) -> None:
        """Discard the gathered values."""
        self._chunks: list[list[ColumnArray]] = [[] for _ in self._outputs]
        """The values of the messages that were converted together, for each output."""
        self._keys: list[RowKeys] = []
        """Keys of the converted rows."""
        self.count = 0
        self._clear()

    def _clear(self) -> None:
        """Forget the messages that are not converted yet."""
        self._batches: list[Batch] = []
        self._count = self._bytes = 0
        self._times: AnyArray = np.zeros(0, np.int64)
        """Times of the messages that are being converted, ns."""

    def _stacked_fields(self, columns: Mapping[str, FieldColumn]) -> list[StackedField]:
        """Return all fields, if they can be read from many messages at once; else []."""
        if self._arrays or not self._by_column:
            return []
        fields = [
            StackedField(output.ref, columns[output.ref.column], kind)
            for output, kind in zip(self._outputs, self._kinds)
            if output.ref is not None
        ]
        return fields if all(field.is_able for field in fields) else []

    def _source(
        self, ref: FieldRef, kind: ArrayType, columns: Mapping[str, FieldColumn]
    ) -> ColumnSource | None:
        """Return the source of a field's values; None: it must be decoded value by value."""
        column = columns.get(ref.column)
        inside = column is not None and column.array in self._arrays
        convert = None if column is None else compile_convert(ref, column, kind, inside)
        if column is None or convert is None:
            return None
        return ColumnSource(column.name, convert, inside)

    def _parts(self) -> RowParts:
        """Return what has to be read of a row."""
        table, extractor = self._table, self._projection.extractor
        if not self._by_column:
            if extractor is None:
                return RowParts(table, ())
            return RowParts(table, extractor.columns if table.by_field else None)
        in_row = self._in_columns or not self._names
        return RowParts(table, self._names if in_row else None, self._names)

    def add(self, batch: Batch) -> None:
        """Add messages that satisfy the condition."""
        if self._batches and batch.has_messages != self._batches[0].has_messages:
            self.flush()
        self._batches.append(batch)
        self._count += len(batch)
        self._bytes += batch.size
        stacked = self._stacked and batch.has_messages
        limit = STACKED_MESSAGES if stacked else OTHER_MESSAGES
        if self._count >= limit or self._bytes >= CONVERTED_BYTES:
            self.flush()

    def flush(self) -> None:
        """Convert the messages that were added; CorruptMessage: a column is malformed."""
        if not self._batches:
            return
        self._times = np.concatenate([batch.times for batch in self._batches])
        convert = self._value_by_value
        if self._by_column:
            stacked = self._stacked and self._batches[0].has_messages
            convert = self._all_at_once if stacked else self._column_by_column
        try:
            chunks = convert()
        except (ValueError, struct.error) as exc:
            if isinstance(exc, CassandraRosError):
                raise
            raise CorruptMessage(f"a column of a row is malformed: {exc}") from exc
        for output_chunks, chunk in zip(self._chunks, chunks):
            output_chunks.append(chunk)
        self._clear()

    def _all_at_once(self) -> list[ColumnArray]:
        """Convert messages whose fields are all stacked."""
        definition = self._table.definition
        if definition is None:
            raise AssertionError("only fields of a definition are stacked")
        count = self._count
        arrays, rest = read_stacked(definition, self._stacked, count, join_groups(self._batches))
        self._add_keys(None)
        cut = [self.parts.cut(wire, int(self._times[n])) for n, wire in rest]
        columns = self._columns_of(cut)
        fields, indices = iter(arrays), np.array([n for n, _ in rest], np.int64)
        chunks = []
        for output, source in zip(self._outputs, self._sources):
            if source is None:
                chunks.append(self._own_values(output.place))
                continue
            chunk = next(fields)
            if rest:
                values, missing = source.convert(columns[source.name])
                chunk.values[indices], chunk.missing[indices] = values, missing
            if not chunk.missing.any():
                chunk = chunk._replace(missing=none_missing(count))
            chunks.append(chunk)
        return chunks

    def _value_by_value(self) -> list[ColumnArray]:
        """Convert messages by decoding each value."""
        decoded: list[RowValues] = []
        counts: list[int] = []
        for batch in self._batches:
            for rows in self._rows_of(batch):
                decoded += rows
                counts.append(len(rows))
        self._add_keys(np.array(counts))
        columns = list(zip(*decoded))
        chunks = []
        for output, kind in zip(self._outputs, self._kinds):
            try:
                chunks.append(from_decoded(columns[output.place] if columns else (), kind))
            except OverflowError as exc:
                reason = f"{output.name} goes beyond int64 nanoseconds; executeCQL answers it"
                raise InvalidQuery(self._text, len("SELECT "), reason) from exc
        return chunks

    def _rows_of(self, batch: Batch) -> Iterator[Sequence[RowValues]]:
        """Yield for each message the values of its rows."""
        projection = self._projection
        identities = batch.identities(runs=projection.runs)
        if self.parts.columns is None:
            values = map(projection.wire_values, identities, batch.wires)
        else:
            values = map(projection.cell_values, identities, batch.cells(self.parts))
        for rows in values:
            kept = filter(self._passes, rows) if self._tests_elements else rows
            yield list(map(projection.complete, kept))

    def _passes(self, values: RowValues) -> bool:
        return self._projection.check(values) is True

    def _column_by_column(self) -> list[ColumnArray]:
        """Convert columns; values outside an unnested array repeat for its elements."""
        # Without fields a block need not be cut into messages.
        batches = self._batches if self._names else ()
        cells = [cells for batch in batches for cells in batch.cells(self.parts)]
        columns = self._columns_of(cells)
        inside = next((s.name for s in self._sources if s is not None and s.inside), None)
        counts = None if inside is None else count_elements(columns[inside])
        self._add_keys(counts)
        chunks = []
        for output, source in zip(self._outputs, self._sources):
            if source is None:
                chunk, repeats = self._own_values(output.place), counts
            else:
                chunk = source.convert(columns[source.name])
                repeats = None if source.inside else counts
            chunks.append(ColumnArray(*(_repeat(values, repeats) for values in chunk)))
        return chunks

    def _columns_of(self, cells: Sequence[Cells]) -> Mapping[str, Raws]:
        """Return the columns of some messages by name; of an unreadable message each is None."""
        missing: Sequence[None] = [None] * len(self._names)
        rows = [missing if own_cells is None else own_cells for own_cells in cells]
        return dict(zip(self._names, zip(*rows)))

    def _own_values(self, place: int) -> ColumnArray:
        """Return KEY, NODE or RUN (``place``: KEY_PLACE, say) of the messages."""
        if place == KEY_PLACE and self._table.named:
            values = objects_of([name for batch in self._batches for name in batch.names])
        elif place == KEY_PLACE:
            values = self._times
        else:
            owners = [owner for batch in self._batches for owner in batch.owners]
            runs = self._table.runs
            texts = [o.node if place == NODE_PLACE else runs.text(o.writer) for o in owners]
            values = np.repeat(objects_of(texts), [owner.messages for owner in owners])
        return ColumnArray(values, none_missing(self._count))

    def _add_keys(self, counts: AnyArray | None) -> None:
        """Note the keys of the rows; ``counts``: number of rows of each message, None = one."""
        seqs = np.concatenate([batch.seqs for batch in self._batches])
        owners = [owner for batch in self._batches for owner in batch.owners]
        ends = np.cumsum([owner.messages for owner in owners])
        if counts is not None:
            ends = np.concatenate([[0], np.cumsum(counts)])[ends]
        numbers = np.diff(ends, prepend=0).tolist()
        pairs = groupby(zip([owner.node for owner in owners], numbers), key=itemgetter(0))
        nodes = [(node, sum(count for _, count in same)) for node, same in pairs]
        self._keys.append(RowKeys(_repeat(self._times, counts), _repeat(seqs, counts), nodes))
        self.count += sum(numbers)

    def take_keys(self) -> Sequence[RowKeys]:
        """Return the keys of the converted rows, and forget them to free their memory."""
        keys, self._keys = self._keys, []
        return keys

    def pop_column(self, name: str, kind: ArrayType) -> ColumnArray:
        """Return the values of a column as type ``kind``, and forget them to free their memory.

        Each column is taken once. If the table lacks the column, each value is missing.
        """
        for n, (output, own_kind) in enumerate(zip(self._outputs, self._kinds)):
            if output.name == name:
                chunks, self._chunks[n] = self._chunks[n], []
                return cast_values(join_values(chunks, own_kind), own_kind, kind)
        return empty_values(kind, self.count)


def _repeat(values: AnyArray, counts: AnyArray | None) -> AnyArray:
    """Return the values of messages, each repeated for the message's elements; None = once."""
    return values if counts is None else np.repeat(values, counts, axis=0)
