# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Retention of messages: by age, by size, around events, and thinned to a rate.

A message is dropped if it is older than the maximum age, or if it and all newer ones exceed the
maximum size. Of the others the first one of each period is kept, for each publisher. Messages in a
window around a message that matches a condition of ``keep``, or around an event, are not touched.
To make such a window, and what is left, playable, neither are the latched messages before it of
runs with messages in it.
"""

from __future__ import annotations

import heapq
import logging
from dataclasses import dataclass, field, replace
from typing import Dict, Iterable, Iterator, Sequence, Tuple

from cassandra_ros.errors import EventNotFound, InvalidOption
from cassandra_ros.places.paths import subtract_ranges
from cassandra_ros.query.plan.bounds import merge_ranges
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.event_finder import EventChoice, merge_windows
from cassandra_ros.topics.overview.latched_messages import LatchedFinder
from cassandra_ros.topics.removal import thin_rows
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import buckets_of, count_rows
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.deletion import delete_of_table
from cassandra_ros.topics.upkeep.table_copy import Progress

_log = logging.getLogger(__name__)

_Periods = Dict[Tuple[str, int], int]
"""nodeID and connection of a publisher → the last period with a message."""


@dataclass(frozen=True)
class Rules:
    """Rules of retention; times in ns."""

    now: int
    """Time from which ages are counted back."""
    max_age: int | None = None
    """Maximum age; None = no limit."""
    max_bytes: int | None = None
    """Maximum number of serialised bytes of all topics together; the oldest messages are dropped
    first."""
    keep: Conditions = None
    """Topic → condition; what lies around matching messages is kept."""
    events: Sequence[str] = ()
    """Names of events; what lies around them is kept."""
    before: int = 0
    """Time range before a matching message or an event that is kept."""
    after: int = 0
    period: int = 0
    """Length of a period, of which one message of each publisher is kept; 0 = keep all."""
    thin_after: int = 0
    """Minimum age of messages that are thinned."""

    def check(self) -> None:
        """Raise InvalidOption if the rules would drop nothing."""
        if self.max_age is None and self.max_bytes is None and not self.period:
            raise InvalidOption(
                "nothing says what is to be dropped: give a maximum age or size, or a rate to "
                "which messages are thinned"
            )


@dataclass
class Retained:
    """Numbers of messages of one topic that were, or would be, dropped and kept."""

    topic: str
    messages: int = 0
    """Number of messages before."""
    dropped: int = 0
    """Number of messages dropped because of age or size."""
    thinned: int = 0

    @property
    def left(self) -> int:
        """Number of messages that are kept."""
        return self.messages - self.dropped - self.thinned


@dataclass
class _Pins:
    """Messages that are kept whatever their age."""

    windows: list[TimeRange] = field(default_factory=list)
    """Time ranges for all topics, in order, without overlap."""
    latched: dict[str, set[int]] = field(default_factory=dict)
    """Table → key times of latched messages."""

    def of(self, table: TopicTable) -> list[TimeRange]:
        """Return the time ranges of a table that are kept, in order."""
        single = (TimeRange(t, t) for t in sorted(self.latched.get(table.name, ())))
        return list(heapq.merge(self.windows, single))


def retain(
    catalog: Catalog,
    topics: Iterable[str] | None,
    rules: Rules,
    dry_run: bool = False,
    progress: Progress = None,
) -> list[Retained]:
    """Drop the messages that the rules do not keep; see Upkeep.retain."""
    rules.check()
    catalog.adder.close()  # buckets that it has open count as being written
    tables = _tables_by_time(catalog, topics)
    work = _Retention(catalog, tables, rules, dry_run)
    by_topic: dict[str, Retained] = {}
    counts = [count_rows(catalog.keyspace.directory, [t], Read()) for t in tables]
    for number, table in enumerate(tables):
        report = by_topic.setdefault(table.metadata.topic, Retained(table.metadata.topic))
        report.messages += counts[number]
        work.table(table, report)
        if progress is not None:
            progress(sum(counts[: number + 1]), sum(counts))
    return [by_topic[topic] for topic in sorted(by_topic)]


def _tables_by_time(catalog: Catalog, topics: Iterable[str] | None) -> list[TopicTable]:
    """Return the tables with a time key; messages with names have no age."""
    tables = catalog.tables(topics)
    named = sorted({table.metadata.topic for table in tables if table.named})
    if topics is not None and named:
        raise InvalidOption(
            f"messages of topic {named[0]} are kept under names, and not by time: delete those "
            "that you do not want any more by their names"
        )
    return [table for table in tables if not table.named]


class _Retention:
    """Applies rules to tables.

    Attributes:
        cutoff: Time before which messages are dropped unless they are pinned, ns.
    """

    def __init__(
        self, catalog: Catalog, tables: Sequence[TopicTable], rules: Rules, dry_run: bool
    ) -> None:
        self._space = catalog.keyspace
        self._catalog = catalog
        self._rules = rules
        self._dry_run = dry_run
        self._finder = LatchedFinder(self._space, tables)
        self.cutoff = 0 if rules.max_age is None else max(0, rules.now - rules.max_age)
        if rules.max_bytes is not None:
            self.cutoff = max(self.cutoff, self._cutoff_of_size(tables, rules.max_bytes))
        self._thin_end = max(0, rules.now - rules.thin_after) if rules.period else 0
        self._pins = self._make_pins()

    def table(self, table: TopicTable, report: Retained) -> None:
        """Drop and thin the messages of one table."""
        pins = self._pins.of(table)
        for gap in subtract_ranges([(0, self.cutoff - 1)], pins):
            report.dropped += delete_of_table(self._space, table, Read(gap), self._dry_run)
        if self._thin_end > self.cutoff:
            # Before reading: messages that are added meanwhile are not deleted.
            until_us = self._space.cassandra.server_time_us()
            last: _Periods = {}
            for gap in subtract_ranges([(self.cutoff, self._thin_end - 1)], pins):
                rows = self._rated(table, gap, last)
                report.thinned += (
                    sum(surplus for _, surplus in rows)
                    if self._dry_run
                    else thin_rows(self._space, rows, until_us)
                )

    def _cutoff_of_size(self, tables: Sequence[TopicTable], most: int) -> int:
        """Return the time from which on the messages of all tables take at most ``most`` bytes.

        From the newest on, buckets are counted by the directory as long as whole ones fit. The rest
        is read message by message.
        """
        directory = self._space.directory
        rows_of_tables = [
            (table, row)
            for table in tables
            for row in recount_open_buckets(directory, table, buckets_of(directory, table))
            if row.rows
        ]
        rows_of_tables.sort(key=lambda pair: -pair[1].t_max)
        room, begin = most, LAST_NS
        for _, row in rows_of_tables:
            if row.bytes > room:
                begin = row.t_max + 1  # all later messages fit, also those of earlier buckets
                break
            room -= row.bytes
        else:
            return 0
        newer = [(table, row) for table, row in rows_of_tables if row.t_max >= begin]
        nbytes = sum(row.bytes for _, row in newer if row.t_min >= begin)
        for table, row in newer:
            if row.t_min < begin:
                whose = Whose((row.node,), frozenset([row.writer]))
                rows = self._bare([table], Read(TimeRange(begin, row.t_max), whose))
                nbytes += sum(row.size for row in rows)
        return self._further(tables, begin, most - nbytes)

    def _further(self, tables: Sequence[TopicTable], begin: int, room: int) -> int:
        """Go back from a time message by message, while they fit into ``room`` bytes.

        Return the time from which on all fit; 0 = all messages do.
        """
        for row in self._bare(tables, Read(TimeRange(0, begin - 1), reverse=True)):
            room -= row.size
            if room < 0:
                return row.t + 1
        return 0

    def _bare(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Yield rows without their bytes."""
        return self._space.rows.read(tables, replace(read, columns=lambda table: ()))

    def _make_pins(self) -> _Pins:
        """Find what is kept before the cutoff, and before the end of thinning."""
        rules, end = self._rules, max(self.cutoff, self._thin_end)
        pins = _Pins()
        if rules.keep:
            reach = Read(TimeRange(0, min(LAST_NS, end + rules.before)))
            filters = self._catalog.filters(rules.keep, None)
            hits = heapq.merge(*(_times(f.rows(reach, bare=True)) for f in filters.values()))
            pins.windows = list(merge_windows(hits, rules.before, rules.after, TimeRange()))
        for name in rules.events:
            windows = sorted([*pins.windows, *self._around_events(name, end)])
            pins.windows = list(merge_ranges(windows))
        if self.cutoff and self._finder.latches:
            for low, high in [*pins.windows, TimeRange(self.cutoff, LAST_NS)]:
                for row in self._finder.before(low, high):
                    pins.latched.setdefault(row.table.name, set()).add(row.t)
        return pins

    def _around_events(self, name: str, end: int) -> Sequence[TimeRange]:
        """Return the time ranges around the events of a name that may reach to before ``end``."""
        rules, reach = self._rules, Read(TimeRange(0, end))
        choice = EventChoice(name, rules.before, rules.after)
        try:
            return self._space.events.chosen(choice, reach).ranges
        except EventNotFound as exc:
            _log.warning("nothing is kept for an event: %s", exc)
            return ()

    def _rated(
        self, table: TopicTable, gap: TimeRange, last: _Periods
    ) -> Iterator[tuple[StoredRow, bool]]:
        """Yield all messages and whether they are surplus: not a publisher's first of a period.

        Latched messages are kept: each one holds until the next one comes.

        Args:
            last: Last periods so far; it is changed.
        """
        for row in self._bare([table], Read(gap)):
            if self._finder.is_latched(row):
                yield row, False
                continue
            publisher, period = (row.node, row.conn), row.t // self._rules.period
            yield row, last.get(publisher) == period
            last[publisher] = period


def _times(rows: Iterable[StoredRow]) -> Iterator[int]:
    return (row.t for row in rows)
