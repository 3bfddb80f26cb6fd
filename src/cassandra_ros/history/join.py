# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The past of a topic and then its live messages: each once, in order, while it is recorded.

Live messages wait from the first moment on. What was stored clearly before them is given first.
Then the end of what is stored is compared with them until each publisher's place is found, and
everything before it had time to be stored; a recorder is some tenths of a second behind.
"""

from __future__ import annotations

import logging
import time
from collections import Counter as Count
from functools import lru_cache
from typing import (
    Callable,
    Counter,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

from cassandra_ros.errors import CassandraRosError, CorruptMessage, MessageNotFound
from cassandra_ros.history.alignment import Live, Mark, digest_of, first_live
from cassandra_ros.history.live_queue import LiveQueue, Publisher, Waiting
from cassandra_ros.history.past import Past
from cassandra_ros.keys import SECOND_NS, split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.recording.message_buffer import starts_with_header
from cassandra_ros.topics.stored_row import Place, StoredRow

_log = logging.getLogger(__name__)

WINDOW_NS = 2 * SECOND_NS
"""What was received so long before us is old, unless a clock is wrong."""
REACH_NS, FAR_NS = 5 * SECOND_NS, 60 * SECOND_NS
"""How far behind its first live message a publisher's place is looked for; at last, with a clock
that is ahead of ours."""
POLL_SEC = 0.1
SETTLE_SEC = 1.0
"""How long what is still on its way into the store is waited for when all places are found."""
PATIENCE_SEC = 10.0
"""How long a message that came live is looked for in the store while its topic is written."""
DOUBT_SEC = 3.0
"""And while nobody is seen to, but some recording has not ended: its table may be being made."""
MOST_SEC = 60.0
"""Then we go live in any case."""
LOOK_SEC = 2.0
LATE_SEC = (5.0, 65.0)
"""How long after going live it is looked for rows that were stored late: a request that failed is
sent again, for 60 s by default, while those after it are stored."""
KEPT_NS = 10 * SECOND_NS
"""So far back it is known which rows were given."""
ROOM = 10_000
"""So many rows more than those may be remembered."""

_Arrival = Tuple[int, str, int, str]


class Heard(NamedTuple):
    """A message of the past or of now."""

    t: int
    """When it was received, ns."""
    header: Mapping[str, str]
    """The fields of its connection's header."""
    wire: bytes
    stored: bool


class _Stream(NamedTuple):
    """What one writer stored of one publisher."""

    publisher: Publisher
    node: str
    writer: int


class _Seen(NamedTuple):
    """A row at the end of what is stored."""

    arrival: _Arrival
    stream: _Stream
    mark: Mark


