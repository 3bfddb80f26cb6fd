# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The context of a viewer's calls: the store, the settings and the caches."""

from __future__ import annotations

import threading
from typing import Callable, TypeVar, cast

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidOption
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.viewing.viewer_settings import ViewerSettings

T = TypeVar("T")
_KEPT_KEYSPACES = 8
"""Maximum number of keyspaces, in addition to the viewer's own, whose caches are kept."""


class ViewerContext:
    """The store, the settings and the caches of one viewer. Thread-safe.

    Each further keyspace that is requested has its own context, which that of the viewer holds.

    Args:
        source: The connected store, or several stores that are shown as one; the caller closes it.
        settings: Settings of the viewer.
    """

    def __init__(self, source: RosCassandra | Fleet, settings: ViewerSettings) -> None:
        self.source = source
        self.settings = settings
        self._others: dict[str, ViewerContext] = {}
        """Contexts by keyspace, in the order of their last request."""
        self._made: dict[object, object] = {}
        self._lock = threading.RLock()  # reentrant: making an object may need another one

    @property
    def store(self) -> RosCassandra:
        """The store.

        Raises:
            InvalidOption: The viewer shows several stores.
        """
        if isinstance(self.source, Fleet):
            names = ", ".join(store.name for store in self.source.stores)
            raise InvalidOption(
                f"one store answers this, and this viewer shows several as one ({names}): start a "
                "viewer of that store, with --store-host and --keyspace in place of --store"
            )
        return self.source

    def of(self, keyspace: str) -> ViewerContext:
        """Return the context of a keyspace; '' = that of the viewer.

        Raises:
            InvalidName: The name is not valid for a keyspace.
            KeyspaceNotFound: The store has no keyspace of this name.
        """
        if not keyspace or keyspace == self.store.keyspace:
            return self
        with self._lock:
            context = self._others.pop(keyspace, None)
        if context is None:
            context = ViewerContext(self.store.inKeyspace(keyspace), self.settings)
        with self._lock:
            self._others[keyspace] = context
            while len(self._others) > _KEPT_KEYSPACES:
                self._others.pop(next(iter(self._others)))
        return context

    def get(self, key: Callable[..., T], make: Callable[[], T]) -> T:
        """Return the object that ``make`` returned at the first call for this key.

        If the object has a method ``close``, it is called at the end of the viewer.
        """
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            return cast(T, self._made[key])

    def close(self) -> None:
        """Close all objects made, the last one first; a second call does nothing."""
        with self._lock:
            made, self._made = list(self._made.values()), {}
        for resource in reversed(made):
            close = getattr(resource, "close", None)
            if close is not None:
                close()
