# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Recorder: records topics of any type from within a process that is a node."""

from __future__ import annotations

import difflib
import logging
import struct
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from typing import Callable, Collection, Iterable, Mapping, Optional, Sequence, Union

import rospy
from std_msgs.msg import String

from cassandra_ros.arguments import check_ros_name
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CassandraRosError, InvalidName, InvalidOption
from cassandra_ros.nodes.node import MASTER_ERRORS, now_ns
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.run_context import keep_context
from cassandra_ros.nodes.subscriptions import Subscriptions, published_topics, subscribed_topics
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.recording_options import RecorderOptions
from cassandra_ros.recording.recording_status import (
    RECORDING,
    SNAPSHOT,
    STOPPED,
    WAITING,
    RecordingStatus,
)
from cassandra_ros.recording.run_series import RunSeries
from cassandra_ros.recording.snapshot import Snapshots
from cassandra_ros.recording.store_future import Store, then
from cassandra_ros.recording.topic_counts import TopicReport, merge_reports
from cassandra_ros.tables.registry import LossKind

_log = logging.getLogger(__name__)

POLL_SEC = 0.1
NODE_POLL_SEC = 1.0
"""How often a node is asked what it subscribes to."""
JOIN_SEC = 2.0
CONTEXT_SEC = 3.0
"""How long the end of a recording waits for parameters that were asked for at its start."""

Say = Callable[[str], None]
Topics = Collection[str]


