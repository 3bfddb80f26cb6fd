# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a read: the buckets in its time range, and what it reads of each."""

from __future__ import annotations

from typing import NamedTuple, Sequence, Tuple

from cassandra_ros.read import Read
from cassandra_ros.tables.directory import BucketRow
from cassandra_ros.tables.row_table import MAX_SEQ, MIN_SEQ, Order, RowTable

FEW_ROWS = 5000
"""Maximum number of wanted rows for which the first pages are smaller than whole ones."""


def takes_few(read: Read) -> bool:
    """Return whether probably less than a page of rows will be taken."""
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
    """Return whether a bucket may hold rows of a read: the directory may list too many."""
    writers = read.whose.writers
    if writers is not None and not any(row.writer in writers for row in bucket):
        return False
    low, high = read.time_range
    return any(
        not row.closed or (row.rows and row.t_min <= high and row.t_max >= low) for row in bucket
    )


class BucketPart(NamedTuple):
    """A bucket of a read, with the sizes of its pages."""

    start: int
    """Time at which it begins, in the direction of reading, ns."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """Rows of its writers in the directory; empty = no bucket, but the place up to which the
    directory
    was read."""
    page_rows: int = 0
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


def ends_of(piece: BucketPart, read: Read) -> tuple[Order, Order]:
    """Return the first and the last row key in a bucket that the read includes."""
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
