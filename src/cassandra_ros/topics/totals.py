# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much is stored: from the directory where that can be, else counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Optional, Sequence

from cassandra_ros.store.counting import scan_keys, settle
from cassandra_ros.store.directory import BucketRow, BucketTotals, Directory
from cassandra_ros.store.fetch import list_names
from cassandra_ros.topics.selection import Nodes
from cassandra_ros.topics.topic_table import TopicTable


@dataclass(frozen=True)
class TopicInfo:
    """What is stored of one topic, in one table, by one node."""

    topic: str
    type: str
    md5sum: str
    format: str
    node: str
    count: int
    bytes: int
    """Serialised bytes of the messages."""
    first_ns: Optional[int]
    last_ns: Optional[int]
    odd: int
    """Messages with a field that is not held exactly in its column."""
    buckets: int
    """Stretches of time, or names."""
    bucket_ns: int
    ttl: int
    table: str
    largest_bucket: int
    """Messages in the fullest bucket, or under one name."""
    key: str
    """What finds a message: 'time', 'hash', 'manual', or the field that is the key."""


def count_rows(
    directory: Directory, tables: Sequence[TopicTable], low: int, high: int, nodes: Nodes
) -> int:
    """Count rows with t in [low, high]: whole closed buckets by the directory."""
    return sum(_count(directory, table, low, high, nodes) for table in tables)


def _count(directory: Directory, table: TopicTable, low: int, high: int, nodes: Nodes) -> int:
    if table.named:
        return sum(low <= key.position.t <= high for key in list_names(table, nodes))
    length, ends = table.metadata.bucket_ns, (table.bucket_of(low), table.bucket_of(high))
    rows = directory.buckets(table.name, *ends, nodes, table.metadata.ttl)
    inner = [r for r in rows if low <= r.bucket * length and (r.bucket + 1) * length - 1 <= high]
    edges = {(r.node, r.bucket) for r in rows} - {(r.node, r.bucket) for r in inner}
    return sum(row.rows for row in settle(directory, table, inner)) + sum(
        1 for node, bucket in edges for _ in scan_keys(table, node, bucket, low, high)
    )


def count_buckets(directory: Directory, tables: Sequence[TopicTable]) -> int:
    """Count the partitions of tables: stretches of time of a node; 0 for named messages."""
    every = ((table.name, row) for table in tables for row in _buckets(directory, table))
    return len({(name, row.node, row.bucket) for name, row in every})


def describe(directory: Directory, tables: Sequence[TopicTable]) -> list[TopicInfo]:
    """Describe what is stored, by table and node; counts come from the directory."""
    found: list[TopicInfo] = []
    for table in tables:
        if table.named:
            rows = _names_as_buckets(table)
        else:
            rows = settle(directory, table, _buckets(directory, table))
        for node in sorted({row.node for row in rows}) or [table.metadata.nodeID]:
            found.append(_describe(table, node, [r for r in rows if r.node == node]))
    return found


def _buckets(directory: Directory, table: TopicTable) -> list[BucketRow]:
    return directory.buckets(table.name, -(2**63), 2**63 - 1, ttl=table.metadata.ttl)


def _names_as_buckets(table: TopicTable) -> list[BucketRow]:
    """Describe the messages of a node under a name as if that were a bucket."""
    counted: dict[tuple[str, str], BucketTotals] = {}
    for (t, node, _, _, name), size, chunked, odd in list_names(table, None):
        counted.setdefault((node, name), BucketTotals()).count(t, size, chunked, odd)
    return [
        BucketRow(node, number, 0, True, None, age_sec=0.0, **vars(totals))
        for number, ((node, _), totals) in enumerate(counted.items())
    ]


def _describe(table: TopicTable, node: str, rows: list[BucketRow]) -> TopicInfo:
    filled = [row for row in rows if row.rows]
    metadata = table.metadata
    by_bucket: Counter[int] = Counter()
    for row in filled:
        by_bucket[row.bucket] += row.rows
    return TopicInfo(
        topic=metadata.topic,
        type=metadata.msg_type,
        md5sum=metadata.md5sum,
        format=metadata.format,
        node=node,
        count=sum(row.rows for row in filled),
        bytes=sum(row.bytes for row in filled),
        first_ns=min((row.t_min for row in filled), default=None),
        last_ns=max((row.t_max for row in filled), default=None),
        odd=sum(row.odd for row in filled),
        buckets=len(by_bucket),
        bucket_ns=metadata.bucket_ns,
        ttl=metadata.ttl,
        table=table.name,
        largest_bucket=max(by_bucket.values(), default=0),
        key=metadata.key_part or metadata.key_format,
    )
