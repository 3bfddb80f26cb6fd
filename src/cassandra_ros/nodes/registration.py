# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A node that stays registered with its master, also when that was started anew.

rospy registers a subscription, publication or service once, when it is made. A master that is
started anew knows nothing of it: publishers that come then are never heard, services not found.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Any, Callable, NamedTuple, Optional

import rospy
from rospy.core import is_shutdown_requested
from rospy.impl.registration import (
    get_registration_listeners,
    get_service_manager,
    get_topic_manager,
)

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.messages.ros_master import master_proxy
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.nodes.node import MASTER_ERRORS, now_ns

_log = logging.getLogger(__name__)

POLL_SEC = 1.0
TIMEOUT_SEC = 3.0
JOIN_SEC = 5.0

OnUnheard = Callable[[str, int, int], None]
"""Called with a topic and the first and last time, ns, at which publishers of it may have been
missed; on the thread of the watch."""


class _Ours(NamedTuple):
    """What is, or is to be, registered in our name: (name, type or URI) of each."""

    publications: set[tuple[str, str]]
    subscriptions: set[tuple[str, str]]
    services: set[tuple[str, str]]

    def but(self, state: Any) -> _Ours:
        """Return what a master does not list; ``state`` is its getSystemState."""
        me, left = rospy.get_name(), []
        for mine, entries in zip(self, state):
            listed = {name for name, nodes in entries if me in nodes}
            left.append({(name, kind) for name, kind in mine if name not in listed})
        return _Ours(*left)

    def still(self, ours: _Ours) -> _Ours:
        """Return what is in both."""
        return _Ours(*(mine & others for mine, others in zip(self, ours)))


def _ours() -> _Ours:
    # rospy unregisters all before is_shutdown() says so, and forgets it only then.
    if is_shutdown_requested():
        return _Ours(set(), set(), set())
    manager = get_topic_manager()
    with manager.lock:
        publications = {(str(name), str(kind)) for name, kind in manager.get_publications()}
        subscriptions = {(str(name), str(kind)) for name, kind in manager.get_subscriptions()}
    services = {(str(name), str(uri)) for name, uri in get_service_manager().get_services()}
    return _Ours(publications, subscriptions, services)


class Registration:
    """Looks each second whether the master lists this node, and registers it again where not.

    Args:
        on_unheard: Called where a publisher is there that this node had not been told of.
    """

    def __init__(self, on_unheard: Optional[OnUnheard] = None) -> None:
        self._on_unheard = on_unheard
        self._stop = threading.Event()
        self._away_since: Optional[float] = None
        self._known_ns = 0
        """When the master was last seen to know all that is ours."""
        self._thread = threading.Thread(target=self._watch, name="registration", daemon=True)

    def start(self) -> Registration:
        """Begin to watch; what is registered then is taken for known."""
        self._known_ns = _now()
        self._thread.start()
        return self

    def stop(self) -> None:
        """Watch no more; twice is harmless."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_SEC)

    def _watch(self) -> None:
        while not self._stop.wait(POLL_SEC) and not is_shutdown_requested():
            try:
                self._look()
            except MASTER_ERRORS as exc:
                if self._away_since is None:
                    self._away_since = time.monotonic()
                    _log.warning(
                        "the ROS master does not answer (%s): connections that stand go on, but "
                        "no new publisher is heard until it is back",
                        exc,
                    )

    def _look(self) -> None:
        """Compare what the master lists with what is ours; raises one of MASTER_ERRORS."""
        master = master_proxy(TIMEOUT_SEC)
        # In this order: what is made in between is registered by rospy itself.
        ours = _ours()
        _, _, state = master.getSystemState(rospy.get_name())
        seen_ns = _now()
        # What was given up while the master answered is not missing: rospy unregisters it.
        missing = ours.but(state).still(_ours())
        if is_shutdown_requested() or self._stop.is_set():
            return
        if any(missing):
            _log.warning(
                "the ROS master does not know this node any more: registering again %d "
                "publications, %d subscriptions, %d services",
                *map(len, missing),
            )
        away, self._away_since = self._away_since, None
        if away is not None:
            _log.warning("the ROS master answers again after %.0f s", time.monotonic() - away)
            # It may have been out of reach only: then it told us of nobody who came meanwhile.
            missing = missing._replace(subscriptions=ours.subscriptions)
        if any(missing):
            self._register(master, missing)
        self._known_ns = seen_ns

    def _register(self, master: Any, missing: _Ours) -> None:
        me, uri = rospy.get_name(), rospy.get_node_uri()
        for name, kind in missing.publications:
            master.registerPublisher(me, name, kind, uri)
        for name, service_uri in missing.services:
            master.registerService(me, name, service_uri, uri)
        unheard = []
        for name, kind in missing.subscriptions:
            code, _, publishers = master.registerSubscriber(me, name, kind, uri)
            if code == 1 and self._connect(name, publishers):
                unheard.append(name)
        # What was left meanwhile must not stay listed.
        left = _ours()
        for name, _ in missing.subscriptions - left.subscriptions:
            master.unregisterSubscriber(me, name, uri)
        for name, _ in missing.publications - left.publications:
            master.unregisterPublisher(me, name, uri)
        for name, service_uri in missing.services - left.services:
            master.unregisterService(me, name, service_uri)
        self._tell(sorted(unheard))

    def _connect(self, topic: str, publishers: list[str]) -> bool:
        """Let rospy connect to the publishers of a topic; say whether one of them is new."""
        impl = get_topic_manager().get_subscriber_impl(topic)
        connected = {c.endpoint_id for c in (impl.connections or ())} if impl is not None else ()
        for listener in list(get_registration_listeners().listeners):
            update = getattr(listener, "publisher_update", None)
            if update is not None:
                update(topic, publishers)
        return any(uri not in connected and uri != rospy.get_node_uri() for uri in publishers)

    def _tell(self, topics: list[str]) -> None:
        first, last = self._known_ns, _now()
        if not topics:
            return
        _log.warning(
            "publishers of %s that came since %s were not heard until %s: what they sent is lost",
            ", ".join(topics),
            iso_time(first),
            iso_time(last),
        )
        if self._on_unheard is not None and first and last:
            for topic in topics:
                self._on_unheard(topic, first, last)


def _now() -> int:
    """Tell the time, ns; 0 while simulated time is not known."""
    try:
        return now_ns()
    except ClockNotSet:
        return 0
