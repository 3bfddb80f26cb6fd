# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A short text for the messages in a time range, which changes whenever the messages do."""

from __future__ import annotations

import hashlib
from typing import Iterator, Sequence

from cassandra_ros.read import Read
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import ALL_BUCKETS, buckets_of
from cassandra_ros.topics.topic_table import TopicTable


def content_version(
    directory: Directory, tables: Sequence[TopicTable], read: Read, before: Sequence[StoredRow] = ()
) -> str:
    """Return a text that changes whenever the messages in a time range do.

    It is computed from the directory. Only buckets that are being written, and those of topics with
    a time to live, take time: their messages are counted. The text may also change if other
    messages of the same buckets do, or the format of a topic.

    Args:
        tables: Tables of the topics to read.
        read: Range of receive times, robots and writers of the messages that count.
        before: Messages from before the range that belong to it, such as latched ones.

    Returns:
        64 hexadecimal digits.
    """
    facts = followed(tables, lambda now: list(_facts(directory, now, read)))
    digest = hashlib.sha256()
    for fact in (*facts, *(repr(row.position) for row in before)):
        digest.update(fact.encode("utf-8", "surrogateescape") + b"\0")
    return digest.hexdigest()


def _facts(directory: Directory, tables: Sequence[TopicTable], read: Read) -> Iterator[str]:
    """Yield texts of which one changes with each change of the messages, in a fixed order."""
    whose = read.whose
    for table in sorted(tables, key=lambda table: table.name):
        yield f"{table.metadata.topic} {table.name}"
        if table.named:
            keys = (key for key in list_names(table, whose.nodes) if whose.has(key.position))
            yield from sorted(map(repr, keys))
        else:
            yield from _bucket_facts(directory, table, read)


def _bucket_facts(directory: Directory, table: TopicTable, read: Read) -> Iterator[str]:
    """Yield the entries of buckets with final counts; of the others the messages are counted."""
    low, high = read.time_range
    ends = table.bucket_of(low), table.bucket_of(high)
    if table.metadata.own_time:
        ends = ALL_BUCKETS  # the buckets of its rows say nothing about the receive times
    rows = buckets_of(directory, table, read.whose, ends)
    uncounted = set()
    for row in rows:
        if row.closed and not table.metadata.ttl:
            counts = row.counts[:5]  # without the number of odd messages
            yield repr((row.node, row.bucket, row.writer, row.heartbeat, counts))
        else:
            uncounted.add((row.node, row.bucket))
    for node, bucket in sorted(uncounted):
        recounts = layout_of(table).recount(node, bucket)
        by_writer = sorted((writer, vars(counts)) for writer, counts in recounts.items())
        yield repr((node, bucket, by_writer))
