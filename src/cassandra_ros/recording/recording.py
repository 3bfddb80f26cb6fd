# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One recording, without ROS: it takes serialised messages from any thread; one thread writes rows.

A callback only stamps, counts and queues a message, so that no publisher waits for the store. One
thread writes; another one makes tables while the messages of their topics wait. Messages that do
not fit into the buffer or cannot be stored are counted by topic and reason.
"""

from __future__ import annotations

import logging
import math
import threading
import time
import weakref
from collections import Counter
from concurrent.futures import wait
from contextlib import suppress
from functools import partial
from typing import Callable, Mapping, MutableMapping, Sequence, Tuple

from cassandra_ros.errors import CassandraRosError, ClockNotSet, StoreUnavailable, WriteFailed
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel
from cassandra_ros.keys import COUNTER_BITS, SECOND_NS, new_writer_id
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.places.run_index import RobotRun
from cassandra_ros.recording.backlog import Backlog, OnDisk
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.message_buffer import Buffer, BufferedMessage, Feed, MessageSource
from cassandra_ros.recording.option_values import BLOCK_SEC, DEFAULT_BUFFER_BYTES
from cassandra_ros.recording.place_keeper import PlaceKeeper
from cassandra_ros.recording.recorder_options import SpoolPlan
from cassandra_ros.recording.store_future import NO_STORE, Store, is_there, store_future
from cassandra_ros.recording.table_maker import TableMaker, connect, make_together
from cassandra_ros.recording.topic_counts import Counts, TopicReport
from cassandra_ros.recording.topic_settings import RecordingSettings, settings_as_json
from cassandra_ros.store.tables.context_blob import RunContext
from cassandra_ros.store.tables.lengths import Lengths
from cassandra_ros.store.tables.registry import LossKind, Run
from cassandra_ros.topics.message_writer import Handle, MessageWriter, make_writer
from cassandra_ros.topics.run_finder import describe_runs

_log = logging.getLogger(__name__)

WRITE_ROUND_MESSAGES = 256
"""Maximum number of messages that the writing thread takes at once."""
WRITE_ROUND_BYTES = 1024 * 1024
"""Size of messages at which the writing thread stops taking more at once, bytes."""
POLL_SEC = 0.05
"""Maximum time that the writing thread waits for a message, s."""
GIVE_UP_SEC = 300.0
"""Maximum time after the end in which messages are still tried to be stored, s."""
MAX_FEEDS = 4096
"""Maximum number of connections whose header is remembered: publishers come and go for days."""
LOSSES_WAIT_SEC = 2.0
"""Maximum time in which an abandoned recording tries to store its losses, s."""
STORE_POLL_SEC = 0.2
"""Interval at which a recording that waits for the store checks whether it is ended, s."""
NO_STORE_SEC = 2.0
"""How long the store may be missing before the recording tells what it keeps in memory, s."""
TELL_SEC = 60.0
"""Interval at which it tells so again, s."""
SAVE_SEC = 2.0
"""Interval at which new losses are stored, s."""
SILENT_STORE_SEC = 5.0
"""Time at the end in which the store takes no message, after which they stay in the spool, s."""
SLOW_STORE_SEC = 30.0
"""The same time while no request to the store has failed, s: it may only be slow."""
SPOOL_WAIT_SEC = 30.0
"""Maximum time that an abandoned recording with a spool waits until its messages are there, s."""
MAX_STEP_BACK_NS = SECOND_NS
"""Step back of the clock above which a warning is logged, ns."""

_Sources = MutableMapping[Tuple[str, bytes], MessageSource]
"""Sources by topic and the bytes of the connection header."""
StampedMessage = Tuple[str, Mapping[str, str], bytes, int]
"""Topic, connection header, serialised message and time of reception, ns."""


class Recording:
    """One run: it stores messages as they are received.

    Args:
        store: The catalog of the connected keyspace, or a future of it: until it is connected
            messages wait in the buffer.
        clock: Returns the time of reception, ns; raises ClockNotSet while it is unknown.
        settings: Settings of the topics; None = all values have their defaults.
        filters: Filters that leave messages out; None = those of the settings.
        node: nodeID of the recorded robot.
        buffer_bytes: Maximum memory of all waiting messages, bytes, above which the oldest are
            dropped; 0 = no maximum.
        block_sec: Maximum time that a message waits for others in a block of format packed, s.
        limit: Maximum number of recorded messages of each topic; 0 = all.
        name, labels: Name and labels of the run.
        restored: Number of messages that ``restore`` will add before those that are received.
        places: Whether the places of the robot are indexed, if poses are recorded; see
            PlaceKeeper.
        spool: How messages wait on disk while the store does not keep up; None = in memory only.
    """

    refusal = ""
    """Reason why received messages are not stored for now and are lost; '' = they are stored."""
    problem = ""
    """Reason why the run cannot be stored at all; '' = it is stored, or may be later."""
    _context: RunContext | None = None
    """Parameters and node graph that are still to be stored."""

    def __init__(
        self,
        store: Store,
        *,
        clock: Callable[[], int] = time.time_ns,
        settings: RecordingSettings | None = None,
        filters: Filters | None = None,
        node: str = "",
        buffer_bytes: int = DEFAULT_BUFFER_BYTES,
        limit: int = 0,
        block_sec: float = BLOCK_SEC,
        name: str = "",
        labels: Mapping[str, str] | None = None,
        restored: int = 0,
        places: bool = True,
        spool: SpoolPlan | None = None,
    ) -> None:
        self._store = store_future(store)
        self._clock = clock
        self._settings = settings or RecordingSettings()
        self._filters = filters or Filters(self._settings, node)
        self.node, self.name, self._labels = node, name, dict(labels or {})
        self._limit, self._block_sec = limit, block_sec
        self._earlier_counts: Mapping[str, int] = {}
        """Number of messages by topic in earlier runs that count for the limit."""
        self._lock = threading.Lock()
        """Guards the values up to ``_writer_ids``, and the order in which received messages enter
        the buffer."""
        self._accepting = True
        self._counter = restored
        """Counter of the next message; those before it are for the restored ones."""
        self._latest = 0
        """Time of reception of the last message, ns; 0 = no message."""
        self._feeds: dict[int, Feed] = {}
        """Connections by the id of their header."""
        # Weak: a source lives as long as a feed, a queued message or ``_waiting`` has it.
        self._sources: _Sources = weakref.WeakValueDictionary()
        self.writer_id = new_writer_id()
        self._writer_ids = [self.writer_id]
        """Writer ids of the run, by number of overflows of the counter: more than one only after
        2**32 messages."""
        self._begun_ns = time.time_ns()
        """Time at which the run began, wall clock, ns."""
        self._losses = LossLog(node, self.writer_id)
        self._places = PlaceKeeper(
            self._store, RobotRun(node, self.writer_id), self._losses, places
        )
        self._counts = Counts(self._losses)
        self._writers: list[MessageWriter] = []
        """Writers in the order of ``_writer_ids``; empty until the run is opened in the store. Then
        only the writing thread appends to it."""
        self._gives_up = math.inf
        """Time at which the recording gives up an unconnected store, monotonic clock, s."""
        self._buffer, self._buffer_bytes = Buffer(buffer_bytes), buffer_bytes
        self._max_waiting_bytes, self._waiting_bytes = buffer_bytes // 2 or 2**63, 0
        """Maximum memory of the messages that wait for their tables, and their memory now, bytes.
        """
        self._waiting: list[MessageSource] = []
        """Sources with messages that wait for their tables. Of the writing thread alone."""
        if self._store.done():
            self._open_now(spool is not None)
        self._tables = TableMaker(self._make_together, self._connect, self._buffer.wake)
        self._backlog = (
            None
            if spool is None
            else Backlog(
                self._buffer,
                spool,
                partial(self._label, spool),
                self._source,
                self._lose_some,
                self._is_away,
            )
        )
        self._queue: Backlog | Buffer = self._backlog or self._buffer
        """Queue from which the writing thread takes messages."""
        self._is_leaving = False
        """Whether messages stay in the spool at the end; set once, by ``_leave``."""
        self._ended = threading.Event()
        """Set at the end: losses are not stored at intervals any more, and the counts become final.
        """
        self._saving = threading.Lock()
        """Held while losses and the context are stored."""
        self._closing = threading.Lock()
        """Held while it is decided whether messages stay in the spool: ``abandon`` is called by
        another thread than ``close``."""
        self._closed = threading.Event()
        """Set when ``close`` has nothing more to do."""
        self._thread = self._thread_of(self._run, "recorder-writer")
        self._thread_of(self._keep, "recorder-losses")

    def _label(self, spool: SpoolPlan, overflows: int) -> SpoolLabel:
        """Return the label of a file with messages after so many overflows of the counter."""
        return SpoolLabel(
            self._writer_id_after(overflows),
            self.writer_id,
            spool.keyspace,
            spool.address,
            self._begun_ns,
            node=self.node,
            name=self.name,
            labels=self._labels,
            settings=settings_as_json(self._settings),
            journal=spool.journal,
        )

    def _writer_id_after(self, overflows: int) -> int:
        """Return the writer id after so many overflows of the counter."""
        with self._lock:
            while len(self._writer_ids) <= overflows:
                self._writer_ids.append(new_writer_id())
            return self._writer_ids[overflows]

    def _source(self, connection: Connection) -> MessageSource:
        """Return the source of a connection, for messages that come back from the spool."""
        with self._lock:
            key = (connection.topic, connection.header)
            return self._sources.setdefault(key, MessageSource(connection))

    def _lose_some(
        self, topic: str, messages: int, kind: LossKind, first: int, last: int, detail: str
    ) -> None:
        """Count messages that the spool has lost, see ``backlog.Lose``."""
        self._counts.lost(topic, messages, kind, first, detail, last)

    def _open_now(self, may_wait: bool) -> None:
        """Start the run in a connected store; if it ``may_wait``, messages wait until it answers.

        Raises:
            CassandraRosError: The store does not take the run.
        """
        if may_wait and self._store.result().keyspace.cassandra.outage.is_current:
            return
        try:
            self._open()
        except StoreUnavailable:
            if not may_wait:
                raise

    def _open(self) -> None:
        """Start the run in the store; raises what the store raises.

        The constructor calls it, or the writing thread when the store answers.
        """
        self._writers.append(self._make_writer(self.writer_id))
        self._store.result().keyspace.cassandra.outage.tell_waiting(self._waiting_for_long)
        if self.name:
            self._tell_namesakes()

    def _tell_namesakes(self) -> None:
        """Tell the user which other runs have the name of this one.

        After this one was stored: of two that start at the same moment at least one knows both.
        """
        with suppress(CassandraRosError):  # messages wait for the store then, and it is told
            runs = self._store.result().keyspace.registry.runs()
            namesakes = [run for run in runs if run.name == self.name]
            if len(namesakes) > 1:
                text = "%s; --run %d means this one alone"
                _log.info(text, describe_runs(namesakes), self.writer_id)

    @property
    def opened(self) -> bool:
        """Whether the run has started in the store; before, messages wait in memory."""
        return bool(self._writers)

    @property
    def is_held_up(self) -> bool:
        """Whether the run has not started in the store, or the store does not answer now."""
        return not self.opened or self._store.result().keyspace.cassandra.outage.is_current

    def _is_away(self) -> bool:
        """Return whether the store does not answer, and messages are on their way to it."""
        if not self.opened or not self._store.result().keyspace.cassandra.outage.is_current:
            return False
        return self._has_pending()

    def _has_pending(self) -> bool:
        """Return whether messages were written and are not acknowledged yet."""
        return any(writer.pending_bytes for writer in list(self._writers))

    @staticmethod
    def _thread_of(work: Callable[[], None], name: str) -> threading.Thread:
        """Start and return a thread that does not keep the process alive."""
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        return thread

    def expect(self, topic: str) -> None:
        """List a topic in the reports even if no message of it is received."""
        self._counts.expect(topic)

    def received(
        self, topic: str, header: Mapping[str, str], wire: bytes, *, paused: bool = False
    ) -> bool:
        """Record one serialised message that was just received. Never waits for the store.

        A message of a topic that has reached the limit is ignored, and not counted.

        Args:
            header: Connection header; the same object for all messages of a connection.
            paused: Only count the message.

        Returns:
            False if the recording has ended.
        """
        # Stamp and counter under one lock: rospy has a thread per publisher, and the order of the
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
    ) -> Sequence[BufferedMessage]:
        """Stamp, filter and queue a message; return the messages that were dropped for it.

        The caller holds the lock.
        """
        feed = self._feed(topic, header)
        self._counts.attribute(topic, wire, feed)
        if paused:
            self._counts.leave_out(topic, wire, paused=True)
            return ()
        try:
            t = self._clock()
        except ClockNotSet as exc:
            self._lose(topic, LossKind.NO_CLOCK, str(exc), time.time_ns())
            return ()
        if t < self._latest - MAX_STEP_BACK_NS:
            _log.warning(
                "time went back by %.3f s: messages received now get times before those that were "
                "recorded last",
                (self._latest - t) / SECOND_NS,
            )
        self._latest = t
        if feed.filter is not None and not feed.filter.passes(header, t, wire):
            self._counts.leave_out(topic, wire, paused=False)
            return ()
        if self.refusal:
            self._lose(topic, LossKind.REFUSED, self.refusal, t)
            return ()
        return self._put(feed, t, wire)

    def _put(self, feed: Feed, t: int, wire: bytes) -> Sequence[BufferedMessage]:
        """Queue a stamped message under the next counter; return those dropped for it.

        The caller holds the lock.
        """
        counter = self._counter
        self._counter += 1
        if feed.source.tells_places:
            self._places.add_message(feed.source, t, wire)
        return self._buffer.put(BufferedMessage(feed.source, t, counter, wire))

    def follow(self, message: StampedMessage) -> None:
        """Record a message that was stamped and filtered already. Never waits for the store."""
        topic, header, wire, t = message
        with self._lock:
            if not self._accepting:
                return
            self._counts.received(topic, wire)
            feed = self._feed(topic, header)
            self._counts.attribute(topic, wire, feed)
            lost = self._put(feed, t, wire)
        for item in lost:
            self._lose(item.source.topic, LossKind.BUFFER_FULL, "option -b", item.t)

    def restore(self, messages: Sequence[StampedMessage]) -> None:
        """Record messages that were received before the recording began; waits for the store.

        Args:
            messages: The messages in the order of reception, as many as the argument ``restored``
                of the constructor.
        """
        # All are counted first: those that are not queued yet when this is given up are lost, too.
        for topic, _, wire, _ in messages:
            self._counts.received(topic, wire)
        for counter, (topic, header, wire, t) in enumerate(messages):
            with self._lock:
                feed = self._feed(topic, header)
                self._counts.attribute(topic, wire, feed)
                if feed.source.tells_places:
                    self._places.add_message(feed.source, t, wire)
            self._buffer.wait_for_room(len(wire))
            for item in self._buffer.put(BufferedMessage(feed.source, t, counter, wire)):
                self._lose(item.source.topic, LossKind.BUFFER_FULL, "option -b", item.t)

    def unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        """Record a loss: messages of publishers of a topic may have been missed.

        Args:
            first_ns, last_ns: Time range in which they may have been sent, ns, both included.
        """
        self._counts.unheard(topic, (last_ns - first_ns) / SECOND_NS)
        self.lose(topic, LossKind.UNHEARD, 0, first_ns, last_ns)

    def lose(self, topic: str, kind: LossKind, messages: int, first_ns: int, last_ns: int) -> None:
        """Record a loss of messages that were not received; 0 = their number is not known."""
        self._counts.lost(topic, messages, kind, first_ns, last=last_ns)

    def now(self) -> int:
        """Return the time of the clock that stamps messages, ns; the wall time if it is unknown."""
        try:
            return self._clock()
        except ClockNotSet:
            return time.time_ns()

    def _lose(self, topic: str, kind: LossKind, detail: str, t: int | None = None) -> None:
        """Count one received message as lost; ``t`` is its time of reception, ns, None = now."""
        self._counts.lost(topic, 1, kind, self.now() if t is None else t, detail)

    def _feed(self, topic: str, header: Mapping[str, str]) -> Feed:
        """Return the connection that a header object belongs to; the caller holds the lock."""
        feed = self._feeds.get(id(header))
        if feed is None:
            connection = live_connection(topic, header)
            key = (topic, connection.header)
            source = self._sources.setdefault(key, MessageSource(connection))
            if len(self._feeds) >= MAX_FEEDS:
                self._feeds.pop(next(iter(self._feeds)))
            feed = self._feeds[id(header)] = Feed(header, source, self._filters.of(topic))
        return feed

    def is_complete(self, topic: str) -> bool:
        """Return whether a topic has all the messages that the limit allows."""
        if not self._limit:
            return False
        return self._earlier_counts.get(topic, 0) + self._counts.kept(topic) >= self._limit

    def hand_over(self, later: Recording, switch: Callable[[], None]) -> None:
        """Accept no more messages, and let a later recording get them.

        Both happen under the lock: no message is received in between.

        Args:
            later: The recording that gets the following messages.
            switch: Makes ``later`` the current recording; must not call this recording.
        """
        with self._lock:
            self._accepting = False
            if self._limit:
                later._earlier_counts = self._limit_counts()
            later.refusal = self.refusal
            switch()

    def _limit_counts(self) -> dict[str, int]:
        """Return the number of messages of each topic that count for the limit."""
        counts = Counter(self._earlier_counts)
        for report in self.reports():
            counts[report.topic] += report.received - report.left_out - report.paused
        return dict(counts)

    @property
    def received_bytes(self) -> int:
        """Serialised size of all received messages that were not left out, bytes."""
        return self._counts.total_bytes

    @property
    def received_messages(self) -> int:
        """Number of received messages that were not left out."""
        return self._counts.total_messages

    @property
    def held_bytes(self) -> int:
        """Memory of the messages that wait for the store, bytes."""
        return self._buffer.held_bytes

    @property
    def on_disk(self) -> OnDisk:
        """How far the store is behind: messages that wait in the spool."""
        return OnDisk() if self._backlog is None else self._backlog.on_disk()

    @property
    def spool(self) -> str:
        """Path of the spool; '' = messages wait in memory only."""
        return "" if self._backlog is None else self._backlog.path

    def count(self, topic: str) -> int:
        """Return the number of received messages of a topic."""
        return self._counts.of(topic)

    def _run(self) -> None:
        """Write messages until the recording has ended: the writing thread."""
        why = self._await_store()
        if not why:
            while not self._step():
                pass
        elif self._backlog is None:
            self._lose_all(why)
        if self._backlog is not None and self._backlog.leaving:
            for source in self._waiting:
                self._backlog.put_aside(list(source.waiting))
                self._buffer.release_all(list(source.waiting))
                source.waiting.clear()
        self._tables.close(wait=not self._is_leaving)

    def _await_store(self) -> str:
        """Open the run as soon as the store answers; return why it cannot be opened, else ''."""
        started = time.monotonic()
        last_warning = started + NO_STORE_SEC - TELL_SEC  # so that the first comes at NO_STORE_SEC
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
            if time.monotonic() >= last_warning + TELL_SEC and self._tell_of_waiting(
                "no store yet"
            ):
                last_warning = time.monotonic()
        if last_warning > started:
            self._tell_of_waiting(f"the store answers after {time.monotonic() - started:.0f} s")
        if self._buffer.closed:  # the recording has ended while it waited
            self._hurry()
        return ""

    def _is_too_late(self) -> bool:
        """Return whether the recording has ended and need not wait for the store any longer.

        With a spool it waits until ``stop`` leaves the messages there.
        """
        if not self._buffer.closed:
            return False
        if self._backlog is not None:
            return self._backlog.ended
        return not self._buffer.held_bytes or time.monotonic() > self._gives_up

    def _tell_of_waiting(self, what: str) -> str:
        """Log how many messages wait, if any do; return the text."""
        text = self._waiting_for_long()
        if text:
            _log.warning("%s: %s", what, text)
        return text

    def _lose_all(self, why: str) -> None:
        """Count all messages as lost until the recording ends: the run could not be opened."""
        while not self._buffer.ended:
            for item in self._buffer.next_messages(
                WRITE_ROUND_MESSAGES, WRITE_ROUND_BYTES, POLL_SEC
            ):
                self._lose(item.source.topic, LossKind.AT_END, why, item.t)
                self._buffer.release(item)

    def _step(self) -> bool:
        """Move some messages on; return whether the recording has ended and no message is left."""
        if self._backlog is not None and self._waiting_bytes > self._max_waiting_bytes:
            time.sleep(POLL_SEC)  # the rest waits on disk
        else:
            for item in self._queue.next_messages(
                WRITE_ROUND_MESSAGES, WRITE_ROUND_BYTES, POLL_SEC
            ):
                self._route(item)
        while self._tables.decided:
            source = self._tables.decided.popleft()
            self._waiting.remove(source)
            while source.waiting:
                self._route(self._take_waiting(source))
        if self._backlog is not None:
            if self._backlog.leaving:
                return True
            if not self._waiting:  # what waits for a table is taken, but no flush waits for it
                self._backlog.delete_stored_files(self._flush)
        ending = self._queue.ended
        for source in self._waiting:
            if not source.submitted and (ending or source.is_ripe()):
                source.submitted = True
                self._tables.make(source)
        if ending:  # a store that does not answer is given up soon
            self._tables.hurry()
        return ending and not self._waiting

    def _route(self, item: BufferedMessage) -> None:
        """Write a message, or keep it until its source has a table, or count it as lost."""
        source = item.source
        if source.handle is None and not source.error:
            if not source.waiting and not source.submitted:
                self._waiting.append(source)
            source.hold(item)
            self._waiting_bytes += item.nbytes
            # Messages that wait for tables use at most half of the buffer, so that topics that
            # have a table go on.
            while self._is_over(source):
                old = self._take_waiting(source)
                self._buffer.release(old)
                self._lose(source.topic, LossKind.TABLE_LATE, "", old.t)
            return
        if source.handle is None:
            self._lose(source.topic, LossKind.NO_TABLE, source.error, item.t)
        else:
            self._write(item, source.handle)
        self._buffer.release(item)

    def _flush(self) -> None:
        """Wait until each message that was written is stored or lost."""
        for writer in self._writers:
            writer.flush()

    def _is_over(self, source: MessageSource) -> bool:
        """Return whether the oldest message of a source that waits for its table is dropped.

        It is not before an attempt to make the table has failed, nor with a spool: ``_step`` then
        takes no more messages. The newest message is never dropped.
        """
        if self._backlog is not None:
            return False
        return (
            source.told
            and self._waiting_bytes > self._max_waiting_bytes
            and len(source.waiting) > 1
        )

    def _take_waiting(self, source: MessageSource) -> BufferedMessage:
        """Remove and return the oldest message of a source that waits for its table."""
        item = source.waiting.popleft()
        self._waiting_bytes -= item.nbytes
        return item

    def _write(self, item: BufferedMessage, handle: Handle) -> None:
        """Give a message to the writer of its counter; count it as lost if that fails."""
        overflows, counter = divmod(item.counter, 1 << COUNTER_BITS)
        source = item.source
        try:
            while len(self._writers) <= overflows:
                self._writers.append(self._make_writer(self._writer_id_after(len(self._writers))))
            writer = self._writers[overflows]
            if overflows:  # the counter overflowed: another writer with its own handles
                handle = connect(writer, source.connection, Lengths(), self._settings)
            writer.write(handle, item.t, counter, item.wire)
        except CassandraRosError as exc:
            self._lose(source.topic, LossKind.REFUSED, str(exc), item.t)
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("a message of topic %s could not be stored", source.topic)
            self._lose(source.topic, LossKind.MISTAKE, _mistake(exc), item.t)

    def _connect(self, source: MessageSource) -> Handle:
        """Make the table of a source, on the thread of the table maker."""
        return connect(self._writers[0], source.connection, source.lengths(), self._settings)

    def _make_together(self, sources: Sequence[MessageSource]) -> None:
        """Make the tables of several sources, on the thread of the table maker."""
        make_together(self._writers[0], sources, self._settings)

    def _make_writer(self, writer_id: int) -> MessageWriter:
        """Make a writer, which stores its run at once; raises what the store raises."""
        run = Run(
            self.node,
            writer_id,
            "recording",
            name=self.name,
            format=self._settings.default.format or "",
            labels=self._labels,
        )
        return make_writer(
            self._store.result().keyspace,
            writer_id=writer_id,
            format=self._settings.default.format,
            node=self.node,
            ttl=self._settings.default.ttl,
            run=run,
            block_sec=self._block_sec,
            # No time limit: during an outage messages are lost only when the buffer is full.
            give_up_after_sec=math.inf,
            on_loss=self._on_refusal,
        )

    def _on_refusal(self, topic: str, messages: int, error: CassandraRosError) -> None:
        """Count messages that a writer has given up; called on any thread."""
        first, last = (error.first_ns, error.last_ns) if isinstance(error, WriteFailed) else (0, 0)
        first, last = first or self.now(), last or self.now()
        self._counts.lost(topic, messages, LossKind.REFUSED, first, str(error), last)

    def put_context(self, context: RunContext) -> None:
        """Store parameters and node graph with the run, in the background.

        They are lost, with a warning, if they come after the end of the run, if the store does not
        answer before it, or if they cannot be stored.
        """
        self._context = context
        if self._ended.is_set():  # the last call of ``_save`` may have come before
            _log.warning(
                "the parameters of run %s came after its end and may not be stored", self.name
            )

    def _keep(self) -> None:
        """Store losses and the context at intervals until the end, on a thread."""
        while not self._ended.wait(SAVE_SEC):
            self._save()

    def _save(self) -> None:
        """Store new losses and the context; if the store does not answer, the next call does so."""
        if is_there(self._store):
            # One thread at a time: an older loss must not overwrite a newer one.
            with self._saving:
                # Each in its own ``try``: an error of the context must not keep the losses back.
                self._save_context()
                self._save_losses()

    def _save_last(self) -> None:
        """Store losses and the context at the end, for the last time."""
        self._save()
        self._tell_lost_context()

    def _save_context(self) -> None:
        """Store the context, if there is one; drop it after an error that does not pass."""
        if self._context is None:
            return
        try:
            registry = self._store.result().keyspace.registry
            registry.put_context(self.writer_id, self.node, self._context)
        except StoreUnavailable as exc:
            _log.debug("the parameters of run %s are written later: %s", self.name, exc)
            return
        except CassandraRosError as exc:
            _log.warning("the parameters of run %s are not stored: %s", self.name, exc)
        self._context = None

    def _save_losses(self) -> None:
        """Store the losses that are new or have grown."""
        try:
            for loss in self._losses.unsaved():
                self._store.result().keyspace.registry.put_loss(loss)
                self._losses.saved(loss)
        except StoreUnavailable as exc:
            _log.debug("losses are written later: %s", exc)
        except CassandraRosError as exc:
            _log.warning("losses of run %s cannot be stored: %s", self.name, exc)

    def _tell_lost_context(self) -> None:
        """Log that the context is lost, if it still waits for the store."""
        if self._context is not None:
            _log.warning(
                "the parameters of run %s are not stored: the store did not answer before the end "
                "of the run",
                self.name,
            )

    def stop(self, timeout_sec: float | None = None) -> bool:
        """Accept no more messages and store the waiting ones.

        Args:
            timeout_sec: Maximum time to wait, s; None = no maximum. Call again to go on waiting.

        Returns:
            Whether the writing thread has ended: each message was given to a writer, which may
            still wait for the store's answer, or is lost, or stays in the spool.
        """
        with self._lock:
            self._accepting = False
        self._gives_up = min(self._gives_up, time.monotonic() + GIVE_UP_SEC)
        self._buffer.close()
        if self._backlog is None:
            self._hurry()
            self._thread.join(timeout_sec)
        else:
            self._store_or_leave(math.inf if timeout_sec is None else timeout_sec)
        return not self._thread.is_alive()

    def _store_or_leave(self, timeout_sec: float) -> None:
        """Wait until all messages are stored; leave them on disk if the store takes none."""
        settled_before, since = -1, time.monotonic()
        ends = since + timeout_sec
        while (self._thread.is_alive() or self._has_pending()) and time.monotonic() < ends:
            self._thread.join(POLL_SEC) if self._thread.is_alive() else time.sleep(POLL_SEC)
            settled = sum(self._stored_counts().values()) + sum(r.lost for r in self.reports())
            if settled != settled_before:
                settled_before, since = settled, time.monotonic()
            patience = SILENT_STORE_SEC if self.is_held_up else SLOW_STORE_SEC
            if time.monotonic() - since > patience and not self._is_leaving:
                self._leave()
            if self._is_leaving and not self._thread.is_alive():
                break  # what is pending is given back when the writers are closed
        if not self._is_leaving and (self.problem or not self.opened):
            self._leave()
        if not (self._is_leaving or self._thread.is_alive() or self._has_pending()):
            for writer in list(self._writers):  # all is stored: only buckets are to be closed
                writer.hurry(SLOW_STORE_SEC)

    def _leave(self) -> None:
        """Keep unstored messages in the spool, also those that the store gives back.

        It does nothing without a spool, if no message waits, or if the recording is closed.
        """
        with self._closing:
            if self._backlog is None or self._is_leaving or self._closed.is_set():
                return
            if not any(report.waiting for report in self.reports()):
                return
            self._is_leaving = True
            self._backlog.leave()
            for overflows, writer in enumerate(list(self._writers)):
                writer.give_back(partial(self._backlog.take_back, overflows))

    def _hurry(self) -> None:
        """Let the writers give up what a silent store has not taken after GIVE_UP_SEC."""
        for writer in list(self._writers):
            writer.hurry(GIVE_UP_SEC)

    def close(self) -> list[TopicReport]:
        """Stop, close the buckets, store the end of the run; return the final report.

        If messages stay in the spool, so does the end of the run. A second call changes nothing.
        """
        self.stop()
        if not self._ended.is_set():
            for writer in self._writers:
                _try_to(writer.flush)
            if self._is_leaving:
                self._finish_spool()
                return self.reports()
            self._end_counts()
            self._save_last()
            self._places.close()
        lost = {report.topic: report.lost for report in self.reports() if report.lost}
        for writer in self._writers:
            _try_to(partial(writer.close, lost))
        if self._backlog is not None and not self._is_leaving:
            self._backlog.close()
        self._closed.set()
        return self.reports()

    def _finish_spool(self) -> None:
        """End a run whose messages are not all stored: the rest stays in the spool.

        In this order: writers give messages back until they are closed, what the spool then cannot
        keep is lost, and the end has the final counts.
        """
        for writer in self._writers:
            _try_to(writer.close)
        self._ended.set()
        self._tell_lost_context()
        self._places.close(wait=False)
        if self._backlog is not None:
            self._backlog.keep_rest()
        reports = self.reports()
        end = RunEnd(
            time.time_ns(),
            {report.topic: report.stored + report.waiting for report in reports},
            {report.topic: report.lost for report in reports if report.lost},
            [
                (loss.topic, loss.kind.value, loss.first_ns, loss.last_ns, loss.count)
                for loss in self._losses.unsaved()
            ],
        )
        try:
            if self._backlog is not None:
                self._backlog.finish(end)
            self._counts.note_spooled({report.topic: report.waiting for report in reports})
        except (OSError, CassandraRosError) as exc:
            _log.error("the end of run %s cannot be written to the spool: %s", self.name, exc)
            self._end_counts()
        self._closed.set()

    def waiting(self) -> tuple[int, int]:
        """Return the number of messages that wait for the store and their memory, bytes."""
        messages = sum(report.waiting for report in self.reports())
        nbytes = self._buffer.held_bytes + sum(w.pending_bytes for w in list(self._writers))
        nbytes += self.on_disk.nbytes
        return max(messages, 0), nbytes

    def _waiting_for_long(self) -> str:
        """Return how many messages wait, as text; '' = none.

        While the store is away the text also says how long they are kept.
        """
        messages, nbytes = self.waiting()
        if not messages:
            return ""
        text = f"{messages} messages ({nbytes / 1e6:.1f} MB) wait"
        if not self.is_held_up:
            return text
        if self._backlog is not None:
            return f"{text}; they are kept in memory and in the spool {self._backlog.path}"
        bound = f"{self._buffer_bytes >> 20} MB wait" if self._buffer_bytes else "memory is full"
        return (
            f"{text}; they are kept in memory until {bound}, then the oldest are dropped; when the "
            f"recording ends they are retried for {GIVE_UP_SEC:.0f} s"
        )

    def abandon(self) -> list[TopicReport]:
        """Count messages that are not stored by now as lost, without waiting; return the report.

        With a spool they stay there, which may take some seconds.
        """
        if self._backlog is not None:
            self._leave()
            if self._closed.wait(SPOOL_WAIT_SEC):
                return self.reports()
        self._end_counts()
        # The losses are stored if the store answers in time; the process may end before.
        self._thread_of(self._save_last, "recorder-losses").join(LOSSES_WAIT_SEC)
        return self.reports()

    def _end_counts(self) -> None:
        """End the recording: messages that still wait are lost, and the counts are final."""
        self._ended.set()
        self._counts.count_rest_as_lost(self._stored_counts(), self._latest or time.time_ns())

    def reports(self) -> list[TopicReport]:
        """Return the report of each topic so far."""
        return self._counts.reports(self._stored_counts())

    def _stored_counts(self) -> Counter[str]:
        """Return the number of messages by topic that the store has acknowledged."""
        stored: Counter[str] = Counter()
        for writer in self._writers:
            stored.update({topic: stats.stored for topic, stats in writer.stats().items()})
        return stored


def _mistake(exc: Exception) -> str:
    """Return the detail of a loss that an error of this package has caused."""
    return f"internal error: {type(exc).__name__}: {exc}"


def _try_to(work: Callable[[], None]) -> None:
    """Call ``work`` and only log its error: the final report, with the losses, must be returned."""
    try:
        work()
    except CassandraRosError as exc:
        _log.error("the recording could not be closed properly: %s", exc)
