# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store what runs have left in the spool: their messages, losses, and their end.

Rows get the writer id, counters, times and connection headers that they would have had. Repeated
rows replace themselves; a message that a block holds already is left out. So a drain may be
interrupted at any time, and be done again.
"""

from __future__ import annotations

import logging
import math
import os
import threading
from bisect import bisect_right
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Callable, Mapping

from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    CorruptMessage,
    DefinitionError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    SchemaConflict,
    SpoolError,
    StoreUnavailable,
    UnknownFormat,
    WriteFailed,
)
from cassandra_ros.files.spool.message_account import MessageAccount
from cassandra_ros.files.spool.segment_reader import Missing, SegmentPart, SegmentReader
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import RunFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel, TopicTotal
from cassandra_ros.keys import COUNTER_BITS, MAX_NS, SECOND_NS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.message_buffer import lengths_for
from cassandra_ros.recording.table_maker import MAX_CONFLICTS, PAUSE_SEC, connect
from cassandra_ros.recording.topic_settings import RecordingSettings, settings_from_json
from cassandra_ros.store.connection.driver_errors import is_denied
from cassandra_ros.store.tables.lengths import Lengths
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import Handle, MessageWriter

_log = logging.getLogger(__name__)

MISSING_END_NS = SECOND_NS
"""Maximum time after the last sign of life of a killed recorder in which messages are missing, ns.
"""
POLL_SEC = 0.1
"""Interval at which a drain that waits for the store checks whether it is to end, s."""

_NEVER = (DefinitionError, CorruptMessage, InvalidKey, InvalidName, InvalidOption, UnknownFormat)
"""Errors for which messages are never stored. Other reasons may pass, as a table of another
version or a lock that is held."""
Progress = Callable[[int], object]
"""Called with the number of messages that were stored since the last call."""


@dataclass(frozen=True)
class LeftRun:
    """A run that a process has left in the spool."""

    folder: RunFolder
    label: SpoolLabel | None
    """Label of the run; None = it is damaged in all files."""
    end: RunEnd | None
    """End of the run; None = the process was killed."""
    problem: str = ""
    """Reason why the run cannot be read; '' = it can be read."""

    @property
    def name(self) -> str:
        """Name of the run, or else its writer id."""
        return (self.label.name if self.label else "") or self.folder.path.name

    def alive_ns(self) -> int:
        """Return the last sign of life of its process, wall clock, ns; 0 = not known."""
        times = []
        for path in self.folder.files():
            with suppress(OSError):
                times.append(path.stat().st_mtime_ns)
        return max(times, default=0)


def read_left(folder: RunFolder) -> LeftRun:
    """Read label and end of a run that was left. What cannot be read is said in ``problem``."""
    label, end, problem = None, None, ""
    files = folder.files()
    for path in files:
        try:
            if label is None or path == files[-1]:
                reader = SegmentReader(path)
                label = label or reader.label()
                end = reader.end()
        except CassandraRosError as exc:
            problem = problem or str(exc)
    if label is None and not problem:
        problem = (
            f"no file in {folder.path} has a label that can be read, so it is not known to which "
            "run and store the messages belong; write them into a file with: rosrun cassandra_ros "
            f"cassandra_bag spool export {folder.path.name} rest.mcap, and import it; then delete "
            f"them with: spool drop {folder.path.name}"
        )
    return LeftRun(folder, label, end, "" if label is not None else problem)


@dataclass
class Drained:
    """What a drain did."""

    run: str
    messages: int = 0
    """Number of messages that are stored now."""
    lost: Counter[str] = field(default_factory=Counter)
    """Number of messages by topic that could not be read or stored. Topic '' = not known; number
    0 = not known."""
    stays: dict[str, str] = field(default_factory=dict)
    """Topics whose messages stay in the spool, and why: the reason may pass."""
    complete: bool = False
    """Whether nothing of the run is left in the spool."""


class Drain:
    """The drain of one run. ``stop`` may be called by any thread.

    Args:
        catalog: The store.
        left_run: The run; its folder is locked by this process.

    Raises:
        SpoolError: The run cannot be read.
        InvalidOption: Its settings cannot be used.
    """

    def __init__(self, catalog: Catalog, left_run: LeftRun) -> None:
        if left_run.label is None:
            raise SpoolError(
                f"the spool of run {left_run.name} cannot be drained: {left_run.problem}"
            )
        self._catalog, self._keyspace = catalog, catalog.keyspace
        self._left_run, self._label = left_run, left_run.label
        self._settings: RecordingSettings = settings_from_json(left_run.label.settings)
        self._writers: dict[int, MessageWriter] = {}
        """Writers by their writer ids."""
        self._handles: dict[tuple[int, Connection], Handle] = {}
        """By writer id and connection; only of connections whose messages can be stored."""
        self._account = MessageAccount(left_run.folder)
        self._read_numbers = _NumberRanges()
        """Sequence numbers of the messages that were read."""
        self._missing: list[Missing] = []
        """Messages that the files miss, as far as ``_store_losses`` has not stored them."""
        self._losses = LossLog(left_run.label.node, left_run.label.run)
        """Losses that are not stored yet."""
        self._drained = Drained(left_run.name)
        """What was done so far."""
        self._is_silent = False
        """Whether the store has stopped answering, or the drain was stopped: then some messages
        that were given to a writer are not stored, and their file must stay."""
        self._refusals = 0
        """Number of messages of the present file that the store refused."""
        self._stopped = threading.Event()
        self._last_counter = -1
        """Largest counter of the messages that were read; -1 = none."""

    def stop(self) -> None:
        """End the drain soon; what is not stored by then stays in the spool."""
        self._stopped.set()
        for writer in list(self._writers.values()):
            writer.hurry(0.0)

    def run(self, progress: Progress = lambda messages: None) -> Drained:
        """Store everything; return what was done.

        Raises:
            CassandraRosError: The store does not answer, or refuses the run; what is not stored
                stays in the spool.
        """
        self._begin()
        try:
            files = self._left_run.folder.files()
            for path in files:
                if self._stopped.is_set():
                    return self._drained
                stays = self._store(path, progress)
                if self._is_silent or self._stopped.is_set():
                    return self._drained
                # With messages of any file the last one stays, too: it tells how the run ended.
                if stays or (self._drained.stays and path == files[-1]):
                    self._keep_staying(path)
                elif path != files[-1]:
                    self._left_run.folder.delete_file(path, self._account.totals())
            if not self._drained.stays:
                for missing_part in self._account.finish():
                    self._note(missing_part)
                self._store_losses()
                self._end()
        finally:
            for writer in self._writers.values():
                with suppress(StoreUnavailable):
                    writer.close()
        if not self._drained.stays:
            try:
                self._left_run.folder.remove()
                self._drained.complete = True
            except SpoolError as exc:
                _log.warning("the messages of run %s are stored, but %s", self._drained.run, exc)
        return self._drained

    def _begin(self) -> None:
        """Make the entry of the run, if it never reached the store.

        Otherwise take robot, name and labels from it: they may have been changed since.
        """
        label = self._label
        runs = [run for run in self._keyspace.registry.runs() if run.writer == label.run]
        if runs and all(run.node != label.node for run in runs):
            # The run has got another robot since.
            self._label = replace(label, node=runs[0].node)
            self._losses = LossLog(runs[0].node, label.run)
        for run in runs:
            if run.node == self._label.node:
                self._label = replace(self._label, name=run.name, labels=run.labels)
        if not runs:
            self._keyspace.side_tables.make()
            begun = _time(label.begun_ns)
            self._keyspace.registry.put_run(replace(self._run_entry(), started=begun))

    def _run_entry(self) -> Run:
        """Return the run as it is listed in the store, without times and numbers of messages."""
        label = self._label
        return Run(
            label.node,
            label.run,
            "recording",
            name=label.name,
            format=self._settings.default.format or "",
            labels=dict(label.labels),
        )

    def _keep_staying(self, path: Path) -> None:
        """Leave in a file only the messages that stay: the others are stored, and may be deleted.

        If the disk is full the whole file stays, and its messages are stored once more.
        """
        reader, kept = SegmentReader(path), path.with_suffix(".kept")
        try:
            written = path.stat()
            kept.unlink(missing_ok=True)
            segment = SegmentWriter(kept, reader.label() or self._label)
            try:
                for segment_part in reader.parts():
                    rows = [
                        row for row in segment_part.messages if row[0].topic in self._drained.stays
                    ]
                    if rows:
                        segment.append(rows)
                if (end := reader.end()) is not None:
                    segment.finish(end)
            finally:
                segment.close()
            # Its time of writing tells when a killed recorder was alive last.
            os.utime(kept, ns=(written.st_atime_ns, written.st_mtime_ns))
            self._left_run.folder.note_settled(path, self._account.totals())
            kept.replace(path)
        except OSError as exc:
            _log.warning("%s stays in the spool with all its messages: %s", path, exc)

    def _store(self, path: Path, progress: Progress) -> bool:
        """Store the messages of one file; return whether some of them stay in it."""
        reader = SegmentReader(path)
        writer = self._writer((reader.label() or self._label).writer)
        totals, stored_blocks = reader.totals(), _StoredBlocks(self._keyspace, writer.writer_id)
        # By id of a connection, which the reader keeps; None = its messages are not stored.
        handles: dict[int, Handle | None] = {}
        count, self._refusals = 0, 0
        for segment_part in self._account.parts(reader):
            self._note(segment_part)
            for connection, t_ns, counter, wire in segment_part.messages:
                self._read_numbers.add(writer.writer_id << COUNTER_BITS | counter)
                if id(connection) not in handles:
                    handles[id(connection)] = self._handle(writer, connection, reader, totals, wire)
                handle = handles[id(connection)]
                if connection.topic in self._drained.stays:
                    continue
                self._last_counter = max(self._last_counter, counter)
                if handle is None:
                    self._miss(connection.topic, 1, t_ns, t_ns, LossKind.NO_TABLE)
                    continue
                count += 1
                if not stored_blocks.has(handle, t_ns, counter, totals):
                    writer.write(handle, t_ns, counter, wire)
            if self._is_silent or self._stopped.is_set():
                return False
            progress(len(segment_part.messages))
        writer.flush()
        if not self._is_silent:
            self._drained.messages += count - self._refusals
            self._store_losses()
        return any(
            file_connection.topic in self._drained.stays
            for file_connection in reader.connections.values()
        )

    def _writer(self, writer_id: int) -> MessageWriter:
        """Return the writer that repeats rows under a writer id, without storing a run."""
        writer = self._writers.get(writer_id)
        if writer is None:
            writer = self._writers[writer_id] = MessageWriter(
                self._keyspace,
                writer_id,
                format=self._settings.default.format,
                node=self._label.node,
                ttl=self._settings.default.ttl,
                give_up_after_sec=math.inf,
                on_loss=self._on_refusal,
            )
        return writer

    def _on_refusal(self, topic: str, messages: int, error: CassandraRosError) -> None:
        """Note messages that a writer has given up; called on any thread, at the latest by flush.

        They stay in the spool if the store did not answer, or denied access. Others are lost.
        """
        causes = error, error.__cause__
        if self._stopped.is_set() or any(isinstance(exc, StoreUnavailable) for exc in causes):
            self._is_silent = True
            return
        self._refusals += messages
        if any(map(is_denied, causes)):
            self._drained.stays[topic] = str(error)
            return
        first = getattr(error, "first_ns", 0) or self._label.begun_ns
        last = getattr(error, "last_ns", 0) or first
        self._miss(topic, messages, first, last, LossKind.REFUSED)

    def _handle(
        self,
        writer: MessageWriter,
        connection: Connection,
        reader: SegmentReader,
        totals: Mapping[int, TopicTotal],
        wire: bytes,
    ) -> Handle | None:
        """Return the handle of a connection, whose table is made if it is missing.

        Args:
            totals: Messages in the file by channel id, of which a table's lengths are computed.
            wire: A message of the connection: its size is taken for that of all.

        Returns:
            None = its messages are not stored: they stay (see ``stays``), or are lost.

        Raises:
            StoreUnavailable, AccessDenied: Nothing can be stored now.
        """
        if connection.topic in self._drained.stays:
            return None
        key = (writer.writer_id, connection)
        if key not in self._handles:
            channels = [n for n, other in reader.connections.items() if other == connection]
            total = next((totals[n] for n in channels if n in totals), TopicTotal(1, 0, 0))
            seconds = (total.last_ns - total.first_ns) / SECOND_NS
            lengths = lengths_for(total.count, total.count * len(wire), seconds)
            try:
                self._handles[key] = self._connect(writer, connection, lengths)
            except (StoreUnavailable, AccessDenied):
                raise  # nothing is stored now
            except _NEVER as exc:
                _log.error("topic %s cannot be stored: %s", connection.topic, exc)
                return None
            except CassandraRosError as exc:
                self._drained.stays[connection.topic] = str(exc)
                return None
        return self._handles[key]

    def _connect(self, writer: MessageWriter, connection: Connection, lengths: Lengths) -> Handle:
        """Return a handle; try again while other clients change the table or hold the lock.

        Raises what ``table_maker.connect`` raises.
        """
        for _ in range(MAX_CONFLICTS - 1):
            try:
                return connect(writer, connection, lengths, self._settings)
            except (SchemaConflict, WriteFailed):
                if self._stopped.wait(PAUSE_SEC):
                    raise
        return connect(writer, connection, lengths, self._settings)

    def _note(self, segment_part: SegmentPart) -> None:
        """Log what is damaged, and note what is missing for ``_store_losses``."""
        if segment_part.damage:
            _log.warning("run %s: %s", self._left_run.name, segment_part.damage)
        self._missing += segment_part.missing

    def _miss(
        self,
        topic: str,
        messages: int,
        first_ns: int,
        last_ns: int,
        kind: LossKind = LossKind.SPOOL_DAMAGED,
    ) -> None:
        """Count messages that cannot be stored; topic '' = not known, messages 0 = not known."""
        self._drained.lost[topic] += messages
        if topic:
            self._losses.add(topic, kind, messages, first_ns, last_ns, "")

    def _store_losses(self) -> None:
        """Store the losses found so far: the file that tells them may be deleted next."""
        for topic, messages, first, last in self._missing:
            lost = messages - self._stored_of(topic, first, last) if messages else 0
            if lost > 0 or not messages:
                self._miss(topic, lost, first, last)
        self._missing.clear()
        for loss in self._losses.unsaved():
            self._keyspace.registry.put_loss(loss)
        self._losses = LossLog(self._label.node, self._label.run)

    def _stored_of(self, topic: str, first_ns: int, last_ns: int) -> int:
        """Return how many messages of a time range are stored that were not read from a file.

        Those of a journal are usually stored before the recorder is killed.
        """
        tables = self._catalog.tables([topic]) if self._catalog.exists(topic) else []
        tables = [table for table in tables if not table.named]
        whose = Whose((self._label.node,), frozenset(self._writers) | {self._label.run})
        stored = 0
        for table in tables:
            time_range = TimeRange() if table.metadata.own_time else TimeRange(first_ns, last_ns)
            for row in self._keyspace.rows.read(
                [table], Read(time_range, whose, columns=lambda _: ())
            ):
                is_there = first_ns <= row.received <= last_ns
                stored += is_there and not self._read_numbers.has(row.position.seq)
        return stored

    def _end(self) -> None:
        """Store how the run ended."""
        end, registry, label = self._left_run.end, self._keyspace.registry, self._label
        if end is None:
            self._note_gap()
            registry.put_heartbeat(label.run, label.node, interrupted=True)
            return
        for topic, kind, first, last, count in end.losses:
            loss = Loss(topic, label.node, label.run, LossKind(kind), first, last, count)
            registry.put_loss(loss)
        missing = self._missing_of_all_drains(end)
        stored = {t: max(n - missing[t], 0) for t, n in end.stored.items() if n}
        lost = Counter(end.lost) + missing
        del lost[""]
        ended = _time(end.ended_ns)
        registry.put_run(replace(self._run_entry(), stored=stored, lost=dict(lost), ended=ended))

    def _missing_of_all_drains(self, end: RunEnd) -> Counter[str]:
        """Return the number of messages by topic that this drain and earlier ones have lost.

        Earlier ones have stored their losses and deleted the files. The recorder's own losses are
        stored, too, and are counted in the end of the run.
        """
        topics = {*end.stored, *end.lost, *self._drained.lost}
        stored_losses: Counter[str] = Counter()
        for loss in self._keyspace.registry.losses(sorted(topics)) if topics else ():
            if loss.writer == self._label.run:
                stored_losses[loss.topic] += loss.count
        missing = Counter(self._drained.lost)
        for topic, count in stored_losses.items():
            missing[topic] = max(missing[topic], count - end.lost.get(topic, 0))
        return +missing  # without topics that miss nothing

    def _note_gap(self) -> None:
        """Store and log what may be missing after the last message of a killed recorder."""
        label, alive = self._label, self._left_run.alive_ns()
        totals = self._account.totals()
        ends = [total.last_ns for total in totals.values()]
        last = max(ends, default=label.begun_ns)
        # Simulated time cannot be compared with the time at which a file was written.
        until = (last if last < label.begun_ns else max(last, alive)) + MISSING_END_NS
        for topic, total in totals.items():
            low = min(total.last_ns, MAX_NS)
            loss = Loss(topic, label.node, label.run, LossKind.KILLED, low, until, 0)
            self._keyspace.registry.put_loss(loss)
        # Before the files are deleted: after a kill in between the next start tells it again.
        _log.warning(
            "run %s was not ended: its last sign of life was at %s, the last message in the spool "
            "has number %d of the run; what came within a second after it is missing",
            self._left_run.name,
            f"{_time(max(last, alive)):%Y-%m-%dT%H:%M:%S.%fZ}",
            self._last_counter,
        )


class _NumberRanges:
    """A set of numbers that come nearly in order."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        """First number of each range, in order."""
        self._lasts: list[int] = []
        """Last number of each range."""

    def add(self, number: int) -> None:
        """Add a number."""
        place = bisect_right(self._firsts, number)
        if place and self._lasts[place - 1] + 1 >= number:
            self._lasts[place - 1] = max(self._lasts[place - 1], number)
        else:
            self._firsts.insert(place, number)
            self._lasts.insert(place, number)

    def has(self, number: int) -> bool:
        """Return whether a number was added."""
        place = bisect_right(self._firsts, number)
        return place > 0 and number <= self._lasts[place - 1]


class _StoredBlocks:
    """The messages of a writer that are in stored blocks, as far as those of one file may be.

    A row that is written again replaces itself. A block does not, if it begins with another message
    than before.
    """

    def __init__(self, space: Keyspace, writer: int) -> None:
        self._keyspace, self._writer = space, writer
        self._seqs: dict[str, set[int]] = {}
        """Sequence numbers by name of the table."""

    def has(
        self, handle: Handle, t_ns: int, counter: int, totals: Mapping[int, TopicTotal]
    ) -> bool:
        """Return whether a message is in a block; note that it is from now on.

        In a table without blocks it may be written again: False.
        """
        if handle.blocks is None:
            return False
        seqs = self._seqs.get(handle.table.name)
        if seqs is None:
            seqs = self._seqs[handle.table.name] = self._read(handle, totals)
        seq = self._writer << COUNTER_BITS | counter
        if seq in seqs:
            return True
        seqs.add(seq)
        return False

    def _read(self, handle: Handle, totals: Mapping[int, TopicTotal]) -> set[int]:
        """Read the numbers of the stored messages in the time range of the file."""
        first = min((total.first_ns for total in totals.values()), default=0)
        last = max((total.last_ns for total in totals.values()), default=MAX_NS)
        whose = Whose.of(handle.node, frozenset([self._writer]))
        has_own_time = handle.table.metadata.own_time  # the key is not a time of reception
        time_range = TimeRange() if has_own_time else TimeRange(first, last)
        read = Read(time_range, whose, columns=lambda table: ())
        return {row.position.seq for row in self._keyspace.rows.read([handle.table], read)}


def _time(ns: int) -> datetime:
    """Return a time, ns since 1970, as cr_run has it."""
    return datetime.fromtimestamp(ns / SECOND_NS, timezone.utc)
