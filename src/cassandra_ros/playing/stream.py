# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""All messages of a selection as one stream, in the order in which they were received."""

from __future__ import annotations

import heapq
from dataclasses import replace
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.keys import MAX_NS, split_seq
from cassandra_ros.messages.stamps import When, iso_time
from cassandra_ros.overview.latched_messages import Source, is_latched
from cassandra_ros.playing.extent import Extent, extents
from cassandra_ros.playing.part import Part, Sent, begun
from cassandra_ros.playing.play_windows import PIECE_NS, Around
from cassandra_ros.playing.robot_alignment import (
    aligned,
    check_alignment,
    source_names,
    split_parts,
    valid_name,
)
from cassandra_ros.playing.selection import Names, PlaySelection, chosen_topics
from cassandra_ros.playing.times import check_length, read_when, resolve_times
from cassandra_ros.read import TimeRange
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.hit_windows import Piece, joined, merge_windows
from cassandra_ros.topics.stored_row import StoredRow

_Timed = Tuple[int, StoredRow]


class Played(NamedTuple):
    """A message as it is played."""

    t: int
    """When, ns on the replay's own time line."""
    row: StoredRow
    topic: str
    """Name under which it goes out."""
    window: TimeRange
    """The stretch of the replay's time line that it belongs to. Where its low end is another one
    than the last message's, what lies between the two stretches is jumped over; the high end of a
    long one may grow from message to message."""


class Channel(NamedTuple):
    """What is advertised before the first message: one for each name, type and md5sum."""

    topic: str
    """Name under which it goes out."""
    type: str
    md5sum: str
    definition: str
    """Text of the message definition, as stored."""
    latched: bool
    """Whether some publisher latched it."""


