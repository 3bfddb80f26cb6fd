# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of stored messages: from the directory where possible, otherwise counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Iterable, Iterator, Sequence

from cassandra_ros.keys import MAX_NS, SECOND_NS, writer_of
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.printable import shown
from cassandra_ros.read import ALWAYS, EVERYBODY, Read, TimeRange, Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.directory import BucketRow, BucketTotals, Directory
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.topic_table import TopicTable

ALL_BUCKETS = (-(2**63), 2**63 - 1)
"""First and last bucket, and slot, of any table."""


@dataclass(frozen=True, repr=False)
class TopicInfo:
    """Numbers of one topic in one table by one robot."""

    topic: str
    type: str
    md5sum: str
    format: str
    node: str
    count: int
    """Number of messages."""
    bytes: int
    """Number of serialised bytes of the messages."""
    first_ns: int | None
    last_ns: int | None
    """Key times of the first and the last message, ns; None = there are no messages."""
    odd: int
    """Number of messages with a field that is not held exactly in its column."""
    buckets: int
    """Number of buckets, or of names."""
    bucket_ns: int
    """Length of a bucket, ns."""
    ttl: int
    """Time to live of the messages, s; 0 = they stay for ever."""
    table: str
    largest_bucket: int
    """Maximum number of messages in one bucket, or with one name."""
    lost: int
    """Known number of lost messages of the topic by this robot, for all tables together: each of
    its tables has the same number, so do not add them up."""
    key: str
    """Key of a message: 'time', 'hash', 'manual', or the name of the key field."""
    rate_hz: float | None
    """Mean rate while messages were coming, Hz: gaps between buckets, such as between two
    recordings, do not count. None if no bucket has two messages of one writer."""

    def __repr__(self) -> str:
        node = f" of {shown(self.node)}" if self.node else ""
        text = f"{self.type} in format {self.format}, messages: {self.count}, bytes: {self.bytes}"
        if self.first_ns is not None and self.last_ns is not None:
            text += f", from {iso_time(self.first_ns)} to {iso_time(self.last_ns)}"
        lost = f", lost: {self.lost}" if self.lost else ""
        return f"<TopicInfo {shown(self.topic)}{node}: {text}{lost}>"


def count_rows(directory: Directory, tables: Sequence[TopicTable], read: Read) -> int:
    """Return the number of rows in the time range of a read, of its nodes and writers.

    Closed buckets that are wholly in the range are counted by the directory.
    """

    def count(now: Sequence[TopicTable]) -> int:
        return sum(_count(directory, table, read) for table in now)

    return followed(tables, count)


