# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The connection of a RosCassandra: cluster and keyspace, made and ended."""

from __future__ import annotations

from typing import Any, Optional, TypeVar

from cassandra_ros.errors import KeyspaceNotFound
from cassandra_ros.store.address import from_environment
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.clock import Clock
from cassandra_ros.topics.keyspace import Keyspace

_Part = TypeVar("_Part")
_Self = TypeVar("_Self", bound="KeyspaceConnection")


class KeyspaceConnection:
    """A cluster, and the keyspace that is worked in; see RosCassandra."""

    def __init__(
        self,
        host: Optional[str] = None,
        port: Optional[int] = None,
        *,
        keyspace: Optional[str] = None,
        clock: Optional[Clock] = None,
        consistency: str = "LOCAL_QUORUM",
        username: Optional[str] = None,
        password: Optional[str] = None,
        ssl_context: Any = None,
    ) -> None:
        login: Any = {"username": username, "password": password, "ssl_context": ssl_context}
        self.cassandra = Cassandra(host, port, consistency=consistency, **login)
        self._clock = clock
        self._parts: Optional[Keyspace] = None
        self._adder: Optional[Adder] = None
        self._catalog: Optional[Catalog] = None
        keyspace = from_environment("KEYSPACE") or None if keyspace is None else keyspace
        if keyspace is not None:
            try:
                self._work_in(Keyspace(self.cassandra, keyspace))
            except BaseException:
                self.cassandra.close()
                raise

    # ---------------------------------------------------------------- keyspace

    def connectToKeyspace(self, keyspace: str, make: bool = True) -> None:
        """Work in this keyspace from now on.

        Tables are made in it by what first writes, never by reading. Topics that were got before
        stay in theirs until the next call or close.

        Args:
            keyspace: 1 to 48 letters, digits and underscores; case matters.
            make: Make it where it is missing, with a replication factor of min(3, nodes).

        Raises:
            InvalidName: It is not a keyspace name.
            KeyspaceNotFound: It is missing and make is false; the text gives the nearest names.
        """
        parts = Keyspace(self.cassandra, keyspace)
        if make:
            parts.side_tables.make_keyspace()
        else:
            parts.side_tables.require_keyspace()
        self._work_in(parts)

    def _work_in(self, parts: Keyspace) -> None:
        if self._adder is not None:
            self._adder.close()
        self._parts = parts
        self._adder = Adder(parts, self._clock)
        self._catalog = Catalog(parts, self._adder)

    @property
    def keyspace(self) -> Optional[str]:
        """The connected keyspace's name, or None."""
        return None if self._parts is None else self._parts.name

    @property
    def parts(self) -> Keyspace:
        """The connected keyspace: schema, directory, registry, rows."""
        return self._connected(self._parts)

    @property
    def _topics(self) -> Catalog:
        return self._connected(self._catalog)

    def _connected(self, part: Optional[_Part]) -> _Part:
        self.cassandra.require_open()
        if part is None:
            raise KeyspaceNotFound("no keyspace is connected: call connectToKeyspace('ros') first")
        return part

    def close(self) -> None:
        """Store what is on its way and close the connection. Twice is harmless."""
        try:
            if self._adder is not None:
                self._adder.close()
        finally:
            self.cassandra.close()

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
