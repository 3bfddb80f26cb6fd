# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read single key presses from the terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
from typing import Any


class Keyboard:
    """Reads single key presses, if standard input is a terminal and this is a foreground process.

    A context manager; on exit it restores the settings of the terminal.
    """

    def __init__(self) -> None:
        self._fd = -1
        self._before: list[Any] | None = None

    @property
    def is_there(self) -> bool:
        """Whether keys can be read."""
        return self._before is not None

    def __enter__(self) -> Keyboard:
        try:
            self._fd = sys.stdin.fileno()
            # A background process is stopped when it changes the terminal.
            if os.isatty(self._fd) and os.tcgetpgrp(self._fd) == os.getpgrp():
                self._before = termios.tcgetattr(self._fd)
                settings = termios.tcgetattr(self._fd)
                settings[3] &= ~(termios.ICANON | termios.ECHO)
                settings[6][termios.VMIN], settings[6][termios.VTIME] = 0, 0
                termios.tcsetattr(self._fd, termios.TCSANOW, settings)
        except (OSError, ValueError, AttributeError, termios.error):
            self._before = None  # standard input is closed or cannot be changed
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._before is not None:
            before, self._before = self._before, None
            try:
                termios.tcsetattr(self._fd, termios.TCSANOW, before)
            except termios.error:
                pass  # the terminal is gone

    def pressed(self) -> str:
        """Return the keys that were pressed since the last call."""
        if self._before is None or not select.select([self._fd], [], [], 0)[0]:
            return ""
        try:
            return os.read(self._fd, 64).decode("utf-8", "replace")
        except OSError:
            self._before = None  # the terminal is gone
            return ""
