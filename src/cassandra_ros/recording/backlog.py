# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of a run that wait for the store: in memory, and on disk in the spool.

While the store keeps up, the writing thread takes messages from the buffer in memory, and nothing
here runs for them. When the store does not answer, when it has taken no message for STALL_SEC, or
when half of the buffer is full, a thread moves messages from the buffer to files of the spool. The
writing thread reads them back from there, in their order, and messages that come meanwhile go to
the end of the files. When all were read, messages go through memory again. Memory is bounded by the
buffer and by one file.

In a journal each message goes to a file first. While the store keeps up it is then handed over in
memory, and the file is deleted when the store has all its messages.

A file is deleted only after the store has acknowledged all its messages. What is written twice,
because a process was killed before, has the same keys as before.

Here, "taken" means: returned by ``next_messages`` to the writing thread. "Handed over" means: put
into the queue of a journal in memory, from which they are taken.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence

from cassandra_ros.errors import CassandraRosError, SpoolError
from cassandra_ros.files.spool.segment_reader import SegmentReader
from cassandra_ros.files.spool.segment_writer import SegmentWriter, SpooledMessage
from cassandra_ros.files.spool.spool_folder import RunFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel, TopicTotal, Totals
from cassandra_ros.keys import COUNTER_BITS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.recording.message_buffer import Buffer, BufferedMessage, MessageSource
from cassandra_ros.recording.recorder_options import SpoolPlan
from cassandra_ros.store.tables.registry import LossKind
from cassandra_ros.topics.message_writer import Handle

_log = logging.getLogger(__name__)

STALL_SEC = 1.0
"""Time in which the store takes no message, after which messages go to the spool, s."""
LOOK_SEC = 0.2
"""Interval at which it is checked whether the store keeps up, s."""
SPOOL_WRITE_SEC = 0.05
"""Interval at which messages are written to a file, s."""
SYNC_SEC = 0.8
"""Interval at which files are synced, s: with SPOOL_WRITE_SEC a power cut costs less than 1 s."""
SPOOL_WRITE_BYTES = 1 << 20
"""Size of messages that are written at once, bytes."""
MESSAGE_BYTES = 64
"""Size of a message in a file in addition to its bytes, about, bytes."""
SPOOL_WRITE_MESSAGES = 4096
"""Maximum number of messages that are written at once."""
SEGMENT_BYTES = 16 << 20
"""Size from which a file is not written any further, bytes."""
SEGMENT_CONNECTIONS = 60_000
"""Number of connections in a file from which it is not written any further."""
RETRY_SEC = 10.0
"""Pause after the disk has failed, s."""
TELL_FIRST_SEC = 2.0
"""How long messages go to the spool before it is told, s."""
TELL_SEC = 60.0
"""Interval at which it is told again, s."""
MOVE_TO_SPOOL_SEC = 10.0
"""Maximum time that the end waits until all messages of the buffer are in files, s."""
_COUNTER_MASK = (1 << COUNTER_BITS) - 1
"""Bits of a counter that a file has; the bits above are the number of overflows."""

Lose = Callable[[str, int, LossKind, int, int, str], None]
"""Counts lost messages: topic, number, kind, first and last time (ns), detail. It may be
called under the lock of the backlog, so it must not call the backlog."""


class OnDisk(NamedTuple):
    """How far the store is behind."""

    messages: int = 0
    """Number of messages that wait on disk."""
    nbytes: int = 0
    """Size of these messages, bytes."""
    behind_sec: float = 0.0
    """Time since the oldest of them was written there, s."""


