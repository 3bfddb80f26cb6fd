# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node replicator: name, parameters, signals, services, diagnostics; Follower does the work."""

from __future__ import annotations

import logging
import signal
import threading
import time
from types import FrameType
from typing import Callable, Mapping, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from cassandra_ros.msg import CopiedTopic
from cassandra_ros.nodes.diagnostics import StatusPublisher
from cassandra_ros.nodes.ros_node import offer_services, start_named_node
from cassandra_ros.srv import ReplicatorStatus, ReplicatorStatusRequest, ReplicatorStatusResponse
from cassandra_ros.stores.copying.copy_status import TopicStatus
from cassandra_ros.stores.copying.follower import AWAY, PAUSED, Follower, FollowerStatus

_log = logging.getLogger(__name__)

SERVICES: Mapping[str, type] = {"status": ReplicatorStatus, "pause": Trigger, "resume": Trigger}
"""The services with their classes."""
TICK_SEC = 0.2
"""Interval at which the state is checked, s."""
PUBLISH_SEC = 5.0
"""Interval at which the status is published, s."""
LATE_SEC = 60.0
"""Recorded time that waits, from which the level of a topic is WARN, s."""
Say = Callable[[str], object]
"""Function that prints a line for the user."""


def start_node(argv: Sequence[str]) -> Mapping[str, object]:
    """Start the node /replicator, anonymous if the name is taken; return its parameters."""
    return start_named_node("replicator", argv)


def follow(follower: Follower, say: Say, *, diagnostics: bool, no_services: bool) -> str:
    """Copy until a signal, the master or a problem ends it; return the problem, '' = none.

    The node has ended then.

    Args:
        follower: Copies the topics; started and ended here.
        say: Prints a line for the user.
        diagnostics: Whether to publish the status on /diagnostics.
        no_services: Whether to offer no services.
    """
    ending = threading.Event()

    def signalled(number: int, frame: FrameType | None) -> None:
        ending.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signalled)
    try:
        with follower:
            handlers = _Handlers(follower)
            services = [(f"~{n}", kind, getattr(handlers, n)) for n, kind in SERVICES.items()]
            offer_services(services, say, none=no_services)
            _say_states(follower, ending, _Diagnostics() if diagnostics else None, say)
        return follower.problem
    finally:
        rospy.signal_shutdown("the replicator has ended")


def _say_states(
    follower: Follower, ending: threading.Event, diagnostics: _Diagnostics | None, say: Say
) -> None:
    """Say each new state, and publish the status each PUBLISH_SEC, until the node is to end."""
    state, due = "", 0.0
    while not (ending.wait(TICK_SEC) or rospy.is_shutdown() or follower.ended):
        status = follower.status
        if status.state != state:
            state = status.state
            reason = f": {status.reason}" if status.reason else ""
            say(f"{state} {status.place}".rstrip() + reason)
        if diagnostics is not None and time.monotonic() >= due:
            due = time.monotonic() + PUBLISH_SEC
            diagnostics.publish(status)


class _Handlers:
    """The handlers of the services."""

    def __init__(self, follower: Follower) -> None:
        self._follower = follower

    def pause(self, request: TriggerRequest) -> TriggerResponse:
        """Answer ~pause."""
        self._follower.pause()
        return TriggerResponse(success=True)

    def resume(self, request: TriggerRequest) -> TriggerResponse:
        """Answer ~resume."""
        self._follower.resume()
        return TriggerResponse(success=True)

    def status(self, request: ReplicatorStatusRequest) -> ReplicatorStatusResponse:
        """Answer ReplicatorStatus."""
        status = self._follower.status
        seconds_left = status.left_sec
        return ReplicatorStatusResponse(
            success=True,
            state=status.state,
            target=status.place,
            reason=status.reason,
            topics=list(map(_pack, status.topics)),
            bytes_per_second=status.bytes_per_sec,
            seconds_left=-1.0 if seconds_left is None else seconds_left,
            unused_patterns=list(status.unused),
        )


def _pack(topic: TopicStatus) -> CopiedTopic:
    return CopiedTopic(
        topic=topic.topic,
        copied=topic.copied,
        left_out=topic.left_out,
        waiting=topic.waiting,
        waiting_bytes=topic.waiting_bytes,
        waiting_seconds=topic.waiting_sec,
        refused=topic.refused,
    )


class _Diagnostics(StatusPublisher):
    """Publishes the status on /diagnostics: one entry for the target, one for each topic."""

    def publish(self, status: FollowerStatus) -> None:
        """Publish a status."""
        entries = [self._of_target(status), *map(self._of_topic, status.topics)]
        entries += self.quota_entries(status.quota)
        self.send(rospy.Time.from_sec(time.time()), entries)

    def _of_target(self, status: FollowerStatus) -> DiagnosticStatus:
        away = status.state in (AWAY, PAUSED)
        level = DiagnosticStatus.WARN if away or status.unused else DiagnosticStatus.OK
        text = status.reason or status.state
        if status.unused and not away:
            text = f"no topic matches {', '.join(status.unused)}"
        seconds_left = status.left_sec
        values = {
            "state": status.state,
            "target": status.place,
            "waiting": str(status.waiting),
            "waiting bytes": str(status.waiting_bytes),
            "bytes/s": f"{status.bytes_per_sec:.0f}",
            "left s": "unknown" if seconds_left is None else f"{seconds_left:.0f}",
        }
        return self.entry(level, "target", text, values)

    def _of_topic(self, topic: TopicStatus) -> DiagnosticStatus:
        level, text = DiagnosticStatus.OK, "copied"
        if topic.waiting:
            text = f"{topic.waiting} messages wait"
            if topic.waiting_sec > LATE_SEC:
                level = DiagnosticStatus.WARN
        if topic.refused:
            level, text = DiagnosticStatus.ERROR, topic.refused
        values = {
            "copied": str(topic.copied),
            "left out": str(topic.left_out),
            "waiting": str(topic.waiting),
            "waiting bytes": str(topic.waiting_bytes),
            "waiting s": f"{topic.waiting_sec:.1f}",
        }
        return self.entry(level, topic.topic, text, values)
