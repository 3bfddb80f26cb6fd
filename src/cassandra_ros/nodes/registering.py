# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Registers a node again with a master that went away and came back.

rospy registers once: a master that was restarted knows nothing of the nodes that were there before.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Optional

import rospy
from rospy.core import xmlrpcapi
from rospy.impl.registration import (
    RegManager,
    get_registration_listeners,
    get_service_manager,
    get_topic_manager,
)

from cassandra_ros.nodes.node import MASTER_ERRORS

_log = logging.getLogger(__name__)

LOOK_SEC = 1.0


class MasterWatch:
    """Looks each second whether the master knows this node, from its making to ``close``."""

    def __init__(self) -> None:
        self._stopping = threading.Event()
        self._away_since: Optional[float] = None
        self._pid: Optional[int] = None
        threading.Thread(target=self._run, daemon=True, name="master watch").start()

    def close(self) -> None:
        """Look no more."""
        self._stopping.set()

    def _run(self) -> None:
        while not (self._stopping.wait(LOOK_SEC) or rospy.is_shutdown()):
            found = [each for each in get_registration_listeners().listeners if _is_manager(each)]
            try:
                for manager in found:
                    self._look(manager)
            except MASTER_ERRORS as exc:
                if self._away_since is None:
                    self._away_since = time.monotonic()
                    _log.warning(
                        "the master at %s does not answer: connections that stand go on, new ones "
                        "come when it is back (%s)",
                        *(found[0].master_uri, exc),
                    )

    def _look(self, manager: RegManager) -> None:
        master, name = xmlrpcapi(manager.master_uri, cache=False), str(rospy.get_name())
        pid = int(master.getPid(name)[2])
        if self._pid not in (None, pid) or master.lookupNode(name, name)[0] != 1:
            register(manager)
            _log.warning("the master did not know this node any more; it is registered again")
        self._pid = pid
        if self._away_since is not None:
            away, self._away_since = time.monotonic() - self._away_since, None
            _log.warning("the master is back after %.0f s", away)


def _is_manager(listener: object) -> bool:
    return isinstance(listener, RegManager) and bool(listener.master_uri)


def register(manager: RegManager) -> None:
    """Register all topics and services of this node, and look who publishes what it listens to."""
    master, name = xmlrpcapi(manager.master_uri, cache=False), str(rospy.get_name())
    topics, services = get_topic_manager(), get_service_manager()
    for topic, kind in topics.get_publications():
        master.registerPublisher(name, topic, kind, manager.uri)
    for topic, kind in topics.get_subscriptions():
        code, _, publishers = master.registerSubscriber(name, topic, kind, manager.uri)
        if code == 1:
            manager.publisher_update(topic, publishers)
    for service, uri in services.get_services():
        master.registerService(name, service, uri, manager.uri)
