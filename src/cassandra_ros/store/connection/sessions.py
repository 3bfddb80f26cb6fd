# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The driver's sessions with a cluster, and their replacement after they have ended.

A driver's session can end for good while the server answers other clients. When a connection of a
session breaks, the driver shuts down the session's pool of connections. While another session still
has an open connection, the driver leaves the node marked as up and never makes another pool.
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
"""How long all requests may fail before the sessions are replaced, s."""
FIRST_PAUSE_SEC = 0.5
LAST_PAUSE_SEC = 30.0
"""Pauses between two attempts to replace the sessions, doubled from the first to the last, s."""
PROBE_SEC = 2.0
"""How long a server may take to accept a connection before sessions are replaced, s."""


class Link(NamedTuple):
    """A driver's cluster and our two sessions with it; all three are replaced together."""

    cluster: Cluster
    session: Session
    """Session that returns decoded values."""
    raw_session: Session
    """Session that returns the bytes of each value."""

    def is_shut_down(self) -> bool:
        """Return whether the cluster or a session has ended for good and can send no request."""
        if self.cluster.is_shutdown:
            return True
        return any(map(_is_session_shut_down, (self.session, self.raw_session)))


def _is_session_shut_down(session: Session) -> bool:
    pools = tuple(session.get_pools())
    # Without pools the driver knows that the nodes are down, and looks for them itself.
    return session.is_shutdown or (bool(pools) and all(pool.is_shutdown for pool in pools))


class Links:
    """The link of a connection, and the thread that makes a new one. Thread-safe.

    Args:
        make: Makes a link; raises CassandraRosError if the cluster does not answer. Called by the
            constructor, later on the thread of ``_replace``.
        adopt: Passes the prepared statements to a link, before it replaces the old one and, for
            those that were prepared meanwhile, after that.
        addresses: Address and port of each node to connect to.
        where: The same as text for log lines.

    Attributes:
        current: The link in use.
    """

    def __init__(
        self,
        make: Callable[[], Link],
        adopt: Callable[[Link], None],
        addresses: list[tuple[str, int]],
        where: str,
    ) -> None:
        self._make, self._adopt, self._addresses, self._where = make, adopt, addresses, where
        self._changed = threading.Condition()
        self._closed = self._making = False
        self._next = 0.0
        """Monotonic time from which the next attempt may begin, s."""
        self._pause = FIRST_PAUSE_SEC
        """Pause between the last attempt and the next, s."""
        self.current = make()
        self._since = time.monotonic()
        """Monotonic time since which the current link is in use, s."""

    def failed(self, silent_sec: float) -> None:
        """Note that a request failed; start to replace the link if it is the reason.

        It never blocks: the driver's own threads call it. Of attempts to replace the link only one
        runs at a time.

        Args:
            silent_sec: Time since which every request has failed without any answer, s.
        """
        link = self.current
        # The silence before this link was in use was that of another link.
        silent_sec = min(silent_sec, time.monotonic() - self._since)
        silent = silent_sec >= SILENT_SEC
        if not (silent or link.is_shut_down()):
            return
        with self._changed:
            if self._closed or self._making or time.monotonic() < self._next:
                return
            self._making = True
        why = f"has answered nothing for {silent_sec:.0f} s" if silent else "was shut down"
        name, args = "cassandra_ros-session", (link, why)
        try:
            threading.Thread(target=self._replace, args=args, name=name, daemon=True).start()
        except RuntimeError as exc:  # no more threads: the next failed request tries again
            _log.warning("the connection %s, and no thread can replace it now: %s", why, exc)
            with self._changed:
                self._making = False

    def await_open(self, seconds: float) -> Link:
        """Return the link; if it has ended, wait up to ``seconds`` for a new one.

        The result is the link that has ended if none was made in this time.
        """
        ends = time.monotonic() + seconds
        while self.current.is_shut_down() and not self._closed and time.monotonic() < ends:
            self.failed(0.0)
            with self._changed:
                self._changed.wait(FIRST_PAUSE_SEC)
        return self.current

    def _replace(self, old: Link, why: str) -> None:
        """Replace the link if another one can be made; ``why`` is a text for the log line."""
        new = self._try_to_make()
        with self._changed:
            self._making = False
            self._pause = FIRST_PAUSE_SEC if new else min(2 * self._pause, LAST_PAUSE_SEC)
            self._next = time.monotonic() + self._pause
            is_closed = self._closed
            if new is not None and not is_closed:
                self.current, self._since = new, time.monotonic()
            self._changed.notify_all()
        if new is None:
            return
        if is_closed:  # close has not seen the new link
            new.cluster.shutdown()
        else:
            self._adopt(new)
            _log.warning("the session with the store at %s %s: made anew", self._where, why)
            # The requests on the old link fail now and are sent again on the new one.
            old.cluster.shutdown()

    def _try_to_make(self) -> Link | None:
        """Return a new link that has the prepared statements; None if none can be made now."""
        if not any(map(_accepts, self._addresses)):
            return None
        try:
            link = self._make()
            self._adopt(link)
            return link
        except CassandraRosError as exc:
            _log.debug("no new session with the store at %s: %s", self._where, exc)
            return None

    def close(self, seconds: float | None = None) -> None:
        """Shut the link down and make no other; wait at most ``seconds`` (None = no limit)."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        shutdown = self.current.cluster.shutdown
        ending = threading.Thread(target=shutdown, name="cassandra_ros-end", daemon=True)
        ending.start()
        ending.join(seconds)


def _accepts(address: tuple[str, int]) -> bool:
    """Return whether a server accepts connections at an address and port."""
    try:
        socket.create_connection(address, timeout=PROBE_SEC).close()
        return True
    except (OSError, UnicodeError):
        return False
