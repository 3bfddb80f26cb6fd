# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A limit of the bytes that are sent in a second."""

from __future__ import annotations

import threading
import time

from cassandra_ros.errors import InvalidOption


class Bandwidth:
    """Lets at most a number of bytes a second pass, for all threads together.

    Args:
        bytes_per_sec: The limit, above 0; None = no limit.
    """

    def __init__(self, bytes_per_sec: float | None) -> None:
        if bytes_per_sec is not None and not 0 < bytes_per_sec < float("inf"):
            raise InvalidOption(f"{bytes_per_sec!r} is no rate: give bytes a second above 0")
        self._rate = bytes_per_sec
        self._free = 0.0
        """Monotonic time from which the next bytes may be sent, s."""
        self._mutex = threading.Lock()
        self.sent_bytes = 0

    def sent(self, nbytes: int) -> None:
        """Wait until these bytes may be sent."""
        with self._mutex:
            self.sent_bytes += nbytes
            if self._rate is None:
                return
            now = time.monotonic()
            begin = max(now, self._free)
            self._free = begin + nbytes / self._rate
        time.sleep(max(0.0, begin - now))
