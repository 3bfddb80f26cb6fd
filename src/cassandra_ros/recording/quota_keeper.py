# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keeps the store of a recorder under a size while it records, on a thread of its own."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.stores.copying.quota import Quota, QuotaReport
from cassandra_ros.topics.catalog import Catalog

_log = logging.getLogger(__name__)

CONNECT_SEC = 1.0
"""Interval at which it is checked whether the store is connected, s."""
PERIOD_SEC = 30.0
"""Interval between two checks of the size, s. Each reads the directory of all topics."""


class QuotaKeeper:
    """Checks the size of the store from its start on, until it is stopped.

    Args:
        store: Future of the catalog of the connected keyspace.
        quota: The maximum size.
        period_sec: Interval between two checks, s.
    """

    def __init__(
        self, store: Future[Catalog], quota: Quota, period_sec: float = PERIOD_SEC
    ) -> None:
        self._store, self._quota, self._period_sec = store, quota, period_sec
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-quota", daemon=True)
        self._thread.start()

    @property
    def report(self) -> QuotaReport | None:
        """State after the last check; None = there was none."""
        return self._quota.report

    def stop(self, timeout_sec: float) -> None:
        """End it; wait at most ``timeout_sec`` for a deletion that goes on."""
        self._ending.set()
        self._thread.join(timeout_sec)

    def _run(self) -> None:
        """Check the size at intervals, once the store is connected."""
        pause_sec = 0.0
        while not self._ending.wait(pause_sec):
            if not is_there(self._store):
                pause_sec = CONNECT_SEC
                continue
            pause_sec = self._period_sec
            try:
                self._quota.keep(self._store.result())
            except CassandraRosError as exc:
                _log.warning("the store could not be kept under its maximum size now: %s", exc)
