# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C and SIGTERM of verbs that may write: they end the verb between two writes."""

from __future__ import annotations

import signal
from types import FrameType
from typing import TYPE_CHECKING, Callable

from cassandra_ros.errors import CassandraRosError

if TYPE_CHECKING:
    from cassandra_ros.store.connection.outage import Outage

LOOK_SEC = 0.2
"""Interval at which an interrupted verb checks whether the store still answers, s."""


class SafeInterrupt:
    """A context manager that delays Ctrl-C and SIGTERM, so that they do not interrupt a write.

    Inside the context the first signal takes effect at the next check(), or when the store has not
    answered for a moment. A second signal takes effect at once.

    Args:
        outage: The outage of the store; the first signal ends its waits.
    """

    def __init__(self, outage: Outage) -> None:
        self._outage = outage
        self._came: int | None = None
        self._handlers: dict[int, signal._HANDLER] = {}
        self._alarm: signal._HANDLER = None

    def check(self) -> None:
        """Raise KeyboardInterrupt after Ctrl-C, SystemExit with status 143 after SIGTERM."""
        if self._came is not None:
            self._quiet()  # the alarm must not interrupt what follows
        if self._came == signal.SIGINT:
            raise KeyboardInterrupt
        if self._came is not None:
            raise SystemExit(128 + self._came)

    def after(self, progress: Callable[[int, int], None]) -> Callable[[int, int], None]:
        """Return a function that calls ``progress``, and then ``check``."""

        def progress_and_check(done: int, total: int) -> None:
            progress(done, total)
            self.check()

        return progress_and_check

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._came = number
        self._restore()
        self._outage.hurry()
        self._alarm = signal.signal(signal.SIGALRM, self._look)
        signal.setitimer(signal.ITIMER_REAL, LOOK_SEC, LOOK_SEC)

    def _look(self, number: int, frame: FrameType | None) -> None:
        if self._outage.left_sec <= 0:
            self.check()

    def _quiet(self) -> None:
        if self._alarm is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, self._alarm)
            self._alarm = None

    def _restore(self) -> None:
        while self._handlers:
            signal.signal(*self._handlers.popitem())

    def __enter__(self) -> SafeInterrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._handlers[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._restore()
        self._quiet()
        # After a signal an error of the store only says that its waits were ended.
        if kind is None or issubclass(kind, CassandraRosError):
            self.check()
