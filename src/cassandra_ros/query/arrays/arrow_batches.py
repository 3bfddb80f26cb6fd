# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of a topic as record batches of Arrow, read lazily.

Whole messages become columns together. Of format ``ros`` a few columns are read without the
messages.
"""

from __future__ import annotations

import logging
from itertools import chain
from typing import TYPE_CHECKING, Callable, Iterator, Sequence

import numpy as np

from cassandra_ros.errors import StoreUnavailable, TopicNotFound
from cassandra_ros.messages.stamps import Stamp
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
from cassandra_ros.query.arrays.batch import Batch, ReadBatches, RowParts, join_groups
from cassandra_ros.query.arrays.row_columns import RowColumns
from cassandra_ros.query.protocols import Table

if TYPE_CHECKING:
    import pyarrow

_log = logging.getLogger(__name__)

ARROW_BATCH_MESSAGES = 16384
"""Maximum number of messages in a batch; those of one block or page may be more."""
ARROW_BATCH_BYTES = 4 * 1024 * 1024
"""Size of serialised messages from which a batch ends, bytes."""
FEW_FIELDS = 8
"""Maximum number of fields that are read from each block by itself, if most are not read."""
APART_MESSAGES = 128
"""Minimum number of messages of one size in such a block: those of smaller groups are joined."""
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
        self.schema = self.arrow.schema([*own_fields, *fields])
        self._parts: dict[str, RowParts] = {}
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

    def parts(self, table: Table) -> RowParts:
        """Return what is read of a table's rows."""
        if table.name not in self._parts:
            reader = self.row_columns(table)
            columns = None if reader is None else reader.names
            self._parts[table.name] = RowParts(table, columns if self.of_table(table) else ())
        return self._parts[table.name]

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


class _BatchMaker:
    """Makes record batches of the messages of one table after the other."""

    def __init__(self, schema: ArrowSchema) -> None:
        self._schema = schema
        self._arrow = schema.arrow

    def make(self, batches: Sequence[Batch]) -> pyarrow.RecordBatch:
        """Make a record batch of some messages of one table."""
        table = batches[0].table
        fields, reader = self._schema.of_table(table), self._schema.row_columns(table)
        if not fields or table.definition is None:
            return self._with_own_columns(batches, ())
        if reader is not None and not batches[0].has_messages:
            parts = self._schema.parts(table)
            cells = [cells for batch in batches for cells in batch.cells(parts)]
            return self._with_own_columns(batches, reader.make(cells))
        apart = APART_MESSAGES if self._schema.reads_few(table) else None
        groups, count = join_groups(batches, apart), sum(map(len, batches))
        arrays, unread = make_columns(self._arrow, table.definition, fields, groups, count)
        if len(unread):
            keys, kind = np.concatenate([batch.times for batch in batches]), table.msg_type
            wires = [wire for batch in batches for wire in batch.wires]
            for n in unread.tolist():
                if wires[n] is not None:  # else it was told when the message was read
                    _log.warning("a message of type %s at %s cannot be read", kind, keys[n])
        return self._with_own_columns(batches, arrays)

    def _with_own_columns(
        self, batches: Sequence[Batch], field_arrays: Sequence[pyarrow.Array]
    ) -> pyarrow.RecordBatch:
        """Return a record batch of the arrays of fields, with the columns that are not fields."""
        arrow, schema, count = self._arrow, self._schema.schema, sum(map(len, batches))
        fields = self._schema.of_table(batches[0].table)
        columns = {field.name.lower(): array for field, array in zip(fields, field_arrays)}
        heads = {name: self._own(name, batches) for name in self._schema.own}
        arrays = []
        for n, field in enumerate(schema):
            array = heads.get(field.name) if n < len(heads) else columns.get(field.name.lower())
            if array is None:  # the definition of the table has no such field
                array = arrow.nulls(count, field.type)
            arrays.append(adapt(arrow, array, field.type))
        return arrow.RecordBatch.from_arrays(arrays, schema=schema)

    def _own(self, name: str, batches: Sequence[Batch]) -> pyarrow.Array:
        """Return the column KEY, NODE or RUN."""
        arrow = self._arrow
        if name == "KEY" and self._schema.named:
            return arrow.array(chain.from_iterable(map(_key_texts, batches)), arrow.string())
        if name == "KEY":
            times = np.concatenate([batch.times for batch in batches])
            return arrow.array(times, arrow.timestamp("ns"))
        owners = [owner for batch in batches for owner in batch.owners]
        runs = batches[0].table.runs
        texts = [owner.node if name == "NODE" else runs.text(owner.writer) for owner in owners]
        parts = [arrow.repeat(text, owner.messages) for text, owner in zip(texts, owners)]
        return arrow.concat_arrays(parts)


def _key_texts(batch: Batch) -> Sequence[str]:
    """Return the keys of messages as texts: names, or times in a table without names."""
    return batch.names or [str(Stamp.from_ns(t)) for t in batch.times.tolist()]


def read_record_batches(
    topic: str,
    schema: ArrowSchema,
    read: ReadBatches,
    watch: Callable[[], None] = lambda: None,
) -> Iterator[pyarrow.RecordBatch]:
    """Yield the messages of a topic as record batches, each of one table.

    Args:
        topic: Name of the topic, for the error text.
        schema: The columns.
        read: Reads the messages.
        watch: Called for each batch of messages; an exception from it ends the read.

    Raises:
        StoreUnavailable: The topic was removed during the read.
    """
    maker = _BatchMaker(schema)
    waiting: dict[tuple[str, bool], list[Batch]] = {}
    """What is not yielded yet, by what can be in one record batch."""
    count = size = 0
    try:
        for batch in read(schema.parts):
            watch()
            waiting.setdefault((batch.table.name, batch.has_messages), []).append(batch)
            count += len(batch)
            size += batch.size
            if count >= ARROW_BATCH_MESSAGES or size >= ARROW_BATCH_BYTES:
                yield from map(maker.make, waiting.values())
                waiting, count, size = {}, 0, 0
    except TopicNotFound as exc:
        raise StoreUnavailable(f"topic {topic} was removed while it was read") from exc
    yield from map(maker.make, waiting.values())