@dataclass
class _SegmentFile:
    """A file of the run. Its attributes are changed under the lock of the backlog."""

    path: Path
    overflows: int
    """Number of times that the counter had overflowed, the same for all its messages."""
    handed: bool
    """Whether its messages were also handed over in memory, so that it is not read here."""
    totals: Totals = field(default_factory=dict)
    """The messages in it."""
    run_totals: Totals = field(default_factory=dict)
    """The messages in the files of the run up to the end of this one, once it is complete."""
    nbytes: int = 0
    """Size of the file, bytes."""
    message_bytes: int = 0
    """Size of its messages, bytes."""
    through: int = 0
    """If they are handed over: number of messages that the run had handed over with its last one.
    When so many are taken, all of this file are."""
    since: float = field(default_factory=time.monotonic)
    """Monotonic time of its first message, s."""

    def count(self, items: Sequence[BufferedMessage]) -> None:
        """Count messages that were written to it."""
        self.message_bytes += sum(len(item.wire) for item in items)
        for item in items:
            self.totals.setdefault(item.source.topic, TopicTotal()).add(1, item.t, item.t)


class _OpenSegment(NamedTuple):
    """The file that is being written."""

    writer: SegmentWriter
    segment: _SegmentFile


class Backlog:
    """The waiting messages of one run.

    ``next_messages``, ``delete_stored_files`` and ``put_aside`` are called by the writing thread.
    At the end another thread calls ``leave``, then (the writing thread has ended, the writers are
    closed) ``keep_rest`` and ``finish``; or, when all messages are stored or lost, ``close``. The
    other methods are called by any thread.

    Args:
        buffer: Messages in memory.
        plan: How the spool is used.
        label: Returns the label of the files after so many overflows of the counter.
        source_of: Returns the source of the messages of a connection.
        lose: Counts messages that the spool has lost.
        is_away: Returns whether messages were written that a silent store has not taken. Both
            threads call it.
    """

    def __init__(
        self,
        buffer: Buffer,
        plan: SpoolPlan,
        label: Callable[[int], SpoolLabel],
        source_of: Callable[[Connection], MessageSource],
        lose: Lose,
        is_away: Callable[[], bool],
    ) -> None:
        self._buffer, self._plan = buffer, plan
        self._label, self._source_of, self._lose = label, source_of, lose
        self._is_away = is_away
        self._journal = plan.journal
        # A full spool drops whole files: not more than an eighth of its maximum size at once.
        self._segment_bytes = min(SEGMENT_BYTES, max(plan.folder.max_bytes // 8, 1))
        # Its lock guards what follows, except ``_reading``, ``_unsynced`` and the times. It is
        # notified when messages are handed over.
        self._changed = threading.Condition(threading.RLock())
        self._folder: RunFolder | None = None
        self._open: _OpenSegment | None = None
        self._run_totals: Totals = {}
        """All messages that were written to files so far; the writers of files count them here."""
        self._parked: deque[_SegmentFile] = deque()
        """Complete files that are still to be read."""
        self._handed: deque[BufferedMessage] = deque()
        """Messages of the journal that are still to be taken."""
        self._unsynced: deque[SegmentWriter] = deque()
        """Complete files that are to be synced and closed."""
        self._unsettled: deque[_SegmentFile] = deque()
        """Complete files whose messages were handed over and may not all be taken yet."""
        self._taken_files: list[_SegmentFile] = []
        """Files whose messages were all taken and may not be stored yet."""
        self._given_back: list[tuple[int, SpooledMessage]] = []
        """Messages that the store gave back, with the number of overflows of the counter."""
        self._handed_count = self._taken_count = 0
        """Number of messages handed over in memory, and of those taken."""
        self._parking = False
        """Whether new messages go to files, not to the store; see doc/internals.md."""
        self._reading: Iterator[list[BufferedMessage]] | None = None
        """Rest of the file that is read; None = no file. Of the writing thread alone."""
        self._oldest: _SegmentFile | None = None
        """File that is read, or was read last; None = new messages go through memory."""
        self._taken_at = time.monotonic()
        """Monotonic time at which the writing thread asked for messages last, s."""
        self._since = self._told_at = 0.0
        """Monotonic times since which new messages go to files, and at which that was logged last,
        s; 0 = not logged."""
        self._messages = self._nbytes = 0
        """Number of messages that wait on disk to be read, and their size, bytes."""
        self._own_bytes = self._other_bytes = 0
        """Size of the files of this run, and of those of other runs in the spool, bytes."""
        self._measured_at = -RETRY_SEC
        """Monotonic time at which ``_other_bytes`` was measured, s."""
        self._has_gaps = False
        """Whether messages of the journal were ever handed over without being written. From then on
        its files alone do not have all that waits."""
        self._is_unwritten = False
        """Whether messages of the journal are handed over now without being written."""
        self.leaving = False
        """Whether messages are not taken any more and stay on disk."""
        self._retry_at = 0.0
        """Monotonic time before which nothing is written: the disk failed, or other runs fill the
        spool, s."""
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-spool", daemon=True)
        self._thread.start()

    def next_messages(
        self, most: int, most_bytes: int, timeout_sec: float
    ) -> list[BufferedMessage]:
        """Remove and return the oldest messages, as Buffer.next_messages does.

        Those read from a file are one chunk of it, of any size. They count in the buffer again
        until they are released. [] also while the store is away, and after ``leave``.
        """
        self._taken_at = time.monotonic()
        if self.leaving:
            return []
        if self._is_away() and self._park():  # more on their way would only fill the memory
            time.sleep(timeout_sec)
            return []
        if self._journal:
            taken = self._take_handed(most, most_bytes, 0 if self._parking else timeout_sec)
            if taken:
                return taken
        if self._parking:
            return self._read()
        return [] if self._journal else self._buffer.next_messages(most, most_bytes, timeout_sec)

    def _take_handed(self, most: int, most_bytes: int, timeout_sec: float) -> list[BufferedMessage]:
        """Take messages of the journal that were handed over; [] after the timeout."""
        taken: list[BufferedMessage] = []
        nbytes = 0
        with self._changed:
            if not self._handed:
                self._changed.wait(timeout_sec)
            while self._handed and len(taken) < most and nbytes < most_bytes:
                taken.append(self._handed.popleft())
                nbytes += taken[-1].nbytes
            self._taken_count += len(taken)
        return taken

    def _read(self) -> list[BufferedMessage]:
        """Read the next messages from the files; [] = the files hold no more."""
        while not self.leaving:
            if self._reading is None:
                segment = self._next_segment()
                if segment is None:
                    return []
                self._reading = self._messages_of(segment)
            items = next(self._reading, None)
            if items is None:
                self._reading = None
                continue
            self._buffer.hold(items)
            return items
        return []

    def _next_segment(self) -> _SegmentFile | None:
        """Return the next file to read; None = all were read, and messages go through memory."""
        with self._changed:
            if not self._parked and self._open is not None and not self._open.segment.handed:
                self._close_open()
            if self._parked:
                self._oldest = self._parked.popleft()
                return self._oldest
            self._parking, self._oldest = False, None
        if self._told_at:
            seconds = time.monotonic() - self._since
            _log.warning("the spool is empty again after %.0f s", seconds)
        return None

    def _messages_of(self, segment: _SegmentFile) -> Iterator[list[BufferedMessage]]:
        """Yield the messages of a file chunk by chunk; what cannot be read is lost.

        The caller asks for the next chunk only when it has routed the one before: so at the end all
        messages of the file are taken.
        """
        read: Counter[str] = Counter()
        read_bytes = 0
        sources: dict[int, MessageSource] = {}
        high_bits, why = segment.overflows << COUNTER_BITS, ""
        try:
            for segment_part in SegmentReader(segment.path).parts():
                why = why or segment_part.damage
                items: list[BufferedMessage] = []
                for connection, t_ns, counter, wire in segment_part.messages:
                    source = sources.get(id(connection))
                    if source is None:
                        source = sources[id(connection)] = self._source_of(connection)
                    items.append(BufferedMessage(source, t_ns, high_bits | counter, wire))
                    read[source.topic] += 1
                nbytes = sum(len(item.wire) for item in items)
                read_bytes += nbytes
                self._count_off_disk(len(items), nbytes)
                if items:
                    yield items
        except CassandraRosError as exc:
            why = str(exc)
        unread = sum(total.count for total in segment.totals.values()) - sum(read.values())
        self._count_off_disk(unread, segment.message_bytes - read_bytes)
        for topic, total in segment.totals.items():
            missing = total.count - read[topic]
            if missing:
                times = total.first_ns, total.last_ns
                self._lose(topic, missing, LossKind.SPOOL_DAMAGED, *times, why)
        with self._changed:
            self._taken_files.append(segment)

    def _count_off_disk(self, messages: int, nbytes: int) -> None:
        """Note that so many messages of this size wait on disk no more: read, or lost there."""
        with self._changed:
            self._messages -= messages
            self._nbytes = max(self._nbytes - nbytes, 0)

    def delete_stored_files(self, flush: Callable[[], None]) -> None:
        """Delete the files whose messages were all taken, after they are stored.

        Args:
            flush: Waits until each message that was taken is stored or lost.
        """
        with self._changed:
            while self._unsettled and self._unsettled[0].through <= self._taken_count:
                self._taken_files.append(self._unsettled.popleft())
            passed, self._taken_files = self._taken_files, []
        if not passed:
            return
        flush()
        with self._changed:
            if self.leaving:
                return  # a message may have been given back: the files stay, and are stored again
            for segment in passed:
                self._delete(segment)

    def _delete(self, segment: _SegmentFile) -> None:
        """Delete a complete file whose messages are stored or lost; the caller holds the lock."""
        self._own_bytes -= segment.nbytes
        if self._folder is not None:
            self._folder.delete_file(segment.path, segment.run_totals)

    @property
    def ended(self) -> bool:
        """Whether no further message will be taken."""
        with self._changed:
            if self.leaving:
                return True
            waits = self._handed or self._parking or self._reading is not None
            return self._buffer.ended and not waits

    def _run(self) -> None:
        """Write messages of the buffer to files, and sync these, until ``_done`` is set."""
        synced = time.monotonic()
        while not self._done.is_set():
            more = self._move()
            now = time.monotonic()
            if now - synced >= SYNC_SEC:
                synced = now
                self._sync()
                self._tell(now)
            if not more:
                self._done.wait(SPOOL_WRITE_SEC if self._journal or self._parking else LOOK_SEC)

    def _move(self) -> bool:
        """Write messages of the buffer to a file; return whether more may wait."""
        if not self._is_needed():
            return False
        with self._changed:
            if not (self._journal or self._parking):
                return False  # the writing thread has read all files meanwhile
            items = self._buffer.next_messages(SPOOL_WRITE_MESSAGES, SPOOL_WRITE_BYTES, 0.0)
            # All messages of a file have the same overflows: a file names one writer.
            overflows = items[0].counter >> COUNTER_BITS if items else 0
            of_one_writer = [item for item in items if item.counter >> COUNTER_BITS == overflows]
            if len(of_one_writer) < len(items):
                self._buffer.put_back(items[len(of_one_writer) :])
            if of_one_writer:
                self._keep(of_one_writer, self._journal and not self._parking)
        return (
            len(items) >= SPOOL_WRITE_MESSAGES or sum(i.nbytes for i in items) >= SPOOL_WRITE_BYTES
        )

    def _is_needed(self) -> bool:
        """Return whether messages are taken from the buffer now.

        Begin to send them through files if the store does not keep up. While the disk fails they
        stay in the buffer. Only a journal that is not read from files then takes them all the same,
        and hands them over without writing them.
        """
        now = time.monotonic()
        if self._retry_at > now and (self._parking or not self._journal):
            return False
        if not self._parking and self._retry_at <= now:
            waits = bool(self._handed) if self._journal else self._buffer.waits
            stalled = waits and now - self._taken_at > STALL_SEC
            if stalled or self._buffer.is_half_full or (self._journal and self._is_away()):
                self._park()
        return self._journal or self._parking

    def _park(self) -> bool:
        """Send messages through files from now on; return whether they go through files.

        While the disk fails, messages that go through memory go on so.
        """
        now = time.monotonic()
        with self._changed:
            if not self._parking and self._retry_at <= now:
                self._parking, self._since, self._told_at = True, now, 0.0
            return self._parking

    def _keep(self, items: Sequence[BufferedMessage], handed: bool) -> None:
        """Write messages of one number of overflows to a file; with ``handed`` hand them over, too.

        The caller holds the lock.
        """
        nbytes = sum(len(item.wire) for item in items)
        overflows = items[0].counter >> COUNTER_BITS
        if self._retry_at > time.monotonic() or not self._make_room(
            nbytes + MESSAGE_BYTES * len(items)
        ):
            self._do_without(items, handed)
            return
        try:
            writer, segment = self._segment(overflows, handed)
            before = writer.size
            rows = [(i.source.connection, i.t, i.counter & _COUNTER_MASK, i.wire) for i in items]
            writer.append(rows)
        except (OSError, CassandraRosError) as exc:
            self._fail(exc)
            self._do_without(items, handed)
            return
        segment.count(items)
        segment.nbytes = writer.size
        self._own_bytes += writer.size - before
        if handed:
            self._hand_over(items)
            segment.through = self._handed_count
            if self._is_unwritten:
                self._is_unwritten = False
                _log.warning("the journal in the spool %s is written again", self.path)
        else:
            self._messages += len(items)
            self._nbytes += nbytes
            self._buffer.release_all(items)
        if writer.size >= self._segment_bytes or writer.connections >= SEGMENT_CONNECTIONS:
            self._close_open()

    def _hand_over(self, items: Sequence[BufferedMessage]) -> None:
        """Let the writing thread take messages of the journal; the caller holds the lock."""
        self._handed.extend(items)
        self._handed_count += len(items)
        self._changed.notify_all()

    def _do_without(self, items: Sequence[BufferedMessage], handed: bool) -> None:
        """Go on with messages that cannot be written.

        A journal hands them over all the same. Otherwise they go back into the buffer if more room
        may come, else they are lost.
        """
        if handed:
            if not self._is_unwritten:
                _log.error(
                    "the spool %s is full or cannot be written: messages are stored without the "
                    "journal until there is room, so a kill -9 may lose more than 1 s; its own "
                    "files are deleted as soon as the store has their messages; other room is made "
                    "by %s",
                    self.path,
                    "deleting files on this disk"
                    if self._retry_at > time.monotonic()
                    else "'cassandra_bag spool drain' or 'spool drop', which take what earlier "
                    "recorders have left, or by a larger --spool-size",
                )
            self._is_unwritten = self._has_gaps = True
            # A complete file is deleted when the store has its messages: that makes room.
            if self._open is not None and self._open.segment.handed:
                self._close_open()
            self._hand_over(items)
        elif self._retry_at > time.monotonic():  # the disk fails: memory is what is left
            self._buffer.put_back(items)
        elif not (self._plan.drops_newest or self._buffer.is_half_full):
            # Other runs fill the spool, and there is no older message of this one to drop.
            self._buffer.put_back(items)
            self._retry_at = time.monotonic() + SYNC_SEC
        else:
            self._lose_totals(_totals_of((item.source.topic, item.t) for item in items))
            self._buffer.release_all(items)

    def _lose_totals(
        self,
        totals: Mapping[str, TopicTotal],
        kind: LossKind = LossKind.SPOOL_FULL,
        why: str = "option --spool-size",
    ) -> None:
        """Count messages as lost, by topic."""
        for topic, total in totals.items():
            self._lose(topic, total.count, kind, total.first_ns, total.last_ns, why)

    def _make_room(self, nbytes: int) -> bool:
        """Delete the oldest files if the spool is full; return whether so many bytes fit."""
        now = time.monotonic()
        if now - self._measured_at > SYNC_SEC:
            self._measured_at = now
            self._other_bytes = self._plan.folder.nbytes() - self._own_bytes
        most_own_bytes = self._plan.folder.max_bytes - max(self._other_bytes, 0) - nbytes
        while self._own_bytes > most_own_bytes:
            if self._plan.drops_newest or not self._parked:
                return False
            oldest = self._parked.popleft()
            self._messages -= sum(total.count for total in oldest.totals.values())
            self._nbytes = max(self._nbytes - oldest.message_bytes, 0)
            self._lose_totals(oldest.totals)
            self._delete(oldest)
        return True

    def _segment(self, overflows: int, handed: bool) -> _OpenSegment:
        """Return the file for messages of this kind; open a new one if the open one is another.

        The caller holds the lock.

        Raises:
            OSError, SpoolError: The disk is full, or fails, or the folder cannot be made.
        """
        opened = self._open
        if opened is not None:
            segment = opened.segment
            if segment.overflows == overflows and segment.handed == handed:
                return opened
            self._close_open()
        label = self._label(overflows)
        if self._folder is None:
            self._folder = self._plan.folder.begin(label.run)
        path = self._folder.new_file()
        writer = SegmentWriter(path, label, self._run_totals)
        self._own_bytes += writer.size
        self._open = _OpenSegment(writer, _SegmentFile(path, overflows, handed))
        return self._open

    def _close_open(self) -> None:
        """Complete the open file, if there is one; ``_sync`` closes it. The caller holds the lock.

        It can be read, and deleted, before it is closed.
        """
        opened, self._open = self._open, None
        if opened is None:
            return
        # Copies: the writer of the next file counts on in the same objects.
        copies = {topic: replace(total) for topic, total in self._run_totals.items()}
        opened.segment.run_totals = copies
        if opened.segment.handed:
            self._unsettled.append(opened.segment)
        else:
            self._parked.append(opened.segment)
        self._unsynced.append(opened.writer)

    def _fail(self, exc: Exception) -> None:
        """Write nothing for RETRY_SEC, because the disk failed; log it."""
        self._retry_at = time.monotonic() + RETRY_SEC
        why = exc.strerror or str(exc) if isinstance(exc, OSError) else str(exc)
        _log.error(
            "the spool %s cannot be written: %s; messages wait in memory only, and it is tried "
            "again in %.0f s",
            self._plan.folder.path,
            why,
            RETRY_SEC,
        )

    def _sync(self) -> None:
        """Write the open file to the disk, and close the complete ones."""
        with self._changed:
            opened, ended = self._open, len(self._unsynced)
        # Without the lock: a slow disk must not hold up the writing thread.
        try:
            for _ in range(ended):
                self._unsynced.popleft().close()
            if opened is not None:
                opened.writer.sync()
        except OSError as exc:
            self._fail(exc)

    def _tell(self, now: float) -> None:
        """Log at intervals that messages wait on disk."""
        if not self._parking or self.leaving or now - self._since < TELL_FIRST_SEC:
            return
        if self._told_at and now - self._told_at < TELL_SEC:
            return
        self._told_at = now
        on_disk = self.on_disk()
        if on_disk.messages:
            _log.warning(
                "the store does not keep up: %d messages (%.1f MB) wait in the spool %s, the "
                "oldest for %.0f s",
                on_disk.messages,
                on_disk.nbytes / 1e6,
                self._plan.folder.path,
                on_disk.behind_sec,
            )

    @property
    def path(self) -> str:
        """Path of the spool."""
        return str(self._plan.folder.path)

    def on_disk(self) -> OnDisk:
        """Return how far the store is behind."""
        with self._changed:
            if not self._messages:
                return OnDisk()
            files = [self._oldest, *list(self._parked)[:1], self._open and self._open.segment]
            times = [file.since for file in files if file is not None and not file.handed]
            now = time.monotonic()
            return OnDisk(self._messages, self._nbytes, now - min(times, default=now))

    def leave(self) -> None:
        """Take no message any more, and let the buffer be emptied into files.

        The buffer must be closed. What is not in files after MOVE_TO_SPOOL_SEC, or if the disk
        fails, ``keep_rest`` writes.
        """
        with self._changed:
            self.leaving = self._parking = True
            self._close_open()
            if self._has_gaps:  # else the files of the journal have them
                self._given_back += map(_spooled_row, self._handed)
            self._buffer.release_all(self._handed)
            self._handed.clear()
        ends = time.monotonic() + MOVE_TO_SPOOL_SEC
        while self._buffer.waits and time.monotonic() < ends and self._retry_at < time.monotonic():
            time.sleep(SPOOL_WRITE_SEC)

    def take_back(
        self, overflows: int, handle: Handle, t_ns: int, counter: int, wire: bytes
    ) -> None:
        """Keep a message that was taken and that the store did not take."""
        if not self._journal or self._has_gaps:  # else the files of the journal have it
            with self._changed:
                self._given_back.append((overflows, (handle.connection, t_ns, counter, wire)))

    def put_aside(self, items: Sequence[BufferedMessage]) -> None:
        """Keep messages that were taken and not written to the store."""
        if not self._journal or self._has_gaps:  # else the files of the journal have them
            with self._changed:
                self._given_back += map(_spooled_row, items)

    def keep_rest(self) -> None:
        """Write the messages that were given back, and those that are still in the buffer.

        Messages that cannot be written are counted as lost. Call it after the writers are closed:
        until then they give messages back.
        """
        self._done.set()
        self._thread.join()
        with self._changed:
            while items := self._buffer.next_messages(SPOOL_WRITE_MESSAGES, SPOOL_WRITE_BYTES, 0.0):
                self._given_back += map(_spooled_row, items)
                self._buffer.release_all(items)
            by_overflows: dict[int, list[SpooledMessage]] = {}
            for overflows, row in self._given_back:
                by_overflows.setdefault(overflows, []).append(row)
            for overflows, rows in sorted(by_overflows.items()):
                for first in range(0, len(rows), SPOOL_WRITE_MESSAGES):
                    self._keep_rows(overflows, rows[first : first + SPOOL_WRITE_MESSAGES])
            self._given_back.clear()

    def _keep_rows(self, overflows: int, rows: Sequence[SpooledMessage]) -> None:
        """Write messages of one number of overflows, or count them as lost."""
        totals = _totals_of((connection.topic, t) for connection, t, _, _ in rows)
        if not self._make_room(sum(len(row[3]) + MESSAGE_BYTES for row in rows)):
            self._lose_totals(totals)
            return
        try:
            self._segment(overflows, False).writer.append(rows)
        except (OSError, CassandraRosError) as exc:
            self._lose_totals(totals, LossKind.AT_END, str(exc))

    def finish(self, end: RunEnd) -> None:
        """Write the end of the run, after ``keep_rest``; the files stay.

        Raises:
            OSError, SpoolError: The disk is full, or fails.
        """
        with self._changed:
            writer, _ = self._segment(0, False)
            writer.finish(end)
            self._close_open()
        self._sync()
        if self._folder is not None:
            self._folder.release()

    def close(self) -> None:
        """Delete the files: all messages are stored or lost."""
        self._done.set()
        self._thread.join()
        with self._changed:
            self._close_open()
        self._sync()
        if self._folder is not None:
            try:
                self._folder.remove()
            except SpoolError as exc:
                _log.warning("the messages of the spool are stored, but %s", exc)


def _totals_of(messages: Iterable[tuple[str, int]]) -> Totals:
    """Return the totals by topic of messages of which topic and time (ns) are given."""
    totals: Totals = {}
    for topic, t in messages:
        totals.setdefault(topic, TopicTotal()).add(1, t, t)
    return totals


def _spooled_row(item: BufferedMessage) -> tuple[int, SpooledMessage]:
    """Return the number of overflows of a message's counter, and the message as files have it."""
    row = (item.source.connection, item.t, item.counter & _COUNTER_MASK, item.wire)
    return item.counter >> COUNTER_BITS, row
