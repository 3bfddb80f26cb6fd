# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Since when a store does not answer: told once, then each minute, and when it is over."""

from __future__ import annotations

import logging
import threading
import time
from typing import Callable

from cassandra_ros.store.driver_errors import cause_of

_log = logging.getLogger(__name__)

GRACE_SEC = 2.0
"""A store that answers nothing for so long is away; what is shorter passes without a word."""
STUBBORN_SEC = 10.0
"""A request that fails for so long is told, also where others are answered."""
REPEAT_SEC = 60.0


class Outage:
    """Hears which requests of a connection fail and which are answered. Thread-safe.

    Args:
        where: The hosts, for people.

    Attributes:
        waiting: Returns what waits for the store and how long it is kept, for the lines that tell
            of an outage; '' = nothing to be said. Whoever keeps something sets it.
        hint: Returns what else is known of the reason; as above.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self.waiting: Callable[[], str] = str
        self.hint: Callable[[], str] = str
        self._mutex = threading.Lock()
        self._failing_since: float | None = None
        """When the first request failed since the last one was answered; monotonic."""
        self._told: float | None = None
        """When the outage was told of last."""
        self._grumbled = -REPEAT_SEC

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
            away, first = now - self._failing_since, self._told is None
            if away >= GRACE_SEC and (first or now - (self._told or now) >= REPEAT_SEC):
                self._told = now
            elif first and trying_sec >= STUBBORN_SEC and now - self._grumbled >= REPEAT_SEC:
                self._grumbled, away = now, 0.0
            else:
                return
        if not away:
            _log.warning("a request fails and is tried again: %s", cause_of(exc))
            return
        clock = time.strftime("%H:%M:%S", time.localtime(time.time() - away))
        cause = f"({cause_of(exc)})" if first else "still"
        text = "the store at %s has not answered since %s %s%s"
        _log.warning(text, self._where, clock, cause, _rest(self.hint(), self.waiting()))

    def answered(self) -> None:
        """Note that a request was answered; cheap while all are."""
        if self._failing_since is None:
            return
        with self._mutex:
            since, told = self._failing_since, self._told
            self._failing_since = self._told = None
        if since is not None and told is not None:
            away = time.monotonic() - since
            text = "the store at %s answers again after %.0f s%s"
            _log.warning(text, self._where, away, _rest(self.waiting()))


def _rest(*texts: str) -> str:
    return "".join(f"; {text}" for text in texts if text)
