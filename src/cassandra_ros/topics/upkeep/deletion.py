# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Deletion of messages of several topics: by time range, robot, run or conditions."""

from __future__ import annotations

from dataclasses import replace
from typing import Iterable, Sequence

from cassandra_ros.errors import InvalidOption
from cassandra_ros.read import ALWAYS, EVERYTHING, Read, Whose
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.removal import delete_rows, delete_time_range
from cassandra_ros.topics.row_finder import Filter
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.stored_totals import count_rows
from cassandra_ros.topics.topic_table import TopicTable


def delete_messages(
    catalog: Catalog,
    topics: Iterable[str] | None,
    read: Read,
    where: Conditions,
    dry_run: bool = False,
) -> dict[str, int]:
    """Delete messages of several topics; see Upkeep.delete.

    If all messages of runs are deleted, and not only counted, the runs are no longer listed.
    """
    space = catalog.keyspace
    if where is None and read == EVERYTHING:
        raise InvalidOption(
            "nothing says which messages to delete: give times, a node, a run or a "
            "condition; removeTopic and truncateTopic remove all of a topic"
        )
    deleted_runs: list[Run] = []
    is_whole = topics is None and where is None and read.time_range == ALWAYS
    if read.whose.writers is not None and is_whole:
        deleted_runs = _ended_runs(catalog, read.whose)
    catalog.adder.close()  # buckets that it has open count as being written
    counts: dict[str, int] = {}
    if where is not None:
        for name, topic_filter in _filters(catalog, topics, where, read.whose).items():
            rows = topic_filter.rows(read, bare=True)
            counts[name] = sum(1 for _ in rows) if dry_run else delete_rows(space, rows)
        return counts
    for table in catalog.tables(topics):
        count = delete_of_table(space, table, read, dry_run)
        counts[table.metadata.topic] = counts.get(table.metadata.topic, 0) + count
    if not dry_run:
        _forget(space, deleted_runs)
    return counts


def delete_of_table(space: Keyspace, table: TopicTable, read: Read, dry_run: bool = False) -> int:
    """Delete the messages of one table that a read asks for, or only count them (dry_run).

    Of the read, time range, robots and writers count. Returns the number of messages.
    """
    if dry_run:
        return count_rows(space.directory, [table], read)
    if not table.named:
        return delete_time_range(space, [table], read)
    keys_only = replace(read, columns=lambda table: ())
    return delete_rows(space, space.rows.read([table], keys_only))


def _filters(
    catalog: Catalog, topics: Iterable[str] | None, where: Conditions, whose: Whose
) -> dict[str, Filter]:
    """Return the filters by topic; other topics lose no messages."""
    named: Sequence[str] | None = None if topics is None else list(topics)
    filters = catalog.filters(where, named, whose)
    for name in named or ():
        if catalog.get(name).name not in filters:
            raise InvalidOption(
                f"there is no condition for topic {name}, of which all messages would be deleted: "
                "give it one, or delete them in a call of their own"
            )
    return filters


def _ended_runs(catalog: Catalog, whose: Whose) -> list[Run]:
    """Return the runs of some writers; raises InvalidOption if one of them goes on."""
    writers: frozenset[int] = whose.writers or frozenset()
    runs = list_runs(catalog.keyspace, catalog.tables(None))
    runs = [r for r in runs if r.writer in writers]
    runs = [r for r in runs if whose.nodes is None or r.node in whose.nodes]
    for run in runs:
        if run.state == "recording":
            raise InvalidOption(
                f"run {run.name or run.writer} goes on: what it records meanwhile would stay; end "
                f"it first. If its process was killed, try again in {STALE_SEC:.0f} s: then it "
                "counts as ended, because it gave no sign of life"
            )
    return runs


def _forget(space: Keyspace, runs: Sequence[Run]) -> None:
    """Delete the entries of runs without messages, with their losses."""
    losses = space.registry.losses() if runs else []
    for run in runs:
        topics = sorted({loss.topic for loss in losses if loss.writer == run.writer})
        space.registry.forget_run(run.writer, run.node, topics)
