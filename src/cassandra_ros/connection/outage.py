# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Since when a store does not answer: told once, then each minute, and when it is over."""

from __future__ import annotations

import logging
import math
import threading
import time
from typing import Callable

from cassandra_ros.connection.driver_errors import cause_of, is_answer

_log = logging.getLogger(__name__)

GRACE_SEC = 2.0
"""A store that answers nothing for so long is away; what is shorter passes without a word."""
STUBBORN_SEC = 10.0
"""A request that fails for so long is told, also where others are answered."""
REPEAT_SEC = 60.0
HURRY_SEC = 1.5
"""How long a program that is to end waits for an answer, from the last one on, s."""


class Outage:
    """Hears which requests of a connection fail and which are answered. Thread-safe.

    Args:
        where: The hosts, for people.

    Attributes:
        waiting: Returns what waits for the store and how long it is kept, for the lines that tell
            of an outage; '' = nothing to be said. Whoever keeps something sets it.
        hint: Returns what else is known of the reason; as above.
        nodes: Returns which nodes of several answer and which do not; '' = all or none do.
        failing: Called with each failure, and how long requests have failed without one that a
            server answered, be it with an error, s; it must not block.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self.waiting: Callable[[], str] = str
        self.hint: Callable[[], str] = str
        self.nodes: Callable[[], str] = str
        self.failing: Callable[[float], object] = float
        self._mutex = threading.Lock()
        self._failing_since: float | None = None
        """When the first request failed since the last one was answered; monotonic."""
        self._silent_since: float | None = None
        """When the first one failed since a server sent its last answer or error; monotonic."""
        self._told: float | None = None
        """When the outage was told of last."""
        self._grumbled = -REPEAT_SEC
        self._hurried: float | None = None
        """When waits were told to end; monotonic."""
        self._heard = 0.0
        """When a request was answered last, since then; monotonic."""

    def hurry(self) -> None:
        """Let each wait end in which nothing is answered for HURRY_SEC: the program is to end.

        A signal handler may call it.
        """
        self._hurried = time.monotonic()

    @property
    def left_sec(self) -> float:
        """How long one more answer may be waited for, s; inf = as long as each wait says."""
        hurried = self._hurried
        if hurried is None:
            return math.inf
        return max(hurried, self._heard) + HURRY_SEC - time.monotonic()

    @property
    def seconds(self) -> float:
        """How long the store has been away, s; 0 = it is there."""
        since = self._failing_since
        return 0.0 if since is None or self._told is None else time.monotonic() - since

    def failed(self, exc: BaseException, trying_sec: float) -> None:
        """Note that a request failed that is tried again, and has been for so many seconds."""
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
        self.failing(silent_sec)
        self._tell(exc, trying_sec, now, away)

    def _tell(self, exc: BaseException, trying_sec: float, now: float, away: float) -> None:
        with self._mutex:
            first = self._told is None
            if away >= GRACE_SEC and (first or now - (self._told or now) >= REPEAT_SEC):
                self._told = now
            elif first and trying_sec >= STUBBORN_SEC and now - self._grumbled >= REPEAT_SEC:
                self._grumbled, away = now, 0.0
            else:
                return
        if not away:
            _log.warning("a request fails and is tried again: %s", cause_of(exc, self.nodes()))
            return
        clock = time.strftime("%H:%M:%S", time.localtime(time.time() - away))
        cause = f"({cause_of(exc, self.nodes())})" if first else "still"
        # An error that a server sent is an answer: it cannot do what is asked.
        does = "fails all requests" if is_answer(exc) else "has not answered"
        text = "the store at %s " + does + " since %s %s%s"
        _log.warning(text, self._where, clock, cause, _rest(self.hint(), self.waiting()))

    def answered(self) -> None:
        """Note that a request was answered; cheap while all are."""
        if self._hurried is not None:
            self._heard = time.monotonic()
        if self._failing_since is None:
            return
        with self._mutex:
            since, told = self._failing_since, self._told
            self._failing_since = self._silent_since = self._told = None
        if since is not None and told is not None:
            away = time.monotonic() - since
            text = "the store at %s answers again after %.0f s%s"
            _log.warning(text, self._where, away, _rest(self.waiting()))


def _rest(*texts: str) -> str:
    return "".join(f"; {text}" for text in texts if text)
