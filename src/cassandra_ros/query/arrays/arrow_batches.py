# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of a topic as record batches of Arrow, read lazily.

Messages of blocks become columns without an object each; those of other formats are read as rows
first.
"""

from __future__ import annotations

import logging
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, Callable, Iterator, NamedTuple, Sequence

import numpy as np

from cassandra_ros.errors import CorruptMessage, MessageNotFound, StoreUnavailable, TopicNotFound
from cassandra_ros.keys import writer_of
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.arrays.arrow_columns import make_columns
from cassandra_ros.query.arrays.arrow_types import (
    OWN_COLUMNS,
    ArrowField,
    ColumnNames,
    Wanted,
    adapt,
    check_columns,
    count_leaves,
    fields_of,
    load_arrow,
    unite_schemas,
)
from cassandra_ros.query.arrays.field_arrays import ReadBlocks, ReadRows
from cassandra_ros.query.arrays.row_columns import RowColumns
from cassandra_ros.query.arrays.stacked_values import (
    MessageBlock,
    SizeGroups,
    group_by_size,
    join_blocks,
)
from cassandra_ros.query.protocols import Row, Table

if TYPE_CHECKING:
    import pyarrow

_log = logging.getLogger(__name__)

ARROW_BATCH_MESSAGES = 16384
"""Maximum number of messages in a batch; those of one block may be more."""
ARROW_BATCH_BYTES = 4 * 1024 * 1024
"""Size of serialised messages from which a batch ends, bytes."""
FEW_FIELDS = 8
"""Maximum number of fields that are read from each block by itself, if most are not read."""
APART_MESSAGES = 128
"""Minimum number of messages of one size in such a block: those of smaller groups are joined."""
MOST_UNUSUAL = 0.1
"""Largest share of rows whose columns do not hold all fields; with more of them the messages of all
rows are read, in one batch."""
UNITS = {"time": "ns since 1970, UTC", "duration": "ns"}
"""Units in the metadata of columns, by kind."""


class ArrowSchema:
    """The columns of a topic: KEY, NODE, RUN and the fields of all its definitions.

    Args:
        tables: Tables of the topic.
        wanted: The columns to make; None = all.
        names: Names that must be among them, see check_columns; None = not checked.

    Attributes:
        arrow: The module pyarrow.
        schema: Its schema.
        named: Whether KEY is a name.
        fields: Fields with a column, by name of the table.
        own: Names of the columns that are not fields.
        empty: Whether messages need not be read, because no field has a column.
    """

    def __init__(
        self,
        tables: Sequence[Table],
        wanted: Wanted | None = None,
        names: Sequence[str] | None = None,
    ) -> None:
        self.arrow = load_arrow("toArrow")
        self._wanted = wanted
        self._names = ColumnNames()
        self.named = any(table.named for table in tables)
        self.fields = {table.name: self._fields(table, wanted) for table in tables}
        key = self.arrow.string() if self.named else self.arrow.timestamp("ns")
        kinds = (key, self.arrow.string(), self.arrow.string())
        own_fields = [
            self.arrow.field(name, kind, metadata={"unit": UNITS["time"]} if name == "KEY" else {})
            for name, kind in zip(OWN_COLUMNS, kinds)
            if wanted is None or name.lower() in wanted
        ]
        schemas = [self._of(fields) for fields in self.fields.values()]
        fields = list(unite_schemas(self.arrow, schemas)) if schemas else []
        self.own = [field.name for field in own_fields]
        self.empty = not any(self.fields.values())
        self.schema = self.arrow.schema([*own_fields, *fields])
        self._row_columns: dict[str, RowColumns | None] = {}
        self._reads_few: dict[str, bool] = {}
        if names is not None:
            check_columns(self.schema, names)

    def _fields(self, table: Table, wanted: Wanted | None) -> tuple[ArrowField, ...]:
        return fields_of(table.definition, wanted, self._names)

    def _of(self, fields: Sequence[ArrowField]) -> pyarrow.Schema:
        return self.arrow.schema([(field.name, field.type(self.arrow)) for field in fields])

    def row_columns(self, table: Table) -> RowColumns | None:
        """Return the reader of a table's columns; None = messages are read."""
        if table.name not in self._row_columns:
            columns = None if self.named else RowColumns.of(self.arrow, table, self.of_table(table))
            self._row_columns[table.name] = columns
        return self._row_columns[table.name]

    def reads_few(self, table: Table) -> bool:
        """Return whether few of the fields of a table's messages are read."""
        if table.name not in self._reads_few:
            count = count_leaves(self.of_table(table))
            total = count_leaves(self._fields(table, None))
            self._reads_few[table.name] = count <= FEW_FIELDS and 2 * count <= total
        return self._reads_few[table.name]

    def of_table(self, table: Table) -> tuple[ArrowField, ...]:
        """Return the fields of a table, also of one that was made after the schema."""
        if table.name not in self.fields:
            self.fields[table.name] = self._fields(table, self._wanted)
        return self.fields[table.name]


