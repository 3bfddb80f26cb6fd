# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The driver's sessions with a cluster, and new ones where these have ended.

A driver's session can end for good while the server answers other clients. The driver shuts the
pool of connections of one session down when a connection of it breaks, and leaves the node marked
as up while another session still has an open connection: then it never makes another pool.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from typing import Callable, NamedTuple

from cassandra.cluster import Cluster, Session

from cassandra_ros.errors import CassandraRosError

_log = logging.getLogger(__name__)

SILENT_SEC = 60.0
"""How long requests may fail, without one that is answered, before sessions are made anew, s."""
FIRST_PAUSE_SEC = 0.5
LAST_PAUSE_SEC = 30.0
"""Pauses between two attempts to make sessions anew: doubled from the first to the last, s."""
PROBE_SEC = 2.0
"""How long a server may take to accept a connection before sessions are made anew, s."""


class Link(NamedTuple):
    """A cluster of the driver with our two sessions; it is replaced as a whole."""

    cluster: Cluster
    session: Session
    """Gives values that are decoded."""
    raw_session: Session
    """Gives the bytes of each value."""

    def is_shut_down(self) -> bool:
        """Say whether one of the sessions has ended for good: no request of it can be sent."""
        if self.cluster.is_shutdown:
            return True
        return any(map(_is_shut_down, (self.session, self.raw_session)))


def _is_shut_down(session: Session) -> bool:
    pools = tuple(session.get_pools())
    # Without pools the driver knows that the nodes are down, and looks for them itself.
    return session.is_shutdown or (bool(pools) and all(pool.is_shutdown for pool in pools))


class Links:
    """The link of a connection, and the thread that makes another one. Thread-safe.

    Args:
        make: Makes a link; raises CassandraRosError where the cluster does not answer.
        adopt: Tells a link which statements are prepared, before and after it is put in use.
        places: Addresses and port of the nodes that are asked for a link.
        where: The same, for people.

    Attributes:
        current: The link that is in use.
    """

    def __init__(
        self,
        make: Callable[[], Link],
        adopt: Callable[[Link], None],
        places: list[tuple[str, int]],
        where: str,
    ) -> None:
        self._make, self._adopt, self._places, self._where = make, adopt, places, where
        self._changed = threading.Condition()
        self._closed = self._making = False
        self._next = 0.0
        """When the next attempt may begin; monotonic."""
        self._pause = FIRST_PAUSE_SEC
        self.current = make()
        self._since = time.monotonic()
        """When it was put in use; monotonic."""

    def failed(self, silent_sec: float) -> None:
        """Note that a request failed; where the link is to blame another one is begun.

        It never blocks: the driver's own threads call it.

        Args:
            silent_sec: How long requests have failed without one that was answered, s.
        """
        link, silent_sec = self.current, min(silent_sec, time.monotonic() - self._since)
        silent = silent_sec >= SILENT_SEC
        if not (silent or link.is_shut_down()):
            return
        with self._changed:
            if self._closed or self._making or time.monotonic() < self._next:
                return
            self._making = True
        why = f"has answered nothing for {silent_sec:.0f} s" if silent else "was shut down"
        name, args = "cassandra_ros-session", (link, why)
        threading.Thread(target=self._replace, args=args, name=name, daemon=True).start()

    def await_open(self, seconds: float) -> Link:
        """Return the link, after so many seconds at the most where one is made in its place."""
        ends = time.monotonic() + seconds
        while self.current.is_shut_down() and not self._closed and time.monotonic() < ends:
            self.failed(0.0)
            with self._changed:
                self._changed.wait(FIRST_PAUSE_SEC)
        return self.current

    def _replace(self, old: Link, why: str) -> None:
        new = self._made()
        with self._changed:
            self._making = False
            self._pause = FIRST_PAUSE_SEC if new else min(2 * self._pause, LAST_PAUSE_SEC)
            self._next = time.monotonic() + self._pause
            unwanted = new if self._closed else None
            if new is not None and not self._closed:
                self.current, self._since = new, time.monotonic()
            self._changed.notify_all()
        if unwanted is not None:
            unwanted.cluster.shutdown()
        elif new is not None:
            self._adopt(new)
            _log.warning("the session with the store at %s %s: made anew", self._where, why)
            # What it had on its way fails now, and is sent again by the new one.
            old.cluster.shutdown()

    def _made(self) -> Link | None:
        if not any(map(_accepts, self._places)):
            return None
        try:
            made = self._make()
            self._adopt(made)
            return made
        except CassandraRosError as exc:
            _log.debug("no new session with the store at %s: %s", self._where, exc)
            return None

    def close(self, seconds: float | None = None) -> None:
        """Shut the link down, waiting for so long at the most (None = as it takes).

        No other link is made.
        """
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        shutdown = self.current.cluster.shutdown
        ending = threading.Thread(target=shutdown, name="cassandra_ros-end", daemon=True)
        ending.start()
        ending.join(seconds)


def _accepts(place: tuple[str, int]) -> bool:
    try:
        socket.create_connection(place, timeout=PROBE_SEC).close()
        return True
    except (OSError, UnicodeError):
        return False
