# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""All messages of a selection as one stream, in the order in which they were received."""

from __future__ import annotations

from typing import Dict, FrozenSet, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.stamps import duration_ns
from cassandra_ros.playing.extent import Extent, extents
from cassandra_ros.playing.selection import Names, PlaySelection, chosen_topics
from cassandra_ros.playing.times import read_when, resolve_times
from cassandra_ros.topics.latched import LatchedFinder, is_latched, tables_of, tests_of
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.topics.selection import Stretch
from cassandra_ros.topics.stored_row import StoredRow


class Played(NamedTuple):
    """A message as it is played."""

    t: int
    """When, ns on the replay's own time line."""
    row: StoredRow
    topic: str
    """Name under which it goes out."""
    window: Stretch
    """The stretch of the replay's time line that it belongs to; what lies between two stretches
    is jumped over."""


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
    """The messages of a selection, merged into one order.

    Attributes:
        selection: What was asked for.
        topics: The stored topics that are played, sorted.
        start_ns, end_ns: First and last time of the replay's time line, both included, ns. It is
            that of the times of reception.

    Raises:
        TopicNotFound, RunNotFound: What was asked for is not stored.
        MessageNotFound: Topics, nodeID and run leave no message.
        InvalidOption: A time is none, before or behind all that is chosen, or reversed; or options
            do not go together.
        InvalidName, InvalidQuery: A name or a condition is none.
    """

    def __init__(self, ros_cas: RosCassandra, selection: PlaySelection) -> None:
        self._ros_cas = ros_cas
        self.selection = selection
        self._names = Names(selection.prefix, selection.remap)
        start, end = read_when("start", selection.start), read_when("end", selection.end)
        if end is not None and selection.duration is not None:
            raise InvalidOption("an end and a duration were given: give one of them")
        length = None if selection.duration is None else duration_ns(selection.duration)
        self.topics = chosen_topics(ros_cas, selection)
        tables = tables_of(ros_cas, self.topics)
        nodes, writers = check_nodes(selection.nodeID), self._writers()
        self._extents = extents(ros_cas.parts, tables, nodes, writers)
        if not self._extents:
            raise MessageNotFound(self._nothing())
        known = Stretch(min(e.first for e in self._extents), max(e.last for e in self._extents))
        tests = tests_of(ros_cas, selection.where, selection.nodeID)
        if selection.where:
            known = Stretch(self._first(known), known.high)
        self._stretch = resolve_times(known, start, end, length)
        self.start_ns, self.end_ns = self._stretch
        self._latched = LatchedFinder(ros_cas.parts, tables, nodes, writers, tests)

    def _writers(self) -> Optional[FrozenSet[int]]:
        run = self.selection.run
        if run is None:
            return None
        every = self._ros_cas.runs()
        named = frozenset(each.writer for each in every if each.name and each.name == run)
        return named or frozenset(each.writer for each in every if str(each.writer) == str(run))

    def _nothing(self) -> str:
        asked = self.selection
        node = "" if asked.nodeID is None else f" of node {asked.nodeID!r}"
        run = "" if asked.run is None else f" of run {asked.run!r}"
        topics = ", ".join(self.topics)
        return f"there is no message{node}{run} on {topics:.500}; cassandra_bag info lists them"

    def _first(self, known: Stretch) -> int:
        """Return when the first message came that satisfies the conditions."""
        row = next(self._rows(known), None)
        if row is None:
            raise MessageNotFound("no message satisfies the conditions")
        return row.received

    def _rows(self, stretch: Stretch) -> Iterator[StoredRow]:
        selection, writers = self.selection, self._writers()
        rows = self._ros_cas.readMessages(
            self.topics,
            stretch.low,
            stretch.high,
            nodeID=selection.nodeID,
            received=True,
            where=selection.where,
        )
        if writers is None:
            return rows
        return (row for row in rows if split_seq(row.seq)[0] in writers)

    @property
    def windows(self) -> List[Stretch]:
        """The stretches of the replay's time line that are played, in order, without overlap."""
        return [self._stretch]

    def channels(self) -> List[Channel]:
        """List what is to be advertised: by the stored connections, without reading a row."""
        found: Dict[Tuple[str, str, str], Channel] = {}
        by_table: Dict[str, List[Extent]] = {}
        for extent in self._extents:
            by_table.setdefault(extent.table.name, []).append(extent)
        for name, _, connection in self._ros_cas.parts.connections.of_tables(by_table):
            metadata = by_table[name][0].table.metadata
            channel = Channel(
                self._names.of(metadata.topic),
                connection.type or metadata.msg_type,
                metadata.md5sum,
                connection.definition_text or metadata.definition,
                is_latched(connection),
            )
            key = channel[:3]
            if key not in found or (channel.latched and not found[key].latched):
                found[key] = found.get(key, channel)._replace(latched=channel.latched)
        return sorted(found.values())

    def latched(self, t: int) -> List[Played]:
        """List the latched messages from before t, in the order of their reception.

        They are to be published first where playing begins at t, or jumps there: the last of each
        publisher, of the runs that have messages between t and the end.
        """
        rows = self._latched.before(t, max(t, self._stretch.high))
        return list(self._played(rows, self._stretch))

    def messages(self, t: Optional[int] = None) -> Iterator[Played]:
        """Walk lazily through the messages from t on, ns, included; None = from the start.

        Memory: some pages of rows for all topics together.
        """
        low = self.start_ns if t is None else max(t, self.start_ns)
        if low > self.end_ns:
            return iter(())
        return self._played(self._rows(Stretch(low, self.end_ns)), self._stretch)

    def _played(self, rows: Iterable[StoredRow], window: Stretch) -> Iterator[Played]:
        return (Played(row.received, row, self._names.of(row.topic), window) for row in rows)
