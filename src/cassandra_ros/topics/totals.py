# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much is stored: from the directory where that can be, else counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Optional, Sequence

from cassandra_ros.store.counting import scan_keys, settle
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.fetch import NamedKey, list_names
from cassandra_ros.topics.topic_table import TopicTable

_FIRST, _LAST = -(2**63), 2**63 - 1


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


class TopicTotals:
    """Counts and describes the rows of one keyspace."""

    def __init__(self, directory: Directory) -> None:
        self._directory = directory

    def count(
        self, tables: Sequence[TopicTable], low: int, high: int, nodes: Optional[Sequence[str]]
    ) -> int:
        """Count rows with t in [low, high]: whole closed buckets by the directory."""
        return sum(self._count(table, low, high, nodes) for table in tables)

    def _count(self, table: TopicTable, low: int, high: int, nodes: Optional[Sequence[str]]) -> int:
        if table.named:
            keys = list_names(table, nodes)
            return sum(low <= key.position.t <= high for key in keys)
        length = table.metadata.bucket_ns
        rows = self._directory.buckets(
            table.name, table.bucket_of(low), table.bucket_of(high), nodes, table.metadata.ttl
        )
        inner = [
            r for r in rows if low <= r.bucket * length and (r.bucket + 1) * length - 1 <= high
        ]
        settled = settle(self._directory, table, inner)
        edges = {(r.node, r.bucket) for r in rows} - {(r.node, r.bucket) for r in inner}
        return sum(row.rows for row in settled) + sum(
            1 for node, bucket in edges for _ in scan_keys(table, node, bucket, low, high)
        )

    def count_buckets(self, tables: Sequence[TopicTable]) -> int:
        """Count the partitions of tables: stretches of time of a node; 0 for named messages."""
        rows = [
            (table.name, row.node, row.bucket)
            for table in tables
            for row in self._directory.buckets(table.name, _FIRST, _LAST, ttl=table.metadata.ttl)
        ]
        return len(set(rows))

    def info(self, tables: Sequence[TopicTable]) -> list[TopicInfo]:
        """Describe what is stored, by table and node; counts come from the directory."""
        found: list[TopicInfo] = []
        for table in tables:
            if table.named:
                rows = _names_as_buckets(table)
            else:
                rows = self._directory.buckets(table.name, _FIRST, _LAST, ttl=table.metadata.ttl)
                rows = settle(self._directory, table, rows)
            for node in sorted({row.node for row in rows}) or [table.metadata.nodeID]:
                found.append(_describe(table, node, [r for r in rows if r.node == node]))
        return found


def _names_as_buckets(table: TopicTable) -> list[BucketRow]:
    """Describe each named message as if its name were a bucket."""
    numbers: dict[str, int] = {}
    return [
        _as_bucket(numbers.setdefault(key.position.name, len(numbers)), key)
        for key in list_names(table, None)
    ]


def _as_bucket(number: int, key: NamedKey) -> BucketRow:
    t = key.position.t
    return BucketRow(
        node=key.position.node,
        bucket=number,
        writer=0,
        closed=True,
        heartbeat=None,
        rows=1,
        bytes=key.size,
        largest=key.size,
        t_min=t,
        t_max=t,
        odd=int(key.odd),
        age_sec=0.0,
    )


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
