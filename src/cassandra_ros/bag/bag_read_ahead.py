# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reads a bag on a thread of its own, some messages ahead of who stores them.

Neither unpacking a chunk nor packing a block holds Python's lock for long: they go on side by side.
"""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType
from typing import Iterator, Optional

from cassandra_ros.bag.message_file import MessageBatch

AHEAD_BYTES = 8 * 1024 * 1024
"""Of messages that are read and not taken; one batch always may be."""


class ReadAhead:
    """Stretches in the order in which they are read; a context manager, which ends the reading.

    What the reading raises is raised where the next batch would come.

    Args:
        batches: Nobody else uses the file that they are read from until this has ended.
    """

    def __init__(self, batches: Iterator[MessageBatch]) -> None:
        self._batches = batches
        self._read: deque[tuple[MessageBatch, int]] = deque()
        self._held = 0
        self._ended = self._unwanted = False
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
            self._unwanted = True
            self._changed.notify_all()
        self._thread.join()

    def __iter__(self) -> Iterator[tuple[MessageBatch, int]]:
        """Yield each batch, and its serialised bytes."""
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
        except BaseException as exc:  # noqa: BLE001 - raised by who takes
            error = exc
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()

    def _put(self, batch: MessageBatch) -> bool:
        """Keep a batch, as soon as there is room; False: nobody wants it any more."""
        size = sum(map(len, batch.wires))
        with self._changed:
            while self._read and self._held + size > AHEAD_BYTES and not self._unwanted:
                self._changed.wait()
            self._read.append((batch, size))
            self._held += size
            self._changed.notify_all()
            return not self._unwanted
