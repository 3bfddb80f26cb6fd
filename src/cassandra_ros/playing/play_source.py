# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of one source of a stream: of all robots, of one robot, or of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import FrozenSet, Iterable, Iterator, Optional, Sequence

from cassandra_ros.keys import MAX_NS
from cassandra_ros.overview.latched_messages import (
    LatchedFinder,
    Publisher,
    Source,
    publisher_of,
    tests_of,
)
from cassandra_ros.playing.stored_ranges import StoredRange
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.row_finder import Filter, Where
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

Writers = Optional[FrozenSet[int]]
"""Writer ids; None = all, {0} = rows without a writer id."""


@dataclass(frozen=True)
class PlaySource:
    """The messages of the selected topics that one source has.

    Its times are shifted to the time line of the replay: the time ranges that its methods take
    and the times that they return are on that time line.
    """

    catalog: Catalog
    topics: Sequence[str]
    whose: Whose
    """nodeIDs and writer ids of its messages. The writer ids {0} mean rows that name no writer."""
    where: Conditions
    stored_ranges: Sequence[StoredRange]
    """Time ranges of reception in which it has messages."""
    chosen: TimeRange = TimeRange(0, MAX_NS)
    """Time range of reception; messages outside are left out."""
    begin: int = 0
    """Time of reception of its first selected message, ns; set by ``with_first_times``."""
    shift: int = 0
    """Difference that is added to times of reception, ns."""

    @property
    def known(self) -> TimeRange:
        """Time range from its first selected message to its last message.

        The last message need not satisfy the condition of its topic.
        """
        high = min(self.chosen.high, max(stored_range.last for stored_range in self.stored_ranges))
        return TimeRange(self.begin + self.shift, high + self.shift)

    def first(self) -> int | None:
        """Return the time of reception of its first selected message, ns; None = no message."""
        first = min(stored_range.first for stored_range in self.stored_ranges)
        if not self.where and self.chosen.low <= first <= self.chosen.high:
            return first
        row = next(self._stored(self.chosen), None)
        return None if row is None else row.received

    def rows(self, time_range: TimeRange) -> Iterator[tuple[int, StoredRow]]:
        """Yield its rows in a time range, each with its time."""
        inner = self._received(time_range)
        return ((row.received + self.shift, row) for row in self._stored(inner))

    def rows_noting_latched(
        self, time_range: TimeRange, sent: LatchedRecord
    ) -> Iterator[tuple[int, StoredRow]]:
        """Yield the rows as ``rows`` does, and record in ``sent`` the latched ones."""
        for t, row in self.rows(time_range):
            if self._finder.is_latched(row):
                sent.played(row)
            yield t, row

    def _received(self, time_range: TimeRange) -> TimeRange:
        """Return the times of reception of a time range of the replay."""
        low, high = time_range.low - self.shift, time_range.high - self.shift
        return TimeRange(max(0, low, self.chosen.low), min(high, self.chosen.high))

    def _stored(self, time_range: TimeRange) -> Iterator[StoredRow]:
        if time_range.low > time_range.high:
            return iter(())
        return self.catalog.read(
            self.topics, Read(time_range, self.whose), self.where, received=True
        )

    def hits(self, topic: str, condition: Where, time_range: TimeRange) -> Iterator[int]:
        """Yield the times of the messages of a topic that satisfy a condition, ns."""
        inner, stored_topic = self._received(time_range), self.catalog.get(topic)
        if inner.low > inner.high:
            return iter(())
        read = Read(inner, self.whose)
        if any(table.metadata.own_time or table.named for table in stored_topic.tables):
            rows = self.catalog.read([topic], read, {topic: condition}, received=True)
        else:
            rows = Filter(stored_topic, condition, self.whose).rows(read, bare=True)
        return (row.received + self.shift for row in rows)

    @cached_property
    def _tables(self) -> list[TopicTable]:
        return list({e.table.name: e.table for e in self.stored_ranges}.values())

    @cached_property
    def _finder(self) -> LatchedFinder:
        tests = tests_of(self.catalog, self.where, self.whose)
        return LatchedFinder(self.catalog.keyspace, self._tables, self.whose, tests)

    def latched(
        self, window: TimeRange, sent: LatchedRecord | None = None
    ) -> list[tuple[int, StoredRow]]:
        """Return the messages latched before a window, in order of reception: time and row."""
        low, high = window.low - self.shift, window.high - self.shift
        if low <= min(stored_range.first for stored_range in self.stored_ranges):
            return []  # the source has no earlier message
        if sent is None:
            rows = self._finder.before(low, high)
        else:
            rows = sent.changes(self._finder, low, high)
        return [(row.received + self.shift, row) for row in rows]


def with_first_times(sources: Iterable[PlaySource]) -> list[PlaySource]:
    """Set the time of the first selected message of each source; leave out sources without one."""
    firsts = ((source, source.first()) for source in sources)
    return [replace(source, begin=first) for source, first in firsts if first is not None]


class LatchedRecord:
    """The latched messages of one source that were played already."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, Publisher], tuple[int, str, int, str]] = {}
        self._looked: dict[Source, int] = {}
        """For each robot and writer the time up to which latched messages were searched for, ns."""

    def changes(self, finder: LatchedFinder, low: int, high: int) -> list[StoredRow]:
        """Return the messages latched before ``low`` and not played yet; record them as played."""
        if not finder.latches:
            return []
        sources = finder.sources(low, high)
        since = min((self._looked.get(source, 0) for source in sources), default=low)
        rows = [row for row in finder.of_sources(sources, low, since) if self._is_new(row)]
        for row in rows:
            self.played(row)
        self._looked.update(dict.fromkeys(sources, low))
        return rows

    def _is_new(self, row: StoredRow) -> bool:
        last = self._last.get((row.table.name, publisher_of(row)))
        return last is None or last < row.arrival

    def played(self, row: StoredRow) -> None:
        """Record a message as played."""
        self._last[row.table.name, publisher_of(row)] = row.arrival
