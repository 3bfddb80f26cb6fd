# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of one source of a stream: of everybody, of one node, or of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import FrozenSet, Iterable, Iterator, List, Optional, Sequence, Tuple

from cassandra_ros.arguments import check_nodes
from cassandra_ros.keys import MAX_NS
from cassandra_ros.overview.latched_messages import (
    LatchedFinder,
    Publisher,
    Source,
    publisher_of,
    tests_of,
)
from cassandra_ros.playing.extent import Extent
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.row_finder import Filter, Where
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

Writers = Optional[FrozenSet[int]]


@dataclass(frozen=True)
class Part:
    """What one source has of the chosen topics; its times are shifted onto those of the replay.

    Stretches that its methods take, and times that they return, are the replay's.
    """

    catalog: Catalog
    topics: Sequence[str]
    node: Optional[str]
    """None = of all nodes."""
    writers: Writers
    """Writer ids; None = all, {0} = rows that name none."""
    where: Conditions
    extents: Sequence[Extent]
    """From when to when it has messages, by their times of reception."""
    chosen: TimeRange = TimeRange(0, MAX_NS)
    """Only messages that were received in it."""
    begin: int = 0
    """When its first chosen message was received, ns; ``begun`` finds it."""
    shift: int = 0
    """What is added to times of reception, ns."""

    @property
    def known(self) -> TimeRange:
        """From its first chosen message to its last one, which may satisfy no condition."""
        high = min(self.chosen.high, max(extent.last for extent in self.extents))
        return TimeRange(self.begin + self.shift, high + self.shift)

    def first(self) -> Optional[int]:
        """Return when its first chosen message was received, None where there is none."""
        first = min(extent.first for extent in self.extents)
        if not self.where and self.chosen.low <= first <= self.chosen.high:
            return first
        row = next(self._stored(self.chosen), None)
        return None if row is None else row.received

    def rows(self, time_range: TimeRange) -> Iterator[Tuple[int, StoredRow]]:
        """Walk lazily through its rows in a stretch: time and row."""
        inner = self._received(time_range)
        return ((row.received + self.shift, row) for row in self._stored(inner))

    def noted(self, time_range: TimeRange, sent: Sent) -> Iterator[Tuple[int, StoredRow]]:
        """Walk through the rows as ``rows`` does, and note which latched ones are played."""
        for t, row in self.rows(time_range):
            if self._finder.is_latched(row):
                sent.played(row)
            yield t, row

    def _received(self, time_range: TimeRange) -> TimeRange:
        """Return the times of reception that a stretch means."""
        low, high = time_range.low - self.shift, time_range.high - self.shift
        return TimeRange(max(0, low, self.chosen.low), min(high, self.chosen.high))

    def _stored(self, time_range: TimeRange) -> Iterator[StoredRow]:
        if time_range.low > time_range.high:
            return iter(())
        return self.catalog.read(
            self.topics,
            *time_range,
            node=self.node,
            received=True,
            where=self.where,
            run=self.writers,
        )

    def hits(self, topic: str, condition: Where, time_range: TimeRange) -> Iterator[int]:
        """Walk lazily through the times of the messages of a topic that satisfy a condition."""
        inner, found = self._received(time_range), self.catalog.get(topic)
        if inner.low > inner.high:
            return iter(())
        if any(table.metadata.own_time or table.named for table in found.tables):
            where = {topic: condition}
            rows = self.catalog.read(
                [topic], *inner, node=self.node, received=True, where=where, run=self.writers
            )
        else:
            whose = Whose.of(self.node, self.writers)
            rows = Filter(found, condition, whose).rows(Read(inner, whose), bare=True)
        return (row.received + self.shift for row in rows)

    @cached_property
    def _tables(self) -> List[TopicTable]:
        return list({e.table.name: e.table for e in self.extents}.values())

    @cached_property
    def _finder(self) -> LatchedFinder:
        tests = tests_of(self.catalog, self.where, self.node)
        nodes = check_nodes(self.node)
        return LatchedFinder(self.catalog.keyspace, self._tables, nodes, self.writers, tests)

    def latched(
        self, window: TimeRange, sent: Optional[Sent] = None
    ) -> List[Tuple[int, StoredRow]]:
        """List what was latched before a window, in the order of reception: time and row."""
        low, high = window.low - self.shift, window.high - self.shift
        if low <= min(extent.first for extent in self.extents):
            return []  # nothing was there yet
        if sent is None:
            found = self._finder.before(low, high)
        else:
            found = sent.changes(self._finder, low, high)
        return [(row.received + self.shift, row) for row in found]


def begun(parts: Iterable[Part]) -> List[Part]:
    """Find when the first chosen message of each part was received; those without are left out."""
    firsts = ((part, part.first()) for part in parts)
    return [replace(part, begin=first) for part, first in firsts if first is not None]


class Sent:
    """What of latched messages was played already, of one part: only what is newer is new."""

    def __init__(self) -> None:
        self._last: dict[Tuple[str, Publisher], Tuple[int, str, int, str]] = {}
        self._looked: dict[Source, int] = {}
        """Until when each run's latched messages are played, as far as they are known here."""

    def changes(self, finder: LatchedFinder, low: int, high: int) -> List[StoredRow]:
        """List what was latched before low and not played, and note it as played."""
        if not finder.latches:
            return []
        sources = finder.sources(low, high)
        since = min((self._looked.get(source, 0) for source in sources), default=low)
        found = [row for row in finder.of_sources(sources, low, since) if self._is_new(row)]
        for row in found:
            self.played(row)
        self._looked.update(dict.fromkeys(sources, low))
        return found

    def _is_new(self, row: StoredRow) -> bool:
        last = self._last.get((row.table.name, publisher_of(row)))
        return last is None or last < row.arrival

    def played(self, row: StoredRow) -> None:
        """Note a message as played."""
        self._last[row.table.name, publisher_of(row)] = row.arrival
