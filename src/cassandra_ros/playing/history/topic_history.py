# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stored messages of a topic, then its live ones: each once, in order, while it is recorded.

Live messages wait in a queue from the start. Stored messages that are clearly older are yielded
first. Then the newest stored messages are compared with the waiting ones until, for each publisher,
the stored message is found that equals its first live one, and until everything before it has had
time to be stored: a recorder stores a message some tenths of a second after it received it.
"""

from __future__ import annotations

import logging
import time
from collections import Counter as Count
from functools import lru_cache
from typing import Callable, Counter, Iterable, Iterator, Mapping, NamedTuple, Tuple

from cassandra_ros.errors import CassandraRosError, CorruptMessage, MessageNotFound
from cassandra_ros.keys import SECOND_NS, split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.playing.history.alignment import Live, MessageFingerprint, digest_of, first_live
from cassandra_ros.playing.history.live_queue import LiveQueue, Publisher, WaitingMessages
from cassandra_ros.playing.history.stored_past import StoredPast
from cassandra_ros.recording.message_buffer import starts_with_header
from cassandra_ros.topics.stored_row import MessageIdentity, StoredRow

_log = logging.getLogger(__name__)

COMPARED_WINDOW_NS = 2 * SECOND_NS
"""Age before the first live message above which a row is yielded without comparing it, ns."""
PUBLISHER_REACH_NS = 5 * SECOND_NS
"""How far after its first live message a publisher's stored messages are compared with it, ns."""
FAR_NS = 60 * SECOND_NS
"""The same after half of the patience, in case the recorder's clock is ahead of ours, ns."""
POLL_SEC = 0.1
"""Interval at which the end of the stored messages is read again, s."""
SETTLE_SEC = 1.0
"""How long to wait, once all bounds are found, for messages that are still being stored, s."""
PATIENCE_SEC = 10.0
"""How long a live message is searched for in the store while a writer writes the topic, s."""
DOUBT_SEC = 3.0
"""The same while no writer is seen but some recording runs, which may be making the table, s."""
MOST_SEC = 60.0
"""Maximum time of the search, s. After it the live messages are yielded in any case."""
LOOK_SEC = 2.0
"""Interval between two checks whether a writer writes the topic, s."""
LATE_SEC = (5.0, 65.0)
"""Times after going live at which rows that were stored late are searched for, s.

A request that failed is sent again, for 60 s by default, while later messages are stored.
"""
KEPT_NS = 10 * SECOND_NS
"""Time range before the newest row in which the yielded rows are remembered, ns."""
ROOM = 10_000
"""Maximum number of rows remembered beyond that time range."""

_Arrival = Tuple[int, str, int, str]
"""Position of a row in the order of reads by receive time, which is its first part, ns; see
StoredRow.arrival."""


class HistoryMessage(NamedTuple):
    """A stored or a live message."""

    t: int
    """Time of reception, ns."""
    header: Mapping[str, str]
    """Fields of its connection header."""
    wire: bytes
    stored: bool
    """Whether it was read from the store."""


class _WriterStream(NamedTuple):
    """The messages of one publisher that one writer stored."""

    publisher: Publisher
    node: str
    writer: int


class _StoredMark(NamedTuple):
    """One of the newest stored rows, to be compared with live messages."""

    arrival: _Arrival
    stream: _WriterStream
    mark: MessageFingerprint


