# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reading of a stream ahead of its playing, on its own thread, within a budget of bytes."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from contextlib import suppress
from typing import Callable, Iterator

from cassandra_ros.errors import (
    CassandraRosError,
    ConnectionFailed,
    CorruptMessage,
    MessageNotFound,
    StoreUnavailable,
)
from cassandra_ros.playing.play_stream import PlayedMessage
from cassandra_ros.playing.played_store import PlayedRow

_log = logging.getLogger(__name__)


ITEM_BYTES = 1000
"""Measured memory of a message in addition to its bytes: a row without columns, bytes."""
REFILL_BYTES = 1024 * 1024
"""Room in the full budget at which reading goes on, bytes.

It is small because reading many messages at once would delay publishing.
"""
LARGE_MESSAGE_BYTES = 256 * 1024
"""Size from which a message is large, bytes."""
LARGE_SEC = 0.004
"""Pause of the reading thread after a large message while another one is being sent, s."""
RETRY_SEC = 1.0
"""Interval between two requests to a store that does not answer, s."""
GIVE_UP_SEC = 60.0
"""How long requests to a store that does not answer are repeated, s."""

OpenStream = Callable[[int], Iterator[PlayedMessage]]
"""Function that yields the messages from a time on, ns."""
OnSkip = Callable[[PlayedMessage, CassandraRosError], None]
"""Function that is called with a message that cannot be read, and the error."""


def keep_row(row: PlayedRow) -> int:
    """Read what is needed to publish a message, so that it needs no store when it is due.

    Returns:
        The size of the serialised message, bytes.

    Raises:
        CorruptMessage, MessageNotFound: It cannot be read.
        StoreUnavailable, ConnectionFailed: The store does not answer.
    """
    size = len(row.keep_wire())
    with suppress(CorruptMessage):  # without its header it is published, but not latched
        _ = row.connection
    return size


class ReadAhead:
    """A queue of messages from one time on, filled by a thread. A seek makes a new one.

    Args:
        begin: Yields the messages from a time on.
        t: First time, ns.
        budget_bytes: Maximum size of the messages that are read and not taken, bytes. One message
            may always be read.
        changed: Condition that is notified when an awaited message comes; its lock guards the
            queue.
        skipped: Called on the reading thread for each message that cannot be read.
    """

    def __init__(
        self,
        begin: OpenStream,
        t: int,
        budget_bytes: int,
        changed: threading.Condition,
        skipped: OnSkip,
    ) -> None:
        self._begin = begin
        self._budget = budget_bytes
        self._refill = min(REFILL_BYTES, budget_bytes // 2)
        self._changed = changed
        self._skipped = skipped
        self._items: deque[tuple[PlayedMessage, int]] = deque()
        """Messages that are read and not taken, each with its size, bytes."""
        self._held = 0
        self._full = False
        """Whether the reading thread waits, or is about to wait, for room."""
        self._room = threading.Event()
        """Set when there is room again, and by ``close``."""
        self._ended = False
        self._error: BaseException | None = None
        """Error that ended the reading; raised after the last message was taken."""
        self._closed = threading.Event()
        self._wanted = False
        """Whether a thread waits for the next message: only then it is notified."""
        threading.Thread(target=self._run, args=(t,), daemon=True, name="read ahead").start()

    @property
    def held_bytes(self) -> int:
        """Size of the messages that are read and not taken, bytes."""
        return self._held

    def await_next(self, timeout_sec: float) -> bool:
        """Wait until ``next_message`` has an answer; the caller holds the lock of ``changed``.

        Returns:
            False if the wait ended without one: by a notification or after ``timeout_sec``.
        """
        if not (self._items or self._ended):
            self._wanted = True
            self._changed.wait(timeout_sec)
            self._wanted = False
        return bool(self._items or self._ended)

    def next_message(self) -> PlayedMessage | None:
        """Return the next message, after ``await_next`` and under its lock; None = the end.

        Raises:
            CassandraRosError: The error that ended the reading.
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
        """End the reading, without waiting for a slow store."""
        self._closed.set()
        self._room.set()

    def _run(self, t: int) -> None:
        """Read to the end, on the thread; keep the error for ``next_message``."""
        error: BaseException | None = None
        try:
            self._read(t)
        except BaseException as exc:  # noqa: BLE001 - raised again in next_message
            error = exc
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()

    def _read(self, t: int) -> None:
        """Read to the end; after an outage of the store go on after the last message."""
        ends = 0.0  # when the retries end, monotonic clock, s; 0 = the store answers
        # Time by position of the read messages that would come again from t on. Times would not
        # do: messages latched in a gap have the time at which the next window begins.
        same: dict[tuple[int, str, int, str], int] = {}
        before: PlayedMessage | None = None
        while not self._closed.is_set():
            rows = self._begin(t)
            try:
                for played in rows:
                    if played.row.arrival in same:
                        continue
                    if not self._put(played):
                        return
                    # Messages latched in a gap come only when reading begins before their window.
                    since = t
                    if played.t != played.window.low:
                        since = played.t
                    elif before is not None and before.window.low != played.window.low:
                        since = before.t
                    if t < since:
                        t = since
                        same = {row: at for row, at in same.items() if at >= t}
                    same[played.row.arrival] = played.t
                    before, ends = played, 0.0
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

    def _put(self, played: PlayedMessage) -> bool:
        """Append a message and wait while the budget is used up; return False after close()."""
        try:
            # Decoded here instead of when it is due; columns may take several times the memory.
            size = keep_row(played.row) + ITEM_BYTES
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
            if size >= LARGE_MESSAGE_BYTES:
                # The message taken to make room is being sent: leave the processor to it.
                self._closed.wait(LARGE_SEC)
        return not self._closed.is_set()
