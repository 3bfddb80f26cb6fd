# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of messages of a table and a robot in some time ranges."""

from __future__ import annotations

from typing import NamedTuple, Sequence

import numpy as np

from cassandra_ros.read import Whose
from cassandra_ros.store.rows.fetch import some_names
from cassandra_ros.store.tables.bucket_columns import BucketColumns
from cassandra_ros.store.tables.directory import (
    CLOCKS_SEC,
    SLOT_BUCKETS,
    STALE_SEC,
    TTL_MARGIN_SEC,
)
from cassandra_ros.topics.overview.timeline.time_cells import Bools, Longs, TimeRanges
from cassandra_ros.topics.topic_table import TopicTable

MAX_NAMES = 1000
"""Maximum number of messages shown of a table whose messages have names."""
_SECOND_MS = 1000


class MessageKeys(NamedTuple):
    """Single messages with known times."""

    times: Longs
    seqs: Longs
    """Writer id << 32 | counter."""
    sizes: Longs
    """Sizes of the serialised messages, bytes."""

    @property
    def writers(self) -> Longs:
        """Writer ids."""
        return self.seqs >> 32

    def where(self, mask: Bools) -> MessageKeys:
        """Return the messages for which ``mask`` is true."""
        return MessageKeys(self.times[mask], self.seqs[mask], self.sizes[mask])

    @classmethod
    def joined(cls, parts: Sequence[MessageKeys]) -> MessageKeys:
        """Return the messages of several objects."""
        empty = np.zeros(0, np.int64)
        return cls(*map(np.concatenate, zip((empty, empty, empty), *parts)))


class RangeCounts(NamedTuple):
    """A piece of a picture: what is known about the messages of one table and one robot."""

    table: TopicTable
    node: str
    time_ranges: TimeRanges
    buckets: Longs
    """Bucket of each time range; -1 = an estimate for buckets that were not read."""
    sampled: bool = False
    """Whether some time ranges are estimates for buckets that were not read."""
    writing: bool = False
    """Whether a writer is writing now."""
    keys: MessageKeys = MessageKeys.joined([])
    """Messages that are not in the time ranges."""


def piece_of(
    table: TopicTable, node: str, columns: BucketColumns, stride: int, whose: Whose
) -> RangeCounts:
    """Return the piece of some buckets, of one slot.

    Args:
        stride: Number of buckets for which each one stands.
        whose: Writers whose buckets count; its nodes were considered before.
    """
    mask = _living(columns, table.metadata.ttl)
    if whose.writers is not None:
        mask &= np.isin(columns.writer, sorted(whose.writers))
    living = columns.where(mask)
    length, has_rows = table.metadata.bucket_ns, living.rows > 0
    begin = living.bucket * length
    first = np.where(has_rows, living.t_min, begin)
    last = np.where(has_rows, living.t_max, begin + length - 1)
    if stride > 1:
        first = living.bucket // stride * stride * length
        last = np.minimum(first + stride * length - 1, _end_of_slot(living.bucket, length))
    sure = living.closed & (stride == 1) & (table.metadata.ttl == 0)
    counts = living.rows * stride, living.bytes * stride
    is_written = living.writing & (living.age_ms <= STALE_SEC * _SECOND_MS)
    time_ranges = TimeRanges(first, last, *counts, living.writer, sure)
    return RangeCounts(table, node, time_ranges, living.bucket, stride > 1, bool(is_written.any()))


def _living(columns: BucketColumns, ttl: int) -> Bools:
    """Return which buckets have messages; ttl of their table in seconds, 0 = no expiry.

    Buckets whose messages have all expired or were all deleted are left out.
    """
    may_have_rows = (columns.rows > 0) | ~columns.closed
    if not ttl:
        return may_have_rows
    margin = np.where(columns.closed, CLOCKS_SEC, TTL_MARGIN_SEC)  # as BucketRow.expired
    return may_have_rows & (columns.age_ms <= (ttl + margin) * _SECOND_MS)


def _end_of_slot(buckets: Longs, length: int) -> Longs:
    """Return the last time of the slots of some buckets, ns; ``length`` is that of a bucket."""
    return np.asarray((buckets // SLOT_BUCKETS + 1) * SLOT_BUCKETS * length - 1)


def unread(
    table: TopicTable, node: str, ends: Sequence[tuple[int, int]], read: Sequence[RangeCounts]
) -> RangeCounts:
    """Return estimates for partitions that were not read: each has the average of those read.

    Args:
        ends: The first and the last bucket of each partition.
        read: Pieces of the partitions that were read, of the same table and robot.
    """
    length = table.metadata.bucket_ns
    first, last = (np.array(buckets, np.int64) * length for buckets in zip(*ends))
    messages_read = sum(int(piece.time_ranges.messages.sum()) for piece in read)
    bytes_read = sum(int(piece.time_ranges.bytes.sum()) for piece in read)
    messages = np.full(len(ends), messages_read // max(1, len(read)))
    size = np.full(len(ends), bytes_read // max(1, len(read)))
    unknown = np.zeros(len(ends), np.int64)
    sure = unknown.astype(bool)
    time_ranges = TimeRanges(first, last + length - 1, messages, size, unknown, sure)
    return RangeCounts(table, node, time_ranges, unknown - 1, sampled=True)


def named_pieces(table: TopicTable, whose: Whose) -> list[RangeCounts]:
    """Return the pieces of messages with names, by robot; at most MAX_NAMES messages."""
    keys, complete = some_names(table, MAX_NAMES)
    by_node: dict[str, list[tuple[int, int, int]]] = {}
    for (t, node, seq, _, _), size, *_ in keys:
        if whose.wrote(seq) and (whose.nodes is None or node in whose.nodes):
            by_node.setdefault(node, []).append((t, seq, size))
    pieces = []
    for node, rows in by_node.items():
        single = MessageKeys(*np.array(rows, np.int64).T)
        nothing = TimeRanges.joined([])
        pieces.append(
            RangeCounts(table, node, nothing, nothing.first, sampled=not complete, keys=single)
        )
    return pieces
