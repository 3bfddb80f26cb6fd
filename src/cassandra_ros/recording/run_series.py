# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The runs of one recorder: started, split when they get too large, ended, counted together."""

from __future__ import annotations

import bisect
import itertools
import logging
import math
import threading
import time
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import Callable, Mapping, NamedTuple, Sequence

from cassandra_ros.arguments import check_run_name
from cassandra_ros.errors import CassandraRosError, TopicNotFound
from cassandra_ros.recording.event_marks import EventWriter
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.store_future import Store, failure_of, store_future
from cassandra_ros.recording.topic_counts import TopicReport, merge_reports
from cassandra_ros.recording.topic_settings import recording_settings

_log = logging.getLogger(__name__)

MAX_ENDING = 2
"""Maximum number of ended runs still being stored; with that many the current run is not split."""
SPACE_SEC = 20.0
"""Interval between two checks of the free space, s; that of rosbag record."""
PATIENCE_SEC = 3.0
"""Time at the end after which the user is told that messages still wait for the store, s."""
RETRY_SEC = 2.0
"""Pause after a failed start of the next run, s."""
BEGIN_SEC = 1.0
"""Maximum time that one ``poll`` waits for the start of the next run, s."""
_LAST_RUN = 10**9
"""Number above that of any run of a recording: with it the name is checked before the start."""
MAX_LATCHED = 4096
"""Maximum number of publishers whose latched message is repeated in each run."""
SPACE_WARN_FACTOR = 5
"""Multiple of the minimum space below which a warning is logged."""


class _EndedRun(NamedTuple):
    """A run that has ended; its messages are stored, lost or in the spool."""

    order: int
    """Position in the order in which runs ended: the objects are sorted by it."""
    run: Recording
    reports: Sequence[TopicReport]


