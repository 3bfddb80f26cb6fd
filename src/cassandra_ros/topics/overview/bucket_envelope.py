# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The envelope of a statement's columns in one piece: a bucket, or a part of a long one.

For blocks of format ``packed`` the zones are enough, if a whole block is in one pixel and the
condition contains only KEY, NODE and RUN. Blocks across the edge of a pixel are unpacked later. All
other messages are read and made into arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterator, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.messages.wire.zones import HIGH, LOW
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType, group_types
from cassandra_ros.query.arrays.batch import Batch
from cassandra_ros.query.arrays.column_values import Convert, compile_convert
from cassandra_ros.query.arrays.envelope import Envelope, Grid, finite
from cassandra_ros.query.arrays.table_values import TableValues
from cassandra_ros.query.plan.bounds import Bounds
from cassandra_ros.query.plan.pushdown import Pushdown, Watch
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.rows.projection import Projection
from cassandra_ros.query.tree.field_names import FieldRef, field_of
from cassandra_ros.query.tree.syntax import FieldPath, KeyOperand, Select, Selected, StatementError
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.blocks.block_bounds import BlockZones, ask_bounds, open_blocks, read_bounds
from cassandra_ros.store.blocks.block_row import BlockRow
from cassandra_ros.store.blocks.block_stream import BucketRead
from cassandra_ros.store.connection.requests import PagedRead
from cassandra_ros.store.tables.row_table import MAX_SEQ, MIN_SEQ
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.overview.plot_columns import Column, as_floats
from cassandra_ros.topics.row_reader import portion_batches
from cassandra_ros.topics.topic_table import TopicTable

EDGES_AT_ONCE = 64
"""Number of blocks unpacked between two checks of the deadline."""
MOST_MESSAGES = 100_000
"""Number of messages that are made into arrays together."""
_NOTHING = ArrayType("mixed")
"""Type in place of a column that a table lacks."""
ZoneRead = Optional[Tuple[BucketRead, PagedRead]]
"""A read of zones that was sent; None = messages have to be read."""


class BucketPiece(NamedTuple):
    """A bucket, or a part of a long one, that is read at once."""

    table: TopicTable
    node: str
    bucket: int
    low: int
    high: int
    """First and last time of the piece, both included, ns."""


class PieceEnvelope:
    """The envelope of a piece as far as it was read.

    Attributes:
        sure: Envelope of the messages in pixels that are exact.
        edges: Blocks that have still to be unpacked.
        around: For the pixels of these blocks the values that they may contain.
    """

    def __init__(self, grid: Grid, columns: int) -> None:
        self.sure = Envelope(grid, columns)
        self.around = Envelope(grid, columns)
        self.edges: Sequence[BlockRow] = ()

    @property
    def nbytes(self) -> int:
        """Approximate size in memory, bytes."""
        return self.sure.nbytes + self.around.nbytes + 512 * len(self.edges)


class _ZoneColumns(NamedTuple):
    """Zone columns of a table, and how to read them."""

    names: tuple[str, ...]
    """Names of the zone columns: two for each column that the table has."""
    converts: tuple[tuple[Convert, ArrayType] | None, ...]
    """Conversion for each column; None = the table lacks the column."""


@dataclass(frozen=True)
class EnvelopeRequest:
    """The columns of a topic's messages that are drawn, and the condition for the messages."""

    select: Select
    """The statement; only its condition counts."""
    bounds: Bounds
    """Range, node and writers of the condition, narrowed by those of the request."""
    columns: tuple[Column, ...]
    """The columns; none of them is an aggregate."""
    key: str
    """Text that identifies this request among all requests for the topic."""

    @property
    def selected(self) -> Select:
        """The statement that selects KEY and the columns, which are named by their numbers."""
        columns = [Selected(column.what, str(n)) for n, column in enumerate(self.columns)]
        key = Selected(KeyOperand(0))
        plain = replace(self.select, order=(), hidden=(), limit=None, descending=False)
        return replace(plain, columns=(key, *columns))


