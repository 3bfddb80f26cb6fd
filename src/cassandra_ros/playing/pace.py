# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The clock of a replay: its time, its rate, and the reasons for which it stands."""

from __future__ import annotations

import math
import threading
import time
from typing import Callable, NamedTuple

from cassandra_ros.errors import InvalidOption

MAX_RATE = 1e6
"""Maximum factor of speed."""


class _State(NamedTuple):
    """The state of a clock, replaced as a whole, so that it can be read without the lock."""

    at: int
    """Reading of the monotonic clock at which the time of the replay was ``t``, ns."""
    t: int
    """Time of the replay, ns."""
    rate: float
    holds: frozenset[str]
    """Reasons for which the clock stands; empty = it runs."""


class Pace:
    """The clock of a replay, driven by the monotonic clock. Thread-safe; no method waits.

    Args:
        t: First time, ns. The clock stands there until ``BEGIN`` is released.
        rate: Factor of speed.
        clock: Returns the monotonic clock, ns.
    """

    BEGIN = "begin"
    """Reason for which a new clock stands."""

    def __init__(
        self, t: int, rate: float = 1.0, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._state = _State(clock(), t, check_rate(rate), frozenset((self.BEGIN,)))

    @property
    def rate(self) -> float:
        """Factor of speed: 2.0 is twice as fast as recorded."""
        return self._state.rate

    def now(self) -> int:
        """Return the time of the replay, ns."""
        return self._at(self._state, self._clock())

    def holds(self, reason: str) -> bool:
        """Return whether the clock stands for this reason, alone or among others."""
        return reason in self._state.holds

    def due_in(self, t: int) -> float | None:
        """Return the wall time until ``t``, s; 0 or less after ``t``, None if the clock stands."""
        state, clock = self._state, self._clock()
        if state.holds:
            return None
        return (state.at - clock + (t - state.t) / state.rate) / 1e9

    def jump(self, t: int) -> None:
        """Set the time to ``t``; a clock that stands goes on standing."""
        with self._lock:
            self._state = self._state._replace(at=self._clock(), t=t)

    def set_rate(self, rate: float) -> None:
        """Change the rate from now on.

        Raises:
            InvalidOption: The rate is not above 0 and at most MAX_RATE.
        """
        self._change(rate=check_rate(rate))

    def hold(self, reason: str) -> None:
        """Stop the clock until every reason is released."""
        self._change(add=reason)

    def release(self, reason: str) -> None:
        """Remove a reason; one for which the clock does not stand is ignored."""
        self._change(remove=reason)

    def _change(
        self, rate: float | None = None, add: str | None = None, remove: str | None = None
    ) -> None:
        """Change the rate, and add or remove a reason to stand; the time of the replay stays."""
        with self._lock:
            state, clock = self._state, self._clock()
            holds = (state.holds | ({add} if add else set())) - ({remove} if remove else set())
            t = self._at(state, clock)
            self._state = _State(clock, t, state.rate if rate is None else rate, holds)

    @staticmethod
    def _at(state: _State, clock: int) -> int:
        """Return the time of the replay at a reading of the monotonic clock, both ns."""
        if state.holds:
            return state.t
        return state.t + int((clock - state.at) * state.rate)


def check_rate(rate: float) -> float:
    """Return a factor of speed, above 0 and at most MAX_RATE, or raise InvalidOption."""
    number = isinstance(rate, (int, float)) and not isinstance(rate, bool)
    if number and math.isfinite(rate) and 0 < rate <= MAX_RATE:
        return float(rate)
    raise InvalidOption(
        f"rate={rate!r:.80} is not a factor of speed: give more than 0, up to {MAX_RATE:.0f}; "
        "1.0 is as recorded, 2.0 twice as fast"
    )
