# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which messages of a topic each partition of Spark reads: those of some buckets."""

from __future__ import annotations

from typing import List, NamedTuple, Sequence

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Time
from cassandra_ros.read import Whose
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.row_finder import time_range_between
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable

MAX_PART_BYTES = 64 * 1024 * 1024
"""Default maximum size of the messages of a partition with several buckets, bytes."""
_MIN_PART_BYTES = 1024 * 1024
"""Size up to which messages are not spread over more partitions, bytes: reading as much takes about
as long as starting a task and connecting to the store."""


class RobotTimeRange(NamedTuple):
    """Messages of one robot, or of all, in a time range."""

    node: str | None = None
    """nodeID; None = all robots."""
    low: int | None = None
    """First time, ns; None = the messages have names, and all are read."""
    high: int | None = None
    """Last time, ns, included."""


SparkPartition = List[RobotTimeRange]
"""What one partition reads."""


class BucketRange(NamedTuple):
    """The time range of a bucket, as far as it is read."""

    low: int
    """First time, ns."""
    high: int
    """Last time, ns, included."""
    size: int
    """Size of its serialised messages, bytes."""


def plan_parts(
    keyspace: Keyspace,
    tables: Sequence[TopicTable],
    times: tuple[Time | None, Time | None],
    whose: Whose,
    part_bytes: int,
    at_once: int,
) -> list[SparkPartition]:
    """Return what each partition reads: every message once. Without messages there is no part.

    Args:
        keyspace: Keyspace of the topic.
        tables: Tables of the topic.
        times: First and last time, both included; None = open.
        whose: Robots and runs whose messages are read. The runs only leave out buckets: the reader
            is given the run, too.
        part_bytes: Maximum size of the messages of a part with several buckets, bytes.
        at_once: Number of parts that Spark can read at once; parts become smaller to be so many.

    Raises:
        InvalidKey: A time is not valid, or the messages have names instead of times.
    """
    if whose.empty:
        return []
    if any(table.named for table in tables):
        if times != (None, None):
            raise InvalidKey(
                f"messages of topic {tables[0].metadata.topic} are kept under names, which have no "
                "order: leave start and end out"
            )
        return [
            [RobotTimeRange(node) for node in ((None,) if whose.nodes is None else whose.nodes)]
        ]
    low, high = time_range_between(keyspace, tables, *times)
    buckets = followed(
        tables, lambda now: _buckets(keyspace.directory, now, (low, min(high, MAX_NS)), whose)
    )
    total = sum(bucket.size for ranges in buckets.values() for bucket in ranges)
    share = max(_MIN_PART_BYTES, -(-total // max(1, at_once)))
    return pack(buckets, min(part_bytes, share))


def _buckets(
    directory: Directory, tables: Sequence[TopicTable], times: tuple[int, int], whose: Whose
) -> dict[str, list[BucketRange]]:
    """Return the buckets with messages in a time range, by robot."""
    buckets: dict[str, list[BucketRange]] = {}
    for table in tables:
        length = table.metadata.bucket_ns
        numbers = (table.bucket_of(times[0]), table.bucket_of(times[1]))
        for row in buckets_of(directory, table, whose, numbers):
            if row.closed and not row.rows:  # one that is open has its count not yet
                continue
            first = row.bucket * length
            low, high = max(first, times[0]), min(first + length - 1, times[1])
            buckets.setdefault(row.node, []).append(BucketRange(low, high, row.bytes))
    return buckets


def pack(buckets: dict[str, list[BucketRange]], part_bytes: int) -> list[SparkPartition]:
    """Return parts of consecutive buckets of a robot, or of several robots.

    Buckets of several tables, or writers, may overlap: each time of a robot is in one part only.

    Args:
        buckets: The buckets by robot, in any order.
        part_bytes: Maximum size of a part with several buckets, bytes.
    """
    parts: list[SparkPartition] = []
    size = 0
    for node in sorted(buckets):
        end = -1
        for bucket in sorted(buckets[node]):
            begin = max(bucket.low, end + 1)
            if begin > bucket.high:
                size += bucket.size  # read with the one before it
                continue
            if not parts or size + bucket.size > part_bytes:
                parts.append([])
                size = 0
            partition = parts[-1]
            if partition and partition[-1].node == node:
                partition[-1] = partition[-1]._replace(high=bucket.high)
            else:
                partition.append(RobotTimeRange(node, begin, bucket.high))
            size += bucket.size
            end = bucket.high
    return parts
