# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How the messages of a table lie in its rows, and what is asked of either way.

A row holds one message (RowLayout in store/rows/layouts.py) or a block of messages (BlockLayout in
store/blocks/block_layout.py); ``layout_of`` chooses. Readers get each message as a TableRow, in
order, or many together as a Portion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Callable, Iterable, Iterator, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from cassandra.query import PreparedStatement
from numpy.typing import NDArray

from cassandra_ros.keys import Position
from cassandra_ros.read import Chooser, Query, Read, Writers
from cassandra_ros.store.tables.directory import BucketRow, BucketTotals
from cassandra_ros.store.tables.row_table import MAX_SEQ, MIN_SEQ, Order, RowTable, TableRow

Longs = NDArray[np.int64]
Mask = NDArray[np.bool_]
StoredPlanes = Tuple[Longs, NDArray[np.uint8], Optional[Mask]]
"""Messages of one size: their indices, a matrix (size, messages) whose row k holds byte k of each,
and which rows are stored as differences; None = no row is."""
Place = Tuple[int, str, int, str]
"""Place in the order of all reads: key time (ns), node, ``_seq`` and table."""
Queries = Optional[Sequence[Query]]
"""Queries that return the rows of a bucket that may match; None = read all rows."""
Answer = Callable[[], Optional[TableRow]]
"""Waits for a message that was requested, and returns it; None = there is no such message."""
Finder = Callable[[Position], Answer]
"""Requests a message by its position."""
Side = Callable[[], Optional[Sequence[TableRow]]]
"""Waits for the message nearest to a time, and returns it as a list of at most one; None = it is
not certain which one that is."""


class MessageKey(NamedTuple):
    """Key of a stored message, and what a count needs of it."""

    t: int
    seq: int
    size: int
    """Serialised size, bytes."""
    chunked: bool
    """Whether its bytes are in the chunk table."""
    odd: bool
    """Whether some column does not hold its field exactly."""


class StackedMessages(NamedTuple):
    """The bytes of messages of one robot, those of each size in planes."""

    table: RowTable
    node: str
    times: Longs
    """Key times, ns, in order."""
    seqs: Longs
    """``_seq`` of the messages."""
    groups: Sequence[StoredPlanes]
    """Messages by size."""
    chosen: Mask | None = None
    """For each message in ``groups`` whether it is one of these; None = all are."""
    unsure: Mask | None = None
    """For each of these messages whether the condition of the read has to be checked again, because
    the store is not sure; None = all have to be."""


class Portion(ABC):
    """Messages of a bucket that were read together, in order: of a block, or of a page of rows.

    Attributes:
        table, node: Table and robot of the messages.
        ends: Keys; no message comes before the first one or after the last one.
        most: Number of the messages at most.
        nbytes: Approximate number of their serialised bytes.
    """

    table: RowTable
    node: str
    ends: tuple[Order, Order]
    most: int
    nbytes: int

    @property
    def t(self) -> int:
        """Key time from which messages may come, ns."""
        return self.ends[0][0]

    @property
    def begin(self) -> Place:
        """The place from which messages may come."""
        (t, seq), _ = self.ends
        return t, self.node, seq, self.table.name

    @property
    def end(self) -> Place:
        """The last place at which a message may come."""
        _, (t, seq) = self.ends
        return t, self.node, seq, self.table.name

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def rows(self) -> Iterable[TableRow]:
        """Return the messages as rows, in order. After it the object is of no use."""

    @abstractmethod
    def stacked(self) -> StackedMessages | None:
        """Return the bytes of the messages; None = they are damaged, ``rows`` says how."""

    @abstractmethod
    def _cut(self, last: Order) -> tuple[Portion, Portion]:
        """Return the messages up to a key, included, and the others."""

    def split(self, place: Place) -> tuple[Portion | None, Portion | None]:
        """Return the messages before a place, and the others; None = no message.

        They take the place of this object.
        """
        t, node, seq, table = place
        last = (t, seq) if self.table.name < table else (t, seq - 1)
        if self.node != node:
            last = (t, MAX_SEQ) if self.node < node else (t - 1, MAX_SEQ)
        if self.ends[1] <= last:
            return self, None
        if last < self.ends[0]:
            return None, self
        return self._cut(last)


