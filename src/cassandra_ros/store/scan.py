# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is to be read: a scan of tables, and its part in each bucket."""

from __future__ import annotations

from typing import Callable, FrozenSet, NamedTuple, Optional, Protocol, Sequence, Tuple

from cassandra_ros.blocks.bucket_read import Sift
from cassandra_ros.keys import Position
from cassandra_ros.tables.directory import BucketRow
from cassandra_ros.tables.row_table import MAX_SEQ, MIN_SEQ, Order, RowTable, Terms

FEW_ROWS = 5000
"""Who takes up to here is not given whole pages from the start."""

Query = Tuple[Terms, bool]
"""What the server is to check, and whether it finds the rows by an index."""


class Chooser(Protocol):
    """Decides, bucket by bucket, what the server is to check."""

    @property
    def checks(self) -> bool:
        """Whether there is anything to check."""

    def choose(self, table: RowTable, bucket: Sequence[BucketRow]) -> Optional[Sequence[Query]]:
        """Return the queries that give the rows that may be wanted; None = all, empty = none."""

    def few(self, table: RowTable) -> bool:
        """Say whether the server is expected to let few rows of a bucket through."""

    def learn(self, table: RowTable, bucket: Sequence[BucketRow], found: int) -> None:
        """Take note of how many rows (messages, also of blocks) the queries of a bucket found."""

    def sift(self, table: RowTable) -> Optional[Sift]:
        """Return what leaves out messages of unpacked blocks; None = nothing can be left out."""

    def opened(self, table: RowTable, messages: int, kept: int) -> None:
        """Take note of a block that was unpacked, and how many of its messages became rows."""


class Scan(NamedTuple):
    """What to read: t in [low, high], rows after a position, by chosen columns."""

    low: int
    high: int
    after: Optional[Position] = None
    nodes: Optional[Sequence[str]] = None
    reverse: bool = False
    columns: Optional[Callable[[RowTable], Optional[Sequence[str]]]] = None
    """Which of the format's columns to read, in their order; None = all."""
    chooser: Optional[Chooser] = None
    """None = all rows."""
    writers: Optional[FrozenSet[int]] = None
    """Only rows of these writer ids; None = of all."""
    wanted: Optional[int] = None
    """How many rows are probably taken; None = all. More come all the same."""

    @property
    def few(self) -> bool:
        """Whether less than a page is probably taken."""
        return self.wanted is not None and self.wanted <= FEW_ROWS

    def buckets(self, table: RowTable) -> Tuple[int, int]:
        """Return the first and the last bucket of a table that may hold rows of it."""
        low, high = self.low, self.high
        if self.after is not None and self.reverse:
            high = min(high, self.after.t)
        elif self.after is not None:
            low = max(low, self.after.t)
        return table.bucket_of(low), table.bucket_of(high)

    def wants(self, bucket: Sequence[BucketRow]) -> bool:
        """Say whether a bucket may hold rows of it: the directory lists a superset."""
        listed = self.writers is None or any(row.writer in self.writers for row in bucket)
        return listed and any(map(self._reaches, bucket))

    def _reaches(self, row: BucketRow) -> bool:
        """Say whether a writer may have rows of the time in a bucket."""
        inside = row.rows and row.t_min <= self.high and row.t_max >= self.low
        return bool(not row.closed or inside)


class Piece(NamedTuple):
    """The part of one bucket that a scan reads."""

    start: int
    """Where in time it begins, in the direction of reading, ns."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """What its writers say in the directory; empty: this is no bucket, but from here on there may
    be some that were not looked for yet."""
    page_rows: int = 0
    page_bytes: int = 0
    """Of messages, what it holds at once at the most, about."""
    first_rows: int = 0
    """Rows of its first page, which the next ones outgrow; 0 = page_rows."""

    @property
    def listed(self) -> int:
        """How many rows it has, as its writers say: of a closed bucket what there are."""
        return sum(row.rows for row in self.rows)

    def listed_in(self, span_ns: int) -> float:
        """Return how many rows lie in so much of its time, where they lie evenly."""
        ends = [(row.t_min, row.t_max) for row in self.rows if row.rows]
        length = max(last for _, last in ends) - min(first for first, _ in ends) if ends else 0
        return self.listed * min(1.0, span_ns / max(1, length))


def ends_of(piece: Piece, scan: Scan) -> tuple[Order, Order]:
    """Return the first and the last place in a bucket whose rows are read."""
    low, high = (scan.low, MIN_SEQ), (scan.high, MAX_SEQ)
    if scan.after is None:
        return low, high
    t, node, seq, table, _ = scan.after
    if scan.reverse and t <= scan.high:
        high = (t - (piece.node > node), MAX_SEQ)
        if piece.node == node:
            high = (t, seq - (piece.table.name >= table))
    elif not scan.reverse and t >= scan.low:
        low = (t + (piece.node < node), MIN_SEQ)
        if piece.node == node and piece.table.name > table:
            low = (t, seq)
        elif piece.node == node:
            low = (t, seq + 1) if seq < MAX_SEQ else (t + 1, MIN_SEQ)
    return low, high
