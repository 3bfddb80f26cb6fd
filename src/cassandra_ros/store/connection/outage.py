# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Outages of the store: logged when one begins, then once a minute, and when it is over."""

from __future__ import annotations

import logging
import math
import threading
import time
from typing import Callable

from cassandra_ros.store.connection.driver_errors import cause_of, is_answer

_log = logging.getLogger(__name__)

GRACE_SEC = 2.0
"""Minimum time without an answer that counts as an outage, s. A shorter one is not logged."""
STUBBORN_SEC = 10.0
"""Age from which a failing request is logged while other requests are answered, s."""
REPEAT_SEC = 60.0
"""Minimum time between two such log lines, and between two of one outage, s."""
HURRY_SEC = 1.5
"""How long a program that has to end waits for an answer, since the last answer, s."""


class Outage:
    """Notes which requests of a connection fail and which are answered. Thread-safe.

    Args:
        where: The hosts, as text for log lines.
        nodes: Returns a text that says which nodes of the cluster answer and which do not; '' if
            all or none do.
        failing: Called after each failure, on any thread, with the time since which no server has
            answered at all, not even with an error, s; must not block.
        limit_sec: Maximum time that a request outside of a Flight waits for an answer, with its
            retries, s.
    """

    def __init__(
        self,
        where: str,
        nodes: Callable[[], str] = str,  # str() is ''
        failing: Callable[[float], object] = float,  # has no effect
        limit_sec: float = math.inf,
    ) -> None:
        self._where = where
        self.limit_sec = limit_sec
        self.nodes = nodes
        self._failing = failing
        self._waiting: Callable[[], str] = str
        self._hint: Callable[[], str] = str
        self._mutex = threading.Lock()
        self._failing_since: float | None = None
        """Monotonic time of the first failure since the last request that succeeded, s."""
        self._silent_since: float | None = None
        """Monotonic time of the first failure since the last answer or error of a server, s."""
        self._told: float | None = None
        """Monotonic time at which the outage was logged last, s."""
        self._stubborn_told = -REPEAT_SEC
        """Monotonic time at which a single failing request was logged last, s."""
        self._hurried: float | None = None
        """Monotonic time at which hurry was called, s."""
        self._heard = 0.0
        """Monotonic time of the last answer since hurry was called, s."""
        self.ended = 0
        """Number of outages that are over."""

    def tell_reason(self, hint: Callable[[], str]) -> None:
        """Add to log lines the reason that ``hint`` returns; '' = no reason is known."""
        self._hint = hint

    def tell_waiting(self, waiting: Callable[[], str]) -> None:
        """Add to log lines which messages wait for the store and how long they are kept.

        ``waiting`` returns that as text; '' = no message waits.
        """
        self._waiting = waiting

    def hurry(self) -> None:
        """End each wait in which no answer comes for HURRY_SEC, because the program has to end.

        A signal handler may call it.
        """
        self._hurried = time.monotonic()

    @property
    def left_sec(self) -> float:
        """How long to wait for one more answer, s; 0 or less = give up, inf = no hurry.

        Each answer restarts this time.
        """
        hurried = self._hurried
        if hurried is None:
            return math.inf
        return max(hurried, self._heard) + HURRY_SEC - time.monotonic()

    @property
    def seconds(self) -> float:
        """Time since the first failure after the last answer, s; 0 = none has failed since."""
        since = self._failing_since
        return 0.0 if since is None else time.monotonic() - since

    @property
    def is_current(self) -> bool:
        """Whether requests have failed for GRACE_SEC and none was answered, logged or not."""
        return self.seconds >= GRACE_SEC

    def failed(self, exc: BaseException, trying_sec: float) -> None:
        """Note that a request failed ``trying_sec`` seconds after its first attempt, and log it."""
        now = time.monotonic()
        with self._mutex:
            if self._failing_since is None:
                self._failing_since = now
            away = now - self._failing_since
            if is_answer(exc):
                self._silent_since = None
            elif self._silent_since is None:
                self._silent_since = now
            silent_sec = 0.0 if self._silent_since is None else now - self._silent_since
        self._failing(silent_sec)
        self._tell(exc, trying_sec, now, away)

    def _tell(self, exc: BaseException, trying_sec: float, now: float, away: float) -> None:
        """Log a failure if it is time to.

        Args:
            now: Monotonic time of the failure, s.
            away: Time for which no request was answered, s.
        """
        with self._mutex:
            first = self._told is None
            is_outage = away >= GRACE_SEC
            if is_outage and (first or now - (self._told or now) >= REPEAT_SEC):
                self._told = now
            elif first and trying_sec >= STUBBORN_SEC and now - self._stubborn_told >= REPEAT_SEC:
                self._stubborn_told = now
                is_outage = False
            else:
                return
        if not is_outage:
            _log.warning("a request fails and is tried again: %s", cause_of(exc, self.nodes()))
            return
        clock = time.strftime("%H:%M:%S", time.localtime(time.time() - away))
        cause = f"({cause_of(exc, self.nodes())})" if first else "still"
        # An error that a server sent is an answer: the server cannot do what it is asked.
        does = "fails all requests" if is_answer(exc) else "has not answered"
        text = "the store at %s " + does + " since %s %s%s"
        _log.warning(text, self._where, clock, cause, _appended(self._hint(), self._waiting()))

    def answered(self) -> None:
        """Note that a request was answered, and log the end of an outage.

        It is cheap while no request fails, because every answer calls it.
        """
        if self._hurried is not None:
            self._heard = time.monotonic()
        if self._failing_since is None:
            return
        with self._mutex:
            since, told_at = self._failing_since, self._told
            if self.is_current:
                self.ended += 1
            self._failing_since = self._silent_since = self._told = None
        if since is not None and told_at is not None:
            away = time.monotonic() - since
            text = "the store at %s answers again after %.0f s%s"
            _log.warning(text, self._where, away, _appended(self._waiting()))


def _appended(*texts: str) -> str:
    """Return texts as the end of a log line; empty ones are left out."""
    return "".join(f"; {text}" for text in texts if text)