class _MessageKeys(NamedTuple):
    """Keys, robots and runs of the messages of a batch."""

    keys: AnyArray
    """Times, ns, or names."""
    owners: Sequence[tuple[str, str, int]]
    """For each group of consecutive messages of one writer: nodeID, value of RUN, and number."""


class _BatchMaker:
    """Makes batches of the messages of one table after the other."""

    def __init__(self, schema: ArrowSchema) -> None:
        self._schema = schema
        self._arrow = schema.arrow

    def of_blocks(self, blocks: Sequence[MessageBlock]) -> pyarrow.RecordBatch:
        """Make a batch of some blocks of one table."""
        keys = np.concatenate([block.times for block in blocks])
        owners = [(block.node, block.run(), len(block.times)) for block in blocks]
        table = blocks[0].table
        apart = APART_MESSAGES if self._schema.reads_few(table) else None
        return self._make(table, _MessageKeys(keys, owners), join_blocks(blocks, apart))

    def of_rows(self, rows: Sequence[Row]) -> Iterator[pyarrow.RecordBatch]:
        """Yield batches of some rows of one table, without those that were deleted meanwhile."""
        reader = self._schema.row_columns(rows[0].table)
        raws = [] if reader is None else [reader.columns_of(row) for row in rows]
        if reader is None or raws.count(None) > MOST_UNUSUAL * len(rows):
            yield from self._of_messages(rows)
            return
        for usual, members in groupby(zip(rows, raws), lambda pair: pair[1] is not None):
            parts, columns = zip(*members)
            if usual:
                arrays = reader.make(columns)
                yield self._with_own_columns(parts[0].table, self._keys_of(parts), arrays)
            else:
                yield from self._of_messages(parts)

    def _of_messages(self, rows: Sequence[Row]) -> Iterator[pyarrow.RecordBatch]:
        """Yield a batch of rows whose messages are read, or none if all were deleted meanwhile."""
        wires: list[bytes | None] = []
        batch: list[Row] = []
        for row in rows:
            try:
                wires.append(None if self._schema.empty else row.wire)
            except MessageNotFound:
                continue
            except CorruptMessage:
                wires.append(None)
            batch.append(row)
        if batch:
            yield self._make(batch[0].table, self._keys_of(batch), group_by_size(wires))

    def _keys_of(self, rows: Sequence[Any]) -> _MessageKeys:
        owned = groupby(rows, key=lambda row: (row.node, writer_of(row.seq)))
        groups = [(node, list(members)) for (node, _), members in owned]
        owners = [(node, members[0].run, len(members)) for node, members in groups]
        if self._schema.named:
            return _MessageKeys(np.array([str(row.key) for row in rows], object), owners)
        return _MessageKeys(np.fromiter((row.t for row in rows), np.int64, len(rows)), owners)

    def _make(self, table: Table, keys: _MessageKeys, groups: SizeGroups) -> pyarrow.RecordBatch:
        """Make a batch of serialised messages; a message in no group has no values."""
        fields, count = self._schema.of_table(table), len(keys.keys)
        if not fields or table.definition is None:
            return self._with_own_columns(table, keys, ())
        arrays, unread = make_columns(self._arrow, table.definition, fields, groups, count)
        for n in unread.tolist():
            key, kind = keys.keys[n], table.msg_type
            _log.warning("a message of type %s at %s cannot be read", kind, key)
        return self._with_own_columns(table, keys, arrays)

    def _with_own_columns(
        self, table: Table, keys: _MessageKeys, field_arrays: Sequence[pyarrow.Array]
    ) -> pyarrow.RecordBatch:
        """Return a batch of the arrays of fields, with the columns that are not fields."""
        arrow, schema, count = self._arrow, self._schema.schema, len(keys.keys)
        fields = self._schema.of_table(table)
        columns = {field.name.lower(): array for field, array in zip(fields, field_arrays)}
        heads = {name: self._own(name, keys) for name in self._schema.own}
        arrays = []
        for n, field in enumerate(schema):
            array = heads.get(field.name) if n < len(heads) else columns.get(field.name.lower())
            if array is None:  # the definition of the table has no such field
                array = arrow.nulls(count, field.type)
            arrays.append(adapt(arrow, array, field.type))
        return arrow.RecordBatch.from_arrays(arrays, schema=schema)

    def _own(self, name: str, keys: _MessageKeys) -> pyarrow.Array:
        """Return the column KEY, NODE or RUN."""
        arrow = self._arrow
        if name == "KEY":
            kind = arrow.string() if self._schema.named else arrow.timestamp("ns")
            return arrow.array(keys.keys, kind)
        is_node = name == "NODE"
        parts = [arrow.repeat(node if is_node else run, n) for node, run, n in keys.owners]
        return arrow.concat_arrays(parts)


