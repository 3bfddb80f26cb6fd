# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events of a recorder on their way to the store, which may not answer for a while."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future

from cassandra_ros.errors import CassandraRosError, StoreUnavailable
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.topics.catalog import Catalog

_log = logging.getLogger(__name__)

RETRY_SEC = 1.0
"""Interval between two attempts to store events while the store does not answer, s."""
END_SEC = 10.0
"""Maximum time that the end of a recorder waits for its last events, s."""
MAX_WAITING = 10_000
"""Maximum number of events that wait for the store."""


class EventWriter:
    """Stores events in the background, the latest state of each. Thread-safe.

    Args:
        store: Future of the catalog of the connected keyspace.
    """

    def __init__(self, store: Future[Catalog]) -> None:
        self._store = store
        self._waiting: dict[str, Event] = {}
        """The events to be stored, by key."""
        self._lost = 0
        """Number of events that were not taken because MAX_WAITING waited."""
        self._ending = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def put(self, event: Event) -> None:
        """Take an event, or its later state, without waiting for the store."""
        with self._changed:
            if event.key not in self._waiting and len(self._waiting) >= MAX_WAITING:
                self._lost += 1
                return
            self._waiting[event.key] = event
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="events", daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> None:
        """Store the remaining events, for at most END_SEC, and say which are lost."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(END_SEC)
        with self._changed:
            events, self._waiting = self._waiting, {}  # so that the thread ends
        if events or self._lost:
            names = ", ".join(sorted({event.name for event in events.values()}))
            _log.error(
                "%d events are not stored, for the store did not take them: %s",
                len(events) + self._lost,
                names or "more than wait in memory",
            )

    def _run(self) -> None:
        """Store the waiting events one by one, until none waits after ``close``."""
        while True:
            with self._changed:
                while not (self._waiting or self._ending):
                    self._changed.wait()
                if not self._waiting:
                    return
                event = next(iter(self._waiting.values()))
            if not self._store_event(event):
                with self._changed:
                    self._changed.wait(RETRY_SEC)
                continue
            with self._changed:
                if self._waiting.get(event.key) is event:  # else its end has come meanwhile
                    del self._waiting[event.key]

    def _store_event(self, event: Event) -> bool:
        """Store an event; return False if it is to be tried again.

        One that the store refuses is logged and not tried again.
        """
        if not is_there(self._store):
            return False
        try:
            self._store.result().keyspace.events.put(event)
        except StoreUnavailable as exc:
            _log.debug("event %s is stored later: %s", event.name, exc)
            return False
        except CassandraRosError as exc:
            _log.error("event %s is not stored: %s", event.name, exc)
        return True
