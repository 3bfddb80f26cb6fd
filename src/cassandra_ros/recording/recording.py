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
import queue
import threading
import time
import weakref
from collections import Counter, deque
from functools import partial
from typing import Callable, Mapping, Optional

from cassandra_ros.errors import CassandraRosError, ClockNotSet, SchemaConflict, StoreUnavailable
from cassandra_ros.keys import COUNTER_BITS, SECOND_NS, new_writer_id
from cassandra_ros.messages.connection import live_connection
from cassandra_ros.recording.buffer import Buffer, Feed, Item, Source
from cassandra_ros.recording.counts import Counts, TopicReport
from cassandra_ros.store.registry import Loss, LossKind, Run
from cassandra_ros.topics.message_writer import Handle, MessageWriter
from cassandra_ros.topics.ros_cassandra import RosCassandra

_log = logging.getLogger(__name__)

DEFAULT_BUFFER_BYTES = 256 * 1024 * 1024
BATCH_ITEMS = 256
BATCH_BYTES = 1024 * 1024
POLL_SEC = 0.05
PAUSE_SEC = 1.0
MAX_CONFLICTS = 5
"""A schema lock may be held by others for a while; a table of another kind stays one."""
LAST_TRIES_SEC = 20.0
"""How long a store that does not answer is waited for when the recorder ends."""
GIVE_UP_SEC = 300.0
"""How long the writing of one message is tried."""
MAX_FEEDS = 4096
"""Connections remembered by their header object; publishers come and go for days."""


