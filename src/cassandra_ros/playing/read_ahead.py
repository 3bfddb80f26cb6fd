# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reads a stream ahead of its time, on a thread of its own, within a budget of bytes."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Callable, Iterator, Optional

from cassandra_ros.errors import (
    CassandraRosError,
    ConnectionFailed,
    CorruptMessage,
    MessageNotFound,
    StoreUnavailable,
)
from cassandra_ros.playing.stream import Played

_log = logging.getLogger(__name__)


ITEM_BYTES = 1000
"""What a message takes besides its bytes: a row without its columns, measured."""
REFILL_BYTES = 1024 * 1024
"""When so much was taken reading goes on: in small steps, for it slows down what is published."""
LARGE_BYTES = 256 * 1024
LARGE_SEC = 0.004
"""How long the reading of a large message waits for the sending of another, where there is time."""
RETRY_SEC = 1.0
GIVE_UP_SEC = 60.0
"""How long a store that does not answer is asked again."""

Open = Callable[[int], Iterator[Played]]
"""Begins to read at a time, ns."""
Skipped = Callable[[Played, CassandraRosError], None]
"""Called with a message that cannot be read, and why."""


class ReadAhead:
    """The messages from one time on. A seek takes a new one.

    Args:
        begin: Begins to read.
        t: Where, ns.
        budget_bytes: How much may be read and not taken; one message always may.
        changed: Notified when something came that is waited for; its lock guards all.
        skipped: Called, on the reading thread, for what cannot be read.
    """

    def __init__(
        self,
        begin: Open,
        t: int,
        budget_bytes: int,
        changed: threading.Condition,
        skipped: Skipped,
    ) -> None:
        self._begin = begin
        self._budget = budget_bytes
        self._refill = min(REFILL_BYTES, budget_bytes // 2)
        self._changed = changed
        self._skipped = skipped
        self._items: deque[tuple[Played, int]] = deque()
        self._held = 0
        self._full = False
        self._room = threading.Event()
        self._ended = False
        self._error: Optional[BaseException] = None
        self._closed = threading.Event()
        self._wanted = False
        threading.Thread(target=self._run, args=(t,), daemon=True, name="read ahead").start()

    @property
    def held_bytes(self) -> int:
        """How many bytes are read and not taken."""
        return self._held

    def await_next(self, timeout_sec: float) -> bool:
        """Wait, under the lock of ``changed``, for ``take``; False: it was woken, or waited."""
        if not (self._items or self._ended):
            self._wanted = True
            self._changed.wait(timeout_sec)
            self._wanted = False
        return bool(self._items or self._ended)

    def take(self) -> Optional[Played]:
        """Return the next message, after ``await_next`` and under its lock; None = there is none.

        Raises:
            CassandraRosError: What ended the reading.
        """
        if self._items:
            played, size = self._items.popleft()
            self._held -= size
            if self._full and self._held <= self._budget - self._refill:
                self._full = False
                self._room.set()
            return played
        if self._error is not None:
            raise self._error
        return None

    def close(self) -> None:
        """Read no more. Does not wait for a store that is slow."""
        self._closed.set()
        self._room.set()

    def _run(self, t: int) -> None:
        error: Optional[BaseException] = None
        try:
            self._read(t)
        except BaseException as exc:  # noqa: BLE001 - raised by who takes
            error = exc
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()

    def _read(self, t: int) -> None:
        """Read to the end; begin again behind the last message where the store was away."""
        ends = 0.0  # when it is given up
        # Messages that are read of those that come again from t on. By their places, for what was
        # latched in a gap has the time at which the window behind it begins, as others may.
        same: set[tuple[int, str, int, str]] = set()
        while not self._closed.is_set():
            rows = self._begin(t)
            try:
                for played in rows:
                    if played.row.arrival in same:
                        continue
                    if not self._put(played):
                        return
                    # What was latched in a gap comes only to who begins before its window.
                    if t < played.t and played.t != played.window.low:
                        same.clear()
                        t = played.t
                    same.add(played.row.arrival)
                    ends = 0.0
                return
            except (StoreUnavailable, ConnectionFailed) as exc:
                now = time.monotonic()
                ends = ends or now + GIVE_UP_SEC
                if now >= ends or self._closed.is_set():
                    raise
                _log.warning("the store does not answer, the replay waits for it: %s", exc)
                self._closed.wait(RETRY_SEC)
            finally:
                close = getattr(rows, "close", None)
                if close is not None:
                    close()

    def _put(self, played: Played) -> bool:
        """Keep a message; wait while the budget is used up. False: nobody wants it any more."""
        try:
            # Decoded here, not when it is due; the columns may take several times as much.
            size = len(played.row.keep_wire()) + ITEM_BYTES
        except (CorruptMessage, MessageNotFound) as exc:
            self._skipped(played, exc)
            return not self._closed.is_set()
        with self._changed:
            self._items.append((played, size))
            self._held += size
            if self._wanted:
                self._changed.notify_all()
            self._full = self._held > self._budget
            if self._full:
                self._room.clear()
        if self._full and not self._closed.is_set():  # ``close`` may have come before ``clear``
            self._room.wait()
            if size >= LARGE_BYTES:
                # What was taken for this is being sent: it needs the machine now.
                self._closed.wait(LARGE_SEC)
        return not self._closed.is_set()
