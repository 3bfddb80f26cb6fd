# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What other processes have left in the spool: taken up by a recorder."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Callable

from cassandra_ros.errors import CassandraRosError, SpoolError
from cassandra_ros.files.spool.spool_folder import RunFolder
from cassandra_ros.recording.recorder_options import SpoolPlan
from cassandra_ros.recording.spool_drain import Drain, Drained, LeftRun, read_left
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.topics.catalog import Catalog

_log = logging.getLogger(__name__)

POLL_SEC = 0.2
"""Interval at which it is checked whether the store is there, or the recorder ends, s."""
LOOK_SEC = 10.0
"""Interval at which it is checked whether another process has left a run, s."""
RETRY_SEC = 5.0
"""Pause after a drain has failed, s."""
MAX_TRIES = 3
"""Maximum number of times in a row that a drain that fails is tried; then other runs come first."""


class LeftRuns:
    """Drains the runs in the spool that belong to a keyspace and have no process, on a thread.

    Args:
        store: Future of the catalog of the connected keyspace.
        plan: The spool, the keyspace and the address of the store.
        say: Prints a line for the user.
    """

    def __init__(self, store: Future[Catalog], plan: SpoolPlan, say: Callable[[str], None]) -> None:
        self._store, self._plan, self._say = store, plan, say
        self._stopped = threading.Event()
        self._drain: Drain | None = None
        """Drain that runs, or ran last; ``stop`` ends it."""
        self._told: set[Path] = set()
        """Folders of runs that stay and that this object does not try again; it was logged why."""
        self._thread = threading.Thread(target=self._run, name="recorder-left", daemon=True)
        self._thread.start()

    def stop(self, timeout_sec: float) -> None:
        """End it; what is not stored by then stays in the spool."""
        self._stopped.set()
        drain = self._drain
        if drain is not None:
            drain.stop()
        self._thread.join(timeout_sec)

    def _run(self) -> None:
        """Drain what is there, then look each LOOK_SEC for what other processes have left."""
        try:
            while not self._stopped.is_set():
                for folder in self._plan.folder.left():
                    try:
                        self._take_up(folder)
                    finally:
                        folder.release()
                    if self._stopped.is_set():
                        return
                self._stopped.wait(LOOK_SEC)
        except Exception:  # noqa: BLE001 - our mistake: the recording goes on, and the files stay
            _log.exception("the spool %s could not be drained", self._plan.folder.path)

    def _take_up(self, folder: RunFolder) -> None:
        """Drain a run whose folder this process has locked, or log why it stays."""
        if folder.path in self._told:
            return
        if folder.is_empty():  # killed before its first message
            try:
                folder.remove()
            except SpoolError as exc:
                _log.warning("an empty run stays in the spool: %s", exc)
                self._told.add(folder.path)
            return
        left_run = read_left(folder)
        problem = left_run.problem or self._foreign(left_run)
        if problem:
            _log.warning("run %s stays in the spool %s: %s", left_run.name, folder.path, problem)
            self._told.add(folder.path)
            return
        while not self._stopped.is_set() and not self._store.done():
            wait([self._store], POLL_SEC)
        for _ in range(MAX_TRIES):
            if self._stopped.is_set() or not is_there(self._store):
                return
            try:
                drain = self._drain = Drain(self._store.result(), left_run)
                done = drain.run()
                for text in lines_of(done):
                    self._say(text)
                if done.stays:  # the next recorder tries again
                    self._told.add(folder.path)
                return
            except CassandraRosError as exc:
                _log.warning("run %s stays in the spool for now: %s", left_run.name, exc)
                self._stopped.wait(RETRY_SEC)

    def _foreign(self, left_run: LeftRun) -> str:
        """Return that a run belongs to another store, as text; '' = it belongs to this one."""
        label, plan = left_run.label, self._plan
        if label is None or (label.keyspace, label.address) == (plan.keyspace, plan.address):
            return ""
        return (
            f"it belongs to keyspace {label.keyspace or '?'} at {label.address or '?'}; store it "
            f"with: cassandra_bag spool drain {left_run.folder.path.name}, or "
            "delete it with: spool drop"
        )


def lines_of(done: Drained) -> list[str]:
    """Return what a drain did, as lines for the user."""
    lines = [f"run {done.run}: {done.messages} messages of the spool are stored"]
    lost = sum(done.lost.values())
    if lost or done.lost:
        lines.append(f"run {done.run}: {lost or 'some'} messages of the spool are lost")
    for topic, reason in done.stays.items():
        lines.append(f"run {done.run}: messages of topic {topic} stay in the spool: {reason}")
    if not (done.complete or done.stays):
        lines.append(f"run {done.run}: the rest stays in the spool")
    return lines
