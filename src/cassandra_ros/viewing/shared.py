# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What calls of a viewer have in common: the store, the settings, and what is kept for more."""

from __future__ import annotations

import threading
from typing import Callable, TypeVar, cast

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.viewing.viewer_settings import ViewerSettings

T = TypeVar("T")
_KEPT_KEYSPACES = 8
"""Maximum number of keyspaces beside the viewer's own whose caches are kept."""


class Shared:
    """The store and the settings of one viewer, and the caches made for it. Safe between threads.

    Each further keyspace that is asked for has one of these, which the one of the viewer keeps.

    Args:
        store: Stays the caller's to close.
        settings: What the viewer was started with.
    """

    def __init__(self, store: RosCassandra, settings: ViewerSettings) -> None:
        self.store = store
        self.settings = settings
        self._others: dict[str, Shared] = {}
        """By keyspace; the one that was asked for last comes last."""
        self._made: dict[object, object] = {}
        self._lock = threading.RLock()  # what is made may itself want another one

    def of(self, keyspace: str) -> Shared:
        """Return what calls on a keyspace have in common; '' = that of the viewer.

        Raises:
            InvalidName: A keyspace cannot have this name.
            KeyspaceNotFound: The store has no keyspace of this name.
        """
        if not keyspace or keyspace == self.store.keyspace:
            return self
        with self._lock:
            found = self._others.pop(keyspace, None)
        if found is None:
            found = Shared(self.store.inKeyspace(keyspace), self.settings)
        with self._lock:
            self._others[keyspace] = found
            while len(self._others) > _KEPT_KEYSPACES:
                self._others.pop(next(iter(self._others)))
        return found

    def get(self, key: Callable[..., T], make: Callable[[], T]) -> T:
        """Return what ``make`` made at the first call for this key.

        If that has a method ``close``, the end of the viewer calls it.
        """
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            return cast(T, self._made[key])

    def close(self) -> None:
        """Close all that was made, the last one first. Twice is harmless."""
        with self._lock:
            made, self._made = list(self._made.values()), {}
        for each in reversed(made):
            close = getattr(each, "close", None)
            if close is not None:
                close()
