# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The directory: the list of a table's buckets by robot, with counts and times.

A bucket is a partition with the rows of one time range. A writer adds it to the directory as *open*
before its first data row, so the directory lists every bucket that has rows, and perhaps some that
have none. The counts of a *closed* bucket are final, those of an open one are estimates. Heartbeats
have the server's time, because clocks of robots are wrong.
"""

from __future__ import annotations

import time
from copy import copy
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import (
    Callable,
    Iterable,
    Iterator,
    NamedTuple,
    Sequence,
    Tuple,
)

from cassandra_ros.connection.cassandra import AT_ONCE, Cassandra, CqlRow
from cassandra_ros.connection.paging import Seconds, sent_ahead
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.tables.block_limits import MAX_BYTES, MAX_MESSAGES
from cassandra_ros.tables.bucket_columns import BucketColumns, SlotRange, read_columns
from cassandra_ros.tables.row_table import RowTable
from cassandra_ros.tables.side_tables import SideTables

BUCKET_LENGTHS = tuple(s * SECOND_NS for s in (1, 10, 60, 600, 3600, 6 * 3600, 86400))
MAX_BUCKET_BYTES = 64_000_000
MAX_BUCKET_ROWS = 100_000
MIN_SPAN_NS = 10_000_000
UNKNOWN_SPAN_NS = 10 * SECOND_NS
"""Minimum time range of a block, ns; and the time range of a block if the rate is unknown, ns."""
BLOCKS_IN_SPAN = 4
SLOT_BUCKETS = 4096
"""Number of buckets in one partition of the directory."""
ALL_ROWS = 2**31 - 1
STALE_SEC = 60.0
"""Age of the heartbeat from which an open bucket has no living writer, s."""
HEARTBEAT_SEC = 10.0
TTL_MARGIN_SEC = 900
"""How much longer than its rows a bucket is listed, s: a row may be retried for this time."""
CLOCKS_SEC = 2.0
"""Maximum difference between the clocks of two servers, s."""
NOTE_SEC = 3600.0
"""Age at which a row of cr_node that expires with its data is renewed, while rows are written,
s."""
NOTE_MARGIN_SEC = 7200
"""How much longer than a data row that is written now its row of cr_node must stay, s."""


class Lengths(NamedTuple):
    """Lengths of buckets and blocks, fixed when a table is made, in ns; 0 = the rate is unknown."""

    bucket_ns: int = 0
    """Length of a bucket, ns."""
    span_ns: int = 0
    """Maximum time range of a block, ns."""
    large: bool = False
    """Whether the messages seen so far are too large to be stored in their rows."""


def bucket_for(rate_hz: float, bytes_per_sec: float, longest_ns: int = BUCKET_LENGTHS[-1]) -> int:
    """Return the length of a topic's buckets.

    Args:
        rate_hz: Messages a second, >= 0.
        bytes_per_sec: Serialised bytes a second, >= 0.
        longest_ns: Maximum length, ns; give a short one if the rate may still grow.

    Returns:
        The longest of 1 s, 10 s, 1 min, 10 min, 1 h, 6 h and 1 day that has at most 64 MB and
        100,000 rows a bucket, in ns; 1 s if all have more.
    """
    for length in reversed(BUCKET_LENGTHS):
        seconds = length / SECOND_NS
        fits = rate_hz * seconds <= MAX_BUCKET_ROWS and bytes_per_sec * seconds <= MAX_BUCKET_BYTES
        if length <= longest_ns and fits:
            return length
    return BUCKET_LENGTHS[0]


def span_for(rate_hz: float, bytes_per_sec: float) -> int:
    """Return the maximum time range of a block of a connection, ns.

    It is the time of four full blocks at this rate of messages and of serialised bytes a second,
    at least 10 ms; 10 s if the rate is unknown (0).
    """
    if not rate_hz:
        return UNKNOWN_SPAN_NS
    seconds = BLOCKS_IN_SPAN * MAX_MESSAGES / rate_hz
    if bytes_per_sec:
        seconds = min(seconds, BLOCKS_IN_SPAN * MAX_BYTES / bytes_per_sec)
    return int(max(min(seconds * SECOND_NS, BUCKET_LENGTHS[-1]), MIN_SPAN_NS))


def limit_for_ttl(bucket_ns: int, ttl_sec: int) -> int:
    """Return a bucket length of which at least 24 fit into a TTL; 0 = rows do not expire."""
    if not ttl_sec:
        return bucket_ns
    longest = min(bucket_ns, ttl_sec * SECOND_NS // 24)
    return max((n for n in BUCKET_LENGTHS if n <= longest), default=BUCKET_LENGTHS[0])


def slot_of(bucket: int) -> int:
    """Return the slot in which a bucket is listed."""
    return bucket // SLOT_BUCKETS


_COLUMNS = "bucket, writer, state, deleted, heartbeat, n, bytes, largest, t_min, t_max, odd, filled"
BucketKey = Tuple[str, str, int, int]
"""Table, node, bucket and writer: the key of a row of cr_bucket."""


class BucketRow(NamedTuple):
    """Counts of the rows that one writer put into one bucket."""

    node: str
    bucket: int
    writer: int
    closed: bool
    """Whether the counts are final."""
    heartbeat: datetime | None
    rows: int
    bytes: int
    largest: int
    """Size of the largest message that is stored in its row (not in chunks), bytes."""
    t_min: int
    t_max: int
    odd: int
    """Number of messages with a field that the server cannot check. A block with one such message
    counts with all its messages."""
    age_sec: float
    """Time since the heartbeat, by the server's clock, s."""
    filled: frozenset[str] = frozenset()
    """Shadow columns that have values in all rows of this writer in the bucket."""
    writing: bool = False
    """Whether the writer has not closed the bucket. If rows were deleted, ``closed`` and
    ``writing`` may both be false."""
    cut: bool = False
    """Whether rows were deleted since the bucket was counted."""

    def expired(self, ttl: int) -> bool:
        """Return whether all rows of this writer in the bucket have expired; ttl in seconds."""
        # A bucket is closed after its last row. While it is open, a row may come that was retried
        # for minutes.
        margin = CLOCKS_SEC if self.closed else TTL_MARGIN_SEC
        return self.age_sec > ttl + margin