class Recorder:
    """Subscribes to topics and stores what comes. Thread-safe; a context manager that starts it.

    The caller's process is a ROS node already (``rospy.init_node``). No signal handler is
    installed and nothing printed here; what goes wrong is logged. Under /use_sim_time the messages
    have simulated times; rospy's own subscription to /clock then drops some of that topic, so that
    /clock itself is recorded whole only by the node ``recorder``.

    Args:
        rosCas: A RosCassandra connected to a keyspace; it stays the caller's. Or a
            ``concurrent.futures.Future`` of one: what comes before it is there waits in memory.
        options: What to record, and how; or the names of topics.
        say: Called with each line for people who watch; default: the log.
    """

    def __init__(
        self,
        rosCas: Union[RosCassandra, Future[RosCassandra]],
        options: Union[RecorderOptions, Sequence[str]],
        *,
        say: Optional[Say] = None,
    ) -> None:
        if not isinstance(options, RecorderOptions):
            options = RecorderOptions([options] if isinstance(options, str) else list(options))
        self._options = options
        self._say: Say = _log.info if say is None else say
        self._publisher: Optional[rospy.Publisher] = None
        self._contexts: list[threading.Thread] = []
        self._series = series = RunSeries(_catalog_of(rosCas), options, now_ns, self._begun)
        bound = options.snapshot
        self._snapshots = (
            None
            if bound is None
            else Snapshots(bound, options.buffsize, now_ns, series.filters, series.single)
        )
        self._subscriptions = Subscriptions(self._received, options.tcpnodelay)
        self._registration = Registration(self._unheard)
        self._own = _Own(rospy.get_name()) if options.discovers else None
        self._left: set[str] = set()
        """Topics that are recorded no more."""
        self._silent: set[str] = set()
        """Topics of which no publisher was ever connected."""
        self._paused: set[str] = set()
        self._all_paused = False
        self._active = self._closed = False
        self._interrupts = 0
        self._hurry = threading.Event()
        self._done = threading.Event()
        self._poller: Optional[threading.Thread] = None
        self._asked_node = 0.0
        self._mutex = threading.RLock()

    # ---------------------------------------------------------------- public

    def start(
        self,
        topics: Topics = (),
        *,
        name: str = "",
        labels: Optional[Mapping[str, str]] = None,
    ) -> str:
        """Begin a run, or record more topics in the current one.

        It returns when the publishers that exist are connected, or after 5 s.

        Args:
            topics: Their names; none = those that the options say.
            name: Of a run that begins here; '' = as the options say.
            labels: Of a run that begins here, beside those of the options.

        Returns:
            The name of the run; '' where messages are only kept for a snapshot.

        Raises:
            InvalidOption: A run is being recorded, and no topics are given; or it was closed.
            InvalidName: A topic's name is none.
            StoreUnavailable: The store does not answer.
        """
        wanted = [rospy.resolve_name(check_ros_name(topic)) for topic in topics]
        if not (wanted or self._options.regex):
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
            self._left.difference_update(wanted or list(self._left))
            self._subscribe_chosen(wanted)
            if first:
                self._poller = threading.Thread(
                    target=self._poll, name="recorder-poll", daemon=True
                )
        self._subscriptions.await_publishers(self._hurry)
        number = len(self._subscriptions.topics)
        self._say(f"recording {number} topic{'' if number == 1 else 's'}")
        if first and self._poller is not None:
            self._poller.start()
            self._registration.start()
        return "" if current is None else current.name

    def stop(self, topics: Topics = ()) -> list[TopicReport]:
        """End the run, or record some topics no more; what had come is read and stored first.

        Returns:
            What became of the topics so far, in all runs of this object together.

        Raises:
            InvalidName: A topic is not recorded.
        """
        wanted = self._recorded(topics)
        with self._mutex:
            if topics:
                self._leave(wanted)
                self._left.update(wanted)
                return self.reports()
            self._active = False
            self._leave(self._subscriptions.topics)
            # What begins next is recorded, until somebody pauses it.
            self._all_paused = False
            for thread in self._contexts:
                thread.join(CONTEXT_SEC)
            self._contexts.clear()
            self._series.end(self._gives_up)
            return self.reports()

    def pause(self, topics: Topics = ()) -> None:
        """Leave out what comes on some topics, none named = on all; subscriptions stand.

        Raises:
            InvalidName: A topic is not recorded.
        """
        self._paused.update(self._recorded(topics))
        self._all_paused = self._all_paused or not topics

    def resume(self, topics: Topics = ()) -> None:
        """Take what comes on some topics again, none named = on all.

        Raises:
            InvalidName: A topic is not recorded.
        """
        wanted = self._recorded(topics)
        if self._all_paused:
            # In this order: the others stay paused all the time.
            self._paused = set(self._subscriptions.topics)
            self._all_paused = False
        self._paused.difference_update(wanted)
        if not topics:
            self._paused.clear()

    @property
    def run(self) -> str:
        """Name of the run that is being recorded; '' = none."""
        current = self._series.current
        return "" if current is None else current.name

    @property
    def problem(self) -> str:
        """Why nothing can be stored, now or any more; '' = it can, or may."""
        return self._series.problem

    def status(self) -> RecordingStatus:
        """Tell how it goes."""
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
        labels: Optional[Mapping[str, str]] = None,
        after: float = 0.0,
        topics: Topics = (),
    ) -> tuple[str, int]:
        """Write what is kept in memory as a run of its own.

        Args:
            name: Of the run; '' = as the options say.
            labels: Of the run, beside those of the options.
            after: Seconds: what comes in them goes into the run, too; it is then written in the
                background. With 0.0 everything is stored or lost when this returns.
            topics: Only these; none = all.

        Returns:
            The name of the run, and how many messages were kept for it.

        Raises:
            InvalidOption: Nothing is kept (option snapshot), or too many are being written.
            InvalidName: A topic is not recorded.
        """
        if self._snapshots is None:
            raise InvalidOption(
                "no messages are kept in memory: start the recorder with --snapshot 30s, say"
            )
        if not 0.0 <= after <= 86400.0:
            raise InvalidOption(f"after={after!r:.40} is no number of seconds of 0 to 86400")
        wanted = self._recorded(topics)
        recording, kept = self._snapshots.write(name, labels or {}, after, wanted)
        self._say(f"snapshot {recording.name}: {kept} messages")
        return recording.name, kept

    def reports(self) -> list[TopicReport]:
        """Describe what became of each topic so far, in all runs together."""
        written: list[Sequence[TopicReport]] = []
        if self._snapshots is not None:
            # Before the first snapshot: what came, and is stored nowhere.
            written = list(self._snapshots.reports) or [self._snapshots.counts()]
        silent = self._silent | self._subscriptions.unheard()
        return [
            replace(report, published=report.topic not in silent or report.received > 0)
            for report in merge_reports([self._series.reports(), *written])
        ]

    def wait(self, timeout_sec: Optional[float] = None) -> bool:
        """Wait until duration, size, limit or a problem has ended it; say whether that is so."""
        return self._done.wait(timeout_sec)

    def interrupt(self) -> None:
        """Let what waits return soon: once start, twice close, which then drops what waits."""
        self._interrupts += 1
        self._hurry.set()

    def close(self) -> list[TopicReport]:
        """End the run as stop does, and everything else; report on all of its runs."""
        self._done.set()
        with self._mutex:
            self._closed = True
        self._registration.stop()
        if self._poller is not None and self._poller.is_alive():
            self._poller.join(JOIN_SEC)
        self.stop()
        if self._snapshots is not None:
            while not self._snapshots.close(timeout_sec=0.2):
                if self._gives_up():
                    self._snapshots.abandon()
                    break
        if self._publisher is not None:
            self._publisher.unregister()
        return self.reports()

    def __enter__(self) -> Recorder:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    # ---------------------------------------------------------------- topics

    def _recorded(self, topics: Topics) -> list[str]:
        """Return the names of topics that are recorded, or raise InvalidName."""
        names, known = [], self._subscriptions.topics
        for topic in topics:
            name = str(rospy.resolve_name(check_ros_name(topic)))
            if name not in known:
                near = difflib.get_close_matches(name, known, n=3)
                hint = f"did you mean {', '.join(near)}?" if near else f"{len(known)} topics are"
                raise InvalidName(f"topic {name} is not recorded; {hint}")
            names.append(name)
        return names

    def _subscribe_chosen(self, wanted: Sequence[str]) -> None:
        if wanted:
            for topic in wanted:
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
        self._series.expect(topic)
        if self._snapshots is not None:
            self._snapshots.expect(topic)
        self._subscriptions.add(topic)

    def _leave(self, topics: Collection[str]) -> None:
        """Read topics to their end and unsubscribe; what could not be read counts as lost."""
        unread = self._subscriptions.drain(topics, self._series.count, self._gives_up)
        current = self._series.current
        for topic in unread:
            if current is not None:
                now = current.now()
                current.lose(topic, LossKind.NOT_READ, 1, now, now)
        self._silent |= self._subscriptions.unheard().intersection(topics)
        self._subscriptions.remove(topics)
        self._paused.difference_update(topics)

    def _gives_up(self) -> bool:
        return self._interrupts > 1

    # ---------------------------------------------------------------- messages

    def _received(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        if self._own is not None and self._own.said(topic, header, wire):
            return
        paused = self._all_paused or topic in self._paused
        sink = self._series if self._snapshots is None else self._snapshots
        sink.received(topic, header, wire, paused=paused)

    def _unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        current = self._series.current
        if current is not None:
            current.unheard(topic, first_ns, last_ns)

    def _begun(self, recording: Recording) -> None:
        """Tell of a run that begins, and keep what stands around it."""
        running = [thread for thread in self._contexts if thread.is_alive()]
        self._contexts = [*running, keep_context(recording)]
        if self._options.publish:
            if self._publisher is None:
                self._publisher = rospy.Publisher("begin_write", String, latch=True, queue_size=10)
            self._publisher.publish(String(recording.name))
        self._say(f"run {recording.name}")

    # ---------------------------------------------------------------- time

    def _poll(self) -> None:
        """Look after new topics, the limit, splits and the end, on a thread of its own."""
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
                    _log.error("the recorder could not look after its topics: %s", exc)

    def _discover(self, announce: bool) -> None:
        try:
            found = published_topics() if self._options.discovers else []
            chosen = [topic for topic in found if self._options.chooses(topic)]
            chosen += self._of_node()
        except MASTER_ERRORS as exc:
            _log.debug("new topics are not seen: %s", exc)  # the registration warns
            self._done.wait(1.0)
            return
        known = self._left.union(self._subscriptions.topics)
        for topic in chosen:
            if topic not in known:
                if announce:
                    self._say(f"recording {topic}, too")
                self._subscribe(topic)

    def _of_node(self) -> Iterable[str]:
        """Return the topics that the node of option --node subscribes to, from time to time."""
        now = time.monotonic()
        if not self._options.node or now < self._asked_node + NODE_POLL_SEC:
            return ()
        first, self._asked_node = not self._asked_node, now
        node = rospy.resolve_name(self._options.node)
        found = subscribed_topics(node)
        if first and not found:
            _log.warning("node %s subscribes to nothing yet, or is not there", node)
        return [topic for topic in found if not self._options.excludes(topic)]

    def _is_complete(self) -> bool:
        """Leave the topics that reached the limit; say whether all have."""
        topics = self._subscriptions.topics
        if not (self._options.limit and topics):
            return False
        complete = [topic for topic in topics if self._series.is_complete(topic)]
        self._left.update(complete)
        self._subscriptions.remove(complete)
        return len(complete) == len(topics)


def _catalog_of(store: Union[RosCassandra, Future[RosCassandra]]) -> Store:
    """Return the catalog of the connected keyspace, or a future of it."""
    if isinstance(store, Future):
        return then(store, lambda ros_cas: ros_cas.catalog)
    return store.catalog


class _Own:
    """Knows what a recorder of all topics says itself: that is not recorded.

    Args:
        name: Full name of its node.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def said(self, topic: str, header: Mapping[str, str], wire: bytes) -> bool:
        """Say whether a message is our own: by its publisher, on /rosout_agg by Log.name."""
        if header.get("callerid") == self._name:
            return True
        return topic == "/rosout_agg" and log_name(wire) == self._name


_U32 = struct.Struct("<I").unpack_from
_FRAME_ID = 12
"""Where the length of header.frame_id stands in a message with a Header."""


def log_name(wire: bytes) -> str:
    """Return the name in a serialised rosgraph_msgs/Log; '' where it is none."""
    try:
        # header.seq, header.stamp, header.frame_id, byte level, string name
        at = _FRAME_ID + 4 + _U32(wire, _FRAME_ID)[0] + 1
        return wire[at + 4 : at + 4 + _U32(wire, at)[0]].decode("utf-8", "replace")
    except struct.error:
        return ""
