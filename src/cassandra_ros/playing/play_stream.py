# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""All messages of a selection as one stream, in the order of reception.

With the option ``around`` only windows around certain messages are played, with ``event`` only
those of events.
"""

from __future__ import annotations

import heapq
import logging
import re
from bisect import bisect_left
from collections import Counter
from dataclasses import replace
from itertools import accumulate, islice
from typing import Iterator, Mapping, NamedTuple, Sequence, Tuple

from cassandra_ros.arguments import spellings
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.keys import MAX_NS, split_seq
from cassandra_ros.messages.stamps import When, iso_time
from cassandra_ros.metadata import Kind
from cassandra_ros.playing.play_selection import PlaySelection, PublishedNames, chosen_topics
from cassandra_ros.playing.play_source import PlaySource, with_first_times
from cassandra_ros.playing.play_times import check_length, read_when, resolve_times
from cassandra_ros.playing.played_store import PlayedRow, PlayedStore
from cassandra_ros.playing.stored_ranges import StoredRange
from cassandra_ros.query.plan.bounds import merge_ranges
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.topics.event_finder import EventChoice, WindowRule, merge_windows
from cassandra_ros.topics.overview.latched_messages import LatchedRecord, Source, is_latched
from cassandra_ros.topics.overview.stored_ends import far_outside

_log = logging.getLogger(__name__)

_MOST_WINDOWS = 100
"""Maximum number of windows that are searched for a message of a run and topic. A run that meets
more is taken to have one, so that the topic is advertised."""


_Timed = Tuple[int, PlayedRow]
"""Time on the replay's time line, ns, and row."""


class PlayedMessage(NamedTuple):
    """A stored message with its time and name in a replay."""

    t: int
    """Time on the replay's time line, ns."""
    row: PlayedRow
    topic: str
    """Name under which it is published."""
    window: TimeRange
    """Window of the replay's time line that contains it.

    If it is another one than that of the message before, the time between the two is skipped.
    """


class Channel(NamedTuple):
    """A topic that is advertised before the first message, by name, type and definition."""

    topic: str
    """Name under which it is published."""
    type: str
    kind: Kind
    """Kind of the messages."""
    definition: str
    """Text of the message definition, as stored."""
    latched: bool
    """Whether at least one publisher latched it."""