def read_batches(
    topic: str,
    schema: ArrowSchema,
    rows: ReadRows,
    blocks: ReadBlocks | None,
    watch: Callable[[], None] = lambda: None,
) -> Iterator[pyarrow.RecordBatch]:
    """Yield the messages of a topic as batches, each of one table.

    Args:
        topic: Name of the topic, for the error text.
        schema: The columns.
        rows: Reads the messages as rows.
        blocks: Reads the messages as blocks, if it can; None = as rows.
        watch: Called for each block or row; an exception from it ends the read.

    Raises:
        StoreUnavailable: The topic was converted or removed during the read.
    """
    maker = _BatchMaker(schema)
    block_stream = None if blocks is None or schema.named else blocks()
    if block_stream is None:
        yield from _of_rows(maker, rows(partial(_columns, schema)), watch)
        return
    try:
        yield from _of_blocks(maker, block_stream, watch)
    except TopicNotFound as exc:
        raise StoreUnavailable(
            f"topic {topic} was converted or removed while it was read: ask again"
        ) from exc


def _columns(schema: ArrowSchema, table: Table) -> Sequence[str] | None:
    """Return the columns of rows that must be read, see ColumnChoice."""
    if schema.empty:
        return ()
    reader = schema.row_columns(table)
    return None if reader is None else reader.names


def _of_blocks(
    maker: _BatchMaker, blocks: Iterator[MessageBlock], watch: Callable[[], None]
) -> Iterator[pyarrow.RecordBatch]:
    batch: list[MessageBlock] = []
    count = size = 0
    for block in blocks:
        watch()
        if batch and block.table.name != batch[0].table.name:
            yield maker.of_blocks(batch)
            batch, count, size = [], 0, 0
        batch.append(block)
        count += len(block.times)
        size += sum(planes.size for _, planes in block.groups)
        if count >= ARROW_BATCH_MESSAGES or size >= ARROW_BATCH_BYTES:
            yield maker.of_blocks(batch)
            batch, count, size = [], 0, 0
    if batch:
        yield maker.of_blocks(batch)


def _of_rows(
    maker: _BatchMaker, rows: Iterator[Row], watch: Callable[[], None]
) -> Iterator[pyarrow.RecordBatch]:
    batch: list[Row] = []
    size = 0
    for row in rows:
        watch()
        another = batch and row.table.name != batch[0].table.name
        if another or len(batch) >= ARROW_BATCH_MESSAGES or size >= ARROW_BATCH_BYTES:
            yield from maker.of_rows(batch)
            batch, size = [], 0
        batch.append(row)
        size += row.size
    if batch:
        yield from maker.of_rows(batch)
