# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read a bag on a separate thread while the caller stores the messages that were read before.

Unpacking a chunk and packing a block both release Python's lock, so they run at the same time.
"""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType
from typing import Iterator, Optional

from cassandra_ros.bag.message_file import MessageBatch

AHEAD_BYTES = 8 * 1024 * 1024
"""Maximum size of the messages that wait for the caller, bytes. One batch may always wait."""


class ReadAhead:
    """An iterator over batches that a separate thread reads; a context manager that stops it.

    An error of the reading thread is raised after the last batch that was read before it.

    Args:
        batches: The batches to read. No other code may use their file until the context is left.
    """

    def __init__(self, batches: Iterator[MessageBatch]) -> None:
        self._batches = batches
        self._read: deque[tuple[MessageBatch, int]] = deque()
        self._held = 0
        self._ended = self._stopped = False
        self._error: Optional[BaseException] = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True, name="cassandra_ros-bag")

    def __enter__(self) -> ReadAhead:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: Optional[type[BaseException]],
        exc: Optional[BaseException],
        where: Optional[TracebackType],
    ) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()

    def __iter__(self) -> Iterator[tuple[MessageBatch, int]]:
        """Yield each batch and the size of its serialised messages, bytes."""
        while True:
            with self._changed:
                while not (self._read or self._ended):
                    self._changed.wait()
                if not self._read:
                    break
                batch, size = self._read.popleft()
                self._held -= size
                self._changed.notify_all()
            yield batch, size
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        error: Optional[BaseException] = None
        try:
            for batch in self._batches:
                if not self._put(batch):
                    break
        except BaseException as exc:  # noqa: BLE001 - __iter__ raises it again
            error = exc
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()

    def _put(self, batch: MessageBatch) -> bool:
        """Wait for room, then add a batch. Return False when the caller has left the context."""
        size = sum(map(len, batch.wires))
        with self._changed:
            while self._read and self._held + size > AHEAD_BYTES and not self._stopped:
                self._changed.wait()
            self._read.append((batch, size))
            self._held += size
            self._changed.notify_all()
            return not self._stopped