class Recording:
    """Stores messages as they arrive.

    Args:
        ros_cas: A RosCassandra connected to a keyspace.
        clock: Returns the time of arrival, ns; raises ClockNotSet while it is unknown.
        format: As addTopic takes it, for all topics.
        node: The robot or entity that is recorded.
        buffer_bytes: Bound of all messages that wait; the oldest are dropped. 0 = none.
        limit: Record only so many messages of each topic; 0 = all.
        ttl: Seconds until a message expires; 0 = never.
        name: Name of the run in the store.
    """

    def __init__(
        self,
        ros_cas: RosCassandra,
        *,
        clock: Callable[[], int] = time.time_ns,
        format: Optional[str] = None,
        node: str = "",
        buffer_bytes: int = DEFAULT_BUFFER_BYTES,
        limit: int = 0,
        ttl: int = 0,
        name: str = "",
    ) -> None:
        self._rosCas = ros_cas
        self._clock = clock
        self._format, self._node, self._ttl, self._name = format, node, ttl, name
        self._limit = limit
        self._buffer_bytes = buffer_bytes
        self._lock = threading.Lock()
        self._accepting = True
        self._counter = 0
        self._feeds: dict[int, Feed] = {}
        # Feeds, queued messages and waiting lists hold the sources that are in use.
        self._sources: weakref.WeakValueDictionary[tuple[str, bytes], Source]
        self._sources = weakref.WeakValueDictionary()
        self._counts = Counts()
        self._writers = [self._make_writer()]
        self._buffer = Buffer(buffer_bytes)
        self._most_waiting = buffer_bytes // 2 or 2**63
        self._waiting: list[Source] = []
        self._waiting_bytes = 0
        # Sources whose tables are to be made (None: no more), and those of which that is decided.
        self._asked: queue.Queue[Optional[Source]] = queue.Queue()
        self._decided: deque[Source] = deque()
        self._deadline = math.inf
        ros_cas.cassandra.outage.waiting = self._waiting_for_long
        self._maker = threading.Thread(
            target=self._make_tables, name="recorder-tables", daemon=True
        )
        self._thread = threading.Thread(target=self._run, name="recorder-writer", daemon=True)
        self._maker.start()
        self._thread.start()

    def expect(self, topic: str) -> None:
        """Let a topic appear in the reports even if nothing ever comes."""
        self._counts.expect(topic)

    def unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        """Note that publishers of a topic may have sent what never came here; waits for the store.

        Args:
            first_ns, last_ns: When that may have been, ns, both included.
        """
        self._counts.unheard(topic, (last_ns - first_ns) / SECOND_NS)
        writer, kind = self._writers[0].writer_id, LossKind.UNHEARD
        loss = Loss(topic, self._node, writer, kind, first_ns, last_ns, 0)
        try:
            self._rosCas.parts.registry.put_loss(loss)
        except CassandraRosError as exc:
            _log.error("a loss of topic %s could not be noted in the store: %s", topic, exc)

    def received(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        """Take one serialised message that has just arrived. Never waits for the store.

        The header is the same object for all messages of a connection.
        """
        # Stamp and counter together: rospy has a thread per publisher, and the order of the
        # stamps must be that of the counters.
        with self._lock:
            if not self._accepting or self.is_complete(topic):
                return
            self._counts.received(topic, wire)
            try:
                lost = self._take(topic, header, wire)
            except Exception as exc:  # noqa: BLE001 - rospy would only log it: counted
                lost = [(topic, _mistake(exc))]
        for lost_topic, reason in lost:
            self._counts.lost(lost_topic, 1, reason)

    def _take(self, topic: str, header: Mapping[str, str], wire: bytes) -> list[tuple[str, str]]:
        """Stamp and queue a message; return topic and reason of what is lost by that."""
        try:
            t = self._clock()
        except ClockNotSet as exc:
            return [(topic, str(exc))]
        counter = self._counter
        self._counter += 1
        feed = self._feed(topic, header)
        self._counts.attribute(topic, wire, feed)
        dropped = self._buffer.put(Item(feed.source, t, counter, wire))
        return [(item.source.topic, "the buffer was full (option -b)") for item in dropped]

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
        return bool(self._limit) and self.count(topic) >= self._limit

    def count(self, topic: str) -> int:
        """Return how many messages of a topic arrived."""
        return self._counts.of(topic)

    def _run(self) -> None:
        while not self._step():
            pass
        self._asked.put(None)
        self._maker.join()

    def _step(self) -> bool:
        """Move some messages on; return whether all are gone."""
        for item in self._buffer.take(BATCH_ITEMS, BATCH_BYTES, POLL_SEC):
            self._route(item)
        while self._decided:
            source = self._decided.popleft()
            self._waiting.remove(source)
            while source.waiting:
                self._route(self._released(source))
        ending = self._buffer.ended
        for source in self._waiting:
            if not source.submitted and (ending or source.is_ripe()):
                source.submitted = True
                self._asked.put(source)
        if ending:  # a store that is gone is not waited for much longer
            self._deadline = min(self._deadline, time.monotonic() + LAST_TRIES_SEC)
        return ending and not self._waiting

    def _route(self, item: Item) -> None:
        source = item.source
        if source.handle is None and not source.error:
            if not source.waiting and not source.submitted:
                self._waiting.append(source)
            source.hold(item)
            self._waiting_bytes += item.nbytes
            # What waits for tables stays within half of the buffer: topics with one go on.
            while self._waiting_bytes > self._most_waiting and len(source.waiting) > 1:
                self._buffer.release(self._released(source))
                self._counts.lost(source.topic, 1, "the buffer was full before its table stood")
            return
        if source.handle is None:
            self._counts.lost(source.topic, 1, source.error)
        else:
            self._write(item, source.handle)
        self._buffer.release(item)

    def _released(self, source: Source) -> Item:
        item = source.waiting.popleft()
        self._waiting_bytes -= item.nbytes
        return item

    def _write(self, item: Item, handle: Handle) -> None:
        generation, counter = divmod(item.counter, 1 << COUNTER_BITS)
        source = item.source
        try:
            while len(self._writers) <= generation:
                self._writers.append(self._make_writer())
            writer = self._writers[generation]
            if generation:  # the counter ran over: another writer, with handles of its own
                handle = writer.connect(source.connection)
            writer.write(handle, item.t, counter, item.wire)
        except CassandraRosError as exc:
            self._counts.lost(source.topic, 1, str(exc))
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("a message of topic %s could not be stored", source.topic)
            self._counts.lost(source.topic, 1, _mistake(exc))

    def _make_tables(self) -> None:
        """Give sources their handles, one after the other, on a thread of its own."""
        for source in iter(self._asked.get, None):
            if self._decide(source):
                self._decided.append(source)
                self._buffer.wake()
            else:
                time.sleep(PAUSE_SEC)
                self._asked.put(source)

    def _decide(self, source: Source) -> bool:
        """Return whether it is decided what becomes of a source."""
        try:
            connection, length = source.connection, source.bucket_length()
            source.handle = self._writers[0].connect(connection, length)
            return True
        except (StoreUnavailable, SchemaConflict) as exc:
            source.conflicts += isinstance(exc, SchemaConflict)
            if source.conflicts < MAX_CONFLICTS and time.monotonic() <= self._deadline:
                if not source.told:
                    _log.warning("topic %s waits for its table: %s", source.topic, exc)
                source.told = True
                return False
            source.error = str(exc)
        except CassandraRosError as exc:
            source.error = str(exc)
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("the table of topic %s could not be made", source.topic)
            source.error = _mistake(exc)
        _log.error("topic %s cannot be recorded: %s", source.topic, source.error)
        return True

    def _make_writer(self) -> MessageWriter:
        number = new_writer_id()
        run = Run(self._node, number, "recording", name=self._name, format=self._format or "")
        return self._rosCas.messageWriter(
            writer_id=number,
            format=self._format,
            nodeID=self._node,
            ttl=self._ttl,
            run=run,
            # The buffer is the bound: a Cassandra that restarts costs nothing while it lasts.
            give_up_after_sec=GIVE_UP_SEC,
            on_loss=lambda topic, messages, error: self._counts.lost(topic, messages, str(error)),
        )

    def stop(self, timeout_sec: Optional[float] = None) -> bool:
        """Take no more messages and store what is here; say whether all is stored or lost.

        It returns after so long in any case (None = never); call again to go on waiting.
        """
        with self._lock:
            self._accepting = False
        self._buffer.close()
        self._thread.join(timeout_sec)
        return not self._thread.is_alive()

    def close(self) -> list[TopicReport]:
        """Stop, close the buckets, note the end of the run; return the final report."""
        self.stop()
        for writer in self._writers:
            _try_to(writer.flush)
        lost = {report.topic: report.lost for report in self.reports(final=True) if report.lost}
        for writer in self._writers:
            _try_to(partial(writer.close, lost))
        return self.reports(final=True)

    def waiting(self) -> tuple[int, int]:
        """Return how many messages wait for the store, and about how many bytes they take."""
        reports = self.reports()
        messages = sum(r.received - r.stored - r.lost for r in reports)
        nbytes = self._buffer.held_bytes + sum(w.pending_bytes for w in list(self._writers))
        return max(messages, 0), nbytes

    def _waiting_for_long(self) -> str:
        messages, nbytes = self.waiting()
        if not messages:
            return ""
        text = f"{messages} messages ({nbytes / 1e6:.1f} MB) wait"
        if not self._rosCas.cassandra.outage.seconds:
            return text
        bound = f"{self._buffer_bytes >> 20} MB wait" if self._buffer_bytes else "memory is full"
        return (
            f"{text}; they are kept in memory until {bound}, then the oldest are dropped; what is "
            f"being sent is dropped after {GIVE_UP_SEC:.0f} s"
        )

    def reports(self, final: bool = False) -> list[TopicReport]:
        """Describe what became of each topic; ``final`` counts what is on its way as lost."""
        stored: Counter[str] = Counter()
        for writer in self._writers:
            stored.update({topic: part.stored for topic, part in writer.stats().items()})
        return self._counts.reports(stored, final)


def _mistake(exc: Exception) -> str:
    return f"internal error: {type(exc).__name__}: {exc}"


def _try_to(work: Callable[[], None]) -> None:
    # The closing table must come whatever happens: it is where losses are told.
    try:
        work()
    except CassandraRosError as exc:
        _log.error("the recording could not be closed properly: %s", exc)
