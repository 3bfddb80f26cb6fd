# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Batches: messages of one table that are read together.

The messages of a block or of a page of rows, or a part of them, are a batch; other rows are cut
into batches (``row_batches``). A batch has the keys of its messages, and either the messages or
some of their columns. Which of them a reader needs of a table, it says with ``RowParts``. Messages
lie in planes, so that a field of all of them is read at once.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from contextlib import suppress
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from typing import Callable, Iterable, Iterator, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.keys import COUNTER_BITS, Position
from cassandra_ros.messages.wire.message_stacks import (
    ByteArray,
    Int64Array,
    Planes,
    by_size,
    copy_planes,
)
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.rows.projection import Projection, RowIdentity

_log = logging.getLogger(__name__)

ROW_BATCH_MESSAGES = 2048
"""Maximum number of messages in a batch of rows; few, because Python's collector walks through all
rows that exist at the same time."""
ROW_BATCH_BYTES = 8 * 1024 * 1024
"""Size of the messages of rows from which a batch of them ends, bytes, whatever is read of them."""

SizeGroups = Iterable[Tuple[Int64Array, Planes]]
"""Pairs of message indices, ascending, and message planes; one pair for each message size."""
LARGE_BYTES = 256 * 1024
"""Size from which a message is read when its row comes, so that those of the next rows are
requested meanwhile."""
_get_time, _get_seq, _get_node = attrgetter("t"), attrgetter("seq"), attrgetter("node")

Cells = Optional[Sequence[bytes]]
"""Some columns of a message, in CQL's encoding; None = the message is unreadable, or no column is
named."""


class Owner(NamedTuple):
    """The robot and the writer of consecutive messages of a batch."""

    node: str
    writer: int
    """Writer id."""
    messages: int
    """Number of the messages."""


