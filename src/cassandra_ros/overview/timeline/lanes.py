# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A timeline: of each topic and node how many messages lie in which cells, its gaps, its runs.

It is drawn of the directory, so it takes as long for a thousand million messages as for a thousand.
Where a bucket covers several cells its messages are spread evenly over them; who wants to know more
asks for detail, and as many keys of messages are read as a bound allows.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.overview.timeline.bucket_detail import refined
from cassandra_ros.overview.timeline.directory_reader import Ends, Reader
from cassandra_ros.overview.timeline.range_counts import Keys, Piece, named_pieces
from cassandra_ros.overview.timeline.time_cells import (
    Cells,
    Longs,
    Scale,
    TimeRanges,
    gaps_between,
    gaps_in,
)
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.key_selection import EVERYBODY, Whose
from cassandra_ros.topics.replaced_tables import followed
from cassandra_ros.topics.topic_table import TopicTable

MAX_RUNS = 2000
ERA_GAP_NS = 10 * 365 * 86_400 * SECOND_NS
"""Shortest time without a message that divides two eras, ns: ten years."""


@dataclass(frozen=True)
class View:
    """What is to be drawn."""

    start: Optional[int] = None
    """ns since 1970, included; None = of the first message."""
    end: Optional[int] = None
    """ns since 1970, included; None = of the last message."""
    cells: int = 1000
    """At most so many, 1 to MAX_CELLS."""
    topics: Optional[Sequence[str]] = None
    """None = all."""
    whose: Whose = EVERYBODY
    detail: bool = False
    """Read keys where buckets are longer than cells."""


class Lane:
    """What is stored of a topic by a node, as far as it touches a window.

    Args:
        tables: In which it lies.
        pieces: What is known of it.
        ends: Of the window, ns.
    """

    def __init__(
        self,
        topic: str,
        node: str,
        tables: Sequence[TopicTable],
        pieces: Sequence[Piece],
        ends: Ends,
    ) -> None:
        self.topic, self.node, self.tables = topic, node, tables
        joined = TimeRanges.joined([piece.time_ranges for piece in pieces])
        self.time_ranges = joined.within(*ends)
        keys = Keys.joined([piece.keys for piece in pieces])
        inside = (keys.times >= ends[0]) & (keys.times <= ends[1])
        self.keys = keys.where(inside)
        self.sampled = any(piece.sampled for piece in pieces)
        self.writing = any(piece.writing for piece in pieces)
        self._ends = ends

    @property
    def times(self) -> Tuple[Optional[int], Optional[int]]:
        """When the first and the last message come that touch the window; None: there is none."""
        firsts = [
            int(each.min()) for each in (self.time_ranges.first, self.keys.times) if len(each)
        ]
        lasts = [int(each.max()) for each in (self.time_ranges.last, self.keys.times) if len(each)]
        return min(firsts, default=None), max(lasts, default=None)

    @property
    def parts(self) -> List[Tuple[Longs, Longs]]:
        """When stretches and single messages that touch the window begin and end, ns."""
        every = (self.time_ranges.first, self.time_ranges.last), (self.keys.times, self.keys.times)
        return [part for part in every if len(part[0])]

    @property
    def messages(self) -> int:
        """How many lie in the window; see exact."""
        return self._sum(self.time_ranges.messages) + len(self.keys.times)

    @property
    def bytes(self) -> int:
        """Serialised bytes of these."""
        return self._sum(self.time_ranges.bytes) + int(self.keys.sizes.sum())

    @property
    def exact(self) -> bool:
        """Whether these are no estimates."""
        whole = (self.time_ranges.shares(*self._ends) == 1.0) & self.time_ranges.sure
        return bool(whole.all()) and not self.sampled

    @property
    def rate_hz(self) -> Optional[float]:
        """Mean rate while messages came, a writer's: pauses between its buckets do not count."""
        each = self.time_ranges
        covered_ns = int((each.last - each.first)[each.messages > 1].sum())
        steps = int(np.maximum(each.messages - 1, 0).sum())
        if not covered_ns and len(self.keys.times) > 1:
            covered_ns = int(self.keys.times.max() - self.keys.times.min())
            steps = len(self.keys.times) - 1
        return steps * SECOND_NS / covered_ns if covered_ns else None

    def _sum(self, counts: Longs) -> int:
        return round(float((counts * self.time_ranges.shares(*self._ends)).sum()))

    def cells(self, scale: Scale) -> Cells:
        """Return how many messages lie in each cell."""
        cells = Cells(scale)
        cells.add(self.time_ranges)
        cells.add_times(self.keys.times)
        return cells

    def gaps(self, scale: Scale) -> List[Tuple[int, int]]:
        """Return between which times a run had no message, where that is unusual."""
        found = [] if self.sampled else gaps_between(self.time_ranges, scale)
        for writer in np.unique(self.keys.writers):
            found += gaps_in(self.keys.times[self.keys.writers == writer], scale)
        return sorted(found)


