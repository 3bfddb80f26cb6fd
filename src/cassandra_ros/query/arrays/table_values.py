# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of some fields of one table, gathered in arrays while its rows are read.

Rows are gathered in batches. Their columns stay undecoded until the whole batch is converted to
arrays. Only a field without a column of its own (an array inside an array of messages, say) is
decoded value by value.
"""

from __future__ import annotations

import logging
import struct
from dataclasses import replace
from typing import Callable, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from cassandra_ros.errors import CassandraRosError, CorruptMessage, InvalidQuery, MessageNotFound
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType, group_types
from cassandra_ros.query.arrays.column_values import (
    ColumnArray,
    Convert,
    cast_values,
    compile_convert,
    count_elements,
    empty_values,
    from_decoded,
    join_values,
    none_missing,
    objects_of,
)
from cassandra_ros.query.arrays.stacked_values import (
    MessageBlock,
    StackedField,
    group_by_size,
    join_blocks,
    read_stacked,
)
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.rows.name_resolution import KEY_PLACE, NODE_PLACE, Findings
from cassandra_ros.query.rows.projection import Projection, RowIdentity
from cassandra_ros.query.tree.field_names import FieldRef
from cassandra_ros.query.tree.syntax import Select

_log = logging.getLogger(__name__)

DECODED_BATCH_ROWS = 4096
"""Maximum number of rows that are decoded together."""
DECODED_BATCH_BYTES = 8 * 1024 * 1024
"""Size of the messages from which a batch of rows is decoded, bytes."""
BLOCKS_BYTES = 2 * 1024 * 1024
"""Size of the messages from which a batch of blocks is converted, bytes."""
BATCH_MESSAGES = 16384
"""Maximum number of messages in a batch of blocks; large, so that messages of rare sizes meet."""


Cut = Callable[[bytes], Sequence[Optional[bytes]]]
"""Function that cuts columns out of a serialised message."""


class Origin(NamedTuple):
    """The source of a field's values."""

    place: int
    """Index of the column among those that are cut out."""
    convert: Convert
    inside: bool
    """Whether the column is a list whose elements become rows."""


