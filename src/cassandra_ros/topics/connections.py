# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Connection headers: from the store and into it, each kept once."""

from __future__ import annotations

import hashlib
import threading

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.connection import Connection, cut_definition, join_definition
from cassandra_ros.store.registry import Registry, StoredHeader

MAX_KNOWN = 1024


def connection_id(connection: Connection) -> int:
    """Number a connection: first 8 bytes of the md5 of topic, number in its bag, and header.

    Identical headers under two numbers of a bag stay two connections.
    """
    text = f"{connection.topic}\0{connection.number}\0".encode("utf-8", "surrogateescape")
    digest = hashlib.md5(text + connection.header).digest()
    return int.from_bytes(digest[:8], "big", signed=True)


class ConnectionCache:
    """Reads connection headers once each and keeps them. Thread-safe."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._known: dict[tuple[str, int], Connection] = {}
        self._mutex = threading.Lock()

    def put(self, table: str, connection: Connection) -> int:
        """Store a connection of a table, before its first row; return its number."""
        number = connection_id(connection)
        with self._mutex:
            if (table, number) in self._known:
                return number
        header, offset, definition = cut_definition(connection.header)
        row = StoredHeader(
            topic=connection.topic,
            number=connection.number,
            header=header,
            def_offset=offset,
            md5sum=connection.md5sum,
            definition=definition,
        )
        self._registry.put_header(table, number, row)
        self._keep(table, number, connection)
        return number

    def get(self, table: str, number: int) -> Connection:
        """Read a connection of a table.

        Raises:
            CorruptMessage: The store has no such connection.
        """
        with self._mutex:
            connection = self._known.get((table, number))
        if connection is None:
            row = self._registry.get_header(table, number)
            if row is None:
                raise CorruptMessage(
                    f"connection header {number} of table {table} is missing: the side tables "
                    "cr_connection and cr_definition were changed by hand; import or record again"
                )
            header = join_definition(row.header, row.def_offset, row.definition)
            connection = Connection(row.topic, header, row.number)
            self._keep(table, number, connection)
        return connection

    def _keep(self, table: str, number: int, connection: Connection) -> None:
        with self._mutex:
            while len(self._known) >= MAX_KNOWN:
                self._known.pop(next(iter(self._known)))
            self._known[(table, number)] = connection
