# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Connection headers in the store: each is written and read once."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from typing import Callable, Container, Iterator, Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.connection_header import Connection, cut_definition, join_definition
from cassandra_ros.store.tables.registry import Registry, StoredHeader

MAX_KNOWN = 1024
"""Maximum number of headers that are cached, of those that were read and of those that were
written."""


class ConnectionCache:
    """Writes and reads connection headers, each once. Thread-safe."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._stored: dict[tuple[str, Connection], int] = {}
        """Table and connection of the headers that were written last → number.

        Without a lock: a header that two threads write twice is the same row."""
        self.get: Callable[[str, int], Connection] = lru_cache(MAX_KNOWN)(self._read)
        """Return a connection of a table by its number; raises CorruptMessage if it is missing."""

    def put(self, table: str, connection: Connection) -> int:
        """Write a connection of a table (by name) before its first row; return its number."""
        return self.put_all([(table, connection)])[0]

    def put_all(self, connections: Sequence[tuple[str, Connection]]) -> list[int]:
        """Write connections of tables (by name) together; return their numbers."""
        stored = self._stored
        new = {pair: _conn(pair[1]) for pair in connections if pair not in stored}
        if new:
            self._registry.put_headers(
                [(table, number, _cut(header)) for (table, header), number in new.items()]
            )
        numbers = [new[pair] if pair in new else stored[pair] for pair in connections]
        if len(self._stored) + len(new) > MAX_KNOWN:
            self._stored = {}
        self._stored.update(new)
        return numbers

    def has(self, table: str, connection: Connection) -> bool:
        """Return whether a connection of a table (by name) is stored."""
        return self._registry.get_header(table, _conn(connection)) is not None

    def _read(self, table: str, conn: int) -> Connection:
        row = self._registry.get_header(table, conn)
        if row is None:
            raise CorruptMessage(
                f"connection header {conn} of table {table} is missing: the side tables "
                "cr_connection and cr_definition were changed by hand; import or record again"
            )
        return _join(row)

    def of_tables(self, tables: Container[str]) -> Iterator[tuple[str, int, Connection]]:
        """Yield the connections of some tables by name: (table, number, connection)."""
        for table, conn, row in self._registry.headers(tables):
            yield table, conn, _join(row)


def _conn(connection: Connection) -> int:
    """Return the number of a connection, the same in every table and program."""
    # Equal headers under two numbers in a bag stay two connections.
    text = f"{connection.topic}\0{connection.number}\0".encode("utf-8", "surrogateescape")
    digest = hashlib.md5(text + connection.header).digest()
    return int.from_bytes(digest[:8], "big", signed=True)


def _cut(connection: Connection) -> StoredHeader:
    header, offset, definition = cut_definition(connection.header)
    number, md5sum = connection.number, connection.md5sum
    return StoredHeader(connection.topic, number, header, offset, md5sum, definition)


def _join(row: StoredHeader) -> Connection:
    header = join_definition(row.header, row.def_offset, row.definition)
    return Connection(row.topic, header, row.number)