class TableValues:
    """Gathers the values of a statement's columns (fields, KEY, …) from the rows of one table.

    Undecoded columns are taken from the row, or cut out of the serialised message. If a field has
    no column of its own, all fields are decoded. A table is filled either by ``add`` or, where
    ``takes_blocks``, by ``add_block``; ``flush`` comes before its values are taken.

    Attributes:
        groups: Name and type of the columns of each selected path.
        block_keys: Times, nodes and _seq of the gathered blocks.
    """

    def __init__(self, select: Select, table: Table, findings: Findings) -> None:
        self._table, self._text = table, select.text
        self._projection = Projection.compile(select, table, findings)
        self.groups = group_types(self._projection, table)
        self._outputs = [output for group in self._projection.groups for output in group]
        self._kinds = [kind for group in self.groups for _, kind in group]
        self._arrays = [".".join(s.name for s in array) for array in self._projection.unnested]
        """Paths of the arrays that are unnested."""
        self._names: list[str] = []
        """Names of the needed columns, each once."""
        self._indices: dict[int, list[int] | None] = {}
        """See _indices_in, by number of columns."""
        plan = None if table.definition is None else wire_plan(table.definition)
        columns = {} if plan is None else {column.name: column for column in plan.all_columns}
        # Source of each output; None: the output has no column of its own.
        self._origins = [
            None if output.ref is None else self._origin(output.ref, kind, columns)
            for output, kind in zip(self._outputs, self._kinds)
        ]
        self._by_column = len(self._arrays) <= 1 and all(
            origin or (output.ref is None and output.compute is None)
            for output, origin in zip(self._outputs, self._origins)
        )
        """Whether the rows are converted column by column; else all fields are decoded."""
        self._cut = plan.cutter(self._names) if plan is not None and self._names else None
        condition = Projection.compile(replace(select, columns=()), table, Findings(select.text))
        # Checks the condition for each unnested element; None: all elements satisfy it.
        self._tester = condition if condition.unnested else None
        self._stacked = self._stacked_fields(columns)
        self.renew()

    def renew(self) -> None:
        """Discard the gathered values."""
        self._chunks: list[list[ColumnArray]] = [[] for _ in self._outputs]
        """The values of each batch, for each output."""
        self._orders: list[AnyArray] = []
        """The numbers of the rows that the values come from, for each batch."""
        self.block_keys: list[MessageBlock] = []
        self._clear()

    def _stacked_fields(self, columns: Mapping[str, FieldColumn]) -> list[StackedField]:
        """Return all fields, if they can be read from many messages at once; else []."""
        if self._table.by_field or self._arrays or not self._by_column:
            return []
        fields = [
            StackedField(output.ref, columns[output.ref.column], kind)
            for output, kind in zip(self._outputs, self._kinds)
            if output.ref is not None
        ]
        return fields if all(field.is_able for field in fields) else []

    @property
    def takes_blocks(self) -> bool:
        """Whether add_block may be called."""
        return bool(self._stacked) and self._tester is None

    def _origin(
        self, ref: FieldRef, kind: ArrayType, columns: Mapping[str, FieldColumn]
    ) -> Origin | None:
        """Return the source of a field's values; None: it must be decoded value by value."""
        column = columns.get(ref.column)
        inside = column is not None and column.array in self._arrays
        convert = None if column is None else compile_convert(ref, column, kind, inside)
        if column is None or convert is None:
            return None
        if column.name not in self._names:
            self._names.append(column.name)
        return Origin(self._names.index(column.name), convert, inside)

    @property
    def needed(self) -> Sequence[str]:
        """Columns of the table that must be read, in the table's order."""
        table_columns = self._table.columns
        if not self._by_column or not set(self._names) <= set(table_columns):
            return table_columns
        return [name for name in table_columns if name in self._names]

    def _read(self, row: Row) -> Sequence[bytes | None] | None:
        """Return the needed columns of a row, each None if the message is unreadable.

        If all fields are stacked, the only column is the whole message. Return None if the message
        was deleted after the row was read.
        """
        if self._cut is None:
            return ()
        try:
            if self._stacked:
                return (row.wire,)
            columns = row.columns
            indices = self._indices_in(len(columns))
            if indices is not None:
                raws = [columns[n] for n in indices]
                # In a row marked odd, a column that is set is exact.
                if None not in raws:
                    return raws
            return self._cut(row.wire)
        except MessageNotFound:
            return None
        except CorruptMessage as exc:
            _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
            return [None] * (1 if self._stacked else len(self._names))

    def _indices_in(self, width: int) -> list[int] | None:
        """Return the index of each needed column in a row with ``width`` columns.

        The width tells whether the row has all columns or the needed ones. None: it has others, or
        the columns are not fields.
        """
        if not self._table.by_field:
            return None
        if width not in self._indices:
            row_names = list(self._table.columns)
            if width != len(row_names):
                row_names = [name for name in row_names if name in self._names]
            fits = width == len(row_names) and all(name in row_names for name in self._names)
            self._indices[width] = [row_names.index(name) for name in self._names] if fits else None
        return self._indices[width]

    def _clear(self) -> None:
        """Begin a batch: what is known of the rows and blocks that are not converted yet."""
        self._numbers: list[int] = []
        self._own: list[RowIdentity] = []
        self._raws: list[Sequence[bytes | None]] = []
        self._hits: list[list[bool]] = []
        """For each element of a row whether it satisfies the condition."""
        self._decoded: list[Sequence[object]] = []
        self._blocks: list[MessageBlock] = []
        self._bytes = 0

    def add(self, row: Row, number: int) -> None:
        """Add a row that satisfies the condition; its number orders the rows of all tables.

        The numbers never fall.
        """
        projection = self._projection
        if self._by_column:
            raws = self._read(row)
            if raws is None:
                return
            self._numbers.append(number)
            self._own.append(projection.own(row))
            self._raws.append(raws)
            if self._tester is not None:
                self._hits.append(list(self._tester.hits(row)))
            self._bytes += sum([len(raw) for raw in raws if raw is not None])
        else:
            rows = list(projection.values(row))
            if self._tester is not None:
                rows = [values for values in rows if projection.check(values) is True]
            self._decoded += map(projection.complete, rows)
            self._numbers += [number] * len(rows)
            self._bytes += row.size
        if len(self._numbers) >= DECODED_BATCH_ROWS or self._bytes >= DECODED_BATCH_BYTES:
            self.flush()

    def add_block(self, block: MessageBlock) -> None:
        """Add a block of messages that all satisfy the condition; ``block_keys`` orders them."""
        self._blocks.append(block)
        self.block_keys.append(block._replace(groups=()))
        self._numbers += [0] * len(block.times)
        self._bytes += sum(planes.size for _, planes in block.groups)
        if len(self._numbers) >= BATCH_MESSAGES or self._bytes >= BLOCKS_BYTES:
            self.flush()

    def flush(self) -> None:
        """Convert the rows of the batch to arrays; CorruptMessage: a column is malformed."""
        if not self._numbers:
            return
        try:
            if self._stacked:
                chunks = self._all_at_once()
            else:
                chunks = self._column_by_column() if self._by_column else self._value_by_value()
        except (ValueError, struct.error) as exc:
            if isinstance(exc, CassandraRosError):
                raise
            raise CorruptMessage(f"a column of a row is malformed: {exc}") from exc
        for output_chunks, chunk in zip(self._chunks, chunks):
            output_chunks.append(chunk)
        self._clear()

    def _all_at_once(self) -> list[ColumnArray]:
        """Convert a batch whose fields are all stacked."""
        definition, cut = self._table.definition, self._cut
        if definition is None or cut is None:
            raise AssertionError("only fields of a definition are stacked")
        count = len(self._numbers)
        groups = (
            join_blocks(self._blocks) if self._blocks else group_by_size([r for (r,) in self._raws])
        )
        arrays, rest = read_stacked(definition, self._stacked, count, groups)
        columns = list(zip(*[self._cut_one(n, wire, cut) for n, wire in rest]))
        fields, indices = iter(arrays), np.array([n for n, _ in rest], np.int64)
        chunks = []
        for output, kind, origin in zip(self._outputs, self._kinds, self._origins):
            if origin is None:
                chunks.append(self._own_values(output.place, kind))
                continue
            chunk = next(fields)
            if rest:
                values, missing = origin.convert(columns[origin.place])
                chunk.values[indices], chunk.missing[indices] = values, missing
            if not chunk.missing.any():
                chunk = chunk._replace(missing=none_missing(count))
            chunks.append(chunk)
        self._orders.append(_order(self._numbers))
        return chunks

    def _cut_one(self, n: int, wire: bytes, cut: Cut) -> Sequence[bytes | None]:
        """Return the columns of message ``n`` of the batch, each None if it is unreadable."""
        try:
            return cut(wire)
        except CorruptMessage as exc:
            key = self._own_values(KEY_PLACE, ArrayType("time")).values[n]
            kind = self._table.msg_type
            _log.warning("a message of type %s at %s cannot be read: %s", kind, key, exc)
            return [None] * len(self._names)

    def _value_by_value(self) -> list[ColumnArray]:
        """Convert a batch of decoded values."""
        columns = list(zip(*self._decoded))
        self._orders.append(_order(self._numbers))
        chunks = []
        for output, kind in zip(self._outputs, self._kinds):
            try:
                chunks.append(from_decoded(columns[output.place], kind))
            except OverflowError as exc:
                reason = f"{output.name} goes beyond int64 nanoseconds; executeCQL answers it"
                raise InvalidQuery(self._text, len("SELECT "), reason) from exc
        return chunks

    def _column_by_column(self) -> list[ColumnArray]:
        """Convert a batch of columns; values outside an unnested array repeat for its elements."""
        columns = list(zip(*self._raws))
        counts = hits_mask = None
        if self._tester is not None:
            counts = np.array([len(hits) for hits in self._hits])
            hits_mask = np.array([hit for hits in self._hits for hit in hits], bool)
        else:
            place = next((o.place for o in self._origins if o is not None and o.inside), None)
            counts = None if place is None else count_elements(columns[place])
        chunks = []
        for output, kind, origin in zip(self._outputs, self._kinds, self._origins):
            if origin is None:
                chunk, repeats = self._own_values(output.place, kind), counts
            else:
                chunk = origin.convert(columns[origin.place])
                repeats = None if origin.inside else counts
            chunks.append(ColumnArray(*(_choose(values, repeats, hits_mask) for values in chunk)))
        self._orders.append(_choose(_order(self._numbers), counts, hits_mask))
        return chunks

    def _own_values(self, place: int, kind: ArrayType) -> ColumnArray:
        """Return KEY, NODE or RUN (``place``: KEY_PLACE, say) of the messages of the batch."""
        if self._blocks:
            return self._own_values_of_blocks(place)
        column = [identity[place] for identity in self._own]
        values = objects_of(column) if kind.dtype.kind == "O" else np.array(column, np.int64)
        return ColumnArray(values, none_missing(len(column)))

    def _own_values_of_blocks(self, place: int) -> ColumnArray:
        blocks = self._blocks
        counts = [len(block.times) for block in blocks]
        if place == KEY_PLACE:
            values = np.concatenate([block.times for block in blocks])
        else:
            texts = [block.node if place == NODE_PLACE else block.run() for block in blocks]
            values = np.repeat(objects_of(texts), counts)
        return ColumnArray(values, none_missing(sum(counts)))

    @property
    def count(self) -> int:
        """Number of values of each output."""
        return sum(len(order) for order in self._orders)

    @property
    def order(self) -> AnyArray:
        """Numbers of the rows that the values come from."""
        return np.concatenate(self._orders)

    def pop_column(self, name: str, kind: ArrayType) -> ColumnArray:
        """Return the values of a column as type ``kind``, and forget them to free their memory.

        Each column is taken once. If the table lacks the column, each value is missing.
        """
        for n, (output, own_kind) in enumerate(zip(self._outputs, self._kinds)):
            if output.name == name:
                chunks, self._chunks[n] = self._chunks[n], []
                return cast_values(join_values(chunks, own_kind), own_kind, kind)
        return empty_values(kind, self.count)


def _order(numbers: Sequence[int]) -> AnyArray:
    """Return the numbers of one or more rows as an array; they never fall."""
    # As long as only one table has rows, all numbers are 0 and take no memory.
    return np.array(numbers) if numbers[-1] else np.broadcast_to(np.int64(0), (len(numbers),))


def _choose(values: AnyArray, counts: AnyArray | None, mask: AnyArray | None) -> AnyArray:
    """Repeat the values of a message for each of its elements, and keep those that match."""
    if counts is not None:
        values = np.repeat(values, counts, axis=0)
    return values if mask is None else values[mask]
