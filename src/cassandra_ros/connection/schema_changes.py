# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Schema changes that the servers push, by which a cached list of tables is known to be old.

A server pushes a change to every connection that has asked for changes, and only then tells the
client that made the change. So on such a connection the answer to a request that began later comes
after the change. A reader who compares marks after its first answer therefore misses no change that
was acknowledged before the read, and needs no extra request for that.
"""

from __future__ import annotations

from typing import Mapping, Tuple

Mark = Tuple[object, object]
"""The newest connection, and the newest change of one keyspace; equal if there was no change."""


class SchemaChanges:
    """The newest schema change of each keyspace, as marks that differ after a change.

    Thread-safe.
    """

    def __init__(self) -> None:
        self._newest: dict[str, object] = {}
        self._connected = object()

    def mark(self, keyspace: str) -> Mark:
        """Return the mark of a keyspace, which changes with each change of its schema."""
        return self._connected, self._newest.get(keyspace)

    def connected(self) -> None:
        """Note a new connection: changes before it were not heard."""
        self._connected = object()

    def pushed(self, change: Mapping[str, object]) -> None:
        """Note a change that a server has pushed, as the driver parsed it.

        On the driver's thread.
        """
        self._newest[str(change["keyspace"])] = object()