class Batch(ABC):
    """Messages of one table.

    Args:
        table: The table.
        times: Row keys of the messages, ns. Of messages with names the times of the names.
        seqs: ``_seq`` of the messages.
        owners: Robots and writers of the messages.

    Attributes:
        names: Names of the messages; () if they are found by their times.
    """

    names: Sequence[str] = ()
    has_messages = True
    """Whether the messages were read; else only their keys, or some columns."""

    def __init__(
        self, table: Table, times: Int64Array, seqs: Int64Array, owners: Sequence[Owner]
    ) -> None:
        self.table, self.owners = table, owners
        self.times, self.seqs = times, seqs

    def __len__(self) -> int:
        return len(self.times)

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of bytes of what was read of the messages."""

    @property
    @abstractmethod
    def groups(self) -> SizeGroups:
        """The messages; one that is in no group is unreadable, or was not read."""

    @property
    @abstractmethod
    def wires(self) -> Sequence[bytes | None]:
        """The messages one by one; None = it is unreadable, or was not read."""

    def cells(self, parts: RowParts) -> Sequence[Cells]:
        """Return some columns of each message.

        Args:
            parts: Names the columns. Of rows of which columns were read, it is what was asked for.
        """
        return [parts.cut(wire, t) for wire, t in zip(self.wires, self.times.tolist())]

    def identities(self, *, runs: bool = False) -> Iterator[RowIdentity]:
        """Yield what a condition knows of each message besides its fields.

        Args:
            runs: Whether RUN is needed; else it is ''.
        """
        times = self.times.tolist()
        keys: Sequence[int | str] = self.names or times
        begin = 0
        for node, writer, messages in self.owners:
            run = self.table.runs.text(writer) if runs else ""
            end = begin + messages
            yield from ((key, node, run, t) for key, t in zip(keys[begin:end], times[begin:end]))
            begin = end


class StackedBatch(Batch):
    """Messages of one robot that lie together, as those of a block, in the order of the read.

    Attributes:
        node: nodeID of the messages.

    Args:
        groups: Messages by size.
        chosen: For each message in ``groups`` whether it is in the batch; None = all are. The
            others are kept until ``groups`` or ``size`` is asked.
        unsure: For each message whether the condition of the read has to be checked again, because
            the store is not sure; None = all have to be.
    """

    def __init__(
        self,
        table: Table,
        node: str,
        times: Int64Array,
        seqs: Int64Array,
        groups: Sequence[tuple[Int64Array, Planes]],
        chosen: NDArray[np.bool_] | None = None,
        unsure: NDArray[np.bool_] | None = None,
    ) -> None:
        super().__init__(table, times, seqs, _writers_of(node, seqs))
        self.node, self._groups, self._chosen, self._unsure = node, groups, chosen, unsure

    @property
    def size(self) -> int:
        """Number of bytes of the messages."""
        return sum(planes.size for _, planes in self.groups)

    @property
    def groups(self) -> Sequence[tuple[Int64Array, Planes]]:
        """The messages; one that is in no group is unreadable."""
        if self._chosen is not None:
            self._groups, self._chosen = choose_groups(self._groups, self._chosen), None
        return self._groups

    @property
    def wires(self) -> Sequence[bytes | None]:
        """The messages one by one; None = it is unreadable."""
        wires: list[bytes | None] = [None] * len(self)
        for members, planes in self.groups:
            size, data = len(planes), planes.T.tobytes()
            for k, n in enumerate(members.tolist()):
                wires[n] = data[k * size : (k + 1) * size]
        return wires

    def position_of(self, n: int) -> Position:
        """Return the position of a message by its index."""
        return Position(int(self.times[n]), self.node, int(self.seqs[n]), self.table.name)

    def only(self, mask: NDArray[np.bool_]) -> StackedBatch:
        """Return the batch of some of its messages: a bool for each."""
        if mask.all():
            return self
        chosen = mask
        if self._chosen is not None:
            chosen = self._chosen.copy()
            chosen[chosen] = mask
        times, seqs = self.times[mask], self.seqs[mask]
        return StackedBatch(self.table, self.node, times, seqs, self._groups, chosen)

    @property
    def unsure(self) -> NDArray[np.bool_]:
        """For each message whether the condition of the read has to be checked again."""
        return np.ones(len(self), bool) if self._unsure is None else self._unsure

    def passing(self, projection: Projection) -> StackedBatch:
        """Return the batch of those messages that satisfy the condition of a projection."""
        unsure = self.unsure
        if not unsure.any():
            return self
        doubtful = self.only(unsure)
        wires = doubtful.wires if projection.extractor is not None else [None] * len(doubtful)
        mask = ~unsure
        mask[unsure] = [
            projection.passes(identity, wire)
            for identity, wire in zip(doubtful.identities(runs=projection.runs), wires)
        ]
        return self.only(mask)


class Window:
    """Batches whose messages may lie between each other; no other message of the read does.

    Attributes:
        batches: The batches.
    """

    def __init__(self, batches: Sequence[StackedBatch]) -> None:
        self.batches = batches

    def __len__(self) -> int:
        return sum(map(len, self.batches))

    @property
    def size(self) -> int:
        """Number of bytes of the messages."""
        return sum(batch.size for batch in self.batches)

    @property
    def position(self) -> Position:
        """Position of the last message."""
        return max(batch.position_of(-1) for batch in self.batches)

    @cached_property
    def order(self) -> Int64Array | None:
        """Index of each message, in the order of reading, among those of all batches.

        None: they are in this order.
        """
        if len(self.batches) == 1:
            return None
        times = np.concatenate([batch.times for batch in self.batches])
        seqs = np.concatenate([batch.seqs for batch in self.batches])
        names = [b.node for b in self.batches], [b.table.name for b in self.batches]
        counts = list(map(len, self.batches))
        nodes, tables = (
            np.repeat(np.unique(texts, return_inverse=True)[1], counts) for texts in names
        )
        order: Int64Array = np.lexsort((tables, seqs, nodes, times))
        return order

    @cached_property
    def _starts(self) -> Int64Array:
        return np.cumsum([0, *map(len, self.batches)])

    def position_of(self, n: int) -> Position:
        """Return the position of a message by its number in the order of reading."""
        at = n if self.order is None else int(self.order[n])
        number = int(self._starts.searchsorted(at, "right")) - 1
        return self.batches[number].position_of(at - int(self._starts[number]))


class RowBatch(Batch):
    """Messages of rows, in the order of the read.

    Args:
        rows: The rows, at least one. They are not kept, because they hold whole messages.
        wires: Their messages, see ``wires``; None = they were not read.
        cells: Their columns; None = they were not read.
    """

    def __init__(
        self,
        rows: Sequence[Row],
        wires: Sequence[bytes | None] | None,
        cells: Sequence[Cells] | None,
    ) -> None:
        table, count = rows[0].table, len(rows)
        seqs = np.fromiter(map(_get_seq, rows), np.int64, count)
        times = np.fromiter(map(_get_time, rows), np.int64, count)
        super().__init__(table, times, seqs, _owners(list(map(_get_node, rows)), seqs))
        if table.named:
            self.names = [row.name for row in rows]
        self._wires, self._cells = wires, cells
        self.has_messages = wires is not None

    @property
    def size(self) -> int:
        """Number of bytes of what was read of the messages."""
        if self._cells is not None:
            return sum([sum(map(len, cells)) for cells in self._cells if cells is not None])
        return sum([len(wire) for wire in self._wires or () if wire is not None])

    @property
    def groups(self) -> SizeGroups:
        """The messages; one that is in no group is unreadable, or was not read."""
        return group_by_size(self.wires)

    @property
    def wires(self) -> Sequence[bytes | None]:
        """The messages one by one; None = it is unreadable, or was not read."""
        return [None] * len(self) if self._wires is None else self._wires

    def cells(self, parts: RowParts) -> Sequence[Cells]:
        """Return some columns of each message, see Batch."""
        return super().cells(parts) if self._cells is None else self._cells


def _owners(nodes: Sequence[str], seqs: Int64Array) -> Sequence[Owner]:
    """Return the owners of messages, from the nodeID and the ``_seq`` of each."""
    if len(set(nodes)) == 1:
        return _writers_of(nodes[0], seqs)
    owned = groupby(zip(nodes, (seqs >> COUNTER_BITS).tolist()))
    return [Owner(node, writer, len(list(pairs))) for (node, writer), pairs in owned]


def _writers_of(node: str, seqs: Int64Array) -> Sequence[Owner]:
    """Return the owners of messages of one robot, from the ``_seq`` of each."""
    writers = seqs >> COUNTER_BITS
    if len(writers) and (writers == writers[0]).all():
        return [Owner(node, int(writers[0]), len(writers))]
    owned = groupby(writers.tolist())
    return [Owner(node, writer, len(list(same))) for writer, same in owned]


class RowParts:
    """What is read of the rows of a table: only keys, some columns, or the messages.

    Args:
        table: The table.
        columns: Names of the columns, in the table's order; () = only keys; None = the messages.
        fields: Names of the columns that ``cut`` returns; None = ``columns``.
    """

    def __init__(
        self, table: Table, columns: Sequence[str] | None, fields: Sequence[str] | None = None
    ) -> None:
        self.columns = columns
        self._table = table
        self._names = fields if fields is not None else columns or ()
        self._cut = None
        if table.definition is not None and self._names:
            self._cut = wire_plan(table.definition).cutter(self._names)
        self._width = len(table.columns)
        self._places = [table.columns.index(name) for name in columns or ()]

    @property
    def only_keys(self) -> bool:
        """Whether neither columns nor messages are read."""
        return self.columns is not None and not self.columns

    def read(self, rows: Sequence[Row]) -> RowBatch | None:
        """Read rows of the table; None = the messages of all of them were deleted meanwhile.

        If only keys are read, it is not noticed that a message was deleted.
        """
        if self.only_keys:
            return RowBatch(rows, None, [()] * len(rows))
        if self.columns is None:
            with suppress(CorruptMessage, MessageNotFound):
                return RowBatch(rows, [row.wire for row in rows], None)
        else:
            all_columns = [self._columns_in(row) for row in rows]
            if None not in all_columns:
                return RowBatch(rows, None, all_columns)
        return self._read_singly(rows)

    def _read_singly(self, rows: Sequence[Row]) -> RowBatch | None:
        """Read rows of which some messages are damaged, deleted or without columns."""
        kept: list[Row] = []
        wires: list[bytes | None] = []
        cells: list[Cells] = []
        for row in rows:
            try:
                if self.columns is None:
                    wires.append(row.wire)
                else:
                    columns = self._columns_in(row)
                    cells.append(self.cut(row.wire, row.t) if columns is None else columns)
            except MessageNotFound:
                continue
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
                wires.append(None)
                cells.append(None)
            kept.append(row)
        if not kept:
            return None
        whole = self.columns is None
        return RowBatch(kept, wires if whole else None, None if whole else cells)

    def read_ahead(self, row: Row) -> None:
        """Read the message of a large row if it is needed. The row keeps it until ``read``."""
        if self.columns is None or (self.columns and self._columns_in(row) is None):
            with suppress(CorruptMessage, MessageNotFound):  # ``read`` tells of it
                _ = row.wire

    def _columns_in(self, row: Row) -> Sequence[bytes] | None:
        """Return the columns of a row; None = they have to be cut out of its message."""
        columns: Sequence[bytes | None] = row.columns
        # A row has all columns, those that were requested, or its message in their place.
        if len(columns) == self._width:
            columns = [columns[n] for n in self._places]
        # In a row marked odd, a column that is set is exact.
        if len(columns) != len(self._places) or None in columns:
            return None
        return columns  # type: ignore[return-value]  # no column is None

    def cut(self, wire: bytes | None, t: int) -> Cells:
        """Return the columns of a message; None: it is unreadable, or no column is named.

        Args:
            wire: The message.
            t: Its time, ns, for the warning.
        """
        if wire is not None and self._cut is not None:
            try:
                return self._cut(wire)
            except CorruptMessage as exc:
                kind = self._table.msg_type
                _log.warning("a message of type %s at %s cannot be read: %s", kind, t, exc)
        return None


PartsOf = Callable[[Table], RowParts]
"""Function of a table that returns what is read of its rows."""
ReadBatches = Callable[[PartsOf], Iterator[Batch]]
"""Function that reads messages."""


CheckOf = Callable[[Table], Projection]
"""Function of a table that returns the check of a condition on its messages."""
LeastOf = Callable[[Table], Optional[int]]
"""Function of a table: the minimum number of messages that come together, for each portion in which
they were read; None = they come one by one."""


def only_keys(table: Table) -> RowParts:
    """Return that nothing but the keys of a table's messages is read."""
    return RowParts(table, ())