def _count(directory: Directory, table: TopicTable, read: Read) -> int:
    """Count the messages of one table; only at the ends of the time range they may be read."""
    (low, high), whose = read.time_range, read.whose
    if table.named:
        keys = (k for k in list_names(table, whose.nodes) if whose.wrote(k.position.seq))
        return sum(low <= key.position.t <= high for key in keys)
    length, ends = table.metadata.bucket_ns, (table.bucket_of(low), table.bucket_of(high))
    # The buckets that are wholly in the range: without those at its ends if it begins or ends in
    # them.
    first = ends[0] if low <= 0 else -(-low // length)
    last = ends[1] if high >= MAX_NS else (high + 1) // length - 1
    count = 0
    rows: list[BucketRow] = []
    if whose == EVERYBODY and not table.metadata.ttl:
        if first <= last:
            count, rows = directory.count_closed(table.name, first, last)
        for end_bucket in {end for end in ends if not first <= end <= last}:
            rows += buckets_of(directory, table, whose, (end_bucket, end_bucket))
    else:
        rows = buckets_of(directory, table, whose, ends)
    inner = [row for row in rows if first <= row.bucket <= last]
    edges = group_by_bucket(row for row in rows if not first <= row.bucket <= last)
    count += sum(row.rows for row in recount_open_buckets(directory, table, inner))
    return count + sum(_count_edge(table, group, read) for group in edges.values())


def _count_edge(table: TopicTable, group: Sequence[BucketRow], read: Read) -> int:
    """Count the messages of a bucket that is partly in a time range."""
    low, high = read.time_range
    if all(row.closed for row in group) and not table.metadata.ttl:
        entries = [row for row in group if row.rows and row.t_min <= high and row.t_max >= low]
        if all(low <= row.t_min and row.t_max <= high for row in entries):
            return sum(row.rows for row in entries)
    return layout_of(table).count(group[0].node, group[0].bucket, (low, high), read.whose.writers)


def holds_any(directory: Directory, tables: Sequence[TopicTable], whose: Whose) -> bool:
    """Return whether some tables may hold messages of ``whose``, without reading these.

    A bucket that the directory lists counts, also if it has no message.
    """

    def holds(now: Sequence[TopicTable]) -> bool:
        timed_first = sorted(now, key=lambda table: table.named)
        return any(True for table in timed_first for _ in writers_of(directory, table, whose))

    return followed(tables, holds)


def writers_of(
    directory: Directory, table: TopicTable, whose: Whose = EVERYBODY
) -> Iterator[tuple[int, str]]:
    """Yield writer id and nodeID of each bucket of a table, or of each message with a name."""
    if table.named:
        positions = (key.position for key in list_names(table, whose.nodes))
        return ((writer_of(p.seq), p.node) for p in positions if whose.wrote(p.seq))
    return ((row.writer, row.node) for row in buckets_of(directory, table, whose))


def count_buckets(directory: Directory, tables: Sequence[TopicTable]) -> int:
    """Return the number of partitions: buckets of a node in a table; 0 for named messages."""

    def count(now: Sequence[TopicTable]) -> int:
        entries = ((t.name, row) for t in now for row in buckets_of(directory, t))
        return len({(name, row.node, row.bucket) for name, row in entries})

    return followed(tables, count)


def describe(
    directory: Directory,
    tables: Sequence[TopicTable],
    whose: Whose = EVERYBODY,
    losses: Sequence[Loss] = (),
    time_range: TimeRange = ALWAYS,
) -> list[TopicInfo]:
    """Describe what is stored, by table and node; counts come from the directory.

    With a run or node only the tables in which it has messages are listed. A time range, which must
    not cut a bucket, does not matter to messages with names.

    Args:
        losses: Losses to count, by topic and node.
    """
    return followed(tables, lambda now: _describe_all(directory, now, whose, losses, time_range))


def _describe_all(
    directory: Directory,
    tables: Sequence[TopicTable],
    whose: Whose,
    losses: Sequence[Loss],
    time_range: TimeRange,
) -> list[TopicInfo]:
    infos: list[TopicInfo] = []
    lost: Counter[tuple[str, str]] = Counter()
    for loss in losses:
        lost[loss.topic, loss.node] += loss.count
    for table in tables:
        if table.named:
            rows = _names_as_buckets(table, whose)
        else:
            ends = table.bucket_of(time_range.low), table.bucket_of(time_range.high)
            rows = recount_open_buckets(directory, table, buckets_of(directory, table, whose, ends))
        groups: dict[str, list[BucketRow]] = {}
        for row in rows:
            groups.setdefault(row.node, []).append(row)
        # A table without messages is listed too, unless a run or node is asked for.
        for node in sorted(groups) or [table.metadata.nodeID] * (whose == EVERYBODY):
            missing = lost[table.metadata.topic, node]
            infos.append(_describe(table, node, groups.get(node, []), missing))
    return infos


def buckets_of(
    directory: Directory,
    table: TopicTable,
    whose: Whose = EVERYBODY,
    ends: tuple[int, int] = ALL_BUCKETS,
) -> list[BucketRow]:
    """Return the buckets of a table with messages of ``whose``, one row for each writer."""
    rows = directory.buckets(table.name, table.metadata, *ends, whose.nodes)
    return rows if whose.writers is None else [row for row in rows if row.writer in whose.writers]


def group_by_bucket(rows: Iterable[BucketRow]) -> dict[tuple[str, int], list[BucketRow]]:
    """Return the rows of each bucket, one for each writer, by nodeID and number of the bucket."""
    groups: dict[tuple[str, int], list[BucketRow]] = {}
    for row in rows:
        groups.setdefault((row.node, row.bucket), []).append(row)
    return groups


def _names_as_buckets(table: TopicTable, whose: Whose) -> list[BucketRow]:
    """Return the totals of each name and node as a closed bucket, whose number has no meaning."""
    totals_by_name: dict[tuple[str, str], BucketTotals] = {}
    for (t, node, seq, _, name), size, chunked, odd in list_names(table, whose.nodes):
        if not whose.wrote(seq):
            continue
        totals_by_name.setdefault((node, name), BucketTotals()).count(t, size, chunked, odd)
    return [
        BucketRow(node, number, 0, True, None, age_sec=0.0, **vars(totals))
        for number, ((node, _), totals) in enumerate(totals_by_name.items())
    ]


def _describe(table: TopicTable, node: str, rows: list[BucketRow], lost: int) -> TopicInfo:
    """Describe what a node has in a table, by its buckets."""
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
        lost=lost,
        key=metadata.key_part or metadata.key_format,
        rate_hz=_rate(filled),
    )


def _rate(filled: Sequence[BucketRow]) -> float | None:
    """Return TopicInfo.rate_hz; the buckets have messages."""
    covered_ns = sum(row.t_max - row.t_min for row in filled)
    return sum(row.rows - 1 for row in filled) * SECOND_NS / covered_ns if covered_ns else None