class BucketPlan(NamedTuple):
    """A bucket to be read, with the sizes of its pages."""

    start: int
    """Time at which it begins, in the direction of reading, ns. Reads in reverse begin at the end
    of the bucket or of the read's time range."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """Rows of its writers in the directory; empty = there is no bucket, and the entry only tells
    how far the directory was read."""
    page_rows: int = 0
    """Maximum number of rows in a page."""
    page_bytes: int = 0
    """Approximate maximum size of its messages in memory, bytes."""
    first_rows: int = 0
    """Number of rows of its first page, from which pages grow; 0 = page_rows."""

    @property
    def listed(self) -> int:
        """Number of rows by the directory, which is exact for a closed bucket."""
        return sum(row.rows for row in self.rows)

    def listed_in(self, span_ns: int) -> float:
        """Return the number of rows in a time range of this length, if they are evenly spread."""
        ends = [(row.t_min, row.t_max) for row in self.rows if row.rows]
        length = max(last for _, last in ends) - min(first for first, _ in ends) if ends else 0
        return self.listed * min(1.0, span_ns / max(1, length))


def ends_of(plan: BucketPlan, read: Read) -> tuple[Order, Order]:
    """Return the first and the last row key in a bucket that the read includes.

    A cursor is a place in the order (t, node, seq, table). So the rows at its time were read before
    if their node comes first, and those with its seq if their table does.
    """
    first, last = read.time_range
    low, high = (first, MIN_SEQ), (last, MAX_SEQ)
    if read.after is None:
        return low, high
    t, node, seq, table, _ = read.after
    if read.reverse and t <= last:
        high = (t - (plan.node > node), MAX_SEQ)
        if plan.node == node:
            high = (t, seq - (plan.table.name >= table))
    elif not read.reverse and t >= first:
        low = (t + (plan.node < node), MIN_SEQ)
        if plan.node == node and plan.table.name > table:
            low = (t, seq)
        elif plan.node == node:
            low = (t, seq + 1) if seq < MAX_SEQ else (t + 1, MIN_SEQ)
    return low, high


def count_for_chooser(
    plan: BucketPlan,
    chooser: Chooser,
    messages: Iterator[TableRow | Portion],
    is_whole: Callable[[], bool] = lambda: False,
) -> Iterator[TableRow | Portion]:
    """Yield the messages that pass the queries of a bucket.

    If all are taken, the chooser is told their number, unless ``is_whole`` says that the bucket was
    read without the queries, because the server refused them.
    """
    count = 0
    for message in messages:
        count += 1 if isinstance(message, TableRow) else len(message)
        yield message
    if not is_whole():
        chooser.learn(plan.table, plan.rows, count)


class TableLayout(ABC):
    """What is asked of the rows of one table. Times are key times, ns."""

    filters_headers: bool
    """Whether of a filtered bucket small headers are read first."""

    def __init__(self, table: RowTable) -> None:
        self._table = table

    @property
    @abstractmethod
    def stored_columns(self) -> tuple[str, ...]:
        """Names of the columns of a row after its partition key, without those of indexes."""

    @abstractmethod
    def inserts(self, shadows: Sequence[str]) -> tuple[PreparedStatement, PreparedStatement]:
        """Return the INSERT that most rows need, with fewer columns, and that of any row.

        Args:
            shadows: Columns of indexes, whose values come last.
        """

    @abstractmethod
    def open(
        self, plan: BucketPlan, read: Read, queries: Queries, *, together: bool = False
    ) -> Iterator[TableRow | Portion]:
        """Request the first messages of a bucket; return all of them in the order of the read.

        Portions come in the order of their beginnings, and may overlap. The request is sent before
        this returns. A chooser of the read is told how many messages there were.

        Args:
            plan, read: What is read.
            queries: What the server checks.
            together: Whether the caller prefers portions to rows that have only some columns.
        """

    @abstractmethod
    def finder(self) -> Finder:
        """Return what finds one message after the other; they may be requested ahead."""

    @abstractmethod
    def ask(self, position: Position, *, any_seq: bool = False) -> Answer:
        """Request one message, also one with a name; any_seq: the first of its time and node.

        The answer raises CorruptMessage if what holds the message is damaged.
        """

    @abstractmethod
    def ask_side(self, node: str, t: int, *, reverse: bool) -> Side:
        """Request the first message of a node in the bucket of a time, from this time on.

        Args:
            reverse: False = at or after the time, True = at or before it. Of several messages with
                the same time it is the first.
        """

    @abstractmethod
    def keys(self, node: str, bucket: int, low: int, high: int) -> Iterator[MessageKey]:
        """Read the keys of the messages of a bucket with a time in [low, high], ns, in order."""

    @abstractmethod
    def count(self, node: str, bucket: int, ends: tuple[int, int], writers: Writers = None) -> int:
        """Return the number of messages of writers with a time in ``ends``, ns, both included."""

    @abstractmethod
    def recount(self, node: str, bucket: int) -> dict[int, BucketTotals]:
        """Count the messages that a bucket has now, by writer id."""
