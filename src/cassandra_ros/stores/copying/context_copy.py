# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What goes with the messages: connections, runs with context, losses, events, and metadata."""

from __future__ import annotations

from dataclasses import replace
from typing import Collection, Iterable

from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import TimeRange, Whose
from cassandra_ros.store.tables.event_table import Event, EventTable
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.stores.copying.table_pair import TablePair
from cassandra_ros.topics.keyspace import Keyspace

_CONTEXT = "cr_context"
_CONTEXT_COLUMNS = ("writer", "node", "heartbeat", "interrupted", "context")
_SENT = "cr_sent"
_SENT_COLUMNS = ("writer", "node", "stripe", "sent")


def copy_headers(pairs: Collection[TablePair]) -> None:
    """Copy all connection headers of some tables of one keyspace, also those without messages."""
    if not pairs:
        return
    by_table: dict[str, list[TablePair]] = {}
    for pair in pairs:
        by_table.setdefault(pair.source.name, []).append(pair)
    here = next(iter(pairs)).here
    for table, conn, _ in here.registry.headers(by_table):
        for pair in by_table[table]:
            pair.connect(conn)


def copy_metadata(pair: TablePair) -> None:
    """Add the user's keys, and the comment, where the topic there has none."""
    here, there = pair.source.metadata, pair.target.metadata
    if _merge_metadata(here, there) != there:
        pair.there.schema.change_topic(pair.topic, lambda other: _merge_metadata(here, other))


def _merge_metadata(here: TopicMetadata, there: TopicMetadata) -> TopicMetadata:
    """Return the metadata there with what only those here have."""
    user = {**here.user, **there.user}
    return there.with_(user=user, comment=there.comment or here.comment)


def copy_runs(
    here: Keyspace, there: Keyspace, writers: Collection[int] | None, topics: Collection[str]
) -> int:
    """Copy runs with their labels, parameters, graph, signs of life and send times.

    Args:
        writers: Writer ids of the runs; None = of all.
        topics: Topics that are there; the runs' counts of others are left out.

    Returns:
        The number of runs that were new or different there.
    """
    runs_there = {(run.writer, run.node): run for run in there.registry.runs()}
    count = 0
    for run in here.registry.runs():
        if writers is not None and run.writer not in writers:
            continue
        stored = {topic: n for topic, n in run.stored.items() if topic in topics}
        run = replace(run, stored=stored)
        other = runs_there.get((run.writer, run.node))
        if other != run:
            _copy_rows(here, there, _SENT, _SENT_COLUMNS, run)
            # After the send times: once the run is equal there, these are not copied again.
            there.registry.put_run(run)
            count += 1
        if other != run or run.ended is None:  # while it goes on, it gives signs of life
            _copy_rows(here, there, _CONTEXT, _CONTEXT_COLUMNS, run)
    return count


def _copy_rows(
    here: Keyspace, there: Keyspace, table: str, columns: tuple[str, ...], run: Run
) -> None:
    """Copy the rows of a side table that belong to a run, as they are."""
    where, what = "writer = ? AND node = ?", "copying a run"
    key = (run.writer, run.node)
    rows = here.side_tables.select(table, ", ".join(columns), where, key, what=what)
    if rows:
        there.side_tables.make(table)
    for row in rows:
        values = {name: value for name, value in zip(columns, row) if value is not None}
        there.side_tables.insert(table, values, what)


def copy_losses(
    here: Keyspace, there: Keyspace, topics: Iterable[str], writers: Collection[int] | None
) -> int:
    """Copy the losses of topics by some writers (None = all); return the number of new ones."""
    names = sorted(topics)
    losses_there = set(there.registry.losses(names))
    new = [
        loss
        for loss in here.registry.losses(names)
        if (writers is None or loss.writer in writers) and loss not in losses_there
    ]
    for loss in new:
        there.registry.put_loss(loss)
    return len(new)


def copy_events(here: Keyspace, there: Keyspace, within: TimeRange, whose: Whose) -> int:
    """Copy events; return the number of those that were new or different there.

    An event that was deleted here stays there. One that was changed there is overwritten.

    Args:
        within: Time range, ns; the events that meet it are copied.
        whose: Robots and writers of the events. Events of all robots, and of no run, go with them.
    """
    table_here, table_there = EventTable(here.side_tables), EventTable(there.side_tables)
    # Both are read in the same order, so that one event of each is in memory, not all.
    events_there = table_there.read(within=within)
    other, count = next(events_there, None), 0
    for event in table_here.read(within=within):
        while other is not None and other.order() < event.order():
            other = next(events_there, None)
        if other != event and _is_selected(event, whose):
            table_there.put(event)
            count += 1
    return count


def _is_selected(event: Event, whose: Whose) -> bool:
    """Return whether an event goes with the messages of some robots and writers."""
    robots, writers = whose.nodes, whose.writers
    return (robots is None or event.node in ("", *robots)) and (
        writers is None or event.writer in (0, *writers)
    )
