# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the schema as the servers push them, so that a cached list of tables is known as old.

A server hands a change to every connection that asked for it before the client that made the change
is told that it is done. So the answer to a request that began later comes behind it on the same
connection: whoever compares marks after the first answer of a read misses no change that was
acknowledged before the read, and pays no request for that.
"""

from __future__ import annotations

from typing import Mapping, Tuple

Mark = Tuple[object, object]
"""The newest connection, and the newest change of one keyspace; equal where nothing has come."""


class SchemaChanges:
    """Counts nothing, keeps the newest: a mark is another one after each change. Thread-safe."""

    def __init__(self) -> None:
        self._newest: dict[str, object] = {}
        self._connected = object()

    def mark(self, keyspace: str) -> Mark:
        """Return the mark of a keyspace: it differs from an earlier one where something changed."""
        return self._connected, self._newest.get(keyspace)

    def connected(self) -> None:
        """Note a new connection: changes may have passed before it was listened to."""
        self._connected = object()

    def pushed(self, change: Mapping[str, object]) -> None:
        """Note a change that a server tells, as the driver reads it; on the driver's thread."""
        self._newest[str(change["keyspace"])] = object()
