# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a read: which buckets it touches, and what it reads of each."""

from __future__ import annotations

from typing import NamedTuple, Sequence, Tuple

from cassandra_ros.read import Read
from cassandra_ros.tables.directory import BucketRow
from cassandra_ros.tables.row_table import MAX_SEQ, MIN_SEQ, Order, RowTable

FEW_ROWS = 5000
"""Maximum number of wanted rows for which the first pages are smaller than whole ones."""


def takes_few(read: Read) -> bool:
    """Say whether less than a page of rows is probably taken."""
    return read.wanted is not None and read.wanted <= FEW_ROWS


def first_and_last(read: Read, table: RowTable) -> Tuple[int, int]:
    """Return the first and the last bucket of a table that may hold rows of a read."""
    low, high = read.time_range
    if read.after is not None and read.reverse:
        high = min(high, read.after.t)
    elif read.after is not None:
        low = max(low, read.after.t)
    return table.bucket_of(low), table.bucket_of(high)


def may_hold(read: Read, bucket: Sequence[BucketRow]) -> bool:
    """Say whether a bucket may hold rows of a read: the directory lists a superset."""
    writers = read.whose.writers
    if writers is not None and not any(row.writer in writers for row in bucket):
        return False
    low, high = read.time_range
    return any(
        not row.closed or (row.rows and row.t_min <= high and row.t_max >= low) for row in bucket
    )


class Piece(NamedTuple):
    """The part of one bucket that is read."""

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


def ends_of(piece: Piece, read: Read) -> tuple[Order, Order]:
    """Return the first and the last place in a bucket whose rows are read."""
    first, last = read.time_range
    low, high = (first, MIN_SEQ), (last, MAX_SEQ)
    if read.after is None:
        return low, high
    t, node, seq, table, _ = read.after
    if read.reverse and t <= last:
        high = (t - (piece.node > node), MAX_SEQ)
        if piece.node == node:
            high = (t, seq - (piece.table.name >= table))
    elif not read.reverse and t >= first:
        low = (t + (piece.node < node), MIN_SEQ)
        if piece.node == node and piece.table.name > table:
            low = (t, seq)
        elif piece.node == node:
            low = (t, seq + 1) if seq < MAX_SEQ else (t + 1, MIN_SEQ)
    return low, high
