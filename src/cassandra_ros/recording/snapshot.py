# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Snapshots: the newest messages are kept in memory and stored as a run on request."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Callable, Collection, Mapping, Sequence

from cassandra_ros.errors import CassandraRosError, ClockNotSet, InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.message_buffer import ITEM_BYTES
from cassandra_ros.recording.option_values import SnapshotBound
from cassandra_ros.recording.recording import Recording, StampedMessage
from cassandra_ros.recording.topic_counts import Counts, TopicReport
from cassandra_ros.store.tables.registry import LossKind

_log = logging.getLogger(__name__)

SNAPSHOTS_AT_ONCE = 4
"""Maximum number of snapshots that are written at the same time."""
PAUSE_SEC = 0.05
"""Time that ``close`` waits for a run that is being started, s."""
MAX_LATCHED = 1000
"""Maximum number of publishers whose latched message is kept although it is too old."""


class MessageRing:
    """The newest messages; the oldest are dropped when there are too many. Not thread-safe.

    Args:
        bound: Maximum time or size.
        most_bytes: Maximum memory in any case, bytes; 0 = no maximum.
    """

    def __init__(self, bound: SnapshotBound, most_bytes: int) -> None:
        self._age_ns = int(bound.seconds * SECOND_NS)
        self._most = min(filter(None, (bound.nbytes, most_bytes)), default=2**63)
        """Maximum memory, bytes."""
        self._timed = not bound.nbytes
        """Whether the messages are bounded by time."""
        self._items: deque[StampedMessage] = deque()
        # The last latched message of each publisher (topic, callerid) that is too old for _items:
        # it is still valid.
        self._latched: dict[tuple[str, str], StampedMessage] = {}
        self._latched_bytes = 0
        self.nbytes = 0
        """Memory of all messages, also of the latched ones, bytes."""
        self.short = False
        """Whether fewer seconds than requested are kept, because the memory is full."""

    def __len__(self) -> int:
        return len(self._items)

    @property
    def seconds(self) -> float:
        """Time from the oldest to the newest message, s."""
        return (self._items[-1][3] - self._items[0][3]) / SECOND_NS if self._items else 0.0

    def add(self, message: StampedMessage) -> None:
        """Append the newest message.

        If its time is over 1 s before that of the last one, all earlier messages are dropped.
        """
        t = message[3]
        if self._items and t < self._items[-1][3] - SECOND_NS:
            _log.warning(
                "time went back: the snapshot's messages lie in the future and are dropped"
            )
            while self._items:
                self._drop()
        self._items.append(message)
        self.nbytes += len(message[2]) + ITEM_BYTES
        self.forget(t)
        while self.nbytes > self._most and len(self._items) > 1:
            if self._timed and not self.short:
                self.short = True
                _log.warning(
                    "the snapshot keeps fewer seconds than requested: its maximum of %d MB is "
                    "reached (option -b)",
                    self._most >> 20,
                )
            self._drop()

    def forget(self, now: int) -> None:
        """Drop the messages that are too old at the time ``now``, ns."""
        while self._age_ns and self._items and self._items[0][3] < now - self._age_ns:
            self._drop()

    def _drop(self) -> None:
        """Drop the oldest message; keep it as the latched one of its publisher if it is latched."""
        message = self._items.popleft()
        topic, header, wire, _ = message
        publisher = topic, header.get("callerid", "")
        self._forget_latched(publisher)
        size = len(wire) + ITEM_BYTES
        is_latched = header.get("latching") == "1"
        # The other half stays for what is new, however much is latched.
        fits = self._latched_bytes + size <= self._most // 2
        if is_latched and fits and len(self._latched) < MAX_LATCHED:
            self._latched[publisher] = message
            self._latched_bytes += size
        else:
            self.nbytes -= size

    def _forget_latched(self, publisher: tuple[str, str]) -> None:
        """Drop the latched message that is kept for a publisher, if there is one."""
        older = self._latched.pop(publisher, None)
        if older is not None:
            size = len(older[2]) + ITEM_BYTES
            self._latched_bytes -= size
            self.nbytes -= size

    def content(self, topics: Collection[str]) -> list[StampedMessage]:
        """Return the messages of some topics in the order of reception.

        The messages that publishers had latched before come first, with the time of the first of
        the other messages, or with their own times if there are no others.

        Args:
            topics: Names of topics; empty = all.
        """
        begin = self._items[0][3] if self._items else None
        latched = [(*message[:3], begin or message[3]) for message in self._latched.values()]
        return [
            message for message in (*latched, *self._items) if not topics or message[0] in topics
        ]


BeginRun = Callable[[str, Mapping[str, str], int], Recording]
"""Function that starts the run of a snapshot, by its name, its labels, and the number of messages
in memory that will be stored in it first. It raises CassandraRosError if the store refuses it."""


@dataclass
class _SnapshotRun:
    """A snapshot that is being written; it is changed under the lock of Snapshots."""

    topics: Collection[str]
    """Names of topics; empty = all."""
    follows: bool
    """Whether messages that are received from now on are stored in it, too."""
    recording: Recording | None = None
    late: deque[StampedMessage] = field(default_factory=deque)
    """Messages received before the run had started."""
    abandoned: bool = False
    """Whether ``Snapshots.abandon`` has reported on it already."""

    def add_message(self, message: StampedMessage) -> None:
        """Store a new message if the snapshot follows its topic; keep it until the run starts."""
        if not self.follows or (self.topics and message[0] not in self.topics):
            return
        if self.recording is None:
            self.late.append(message)
        else:
            self.recording.follow(message)

    def begin(self, recording: Recording) -> None:
        """Hand on what came before the run had begun; what comes from now on goes to it at once.

        The messages of the ring are not among them: ``Recording.restore`` stores these meanwhile,
        under the counters before theirs.
        """
        while self.late:
            recording.follow(self.late.popleft())
        self.recording = recording