class PieceReader:
    """Reads pieces of the buckets of a topic.

    Args:
        keyspace: Keyspace of the topic.
        request: Columns and condition to read.
        watch: See Watch.
    """

    def __init__(self, keyspace: Keyspace, request: EnvelopeRequest, watch: Watch) -> None:
        self._rows = keyspace.rows
        self._request, self._watch = request, watch
        self._select = request.selected
        self._columns = len(request.columns)
        self._zone_columns: dict[str, _ZoneColumns | None] = {}
        """Table → how its zones are read; None = messages have to be read."""

    def ask(self, piece: BucketPiece) -> ZoneRead:
        """Request the zones of a piece's blocks, if they are enough."""
        name = piece.table.name
        if name not in self._zone_columns:
            self._zone_columns[name] = self._zones(piece.table)
        zone_columns = self._zone_columns[name]
        if zone_columns is None:
            return None
        blocks = self._blocks(piece)
        return blocks, ask_bounds(blocks, zone_columns.names)

    def read(self, piece: BucketPiece, shift: int, coming: ZoneRead) -> PieceEnvelope:
        """Read a piece in pixels of 2 ** shift ns; coming: result of ``ask`` for the piece."""
        envelope = PieceEnvelope(Grid.over(piece.low, piece.high, shift), self._columns)
        if coming is None:
            self._add_messages(piece, envelope.sure)
        else:
            self._add_bounds(piece, envelope, list(read_bounds(*coming)))
        return envelope

    def refined(self, piece: BucketPiece, earlier: PieceEnvelope) -> PieceEnvelope:
        """Return the envelope of a piece after some more of its edges were unpacked.

        ``earlier``, which may be cached, is not changed.
        """
        envelope = PieceEnvelope(earlier.sure.grid, self._columns)
        envelope.sure.merge(earlier.sure)
        edges, envelope.edges = earlier.edges[:EDGES_AT_ONCE], earlier.edges[EDGES_AT_ONCE:]
        values = self._values(piece.table)
        messages = open_blocks(self._blocks(piece), edges)
        for batch in portion_batches(messages, piece.table, lambda _: values.parts):
            self._watch()
            values.add(batch)
        _drain(values, envelope.sure)
        if envelope.edges:
            envelope.around.merge(earlier.around)
        return envelope

    def _blocks(self, piece: BucketPiece) -> BucketRead:
        """Return the read of the blocks of a piece."""
        ends = (piece.low, MIN_SEQ), (piece.high, MAX_SEQ)
        writers = self._request.bounds.read.whose.writers
        return BucketRead(piece.table, piece.node, piece.bucket, ends, writers=writers)

    def _zones(self, table: TopicTable) -> _ZoneColumns | None:
        """Return how the zones of all columns are read; None if messages have to be read."""
        zone_map = table.zone_map
        if zone_map is None or not self._request.bounds.whole:
            return None
        names: list[str] = []
        converts: list[tuple[Convert, ArrayType] | None] = []
        projection = Projection.compile(self._select, table, Findings(self._select.text))
        for column, group in zip(self._request.columns, group_types(projection, table)[1:]):
            if not group:
                converts.append(None)
                continue
            ref = _plain_field(column, table)
            zone = None if ref is None else zone_map.fields.get(ref.column)
            kind = group[0][1]
            convert = None if not (ref and zone) else compile_convert(ref, zone, kind, False)
            if zone is None or convert is None or zone.is_list:
                return None
            names += [LOW + zone.name, HIGH + zone.name]
            converts.append((convert, kind))
        return _ZoneColumns(tuple(names), tuple(converts))

    def _add_bounds(
        self, piece: BucketPiece, envelope: PieceEnvelope, blocks: Sequence[BlockZones]
    ) -> None:
        """Add blocks by their zones, and note as edges those that have to be unpacked.

        The zones of a block are enough if it lies in one pixel and in the piece, and if they are
        exact and finite.
        """
        zone_columns = self._zone_columns[piece.table.name]
        if zone_columns is None or not blocks:
            return
        ends = [(b.header.t, b.header.last, b.header.left, b.exact) for b in blocks]
        firsts, lasts, rows, exact = (np.array(column, np.int64) for column in zip(*ends))
        places = envelope.sure.grid.places
        sure = (exact > 0) & (places(firsts) == places(lasts))
        sure &= (firsts >= piece.low) & (lasts <= piece.high)
        low, high = self._numbers(zone_columns, [block.values for block in blocks])
        # An infinite bound hides the finite one, which only the messages tell.
        sure &= ~(np.isinf(low) | np.isinf(high)).any(axis=0)
        low, high = finite(low), finite(high)
        envelope.sure.add_spans(firsts[sure], lasts[sure], low[:, sure], high[:, sure], rows[sure])
        edge = ~sure
        envelope.edges = [blocks[n].header for n in np.flatnonzero(edge).tolist()]
        envelope.around.add_wide(firsts[edge], lasts[edge], low[:, edge], high[:, edge])

    def _numbers(
        self, zone_columns: _ZoneColumns, values: Sequence[Sequence[bytes | None]]
    ) -> tuple[AnyArray, AnyArray]:
        """Return the minimum and the maximum of each column: (columns, blocks) each.

        Args:
            values: For each block the encoded values of ``zone_columns.names``.
        """
        encoded_columns = iter(list(zip(*values)))
        low, high = (np.full((self._columns, len(values)), np.nan) for _ in range(2))
        for n, convert in enumerate(zone_columns.converts):
            if convert is not None:
                decode, kind = convert
                low[n] = as_floats(decode(next(encoded_columns)), kind)
                high[n] = as_floats(decode(next(encoded_columns)), kind)
        return low, high

    def _values(self, table: TopicTable) -> TableValues:
        """Return an object that makes arrays of KEY and the columns, from messages of a table."""
        return TableValues(self._select, table, Findings(self._select.text))

    def _add_messages(self, piece: BucketPiece, envelope: Envelope) -> None:
        """Read the messages of a piece, and make arrays of a limited number at a time."""
        values, count = self._values(piece.table), 0
        for batch in self._batches(piece, values):
            self._watch()
            values.add(batch)
            count += len(batch)
            if count >= MOST_MESSAGES:
                _drain(values, envelope)
                count = 0
        _drain(values, envelope)

    def _batches(self, piece: BucketPiece, values: TableValues) -> Iterator[Batch]:
        """Yield the messages of a piece that satisfy the condition.

        Raises:
            TopicNotFound: The table was replaced or dropped meanwhile.
        """
        whose = Whose((piece.node,), self._request.bounds.read.whose.writers)
        read = Read(TimeRange(piece.low, piece.high), whose)
        table, bounds = piece.table, self._request.bounds
        check = None
        if not bounds.whole:
            read = replace(read, chooser=Pushdown(self._select.condition, watch=self._watch))
            no_columns = replace(self._select, columns=())
            test = Projection.compile(no_columns, table, Findings(self._select.text))
            check = lambda _: test  # noqa: E731
        for span_read in replace(bounds, read=read).reads():
            for batch in self._rows.batches([table], span_read, lambda _: values.parts, check):
                if batch.table.name != table.name:
                    raise TopicNotFound(f"table {table.name} was replaced while it was read")
                yield batch


def _plain_field(column: Column, table: TopicTable) -> FieldRef | None:
    """Return the field that a column shows unchanged; None if it shows something else."""
    if not isinstance(column.what, FieldPath) or table.definition is None:
        return None
    try:
        ref = field_of(column.what, table.definition)
    except StatementError:
        return None
    return None if ref.part or ref.index is not None else ref


def _drain(values: TableValues, envelope: Envelope) -> None:
    """Move the gathered values into an envelope."""
    values.flush()
    # The first group is KEY. A group is empty if the table lacks the column.
    (key_name, key), *kinds = (next(iter(group), ("", _NOTHING)) for group in values.groups)
    times = values.pop_column(key_name, key).values
    numbers = np.full((len(kinds), len(times)), np.nan)
    for n, (name, kind) in enumerate(kinds):
        if kind is not _NOTHING:
            numbers[n] = as_floats(values.pop_column(name, kind), kind)
    envelope.add(times, numbers)
    values.renew()
