# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is kept of topics: by age, by size, around what happened, and thinned to a rate.

A message is dropped where it is older than the greatest age, or where it and all that is newer take
more than the size. Of the rest one of each period of the rate is kept, for each publisher. Nothing
of that befalls what lies in a window around a hit; nor, so that a window can still be played, what
was latched before it, or before what is left, by the runs that go on there.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import Dict, Iterable, Iterator, List, Optional, Sequence, Set, Tuple

from cassandra_ros.errors import InvalidOption
from cassandra_ros.overview.latched_messages import LatchedFinder
from cassandra_ros.store.row_counts import settle
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.hit_windows import joined, merge_windows
from cassandra_ros.topics.key_selection import EVERYBODY, LAST_NS, TimeRange, Whose
from cassandra_ros.topics.removal import thin_rows
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import buckets_of, count_rows
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.upkeep.deletion import delete_of_table
from cassandra_ros.upkeep.table_copy import Progress

_Periods = Dict[Tuple[str, int], int]
"""nodeID and connection of a publisher -> the last period of which there is a message."""


@dataclass(frozen=True)
class Rules:
    """What is to be kept; times in ns."""

    now: int
    """From which ages are counted back."""
    max_age: Optional[int] = None
    """Older messages are dropped; None = none for its age."""
    max_bytes: Optional[int] = None
    """Serialised bytes that the topics may take together; the oldest go first."""
    keep: Conditions = None
    """Topic -> condition: what lies around their messages is kept."""
    before: int = 0
    """How far before a message of keep."""
    after: int = 0
    period: int = 0
    """Of a publisher one message in each such period of time is kept; 0 = all."""
    thin_after: int = 0
    """Only older messages are thinned."""

    def check(self) -> None:
        """Raise InvalidOption where nothing would be dropped by them."""
        if self.max_age is None and self.max_bytes is None and not self.period:
            raise InvalidOption(
                "nothing says what is to be dropped: give a greatest age or size, or a rate to "
                "which messages are thinned"
            )


@dataclass
class Retained:
    """What became, or would become, of one topic."""

    topic: str
    messages: int = 0
    """How many there were."""
    dropped: int = 0
    """For their age, or the size."""
    thinned: int = 0

    @property
    def left(self) -> int:
        """How many are kept."""
        return self.messages - self.dropped - self.thinned


@dataclass
class _Pins:
    """What stays whatever its age: of all topics, and single messages of one."""

    windows: List[TimeRange] = field(default_factory=list)
    """In order, without overlap."""
    latched: Dict[str, Set[int]] = field(default_factory=dict)
    """Table -> times of messages."""

    def of(self, table: TopicTable) -> List[TimeRange]:
        """Return the stretches of a table that stay, in order."""
        single = (TimeRange(t, t) for t in sorted(self.latched.get(table.name, ())))
        return list(heapq.merge(self.windows, single))


def retain(
    catalog: Catalog,
    topics: Optional[Iterable[str]],
    rules: Rules,
    dry_run: bool = False,
    progress: Progress = None,
) -> List[Retained]:
    """Drop what the rules do not keep; see Upkeep.retain."""
    rules.check()
    catalog.adder.close()  # what it holds open is written to, too
    tables = _timed(catalog, topics)
    work = _Work(catalog, tables, rules, dry_run)
    found: Dict[str, Retained] = {}
    counts = [count_rows(catalog.keyspace.directory, [t], *TimeRange(), EVERYBODY) for t in tables]
    for number, table in enumerate(tables):
        each = found.setdefault(table.metadata.topic, Retained(table.metadata.topic))
        each.messages += counts[number]
        work.table(table, each)
        if progress is not None:
            progress(sum(counts[: number + 1]), sum(counts))
    return [found[topic] for topic in sorted(found)]


def _timed(catalog: Catalog, topics: Optional[Iterable[str]]) -> List[TopicTable]:
    """Return the tables whose messages lie by time; those under names have no age."""
    tables = catalog.tables(topics)
    named = sorted({table.metadata.topic for table in tables if table.named})
    if topics is not None and named:
        raise InvalidOption(
            f"messages of topic {named[0]} are kept under names, and not by time: delete those "
            "that are not wanted any more by themselves"
        )
    return [table for table in tables if not table.named]


