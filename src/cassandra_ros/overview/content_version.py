# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a window of messages holds, as a short text: another one as soon as it holds others."""

from __future__ import annotations

import hashlib
from typing import Iterator, Sequence

from cassandra_ros.store.fetch import list_names
from cassandra_ros.store.row_counts import recount
from cassandra_ros.tables.directory import Directory
from cassandra_ros.topics.key_selection import TimeRange, Whose
from cassandra_ros.topics.replaced_tables import followed
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable

_ALL_BUCKETS = -(2**63), 2**63 - 1


def content_version(
    directory: Directory,
    tables: Sequence[TopicTable],
    time_range: TimeRange,
    whose: Whose,
    before: Sequence[StoredRow] = (),
) -> str:
    """Return a text that changes whenever the messages of a window do.

    It is of the directory: what takes time are buckets that are being written, and those of topics
    with a time to live, whose messages are counted. It may change where other messages of the same
    buckets do, or the format of a topic.

    Args:
        tables: Of the topics that are read.
        stretch: Times of reception, ns, both ends included.
        whose: Whose messages are meant.
        before: Messages from before the window that belong to it, as latched ones.

    Returns:
        64 hexadecimal digits.
    """
    facts = followed(tables, lambda now: list(_facts(directory, now, time_range, whose)))
    digest = hashlib.sha256()
    for fact in (*facts, *(repr(row.position) for row in before)):
        digest.update(fact.encode("utf-8", "surrogateescape") + b"\0")
    return digest.hexdigest()


def _facts(
    directory: Directory, tables: Sequence[TopicTable], time_range: TimeRange, whose: Whose
) -> Iterator[str]:
    for table in sorted(tables, key=lambda table: table.name):
        yield f"{table.metadata.topic} {table.name}"
        if table.named:
            keys = (key for key in list_names(table, whose.nodes) if whose.has(key.position))
            yield from sorted(map(repr, keys))
        else:
            yield from _bucket_facts(directory, table, time_range, whose)


def _bucket_facts(
    directory: Directory, table: TopicTable, time_range: TimeRange, whose: Whose
) -> Iterator[str]:
    ends = table.bucket_of(time_range.low), table.bucket_of(time_range.high)
    if table.metadata.own_time:
        ends = _ALL_BUCKETS  # where its rows lie does not say when they were received
    rows = buckets_of(directory, table, whose, ends)
    moving = set()
    for row in rows:
        if row.closed and not table.metadata.ttl:
            yield repr((row.node, row.bucket, row.writer, row.heartbeat, row[5:10]))
        else:
            moving.add((row.node, row.bucket))
    for node, bucket in sorted(moving):
        counted = recount(table, node, bucket)
        yield repr((node, bucket, sorted((each, vars(counts)) for each, counts in counted.items())))
