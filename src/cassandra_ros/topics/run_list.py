# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The list of runs with their present state and counts, also for runs that were killed."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Counter as Counts
from typing import Sequence

from cassandra_ros.keys import writer_of
from cassandra_ros.read import Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.directory import STALE_SEC, Directory
from cassandra_ros.store.tables.registry import Run, SignOfLife
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable


@dataclass
class _StoredCounts:
    """Messages that are stored of one writer."""

    stored: Counts[str] = field(default_factory=Counter)
    age_sec: float = math.inf
    """Time since its last heartbeat of a bucket, s."""


def list_runs(space: Keyspace, tables: Sequence[TopicTable], times: bool = False) -> list[Run]:
    """Return the runs with their state; for those that have not ended messages are counted.

    A run without a sign of life for STALE_SEC is interrupted.

    Args:
        tables: All tables of the keyspace.
        times: Whether the times of their first and last messages are looked up.
    """
    runs, signs = space.registry.runs(), space.registry.signs()
    open_writers = frozenset(run.writer for run in runs if not _has_ended(run))
    counts: dict[int, _StoredCounts] = {}
    if open_writers:
        counts = followed(tables, lambda now: _count_stored(space.directory, now, open_writers))
    extents: dict[int, tuple[int, int]] = {}
    if times:
        extents = followed(tables, lambda now: _extents(space.directory, now))
    lost: dict[int, Counts[str]] = {}
    for loss in space.registry.losses() if open_writers else ():
        lost.setdefault(loss.writer, Counter())[loss.topic] += loss.count
    answer: list[Run] = []
    for stored_run in runs:
        first, last = extents.get(stored_run.writer, (None, None))
        run = replace(stored_run, first_ns=first, last_ns=last)
        sign = signs.get((run.writer, run.node), SignOfLife(math.inf, False))
        if _has_ended(run):
            answer.append(replace(run, state="interrupted" if sign.interrupted else "ended"))
            continue
        run_counts = counts.get(run.writer, _StoredCounts())
        alive = not sign.interrupted and min(sign.age_sec, run_counts.age_sec) <= STALE_SEC
        state = "recording" if alive else "interrupted"
        stored = {topic: count for topic, count in sorted(run_counts.stored.items()) if count}
        missing = dict(lost.get(run.writer, Counter()))
        answer.append(replace(run, ended=None, state=state, stored=stored, lost=missing))
    return answer


def _has_ended(run: Run) -> bool:
    # An import that is repeated has its new start beside its old end.
    return run.ended is not None and (run.started is None or run.started <= run.ended)


def _extents(directory: Directory, tables: Sequence[TopicTable]) -> dict[int, tuple[int, int]]:
    """Return the times of the first and the last message by writer, ns."""
    extents: dict[int, tuple[int, int]] = {}
    for table in tables:
        rows = [] if table.named else buckets_of(directory, table)
        for row in recount_open_buckets(directory, table, rows):
            if row.rows:
                first, last = extents.get(row.writer, (row.t_min, row.t_max))
                extents[row.writer] = min(first, row.t_min), max(last, row.t_max)
    return extents


def _count_stored(
    directory: Directory, tables: Sequence[TopicTable], writers: frozenset[int]
) -> dict[int, _StoredCounts]:
    """Count the stored messages of some writers, by the directory where possible."""
    counts: dict[int, _StoredCounts] = {}
    whose = Whose(None, writers)
    for table in tables:
        topic = table.metadata.topic
        if table.named:
            for key in list_names(table, None):
                if whose.wrote(key.position.seq):
                    run_counts = counts.setdefault(writer_of(key.position.seq), _StoredCounts())
                    run_counts.stored[topic] += 1
            continue
        rows = buckets_of(directory, table, whose)
        for row in recount_open_buckets(directory, table, rows):
            run_counts = counts.setdefault(row.writer, _StoredCounts())
            run_counts.stored[topic] += row.rows
            run_counts.age_sec = min(run_counts.age_sec, row.age_sec)
    return counts
