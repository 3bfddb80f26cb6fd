# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keeps a node registered with the ROS master, also after a restart of the master.

rospy registers a subscription, publication or service only once, when it is made. A restarted
master does not know it: new publishers are never connected, and services are not found.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from typing import Any, Callable, Iterable, Iterator, NamedTuple

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
from cassandra_ros.nodes.ros_node import MASTER_ERRORS, ros_now_ns

_log = logging.getLogger(__name__)

POLL_SEC = 1.0
"""Interval between two checks of the registration, s."""
TIMEOUT_SEC = 3.0
"""Maximum time for an answer of the master, s."""
JOIN_SEC = 5.0
"""Maximum time that ``stop`` waits for the thread, s."""

OnUnheard = Callable[[str, int, int], None]
"""Function called with a topic and the first and last time, ns, at which messages of its new
publishers may have been missed. It is called on the thread that checks the registration."""


class _Registrations(NamedTuple):
    """The registrations of this node: three kinds, in the order of getSystemState."""

    publications: set[tuple[str, str]]
    """Topics with their types."""
    subscriptions: set[tuple[str, str]]
    """Topics with their types."""
    services: set[tuple[str, str]]
    """Services with their URIs."""

    def not_in(self, state: Any) -> _Registrations:
        """Return the registrations that a master does not list in ``state`` (getSystemState)."""
        me, missing = rospy.get_name(), []
        for mine, entries in zip(self, state):
            listed = {name for name, nodes in entries if me in nodes}
            missing.append({(name, kind) for name, kind in mine if name not in listed})
        return _Registrations(*missing)

    def common(self, other: _Registrations) -> _Registrations:
        """Return the registrations that are in both."""
        return _Registrations(*(mine & others for mine, others in zip(self, other)))


def _own_registrations() -> _Registrations:
    """Return the registrations that rospy has for this node; none once it shuts down.

    TimeoutError: one that is being made waits for the master.
    """
    # At shutdown rospy unregisters everything before is_shutdown() is true, but still lists it.
    if is_shutdown_requested():
        return _Registrations(set(), set(), set())
    topics, services = get_topic_manager(), get_service_manager()
    with _held(topics.lock):
        publications, subscriptions = topics.get_publications(), topics.get_subscriptions()
    with _held(services.lock):
        offered = services.get_services()
    return _Registrations(_texts(publications), _texts(subscriptions), _texts(offered))


def _texts(registrations: Iterable[tuple[object, object]]) -> set[tuple[str, str]]:
    """Return names with their types, or with their URIs, as texts."""
    return {(str(name), str(kind)) for name, kind in registrations}


@contextlib.contextmanager
def _held(lock: threading.Condition | threading.RLock) -> Iterator[None]:
    """Hold a lock of rospy. rospy itself holds it during a registration with the master.

    TimeoutError: a registration has not been answered within TIMEOUT_SEC.
    """
    if not lock.acquire(timeout=TIMEOUT_SEC):
        raise TimeoutError(f"a registration was not answered within {TIMEOUT_SEC:g} s")
    try:
        yield
    finally:
        lock.release()


class Registration:
    """A thread that checks each second whether the master lists this node, and registers it again.

    Args:
        on_unheard: Called when a topic has a publisher of which the master did not tell this node.
    """

    def __init__(self, on_unheard: OnUnheard | None = None) -> None:
        self._on_unheard = on_unheard
        self._stop = threading.Event()
        self._away_since: float | None = None
        """Monotonic time at which the master did not answer first, s; None = it answers."""
        self._known_ns = 0
        """Last time at which the master listed all registrations of this node, ns; 0 = the time was
        not known then."""
        self._thread = threading.Thread(target=self._watch, name="registration", daemon=True)

    def start(self) -> Registration:
        """Start the thread; all present registrations are taken as known to the master."""
        self._known_ns = _now()
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the thread; a second call does nothing."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_SEC)

    def _watch(self) -> None:
        """Check the registrations each POLL_SEC, on a thread."""
        while not self._stop.wait(POLL_SEC) and not is_shutdown_requested():
            try:
                self._check()
            except MASTER_ERRORS as exc:
                if self._away_since is None:
                    self._away_since = time.monotonic()
                    _log.warning(
                        "the ROS master does not answer (%s): existing connections go on, but "
                        "no new publisher is heard until it is back",
                        exc,
                    )

    def _check(self) -> None:
        """Register again what the master does not list; raises one of MASTER_ERRORS."""
        master = master_proxy(TIMEOUT_SEC)
        # In this order: rospy itself registers what is made between the two lines.
        ours = _own_registrations()
        _, _, state = master.getSystemState(rospy.get_name())
        seen_ns = _now()
        # Registrations that were removed while the master answered are not missing.
        missing = ours.not_in(state).common(_own_registrations())
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
            # The master may only have been out of reach: then this node was not told of publishers
            # that came meanwhile.
            missing = missing._replace(subscriptions=ours.subscriptions)
        if any(missing):
            self._register(master, missing)
        self._known_ns = seen_ns

    def _register(self, master: Any, missing: _Registrations) -> None:
        """Register with the master, as rospy did at first; connect to publishers that it names."""
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
        # Registrations that the node removed meanwhile must not stay listed.
        present = _own_registrations()
        for name, _ in missing.subscriptions - present.subscriptions:
            master.unregisterSubscriber(me, name, uri)
        for name, _ in missing.publications - present.publications:
            master.unregisterPublisher(me, name, uri)
        for name, service_uri in missing.services - present.services:
            master.unregisterService(me, name, service_uri)
        self._tell_unheard(sorted(unheard))

    def _connect(self, topic: str, publishers: list[str]) -> bool:
        """Let rospy connect to the publishers of a topic; return whether one of them is new."""
        impl = get_topic_manager().get_subscriber_impl(topic)
        connected = {c.endpoint_id for c in (impl.connections or ())} if impl is not None else ()
        for listener in list(get_registration_listeners().listeners):
            update = getattr(listener, "publisher_update", None)
            if update is not None:
                update(topic, publishers)
        return any(uri not in connected and uri != rospy.get_node_uri() for uri in publishers)

    def _tell_unheard(self, topics: list[str]) -> None:
        """Tell that topics have publishers that were not heard since ``_known_ns``."""
        first, last = self._known_ns, _now()
        if not topics:
            return
        _log.warning(
            "publishers of %s that came after %s were not heard until %s: their messages are lost",
            ", ".join(topics),
            iso_time(first),
            iso_time(last),
        )
        if self._on_unheard is not None and first and last:
            for topic in topics:
                self._on_unheard(topic, first, last)


def _now() -> int:
    """Return the time, ns; 0 while simulated time is not known."""
    try:
        return ros_now_ns()
    except ClockNotSet:
        return 0
