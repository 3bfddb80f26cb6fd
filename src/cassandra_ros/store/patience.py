# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How long a failed request is asked again, and how often."""

from __future__ import annotations

import logging
import time

from cassandra_ros.store.driver_errors import isBusy, isPassing, translate

_log = logging.getLogger(__name__)

RETRY_SEC = 30.0
BUSY_PAUSE_SEC = 0.002
FIRST_PAUSE_SEC = 0.1
LAST_PAUSE_SEC = 5.0


class Patience:
    """Counts the tries of one idempotent request.

    Args:
        what: What is being done, for log and error.
        seconds: How long it may be asked again.
    """

    def __init__(self, what: str, seconds: float = RETRY_SEC) -> None:
        self._what = what
        self._deadline = time.monotonic() + seconds
        self._pause = FIRST_PAUSE_SEC

    def wait(self, exc: BaseException) -> None:
        """Sleep before the next try.

        Raises:
            CassandraRosError: Another try cannot help, or the time is up.
        """
        pause = BUSY_PAUSE_SEC if isBusy(exc) else self._pause
        if not isPassing(exc) or time.monotonic() + pause > self._deadline:
            raise translate(exc, self._what) from exc
        if not isBusy(exc):
            _log.warning("%s: %s; trying again", self._what, exc)
            self._pause = min(2 * self._pause, LAST_PAUSE_SEC)
        time.sleep(pause)
