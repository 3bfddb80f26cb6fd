# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The recorder without ROS: serialised messages in from any thread, rows out by one.

A callback only stamps, counts and queues, so no publisher waits for the store. One thread writes;
another makes tables while the messages of their topics wait. What does not fit into the buffer, or
cannot be stored, is counted by topic and reason.
"""

from __future__ import annotations

import logging
import math
import threading
import time
import weakref
from collections import Counter
from concurrent.futures import wait
from functools import partial
from typing import Callable, Mapping, MutableMapping, Optional, Sequence, Tuple

from cassandra_ros.errors import CassandraRosError, ClockNotSet, StoreUnavailable, WriteFailed
from cassandra_ros.keys import COUNTER_BITS, SECOND_NS, new_writer_id
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.places.run_index import RobotRun
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.message_buffer import Buffer, Feed, Item, Source
from cassandra_ros.recording.place_keeper import PlaceKeeper
from cassandra_ros.recording.store_future import NO_STORE, Store, is_there, store_future
from cassandra_ros.recording.tables import TableMaker, connect
from cassandra_ros.recording.topic_counts import Counts, TopicReport
from cassandra_ros.recording.topic_settings import Settings, TopicSettings
from cassandra_ros.tables.context_blob import RunContext
from cassandra_ros.tables.directory import Lengths
from cassandra_ros.tables.registry import LossKind, Run
from cassandra_ros.topics.message_writer import Handle, MessageWriter, make_writer

_log = logging.getLogger(__name__)

DEFAULT_BUFFER_BYTES = 256 * 1024 * 1024
BLOCK_SEC = 0.5
BATCH_ITEMS = 256
BATCH_BYTES = 1024 * 1024
POLL_SEC = 0.05
GIVE_UP_SEC = 300.0
"""How long a store that does not answer is waited for when the recording ends."""
MAX_FEEDS = 4096
"""Connections remembered by their header object; publishers come and go for days."""
LAST_WORD_SEC = 2.0
"""How long a recorder that drops what waits tries to tell the store so."""
STORE_POLL_SEC = 0.2
"""Interval at which a recording that waits for the store checks whether it is ended, s."""
NO_STORE_SEC = 2.0
"""How long the store may be missing before the recording tells what it keeps in memory, s."""
TELL_SEC = 60.0
"""Interval at which it tells so again, s."""
SAVE_SEC = 2.0
"""How often losses are written while messages are being lost."""
MAX_STEP_BACK_NS = SECOND_NS
"""A clock that goes back further is warned of."""

_Sources = MutableMapping[Tuple[str, bytes], Source]
Kept = Tuple[str, Mapping[str, str], bytes, int]
"""Topic, connection header, serialised message and time of arrival, ns."""


class Recording:
    """Stores messages as they arrive: one run.

    Args:
        store: The catalog of the connected keyspace, or a future of it: what comes before it
            answers is kept in the buffer.
        clock: Returns the time of arrival, ns; raises ClockNotSet while it is unknown.
        format: As addTopic takes it, for topics of which the settings say nothing.
        settings: How each topic is recorded; None = as ``format`` says.
        filters: Which messages are left out; None = those that the settings say.
        node: The robot or entity that is recorded.
        buffer_bytes: Bound of all messages that wait; the oldest are dropped. 0 = none.
        block_sec: How long a message waits for others in a block of format packed.
        limit: Record only so many messages of each topic; 0 = all.
        name, labels: Of the run in the store.
        restored: Messages that ``restore`` will bring: they come before those that arrive.
        places: Note where the robot is, where that is recorded; see PlaceKeeper.
    """

    _refusal = ""
    """Why nothing may be stored for now: what comes is lost; '' = it may."""
    problem = ""
    """Why the store will never take this run: all of it is lost; '' = it does, or may."""
    _context: Optional[RunContext] = None

    def __init__(
        self,
        store: Store,
        *,
        clock: Callable[[], int] = time.time_ns,
        format: Optional[str] = None,
        settings: Optional[Settings] = None,
        filters: Optional[Filters] = None,
        node: str = "",
        buffer_bytes: int = DEFAULT_BUFFER_BYTES,
        limit: int = 0,
        block_sec: float = BLOCK_SEC,
        name: str = "",
        labels: Optional[Mapping[str, str]] = None,
        restored: int = 0,
        places: bool = True,
    ) -> None:
        self._store = store_future(store)
        self._clock = clock
        self._settings = settings or Settings(TopicSettings(format))
        self._filters = filters or Filters(self._settings, node)
        self.node, self.name, self._labels = node, name, dict(labels or {})
        self._limit, self._block_sec = limit, block_sec
        self._before: Mapping[str, int] = {}
        """Messages by topic that count for the limit already."""
        self._lock = threading.Lock()
        self._accepting, self._counter, self._latest = True, restored, 0
        self._feeds: dict[int, Feed] = {}
        # They are held by feeds, queued messages and waiting lists.
        self._sources: _Sources = weakref.WeakValueDictionary()
        self.writer_id = new_writer_id()
        self._losses = LossLog(node, self.writer_id)
        self._places = PlaceKeeper(
            self._store, RobotRun(node, self.writer_id), self._losses, places
        )
        self._counts = Counts(self._losses)
        self._writers: list[MessageWriter] = []
        """Empty until the store answers."""
        self._gives_up = math.inf
        """Until when the store is waited for after the end; monotonic."""
        self._buffer, self._buffer_bytes = Buffer(buffer_bytes), buffer_bytes
        self._most_waiting, self._waiting_bytes = buffer_bytes // 2 or 2**63, 0
        self._waiting: list[Source] = []
        if self._store.done():
            self._open()
        self._tables = TableMaker(self._connect, self._buffer.wake)
        self._start()

    def _start(self) -> None:
        self._ended, self._saving = threading.Event(), threading.Lock()
        self._thread = self._thread_of(self._run, "recorder-writer")
        self._thread_of(self._keep, "recorder-losses")

    def _open(self) -> None:
        """Begin the run in the store; raises what the store raises."""
        self._writers.append(self._make_writer(self.writer_id))
        self._store.result().keyspace.cassandra.outage.tell_waiting(self._waiting_for_long)

    @property
    def opened(self) -> bool:
        """Whether the run has begun in the store: before, what comes waits in memory."""
        return bool(self._writers)

    @property
    def is_held_up(self) -> bool:
        """Whether the store does not answer now."""
        return not self.opened or self._store.result().keyspace.cassandra.outage.seconds > 0

    @staticmethod
    def _thread_of(work: Callable[[], None], name: str) -> threading.Thread:
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        return thread

    def refuse(self, reason: str) -> None:
        """Store nothing that comes from now on, for this reason; '' = store it again."""
        self._refusal = reason

    def expect(self, topic: str) -> None:
        """Let a topic appear in the reports even if nothing ever comes."""
        self._counts.expect(topic)

    def received(
        self, topic: str, header: Mapping[str, str], wire: bytes, *, paused: bool = False
    ) -> bool:
        """Take one serialised message that has just arrived. Never waits for the store.

        The header is the same object for all messages of a connection.

        Args:
            paused: Only count it.

        Returns:
            Whether it was looked at; False where the recording has ended.
        """
        # Stamp and counter together: rospy has a thread per publisher, and the order of the
        # stamps must be that of the counters.
        with self._lock:
            if not self._accepting:
                return False
            if self.is_complete(topic):
                return True
            self._counts.received(topic, wire)
            try:
                lost = self._take(topic, header, wire, paused)
            except Exception as exc:  # noqa: BLE001 - rospy would only log it: counted
                self._lose(topic, LossKind.MISTAKE, _mistake(exc))
                return True
        for item in lost:
            self._lose(item.source.topic, LossKind.BUFFER_FULL, "option -b", item.t)
        return True

    def _take(
        self, topic: str, header: Mapping[str, str], wire: bytes, paused: bool
    ) -> Sequence[Item]:
        """Stamp and queue a message; return what is lost by that."""
        feed = self._feed(topic, header)
        self._counts.attribute(topic, wire, feed)
        if paused:
            self._counts.leave_out(topic, paused=True)
            return ()
        try:
            t = self._clock()
        except ClockNotSet as exc:
            self._lose(topic, LossKind.NO_CLOCK, str(exc), time.time_ns())
            return ()
        if t < self._latest - MAX_STEP_BACK_NS:
            _log.warning(
                "time went back by %.3f s: what comes now is kept at times that lie before what "
                "was recorded last",
                (self._latest - t) / SECOND_NS,
            )
        self._latest = t
        if not self._filters.passes(topic, header, t, wire):
            self._counts.leave_out(topic, paused=False)
            return ()
        if self._refusal:
            self._lose(topic, LossKind.REFUSED, self._refusal, t)
            return ()
        return self._put(feed, t, wire)

    def _put(self, feed: Feed, t: int, wire: bytes) -> Sequence[Item]:
        counter = self._counter
        self._counter += 1
        self._places.take(feed.source, t, wire)
        return self._buffer.put(Item(feed.source, t, counter, wire))

    def follow(self, kept: Kept) -> None:
        """Take a message that was stamped and filtered already; never waits for the store."""
        topic, header, wire, t = kept
        with self._lock:
            if not self._accepting:
                return
            self._counts.received(topic, wire)
            feed = self._feed(topic, header)
            self._counts.attribute(topic, wire, feed)
            lost = self._put(feed, t, wire)
        for item in lost:
            self._lose(item.source.topic, LossKind.BUFFER_FULL, "option -b", item.t)

    def restore(self, kept: Sequence[Kept]) -> None:
        """Take messages that came before the recording began; waits for the store.

        They must be as many as the constructor was told, in the order of their arrival.
        """
        # All at once: what is still to be taken when this is given up is lost, too.
        for topic, _, wire, _ in kept:
            self._counts.received(topic, wire)
        for counter, (topic, header, wire, t) in enumerate(kept):
            with self._lock:
                feed = self._feed(topic, header)
                self._counts.attribute(topic, wire, feed)
                self._places.take(feed.source, t, wire)
            self._buffer.wait_for_room(len(wire))
            for item in self._buffer.put(Item(feed.source, t, counter, wire)):
                self._lose(item.source.topic, LossKind.BUFFER_FULL, "option -b", item.t)

    def unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        """Note that publishers of a topic may have sent what never came here.

        Args:
            first_ns, last_ns: When that may have been, ns, both included.
        """
        self._counts.unheard(topic, (last_ns - first_ns) / SECOND_NS)
        self.lose(topic, LossKind.UNHEARD, 0, first_ns, last_ns)

    def lose(self, topic: str, kind: LossKind, messages: int, first_ns: int, last_ns: int) -> None:
        """Note messages that never came here; 0 = nobody knows how many."""
        self._counts.lost(topic, messages, kind, first_ns, last=last_ns)

    def now(self) -> int:
        """Tell the time as messages are stamped, ns; the wall clock's while it is unknown."""
        try:
            return self._clock()
        except ClockNotSet:
            return time.time_ns()

    def _lose(self, topic: str, kind: LossKind, detail: str, t: Optional[int] = None) -> None:
        self._counts.lost(topic, 1, kind, self.now() if t is None else t, detail)

    def _feed(self, topic: str, header: Mapping[str, str]) -> Feed:
        feed = self._feeds.get(id(header))
        if feed is None:
            connection = live_connection(topic, header)
            key = (topic, connection.header)
            source = self._sources.setdefault(key, Source(connection))
            if len(self._feeds) >= MAX_FEEDS:
                self._feeds.pop(next(iter(self._feeds)))
            feed = self._feeds[id(header)] = Feed(header, source)
        return feed

    def is_complete(self, topic: str) -> bool:
        """Say whether a topic has all the messages that the limit allows."""
        if not self._limit:
            return False
        return self._before.get(topic, 0) + self._counts.kept(topic) >= self._limit

    def hand_over(self, later: Recording, switch: Callable[[], None]) -> None:
        """Take no more messages; what comes from now on is the later one's, whom switch names."""
        with self._lock:
            self._accepting = False
            if self._limit:
                later._go_on_counting(self._kept())
            later.refuse(self._refusal)
            switch()

    def _go_on_counting(self, before: Mapping[str, int]) -> None:
        """Count messages of an earlier run, by topic, for the limit too."""
        self._before = before

    def _kept(self) -> dict[str, int]:
        """Return how many messages of each topic count for the limit by now."""
        found = Counter(self._before)
        for report in self.reports():
            found[report.topic] += report.received - report.left_out - report.paused
        return dict(found)

    @property
    def received_bytes(self) -> int:
        """Serialised bytes that have come."""
        return self._counts.total_bytes

    @property
    def held_bytes(self) -> int:
        """How much waits for the store, in bytes of memory."""
        return self._buffer.held_bytes

    def count(self, topic: str) -> int:
        """Return how many messages of a topic arrived."""
        return self._counts.of(topic)

    def _run(self) -> None:
        why = self._await_store()
        if why:
            self._lose_all(why)
        else:
            while not self._step():
                pass
        self._tables.close()

    def _await_store(self) -> str:
        """Open the run as soon as the store answers; return why that cannot be, '' = it is open."""
        begun = time.monotonic()
        told = begun + NO_STORE_SEC - TELL_SEC
        while not self.opened:
            if self._is_too_late():
                return NO_STORE
            try:
                if wait([self._store], STORE_POLL_SEC).done:
                    self._open()
                    break
            except StoreUnavailable as exc:
                _log.debug("the run is opened later: %s", exc)
                time.sleep(STORE_POLL_SEC)
            except CassandraRosError as exc:
                self.problem = str(exc)
                return self.problem
            except Exception as exc:  # noqa: BLE001 - our mistake: the messages are counted
                _log.exception("the run could not be opened in the store")
                self.problem = _mistake(exc)
                return self.problem
            if time.monotonic() >= told + TELL_SEC and self._tell_of_waiting("no store yet"):
                told = time.monotonic()
        if told > begun:
            self._tell_of_waiting(f"the store answers after {time.monotonic() - begun:.0f} s")
        if self._buffer.closed:  # it ended meanwhile
            self._hurry()
        return ""

    def _is_too_late(self) -> bool:
        """Say whether the recording has ended and need not wait for the store."""
        if not self._buffer.closed:
            return False
        return not self._buffer.held_bytes or time.monotonic() > self._gives_up

    def _tell_of_waiting(self, what: str) -> str:
        """Tell how many messages wait, where any do; return the text."""
        text = self._waiting_for_long()
        if text:
            _log.warning("%s: %s", what, text)
        return text

    def _lose_all(self, why: str) -> None:
        """Count what came, and comes, as lost: the run could not be opened."""
        while not self._buffer.ended:
            for item in self._buffer.take(BATCH_ITEMS, BATCH_BYTES, POLL_SEC):
                self._lose(item.source.topic, LossKind.AT_END, why, item.t)
                self._buffer.release(item)

    def _step(self) -> bool:
        """Move some messages on; return whether all are gone."""
        for item in self._buffer.take(BATCH_ITEMS, BATCH_BYTES, POLL_SEC):
            self._route(item)
        while self._tables.decided:
            source = self._tables.decided.popleft()
            self._waiting.remove(source)
            while source.waiting:
                self._route(self._released(source))
        ending = self._buffer.ended
        for source in self._waiting:
            if not source.submitted and (ending or source.is_ripe()):
                source.submit()
                self._tables.make(source)
        if ending:  # a store that is gone is not waited for much longer
            self._tables.hurry()
        return ending and not self._waiting

    def _route(self, item: Item) -> None:
        source = item.source
        if source.handle is None and not source.error:
            if not source.waiting and not source.submitted:
                self._waiting.append(source)
            source.hold(item)
            self._waiting_bytes += item.nbytes
            # What waits for tables that cannot be made stays within half of the buffer: topics
            # with one go on.
            while self._is_over(source):
                old = self._released(source)
                self._buffer.release(old)
                self._lose(source.topic, LossKind.TABLE_LATE, "", old.t)
            return
        if source.handle is None:
            self._lose(source.topic, LossKind.NO_TABLE, source.error, item.t)
        else:
            self._write(item, source.handle)
        self._buffer.release(item)

    def _is_over(self, source: Source) -> bool:
        """Say whether the oldest message of a source that waits for its table is to be dropped."""
        return source.told and self._waiting_bytes > self._most_waiting and len(source.waiting) > 1

    def _released(self, source: Source) -> Item:
        item = source.waiting.popleft()
        self._waiting_bytes -= item.nbytes
        return item

    def _write(self, item: Item, handle: Handle) -> None:
        generation, counter = divmod(item.counter, 1 << COUNTER_BITS)
        source = item.source
        try:
            while len(self._writers) <= generation:
                self._writers.append(self._make_writer(new_writer_id()))
            writer = self._writers[generation]
            if generation:  # the counter ran over: another writer, with handles of its own
                handle = connect(writer, source.connection, Lengths(), self._settings)
            writer.write(handle, item.t, counter, item.wire)
        except CassandraRosError as exc:
            self._lose(source.topic, LossKind.REFUSED, str(exc), item.t)
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("a message of topic %s could not be stored", source.topic)
            self._lose(source.topic, LossKind.MISTAKE, _mistake(exc), item.t)

    def _connect(self, source: Source) -> Handle:
        """Make the table of a source, on the thread of the table maker."""
        return connect(self._writers[0], source.connection, source.lengths(), self._settings)

    def _make_writer(self, number: int) -> MessageWriter:
        run = Run(
            self.node,
            number,
            "recording",
            name=self.name,
            format=self._settings.default.format or "",
            labels=self._labels,
        )
        return make_writer(
            self._store.result().keyspace,
            writer_id=number,
            format=self._settings.default.format,
            node=self.node,
            ttl=self._settings.default.ttl,
            run=run,
            block_sec=self._block_sec,
            # The buffer is the bound: an outage costs nothing while it lasts.
            give_up_after_sec=math.inf,
            on_loss=self._refused,
        )

    def _refused(self, topic: str, messages: int, error: CassandraRosError) -> None:
        first, last = (error.first_ns, error.last_ns) if isinstance(error, WriteFailed) else (0, 0)
        first, last = first or self.now(), last or self.now()
        self._counts.lost(topic, messages, LossKind.REFUSED, first, str(error), last)

    def put_context(self, context: RunContext) -> None:
        """Keep parameters and node graph with the run, in the background."""
        self._context = context

    def _keep(self) -> None:
        """Write losses and the context, on a thread of its own, until the end."""
        while not self._ended.wait(SAVE_SEC):
            self._save()

    def _save(self) -> None:
        if not is_there(self._store):
            return
        registry = self._store.result().keyspace.registry
        try:
            # One at a time: what is older must not be written over what is newer.
            with self._saving:
                if self._context is not None:
                    registry.put_context(self.writer_id, self.node, self._context)
                    self._context = None
                for loss in self._losses.unsaved():
                    registry.put_loss(loss)
                    self._losses.saved(loss)
        except StoreUnavailable as exc:
            _log.debug("losses are written later: %s", exc)
        except CassandraRosError as exc:
            _log.warning("losses or parameters of the run cannot be kept: %s", exc)

    def stop(self, timeout_sec: Optional[float] = None) -> bool:
        """Take no more messages and store what is here; say whether all is stored or lost.

        It returns after so long in any case (None = never); call again to go on waiting.
        """
        with self._lock:
            self._accepting = False
        self._gives_up = min(self._gives_up, time.monotonic() + GIVE_UP_SEC)
        self._buffer.close()
        self._hurry()
        self._thread.join(timeout_sec)
        return not self._thread.is_alive()

    def _hurry(self) -> None:
        for writer in list(self._writers):
            writer.hurry(GIVE_UP_SEC)

    def close(self) -> list[TopicReport]:
        """Stop, close the buckets, note the end of the run; return the final report."""
        self.stop()
        if not self._ended.is_set():
            for writer in self._writers:
                _try_to(writer.flush)
            self._settle()
            self._save()
            self._places.close()
        lost = {report.topic: report.lost for report in self.reports() if report.lost}
        for writer in self._writers:
            _try_to(partial(writer.close, lost))
        return self.reports()

    def waiting(self) -> tuple[int, int]:
        """Return how many messages wait for the store, and about how many bytes they take."""
        messages = sum(report.waiting for report in self.reports())
        nbytes = self._buffer.held_bytes + sum(w.pending_bytes for w in list(self._writers))
        return max(messages, 0), nbytes

    def _waiting_for_long(self) -> str:
        messages, nbytes = self.waiting()
        if not messages:
            return ""
        text = f"{messages} messages ({nbytes / 1e6:.1f} MB) wait"
        if not self.is_held_up:
            return text
        bound = f"{self._buffer_bytes >> 20} MB wait" if self._buffer_bytes else "memory is full"
        return (
            f"{text}; they are kept in memory until {bound}, then the oldest are dropped; once the "
            f"recording ends they are tried for {GIVE_UP_SEC:.0f} s"
        )

    def abandon(self) -> list[TopicReport]:
        """Count as lost what is not stored by now, and wait for nothing; return the report."""
        self._settle()
        # The store is told if it answers; the process may end meanwhile.
        self._thread_of(self._save, "recorder-losses").join(LAST_WORD_SEC)
        return self.reports()

    def _settle(self) -> None:
        self._ended.set()
        self._counts.settle(self._stored(), self._latest or time.time_ns())

    def reports(self) -> list[TopicReport]:
        """Describe what became of each topic so far."""
        return self._counts.reports(self._stored())

    def _stored(self) -> Counter[str]:
        stored: Counter[str] = Counter()
        for writer in self._writers:
            stored.update({topic: part.stored for topic, part in writer.stats().items()})
        return stored


def _mistake(exc: Exception) -> str:
    return f"internal error: {type(exc).__name__}: {exc}"


def _try_to(work: Callable[[], None]) -> None:
    # The closing table must come whatever happens: it is where losses are told.
    try:
        work()
    except CassandraRosError as exc:
        _log.error("the recording could not be closed properly: %s", exc)