class Snapshots:
    """The newest messages in memory, and the snapshots that are written of them. Thread-safe.

    Args:
        bound: Maximum time or size of the messages in memory.
        most_bytes: Maximum memory in any case, bytes; 0 = no maximum.
        clock: Returns the time of reception, ns; raises ClockNotSet while it is unknown.
        filters: Filters that leave messages out.
        begin: Starts a run; it may wait for the store.
    """

    def __init__(
        self,
        bound: SnapshotBound,
        most_bytes: int,
        clock: Callable[[], int],
        filters: Filters,
        begin: BeginRun,
    ) -> None:
        self.ring = MessageRing(bound, most_bytes)
        self._clock, self._filters, self._begin = clock, filters, begin
        self._counts = Counts(LossLog("", 0))
        self._writing: list[_SnapshotRun] = []
        """The snapshots that are being written, also those whose run is being started."""
        self._threads: list[threading.Thread] = []
        self._mutex = threading.Lock()
        """Guards the ring and ``_writing``: a message is in the ring when a snapshot takes it, or
        the snapshot gets it from ``received``."""
        self._closing = threading.Event()
        self.reports: list[Sequence[TopicReport]] = []
        """Reports of the snapshots that were written."""

    def expect(self, topic: str) -> None:
        """List a topic in the counts even if no message of it is received."""
        self._counts.expect(topic)

    def counts(self) -> list[TopicReport]:
        """Return the counts of received messages by topic."""
        return self._counts.reports({})

    def received(
        self, topic: str, header: Mapping[str, str], wire: bytes, *, paused: bool = False
    ) -> None:
        """Keep a message that was just received; with ``paused`` only count it."""
        with self._mutex:
            self._counts.received(topic, wire)
            try:
                t = self._clock()
            except ClockNotSet as exc:
                self._counts.lost(topic, 1, LossKind.NO_CLOCK, 0, str(exc))
                return
            if paused or not self._filters.passes(topic, header, t, wire):
                self._counts.leave_out(topic, wire, paused)
                return
            message = (topic, header, wire, t)
            self.ring.add(message)
            for writing in self._writing:
                writing.add_message(message)

    def write(
        self,
        name: str,
        labels: Mapping[str, str],
        after_sec: float = 0.0,
        topics: Collection[str] = (),
    ) -> tuple[Recording, int]:
        """Store the messages in memory as a run.

        Args:
            name: Name of the run; '' = as the options say.
            labels: Labels of the run.
            after_sec: Time in which received messages are stored in the run, too, s. With 0 the
                call returns when all messages are stored or lost, otherwise at once, and the run
                ends by itself.
            topics: Names of topics; empty = all.

        Returns:
            The run, and the number of messages that were in memory for it.

        Raises:
            InvalidOption: SNAPSHOTS_AT_ONCE snapshots are being written already.
            CassandraRosError: The run cannot be started in the store.
        """
        writing, ends = _SnapshotRun(topics, after_sec > 0), time.monotonic() + after_sec
        with self._mutex:
            if len(self._writing) >= SNAPSHOTS_AT_ONCE:
                raise InvalidOption(
                    f"{SNAPSHOTS_AT_ONCE} snapshots are being written already: wait for one to end"
                )
            try:
                self.ring.forget(self._clock())
            except ClockNotSet:
                pass
            messages = self.ring.content(topics)
            self._writing.append(writing)
        try:
            recording = self._begin(name, labels, len(messages))
        except BaseException:
            with self._mutex:
                self._writing.remove(writing)
            raise
        count = len(messages)
        work = threading.Thread(
            target=self._write, args=(writing, recording, messages, ends), daemon=True
        )
        self._threads.append(work)
        work.start()
        if not after_sec:
            work.join()
        return recording, count

    def _write(
        self,
        writing: _SnapshotRun,
        recording: Recording,
        messages: list[StampedMessage],
        ends: float,
    ) -> None:
        """Store the messages in the run, wait until it ends (monotonic clock, s), close it."""
        try:
            with self._mutex:
                writing.begin(recording)
            recording.restore(messages)
            messages.clear()
            if writing.follows:
                self._closing.wait(max(0.0, ends - time.monotonic()))
        except CassandraRosError as exc:
            _log.error("the snapshot %s could not be written whole: %s", recording.name, exc)
        finally:
            with self._mutex:
                writing.follows = False
            reports = recording.close()
            with self._mutex:
                self._writing.remove(writing)
                if not writing.abandoned:
                    self.reports.append(reports)

    def abandon(self) -> None:
        """Count messages that are not stored by now as lost, without waiting for the store.

        With a spool they stay there; see Recording.abandon.
        """
        with self._mutex:
            runs = list(self._writing)
            for writing in runs:
                writing.abandoned = True
        for writing in runs:
            if writing.recording is None:
                _log.error("a requested snapshot is not written: its run could not be started")
            else:
                self.reports.append(writing.recording.abandon())

    def close(self, timeout_sec: float | None = None) -> bool:
        """End all snapshots; return whether all their messages are stored or lost.

        Args:
            timeout_sec: Maximum time to wait for each snapshot, s; None = no maximum.
        """
        self._closing.set()
        for thread in list(self._threads):
            thread.join(timeout_sec)
        if any(thread.is_alive() for thread in self._threads):
            return False
        with self._mutex:
            beginning = bool(self._writing)
        if beginning:  # the run of a snapshot that was requested just now has not started yet
            time.sleep(PAUSE_SEC)
        return not beginning
