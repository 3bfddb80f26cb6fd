# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the directory says about a time range, as much as a picture needs, cached for some seconds.

If there are more buckets than that, a sample of them stands for the others, so the cost is limited
however long the recordings are.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, OrderedDict
from typing import Callable, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np

from cassandra_ros.read import LAST_NS, Whose
from cassandra_ros.store.connection.cassandra import REQUESTS_AT_ONCE
from cassandra_ros.store.connection.requests import sent_ahead
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.bucket_columns import BucketColumns, SlotKey, SlotRange
from cassandra_ros.store.tables.directory import ALL_ROWS, SLOT_BUCKETS, Directory, slot_of
from cassandra_ros.topics.overview.timeline.range_counts import (
    RangeCounts,
    piece_of,
    unread,
)
from cassandra_ros.topics.stored_totals import ALL_BUCKETS
from cassandra_ros.topics.topic_table import TopicTable

MAX_PARTITIONS = 2000
"""Maximum number of partitions of the directory read for one picture, but at least one for each
table and node."""
MAX_BUCKETS = 200_000
"""Approximate maximum number of rows of the directory read for one picture."""
LEAST_BUCKETS = 128
"""Minimum number of buckets read from each partition."""
MAX_RECOUNTS = 10_000
"""Maximum number of buckets with deleted messages that are counted again for one picture."""
KEEP_SEC = 5.0
"""How long cached rows are used, s. A user who zooms asks often."""
KEPT_BUCKETS = 400_000
"""Maximum number of cached rows of the directory, 80 bytes each."""
_EVER_NS = (0, LAST_NS)
_SPREAD = 2_654_435_761
"""2**32 divided by the golden ratio: its multiples are spread evenly without any other pattern."""
_WRITERS = 8
"""Number of writers read for the first and for the last bucket."""

Ends = Tuple[int, int]
"""First and last time, ns, or first and last bucket, both included."""
Listed = List[Tuple[int, str]]
"""Slots of a table and the nodes that have buckets in them, in order."""


SlotPart = Tuple[TopicTable, SlotKey, Ends]
"""A partition of the directory, and the range of its buckets to read."""


class _CachedRows(NamedTuple):
    """The rows of a partition that were read."""

    until: float
    """Monotonic time until which they are used, s."""
    ends: Ends
    """The requested buckets."""
    columns: BucketColumns
    stride: int
    """Number of buckets for which each one in the columns stands."""


