# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Recorder: records topics of any type in a process that is a ROS node."""

from __future__ import annotations

import difflib
import logging
import struct
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from typing import Callable, Collection, Iterable, Mapping, Sequence

import rospy
from std_msgs.msg import String

from cassandra_ros.arguments import check_ros_name
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CassandraRosError, ClockNotSet, InvalidName, InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.ros_master import master_proxy
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.ros_node import MASTER_ERRORS, ros_now_ns
from cassandra_ros.nodes.subscriptions import Subscriptions, published_topics, subscribed_topics
from cassandra_ros.recording.backlog import OnDisk
from cassandra_ros.recording.event_marks import EventMarks
from cassandra_ros.recording.left_runs import LeftRuns
from cassandra_ros.recording.quota_keeper import QuotaKeeper
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.recording_status import (
    RECORDING,
    SNAPSHOT,
    STOPPED,
    WAITING,
    RecordingStatus,
)
from cassandra_ros.recording.run_series import RunSeries
from cassandra_ros.recording.snapshot import Snapshots
from cassandra_ros.recording.store_future import Store, store_future, then
from cassandra_ros.recording.topic_counts import TopicReport, merge_reports
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.store.tables.registry import LossKind
from cassandra_ros.stores.copying.quota import Quota

_log = logging.getLogger(__name__)

POLL_SEC = 0.1
"""Interval at which new topics, limits and the end are checked, s."""
NODE_POLL_SEC = 1.0
"""Interval at which the subscriptions of the node of option --node are requested, s."""
JOIN_SEC = 2.0
"""Maximum time that the end waits for the polling thread, s."""
CONTEXT_SEC = 3.0
"""Maximum time that the end of a run waits for the parameters requested at its start, s."""
CONTEXT_TIMEOUT_SEC = 5.0
"""Maximum time for each of three answers of the master, s."""

Say = Callable[[str], None]
"""Function that prints a line for the user."""
Topics = Collection[str]
"""Names of topics."""


