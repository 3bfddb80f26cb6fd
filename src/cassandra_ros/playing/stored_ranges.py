# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Time ranges in which the runs of a keyspace have messages of some topics."""

from __future__ import annotations

from typing import NamedTuple, Sequence

from cassandra_ros.keys import split_seq
from cassandra_ros.read import EVERYBODY, Nodes, Read, Whose
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.directory import BucketRow
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable


class StoredRange(NamedTuple):
    """The time range in which one run has messages in one table."""

    table: TopicTable
    node: str
    writer: int
    """Writer id; 0 if rows do not have it (key format hash)."""
    first: int
    """Time of reception of the first message, ns."""
    last: int
    """Time of reception of the last message, ns."""


def stored_ranges(
    keyspace: Keyspace, tables: Sequence[TopicTable], whose: Whose = EVERYBODY
) -> list[StoredRange]:
    """Return the time range of each run in each table; most of them without reading a row."""
    ranges: list[StoredRange] = []
    nodes, writers = whose
    for table in tables:
        has_own_order = table.named or table.metadata.own_time
        listed = (
            _by_keys(keyspace, table, nodes)
            if has_own_order
            else _by_buckets(keyspace, table, nodes)
        )
        ranges.extend(
            stored_range
            for stored_range in listed
            if writers is None or not stored_range.writer or stored_range.writer in writers
        )
    return ranges


def _by_buckets(keyspace: Keyspace, table: TopicTable, nodes: Nodes) -> list[StoredRange]:
    """Take the times from the directory; only rows of open buckets are counted."""
    by_run: dict[tuple[str, int], list[BucketRow]] = {}
    for row in buckets_of(keyspace.directory, table, Whose(nodes)):
        by_run.setdefault((row.node, row.writer), []).append(row)
    ranges: list[StoredRange] = []
    for (node, writer), rows in by_run.items():
        rows.sort(key=lambda row: row.bucket)
        first, last = (_first_filled(keyspace, table, ordered) for ordered in (rows, rows[::-1]))
        if first is not None and last is not None:
            ranges.append(StoredRange(table, node, writer, first.t_min, last.t_max))
    return ranges


def _first_filled(
    keyspace: Keyspace, table: TopicTable, rows: Sequence[BucketRow]
) -> BucketRow | None:
    """Return the first bucket that is not empty; count its rows and those of the ones before."""
    recounted = (recount_open_buckets(keyspace.directory, table, [row])[0] for row in rows)
    return next((row for row in recounted if row.rows), None)


def _by_keys(keyspace: Keyspace, table: TopicTable, nodes: Nodes) -> list[StoredRange]:
    """Read all keys: those of such topics are not in the order of reception."""
    ranges: dict[tuple[str, int], StoredRange] = {}
    rows = keyspace.rows.read([table], Read(whose=Whose(nodes), columns=lambda table: ()))
    for row in rows:
        run, t = (row.node, split_seq(row.seq)[0]), row.received
        run_range = ranges.get(run, StoredRange(table, *run, t, t))
        ranges[run] = run_range._replace(first=min(run_range.first, t), last=max(run_range.last, t))
    return list(ranges.values())