def row_batches(rows: Iterable[Row | Batch], parts_of: PartsOf) -> Iterator[Batch]:
    """Yield rows as batches, without messages that were deleted meanwhile.

    The batches of a table are in the order of the rows; those of a table with few rows may come
    last. Batches among the rows are yielded as they come.
    """
    waiting: dict[str, _WaitingRows] = {}
    table: Table | None = None
    for row in rows:
        if isinstance(row, Batch):
            yield row
            continue
        if row.table is not table:
            table = row.table
            if table.name not in waiting:
                waiting[table.name] = _WaitingRows(parts_of(table))
            rows_of_table = waiting[table.name]
        rows_of_table.rows.append(row)
        rows_of_table.size += row.size
        if row.size >= LARGE_BYTES:
            rows_of_table.parts.read_ahead(row)
        full = len(rows_of_table.rows) >= ROW_BATCH_MESSAGES
        if full or rows_of_table.size >= ROW_BATCH_BYTES:
            batch = rows_of_table.take()
            if batch is not None:
                yield batch
    for rows_of_table in waiting.values():
        batch = rows_of_table.take()
        if batch is not None:
            yield batch


class _WaitingRows:
    """Rows of a table that become a batch together."""

    def __init__(self, parts: RowParts) -> None:
        self.parts = parts
        self.rows: list[Row] = []
        self.size = 0
        """Size of their messages, bytes."""

    def take(self) -> Batch | None:
        """Return the batch of the rows, and forget them; None = no message is left."""
        rows, self.rows, self.size = self.rows, [], 0
        return self.parts.read(rows) if rows else None


