# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C and SIGTERM at a moment of our choice: between two messages, not amid a write."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any, Dict

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class SafeInterrupt:
    """While it is entered, the first signal waits for check(); a second one acts at once."""

    def __init__(self) -> None:
        self._came: int | None = None
        self._handlers: Dict[int, Any] = {}

    def check(self) -> None:
        """Act on a signal that has come.

        Raises:
            KeyboardInterrupt: It was Ctrl-C.
            SystemExit: It was SIGTERM; with the status that a shell gives it.
        """
        if self._came == signal.SIGINT:
            raise KeyboardInterrupt
        if self._came is not None:
            raise SystemExit(128 + self._came)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._came = number
        self._restore()

    def _restore(self) -> None:
        while self._handlers:
            signal.signal(*self._handlers.popitem())

    def __enter__(self) -> SafeInterrupt:
        for number in _SIGNALS:
            self._handlers[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._restore()
        if kind is None:
            self.check()