@dataclass
class BucketTotals:
    """Counts with which a writer closes a bucket."""

    rows: int = 0
    bytes: int = 0
    largest: int = 0
    t_min: int = 2**63 - 1
    t_max: int = -1
    odd: int = 0

    def count(self, t: int, size: int, chunked: bool, odd: bool) -> None:
        """Add one row to the counts."""
        self.rows += 1
        self.bytes += size
        self.t_min = min(self.t_min, t)
        self.t_max = max(self.t_max, t)
        self.odd += odd
        if not chunked:
            self.largest = max(self.largest, size)

    def add(self, rows: int, nbytes: int, largest: int, ends: tuple[int, int], odd: bool) -> None:
        """Add a block.

        Its number of messages, their bytes, the largest, first and last time, odd.
        """
        self.rows += rows
        self.bytes += nbytes
        self.largest = max(self.largest, largest)
        self.t_min, self.t_max = min(self.t_min, ends[0]), max(self.t_max, ends[1])
        self.odd += rows * odd

    def columns(self) -> dict[str, int]:
        """Return the counts by the names of their columns in cr_bucket."""
        return {"n": self.rows, **{name: v for name, v in vars(self).items() if name != "rows"}}


class Directory:
    """Reads and writes cr_node and cr_bucket of one keyspace."""

    def __init__(self, cassandra: Cassandra, side_tables: SideTables) -> None:
        self._cassandra = cassandra
        self._tables = side_tables
        self._noted: dict[tuple[str, int, str], float] = {}
        self.seen: dict[str, dict[int, tuple[str, ...]]] = {}
        """Table → slot → nodes, as listed last; may be out of date."""
        self.first: dict[tuple[str, bool], tuple[Sequence[str], Sequence[Sequence[BucketRow]]]] = {}
        """Table and whether newest rows come first → nodes and buckets in which the last read of
        few rows began; see ``foresee`` in store/."""

    def patient(self, retry_sec: Seconds) -> Directory:
        """Return a copy for one writer, which retries each request for ``retry_sec``."""
        directory = copy(self)
        directory._tables = self._tables.patient(retry_sec)
        directory._noted = {}
        return directory

    def nodes(self, table: str, first_slot: int, last_slot: int) -> list[tuple[int, str]]:
        """Return the (slot, node) pairs of a table for slots in [first_slot, last_slot]."""
        return self.begin_nodes(table, (first_slot, last_slot))()

    def begin_nodes(
        self, table: str, slots: tuple[int, int], limit: int = ALL_ROWS, *, reverse: bool = False
    ) -> Callable[[], list[CqlRow]]:
        """Request the first (slot, node) pairs of a table in [first, last]; see Cassandra.begin."""
        if not self._tables.has("cr_node"):
            return list
        cql = (
            f"SELECT slot, node FROM {self._tables.qualified('cr_node')} "
            f"WHERE tbl = ? AND slot >= ? AND slot <= ?{' ORDER BY slot DESC' * reverse} LIMIT ?"
        )
        what, retry_sec = "reading the directory of nodes", self._tables.retry_sec
        return self._cassandra.begin(cql, (table, *slots, limit), what=what, retry_sec=retry_sec)

    def buckets(
        self, table: str, first: int, last: int, nodes: Sequence[str] | None = None, ttl: int = 0
    ) -> list[BucketRow]:
        """Return the buckets of a table in [first, last], one row for each writer.

        Args:
            nodes: The nodeIDs to read; None = all.
            ttl: Lifetime of the table's rows, seconds; buckets with only expired rows are left out.
        """
        listed = self.nodes(table, slot_of(first), slot_of(last))
        found = [(slot, node) for slot, node in listed if nodes is None or node in nodes]
        every = self._buckets([(table, node, slot, first, last) for slot, node in found])
        return every if not ttl else [row for row in every if not row.expired(ttl)]

    def find(self, table: str, node: str, bucket: int) -> list[BucketRow]:
        """Return the rows of all writers for one bucket."""
        return self._buckets([(table, node, slot_of(bucket), bucket, bucket)])

    def _buckets(
        self,
        params: Sequence[tuple[str, str, int, int, int]],
        limit: int = ALL_ROWS,
        *,
        reverse: bool = False,
    ) -> list[BucketRow]:
        asked = self.begin_buckets(params, limit, reverse=reverse)
        return [row for answer in sent_ahead(asked, AT_ONCE) for row in answer()]

    def begin_buckets(
        self,
        params: Iterable[tuple[str, str, int, int, int]],
        limit: int = ALL_ROWS,
        *,
        reverse: bool = False,
    ) -> Iterator[Callable[[], list[BucketRow]]]:
        """Request buckets by (table, node, slot, first, last), one request when each is taken.

        Each answer has at most ``limit`` rows, from the first bucket on or (reverse) from the last.
        """
        if not self._tables.has("cr_bucket"):
            return
        cql = (
            f"SELECT {_COLUMNS}, toTimestamp(now()) FROM {self._tables.qualified('cr_bucket')} "
            "WHERE tbl = ? AND node = ? AND slot = ? AND bucket >= ? AND bucket <= ?"
            f"{' ORDER BY bucket DESC' * reverse} LIMIT ?"
        )
        what, retry_sec = "reading the directory of buckets", self._tables.retry_sec
        for each in params:
            asked = self._cassandra.begin(cql, (*each, limit), what=what, retry_sec=retry_sec)
            yield partial(_bucket_rows, each[1], asked)

    def columns(
        self, wanted: Iterable[SlotRange], *, single: bool = False
    ) -> Iterator[BucketColumns]:
        """Read many buckets as columns, several partitions at once; see read_columns."""
        if not self._tables.has("cr_bucket"):
            return iter(())
        table = self._tables.qualified("cr_bucket")
        return read_columns(self._cassandra, table, wanted, single=single)

    def add_node(self, table: str, slot: int, node: str, ttl: int = 0) -> None:
        """Add a slot of a node, before its first bucket, for ``ttl`` seconds (0 = for ever)."""
        columns, what = {"tbl": table, "slot": slot, "node": node}, "writing the directory of nodes"
        self._tables.insert("cr_node", columns, what, ttl=_ttl(ttl))

    def note(self, table: RowTable, node: str, bucket: int) -> None:
        """Add the slot of a bucket, before rows are written, unless that was done not long ago."""
        slot = (table.name, slot_of(bucket), node)
        # Rows found by name have no other entry in the directory, so this one never expires.
        ttl = 0 if table.named else table.metadata.ttl
        noted, now = self._noted.get(slot), time.monotonic()
        if noted is None or (ttl and now - noted > NOTE_SEC):
            self.add_node(*slot, ttl and ttl + NOTE_MARGIN_SEC)
            self._noted[slot] = now

    def mark(
        self,
        place: BucketKey,
        ttl: int,
        filled: Iterable[str] = (),
        totals: BucketTotals | None = None,
        *,
        closed: bool = False,
        deleted: bool = False,
    ) -> None:
        """Write a writer's counts of a bucket, with a new heartbeat.

        Args:
            ttl: Lifetime of the table's rows, seconds; 0 = for ever.
            filled: Shadow columns that all of the writer's rows in the bucket have and will have.
            totals: Counts, final if closed, otherwise estimates; None = leave those that are there.
            deleted: Only note that rows were deleted, so no count is final until the next recount.
                It is a separate column because a living writer closes the bucket with its own
                counts.
        """
        columns = _key(place)
        if deleted:
            columns["deleted"] = True
        else:
            columns.update(state="closed" if closed else "open", filled=set(filled))
            columns.update(totals.columns() if totals is not None else {})
        what = "writing the directory of buckets"
        self._tables.insert("cr_bucket", columns, what, now=["heartbeat"], ttl=_ttl(ttl))

    def put_recount(self, table: str, row: BucketRow, totals: BucketTotals, ttl: int) -> bool:
        """Close a bucket that has no living writer; return whether that was done.

        It is not done if the bucket has changed since ``row`` was read, which must be before its
        data rows are counted.
        """
        columns = {"filled": set(row.filled), **totals.columns()}
        key = _key((table, row.node, row.bucket, row.writer))
        answer = self._cassandra.execute_once(
            f"UPDATE {self._tables.qualified('cr_bucket')} USING TTL ? SET state = 'closed', "
            f"{''.join(f'{name} = ?, ' for name in columns)}deleted = false, "
            "heartbeat = toTimestamp(now()) "
            f"WHERE {' AND '.join(f'{name} = ?' for name in key)} IF heartbeat = ?",
            (_ttl(ttl), *columns.values(), *key.values(), row.heartbeat),
            what="closing a bucket in the directory",
        )
        return bool(answer[0][0])

    def tables(self) -> set[str]:
        """Return the names of the tables with buckets, including dropped tables (a full scan)."""
        rows = self._tables.select("cr_node", "DISTINCT tbl", what="listing the directory")
        return {table for (table,) in rows}

    def forget(self, table: str) -> None:
        """Delete all entries of a table that was dropped."""
        slots = [(table, node, slot) for slot, node in self.nodes(table, -(2**63), 2**63 - 1)]
        key = ("tbl", "node", "slot")
        self._tables.delete("cr_bucket", key, slots, "clearing the directory of buckets")
        self.seen.pop(table, None)
        for reverse in (False, True):
            self.first.pop((table, reverse), None)
        self._tables.delete("cr_node", ("tbl",), [(table,)], "clearing the directory")


def _key(place: BucketKey) -> dict[str, object]:
    """Return the primary key of a row of cr_bucket: column → value."""
    table, node, bucket, writer = place
    slot = slot_of(bucket)
    return {"tbl": table, "node": node, "slot": slot, "bucket": bucket, "writer": writer}


def _ttl(ttl: int) -> int:
    return ttl + TTL_MARGIN_SEC if ttl else 0


def _bucket_rows(node: str, answer: Callable[[], list[CqlRow]]) -> list[BucketRow]:
    return [_bucket_row(node, row) for row in answer()]


def _bucket_row(node: str, row: CqlRow) -> BucketRow:
    bucket, writer, state, deleted, beat, n, size, largest, t_min, t_max, odd, filled, now = row
    closed = state == "closed" and not deleted
    latest = -1 if t_max is None else t_max
    counts = (n or 0, size or 0, largest or 0, t_min or 0, latest, odd or 0)
    age_sec = STALE_SEC + 1 if beat is None else (now - beat).total_seconds()
    said = node, bucket, writer, closed, beat, *counts, age_sec, frozenset(filled or ())
    return BucketRow(*said, writing=state == "open", cut=bool(deleted))
