# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The subscriptions of a recorder: connected at its start and read to their end when it ends."""

from __future__ import annotations

import logging
import threading
import time
from difflib import get_close_matches
from typing import Callable, Collection, Iterable

import rospy

from cassandra_ros.nodes.ros_node import MASTER_ERRORS
from cassandra_ros.nodes.subscription import (
    Callback,
    OnGap,
    connected_uris,
    is_drained,
    subscribe,
    was_heard,
)
from cassandra_ros.recording.dry_run import PlannedTopic, plan_topics
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.topic_settings import recording_settings
from cassandra_ros.topics.catalog import Catalog

_log = logging.getLogger(__name__)

CONNECT_SEC = 5.0
"""Maximum time to wait at the start for connections to the existing publishers, s."""
DRAIN_SEC = 5.0
"""Maximum time without a message in which the sockets are read to their end, s."""
MAX_DRAIN_SEC = 60.0
"""The same while messages come, s: a publisher may send faster than they can be handled."""


class Subscriptions:
    """The subscriptions to topics of any type, all with the same callbacks. Thread-safe."""

    def __init__(
        self, callback: Callback, tcp_nodelay: bool = False, on_gap: OnGap | None = None
    ) -> None:
        self._callback = callback
        self._on_gap = on_gap
        self._nodelay = tcp_nodelay
        self._subscribers: dict[str, rospy.Subscriber] = {}
        self._mutex = threading.Lock()

    @property
    def topics(self) -> list[str]:
        """Names of the subscribed topics."""
        with self._mutex:
            return list(self._subscribers)

    def add(self, topic: str) -> None:
        """Subscribe to a topic, by its resolved name."""
        with self._mutex:
            if topic not in self._subscribers:
                self._subscribers[topic] = subscribe(
                    topic, self._callback, self._nodelay, self._on_gap
                )

    def remove(self, topics: Iterable[str]) -> None:
        """Unsubscribe from topics: their callback is not called any more."""
        with self._mutex:
            subscribers = [self._subscribers.pop(topic, None) for topic in topics]
        for subscriber in subscribers:
            if subscriber is not None:
                subscriber.unregister()

    def unheard(self) -> set[str]:
        """Return the topics to which no publisher was ever connected."""
        with self._mutex:
            return {t for t, subscriber in self._subscribers.items() if not was_heard(subscriber)}

    def warn_of_names(self) -> None:
        """Warn of topics that have no publisher (yet): the name may be mistyped."""
        published = _publishers(None)
        for topic in self.topics:
            if published and topic not in published:
                near = get_close_matches(topic, sorted(published), 3)
                meant = f"; did you mean {' or '.join(near)}?" if near else ""
                _log.warning("topic %s has no publisher yet%s", topic, meant)

    def await_publishers(self, hurry: threading.Event) -> None:
        """Wait until the existing publishers are connected, or ``hurry`` is set, or CONNECT_SEC."""
        ends = time.monotonic() + CONNECT_SEC
        with self._mutex:
            subscribers = dict(self._subscribers)
        missing = _publishers(subscribers)
        while missing and time.monotonic() < ends and not hurry.is_set():
            missing = {
                topic: count
                for topic, count in missing.items()
                if len(connected_uris(subscribers[topic])) < count
            }
            hurry.wait(0.02)
        if missing and not hurry.is_set():
            _log.warning(
                "not all publishers of %s are connected yet: their messages are recorded only from "
                "then on (is their node alive, and ROS_IP or ROS_HOSTNAME right?)",
                ", ".join(sorted(missing)),
            )

    def drain(
        self, topics: Collection[str], count: Callable[[str], int], give_up: Callable[[], bool]
    ) -> list[str]:
        """Wait until all connections of some topics were empty once.

        Messages that were sent before are handled then. It stops when no message of a topic that it
        waits for has come for DRAIN_SEC, after MAX_DRAIN_SEC in all, and when ROS shuts down.

        Args:
            topics: Names of the topics.
            count: Returns the number of received messages of a topic.
            give_up: Returns whether to stop waiting.

        Returns:
            The topics whose connections could not be read to their end.
        """
        with self._mutex:
            waiting = {t: subscriber for t, subscriber in self._subscribers.items() if t in topics}
        seen: dict[str, int] = {}
        ends = 0.0  # when to stop if no more messages come
        last = time.monotonic() + MAX_DRAIN_SEC
        while waiting:
            waiting = {
                t: subscriber for t, subscriber in waiting.items() if not is_drained(subscriber)
            }
            arrived, now = {topic: count(topic) for topic in waiting}, time.monotonic()
            # A topic that is not waited for any more is no news.
            if arrived.items() - seen.items():
                seen, ends = arrived, min(now + DRAIN_SEC, last)
            if not waiting or now > ends or give_up() or rospy.is_shutdown():
                break
            time.sleep(0.01)
        if waiting:
            _log.warning(
                "the last messages of the publishers of %s are not recorded: their connections "
                "could not be read to their end",
                ", ".join(sorted(waiting)),
            )
        return sorted(waiting)


def published_topics(but_of: str = "") -> list[str]:
    """Return the topics that have a publisher other than the node of this name.

    Raises one of MASTER_ERRORS.
    """
    _, _, (publishers, _, _) = rospy.get_master().getSystemState()
    return [topic for topic, nodes in publishers if any(node != but_of for node in nodes)]


def subscribed_topics(node: str) -> list[str]:
    """Return the topics that a node subscribes to; raises one of MASTER_ERRORS."""
    _, _, (_, subscribers, _) = rospy.get_master().getSystemState()
    return [topic for topic, nodes in subscribers if node in nodes]


def _publishers(topics: Collection[str] | None) -> dict[str, int]:
    """Return the number of publishers of each topic that has any; None = all topics."""
    try:
        _, _, (publishers, _, _) = rospy.get_master().getSystemState()
    except MASTER_ERRORS:
        return {}
    return {
        topic: len(nodes)
        for topic, nodes in publishers
        if nodes and (topics is None or topic in topics)
    }


def make_plan(catalog: Catalog, options: RecorderOptions) -> list[PlannedTopic]:
    """Return the plan for each topic that would be recorded now; raises one of MASTER_ERRORS."""
    named = [] if options.regex else [rospy.resolve_name(name) for name in options.topics]
    if options.node:
        named += subscribed_topics(rospy.resolve_name(options.node))
    topics = {topic for topic in named if not options.excludes(topic)}
    topics.update(filter(options.chooses, published_topics()))
    _, _, pairs = rospy.get_master().getTopicTypes()
    types = dict(pairs)
    return plan_topics(catalog, recording_settings(options), {t: types.get(t, "") for t in topics})
