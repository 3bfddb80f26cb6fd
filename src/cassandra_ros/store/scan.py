# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a read of many rows is asked for."""

from __future__ import annotations

from typing import Callable, NamedTuple, Optional, Protocol, Sequence, Tuple

from cassandra_ros.keys import Position
from cassandra_ros.store.directory import BucketRow
from cassandra_ros.store.row_table import RowTable

Terms = Tuple[Tuple[str, str, bytes], ...]
"""Column, operator and encoded value; all of them hold."""
Query = Tuple[Terms, bool]
"""What the server is to check, and whether it finds the rows by an index."""


class Chooser(Protocol):
    """Decides, bucket by bucket, what the server is to check."""

    def choose(self, table: RowTable, bucket: Sequence[BucketRow]) -> Optional[Sequence[Query]]:
        """Return the queries whose rows together are those of the bucket that may be wanted.

        None = all rows of the bucket; empty = none of them.
        """

    def few(self, table: RowTable) -> bool:
        """Say whether the server is expected to let few rows of a bucket through."""

    def learn(self, table: RowTable, bucket: Sequence[BucketRow], found: int) -> None:
        """Take note of how many rows the queries of a bucket found."""


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


class Piece(NamedTuple):
    """The part of one bucket that a scan reads."""

    start: int
    """Where in time it begins, in the direction of reading, ns."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """What its writers say in the directory."""
    page_rows: int