class History:
    """Yields the past of a topic from a time on, then what comes live; see the module.

    Args:
        past: What is stored.
        queue: What comes live; it was filled before this begins to read.
        since: Tells from the time, ns, since when stored messages are given, ns.
        connected: Says whether the publishers that exist are connected to the queue.
    """

    def __init__(
        self,
        past: Past,
        queue: LiveQueue,
        since: Callable[[int], int],
        connected: Callable[[], bool],
    ) -> None:
        self._past, self._queue, self._connected = past, queue, connected
        self._since, self._low = since, 0
        self._done: Dict[Place, int] = {}
        self._floor, self._room = 0, ROOM
        """From this time on all rows that were given are in _done, ns; when to make room there."""
        self._over: Dict[_Stream, _Arrival] = {}
        self._heard: Dict[Publisher, Live] = {}
        self._late_sec: List[float] = []
        self._seen: Dict[Place, _Seen] = {}
        self._newest = 0
        self._last: Dict[_Stream, Mark] = {}
        self._counted: Dict[Publisher, int] = {}
        self._looked = -LOOK_SEC
        self._written = self._doubtful = False
        self._unseen: List[Publisher] = []
        self._found = False
        self._epoch, self._begun_sec, self._ready_sec = -1, -1.0, -1.0
        self.live = False
        """Whether the past is done."""
        self.lost = 0
        """Messages that are known to be missing."""

    def messages(self) -> Iterator[Heard]:
        """Yield message by message until the queue is closed."""
        try:
            yield from self._all_past()
        except CassandraRosError as exc:
            if not self._queue.closed:
                _log.error(
                    "the stored messages cannot be read on from %s, so there may be a gap up to "
                    "the first live one: %s", iso_time(self._newest), exc,
                )  # fmt: skip
                self._queue.join(self._queue.epoch)
        self.live = True
        self._seen.clear()
        while not self._queue.closed:
            message = self._queue.take(1.0)
            if message is not None and message.wanted:
                yield Heard(message.t, message.header, message.wire, False)
            if self._late_sec and time.monotonic() > self._late_sec[0]:
                del self._late_sec[0]
                yield from self._late()
            elif not self._late_sec and self._done:
                self._forget()

    # ---------------------------------------------------------------- the past

    def _all_past(self) -> Iterator[Heard]:
        while not self._queue.begin():  # under simulated time, until there is one
            self._queue.wait(POLL_SEC)
            if self._queue.closed:
                return
        self._low = self._floor = self._since(self._queue.began_ns)
        reason = ""
        if not self._past.exists() and not self._past.may_be_written():
            reason = "nothing is stored of it, and nothing is recorded"
        elif self._low > self._queue.now_ns():
            reason = f"{iso_time(self._low)}, since when stored messages are wanted, is to come"
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
                self._go_over(bounds)
                yield from self._rest(bounds)
                self._account()
                return

    def _warn_of_losses(self) -> None:
        found = self._past.losses(self._low)
        if found:
            _log.warning(
                "topic %s: %d messages or more were not recorded between %s and %s (%s), so the "
                "past lacks them; cassandra_bag info lists them",
                self._past.topic, sum(loss.count for loss in found),
                iso_time(min(loss.first_ns for loss in found)),
                iso_time(max(loss.last_ns for loss in found)),
                ", ".join(sorted({loss.kind.value for loss in found})),
            )  # fmt: skip

    def _begin(self) -> None:
        """Take note of it where live messages were forgotten."""
        if self._epoch != self._queue.epoch:
            self._epoch = self._queue.epoch
            self._begun_sec = self._ready_sec = -1.0

    def _old(self) -> Iterator[Heard]:
        """Give what was stored clearly before the live messages."""
        high = self._queue.began_ns - WINDOW_NS
        heads = {who: w.messages[0].mark for who, w in self._queue.waiting().items()}
        last = None
        for row in self._past.rows(self._low, high):
            self._look()
            if self._queue.closed:
                return
            if row.place not in self._done:
                if self._is_head(row, heads):
                    break
                yield from self._give(row)
            last = row.received
            self._make_room(last)
        if last is not None:
            self._low = max(self._low, last - WINDOW_NS)

    def _make_room(self, last: int) -> None:
        """Remember the last given rows alone: of a past of days they would not fit into memory."""
        if len(self._done) > self._room:
            self._floor = max(self._floor, last - KEPT_NS)
            self._done = {p: t for p, t in self._done.items() if t >= self._floor}
            self._room = 2 * len(self._done) + ROOM

    def _is_head(self, row: StoredRow, heads: Mapping[Publisher, Mark]) -> bool:
        """Say whether an old row is the first live message: the recorder's clock is behind ours."""
        if not heads:
            return False
        head = heads.get(_publisher(row.connection))
        if head is None or not _is_stamped(row.connection.definition_text):
            return False
        wire = self._wire(row)
        return wire is not None and digest_of(wire) == head.digest

    def _wire(self, row: StoredRow) -> Optional[bytes]:
        try:
            return row.wire
        except MessageNotFound:
            return None
        except CorruptMessage as exc:
            self.lost += row.place not in self._done
            self._done[row.place] = row.received
            _log.error("a stored message is left out: %s", exc)
            return None

    def _give(self, row: StoredRow) -> Iterator[Heard]:
        wire = self._wire(row)
        if wire is None:
            return
        self._done[row.place] = row.received
        self._newest = max(self._newest, row.received)
        self._seen.pop(row.place, None)
        stream = _stream(row)
        owed = self._queue.owed.get(stream.publisher)
        mark = self._last[stream] = Mark(row.received, digest_of(wire))
        if stream.publisher in self._counted:
            self._counted[stream.publisher] += 1
        elif owed is not None and mark.digest == owed.first.digest:
            self._counted[stream.publisher] = 1
        yield Heard(row.received, _fields(row.connection), wire, True)

    def _look(self) -> None:
        """See from time to time whether somebody writes the topic."""
        now = time.monotonic()
        if now - self._looked >= LOOK_SEC:
            self._looked = now
            self._written = self._past.is_written(self._queue.now_ns())
            self._doubtful = self._written or self._past.may_be_written()
            self._queue.note_recorded(self._written)

    # ---------------------------------------------------------------- the place

    def _bounds(self) -> Optional[Dict[_Stream, _Arrival]]:
        """Find for each stream the first row that is not given; None while that is not known."""
        self._look()
        now = time.monotonic()
        if self._begun_sec < 0:
            self._begun_sec = now
        self._read_end(FAR_NS if now - self._begun_sec > self._patience / 2 else REACH_NS)
        waiting = self._queue.waiting()
        if self._queue.epoch != self._epoch:
            return None
        streams: Dict[_Stream, List[_Seen]] = {}
        for seen in sorted(self._seen.values()):
            streams.setdefault(seen.stream, []).append(seen)
        bounds = {stream: _behind(rows[-1].arrival) for stream, rows in streams.items()}
        unseen: Dict[Publisher, float] = {}
        for who, live in waiting.items():
            places = self._places(who, live, streams)
            bounds.update(places)
            if not places:
                unseen[who] = live.since
        self._unseen, self._found = list(unseen), len(waiting) > len(unseen)
        return bounds if self._is_ready(unseen.values()) else None

    def _read_end(self, reach_ns: int) -> None:
        """Take note of the rows among which the live messages begin."""
        firsts = {who: w.messages[0].t for who, w in self._queue.waiting().items()}
        high = max([self._queue.began_ns, *firsts.values()]) + reach_ns
        for row in self._past.rows(self._low, high):
            if row.place in self._done or row.place in self._seen:
                continue
            stream = _stream(row)
            if row.received > firsts.get(stream.publisher, high) + reach_ns:
                continue
            wire = self._wire(row)
            if wire is not None:
                mark = Mark(row.received, digest_of(wire))
                self._seen[row.place] = _Seen(row.arrival, stream, mark)

    def _places(
        self, who: Publisher, live: Waiting, streams: Mapping[_Stream, List[_Seen]]
    ) -> Dict[_Stream, _Arrival]:
        """Find a publisher's live messages in what each writer stored of it."""
        marks = [message.mark for message in live.messages]
        sure = _is_stamped(live.messages[0].header.get("message_definition", ""))
        repeated = live.messages[0].repeated
        found: Dict[_Stream, _Arrival] = {}
        mine = {s for s in (*streams, *self._last) if s.publisher == who}
        for stream in mine:
            rows = streams.get(stream, [])
            stored = [row.mark for row in rows]
            place = first_live(stored, marks[1:] if repeated else marks, sure)
            if repeated:
                before = stored[:place][-1:] or [self._last.get(stream, Mark(0, b""))]
                if before[0].digest == marks[0].digest and (stored or stream in self._last):
                    # Latched: it was sent before we came, and is stored.
                    live.messages[0].wanted = False
                    found[stream] = _behind(rows[-1].arrival) if rows else (0, "", 0, "")
            if place is not None:
                found[stream] = rows[place].arrival
        return found

    @property
    def _patience(self) -> float:
        return PATIENCE_SEC if self._written else DOUBT_SEC if self._doubtful else 0.0

    def _is_ready(self, unseen: Iterable[float]) -> bool:
        """Say whether the places are found, or will not be, and what is before them is stored."""
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

    # ---------------------------------------------------------------- over to now

    def _go_over(self, bounds: Mapping[_Stream, _Arrival]) -> None:
        """Take note of what comes live and may come from the store, too, and later."""
        self._over = dict(bounds)
        last = max((bound[0] for bound in bounds.values()), default=0) + REACH_NS
        for who, live in self._queue.waiting().items():
            sure = _is_stamped(live.messages[0].header.get("message_definition", ""))
            marks = [message.mark for message in live.messages if message.t <= last]
            self._heard[who] = Live(marks, sure)
        if self._doubtful and bounds:
            self._late_sec = [time.monotonic() + seconds for seconds in LATE_SEC]

    def _is_heard(self, row: StoredRow) -> bool:
        """Say whether a row that has only just been stored came live, too."""
        live = self._heard.get(_publisher(row.connection))
        wire = None if live is None else self._wire(row)
        return (
            live is not None and wire is not None and live.has(Mark(row.received, digest_of(wire)))
        )

    def _late(self) -> Iterator[Heard]:
        """Give what was still on its way into the store when the past was done."""
        low = max(self._floor, self._queue.began_ns - KEPT_NS)
        found: List[int] = []
        try:
            for row in self._past.rows(low, max(b[0] for b in self._over.values())):
                bound = self._over.get(_stream(row))
                if bound is None or row.arrival >= bound or row.place in self._done:
                    continue
                if not self._is_heard(row):
                    found.append(row.received)
                    yield from self._give(row)
        except CassandraRosError as exc:
            _log.warning(
                "topic %s: it cannot be looked for messages that were stored late: %s",
                self._past.topic, exc,
            )  # fmt: skip
        if found:
            _log.warning(
                "topic %s: %d messages of %s to %s were stored late, so they came out of order, "
                "after live ones",
                self._past.topic, len(found), iso_time(min(found)), iso_time(max(found)),
            )  # fmt: skip

    def _forget(self) -> None:
        for each in (self._over, self._heard, self._done, self._last, self._counted):
            each.clear()

    def _rest(self, bounds: Mapping[_Stream, _Arrival]) -> Iterator[Heard]:
        """Give the stored rows before the bounds, and among them what other publishers sent."""
        left: Counter[Publisher] = Count(
            seen.stream.publisher
            for seen in self._seen.values()
            if seen.arrival < bounds[seen.stream]
        )
        for row in self._past.rows(self._low, max((b[0] for b in bounds.values()), default=0)):
            if self._queue.closed:
                return
            stream = _stream(row)
            bound = bounds.get(stream)
            if bound is None or row.arrival >= bound or row.place in self._done:
                continue
            if row.place not in self._seen and self._is_heard(row):
                continue  # stored since the place was found
            yield from self._live_before(row.received, left)
            if row.place in self._seen:
                left[stream.publisher] -= 1
            yield from self._give(row)

    def _live_before(self, t: int, left: Counter[Publisher]) -> Iterator[Heard]:
        while True:
            message = self._queue.first()
            if message is None or message.t >= t or left[message.publisher] > 0:
                return
            self._queue.take(0.0)
            if message.wanted:
                yield Heard(message.t, message.header, message.wire, False)

    def _account(self) -> None:
        """Say what is known to be missing, and where a gap may be."""
        missing = {
            who: owed.number - self._counted.get(who, 0) for who, owed in self._queue.owed.items()
        }
        for who, count in missing.items():
            if count > 0:
                self.lost += count
                _log.error(
                    "%d messages of %s are lost: they came from %s on while the past was read, "
                    "there was no room for them, and no recorder stored them",
                    count, who.callerid or "a publisher", iso_time(self._queue.owed[who].first.t),
                )  # fmt: skip
        if self._newest and not self._doubtful:
            self._warn_of_gap("nobody is recording it")
        elif self._newest and self._unseen:
            names = ", ".join(who.callerid or "a publisher" for who in self._unseen)
            self._warn_of_gap(f"what {names} sends is not seen to be recorded")
        elif self._newest and not (self._found or self._written):
            self._warn_of_gap("nobody is seen to record it now")

    def _warn_of_gap(self, reason: str) -> None:
        _log.warning(
            "topic %s: %s, so what was sent between the last stored message (%s) and the first "
            "live one (not before %s) may be missing",
            self._past.topic, reason, iso_time(self._newest), iso_time(self._queue.began_ns),
        )  # fmt: skip


def _behind(arrival: _Arrival) -> _Arrival:
    """Return the place directly behind a row."""
    return (*arrival[:3], arrival[3] + "\0")


@lru_cache(maxsize=256)
def _fields(connection: Connection) -> Mapping[str, str]:
    found = connection.fields.items()
    return {name: value.decode("utf-8", "surrogateescape") for name, value in found}


def _stream(row: StoredRow) -> _Stream:
    return _Stream(_publisher(row.connection), row.node, split_seq(row.seq)[0])


@lru_cache(maxsize=1024)
def _publisher(connection: Connection) -> Publisher:
    return Publisher(connection.callerid, connection.type, connection.md5sum)


@lru_cache(maxsize=256)
def _is_stamped(definition_text: str) -> bool:
    """Say whether messages of a type begin with a Header: no two of them are equal."""
    return starts_with_header(definition_text)