class PlayStream:
    """The messages of a selection in one order: by time, node, counter and table.

    Attributes:
        selection: The selection, as given.
        topics: Names of the stored topics that are played, sorted.
        start_ns, end_ns: First and last time of the replay's time line, both included, ns. The
            time line is that of the times of reception; with align_start, that of the earliest
            run.
        windows: The time ranges of the replay's time line that are played, in order, not
            overlapping. Without ``around`` and ``event`` there is one, from start to end.

    Raises:
        TopicNotFound, RunNotFound, EventNotFound: A topic, the run or the event is not stored.
        MessageNotFound: Topics, nodeID, run, times or conditions leave no message.
        InvalidOption: A time cannot be read, lies before or after all selected messages, or the
            end lies before the start; or two options exclude each other.
        InvalidName, InvalidQuery: A name or a condition cannot be read.
        InvalidKey: A length of time of ``event`` cannot be read.
    """

    def __init__(self, store: PlayedStore, selection: PlaySelection) -> None:
        self._store = store
        self.selection = selection
        self._names = PublishedNames(selection.prefix, selection.remap)
        self._align = check_alignment(selection.align_start)
        start, end = read_when("start", selection.start), read_when("end", selection.end)
        if end is not None and selection.duration is not None:
            raise InvalidOption("an end and a duration were given: give one of them")
        length = check_length("duration", selection.duration)
        reach = check_length("before", selection.before), check_length("after", selection.after)
        self._around = WindowRule.of(selection.around, reach[0] or 0, reach[1] or 0)
        self._event = EventChoice.of(selection.event)
        if self._event is not None and self._around is not None:
            raise InvalidOption("an event and around were given: give one of them")
        self.topics = chosen_topics(store, selection)
        self._stored_ranges = self._find_stored_ranges()
        self._play_sources = self._find_sources(start, end)
        if self._align:
            # Dates have selected the messages already; they have no place on a common time line.
            start, end = (when if when and when.relative else None for when in (start, end))
        received_range = _message_range(self._play_sources)
        bounds = resolve_times(received_range, start, end, length)
        if end is not None and not end.relative:
            reason = far_outside("end", end.ns, received_range, "selected")
            if reason:
                _log.warning("the end, %s, %s", iso_time(end.ns), reason)
        self.windows = self._find_windows(bounds)
        lengths = (high - low for low, high in self.windows)
        self._played_before = list(accumulate(lengths, initial=0))
        """Time that is played before each window, and in all, ns."""
        self.start_ns, self.end_ns = self.windows[0].low, self.windows[-1].high
        self._robot_names: Mapping[Source, str] = {}
        """Name before the topics by robot and writer, with the option node_prefix."""
        if selection.node_prefix:
            self._robot_names = source_names(self._stored_ranges, store.run_names(), self._align)

    def _find_stored_ranges(self) -> list[StoredRange]:
        """Return the time ranges of the selected runs; set ``_whose``. Raises MessageNotFound."""
        selection = self.selection
        self._whose = self._store.whose(selection.nodeID, selection.run)
        ranges = self._store.ranges(self.topics, self._whose)
        if ranges:
            return ranges
        node = "" if selection.nodeID is None else f" of node {selection.nodeID!r}"
        run = "" if selection.run is None else f" of run {selection.run!r}"
        topics = ", ".join(self.topics)
        raise MessageNotFound(
            f"there is no message{node}{run} on {topics:.500}; cassandra_bag info lists what "
            "is stored"
        )

    def _find_sources(self, start: When | None, end: When | None) -> list[PlaySource]:
        """Return the sources that are played: one, or with align_start one for each run or robot.

        Aligned ones have only the messages between a start and an end that are dates. Otherwise
        start and end are not used.

        Raises:
            MessageNotFound: No message satisfies the conditions.
            InvalidOption: Start or end, a date, lies outside of all messages.
        """
        selection = self.selection
        times = None
        if self._event is not None:
            times = self._store.event_times(self._event, self._whose)
        whole = PlaySource(
            self._store,
            self.topics,
            self._whose,
            selection.where,
            self._stored_ranges,
            times=times,
        )
        if not self._align:
            return self._with_messages([whole])
        first, last = (None if when is None or when.relative else when for when in (start, end))
        # The errors are those of a replay that is not aligned.
        resolve_times(_message_range(self._with_messages([whole])), first, last, None)
        time_range = TimeRange(
            0 if first is None else first.ns, MAX_NS if last is None else last.ns
        )
        return aligned(
            self._with_messages(split_sources(replace(whole, chosen=time_range), self._align))
        )

    def _with_messages(self, sources: Sequence[PlaySource]) -> list[PlaySource]:
        """Return the sources that have a selected message, or raise MessageNotFound."""
        with_first = with_first_times(sources)
        if with_first:
            return with_first
        where = "; ".join(
            f"{topic}: {text}" for topic, text in (self.selection.where or {}).items()
        )
        reasons = [f"satisfies {where}"] if where else []
        reasons += [f"is of event {self._event.name!r:.80}"] if self._event is not None else []
        text = " or ".join(reasons)
        raise MessageNotFound(f"no message of the selection is left: no message {text}")

    def _name_of(self, topic: str, node: str, writer: int) -> str:
        """Return the name under which a topic of a run is published."""
        if not self.selection.node_prefix:
            return self._names.of(topic)
        # A run that began after the stream was made has no name yet.
        default = valid_name(node or f"run_{writer}")
        return self._names.of(topic, self._robot_names.get((node, writer), default))

    def _find_windows(self, bounds: TimeRange) -> list[TimeRange]:
        """Return the windows within the bounds, at least one, or raise MessageNotFound."""
        sources, around = self._play_sources, self._around
        if self._event is not None:
            events = heapq.merge(*(source.events(bounds) for source in sources))
            windows = list(merge_ranges(events))
            what = "event reaches into the time"
        elif around is not None:
            hits_by_source = (
                source.hits(around.topic, around.condition, bounds) for source in sources
            )
            hits = heapq.merge(*hits_by_source)
            windows = list(merge_windows(hits, around.before, around.after, bounds))
            what = f"message of {around.topic} satisfies {around.condition!r:.200}"
        else:
            return [bounds]
        if not windows:
            low, high = map(iso_time, bounds)
            raise MessageNotFound(f"no {what} between {low} and {high}")
        return windows

    def _windows_from(self, t: int) -> Iterator[TimeRange]:
        """Yield the windows from a time on; the first one is cut off at that time."""
        return (TimeRange(max(low, t), high) for low, high in self.windows if high >= t)

    def played_ns(self, t: int) -> int:
        """Return the time that is played before ``t``, ns: that in the windows."""
        number = bisect_left(self.windows, (t,))  # of the windows that begin before t
        if not number:
            return 0
        low, high = self.windows[number - 1]
        return self._played_before[number - 1] + min(high, t) - low

    def _plays(self, source: PlaySource, stored_range: StoredRange) -> bool:
        """Return whether a run has a selected message of a table's topic in a window.

        True also if more than _MOST_WINDOWS would have to be searched.
        """
        alone = _alone(source, stored_range)
        first, last = stored_range.first + source.shift, stored_range.last + source.shift
        met = [window for window in self.windows if first <= window.high and last >= window.low]
        if not alone.where and source.times is None:
            # It has a message at each of its ends.
            if any(w.low <= first or last <= w.high for w in met):
                return True
        if len(met) > _MOST_WINDOWS:
            return True
        rows = (row for window in met for _, row in alone.rows(window))
        return any(row.table.name == stored_range.table.name for row in rows)

    def _first_time(self, source: PlaySource, stored_range: StoredRange) -> int:
        """Return the time of the first message of a run and table that is played, ns.

        MAX_NS if the first _MOST_WINDOWS windows have none.
        """
        first, alone = stored_range.first + source.shift, _alone(source, stored_range)
        met = (window for window in self.windows if first <= window.high)
        for low, high in islice(met, _MOST_WINDOWS):
            for t, row in alone.rows(TimeRange(max(low, first), high)):
                if row.table.name == stored_range.table.name:
                    return t
        return MAX_NS

    def channels(self) -> list[Channel]:
        """Return the topics to be advertised, by the stored connections.

        They have messages in the windows, or latched ones before them. If a topic has several
        types, they come in the order of their first messages in the windows; ROS takes the first.
        """
        playing: list[StoredRange] = []  # with messages in a window
        earlier: list[StoredRange] = []  # without, but one may have been latched before
        sources: dict[StoredRange, PlaySource] = {}
        for source in self._play_sources:
            for stored_range in source.stored_ranges:
                if self._plays(source, stored_range):
                    playing.append(stored_range)
                    sources[stored_range] = source
                elif stored_range.first + source.shift <= self.end_ns:
                    earlier.append(stored_range)
        runs = {(stored_range.node, stored_range.writer) for stored_range in playing}
        earlier = [
            stored_range
            for stored_range in earlier
            if (stored_range.node, stored_range.writer) in runs
        ]
        by_table: dict[str, list[tuple[StoredRange, bool]]] = {}  # and whether it is in ``playing``
        for ranges, plays in ((playing, True), (earlier, False)):
            for stored_range in ranges:
                by_table.setdefault(stored_range.table.name, []).append((stored_range, plays))
        channels: dict[tuple[str, str, Kind], Channel] = {}
        played: dict[tuple[str, str, Kind], set[StoredRange]] = {}
        for name, _, connection in self._store.connections(by_table):
            table, latched = by_table[name][0][0].table, is_latched(connection)
            metadata = table.metadata
            msg_type = connection.type or metadata.msg_type
            text = connection.definition_text or metadata.definition
            for stored_range, plays in by_table[name]:
                if not (plays or latched):
                    continue
                topic = self._name_of(metadata.topic, stored_range.node, stored_range.writer)
                key = (topic, msg_type, table.kind)
                channel = channels.get(key, Channel(*key, text, latched))
                channels[key] = channel._replace(latched=channel.latched or latched)
                if plays:
                    played.setdefault(key, set()).add(stored_range)
        types = Counter(channel.topic for channel in channels.values())

        def first_ns(channel: Channel) -> int:
            # Only the order of the types of one topic matters: of others nothing is read.
            ranges = played.get(channel[:3], set()) if types[channel.topic] > 1 else set()
            return min(
                (self._first_time(sources[stored_range], stored_range) for stored_range in ranges),
                default=MAX_NS,
            )

        return sorted(
            channels.values(), key=lambda channel: (channel.topic, first_ns(channel), channel)
        )

    @property
    def missing(self) -> Mapping[str, str]:
        """The stores of a fleet that did not answer so far, or not to the end → why."""
        return self._store.missing

    def losses(self) -> Sequence[Loss]:
        """Return the losses in the windows; with align_start all of them."""
        if self._align:
            return self._store.losses(self.topics, Read(TimeRange(), self._whose))
        reach = TimeRange(self.start_ns, self.end_ns)
        losses = self._store.losses(self.topics, Read(reach, self._whose))
        return [loss for loss in losses if self._meets(loss)]

    def _meets(self, loss: Loss) -> bool:
        """Return whether a loss is during an event of its robot, or in a window."""
        read = Read(TimeRange(loss.first_ns, loss.last_ns), Whose((loss.node,)))
        times = [source.times for source in self._play_sources if source.times is not None]
        if times:
            return any(times_of_source.reads(read) for times_of_source in times)
        return any(loss.first_ns <= high and loss.last_ns >= low for low, high in self.windows)

    def latched(self, t: int) -> list[PlayedMessage]:
        """Return the latched messages received before ``t``, in order of reception.

        They are published first when playing begins at ``t`` or jumps there: the last message of
        each publisher, for the runs that have messages in the window played from then on. Their
        times are their times of reception.
        """
        window = next(self._windows_from(t), None)
        if window is None:
            return []
        rows = _merge([source.latched(window) for source in self._play_sources])
        return [self._played_message(t, row, window) for t, row in rows]

    def messages(self, t: int | None = None) -> Iterator[PlayedMessage]:
        """Yield the messages from ``t`` on, ns, included; None = from the start.

        With ``around`` and ``event``, latched messages that changed in a gap between windows come
        first in the next window, with the time at which it begins. ``latched`` returns those before
        the first window.

        Memory: a few pages of rows for all topics of a run together.
        """
        low = self.start_ns if t is None else max(t, self.start_ns)
        windowed = self._around is not None or self._event is not None
        sent = [LatchedRecord() for _ in self._play_sources] if windowed else None
        for number, window in enumerate(self._windows_from(low)):
            if sent is not None:
                changed = [p.latched(window, s) for p, s in zip(self._play_sources, sent)]
                for _, row in _merge(changed if number else []):
                    yield self._played_message(window.low, row, window)
            for at, row in self._rows(window, sent):
                yield self._played_message(at, row, window)

    def _rows(
        self, time_range: TimeRange, sent: Sequence[LatchedRecord] | None
    ) -> Iterator[_Timed]:
        """Yield the rows of all sources in one order; record latched ones in ``sent``, if given."""
        if sent is None:
            return heapq.merge(
                *(source.rows(time_range) for source in self._play_sources), key=_order
            )
        pairs = zip(self._play_sources, sent)
        return heapq.merge(
            *(
                source.rows_noting_latched(time_range, latched_record)
                for source, latched_record in pairs
            ),
            key=_order,
        )

    def _played_message(self, t: int, row: PlayedRow, window: TimeRange) -> PlayedMessage:
        name = self._name_of(row.topic, row.node, split_seq(row.seq)[0])
        return PlayedMessage(t, row, name, window)