class RunSeries:
    """The runs of one recorder, one after the other.

    ``begin``, ``poll`` and ``end`` are called by one thread at a time, the other methods by any.

    Args:
        store: The catalog of the connected keyspace, or a future of it; see Recording.
        options: Options of the recorder.
        clock: Returns the time of reception, ns; raises ClockNotSet while it is unknown.
        begun: Called with each run when it has started, before it gets messages.
    """

    def __init__(
        self,
        store: Store,
        options: RecorderOptions,
        clock: Callable[[], int],
        begun: Callable[[Recording], None],
    ) -> None:
        self._store = store_future(store)
        self._options, self._clock, self._begun = options, clock, begun
        self._settings = recording_settings(options)
        self._space = SpaceGuard(options.free_space, options.min_space)
        self._check_space_at = 0.0
        """Monotonic time at which the free space is checked next, s."""
        self.events = EventWriter(self._store)
        self.filters = Filters(
            self._settings, options.node_id, self.events.put, lambda: self.writer
        )
        self.current: Recording | None = None
        """The run that is being recorded."""
        self._topics: set[str] = set()
        """Topics that are listed in the reports of each run."""
        self._number = 0
        """Number of the next run of this recording."""
        self._begun_at = 0.0
        """Monotonic time from which the duration of the current run counts, s."""
        self._split_at = 0.0
        """Monotonic time before which no next run is started, because that has failed, s."""
        self._repeated_messages = 0
        """Number of latched messages with which the current run began."""
        self._making: Future[Recording] | None = None
        """The next run, whose start may take several calls of ``poll``."""
        self._problem = ""
        """Reason why the run that ended last could not be stored; '' = none."""
        self._name, self._labels = "", dict(options.labels)
        """Name and labels of the runs, as given to ``begin``; '' = as the options say."""
        self._closers: list[threading.Thread] = []
        """Threads that store runs which have ended by a split."""
        self._closing: list[Recording] = []
        """Runs that have ended and are still being stored."""
        self._order = itertools.count()
        self._ended: list[_EndedRun] = []
        """Runs of this recording that have ended and are not deleted."""
        self._removed: list[Sequence[TopicReport]] = []
        """Reports of the runs that were deleted for --max-splits."""
        self._latched: dict[tuple[str, str], tuple[Mapping[str, str], bytes]] = {}
        """Last latched message, with its connection header, by topic and callerid."""
        self._latched_lock = threading.Lock()
        self._mutex = threading.RLock()
        """Guards the lists of runs, so that a report counts each run once. A thread that holds it
        must not wait for the lock of a Recording: ``hand_over`` takes them in the other order."""

    def begin(self, name: str = "", labels: Mapping[str, str] | None = None) -> Recording:
        """Start the first run.

        Args:
            name: Name of the run; '' = as the options say.
            labels: Labels of this and later runs, in addition to those of the options.

        Raises:
            InvalidName: The name or a label cannot be stored.
            CassandraRosError: The run cannot be started in the store.
        """
        check_run_name(self._options.run_name(_LAST_RUN, name))
        self._name, self._number = name, 0
        self._labels = {**self._options.labels, **(labels or {})}
        current = self._new()
        self._expect_all(current)
        self._begun(current)
        self.current = current
        self._begun_at = time.monotonic()
        return current

    def single(self, name: str, labels: Mapping[str, str], restored: int) -> Recording:
        """Start a run outside the series for a snapshot. The caller closes it.

        Args:
            name: Name of the run; '' = as the options say.
            labels: Labels of the run in addition to those of the options.
            restored: Number of messages in memory that will be stored in it first.
        """
        name = name or self._options.run_name(self._number)
        recording = self._make(name, {**self._options.labels, **labels}, restored=restored)
        self._begun(recording)
        return recording

    def _new(self) -> Recording:
        """Start the next run of the series."""
        name = self._options.run_name(self._number, self._name)
        return self._make(name, self._labels, limit=self._options.limit)

    def _make(
        self, name: str, labels: Mapping[str, str], *, limit: int = 0, restored: int = 0
    ) -> Recording:
        """Start a run in the store, or before it answers; raises what Recording raises."""
        options = self._options
        recording = Recording(
            self._store,
            clock=self._clock,
            settings=self._settings,
            filters=self.filters,
            node=options.node_id,
            buffer_bytes=options.buffsize,
            block_sec=options.block_age,
            places=options.places,
            spool=options.spool_plan,
            limit=limit,
            name=name,
            labels=labels,
            restored=restored,
        )
        self._number += 1
        return recording

    def _expect_all(self, recording: Recording) -> None:
        for topic in self._topics:
            recording.expect(topic)

    def expect(self, topic: str) -> None:
        """List a topic in the reports even if no message of it is received."""
        self._topics.add(topic)
        current = self.current
        if current is not None:
            current.expect(topic)

    @property
    def writer(self) -> int:
        """Writer id of the run that is being recorded; 0 = no run."""
        current = self.current
        return 0 if current is None else current.writer_id

    @property
    def problem(self) -> str:
        """Reason why no message can be stored; '' = messages can be stored, as far as known."""
        current = self.current
        return (current and current.problem) or self._problem or failure_of(self._store)

    def received(
        self, topic: str, header: Mapping[str, str], wire: bytes, *, paused: bool = False
    ) -> None:
        """Record a message that was just received; with ``paused`` only count it."""
        if self._options.repeat_latched and not paused and header.get("latching") == "1":
            self._keep_latched(topic, header, wire)
        recording = self.current
        while recording is not None and not recording.received(topic, header, wire, paused=paused):
            last, recording = recording, self.current
            if recording is last:
                return  # the run is being ended

    def _keep_latched(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        """Keep a message with which later runs begin; a new publisher only up to MAX_LATCHED."""
        key = (topic, header.get("callerid", ""))
        with self._latched_lock:
            if key in self._latched or len(self._latched) < MAX_LATCHED:
                self._latched[key] = header, wire

    def poll(self) -> bool:
        """Split the current run if it is large or long enough; check the free space now and then.

        Returns:
            Whether the run is complete and, without the option split, the recording must end.
        """
        options, current = self._options, self.current
        if current is None:
            return False
        if time.monotonic() >= self._check_space_at:
            self._check_space_at = time.monotonic() + SPACE_SEC
            current.refusal = self._space.refusal()
        full = bool(options.size) and current.received_bytes >= options.size
        late = bool(options.duration) and time.monotonic() >= self._begun_at + options.duration
        if not (full or late):
            return False
        if options.split and current.received_messages <= self._repeated_messages:
            # The recording is paused: an empty run would take an earlier one's place.
            self._begun_at = time.monotonic()
            return False
        if options.split:
            self._split()
        return not options.split

    def _split(self) -> None:
        """Start the next run and let it go on, unless the store is away or too far behind.

        It waits for the start for BEGIN_SEC; a later call goes on with a start that takes longer.
        """
        # Not under the mutex: the status must not wait for a slow store.
        self._closers = [thread for thread in self._closers if thread.is_alive()]
        old, now = self.current, time.monotonic()
        if old is None or old.is_held_up or now < self._split_at:
            return
        if len(self._closers) >= MAX_ENDING:
            return
        making = self._making = self._making or self._start_next()
        if not wait([making], BEGIN_SEC).done:
            return
        self._making, problem = None, making.exception()
        if problem is not None:
            self._split_at = time.monotonic() + RETRY_SEC
            _log.warning("the next run cannot begin yet, run %s goes on: %s", old.name, problem)
            return
        new = making.result()
        self._expect_all(new)
        self._begun(new)
        with self._latched_lock:
            latched = list(self._latched.items())
        self._repeated_messages = len(latched)
        for (topic, _), (header, wire) in latched:
            new.received(topic, header, wire)

        def switch() -> None:
            with self._mutex:
                self._closing.append(old)
                self.current, self._begun_at = new, now

        old.hand_over(new, switch)
        args, name = (next(self._order), old), "recorder-split"
        thread = threading.Thread(target=self._close, args=args, name=name, daemon=True)
        self._closers.append(thread)
        thread.start()

    def _start_next(self) -> Future[Recording]:
        """Start the next run on a thread of its own, because the store may not answer."""
        making: Future[Recording] = Future()

        def start() -> None:
            try:
                making.set_result(self._new())
            except BaseException as exc:
                making.set_exception(exc)
                if not isinstance(exc, CassandraRosError):
                    raise  # our mistake: the thread prints it

        threading.Thread(target=start, name="recorder-begin", daemon=True).start()
        return making

    def _close(self, order: int, recording: Recording) -> None:
        """Store a run that has ended by a split; delete the oldest ones above max_splits."""
        reports = recording.close()
        removed = []
        with self._mutex:
            self._closing.remove(recording)
            # A run may be stored before one that was recorded earlier.
            bisect.insort(self._ended, _EndedRun(order, recording, reports))
            # The current run counts, too.
            most = self._options.max_splits - 1
            while self._options.max_splits and len(self._ended) > most:
                removed.append(self._ended.pop(0))
            self._removed += [oldest.reports for oldest in removed]
        # Not under the mutex: see _split.
        for oldest in removed:
            self._remove(oldest.run, oldest.reports)

    def _remove(self, run: Recording, reports: Sequence[TopicReport]) -> None:
        """Delete a run: its messages, then its entry in the list of runs and its losses."""
        try:
            catalog = self._store.result()
            for report in reports:
                if report.stored:
                    with suppress(TopicNotFound):
                        catalog.get(report.topic).removeData(run=run.writer_id)
            topics = [report.topic for report in reports]
            catalog.keyspace.registry.forget_run(run.writer_id, run.node, topics)
        except CassandraRosError as exc:
            _log.error("run %s could not be removed (--max-splits): %s", run.name, exc)

    def end(self, give_up: Callable[[], bool] = lambda: False) -> list[TopicReport]:
        """End the current run and return its report.

        It waits until all messages of this and earlier runs are stored or lost, or in the spool.

        Args:
            give_up: Returns whether to stop waiting; messages not stored by then are lost, or stay
                in the spool.

        Returns:
            The report; [] if no run is being recorded.
        """
        making, self._making = self._making, None
        if making is not None:
            making.add_done_callback(_drop)
        recording = self.current
        if recording is None:
            return []
        # On another thread: this one must react to signals while the store does not answer.
        closing = threading.Thread(target=recording.close, name="recorder-close", daemon=True)
        closing.start()
        tell_at = time.monotonic() + PATIENCE_SEC
        while closing.is_alive() or any(thread.is_alive() for thread in self._closers):
            closing.join(0.05) if closing.is_alive() else time.sleep(0.05)
            if give_up():
                then = "stay in the spool" if recording.spool else "are lost"
                _log.warning("interrupted again: messages that are not stored yet %s", then)
                with self._mutex:
                    split = list(self._closing)
                for run in split:
                    run.abandon()
                return self._note_end(recording, recording.abandon())
            if time.monotonic() > tell_at or recording.is_held_up:
                messages, nbytes = recording.waiting()
                if messages and tell_at < math.inf:
                    tell_at = math.inf
                    fate = (
                        f"stay in the spool {recording.spool}" if recording.spool else "are dropped"
                    )
                    _log.warning(
                        "%d messages (%.1f MB) wait for the store; they %s if this is interrupted "
                        "again (a second Ctrl-C)",
                        messages,
                        nbytes / 1e6,
                        fate,
                    )
        # Returns or raises again what it did on that thread.
        return self._note_end(recording, recording.close())

    def _note_end(self, recording: Recording, reports: list[TopicReport]) -> list[TopicReport]:
        """Note that the current run has ended; return its reports."""
        self._problem = recording.problem
        with self._mutex:
            self._ended.append(_EndedRun(next(self._order), recording, reports))
            self.current = None
        return reports

    def is_complete(self, topic: str) -> bool:
        """Return whether a topic has all the messages that the limit allows."""
        current = self.current
        return current is not None and current.is_complete(topic)

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic received in the current run."""
        current = self.current
        return 0 if current is None else current.count(topic)

    def reports(self) -> list[TopicReport]:
        """Return a report for each topic over all runs together."""
        with self._mutex:
            reports = [*self._removed, *(ended.reports for ended in self._ended)]
            reports += [recording.reports() for recording in self._closing]
            if self.current is not None:
                reports.append(self.current.reports())
            return merge_reports(reports)


def _drop(making: Future[Recording]) -> None:
    """End a run that is not wanted any more and has no messages, without waiting for it."""
    if making.exception() is None:
        close = making.result().close
        threading.Thread(target=close, name="recorder-drop", daemon=True).start()


class SpaceGuard:
    """A check whether the store has enough free space for more messages.

    Args:
        free_space: Returns the free space, bytes, or None if it is not known now. None = the free
            space is never known.
        minimum: Minimum free space, bytes.
    """

    def __init__(self, free_space: Callable[[], int | None] | None, minimum: int) -> None:
        self._free_space, self._minimum = free_space, minimum
        self._warned = False

    def refusal(self) -> str:
        """Return the reason why no message may be stored now; '' = messages may be stored."""
        if self._free_space is None or not self._minimum:
            return ""
        try:
            free = self._free_space()
        except OSError as exc:
            _log.warning("the free space of the store is not known: %s", exc)
            return ""
        if free is None:
            return ""
        sizes = f"{free >> 20} MB are free where the store keeps its data"
        if free < self._minimum:
            return f"{sizes}, less than {self._minimum >> 20} MB (option --min-space)"
        if free < SPACE_WARN_FACTOR * self._minimum and not self._warned:
            self._warned = True
            _log.warning("only %s; below %d MB no message is stored", sizes, self._minimum >> 20)
        return ""