class DirectoryReader:
    """Reads the directory for timelines, with a cache. Thread-safe.

    Args:
        directory: Directory of the keyspace.
        clock: Returns monotonic seconds.
    """

    def __init__(self, directory: Directory, clock: Callable[[], float] = time.monotonic) -> None:
        self._directory = directory
        self._clock = clock
        self._rows: OrderedDict[SlotKey, _CachedRows] = OrderedDict()
        """Cached rows, the oldest first."""
        self._slots: dict[str, tuple[float, Listed]] = {}
        """Table → monotonic time until which its slots are used, s, and the slots."""
        self._size = 0
        """Number of the cached rows of all partitions."""
        self._mutex = threading.Lock()

    def slots(self, tables: Sequence[TopicTable]) -> dict[str, Listed]:
        """Return the slots and nodes of the tables with a time key, by name of table."""
        now = self._clock()
        with self._mutex:
            fresh = {name: slots for name, (until, slots) in self._slots.items() if until > now}
        missing = [table.name for table in tables if not table.named and table.name not in fresh]
        requests = (self._directory.begin_nodes(name, ALL_BUCKETS) for name in missing)
        for name, answer in zip(missing, sent_ahead(requests, REQUESTS_AT_ONCE)):
            fresh[name] = [(slot, node) for slot, node in answer()]
        until = now + KEEP_SEC
        with self._mutex:
            self._slots = {name: entry for name, entry in self._slots.items() if entry[0] > now}
            self._slots.update((name, (until, fresh[name])) for name in missing)
        return {table.name: fresh[table.name] for table in tables if not table.named}

    def extent(self, tables: Sequence[TopicTable], whose: Whose) -> Ends | None:
        """Return the first and the last time of messages in some tables; None without messages.

        Tables whose messages have names are left out. For single writers the times come from
        ``pieces``, and are estimates if there are more buckets than it reads.
        """
        if whose.writers is not None:
            whole = self.extent(tables, whose._replace(writers=None))
            pieces = self.pieces(tables, whole, whose) if whole is not None else []
            ranges = [piece.time_ranges for piece in pieces if len(piece.time_ranges.first)]
            if not ranges:
                return None
            return min(int(s.first.min()) for s in ranges), max(int(s.last.max()) for s in ranges)
        ends: list[int] = []
        empty: dict[str, TopicTable] = {}
        for reverse in (False, True):
            for table, times in self._outmost(tables, whose, reverse):
                ends += times
                if not times:
                    empty[table.name] = table
        # If all messages of the outmost buckets were deleted, the others may be anywhere between.
        for piece in self.pieces(list(empty.values()), _EVER_NS, whose) if empty else ():
            if len(piece.time_ranges.first):
                ends += [int(piece.time_ranges.first.min()), int(piece.time_ranges.last.max())]
        return (min(ends), max(ends)) if ends else None

    def _outmost(
        self, tables: Sequence[TopicTable], whose: Whose, reverse: bool
    ) -> Iterator[tuple[TopicTable, list[int]]]:
        """Yield the times in the first (reverse: last) bucket of each table and node.

        A bucket with deleted messages gives no times, because the directory does not know them.
        """
        slots = self.slots(tables)
        slot_ranges = [
            (table, (table.name, node, slot, *ALL_BUCKETS))
            for table in tables
            for node, slot in _outmost_slots(slots.get(table.name, []), reverse).items()
            if whose.nodes is None or node in whose.nodes
        ]
        params = (place for _, place in slot_ranges)
        answers = self._directory.begin_buckets(params, _WRITERS, reverse=reverse)
        for (table, place), answer in zip(slot_ranges, sent_ahead(answers, REQUESTS_AT_ONCE)):
            length, ttl = table.metadata.bucket_ns, table.metadata.ttl
            times: list[int] = []
            entries = answer()
            if len(entries) >= _WRITERS and entries[0].bucket == entries[-1].bucket:
                # There may be more writers, whose messages are earlier or later.
                entries = self._directory.find(table.name, place[1], entries[0].bucket)
            rows = [row for row in entries if not row.expired(ttl)]
            for row in [] if any(row.cut for row in rows) else rows:
                if row.rows:
                    times += (row.t_min, row.t_max)
                elif not row.closed:  # its counts are not known yet
                    times += (row.bucket * length, (row.bucket + 1) * length - 1)
            yield table, times

    def pieces(self, tables: Sequence[TopicTable], ends: Ends, whose: Whose) -> list[RangeCounts]:
        """Return what tables hold in the buckets that meet a time range.

        Tables whose messages have names are left out.
        """
        counts: list[RangeCounts] = []
        parts = list(self._parts(tables, ends, whose))
        stride = max(1, -(-len(parts) // MAX_PARTITIONS))
        sample, others = _thin(parts, stride)
        limit = max(LEAST_BUCKETS, MAX_BUCKETS // max(1, len(sample)))
        answers = self._columns(sample, limit)
        for (table, (_, node, _), _), (columns, weight) in zip(sample, answers):
            counts.append(piece_of(table, node, columns, weight, whose))
        return [*counts, *_rest(others, counts)]

    def _parts(self, tables: Sequence[TopicTable], ends: Ends, whose: Whose) -> Iterator[SlotPart]:
        """Yield the partitions with buckets in a time range, and the range of these buckets."""
        slots = self.slots(tables)
        for table in tables:
            low, high = (table.bucket_of(end) for end in ends)
            first, last = slot_of(low), slot_of(high)
            for slot, node in slots.get(table.name, []):
                if first <= slot <= last and (whose.nodes is None or node in whose.nodes):
                    begin = slot * SLOT_BUCKETS
                    inside = max(begin, low), min(begin + SLOT_BUCKETS - 1, high)
                    yield table, (table.name, node, slot), inside

    def _columns(self, parts: Sequence[SlotPart], limit: int) -> list[tuple[BucketColumns, int]]:
        """Return the buckets of partitions, and the number of buckets for which each one stands.

        They come from the cache; else all buckets of a partition are read or, if it has more than
        ``limit``, a sample of them. There is one result for each partition, in their order.
        """
        until, recounts_left = self._clock() + KEEP_SEC, MAX_RECOUNTS
        tables = {place: table for table, place, _ in parts}
        columns_of_slots = {place: self._get(place, ends, limit) for _, place, ends in parts}
        missing = [(place, ends) for _, place, ends in parts if columns_of_slots[place] is None]

        def keep(place: SlotKey, ends: Ends, columns: BucketColumns, stride: int) -> None:
            """Recount what was read, as far as MAX_RECOUNTS permits, and cache it."""
            nonlocal recounts_left
            columns, count = self._recount(tables[place], place[1], columns, recounts_left)
            recounts_left -= count
            columns_of_slots[place] = self._keep(place, _CachedRows(until, ends, columns, stride))

        # One row more than the limit shows that there are too many.
        slot_ranges: list[SlotRange] = [(place, ends, limit + 1) for place, ends in missing]
        many: list[tuple[SlotKey, Ends, int]] = []
        for (place, ends), columns in zip(missing, self._directory.columns(slot_ranges)):
            if len(columns.bucket) > limit:
                many.append((place, ends, -(-(ends[1] - ends[0] + 1) // limit)))
            else:
                keep(place, ends, columns, 1)
        samples: list[SlotRange] = [
            (place, _sample(ends, stride), ALL_ROWS) for place, ends, stride in many
        ]
        answers = self._directory.columns(samples, single=True)
        for (place, ends, stride), columns in zip(many, answers):
            keep(place, ends, columns, stride)
        return [
            pair for pair in (columns_of_slots[place] for _, place, _ in parts) if pair is not None
        ]

    def _recount(
        self, table: TopicTable, node: str, columns: BucketColumns, most: int
    ) -> tuple[BucketColumns, int]:
        """Count the messages of buckets with deleted messages; return columns and number counted.

        Args:
            most: Maximum number of buckets to count. The others keep the counts of the directory.
        """
        buckets = np.unique(columns.bucket[columns.cut])[:most].tolist()
        if not buckets:
            return columns, 0
        params = ((table.name, node, slot_of(bucket), bucket, bucket) for bucket in buckets)
        answers = sent_ahead(self._directory.begin_buckets(params), REQUESTS_AT_ONCE)
        rows = recount_open_buckets(
            self._directory, table, [row for answer in answers for row in answer()]
        )
        counts = {(row.bucket, row.writer): row for row in rows}
        columns = BucketColumns._make(column.copy() for column in columns)
        for n in np.flatnonzero(np.isin(columns.bucket, buckets)).tolist():
            row = counts.get((int(columns.bucket[n]), int(columns.writer[n])))
            totals = (0, 0, 0, 0) if row is None else (row.rows, row.bytes, row.t_min, row.t_max)
            columns.rows[n], columns.bytes[n], columns.t_min[n], columns.t_max[n] = totals
            columns.closed[n] = not columns.writing[n]
        return columns, len(buckets)

    def _get(self, place: SlotKey, ends: Ends, limit: int) -> tuple[BucketColumns, int] | None:
        """Return the cached rows of a partition.

        None if they are too few, too coarse or too old.
        """
        with self._mutex:
            rows = self._rows.get(place)
        if rows is None or rows.until < self._clock():
            return None
        covers = rows.ends[0] <= ends[0] and ends[1] <= rows.ends[1]
        if not covers or rows.stride > max(1, -(-(ends[1] - ends[0] + 1) // limit)):
            return None
        bucket = rows.columns.bucket
        # A bucket stands for others of its cell, also for those after it.
        inside = (bucket > ends[0] - rows.stride) & (bucket <= ends[1])
        return rows.columns.where(inside), rows.stride

    def _keep(self, place: SlotKey, rows: _CachedRows) -> tuple[BucketColumns, int]:
        """Cache the rows of a partition, and return them as ``_get`` does."""
        with self._mutex:
            earlier = self._rows.pop(place, None)
            self._rows[place] = rows
            self._size += len(rows.columns.bucket)
            self._size -= len(earlier.columns.bucket) if earlier is not None else 0
            while self._size > KEPT_BUCKETS:
                _, oldest = self._rows.popitem(last=False)
                self._size -= len(oldest.columns.bucket)
        return rows.columns, rows.stride


def _sample(ends: Ends, stride: int) -> list[int]:
    """Choose one of each ``stride`` buckets, at changing places: recordings may be regular."""
    cells = range(ends[0] // stride, ends[1] // stride + 1)
    return [cell * stride + (cell * _SPREAD % 2**32 * stride >> 32) for cell in cells]


def _outmost_slots(slots: Listed, reverse: bool) -> dict[str, int]:
    """Return the first (reverse: last) slot of each node."""
    entries = slots if reverse else reversed(slots)
    return {node: slot for slot, node in entries}  # of equal keys the last one stays


def _thin(parts: Sequence[SlotPart], stride: int) -> tuple[list[SlotPart], list[SlotPart]]:
    """Choose one in ``stride`` partitions of each table and node, always with the first one."""
    counts: Counter[tuple[str, str]] = Counter()
    sample: list[SlotPart] = []
    others: list[SlotPart] = []
    for slot_part in parts:
        lane = slot_part[1][:2]
        (others if counts[lane] % stride else sample).append(slot_part)
        counts[lane] += 1
    return sample, others


def _rest(parts: Sequence[SlotPart], read: Sequence[RangeCounts]) -> Iterator[RangeCounts]:
    """Yield estimates for the partitions that were not read."""
    by_lane: dict[tuple[str, str], tuple[TopicTable, list[Ends]]] = {}
    for table, (_, node, _), inside in parts:
        by_lane.setdefault((table.name, node), (table, []))[1].append(inside)
    for (name, node), (table, ends) in by_lane.items():
        pieces = [piece for piece in read if piece.node == node and piece.table.name == name]
        yield unread(table, node, ends, pieces)