class Recorder:
    """Subscribes to topics and stores their messages. Thread-safe; as a context manager it starts.

    The process must be a ROS node already (``rospy.init_node``). The class installs no signal
    handler and prints nothing; errors are logged. With /use_sim_time messages get simulated times;
    rospy's own subscription to /clock then drops messages, so that /clock itself is recorded
    completely only by the node ``recorder``.

    Args:
        rosCas: A RosCassandra connected to a keyspace, which the caller closes; or a
            ``concurrent.futures.Future`` of one: until it is connected messages wait in memory.
        options: Options of the recorder, or names of topics.
        say: Prints a line for the user; default: the log.
    """

    def __init__(
        self,
        rosCas: RosCassandra | Future[RosCassandra],
        options: RecorderOptions | Sequence[str],
        *,
        say: Say | None = None,
    ) -> None:
        if not isinstance(options, RecorderOptions):
            options = RecorderOptions([options] if isinstance(options, str) else list(options))
        if not options.keyspace and not isinstance(rosCas, Future):
            options = replace(options, keyspace=str(rosCas.keyspace), address=_address_of(rosCas))
        self._options = options
        self._say: Say = _log.info if say is None else say
        self._publisher: rospy.Publisher | None = None
        """Publisher of the names of runs, with the option publish."""
        self._contexts: list[threading.Thread] = []
        """Threads that request the parameters of the runs."""
        self._store = _catalog_of(rosCas)
        self._left_runs: LeftRuns | None = None
        self._quota: QuotaKeeper | None = None
        self._series = series = RunSeries(self._store, options, ros_now_ns, self._announce_run)
        bound = options.snapshot
        self._marks = EventMarks(series.events.put)
        self._snapshots = (
            None
            if bound is None
            else Snapshots(bound, options.buffsize, ros_now_ns, series.filters, series.single)
        )
        self._subscriptions = Subscriptions(self._on_message, options.tcpnodelay, self._broken)
        self._registration = Registration(self._unheard)
        self._own_messages = _OwnMessages(rospy.get_name()) if options.discovers else None
        """The messages that are left out; None = no topic is selected when it appears."""
        self._left_topics: set[str] = set()
        """Topics that were stopped, or reached the limit: they are not selected again."""
        self._unheard_topics: set[str] = set()
        """Former topics to which no publisher was ever connected."""
        self._paused: set[str] = set()
        self._all_paused = False
        self._active = self._closed = False
        """Whether it records now, and whether ``close`` was called."""
        self._interrupts = 0
        """Number of calls of ``interrupt``, which may come from a signal handler."""
        self._interrupted = threading.Event()
        self._done = threading.Event()
        """Set when the recording must end, and by ``close``."""
        self._poller: threading.Thread | None = None
        """Thread of ``_poll``; None = ``start`` was not called yet."""
        self._node_asked_at = 0.0
        """Monotonic time at which the node of option --node was asked for last, s; 0 = never."""
        self._mutex = threading.RLock()
        """Held by ``start``, ``stop`` and each step of ``_poll``: one of them at a time."""

    def start(
        self, topics: Topics = (), *, name: str = "", labels: Mapping[str, str] | None = None
    ) -> str:
        """Start a run, or record more topics in the current one.

        It returns when the existing publishers are connected, or after 5 s.

        Args:
            topics: Names of the topics; empty = those of the options.
            name: Name of a new run; '' = as the options say.
            labels: Labels of a new run in addition to those of the options.

        Returns:
            The name of the run; '' if messages are only kept for a snapshot.

        Raises:
            InvalidOption: A run is being recorded and no topics are given; or the recorder was
                closed.
            InvalidName: The name of a topic or of the run, or a label, is not valid.
            StoreUnavailable: The store does not answer, and the recorder has no spool.
        """
        names = [rospy.resolve_name(check_ros_name(topic)) for topic in topics]
        if not (names or self._options.regex):
            for topic in self._options.topics:
                check_ros_name(topic)
        with self._mutex:
            if self._closed:
                raise InvalidOption("this recorder is being closed: make another one")
            first, current = self._poller is None, self._series.current
            if self._active and not topics:
                run = f": run {current.name}" if current is not None else ""
                raise InvalidOption(f"it is recording already{run}; stop it first, or name topics")
            if self._snapshots is None and current is None:
                current = self._series.begin(name, labels)
            self._active = True
            self._left_topics.difference_update(names or list(self._left_topics))
            self._subscribe_chosen(names)
            if first:
                self._poller = threading.Thread(
                    target=self._poll, name="recorder-poll", daemon=True
                )
        self._subscriptions.await_publishers(self._interrupted)
        number = len(self._subscriptions.topics)
        self._say(f"recording {number} topic{'' if number == 1 else 's'}")
        if first and self._poller is not None:
            self._poller.start()
            self._registration.start()
            plan = self._options.spool_plan
            if plan is not None:
                self._left_runs = LeftRuns(store_future(self._store), plan, self._say)
            if self._options.max_size:
                quota = Quota(self._options.max_size, uncopied=self._options.drop_uncopied)
                self._quota = QuotaKeeper(store_future(self._store), quota)
        return "" if current is None else current.name

    def stop(self, topics: Topics = ()) -> list[TopicReport]:
        """End the run, or the recording of some topics, after received messages have been stored.

        Returns:
            A report of each topic over all runs of this object together.

        Raises:
            InvalidName: A topic is not recorded.
        """
        names = self._recorded_topics(topics)
        with self._mutex:
            if topics:
                self._leave(names)
                self._left_topics.update(names)
                return self.reports()
            self._active = False
            self._leave(self._subscriptions.topics)
            # The next run is not paused.
            self._all_paused = False
            for thread in self._contexts:
                thread.join(CONTEXT_SEC)
            self._contexts.clear()
            self._series.filters.end_events()
            self._series.end(self._gives_up)
            return self.reports()

    def mark(
        self,
        name: str,
        *,
        labels: Mapping[str, str] | None = None,
        values: Mapping[str, object] | None = None,
    ) -> Event:
        """Begin an event of the robot now; the next call with the same name ends it.

        The event belongs to the run that is being recorded. It is stored in the background. An
        event that lasts is ended when the recorder is closed.

        Args:
            name: Name of the event.
            labels, values: As in RosCassandra.addEvent.

        Raises:
            InvalidName: The name, a label or a value cannot be stored.
            InvalidOption: The recorder was closed.
            ClockNotSet: Simulated time is in use and has not come yet.
        """
        if self._closed:
            raise InvalidOption("this recorder is being closed: it marks no events any more")
        node, writer = self._options.node_id, self._series.writer
        return self._marks.mark(name, ros_now_ns(), node, labels, values, writer)

    def pause(self, topics: Topics = ()) -> None:
        """Leave out the messages of some topics (empty = all) but stay subscribed.

        Raises:
            InvalidName: A topic is not recorded.
        """
        self._paused.update(self._recorded_topics(topics))
        self._all_paused = self._all_paused or not topics

    def resume(self, topics: Topics = ()) -> None:
        """Record the messages of some paused topics again (empty = all).

        Raises:
            InvalidName: A topic is not recorded.
        """
        names = self._recorded_topics(topics)
        if self._all_paused:
            # In this order: the other topics stay paused all the time.
            self._paused = set(self._subscriptions.topics)
            self._all_paused = False
        self._paused.difference_update(names)
        if not topics:
            self._paused.clear()

    @property
    def run(self) -> str:
        """Name of the run that is being recorded; '' = no run."""
        current = self._series.current
        return "" if current is None else current.name

    @property
    def problem(self) -> str:
        """Reason why no message can be stored; '' = messages can be stored, as far as known."""
        return self._series.problem

    def status(self) -> RecordingStatus:
        """Return the present status."""
        current, snapshots = self._series.current, self._snapshots
        subscribed = self._subscriptions.topics
        held = 0 if current is None else current.held_bytes
        state = STOPPED
        if current is not None:
            state = RECORDING if current.opened else WAITING
        status = RecordingStatus(
            state,
            self.run,
            0 if current is None else current.writer_id,
            self.reports(),
            subscribed,
            sorted(subscribed if self._all_paused else self._paused),
            held,
            self._options.buffsize,
            OnDisk() if current is None else current.on_disk,
            quota=None if self._quota is None else self._quota.report,
            held_up=current is not None and current.opened and current.is_held_up,
        )
        if snapshots is None:
            return status
        ring = snapshots.ring
        return replace(
            status,
            state=SNAPSHOT if self._active else STOPPED,
            topics=snapshots.counts(),
            held_bytes=ring.nbytes,
            held_sec=ring.seconds,
            held_messages=len(ring),
        )

    def snapshot(
        self,
        *,
        name: str = "",
        labels: Mapping[str, str] | None = None,
        after: float = 0.0,
        topics: Topics = (),
    ) -> tuple[str, int]:
        """Store the messages in memory as a separate run.

        Args:
            name: Name of the run; '' = as the options say.
            labels: Labels of the run in addition to those of the options.
            after: Time in which received messages are stored in the run, too, s; the run is then
                written in the background. With 0.0 all messages are stored or lost when this
                returns.
            topics: Names of the topics; empty = all.

        Returns:
            The name of the run, and the number of messages that were in memory for it.

        Raises:
            InvalidOption: No messages are kept in memory (option snapshot), or too many snapshots
                are being written.
            InvalidName: A topic is not recorded.
            StoreUnavailable: The store does not answer, and the recorder has no spool.
        """
        if self._snapshots is None:
            raise InvalidOption(
                "no messages are kept in memory: start the recorder with --snapshot 30s, say"
            )
        if not 0.0 <= after <= 86400.0:
            raise InvalidOption(f"after={after!r:.40} is not a number of seconds of 0 to 86400")
        names = self._recorded_topics(topics)
        recording, messages = self._snapshots.write(name, labels or {}, after, names)
        self._say(f"snapshot {recording.name}: {messages} messages")
        return recording.name, messages

    def reports(self) -> list[TopicReport]:
        """Return a report of each topic over all runs together."""
        written: list[Sequence[TopicReport]] = []
        if self._snapshots is not None:
            # Before the first snapshot: the counts of received messages, of which none is stored.
            written = list(self._snapshots.reports) or [self._snapshots.counts()]
        silent = self._unheard_topics | self._subscriptions.unheard()
        return [
            replace(report, published=report.topic not in silent or report.received > 0)
            for report in merge_reports([self._series.reports(), *written])
        ]

    def wait(self, timeout_sec: float | None = None) -> bool:
        """Wait until duration, size, limit or a problem has ended it; return whether one has."""
        return self._done.wait(timeout_sec)

    def interrupt(self) -> None:
        """Shorten waiting: the first call ends that of ``start``, the second that of ``close``.

        The messages that wait for the store are then lost, or stay in the spool. A signal handler
        may call it.
        """
        self._interrupts += 1
        self._interrupted.set()

    def close(self) -> list[TopicReport]:
        """End the run as ``stop`` does, and the recorder; return the reports over all its runs."""
        self._done.set()
        with self._mutex:
            self._closed = True
        self._registration.stop()
        if self._left_runs is not None:
            self._left_runs.stop(JOIN_SEC)
        if self._quota is not None:
            self._quota.stop(JOIN_SEC)
        if self._poller is not None and self._poller.is_alive():
            self._poller.join(JOIN_SEC)
        self.stop()
        if self._snapshots is not None:
            while not self._snapshots.close(timeout_sec=0.2):
                if self._gives_up():
                    self._snapshots.abandon()
                    break
        with suppress(ClockNotSet):  # then no event has begun
            self._marks.end_all(ros_now_ns())
        self._series.events.close()
        if self._publisher is not None:
            self._publisher.unregister()
        return self.reports()

    def __enter__(self) -> Recorder:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _recorded_topics(self, topics: Topics) -> list[str]:
        """Return the names of topics that are recorded, or raise InvalidName."""
        names, subscribed = [], self._subscriptions.topics
        for topic in topics:
            name = str(rospy.resolve_name(check_ros_name(topic)))
            if name not in subscribed:
                near = difflib.get_close_matches(name, subscribed, n=3)
                hint = (
                    f"did you mean {', '.join(near)}?" if near else f"{len(subscribed)} topics are"
                )
                raise InvalidName(f"topic {name} is not recorded; {hint}")
            names.append(name)
        return names

    def _subscribe_chosen(self, names: Sequence[str]) -> None:
        """Subscribe to some topics (resolved names), or without names to those of the options."""
        if names:
            for topic in names:
                self._subscribe(topic)
            return
        if not self._options.regex:
            for name in self._options.topics:
                topic = rospy.resolve_name(name)
                if not self._options.excludes(topic):
                    self._subscribe(topic)
            self._subscriptions.warn_of_names()
        self._discover(announce=False)

    def _subscribe(self, topic: str) -> None:
        """Record a topic, by its resolved name; list it also if no message comes."""
        self._series.expect(topic)
        if self._snapshots is not None:
            self._snapshots.expect(topic)
        self._subscriptions.add(topic)

    def _leave(self, topics: Collection[str]) -> None:
        """Read topics to their end and unsubscribe; messages that cannot be read count as lost."""
        unread = self._subscriptions.drain(topics, self._series.count, self._gives_up)
        current = self._series.current
        for topic in unread:
            if current is not None:
                now = current.now()
                current.lose(topic, LossKind.NOT_READ, 1, now, now)
        self._unheard_topics |= self._subscriptions.unheard().intersection(topics)
        self._subscriptions.remove(topics)
        self._paused.difference_update(topics)

    def _gives_up(self) -> bool:
        """Return whether the user does not wait for the store, and the sockets, any longer."""
        return self._interrupts > 1

    def _on_message(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        """Record a message; called on the threads of the publishers' connections."""
        if self._own_messages is not None and self._own_messages.has(topic, header, wire):
            return
        paused = self._all_paused or topic in self._paused
        sink = self._series if self._snapshots is None else self._snapshots
        sink.received(topic, header, wire, paused=paused)

    def _unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        """Note a time range in which publishers of a topic were not heard, see Registration."""
        current = self._series.current
        if current is not None:
            current.unheard(topic, first_ns, last_ns)

    def _broken(self, topic: str, seconds: float) -> None:
        """Note a time up to now in which a publisher was not heard, see ``subscribe``."""
        current = self._series.current
        if current is not None and topic in self._subscriptions.topics:
            last = current.now()
            current.unheard(topic, max(0, last - int(seconds * SECOND_NS)), last)

    def _announce_run(self, recording: Recording) -> None:
        """Announce a run that has started, and store its context."""
        running = [thread for thread in self._contexts if thread.is_alive()]
        self._contexts = [*running, keep_context(recording)]
        if self._options.publish:
            if self._publisher is None:
                self._publisher = rospy.Publisher("begin_write", String, latch=True, queue_size=10)
            self._publisher.publish(String(recording.name))
        self._say(f"run {recording.name}")

    def _poll(self) -> None:
        """Check for new topics, the limit, splits and the end, on a thread."""
        while not self._done.wait(POLL_SEC):
            with self._mutex:
                if self.problem:
                    self._done.set()
                if self._done.is_set() or not self._active:
                    continue
                try:
                    self._discover(announce=True)
                    if self._is_complete() or self._series.poll():
                        self._done.set()
                except CassandraRosError as exc:
                    _log.error("the recorder could not check its topics: %s", exc)

    def _discover(self, announce: bool) -> None:
        """Subscribe to the topics that the options select now; say so with ``announce``."""
        try:
            selected: list[str] = []
            if self._own_messages is not None:
                published = published_topics(self._own_messages.name)
                selected = [topic for topic in published if self._options.chooses(topic)]
            selected += self._of_node()
        except MASTER_ERRORS as exc:
            _log.debug("new topics are not seen: %s", exc)  # the registration warns
            self._done.wait(1.0)
            return
        ignored = self._left_topics.union(self._subscriptions.topics)
        for topic in selected:
            if topic not in ignored:
                if announce:
                    self._say(f"recording {topic}, too")
                self._subscribe(topic)

    def _of_node(self) -> Iterable[str]:
        """Return, every NODE_POLL_SEC, the topics that the node of option --node subscribes to."""
        now = time.monotonic()
        if not self._options.node or now < self._node_asked_at + NODE_POLL_SEC:
            return ()
        first, self._node_asked_at = not self._node_asked_at, now
        node = rospy.resolve_name(self._options.node)
        topics = subscribed_topics(node)
        if first and not topics:
            _log.warning("node %s has no subscription yet, or is not running", node)
        return [topic for topic in topics if not self._options.excludes(topic)]

    def _is_complete(self) -> bool:
        """Unsubscribe from the topics that reached the limit; return whether all have."""
        topics = self._subscriptions.topics
        if not (self._options.limit and topics):
            return False
        complete = [topic for topic in topics if self._series.is_complete(topic)]
        self._left_topics.update(complete)
        self._subscriptions.remove(complete)
        return len(complete) == len(topics)


def _catalog_of(store: RosCassandra | Future[RosCassandra]) -> Store:
    """Return the catalog of the connected keyspace, or a future of it."""
    if isinstance(store, Future):
        return then(store, lambda ros_cas: ros_cas.catalog)
    return store.catalog


def _address_of(store: RosCassandra) -> str:
    """Return the address of a store as the label of the spool has it."""
    return f"{','.join(store.cassandra.hosts)}:{store.cassandra.port}"


class _OwnMessages:
    """A test for the messages of this node, which a recorder of all topics leaves out.

    Args:
        name: Full name of the node.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        """Full name of the node."""

    def has(self, topic: str, header: Mapping[str, str], wire: bytes) -> bool:
        """Return whether this node sent a message: by its publisher, on /rosout_agg by Log.name.

        /rosout_agg is published by the node rosout, for all others.
        """
        if header.get("callerid") == self.name:
            return True
        return topic == "/rosout_agg" and log_name(wire) == self.name


_U32 = struct.Struct("<I").unpack_from
_FRAME_ID = 12
"""Offset of the length of header.frame_id in a message with a Header, bytes."""


def log_name(wire: bytes) -> str:
    """Return the name in a serialised rosgraph_msgs/Log; '' if the bytes are no such message."""
    try:
        # header.seq, header.stamp, header.frame_id, byte level, string name
        at = _FRAME_ID + 4 + _U32(wire, _FRAME_ID)[0] + 1
        return wire[at + 4 : at + 4 + _U32(wire, at)[0]].decode("utf-8", "replace")
    except struct.error:
        return ""


def take_context() -> RunContext:
    """Return parameters and node graph, as the master has them.

    Raises:
        MASTER_ERRORS: The master does not answer.
        ValueError, TypeError: The answer of the master has another form.
    """
    name, master = rospy.get_name(), master_proxy(CONTEXT_TIMEOUT_SEC)
    _, _, params = master.getParam(name, "/")
    _, _, (publishers, subscribers, services) = master.getSystemState(name)
    _, _, types = master.getTopicTypes(name)
    graph = NodeGraph(dict(publishers), dict(subscribers), dict(services), dict(types))
    return RunContext(params if isinstance(params, dict) else {}, graph)


def keep_context(recording: Recording) -> threading.Thread:
    """Store the present context with a run, in the background.

    Failures are logged, and that it came after the end of the run.
    """

    def work() -> None:
        try:
            recording.put_context(take_context())
        except (*MASTER_ERRORS, ValueError, TypeError) as exc:
            _log.warning("the parameters of run %s could not be read: %s", recording.name, exc)

    thread = threading.Thread(target=work, name="recorder-context", daemon=True)
    thread.start()
    return thread
