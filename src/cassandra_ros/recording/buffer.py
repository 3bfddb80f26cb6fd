# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The queue between callbacks and the writing thread, bounded in bytes."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any, NamedTuple

ITEM_BYTES = 300
"""What an item takes besides its message: small messages would else fill the memory unseen."""


class Item(NamedTuple):
    """One message on its way into the store."""

    source: Any
    """The Source over which it came."""
    t: int
    """Time of arrival, ns."""
    counter: int
    """Arrival order over all topics."""
    wire: bytes

    @property
    def nbytes(self) -> int:
        """What it counts for in the buffer."""
        return len(self.wire) + ITEM_BYTES


class Buffer:
    """First in, first out; when full the oldest is dropped, as in rosbag. Thread-safe.

    An item counts until it is released, so that also what was taken and still waits for its table
    is within the bound. One message is always accepted, whatever its size.

    Args:
        bound_bytes: 0 = no bound.
    """

    def __init__(self, bound_bytes: int) -> None:
        self._bound = bound_bytes or 2**63
        self._items: deque[Item] = deque()
        self._held = 0
        self._closed = False
        self._changed = threading.Condition()

    def put(self, item: Item) -> list[Item]:
        """Append an item; return what had to be dropped for it."""
        dropped: list[Item] = []
        with self._changed:
            self._items.append(item)
            self._held += item.nbytes
            while self._held > self._bound and len(self._items) > 1:
                dropped.append(self._items.popleft())
                self._held -= dropped[-1].nbytes
            if len(self._items) == 1:
                self._changed.notify()
        return dropped

    def take(self, most: int, most_bytes: int, timeout_sec: float) -> list[Item]:
        """Take the oldest items, at least one; [] after the timeout or a wake.

        Args:
            most: At most so many.
            most_bytes: No further one when these are reached.
            timeout_sec: How long to wait for the first.
        """
        taken: list[Item] = []
        nbytes = 0
        with self._changed:
            if not self._items:
                self._changed.wait(timeout_sec)
            while self._items and len(taken) < most and nbytes < most_bytes:
                item = self._items.popleft()
                nbytes += item.nbytes
                taken.append(item)
        return taken

    def release(self, item: Item) -> None:
        """Note that an item that was taken is no longer held in memory."""
        with self._changed:
            self._held -= item.nbytes

    def wake(self) -> None:
        """Let a waiting ``take`` return at once."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Note that nothing will be put any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def ended(self) -> bool:
        """Whether it is closed and everything was taken."""
        with self._changed:
            return self._closed and not self._items

    @property
    def held_bytes(self) -> int:
        """What the items take that were put and not released."""
        return self._held
