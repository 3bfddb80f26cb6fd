# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Timelines: for each topic and robot the numbers of messages in cells of time, gaps, and runs.

A timeline is drawn from the directory, so it takes as long for a thousand million messages as for a
thousand. If a bucket covers several cells, its messages are spread over them evenly. A request for
detail also reads keys of messages, up to a limit.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.read import EVERYBODY, Whose
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.timeline.bucket_detail import refined
from cassandra_ros.topics.overview.timeline.directory_reader import DirectoryReader, Ends
from cassandra_ros.topics.overview.timeline.range_counts import (
    MessageKeys,
    RangeCounts,
    named_pieces,
)
from cassandra_ros.topics.overview.timeline.time_cells import (
    Longs,
    Scale,
    TimeCells,
    TimeRanges,
    gaps_between,
    gaps_in,
)
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.topic_table import TopicTable

MAX_RUNS = 2000
"""Maximum number of runs in a picture."""
ERA_GAP_NS = 10 * 365 * 86_400 * SECOND_NS
"""Minimum time without a message between two eras, ns: ten years."""
_DAY_NS = 86_400 * SECOND_NS
_LEAST_PERIOD_NS = 600 * SECOND_NS
"""Minimum length that a period counts for, ns: messages of a moment are seen, too."""
_EMPTY_PER_FULL = 300
"""Minimum ratio of the time between two periods to the length of all of them. A picture of 1,000
pixels over a longer pause has some three pixels for everything that is stored."""


@dataclass(frozen=True)
class View:
    """Time range, topics and resolution of a timeline."""

    start: int | None = None
    """First time, ns since 1970, included; None = that of the first message."""
    end: int | None = None
    """Last time, ns since 1970, included; None = that of the last message."""
    cells: int = 1000
    """Maximum number of cells, 1 to MAX_CELLS."""
    topics: Sequence[str] | None = None
    """Names of topics; None = all."""
    whose: Whose = EVERYBODY
    detail: bool = False
    """Whether keys are read if buckets are longer than cells."""


