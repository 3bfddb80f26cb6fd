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
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence

from cassandra_ros.errors import CassandraRosError
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
_LOW = (1 << COUNTER_BITS) - 1

Lose = Callable[[str, int, LossKind, int, int, str], None]
"""Counts lost messages: topic, number, kind, first and last time (ns), detail."""


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
    """A file of the run."""

    path: Path
    overflows: int
    """Number of times that the counter had overflowed."""
    handed: bool
    """Whether its messages were also handed over in memory."""
    totals: Totals = field(default_factory=dict)
    """The messages in it."""
    run_totals: Totals = field(default_factory=dict)
    """The messages of the run up to its end, when it is complete."""
    nbytes: int = 0
    """Size of the file, bytes."""
    message_bytes: int = 0
    """Size of its messages, bytes."""
    through: int = 0
    """Number of messages handed over when its last one was."""
    since: float = field(default_factory=time.monotonic)
    """Monotonic time of its first message, s."""

    def count(self, items: Sequence[BufferedMessage]) -> None:
        """Count messages that were written to it."""
        self.message_bytes += sum(len(item.wire) for item in items)
        for item in items:
            self.totals.setdefault(item.source.topic, TopicTotal()).add(1, item.t, item.t)


class _OpenSegment(NamedTuple):
    writer: SegmentWriter
    segment: _SegmentFile