def choose_groups(
    groups: Iterable[tuple[Int64Array, Planes]], mask: NDArray[np.bool_]
) -> Sequence[tuple[Int64Array, Planes]]:
    """Return the groups of some of their messages, numbered anew; ``mask``: a bool for each."""
    if mask.all():
        return list(groups)
    numbers = np.cumsum(mask) - 1
    chosen: list[tuple[Int64Array, Planes]] = []
    for members, planes in groups:
        inside = mask[members]
        if inside.any():
            chosen.append((numbers[members[inside]], planes[:, inside]))
    return chosen


def group_by_size(wires: Sequence[bytes | None]) -> SizeGroups:
    """Group messages by size; None stands for a missing message."""
    indices = np.array([n for n, wire in enumerate(wires) if wire is not None], np.int64)
    for members, planes in by_size([wire for wire in wires if wire is not None]):
        yield indices[members], planes


def join_groups(batches: Sequence[Batch], apart: int | None = None) -> SizeGroups:
    """Join the groups of batches: if sizes vary, each block has only few messages of a size.

    Args:
        batches: The batches.
        apart: Number of messages from which a group is not joined, because all of its bytes would
            be decoded and copied; None = all are joined.
    """
    groups: dict[int, list[tuple[Int64Array, Planes]]] = {}
    first = 0
    for batch in batches:
        for members, planes in batch.groups:
            if apart is not None and len(members) >= apart:
                yield members + first, planes
            else:
                groups.setdefault(len(planes), []).append((members + first, planes))
        first += len(batch)
    for pairs in groups.values():
        if len(pairs) == 1:
            yield pairs[0]
        else:
            indices = np.concatenate([members for members, _ in pairs])
            yield indices, _join([planes for _, planes in pairs], len(indices))


def _join(groups: Sequence[Planes], count: int) -> ByteArray:
    """Return the planes of ``count`` messages of one size, from several groups."""
    arrays = [planes for planes in groups if isinstance(planes, np.ndarray)]
    if len(arrays) == len(groups):
        return np.concatenate(arrays, axis=1)  # messages that are adjacent in memory stay so
    all_planes = np.empty((len(groups[0]), count), np.uint8)
    at = 0
    for planes in groups:
        after = at + planes.shape[1]
        copy_planes(planes, all_planes[:, at:after])
        at = after
    return all_planes
