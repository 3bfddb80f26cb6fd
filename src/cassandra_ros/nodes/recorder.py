# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Recorder: records topics of any type from within a process that is a node."""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import replace
from typing import Callable, Mapping, Optional

import rospy

from cassandra_ros.nodes.node import MASTER_ERRORS, now_ns
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.subscriptions import Subscriptions, published_topics
from cassandra_ros.recording.counts import TopicReport
from cassandra_ros.recording.options import RecorderOptions
from cassandra_ros.recording.recording import Recording
from cassandra_ros.topics.ros_cassandra import RosCassandra

_log = logging.getLogger(__name__)

POLL_SEC = 0.1
JOIN_SEC = 2.0
PATIENCE_SEC = 3.0
"""How long a store may take in the end before people are told that it does."""

Say = Callable[[str], None]


class Recorder:
    """Subscribes to topics and stores what comes. Thread-safe; a context manager that starts it.

    The caller's process is a ROS node already (``rospy.init_node``). No signal handler is
    installed and nothing printed here; what goes wrong is logged.

    Args:
        rosCas: A RosCassandra connected to a keyspace; it stays the caller's.
        options: What to record, and how.
        say: Called with each line for people who watch; default: the log.
    """

    def __init__(
        self, rosCas: RosCassandra, options: RecorderOptions, *, say: Optional[Say] = None
    ) -> None:
        self._rosCas = rosCas
        self._options = options
        self._say: Say = _log.info if say is None else say
        self._subscriptions = Subscriptions(self._received, options.tcpnodelay)
        self._registration = Registration(self._unheard)
        self._recording: Optional[Recording] = None
        self._left: set[str] = set()
        """Topics that are recorded no more."""
        self._interrupts = 0
        self._hurry = threading.Event()
        self._done = threading.Event()
        self._ends = float("inf")
        self._poller = threading.Thread(target=self._poll, name="recorder-poll", daemon=True)

    def start(self) -> None:
        """Begin to record; return when the publishers that exist are connected, or after 5 s."""
        self._recording = self._begin(rospy.get_name())
        if self._options.discovers:
            self._discover(announce=False)
        else:
            for name in self._options.topics:
                topic = rospy.resolve_name(name)
                if not self._options.excludes(topic):
                    self._subscribe(topic)
            self._subscriptions.warn_of_names()
        self._subscriptions.await_publishers(self._hurry)
        topics = len(self._subscriptions.topics)
        self._say(f"recording {topics} topic{'' if topics == 1 else 's'}")
        if self._options.duration:
            self._ends = time.monotonic() + self._options.duration
        self._poller.start()
        self._registration.start()

    def wait(self, timeout_sec: Optional[float] = None) -> bool:
        """Wait until duration or limit has ended the recording; say whether that is so."""
        return self._done.wait(timeout_sec)

    def interrupt(self) -> None:
        """Let what waits return soon: once start, twice close, which then drops what waits."""
        self._interrupts += 1
        self._hurry.set()

    def close(self) -> list[TopicReport]:
        """Read what is on its way, store it, and report on each topic."""
        self._done.set()
        self._registration.stop()
        if self._poller.is_alive():
            self._poller.join(JOIN_SEC)
        recording = self._recording
        if recording is None:
            return []
        topics = self._subscriptions.topics
        self._subscriptions.drain(topics, recording.count, lambda: self._interrupts > 1)
        return self._final(self._close(recording))

    def _close(self, recording: Recording) -> list[TopicReport]:
        """Let a recording store what it has, unless it is interrupted again."""
        # On another thread: it waits for a store that may be away, and hears no signal.
        closing = threading.Thread(target=recording.close, name="recorder-close", daemon=True)
        closing.start()
        tell_at: float = time.monotonic() + PATIENCE_SEC
        while closing.is_alive():
            closing.join(0.05)
            if self._interrupts > 1:
                _log.warning("interrupted again: what is not stored yet is lost")
                return recording.reports(final=True)
            if time.monotonic() > tell_at or self._rosCas.cassandra.outage.seconds:
                messages, nbytes = recording.waiting()
                if messages and tell_at < math.inf:
                    tell_at = math.inf
                    _log.warning(
                        "%d messages (%.1f MB) wait for the store; they are dropped if this is "
                        "interrupted again (a second Ctrl-C)",
                        messages,
                        nbytes / 1e6,
                    )
        return recording.close()  # what it had returned, or raised, on that thread

    def _final(self, reports: list[TopicReport]) -> list[TopicReport]:
        """Note in the reports which topics nobody ever published."""
        silent = self._subscriptions.unheard()
        return [
            replace(report, published=report.topic not in silent or report.received > 0)
            for report in reports
        ]

    def __enter__(self) -> Recorder:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _begin(self, name: str) -> Recording:
        options = self._options
        return Recording(
            self._rosCas,
            clock=now_ns,
            format=options.format,
            node=options.node_id,
            buffer_bytes=options.buffsize,
            limit=options.limit,
            ttl=options.ttl,
            name=name,
        )

    def _received(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        recording = self._recording
        if recording is not None:
            recording.received(topic, header, wire)

    def _unheard(self, topic: str, first_ns: int, last_ns: int) -> None:
        recording = self._recording
        if recording is not None:
            recording.unheard(topic, first_ns, last_ns)

    def _subscribe(self, topic: str) -> None:
        if self._recording is not None:
            self._recording.expect(topic)
        self._subscriptions.add(topic)

    def _poll(self) -> None:
        """Look after new topics, the limit and the end, on a thread of its own."""
        while not self._done.wait(POLL_SEC):
            if self._options.discovers:
                self._discover(announce=True)
            if self._is_complete() or time.monotonic() >= self._ends:
                self._done.set()

    def _discover(self, announce: bool) -> None:
        try:
            published = published_topics()
        except MASTER_ERRORS as exc:
            _log.debug("new topics are not seen: %s", exc)  # the registration warns
            self._done.wait(1.0)
            return
        known = self._left.union(self._subscriptions.topics)
        for topic in published:
            if topic not in known and self._options.chooses(topic):
                if announce:
                    self._say(f"recording {topic}, too")
                self._subscribe(topic)

    def _is_complete(self) -> bool:
        """Leave the topics that reached the limit; say whether all have."""
        recording = self._recording
        topics = self._subscriptions.topics
        if not (self._options.limit and topics) or recording is None:
            return False
        complete = [topic for topic in topics if recording.is_complete(topic)]
        self._left.update(complete)
        self._subscriptions.remove(complete)
        return len(complete) == len(topics)
