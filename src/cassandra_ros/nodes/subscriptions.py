# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The subscriptions of a recorder: connected before it says so, read to their end when it ends."""

from __future__ import annotations

import logging
import threading
import time
from difflib import get_close_matches
from typing import Callable, Collection, Iterable, Optional

import rospy

from cassandra_ros.nodes.node import MASTER_ERRORS
from cassandra_ros.nodes.subscription import (
    Callback,
    connected_uris,
    is_drained,
    subscribe,
    was_heard,
)

_log = logging.getLogger(__name__)

CONNECT_SEC = 5.0
"""How long publishers that exist are waited for before a recorder says that it records."""
DRAIN_SEC = 5.0
"""How long the rest of what lies in the sockets at the end is waited for while nothing comes."""
MAX_DRAIN_SEC = 60.0
"""And while messages come: a publisher may send faster than they can be taken."""


class Subscriptions:
    """Subscriptions to topics of any type, all with one callback. Thread-safe."""

    def __init__(self, callback: Callback, tcp_nodelay: bool = False) -> None:
        self._callback = callback
        self._nodelay = tcp_nodelay
        self._subscribers: dict[str, rospy.Subscriber] = {}
        self._mutex = threading.Lock()

    @property
    def topics(self) -> list[str]:
        """The topics that are subscribed to."""
        with self._mutex:
            return list(self._subscribers)

    def add(self, topic: str) -> None:
        """Subscribe to a topic, by its resolved name."""
        with self._mutex:
            if topic not in self._subscribers:
                self._subscribers[topic] = subscribe(topic, self._callback, self._nodelay)

    def remove(self, topics: Iterable[str]) -> None:
        """Leave topics: nothing comes from them any more."""
        with self._mutex:
            left = [self._subscribers.pop(topic, None) for topic in topics]
        for subscriber in left:
            if subscriber is not None:
                subscriber.unregister()

    def unheard(self) -> set[str]:
        """Return the topics of which no publisher was ever connected."""
        with self._mutex:
            return {t for t, subscriber in self._subscribers.items() if not was_heard(subscriber)}

    def warn_of_names(self) -> None:
        """Warn of topics that nobody publishes (yet): the name may be mistyped."""
        published = _publishers(None)
        for topic in self.topics:
            if published and topic not in published:
                near = get_close_matches(topic, sorted(published), 3)
                meant = f"; did you mean {' or '.join(near)}?" if near else ""
                _log.warning("nobody publishes %s yet%s", topic, meant)

    def await_publishers(self, hurry: threading.Event) -> None:
        """Return when the publishers that exist are connected, in a hurry, or after a while."""
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
                "no connection yet to all publishers of %s: their messages are recorded only from "
                "when it stands (is their node alive, and ROS_IP or ROS_HOSTNAME right?)",
                ", ".join(sorted(missing)),
            )

    def drain(
        self,
        topics: Collection[str],
        count: Callable[[str], int],
        give_up: Callable[[], bool],
    ) -> list[str]:
        """Wait until each connection was seen empty once: until then it lags behind the end.

        Args:
            count: Tells how many messages of a topic have come.
            give_up: Tells whether nobody wants to wait any longer.

        Returns:
            The topics of which something could not be read to its end.
        """
        with self._mutex:
            left = {t: subscriber for t, subscriber in self._subscribers.items() if t in topics}
        seen, ends = -1, 0.0
        last = time.monotonic() + MAX_DRAIN_SEC
        while left:
            left = {t: subscriber for t, subscriber in left.items() if not is_drained(subscriber)}
            arrived, now = sum(map(count, left)), time.monotonic()
            if arrived != seen:
                seen, ends = arrived, min(now + DRAIN_SEC, last)
            if not left or now > ends or give_up() or rospy.is_shutdown():
                break
            time.sleep(0.01)
        if left:
            _log.warning(
                "what the publishers of %s had sent last is not recorded: "
                "it could not be read to its end",
                ", ".join(sorted(left)),
            )
        return sorted(left)


def published_topics() -> list[str]:
    """List the topics that somebody publishes; raises one of MASTER_ERRORS."""
    _, _, published = rospy.get_master().getPublishedTopics("")
    return [topic for topic, _ in published]


def subscribed_topics(node: str) -> list[str]:
    """List the topics that a node subscribes to; raises one of MASTER_ERRORS."""
    _, _, (_, subscribers, _) = rospy.get_master().getSystemState()
    return [topic for topic, nodes in subscribers if node in nodes]


def _publishers(topics: Optional[Collection[str]]) -> dict[str, int]:
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