class History:
    """The stored messages of a topic from a time on, then its live messages; see the module.

    Args:
        past: The stored messages.
        queue: The live messages; it must be filled already when the reading of the past begins.
        since: Returns, for the present time, ns, the time from which stored messages are read, ns.
        connected: Returns whether all present publishers are connected to the queue.
    """

    def __init__(
        self,
        past: StoredPast,
        queue: LiveQueue,
        since: Callable[[int], int],
        connected: Callable[[], bool],
    ) -> None:
        self._past, self._queue, self._connected = past, queue, connected
        self._since, self._low = since, 0
        """Function of the argument ``since``, and the receive time from which is read next, ns."""
        # All that follows is used by the thread that iterates ``messages``.
        self._done: dict[MessageIdentity, int] = {}
        """Rows that were yielded, or are damaged → receive time, ns."""
        self._floor, self._room = 0, ROOM
        """All yielded rows from the time _floor on, ns, are in _done; _room is its maximum size."""
        self._bounds_by_stream: dict[_WriterStream, _Arrival] = {}
        """For each stream the first row that comes live instead, once live messages are yielded."""
        self._heard: dict[Publisher, Live] = {}
        """First live messages of each publisher, which may be read from the store later, too."""
        self._late_sec: list[float] = []
        """Monotonic times at which rows are still searched that were stored late, s."""
        self._seen: dict[MessageIdentity, _StoredMark] = {}
        """Newest rows, among which the first live messages are searched; not yielded yet."""
        self._newest = 0
        """Receive time of the newest row that was yielded, ns."""
        self._last: dict[_WriterStream, MessageFingerprint] = {}
        """The row of each stream that was yielded last."""
        self._counted: dict[Publisher, int] = {}
        """Number of rows of a publisher that were yielded since the first message that the queue
        had dropped."""
        self._checked_at = -LOOK_SEC
        """Monotonic time at which it was checked whether the topic is written, s."""
        self._written = self._doubtful = False
        """Whether a writer is seen to write the topic, and whether one may."""
        self._unseen: list[Publisher] = []
        """Publishers of which no live message was found among the rows."""
        self._has_seen_live = False
        """Whether a live message of another publisher was."""
        self._epoch, self._begun_sec, self._ready_sec = -1, -1.0, -1.0
        """Epoch of the queue in which the bounds are searched, monotonic time of the beginning of
        the search, and of the moment from which the search may end, s; -1 = not yet."""
        self.live = False
        """Whether all stored messages were yielded, as far as they could be read."""
        self.lost = 0
        """Number of messages known to be missing."""

    def messages(self) -> Iterator[HistoryMessage]:
        """Yield the messages until the queue is closed."""
        try:
            yield from self._all_past()
        except CassandraRosError as exc:
            if not self._queue.closed:
                _log.error(
                    "the stored messages after %s cannot be read, so there may be a gap up to "
                    "the first live one: %s",
                    iso_time(self._newest),
                    exc,
                )
                while not (self._queue.join(self._queue.epoch) or self._queue.closed):
                    pass  # messages were dropped between the two
                self._count_missing("the store does not answer")
        self.live = True
        self._seen.clear()
        while not self._queue.closed:
            message = self._queue.next_message(1.0)
            if message is not None and message.wanted:
                yield HistoryMessage(message.t, message.header, message.wire, False)
            if self._late_sec and time.monotonic() > self._late_sec[0]:
                del self._late_sec[0]
                yield from self._late()
            elif not self._late_sec and self._done:
                self._forget()

    def _all_past(self) -> Iterator[HistoryMessage]:
        """Yield the stored messages up to the live ones; from then on the queue drops nothing."""
        while not self._queue.begin():  # simulated time begins with the first /clock message
            self._queue.wait(POLL_SEC)
            if self._queue.closed:
                return
        self._low = self._floor = self._since(self._queue.began_ns)
        reason = ""
        if not self._past.exists() and not self._past.may_be_written():
            reason = "no message of it is stored, and no recording is running"
        elif self._low > self._queue.now_ns():
            reason = (
                f"stored messages are to begin at {iso_time(self._low)}, which is in the future"
            )
        if reason:
            _log.warning("topic %s: live messages only: %s", self._past.topic, reason)
            self._queue.join(self._queue.epoch)
            return
        self._warn_of_losses()
        while not self._queue.closed:
            self._begin()
            yield from self._old()
            bounds = self._bounds()
            if bounds is None:
                self._queue.wait(POLL_SEC)
            elif self._queue.join(self._epoch):
                self._remember_live(bounds)
                yield from self._rest(bounds)
                self._tell_gaps()
                return

    def _warn_of_losses(self) -> None:
        losses = self._past.losses(self._low)
        if losses:
            _log.warning(
                "topic %s: at least %d messages were not recorded between %s and %s (%s), so they "
                "are missing here; cassandra_bag info lists them",
                self._past.topic,
                sum(loss.count for loss in losses),
                iso_time(min(loss.first_ns for loss in losses)),
                iso_time(max(loss.last_ns for loss in losses)),
                ", ".join(sorted({loss.kind.value for loss in losses})),
            )

    def _begin(self) -> None:
        """Start the search for the bounds again if live messages were dropped."""
        if self._epoch != self._queue.epoch:
            self._epoch = self._queue.epoch
            self._begun_sec = self._ready_sec = -1.0

    def _old(self) -> Iterator[HistoryMessage]:
        """Yield the rows that are clearly older than the live messages.

        The next read begins shortly before the last of them.
        """
        high = self._queue.began_ns - COMPARED_WINDOW_NS
        heads = {who: w.messages[0].mark for who, w in self._queue.waiting().items()}
        last = None
        for row in self._past.rows(self._low, high):
            self._check_written()
            if self._queue.closed:
                return
            if row.identity not in self._done:
                if self._is_head(row, heads):
                    break
                yield from self._give(row)
            last = row.received
            self._make_room(last)
        if last is not None:
            self._low = max(self._low, last - COMPARED_WINDOW_NS)

    def _make_room(self, last: int) -> None:
        """Forget all yielded rows but the last ones: those of days would not fit into memory.

        Args:
            last: Receive time of the row that was yielded last, ns.
        """
        if len(self._done) > self._room:
            self._floor = max(self._floor, last - KEPT_NS)
            self._done = {p: t for p, t in self._done.items() if t >= self._floor}
            self._room = 2 * len(self._done) + ROOM

    def _is_head(self, row: StoredRow, heads: Mapping[Publisher, MessageFingerprint]) -> bool:
        """Return whether a row is a first live message: the recorder's clock may be behind ours."""
        if not heads:
            return False
        head = heads.get(_publisher(row.connection))
        if head is None or not _is_stamped(row.connection.definition_text):
            return False
        wire = self._wire(row)
        return wire is not None and digest_of(wire) == head.digest

    def _wire(self, row: StoredRow) -> bytes | None:
        """Return the bytes of a row; None = it was deleted, or is damaged, which counts as lost."""
        try:
            return row.wire
        except MessageNotFound:
            return None
        except CorruptMessage as exc:
            self.lost += row.identity not in self._done
            self._done[row.identity] = row.received
            _log.error("a stored message is left out: %s", exc)
            return None

    def _give(self, row: StoredRow) -> Iterator[HistoryMessage]:
        """Yield a row as a message and note it as yielded; nothing if it cannot be read."""
        wire = self._wire(row)
        if wire is None:
            return
        self._done[row.identity] = row.received
        self._newest = max(self._newest, row.received)
        self._seen.pop(row.identity, None)
        stream = _stream(row)
        dropped = self._queue.dropped.get(stream.publisher)
        mark = self._last[stream] = MessageFingerprint(row.received, digest_of(wire))
        if stream.publisher in self._counted:
            self._counted[stream.publisher] += 1
        elif dropped is not None and mark.digest == dropped.first.digest:
            self._counted[stream.publisher] = 1
        yield HistoryMessage(row.received, _fields(row.connection), wire, True)

    def _check_written(self) -> None:
        """Check, every LOOK_SEC, whether a writer writes the topic."""
        now = time.monotonic()
        if now - self._checked_at >= LOOK_SEC:
            self._checked_at = now
            self._written = self._past.is_written(self._queue.now_ns())
            self._doubtful = self._written or self._past.may_be_written()
            self._queue.recorded = self._written

    def _bounds(self) -> dict[_WriterStream, _Arrival] | None:
        """Return for each stream the first row that comes live instead; None = not known yet."""
        self._check_written()
        now = time.monotonic()
        if self._begun_sec < 0:
            self._begun_sec = now
        self._read_end(FAR_NS if now - self._begun_sec > self._patience / 2 else PUBLISHER_REACH_NS)
        waiting = self._queue.waiting()
        if self._queue.epoch != self._epoch:
            return None
        streams: dict[_WriterStream, list[_StoredMark]] = {}
        for seen in sorted(self._seen.values()):
            streams.setdefault(seen.stream, []).append(seen)
        bounds = {stream: _just_after(rows[-1].arrival) for stream, rows in streams.items()}
        unseen: dict[Publisher, float] = {}
        for who, live in waiting.items():
            places = self._places(who, live, streams)
            bounds.update(places)
            if not places:
                unseen[who] = live.since
        self._unseen, self._has_seen_live = list(unseen), len(waiting) > len(unseen)
        return bounds if self._is_ready(unseen.values()) else None

    def _read_end(self, reach_ns: int) -> None:
        """Remember the newest rows: the first live messages are among them.

        Args:
            reach_ns: How far after its first live message the rows of a publisher are read, ns.
        """
        firsts = {who: w.messages[0].t for who, w in self._queue.waiting().items()}
        high = max([self._queue.began_ns, *firsts.values()]) + reach_ns
        for row in self._past.rows(self._low, high):
            if row.identity in self._done or row.identity in self._seen:
                continue
            stream = _stream(row)
            if row.received > firsts.get(stream.publisher, high) + reach_ns:
                continue
            wire = self._wire(row)
            if wire is not None:
                mark = MessageFingerprint(row.received, digest_of(wire))
                self._seen[row.identity] = _StoredMark(row.arrival, stream, mark)

    def _places(
        self,
        who: Publisher,
        live: WaitingMessages,
        streams: Mapping[_WriterStream, list[_StoredMark]],
    ) -> dict[_WriterStream, _Arrival]:
        """Return the first row that comes live, for each writer that has stored the publisher.

        A writer that has stored none of its live messages is left out.
        """
        marks = [message.mark for message in live.messages]
        sure = _is_stamped(live.messages[0].header.get("message_definition", ""))
        repeated = live.messages[0].repeated
        places: dict[_WriterStream, _Arrival] = {}
        mine = {s for s in (*streams, *self._last) if s.publisher == who}
        for stream in mine:
            rows = streams.get(stream, [])
            stored = [row.mark for row in rows]
            place = first_live(stored, marks[1:] if repeated else marks, sure)
            if repeated:
                before = stored[:place][-1:] or [self._last.get(stream, MessageFingerprint(0, b""))]
                if before[0].digest == marks[0].digest and (stored or stream in self._last):
                    # Latched: it was published before we subscribed and is stored already.
                    live.messages[0].wanted = False
                    # No row of the stream is left to be yielded: (0, "", 0, "") is before all.
                    places[stream] = _just_after(rows[-1].arrival) if rows else (0, "", 0, "")
            if place is not None:
                places[stream] = rows[place].arrival
        return places

    @property
    def _patience(self) -> float:
        """How long a live message is searched for in the store, s."""
        return PATIENCE_SEC if self._written else DOUBT_SEC if self._doubtful else 0.0

    def _is_ready(self, unseen: Iterable[float]) -> bool:
        """Return whether the search may end.

        Args:
            unseen: Monotonic times at which the publishers came that were not found, s.

        It ends when each publisher's first live message was found or searched for long enough,
        and the messages before it have had time to be stored.
        """
        now = time.monotonic()
        if now - self._begun_sec > MOST_SEC:
            return True
        waits = any(now - max(since, self._begun_sec) < self._patience for since in unseen)
        if waits or not self._connected():
            self._ready_sec = -1.0
            return False
        if self._ready_sec < 0:
            self._ready_sec = now
        return now - self._ready_sec >= (SETTLE_SEC if self._doubtful else 0.0)

    def _remember_live(self, bounds: Mapping[_WriterStream, _Arrival]) -> None:
        """Remember the live messages that may also be read from the store later."""
        self._bounds_by_stream = dict(bounds)
        last = max((bound[0] for bound in bounds.values()), default=0) + PUBLISHER_REACH_NS
        for who, live in self._queue.waiting().items():
            sure = _is_stamped(live.messages[0].header.get("message_definition", ""))
            marks = [message.mark for message in live.messages if message.t <= last]
            self._heard[who] = Live(marks, sure)
        if self._doubtful and bounds:
            self._late_sec = [time.monotonic() + seconds for seconds in LATE_SEC]

    def _is_heard(self, row: StoredRow) -> bool:
        """Return whether a row that was stored only now was also received live."""
        live = self._heard.get(_publisher(row.connection))
        wire = None if live is None else self._wire(row)
        return (
            live is not None
            and wire is not None
            and live.has(MessageFingerprint(row.received, digest_of(wire)))
        )

    def _late(self) -> Iterator[HistoryMessage]:
        """Yield rows before the bounds that were stored after the past had been read.

        If the store does not answer, a warning is logged instead.
        """
        low = max(self._floor, self._queue.began_ns - KEPT_NS)
        times: list[int] = []
        try:
            for row in self._past.rows(low, max(b[0] for b in self._bounds_by_stream.values())):
                bound = self._bounds_by_stream.get(_stream(row))
                if bound is None or row.arrival >= bound or row.identity in self._done:
                    continue
                if not self._is_heard(row):
                    times.append(row.received)
                    yield from self._give(row)
        except CassandraRosError as exc:
            _log.warning(
                "topic %s: messages that were stored late cannot be searched for: %s",
                self._past.topic,
                exc,
            )
        if times:
            _log.warning(
                "topic %s: %d messages of %s to %s were stored late, so they came out of order, "
                "after live ones",
                self._past.topic,
                len(times),
                iso_time(min(times)),
                iso_time(max(times)),
            )

    def _forget(self) -> None:
        """Free what is only needed to find rows that were stored late."""
        for rows in (self._bounds_by_stream, self._heard, self._done, self._last, self._counted):
            rows.clear()

    def _rest(self, bounds: Mapping[_WriterStream, _Arrival]) -> Iterator[HistoryMessage]:
        """Yield the rows before the bounds, merged by time with other publishers' live messages."""
        expected: Counter[Publisher] = Count(
            seen.stream.publisher
            for seen in self._seen.values()
            if seen.arrival < bounds[seen.stream]
        )
        for row in self._past.rows(self._low, max((b[0] for b in bounds.values()), default=0)):
            if self._queue.closed:
                return
            stream = _stream(row)
            bound = bounds.get(stream)
            if bound is None or row.arrival >= bound or row.identity in self._done:
                continue
            if row.identity not in self._seen and self._is_heard(row):
                continue  # stored after the bound had been found
            yield from self._live_before(row.received, expected)
            if row.identity in self._seen:
                expected[stream.publisher] -= 1
            yield from self._give(row)

    def _live_before(self, t: int, expected: Counter[Publisher]) -> Iterator[HistoryMessage]:
        """Yield live messages received before ``t``, ns, up to the first that must wait for rows.

        Args:
            expected: Number of rows that are still to be yielded, by publisher. They come before
                its live messages.
        """
        while True:
            message = self._queue.first()
            if message is None or message.t >= t or expected[message.publisher] > 0:
                return
            self._queue.next_message(0.0)
            if message.wanted:
                yield HistoryMessage(message.t, message.header, message.wire, False)

    def _tell_gaps(self) -> None:
        """Log which messages are missing and where a gap may be."""
        self._count_missing("no recorder stored them")
        if self._newest and not self._doubtful:
            self._warn_of_gap("no recorder is recording it")
        elif self._newest and self._unseen:
            names = ", ".join(who.callerid or "a publisher" for who in self._unseen)
            self._warn_of_gap(f"no messages of {names} are seen to be recorded")
        elif self._newest and not (self._has_seen_live or self._written):
            self._warn_of_gap("no recorder is seen to record it now")

    def _count_missing(self, reason: str) -> None:
        """Count as lost, and log, the messages that the queue dropped and no row has replaced."""
        missing = {
            who: dropped.number - self._counted.get(who, 0)
            for who, dropped in self._queue.dropped.items()
        }
        for who, count in missing.items():
            if count > 0:
                self.lost += count
                _log.error(
                    "%d messages of %s are lost: they came from %s on while stored messages were "
                    "read, the buffer had no room for them, and %s",
                    count,
                    who.callerid or "a publisher",
                    iso_time(self._queue.dropped[who].first.t),
                    reason,
                )

    def _warn_of_gap(self, reason: str) -> None:
        _log.warning(
            "topic %s: %s, so what was sent between the last stored message (%s) and the first "
            "live one (not before %s) may be missing",
            self._past.topic,
            reason,
            iso_time(self._newest),
            iso_time(self._queue.began_ns),
        )


def _just_after(arrival: _Arrival) -> _Arrival:
    """Return the smallest position after that of a row."""
    return (*arrival[:3], arrival[3] + "\0")


@lru_cache(maxsize=256)
def _fields(connection: Connection) -> Mapping[str, str]:
    """Return the header of a stored connection in the form of a live one."""
    fields = connection.fields.items()
    return {name: value.decode("utf-8", "surrogateescape") for name, value in fields}


def _stream(row: StoredRow) -> _WriterStream:
    return _WriterStream(_publisher(row.connection), row.node, split_seq(row.seq)[0])


@lru_cache(maxsize=1024)
def _publisher(connection: Connection) -> Publisher:
    return Publisher(connection.callerid, connection.type, connection.md5sum)


@lru_cache(maxsize=256)
def _is_stamped(definition_text: str) -> bool:
    """Return whether messages of a type begin with a Header, so that no two of them are equal."""
    return starts_with_header(definition_text)