class RunSpan(NamedTuple):
    """What a run stored that touches the window, by the times of its messages, ns."""

    writer: int
    node: str
    first: int
    last: int
    messages: int


class Picture(NamedTuple):
    """What is to be seen in a window."""

    extent: Optional[Ends]
    """When the first and the last message come of all that is chosen; None: there is none. Of what
    lies under names it is told only where nothing else is chosen."""
    scale: Optional[Scale]
    """None: there is no window."""
    lanes: List[Lane]
    """By node and topic, also of what has nothing in the window."""

    @property
    def eras(self) -> List[Ends]:
        """The times in which messages lie, in their order, with ten years or more between two.

        A clock that was not set makes two of them: it begins in 1970.
        """
        parts = [part for lane in self.lanes for part in lane.parts]
        if not parts:
            return []
        firsts, lasts = (np.concatenate(ends) for ends in zip(*parts))
        order = np.argsort(firsts)
        firsts, reached = firsts[order], np.maximum.accumulate(lasts[order])
        later = np.flatnonzero(firsts[1:] - reached[:-1] >= ERA_GAP_NS) + 1
        if self.scale is not None:  # a stretch may begin before the window, or end after it
            firsts, reached = (np.clip(t, *self.scale[:2]) for t in (firsts, reached))
        starts, ends = [0, *later.tolist()], [*(later - 1).tolist(), len(firsts) - 1]
        return [(int(firsts[low]), int(reached[high])) for low, high in zip(starts, ends)]

    @property
    def runs(self) -> List[RunSpan]:
        """Whatever stored messages in the window, by their first; at most MAX_RUNS, the longest."""
        found: Dict[Tuple[str, int], RunSpan] = {}
        for lane in self.lanes:
            for span in _spans(lane):
                key = span.node, span.writer
                found[key] = _joined(found[key], span) if key in found else span
        longest = sorted(found.values(), key=lambda span: span.first - span.last)[:MAX_RUNS]
        return sorted(longest, key=lambda span: (span.first, span.last, span.writer))


def _spans(lane: Lane) -> List[RunSpan]:
    s, keys = lane.time_ranges, lane.keys
    ones = np.ones(len(keys.times), np.int64)
    first, last = (np.concatenate([each, keys.times]) for each in (s.first, s.last))
    messages, writers = (
        np.concatenate(pair) for pair in ((s.messages, ones), (s.writer, keys.writers))
    )
    every, place = np.unique(writers, return_inverse=True)
    lows, highs = np.full(len(every), 2**63 - 1), np.full(len(every), -(2**63))
    np.minimum.at(lows, place, first)
    np.maximum.at(highs, place, last)
    counts = np.bincount(place, messages, len(every))
    rows = zip(every.tolist(), lows.tolist(), highs.tolist(), counts.tolist())
    # Of what stands for others, which were not read, the writer is unknown: 0.
    return [RunSpan(w, lane.node, low, high, int(n)) for w, low, high, n in rows if w]