class Stream:
    """The messages of a selection, merged into one order: by time, node, counter and table.

    Attributes:
        selection: What was asked for.
        topics: The stored topics that are played, sorted.
        start_ns, end_ns: First and last time of the replay's time line, both included, ns. It is
            that of the times of reception; with align_start, of the run that was the first. With
            around the first window begins at the start; the last one may end before the end.

    Raises:
        TopicNotFound, RunNotFound: What was asked for is not stored.
        MessageNotFound: Topics, nodeID, run, times or conditions leave no message.
        InvalidOption: A time is none, before or behind all that is chosen, or reversed; or options
            do not go together.
        InvalidName, InvalidQuery: A name or a condition is none.
    """

    def __init__(self, catalog: Catalog, selection: PlaySelection) -> None:
        self._catalog = catalog
        self.selection = selection
        self._names = Names(selection.prefix, selection.remap)
        self._align = check_alignment(selection.align_start)
        start, end = read_when("start", selection.start), read_when("end", selection.end)
        if end is not None and selection.duration is not None:
            raise InvalidOption("an end and a duration were given: give one of them")
        length = check_length("duration", selection.duration)
        self._around = Around.of(selection.around, selection.before, selection.after)
        self.topics = chosen_topics(catalog, selection)
        self._extents = self._find_extents()
        self._parts = self._find_parts(start, end)
        if self._align:
            # Times of the calendar have chosen the messages; on a common line they mean nothing.
            start, end = (when if when and when.relative else None for when in (start, end))
        self._time_range = resolve_times(_known(self._parts), start, end, length)
        self.start_ns, self.end_ns = self._time_range
        if self._around is not None:
            self.start_ns = self._first_window(self._around)
        self._sources = self._source_names() if selection.node_prefix else {}

    def _find_extents(self) -> List[Extent]:
        asked, keyspace = self.selection, self._catalog.keyspace
        self._writers = keyspace.runs.writers(asked.run)
        tables, nodes = self._catalog.tables(self.topics), check_nodes(asked.nodeID)
        found = extents(keyspace, tables, nodes, self._writers)
        if found:
            return found
        node = "" if asked.nodeID is None else f" of node {asked.nodeID!r}"
        run = "" if asked.run is None else f" of run {asked.run!r}"
        topics = ", ".join(self.topics)
        raise MessageNotFound(
            f"there is no message{node}{run} on {topics:.500}; cassandra_bag info lists what "
            "is stored"
        )

    def _find_parts(self, start: Optional[When], end: Optional[When]) -> List[Part]:
        asked = self.selection
        whole = Part(
            self._catalog, self.topics, asked.nodeID, self._writers, asked.where, self._extents
        )
        if not self._align:
            return self._begun([whole])
        first, last = (None if when is None or when.relative else when for when in (start, end))
        resolve_times(_known(self._begun([whole])), first, last, None)  # checked as for all
        chosen = TimeRange(0 if first is None else first.ns, MAX_NS if last is None else last.ns)
        return aligned(self._begun(split_parts(replace(whole, chosen=chosen), self._align)))

    def _begun(self, parts: Sequence[Part]) -> List[Part]:
        found = begun(parts)
        if found:
            return found
        where = "; ".join(
            f"{topic}: {text}" for topic, text in (self.selection.where or {}).items()
        )
        raise MessageNotFound(
            f"nothing is left of what was asked for: no message satisfies {where}"
        )

    def _source_names(self) -> Dict[Source, str]:
        run_names = {run.writer: run.name for run in self._catalog.keyspace.registry.runs()}
        return source_names(self._extents, run_names, self._align)

    def _name_of(self, topic: str, node: str, writer: int) -> str:
        if not self.selection.node_prefix:
            return self._names.of(topic)
        # A recorder may have begun since the stream was made.
        default = valid_name(node or f"run_{writer}")
        return self._names.of(topic, self._sources.get((node, writer), default))

    @property
    def windows(self) -> List[TimeRange]:
        """The stretches of the replay's time line that are played, in order, without overlap.

        With around all hits are looked for; messages() does not need them beforehand.
        """
        return list(joined(self._pieces(self._time_range.low)))

    def _pieces(self, low: int) -> Iterator[Piece]:
        """Walk through the windows from a time on: of the first one what lies before is cut off."""
        bounds, around = self._time_range, self._around
        low = max(low, bounds.low)
        if around is None:
            if low <= bounds.high:
                yield Piece(low, low, bounds.high)
            return
        reach = TimeRange(max(bounds.low, low - around.after), bounds.high)
        hits = heapq.merge(*(p.hits(around.topic, around.condition, reach) for p in self._parts))
        for piece in merge_windows(hits, around.before, around.after, bounds, PIECE_NS):
            if piece.high >= low:
                yield Piece(max(piece.window, low), max(piece.low, low), piece.high)

    def _first_window(self, around: Around) -> int:
        first = next(self._pieces(self._time_range.low), None)
        if first is None:
            low, high = map(iso_time, self._time_range)
            raise MessageNotFound(
                f"no message of {around.topic} satisfies {around.condition!r:.200} between {low} "
                f"and {high}"
            )
        return first.low

    def channels(self) -> List[Channel]:
        """List what is to be advertised: by the stored connections, without reading a row."""
        by_table: Dict[str, List[Extent]] = {}
        for extent in self._extents:
            by_table.setdefault(extent.table.name, []).append(extent)
        found: Dict[Tuple[str, str, str], Channel] = {}
        for name, _, connection in self._catalog.keyspace.connections.of_tables(by_table):
            metadata, latched = by_table[name][0].table.metadata, is_latched(connection)
            kind = connection.type or metadata.msg_type
            text = connection.definition_text or metadata.definition
            for each in by_table[name]:
                topic = self._name_of(metadata.topic, each.node, each.writer)
                key = (topic, kind, metadata.md5sum)
                known = found.get(key, Channel(*key, text, latched))
                found[key] = known._replace(latched=known.latched or latched)
        return sorted(found.values())

    def latched(self, t: int) -> List[Played]:
        """List the latched messages from before t, in the order of their reception.

        They are to be published first where playing begins at t, or jumps there: the last of each
        publisher, of the runs that have messages in what is played from then on. Their times are
        those at which they were received.
        """
        piece = next(self._pieces(t), None)
        if piece is None:
            return []
        window = TimeRange(piece.low, piece.high)
        rows = _merged([part.latched(window) for part in self._parts])
        return [self._played(t, row, window) for t, row in rows]

    def messages(self, t: Optional[int] = None) -> Iterator[Played]:
        """Walk lazily through the messages from t on, ns, included; None = from the start.

        With around, the latched messages that changed in a gap come first in the window behind it,
        with the time at which it begins; those before the first window are left to ``latched``.

        Memory: some pages of rows for all topics of a run together.
        """
        low = self.start_ns if t is None else max(t, self.start_ns)
        sent = [Sent() for _ in self._parts] if self._around else None
        last: Optional[int] = None
        for piece in self._pieces(low):
            window = TimeRange(piece.window, piece.high)
            reach = TimeRange(piece.low, piece.high)
            if sent is not None and piece.window != last:
                changed = [p.latched(reach, s) for p, s in zip(self._parts, sent)]
                if last is not None:
                    for _, row in _merged(changed):
                        yield self._played(piece.low, row, window)
                last = piece.window
            for at, row in self._rows(reach, sent):
                yield self._played(at, row, window)

    def _rows(self, time_range: TimeRange, sent: Optional[Sequence[Sent]]) -> Iterator[_Timed]:
        if sent is None:
            return heapq.merge(*(part.rows(time_range) for part in self._parts), key=_order)
        pairs = zip(self._parts, sent)
        return heapq.merge(*(part.noted(time_range, each) for part, each in pairs), key=_order)

    def _played(self, t: int, row: StoredRow, window: TimeRange) -> Played:
        name = self._name_of(row.topic, row.node, split_seq(row.seq)[0])
        return Played(t, row, name, window)


def _known(parts: Sequence[Part]) -> TimeRange:
    """Return from when to when some parts reach, on the replay's time line."""
    return TimeRange(min(p.known.low for p in parts), max(p.known.high for p in parts))


def _merged(parts: Sequence[Sequence[_Timed]]) -> Iterator[_Timed]:
    return heapq.merge(*parts, key=_order)


def _order(timed: _Timed) -> Tuple[int, str, int, str]:
    t, row = timed
    return t, row.node, row.seq, row.table.name
