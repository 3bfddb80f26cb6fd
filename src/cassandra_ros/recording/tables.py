# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tables for new topics, made on a thread of their own: that takes 0.1 to 1.2 s each."""

from __future__ import annotations

import logging
import queue
import threading
import time
from typing import Callable, Optional

from cassandra_ros.errors import CassandraRosError, SchemaConflict, StoreUnavailable
from cassandra_ros.recording.source import Source

_log = logging.getLogger(__name__)

PAUSE_SEC = 1.0
MAX_CONFLICTS = 5
"""A schema lock may be held by others for a while; a table of another kind stays one."""
LAST_TRIES_SEC = 20.0
"""How long a store that does not answer is waited for when the recorder ends."""

Connect = Callable[[Source, int], object]


class TableMaker:
    """Gives sources their handles, one after the other.

    Args:
        connect: Makes a source's handle, given the source and a bucket length, ns.
        done: Called on the thread when a source got its handle or error.
    """

    def __init__(self, connect: Connect, done: Callable[[], None]) -> None:
        self._connect = connect
        self._done = done
        self._asked: queue.Queue[Optional[Source]] = queue.Queue()
        self._finished: queue.Queue[Source] = queue.Queue()
        self._conflicts: dict[Source, int] = {}
        self._deadline: Optional[float] = None
        self._thread = threading.Thread(target=self._run, name="recorder-tables", daemon=True)
        self._thread.start()

    def submit(self, source: Source) -> None:
        """Ask for the handle of a source."""
        source.submitted = True
        self._asked.put(source)

    def finished(self) -> list[Source]:
        """Return the sources that got a handle or an error since the last call."""
        found: list[Source] = []
        while not self._finished.empty():
            found.append(self._finished.get())
        return found

    def hurry(self) -> None:
        """Note that the recorder ends: a store that is gone is not waited for much longer."""
        if self._deadline is None:
            self._deadline = time.monotonic() + LAST_TRIES_SEC

    def close(self) -> None:
        """End the thread when it has done what was asked."""
        self._asked.put(None)
        self._thread.join()

    def _run(self) -> None:
        while True:
            source = self._asked.get()
            if source is None:
                return
            if self._try(source):
                self._finished.put(source)
                self._done()
            else:
                time.sleep(PAUSE_SEC)
                self._asked.put(source)

    def _try(self, source: Source) -> bool:
        """Return whether it is decided what becomes of a source."""
        try:
            source.handle = self._connect(source, source.bucketLength())
        except (StoreUnavailable, SchemaConflict) as exc:
            if self._again(source, exc):
                return False
            source.error = str(exc)
        except CassandraRosError as exc:
            source.error = str(exc)
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("the table of topic %s could not be made", source.topic)
            source.error = f"internal error: {type(exc).__name__}: {exc}"
        if source.error:
            _log.error("topic %s cannot be recorded: %s", source.topic, source.error)
        return True

    def _again(self, source: Source, exc: CassandraRosError) -> bool:
        if isinstance(exc, SchemaConflict):
            self._conflicts[source] = self._conflicts.get(source, 0) + 1
            if self._conflicts[source] >= MAX_CONFLICTS:
                return False
        if self._deadline is not None and time.monotonic() > self._deadline:
            return False
        _log.warning("topic %s waits for its table: %s", source.topic, exc)
        return True