class Backlog:
    """The waiting messages of one run.

    ``next_messages`` and ``delete_stored_files`` are called by one thread.

    Args:
        buffer: Messages in memory.
        plan: How the spool is used.
        label: Returns the label of the files after so many overflows of the counter.
        source_of: Returns the source of the messages of a connection.
        lose: Counts messages that the spool has lost.
        is_away: Returns whether messages were written that a silent store has not taken.
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
        self._most_bytes = min(SEGMENT_BYTES, max(plan.folder.max_bytes // 8, 1))
        self._changed = threading.Condition(threading.RLock())
        self._folder: RunFolder | None = None
        self._open: _OpenSegment | None = None
        self._run_totals: Totals = {}
        """The messages that were written to files."""
        self._parked: deque[_SegmentFile] = deque()
        """Complete files that are still to be read."""
        self._handed: deque[BufferedMessage] = deque()
        """Messages of the journal that are still to be taken."""
        self._unsynced: deque[SegmentWriter] = deque()
        """Complete files that are to be synced and closed."""
        self._unsettled: deque[_SegmentFile] = deque()
        """Complete files whose messages were handed over."""
        self._passed: list[_SegmentFile] = []
        """Files whose messages were all taken and may not be stored yet."""
        self._back: list[tuple[int, SpooledMessage]] = []
        """Messages that the store gave back, with the number of overflows of the counter."""
        self._given = self._taken = 0
        """Number of messages handed over in memory, and of those taken."""
        self._parking = False
        """Whether new messages go to files, not to the store; see doc/internals.md."""
        self._reading: Iterator[list[BufferedMessage]] | None = None
        self._oldest: _SegmentFile | None = None
        """File that is read, or was read last."""
        self._taken_at = time.monotonic()
        self._since = self._told = 0.0
        """Monotonic times since which new messages go to files, and at which that was told last,
        s."""
        self._messages = self._nbytes = 0
        """Number of messages that wait on disk, and their size, bytes."""
        self._own_bytes = self._other_bytes = 0
        """Size of the files of this run, and of those of other runs in the spool, bytes."""
        self._measured = -RETRY_SEC
        self._gaps = False
        """Whether messages of the journal were handed over without being written."""
        self._bare = False
        """Whether they are now."""
        self.leaving = False
        """Whether messages are not taken any more and stay on disk."""
        self._retry_at = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-spool", daemon=True)
        self._thread.start()

    # ---------------------------------------------------------------- the writing thread

    def next_messages(
        self, most: int, most_bytes: int, timeout_sec: float
    ) -> list[BufferedMessage]:
        """Remove and return the oldest messages, as Buffer.next_messages does.

        Those read from a file are one chunk of it, of any size.
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
        taken: list[BufferedMessage] = []
        nbytes = 0
        with self._changed:
            if not self._handed:
                self._changed.wait(timeout_sec)
            while self._handed and len(taken) < most and nbytes < most_bytes:
                taken.append(self._handed.popleft())
                nbytes += taken[-1].nbytes
            self._taken += len(taken)
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
        with self._changed:
            if not self._parked and self._open is not None and not self._open.segment.handed:
                self._close_open()
            if self._parked:
                self._oldest = self._parked.popleft()
                return self._oldest
            self._parking, self._oldest = False, None
        if self._told:
            seconds = time.monotonic() - self._since
            _log.warning("the spool is empty again after %.0f s", seconds)
        return None

    def _messages_of(self, segment: _SegmentFile) -> Iterator[list[BufferedMessage]]:
        """Yield the messages of a file chunk by chunk; what cannot be read is lost."""
        read: Counter[str] = Counter()
        read_bytes = 0
        sources: dict[int, MessageSource] = {}
        high, why = segment.overflows << COUNTER_BITS, ""
        try:
            for segment_part in SegmentReader(segment.path).parts():
                why = why or segment_part.damage
                items: list[BufferedMessage] = []
                for connection, t_ns, counter, wire in segment_part.messages:
                    source = sources.get(id(connection))
                    if source is None:
                        source = sources[id(connection)] = self._source_of(connection)
                    items.append(BufferedMessage(source, t_ns, high | counter, wire))
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
            self._passed.append(segment)

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
            while self._unsettled and self._unsettled[0].through <= self._taken:
                self._passed.append(self._unsettled.popleft())
            passed, self._passed = self._passed, []
        if not passed:
            return
        flush()
        with self._changed:
            if self.leaving:
                return  # a message may have been given back
            for segment in passed:
                self._delete(segment)

    def _delete(self, segment: _SegmentFile) -> None:
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

    # ---------------------------------------------------------------- the spool's thread

    def _run(self) -> None:
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
            high = items[0].counter >> COUNTER_BITS if items else 0
            same = [item for item in items if item.counter >> COUNTER_BITS == high]
            if len(same) < len(items):
                self._buffer.put_back(items[len(same) :])
            if same:
                self._keep(same, self._journal and not self._parking)
        return (
            len(items) >= SPOOL_WRITE_MESSAGES or sum(i.nbytes for i in items) >= SPOOL_WRITE_BYTES
        )

    def _is_needed(self) -> bool:
        """Decide whether messages go to files now."""
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
        """Send messages through files from now on; return False if the disk failed."""
        now = time.monotonic()
        with self._changed:
            if not self._parking and self._retry_at <= now:
                self._parking, self._since, self._told = True, now, 0.0
            return self._parking

    def _keep(self, items: Sequence[BufferedMessage], handed: bool) -> None:
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
            rows = [(i.source.connection, i.t, i.counter & _LOW, i.wire) for i in items]
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
            segment.through = self._given
            if self._bare:
                self._bare = False
                _log.warning("the journal in the spool %s is written again", self.path)
        else:
            self._messages += len(items)
            self._nbytes += nbytes
            self._buffer.release_all(items)
        if writer.size >= self._most_bytes or writer.connections >= SEGMENT_CONNECTIONS:
            self._close_open()

    def _hand_over(self, items: Sequence[BufferedMessage]) -> None:
        self._handed.extend(items)
        self._given += len(items)
        self._changed.notify_all()

    def _do_without(self, items: Sequence[BufferedMessage], handed: bool) -> None:
        """Go on with messages that cannot be written."""
        if handed:
            if not self._bare:
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
            self._bare = self._gaps = True
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
        for topic, total in totals.items():
            self._lose(topic, total.count, kind, total.first_ns, total.last_ns, why)

    def _make_room(self, nbytes: int) -> bool:
        """Delete the oldest files if the spool is full; return whether so many bytes fit."""
        now = time.monotonic()
        if now - self._measured > SYNC_SEC:
            self._measured = now
            self._other_bytes = self._plan.folder.nbytes() - self._own_bytes
        most = self._plan.folder.max_bytes - max(self._other_bytes, 0) - nbytes
        while self._own_bytes > most:
            if self._plan.drops_newest or not self._parked:
                return False
            oldest = self._parked.popleft()
            self._messages -= sum(total.count for total in oldest.totals.values())
            self._nbytes = max(self._nbytes - oldest.message_bytes, 0)
            self._lose_totals(oldest.totals)
            self._delete(oldest)
        return True

    def _segment(self, overflows: int, handed: bool) -> _OpenSegment:
        """Return the file to write to."""
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
        opened, self._open = self._open, None
        if opened is None:
            return
        ends = {topic: replace(total) for topic, total in self._run_totals.items()}
        opened.segment.run_totals = ends
        if opened.segment.handed:
            self._unsettled.append(opened.segment)
        else:
            self._parked.append(opened.segment)
        self._unsynced.append(opened.writer)

    def _fail(self, exc: Exception) -> None:
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
        if self._told and now - self._told < TELL_SEC:
            return
        self._told = now
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

    # ---------------------------------------------------------------- state and end

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

    def leave(self) -> bool:
        """Move all messages to files and take none any more; return whether all are there.

        The buffer must be closed.
        """
        with self._changed:
            self.leaving = self._parking = True
            self._close_open()
            if self._gaps:
                self._back += [_spooled_row(item) for item in self._handed]
            self._buffer.release_all(self._handed)
            self._handed.clear()
        ends = time.monotonic() + MOVE_TO_SPOOL_SEC
        while self._buffer.waits and time.monotonic() < ends and self._retry_at < time.monotonic():
            time.sleep(SPOOL_WRITE_SEC)
        return not self._buffer.waits

    def take_back(
        self, overflows: int, handle: Handle, t_ns: int, counter: int, wire: bytes
    ) -> None:
        """Keep a message that was taken and that the store did not take. Thread-safe."""
        if not self._journal or self._gaps:
            with self._changed:
                self._back.append((overflows, (handle.connection, t_ns, counter, wire)))

    def put_aside(self, items: Sequence[BufferedMessage]) -> None:
        """Keep messages that were taken and not written."""
        if not self._journal or self._gaps:
            with self._changed:
                self._back += map(_spooled_row, items)

    def keep_rest(self) -> None:
        """Write the messages that were given back, and those that are left in the buffer.

        Messages that cannot be written are counted as lost.
        """
        self._done.set()
        self._thread.join()
        with self._changed:
            while items := self._buffer.next_messages(SPOOL_WRITE_MESSAGES, SPOOL_WRITE_BYTES, 0.0):
                self._back += map(_spooled_row, items)
                self._buffer.release_all(items)
            for overflows in sorted({overflows for overflows, _ in self._back}):
                rows = [row for row_overflows, row in self._back if row_overflows == overflows]
                for first in range(0, len(rows), SPOOL_WRITE_MESSAGES):
                    self._keep_rows(overflows, rows[first : first + SPOOL_WRITE_MESSAGES])
            self._back.clear()

    def _keep_rows(self, overflows: int, rows: Sequence[SpooledMessage]) -> None:
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
            self._folder.remove()


def _totals_of(messages: Iterable[tuple[str, int]]) -> Totals:
    """Return the totals by topic of messages of which topic and time (ns) are given."""
    totals: Totals = {}
    for topic, t in messages:
        totals.setdefault(topic, TopicTotal()).add(1, t, t)
    return totals


def _spooled_row(item: BufferedMessage) -> tuple[int, SpooledMessage]:
    row = (item.source.connection, item.t, item.counter & _LOW, item.wire)
    return item.counter >> COUNTER_BITS, row