def _alone(source: PlaySource, stored_range: StoredRange) -> PlaySource:
    """Return the messages of a source that are of the topic, robot and run of a stored range."""
    topic = stored_range.table.metadata.topic
    where = {n: text for n, text in (source.where or {}).items() if topic in spellings(n)}
    whose = Whose((stored_range.node,), frozenset({stored_range.writer}))
    return replace(source, topics=[topic], whose=whose, where=where or None)


def _message_range(sources: Sequence[PlaySource]) -> TimeRange:
    """Return the time range of the replay's time line in which some sources have messages."""
    ranges = [source.time_range for source in sources]
    return TimeRange(min(low for low, _ in ranges), max(high for _, high in ranges))


def _merge(sources: Sequence[Sequence[_Timed]]) -> Iterator[_Timed]:
    """Yield the rows of several sources, each in order, in one order."""
    return heapq.merge(*sources, key=_order)


def _order(timed: _Timed) -> tuple[int, str, int, str]:
    """Return the position of a row in the order of the replay: time, node, counter and table."""
    t, row = timed
    return t, row.node, row.seq, row.table.name


def check_alignment(align: object) -> str:
    """Return 'run', 'node', or '' for no alignment, or raise InvalidOption."""
    alignments = {False: "", True: "run", "": "", "run": "run", "node": "node"}
    if isinstance(align, (bool, str)) and align in alignments:
        return alignments[align]
    raise InvalidOption(f"align_start {align!r:.80} is neither 'run' nor 'node'")