def _joined(one: RunSpan, other: RunSpan) -> RunSpan:
    first, last = min(one.first, other.first), max(one.last, other.last)
    return RunSpan(one.writer, one.node, first, last, one.messages + other.messages)


class Timeline:
    """Draws what is stored of one keyspace. Thread-safe.

    Args:
        catalog: The topics of the keyspace; only read.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._reader = Reader(catalog.keyspace.directory)

    def picture(self, view: View, gone: Optional[threading.Event] = None) -> Picture:
        """Draw what is to be seen.

        Args:
            gone: Once it is set nobody waits for the answer: no further keys are read.

        Raises:
            TopicNotFound: A topic is not stored.
            InvalidOption: There are too many cells, or none; start lies behind end.
        """
        names = view.topics
        topics = self._catalog.all(None) if names is None else map(self._catalog.get, names)
        tables = {table.name: table for topic in topics for table in topic.tables}
        gone = threading.Event() if gone is None else gone
        return followed(list(tables.values()), lambda now: self._picture(now, view, gone))

    def _picture(self, tables: Sequence[TopicTable], view: View, gone: threading.Event) -> Picture:
        named = [
            piece for table in tables if table.named for piece in named_pieces(table, view.whose)
        ]
        # A map that is stored today of a recording of last year would leave little to be seen.
        extent = self._reader.extent(tables, view.whose) or _extent(named)
        ends = _window(view, extent)
        if ends is None:
            return Picture(None, None, self._lanes(tables, [], view.whose, (0, 0)))
        scale = Scale.over(*ends, view.cells)
        pieces = self._reader.pieces(tables, ends, view.whose)
        if view.detail:
            pieces = refined(pieces, scale, view.whose, gone)
        return Picture(extent, scale, self._lanes(tables, [*pieces, *named], view.whose, ends))

    def _lanes(
        self, tables: Sequence[TopicTable], pieces: Sequence[Piece], whose: Whose, ends: Ends
    ) -> List[Lane]:
        """Make the lanes of tables: of the nodes that have messages in them, now or ever."""
        slots = self._reader.slots(tables)
        of_table: Dict[str, List[Piece]] = {}
        for piece in pieces:
            of_table.setdefault(piece.table.name, []).append(piece)
        lanes: Dict[Tuple[str, str], Tuple[List[TopicTable], List[Piece]]] = {}
        for table in tables:
            listed = {node for _, node in slots.get(table.name, [])}
            own = of_table.get(table.name, [])
            nodes = listed | {piece.node for piece in own} or {table.metadata.nodeID}
            if whose.nodes is not None:
                nodes = nodes.intersection(whose.nodes)
            for node in nodes:
                of_lane = lanes.setdefault((node, table.metadata.topic), ([], []))
                of_lane[0].append(table)
                of_lane[1].extend(piece for piece in own if piece.node == node)
        found = [Lane(topic, node, *lanes[node, topic], ends) for node, topic in sorted(lanes)]
        if whose.writers is None:
            return found
        return [lane for lane in found if lane.times[0] is not None]


def _extent(named: Sequence[Piece]) -> Optional[Ends]:
    """Tell when the first and the last message under a name was stored; None: there is none."""
    times = Keys.joined([piece.keys for piece in named]).times
    return (int(times.min()), int(times.max())) if len(times) else None


def _window(view: View, extent: Optional[Ends]) -> Optional[Ends]:
    """Return what is to be seen; where one end is open it is never before the other one."""
    start, end = view.start, view.end
    if start is None:
        low = extent[0] if extent else end
        start = low if low is None or end is None else min(low, end)
    if end is None:
        high = extent[1] if extent else start
        end = high if high is None or start is None else max(high, start)
    return None if start is None or end is None else (start, end)