class Lane:
    """What is stored of one topic by one robot in a time range.

    Args:
        tables: Tables of the topic.
        pieces: Counts of the messages in these tables.
        ends: First and last time of the range, ns.
    """

    def __init__(
        self,
        topic: str,
        node: str,
        tables: Sequence[TopicTable],
        pieces: Sequence[RangeCounts],
        ends: Ends,
    ) -> None:
        self.topic, self.node, self.tables = topic, node, tables
        ranges = TimeRanges.joined([piece.time_ranges for piece in pieces])
        self.time_ranges = ranges.within(*ends)
        keys = MessageKeys.joined([piece.keys for piece in pieces])
        inside = (keys.times >= ends[0]) & (keys.times <= ends[1])
        self.keys = keys.where(inside)
        self.sampled = any(piece.sampled for piece in pieces)
        self.writing = any(piece.writing for piece in pieces)
        self._ends = ends

    @property
    def key(self) -> tuple[str, str]:
        """Robot and topic."""
        return self.node, self.topic

    @property
    def times(self) -> tuple[int | None, int | None]:
        """Times of the first and the last message, ns; None if there is no message."""
        firsts = [int(t.min()) for t in (self.time_ranges.first, self.keys.times) if len(t)]
        lasts = [int(t.max()) for t in (self.time_ranges.last, self.keys.times) if len(t)]
        return min(firsts, default=None), max(lasts, default=None)

    @property
    def spans(self) -> list[tuple[Longs, Longs, Longs]]:
        """First and last times, ns, and counts of the time ranges and of the single messages."""
        times = self.keys.times
        columns = self.time_ranges[:3], (times, times, np.ones(len(times), np.int64))
        return [(first, last, counts) for first, last, counts in columns if len(first)]

    @property
    def messages(self) -> int:
        """Number of messages in the range; see ``exact``."""
        return self._sum(self.time_ranges.messages) + len(self.keys.times)

    @property
    def bytes(self) -> int:
        """Number of serialised bytes of these messages."""
        return self._sum(self.time_ranges.bytes) + int(self.keys.sizes.sum())

    @property
    def exact(self) -> bool:
        """Whether messages and bytes are exact; otherwise they are estimates."""
        whole = (self.time_ranges.shares(*self._ends) == 1.0) & self.time_ranges.sure
        return bool(whole.all()) and not self.sampled

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of a writer while it was sending, Hz.

        Pauses between its buckets do not count.
        """
        ranges = self.time_ranges
        covered_ns = int((ranges.last - ranges.first)[ranges.messages > 1].sum())
        steps = int(np.maximum(ranges.messages - 1, 0).sum())
        if not covered_ns and len(self.keys.times) > 1:
            covered_ns = int(self.keys.times.max() - self.keys.times.min())
            steps = len(self.keys.times) - 1
        return steps * SECOND_NS / covered_ns if covered_ns else None

    def _sum(self, counts: Longs) -> int:
        """Return the sum of counts of the time ranges, by their shares in the range of the lane."""
        return round(float((counts * self.time_ranges.shares(*self._ends)).sum()))

    def cells(self, scale: Scale) -> TimeCells:
        """Return the number of messages in each cell."""
        cells = TimeCells(scale)
        cells.add(self.time_ranges)
        cells.add_times(self.keys.times)
        return cells

    def gaps(self, scale: Scale) -> list[tuple[int, int]]:
        """Return first and last times of the unusual pauses of runs, ns."""
        gaps = [] if self.sampled else gaps_between(self.time_ranges, scale)
        for writer in np.unique(self.keys.writers):
            gaps += gaps_in(self.keys.times[self.keys.writers == writer], scale)
        return sorted(gaps)


class RunSpan(NamedTuple):
    """The messages of a run in a lane, by their first and last time, ns."""

    writer: int
    node: str
    first: int
    last: int
    messages: int


class Period(NamedTuple):
    """A time range with messages, between long pauses."""

    start: int
    """Time of its first message, ns."""
    end: int
    """Time of its last message, ns."""
    messages: int
    """Number of its messages, as accurate as the picture."""


class Picture(NamedTuple):
    """A timeline that was drawn."""

    extent: Ends | None
    """Times of the first and the last of all selected messages, ns; None = no messages. Messages
    with names count only if no others are selected."""
    scale: Scale | None
    """Cells of the time range; None = there is no time range."""
    lanes: list[Lane]
    """Lanes by robot and topic, also without messages in the range. If all messages lie in it,
    robots whose messages were all deleted have none."""
    named: bool = False
    """Whether the extent is that of messages with names."""

    @property
    def eras(self) -> list[Ends]:
        """Time ranges of messages, in order, with ten years or more between two of them.

        A clock that was not set begins in 1970, which makes two eras.
        """
        return [(period.start, period.end) for period in self._divided(ERA_GAP_NS)]

    @property
    def periods(self) -> list[Period]:
        """Time ranges of messages, in order, with so long pauses that one picture shows nothing.

        The time between two of them is a day at least, and ten years, or 300 times as long as all
        days with messages.
        """
        covered = sum(
            max(period.end - period.start, _LEAST_PERIOD_NS) for period in self._divided(_DAY_NS)
        )
        return self._divided(min(ERA_GAP_NS, max(_DAY_NS, _EMPTY_PER_FULL * covered)))

    def _divided(self, gap_ns: int) -> list[Period]:
        """Divide the messages at each time of this length, or longer, without a message."""
        spans = [columns for lane in self.lanes for columns in lane.spans]
        if not spans:
            return []
        firsts, lasts, messages = (np.concatenate(columns) for columns in zip(*spans))
        order = np.argsort(firsts)
        # The last time of all time ranges so far, in the order of their first times.
        firsts, reached = firsts[order], np.maximum.accumulate(lasts[order])
        later = np.flatnonzero(firsts[1:] - reached[:-1] >= gap_ns) + 1
        if self.scale is not None:  # a time range may begin before the window or end after it
            firsts, reached = (np.clip(t, *self.scale[:2]) for t in (firsts, reached))
        starts, ends = [0, *later.tolist()], [*(later - 1).tolist(), len(firsts) - 1]
        counts = np.add.reduceat(messages[order], starts)
        return [
            Period(int(firsts[low]), int(reached[high]), int(count))
            for low, high, count in zip(starts, ends, counts)
        ]

    @property
    def runs(self) -> list[RunSpan]:
        """Runs with messages in the range, by their first; at most the MAX_RUNS longest."""
        spans: dict[tuple[str, int], RunSpan] = {}
        for lane in self.lanes:
            for span in _spans(lane):
                key = span.node, span.writer
                spans[key] = _join(spans[key], span) if key in spans else span
        longest = sorted(spans.values(), key=lambda span: span.first - span.last)[:MAX_RUNS]
        return sorted(longest, key=lambda span: (span.first, span.last, span.writer))


def _spans(lane: Lane) -> list[RunSpan]:
    """Return the runs that have messages in a lane."""
    ranges, keys = lane.time_ranges, lane.keys
    first = np.concatenate([ranges.first, keys.times])
    last = np.concatenate([ranges.last, keys.times])
    messages = np.concatenate([ranges.messages, np.ones(len(keys.times), np.int64)])
    writers = np.concatenate([ranges.writer, keys.writers])
    unique_writers, place = np.unique(writers, return_inverse=True)
    lows, highs = np.full(len(unique_writers), 2**63 - 1), np.full(len(unique_writers), -(2**63))
    np.minimum.at(lows, place, first)
    np.maximum.at(highs, place, last)
    counts = np.bincount(place, messages, len(unique_writers))
    rows = zip(unique_writers.tolist(), lows.tolist(), highs.tolist(), counts.tolist())
    # Estimates for partitions that were not read have no writer: 0.
    return [RunSpan(w, lane.node, low, high, int(n)) for w, low, high, n in rows if w]


def _join(one: RunSpan, other: RunSpan) -> RunSpan:
    """Return the messages of a run in two lanes together."""
    first, last = min(one.first, other.first), max(one.last, other.last)
    return RunSpan(one.writer, one.node, first, last, one.messages + other.messages)


class Timeline:
    """Draws timelines of one keyspace. Thread-safe.

    Args:
        catalog: Topics of the keyspace; it is only read.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._reader = DirectoryReader(catalog.keyspace.directory)

    def picture(self, view: View, gone: threading.Event | None = None) -> Picture:
        """Draw a timeline.

        Args:
            gone: Set when the client has gone; then no more keys are read.

        Raises:
            TopicNotFound: A topic is not stored.
            InvalidOption: The number of cells is 0 or too large, or start is later than end.
        """
        names = view.topics
        topics = self._catalog.all(None) if names is None else map(self._catalog.get, names)
        tables = {table.name: table for topic in topics for table in topic.tables}
        gone = threading.Event() if gone is None else gone
        return followed(list(tables.values()), lambda now: self._picture(now, view, gone))

    def ends(self) -> Ends | None:
        """Return the times of the first and the last message, ns; None = no message."""
        return self._reader.extent(self._catalog.tables(None), EVERYBODY)

    def _picture(self, tables: Sequence[TopicTable], view: View, gone: threading.Event) -> Picture:
        named = [
            piece for table in tables if table.named for piece in named_pieces(table, view.whose)
        ]
        # Maps with names do not count: one stored today for a recording of last year would leave
        # the recording a single pixel.
        timed_extent = self._reader.extent(tables, view.whose)
        extent = timed_extent or _extent(named)
        ends = window_of(view, extent)
        if ends is None:
            return Picture(None, None, self._lanes(tables, [], view.whose, (0, 0), whole=True))
        scale = Scale.over(*ends, view.cells)
        pieces = self._reader.pieces(tables, ends, view.whose)
        if view.detail:
            pieces = refined(pieces, scale, view.whose, gone)
        whole = extent is None or (ends[0] <= extent[0] and extent[1] <= ends[1])
        lanes = self._lanes(tables, [*pieces, *named], view.whose, ends, whole)
        return Picture(extent, scale, lanes, timed_extent is None)

    def _lanes(
        self,
        tables: Sequence[TopicTable],
        pieces: Sequence[RangeCounts],
        whose: Whose,
        ends: Ends,
        whole: bool,
    ) -> list[Lane]:
        """Return the lanes of tables, one for each robot that has messages in them.

        Args:
            whole: Whether all messages lie in the range. Otherwise there are also lanes of robots
                that had messages, which may have been deleted.
        """
        slots = self._reader.slots(tables)
        of_table: dict[str, list[RangeCounts]] = {}
        for piece in pieces:
            of_table.setdefault(piece.table.name, []).append(piece)
        lanes: dict[tuple[str, str], tuple[list[TopicTable], list[RangeCounts]]] = {}
        listed: set[tuple[str, str]] = set()
        """Robot and topic of the lanes that had messages once, by the directory."""
        for table in tables:
            listed_nodes = {node for _, node in slots.get(table.name, [])}
            table_pieces = of_table.get(table.name, [])
            nodes = listed_nodes | {piece.node for piece in table_pieces}
            nodes = nodes or {table.metadata.nodeID}
            if whose.nodes is not None:
                nodes = nodes.intersection(whose.nodes)
            for node in nodes:
                lane_tables, lane_pieces = lanes.setdefault((node, table.metadata.topic), ([], []))
                lane_tables.append(table)
                lane_pieces.extend(piece for piece in table_pieces if piece.node == node)
            listed.update((node, table.metadata.topic) for node in listed_nodes)
        all_lanes = [Lane(topic, node, *lanes[node, topic], ends) for node, topic in sorted(lanes)]
        if whose.writers is not None:
            return [lane for lane in all_lanes if lane.times[0] is not None]
        if not whole:
            return all_lanes
        shown = [lane for lane in all_lanes if lane.times[0] is not None or lane.key not in listed]
        topics = {lane.topic for lane in shown}
        if whose.nodes is None:  # a topic without messages is shown too, without its robots
            bare_topics = {
                lane.topic: lane.tables for lane in all_lanes if lane.topic not in topics
            }
            shown += [Lane(topic, "", tables, [], ends) for topic, tables in bare_topics.items()]
        return sorted(shown, key=lambda lane: lane.key)


def _extent(named: Sequence[RangeCounts]) -> Ends | None:
    """Return the first and the last time of messages with names, ns; None without messages."""
    times = MessageKeys.joined([piece.keys for piece in named]).times
    return (int(times.min()), int(times.max())) if len(times) else None


def window_of(view: View, extent: Ends | None) -> Ends | None:
    """Return the range to draw; an open end is never on the wrong side of the other end.

    None: both ends are open, and there are no messages.
    """
    start, end = view.start, view.end
    if start is None:
        low = extent[0] if extent else end
        start = low if low is None or end is None else min(low, end)
    if end is None:
        high = extent[1] if extent else start
        end = high if high is None or start is None else max(high, start)
    return None if start is None or end is None else (start, end)
