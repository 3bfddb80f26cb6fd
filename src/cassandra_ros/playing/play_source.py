# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of one source of a stream: of all robots, of one robot, or of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Iterable, Iterator, Sequence

from cassandra_ros.keys import MAX_NS
from cassandra_ros.playing.played_store import PlayedRow, PlayedStore
from cassandra_ros.playing.stored_ranges import StoredRange
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.topics.catalog import Conditions
from cassandra_ros.topics.event_times import EventTimes, Reads
from cassandra_ros.topics.overview.latched_messages import Latched, LatchedRecord
from cassandra_ros.topics.row_finder import Where


@dataclass(frozen=True)
class PlaySource:
    """The messages of the selected topics that one source has.

    Its times are shifted to the time line of the replay: the time ranges that its methods take
    and the times that they return are on that time line.
    """

    store: PlayedStore
    topics: Sequence[str]
    whose: Whose
    """nodeIDs and writer ids of its messages. The writer ids {0} mean rows that name no writer."""
    where: Conditions
    stored_ranges: Sequence[StoredRange]
    """Time ranges of reception in which it has messages."""
    chosen: TimeRange = TimeRange(0, MAX_NS)
    """Time range of reception; messages outside are left out."""
    begin: int = 0
    """Time of reception of its first selected message, ns, without ``shift``; set by
    ``with_first_times``."""
    shift: int = 0
    """Difference that is added to times of reception, ns."""
    times: EventTimes | None = None
    """Times of the events during which messages are selected; None = at any time."""

    @property
    def time_range(self) -> TimeRange:
        """Time range from its first selected message to its last message.

        The last message need not satisfy the condition of its topic. It needs ``begin``.
        """
        high = min(self.chosen.high, max(stored_range.last for stored_range in self.stored_ranges))
        return TimeRange(self.begin + self.shift, high + self.shift)

    def first(self) -> int | None:
        """Return the time of reception of its first selected message, ns; None = no message."""
        # Without conditions the first stored message is it, and no row is read.
        first = min(stored_range.first for stored_range in self.stored_ranges)
        if not self.where and self.times is None and self.chosen.low <= first <= self.chosen.high:
            return first
        row = next(self._stored_rows(self.chosen), None)
        return None if row is None else row.received

    def rows(self, time_range: TimeRange) -> Iterator[tuple[int, PlayedRow]]:
        """Yield its rows in a time range, each with its time."""
        inner = self._receive_times(time_range)
        return ((row.received + self.shift, row) for row in self._stored_rows(inner))

    def rows_noting_latched(
        self, time_range: TimeRange, sent: LatchedRecord
    ) -> Iterator[tuple[int, PlayedRow]]:
        """Yield the rows as ``rows`` does, and record in ``sent`` the latched ones as given."""
        for t, row in self.rows(time_range):
            if self._finder.is_latched(row):
                sent.note(row)
            yield t, row

    def _receive_times(self, time_range: TimeRange) -> TimeRange:
        """Return a time range of the replay as times of reception, cut off at the chosen ones.

        It may be empty: then the first time is after the last one.
        """
        low, high = time_range.low - self.shift, time_range.high - self.shift
        return TimeRange(max(0, low, self.chosen.low), min(high, self.chosen.high))

    def _stored_rows(self, time_range: TimeRange) -> Iterator[PlayedRow]:
        """Yield its rows in a time range of reception."""
        if time_range.low > time_range.high:
            return iter(())
        whole = Read(time_range, self.whose)
        reads = [whole] if self.times is None else self.times.reads(whole)
        return self.store.rows(self.topics, Reads(whole, reads), self.where)

    def events(self, time_range: TimeRange) -> Iterator[TimeRange]:
        """Yield the time ranges of its events in a time range, in order."""
        low, high = self._receive_times(time_range)
        spans = () if self.times is None else self.times.spans(low, high)
        return (TimeRange(a + self.shift, b + self.shift) for a, b in spans)

    def hits(self, topic: str, condition: Where, time_range: TimeRange) -> Iterator[int]:
        """Yield the times of the messages of a topic that satisfy a condition, ns.

        The topic need not be one of those that are played.
        """
        inner = self._receive_times(time_range)
        if inner.low > inner.high:
            return iter(())
        rows = self.store.hits(topic, condition, Read(inner, self.whose))
        return (row.received + self.shift for row in rows)

    @cached_property
    def _finder(self) -> Latched[PlayedRow]:
        """Finder of its latched messages; made once, because it reads the connections."""
        return self.store.latched(self.topics, self.whose, self.where)

    def latched(
        self, window: TimeRange, sent: LatchedRecord | None = None
    ) -> list[tuple[int, PlayedRow]]:
        """Return the messages latched before a window, in order of reception: time and row.

        Args:
            sent: The messages that were given already, which are left out; the others are recorded
                there. None = all are returned.
        """
        low, high = window.low - self.shift, window.high - self.shift
        if low <= min(stored_range.first for stored_range in self.stored_ranges):
            return []  # the source has no earlier message
        finder = self._finder
        rows = finder.before(low, high) if sent is None else sent.changes(finder, low, high)
        return [(row.received + self.shift, row) for row in rows]


def with_first_times(sources: Iterable[PlaySource]) -> list[PlaySource]:
    """Set the time of the first selected message of each source; leave out sources without one."""
    firsts = ((source, source.first()) for source in sources)
    return [replace(source, begin=first) for source, first in firsts if first is not None]
