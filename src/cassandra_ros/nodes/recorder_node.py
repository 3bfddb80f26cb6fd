# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node recorder: subscribes to topics of any type and stores what comes."""

from __future__ import annotations

import logging
import re
import signal
import threading
import time
from dataclasses import dataclass, replace
from difflib import get_close_matches
from types import FrameType
from typing import Callable, Optional, Sequence

import rospy

from cassandra_ros.nodes.node import (
    MASTER_ERRORS,
    REMAP,
    follow_clock,
    forward_logging,
    now_ns,
    own_name,
)
from cassandra_ros.nodes.subscription import connected_uris, is_drained, subscribe, was_heard
from cassandra_ros.recording.counts import TopicReport
from cassandra_ros.recording.recording import Recording
from cassandra_ros.topics.ros_cassandra import RosCassandra

_log = logging.getLogger(__name__)

POLL_SEC = 0.1
CONNECT_SEC = 5.0
"""How long publishers that exist are waited for before the recorder says that it records."""
DRAIN_SEC = 5.0
"""How long the rest of what lies in the sockets at the end is waited for while nothing comes."""
MAX_DRAIN_SEC = 60.0
"""And while messages come: a publisher may send faster than they can be taken."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class RecorderOptions:
    """What to record, and how: the options of the command line."""

    topics: Sequence[str]
    """Names, or regular expressions."""
    all: bool
    regex: bool
    exclude: str
    """Regular expression of topics that are left out."""
    format: Optional[str]
    node_id: str
    duration: float
    """Seconds; 0 = until it is stopped."""
    limit: int
    buffsize: int
    """Bytes."""
    ttl: int
    tcpnodelay: bool

    @property
    def discovers(self) -> bool:
        """Whether topics are chosen while they appear."""
        return self.all or self.regex

    def excludes(self, topic: str) -> bool:
        """Say whether a topic is left out whatever else is said."""
        return bool(self.exclude and re.fullmatch(self.exclude, topic))

    def chooses(self, topic: str) -> bool:
        """Say whether a topic that appeared is to be recorded."""
        wanted = self.all or any(re.fullmatch(name, topic) for name in self.topics)
        return wanted and not self.excludes(topic)


def record(
    ros_cas: RosCassandra, options: RecorderOptions, argv: Sequence[str], say: Say
) -> list[TopicReport]:
    """Record until a signal, the master, the duration or the limit ends it; report each topic."""
    name = _start_node(argv)
    recorder = Recording(
        ros_cas,
        clock=now_ns,
        format=options.format,
        node=options.node_id,
        buffer_bytes=options.buffsize,
        limit=options.limit,
        ttl=options.ttl,
        name=name,
    )
    try:
        return _Session(recorder, options, say).run()
    except BaseException:
        recorder.close()
        raise
    finally:
        rospy.signal_shutdown("the recording has ended")


class _Session:
    """One recording from its first subscription to its last message."""

    def __init__(self, recorder: Recording, options: RecorderOptions, say: Say) -> None:
        self._recorder = recorder
        self._options = options
        self._say = say
        self._subscribers: dict[str, rospy.Subscriber] = {}
        self._signals = 0
        self._stop = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._signalled)

    def run(self) -> list[TopicReport]:
        self._subscribe_all()
        self._await_publishers()
        topics = len(self._subscribers)
        self._say(f"recording {topics} topic{'' if topics == 1 else 's'}")
        ends = time.monotonic() + (self._options.duration or 1e12)
        while not (self._stop.wait(POLL_SEC) or rospy.is_shutdown() or time.monotonic() >= ends):
            if self._options.discovers:
                self._discover(announce=True)
            if self._is_complete():
                break
        return self._end()

    def _subscribe_all(self) -> None:
        if self._options.discovers:
            self._discover(announce=False)
            return
        for topic in self._options.topics:
            resolved = rospy.resolve_name(topic)
            if not self._options.excludes(resolved):
                self._subscribe(resolved)
        self._warn_of_names()

    def _warn_of_names(self) -> None:
        """Warn of topics that nobody publishes (yet): the name may be mistyped."""
        published = _publishers(None)
        for topic in self._subscribers:
            if published and topic not in published:
                near = get_close_matches(topic, sorted(published), 3)
                meant = f"; did you mean {' or '.join(near)}?" if near else ""
                _log.warning("nobody publishes %s yet%s", topic, meant)

    def _discover(self, announce: bool) -> None:
        try:
            _, _, published = rospy.get_master().getPublishedTopics("")
        except MASTER_ERRORS as exc:
            _log.warning("the master does not answer; new topics are not seen: %s", exc)
            self._stop.wait(1.0)
            return
        for topic, _ in published:
            if topic not in self._subscribers and self._options.chooses(topic):
                if announce:
                    self._say(f"recording {topic}, too")
                self._subscribe(topic)

    def _subscribe(self, topic: str) -> None:
        if topic not in self._subscribers:
            take, nodelay = self._recorder.received, self._options.tcpnodelay
            self._recorder.expect(topic)
            self._subscribers[topic] = subscribe(topic, take, nodelay)

    def _await_publishers(self) -> None:
        """Return when the publishers that exist are connected, or after a while."""
        ends = time.monotonic() + CONNECT_SEC
        missing = _publishers(list(self._subscribers))
        while missing and time.monotonic() < ends and not self._stop.is_set():
            missing = {
                topic: count
                for topic, count in missing.items()
                if len(connected_uris(self._subscribers[topic])) < count
            }
            self._stop.wait(0.02)
        if missing and not self._stop.is_set():
            _log.warning(
                "no connection yet to all publishers of %s: their messages are recorded only from "
                "when it stands (is their node alive, and ROS_IP or ROS_HOSTNAME right?)",
                ", ".join(sorted(missing)),
            )

    def _is_complete(self) -> bool:
        """Leave the topics that reached the limit; say whether all have."""
        left = False
        for topic, subscriber in self._subscribers.items():
            if not self._recorder.is_complete(topic):
                left = True
            elif subscriber.impl is not None:
                subscriber.unregister()
        return bool(self._options.limit and self._subscribers) and not left

    def _end(self) -> list[TopicReport]:
        """Read what is on its way, store it, and report."""
        self._drain_sockets()
        while not self._recorder.stop(timeout_sec=0.2):
            if self._signals > 1:
                _log.warning("interrupted again: what is not stored yet is lost")
                return self._final(self._recorder.reports(final=True))
        return self._final(self._recorder.close())

    def _final(self, reports: list[TopicReport]) -> list[TopicReport]:
        """Note in the reports which topics nobody ever published."""
        silent = {t for t, subscriber in self._subscribers.items() if not was_heard(subscriber)}
        return [
            replace(report, published=report.topic not in silent or report.received > 0)
            for report in reports
        ]

    def _drain_sockets(self) -> None:
        """Wait until each connection was seen empty once: until then it lags behind the end."""
        left, seen, ends = dict(self._subscribers), -1, 0.0
        last = time.monotonic() + MAX_DRAIN_SEC
        while self._signals < 2 and not rospy.is_shutdown():
            left = {t: subscriber for t, subscriber in left.items() if not is_drained(subscriber)}
            arrived, now = sum(map(self._recorder.count, left)), time.monotonic()
            if arrived != seen:
                seen, ends = arrived, min(now + DRAIN_SEC, last)
            if not left:
                return
            if now > ends:
                _log.warning(
                    "what the publishers of %s had sent last is not recorded: "
                    "it could not be read to its end",
                    ", ".join(sorted(left)),
                )
                return
            time.sleep(0.01)

    def _signalled(self, number: int, frame: Optional[FrameType]) -> None:
        self._signals += 1
        self._stop.set()


def _start_node(argv: Sequence[str]) -> str:
    """Become /recorder where that name is free, else a node of an anonymous name."""
    name, full_name, taken = own_name("recorder", argv)
    # A name that is given forbids an anonymous one.
    words = [word for word in argv if not (taken and word.startswith(REMAP))]
    rospy.init_node(name, argv=words, anonymous=taken, disable_signals=True, disable_rostime=True)
    forward_logging()
    follow_clock()
    if taken:
        _log.warning("a node %s runs already; this one is %s", full_name, rospy.get_name())
    return str(rospy.get_name())


def _publishers(topics: Optional[Sequence[str]]) -> dict[str, int]:
    """Return how many publishers each topic has, where it has any; None = of all topics."""
    try:
        _, _, (publishers, _, _) = rospy.get_master().getSystemState()
    except MASTER_ERRORS:
        return {}
    return {
        topic: len(nodes)
        for topic, nodes in publishers
        if nodes and (topics is None or topic in topics)
    }