def split_sources(source: PlaySource, align: str) -> list[PlaySource]:
    """Divide a source into sources that are aligned with each other: its runs or its robots."""
    groups: dict[Source, list[StoredRange]] = {}
    for stored_range in source.stored_ranges:
        writer = 0 if align == "node" and stored_range.node else stored_range.writer
        groups.setdefault((stored_range.node, writer), []).append(stored_range)
    sources = []
    for (node, writer), ranges in sorted(groups.items()):
        writers = source.whose.writers if align == "node" and node else frozenset([writer])
        whose = Whose((node,), writers)
        sources.append(replace(source, whose=whose, stored_ranges=tuple(ranges)))
    return sources


def aligned(sources: Sequence[PlaySource]) -> list[PlaySource]:
    """Shift sources so that their first selected messages have the time of the earliest one."""
    start = min(source.begin for source in sources)
    return [replace(source, shift=start - source.begin) for source in sources]


def source_names(
    stored_ranges: Sequence[StoredRange], run_names: Mapping[int, str], align: str
) -> dict[Source, str]:
    """Return for each robot and writer a valid ROS name to stand before its topics.

    It is the nodeID, else the run's name, else run_<writer id>. When several runs of one robot are
    aligned with each other, it is nodeID and run. Names that would be equal are numbered.
    """
    firsts: dict[Source, int] = {}
    for stored_range in stored_ranges:
        source = (stored_range.node, stored_range.writer)
        firsts[source] = min(stored_range.first, firsts.get(source, stored_range.first))
    names: dict[Source, str] = {}
    owners: dict[str, tuple[str, str]] = {}  # of each name: the robot, and the run if it is its own
    for node, writer in sorted(firsts, key=lambda source: (firsts[source], source)):
        run = run_names.get(writer) or f"run_{writer}"
        runs_of_node = {w for n, w in firsts if n == node}
        told_apart = not node or (align == "run" and len(runs_of_node) > 1)
        text = f"{node}_{run}" if node and told_apart else node or run
        # All runs of one robot share its name unless they are aligned with each other.
        owner = (node, str(writer) if told_apart else "")
        name, number = valid_name(text), 1
        while owners.setdefault(name, owner) != owner:
            number += 1
            name = f"{valid_name(text)}_{number}"
        names[node, writer] = name
    return names


def valid_name(text: str) -> str:
    """Return a text as a name that is valid between two slashes in ROS: /<name>/topic."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return name if name[:1].isalpha() else f"node_{name}"