class _Work:
    """Applies rules to tables.

    Attributes:
        cutoff: What lies before is dropped, ns, where it is not pinned.
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

    def table(self, table: TopicTable, found: Retained) -> None:
        """Drop and thin the messages of one table."""
        pins = self._pins.of(table)
        for gap in _gaps(pins, 0, self.cutoff - 1):
            found.dropped += delete_of_table(self._space, table, gap, EVERYBODY, self._dry_run)
        if self._thin_end > self.cutoff:
            # Before it is read: what somebody adds among it later stays.
            until_us = self._space.cassandra.server_time_us()
            last: _Periods = {}
            for gap in _gaps(pins, self.cutoff, self._thin_end - 1):
                rows = self._rated(table, gap, last)
                found.thinned += (
                    sum(surplus for _, surplus in rows)
                    if self._dry_run
                    else thin_rows(self._space, rows, until_us)
                )

    # ---------------------------------------------------------------- size

    def _cutoff_of_size(self, tables: Sequence[TopicTable], most: int) -> int:
        """Find the time from which on the messages of all tables take at most so many bytes."""
        directory = self._space.directory
        every = [
            (table, row)
            for table in tables
            for row in settle(directory, table, buckets_of(directory, table))
            if row.rows
        ]
        every.sort(key=lambda each: -each[1].t_max)
        left, whole = most, LAST_NS
        for _, row in every:
            if row.bytes > left:
                whole = row.t_max + 1  # from here on all fits, also what lies before in its buckets
                break
            left -= row.bytes
        else:
            return 0
        newer = [(table, row) for table, row in every if row.t_max >= whole]
        taken = sum(row.bytes for _, row in newer if row.t_min >= whole)
        for table, row in newer:
            if row.t_min < whole:
                whose = Whose((row.node,), frozenset([row.writer]))
                part = self._bare([table], TimeRange(whole, row.t_max), whose)
                taken += sum(each.size for each in part)
        return self._further(tables, whole, most - taken)

    def _further(self, tables: Sequence[TopicTable], begin: int, left: int) -> int:
        """Go back from a time message by message, as long as so many bytes hold them."""
        for row in self._bare(tables, TimeRange(0, begin - 1), EVERYBODY, reverse=True):
            left -= row.size
            if left < 0:
                return row.t + 1
        return 0

    def _bare(
        self,
        tables: Sequence[TopicTable],
        time_range: TimeRange,
        whose: Whose = EVERYBODY,
        reverse: bool = False,
    ) -> Iterator[StoredRow]:
        """Read rows without their bytes."""
        read = self._space.rows.read
        return read(tables, time_range, whose=whose, reverse=reverse, columns=lambda table: ())

    # ---------------------------------------------------------------- what stays

    def _make_pins(self) -> _Pins:
        rules, end = self._rules, max(self.cutoff, self._thin_end)
        pins = _Pins()
        if rules.keep:
            reach = TimeRange(0, min(LAST_NS, end + rules.before))
            filters = self._catalog.filters(rules.keep, None, None)
            hits = heapq.merge(*(_times(each.rows(reach, bare=True)) for each in filters.values()))
            pieces = merge_windows(hits, rules.before, rules.after, TimeRange(), LAST_NS)
            pins.windows = list(joined(pieces))
        if self.cutoff and self._finder.latches:
            for low, high in [*pins.windows, TimeRange(self.cutoff, LAST_NS)]:
                for row in self._finder.before(low, high):
                    pins.latched.setdefault(row.table.name, set()).add(row.t)
        return pins

    # ---------------------------------------------------------------- rate

    def _rated(
        self, table: TopicTable, gap: TimeRange, last: _Periods
    ) -> Iterator[Tuple[StoredRow, bool]]:
        """Yield all messages, and which are too many: those of a period but a publisher's first.

        A latched message holds until the next one comes, however long that takes: none is left out.
        """
        for row in self._bare([table], gap):
            if self._finder.is_latched(row):
                yield row, False
                continue
            publisher, period = (row.node, row.conn), row.t // self._rules.period
            yield row, last.get(publisher) == period
            last[publisher] = period


def _times(rows: Iterable[StoredRow]) -> Iterator[int]:
    return (row.t for row in rows)


def _gaps(pins: Iterable[TimeRange], low: int, high: int) -> Iterator[TimeRange]:
    """Yield what lies between pins, which are in order, from low to high, both included."""
    for pin in pins:
        if pin.low > low and low <= high:
            yield TimeRange(low, min(high, pin.low - 1))
        low = max(low, pin.high + 1)
    if low <= high:
        yield TimeRange(low, high)
