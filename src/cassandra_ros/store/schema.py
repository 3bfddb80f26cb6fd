# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topics' tables: made under the lock, found by reading comments, dropped for good."""

from __future__ import annotations

import logging
import threading
import time
from typing import Mapping

from cassandra_ros.errors import SchemaConflict, TopicNotFound
from cassandra_ros.metadata import TopicMetadata, fromComment
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import chunkTableName, quoteName, quoteText, tableName

_log = logging.getLogger(__name__)

KEY_COLUMNS = {"_node": "text", "_bucket": "bigint", "_t": "bigint", "_seq": "bigint"}
OWN_COLUMNS = {
    "_conn": "bigint",
    "_size": "int",
    "_nchunks": "int",
    "_crc": "bigint",
    "_odd": "boolean",
    "_raw": "blob",
}
CHUNK_TTL_MARGIN_SEC = 86_400
_WINDOWS = 25
CACHE_SEC = 2.0
"""How old the list of tables may be: other clients add definitions and drop topics."""


class Schema:
    """Topic tables of one keyspace. Thread-safe; what it lists is cached until it changes.

    Args:
        cassandra: An open connection.
        keyspace: A keyspace that has its side tables.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str) -> None:
        self._cassandra = cassandra
        self.keyspace = keyspace
        self._tables: dict[str, TopicMetadata] | None = None
        self._read_at = 0.0
        self.seen: set[tuple[str, str]] = set()
        """(topic, format) of every table that was ever listed here."""
        self._mutex = threading.Lock()

    def qualified(self, table: str) -> str:
        """Return the quoted name of a table with its keyspace."""
        return f"{quoteName(self.keyspace)}.{quoteName(table)}"

    def tables(self, *, fresh: bool = False) -> Mapping[str, TopicMetadata]:
        """List the topic tables: name → metadata, from the comments.

        Args:
            fresh: Ask the server even where the answer was read within the last 2 s.
        """
        with self._mutex:
            now = time.monotonic()
            if self._tables is None or fresh or now - self._read_at > CACHE_SEC:
                self._tables = self._read()
                self._read_at = now
            return self._tables

    def _read(self) -> dict[str, TopicMetadata]:
        rows = self._cassandra.execute(
            "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = ?",
            (self.keyspace,),
            what=f"listing the topics of keyspace {self.keyspace}",
        )
        found = {}
        for name, comment in rows:
            metadata = fromComment(comment or "", f"{self.keyspace}.{name}")
            if metadata is not None:
                found[name] = metadata
                self.seen.add((metadata.topic, metadata.format))
        return found

    def find(self, topic: str, md5sum: str, format_name: str) -> str | None:
        """Return the table of a topic for one md5 and format, as far as it is cached."""
        for name, metadata in self.tables().items():
            if (metadata.topic, metadata.md5sum, metadata.format) == (topic, md5sum, format_name):
                return name
        return None

    def ensureTable(self, wanted: TopicMetadata, columns: Mapping[str, str]) -> str:
        """Make the table of a topic, or find the one that somebody made before.

        Args:
            wanted: What its comment will say; the generation is chosen here.
            columns: The format's own columns, name → CQL type.

        Returns:
            The table's name.

        Raises:
            SchemaConflict: The table that came out is not the one that was asked for.
        """
        key = (wanted.topic, wanted.md5sum, wanted.format)
        name = self.find(*key)
        if name is not None:
            return name
        with SchemaLock(self._cassandra, self.keyspace) as lock:
            self.tables(fresh=True)
            name = self.find(*key)
            if name is not None:
                return name
            wanted = wanted.with_(generation=time.time_ns())
            name = tableName(*key, wanted.generation)
            lock.renew()
            self._create(name, wanted, columns)
        self._check(name, wanted, columns)
        self.tables(fresh=True)
        return name

    def _create(self, name: str, wanted: TopicMetadata, columns: Mapping[str, str]) -> None:
        every = {**KEY_COLUMNS, **OWN_COLUMNS, **columns}
        listing = ", ".join(f"{quoteName(c)} {cql}" for c, cql in every.items())
        self._cassandra.schemaChange(
            f"CREATE TABLE {self.qualified(name)} ({listing}, "
            f'PRIMARY KEY (("_node", "_bucket"), "_t", "_seq")) '
            f"WITH comment = {quoteText(wanted.toComment())} AND {_storage(wanted.ttl, 0)} "
            f"AND compression = {{'class': 'LZ4Compressor', 'chunk_length_in_kb': 16}}",
            what=f"making the table of topic {wanted.topic}",
        )

    def _check(self, name: str, wanted: TopicMetadata, columns: Mapping[str, str]) -> None:
        rows = self._cassandra.execute(
            "SELECT column_name, type FROM system_schema.columns "
            "WHERE keyspace_name = ? AND table_name = ?",
            (self.keyspace, name),
            what=f"reading the columns of {name}",
        )
        every = {**KEY_COLUMNS, **OWN_COLUMNS, **columns}
        comment = self._read().get(name)
        if dict(rows) != every or comment != wanted:
            raise SchemaConflict(
                f"table {self.keyspace}.{name} of topic {wanted.topic} is not what was asked "
                "for (columns or comment differ): another client changed it at the same time; "
                "remove the topic and try again"
            )

    def ensureChunkTable(self, table: str, ttl: int) -> str:
        """Make the table for a topic's large messages where it is missing; return its name."""
        name = chunkTableName(table)
        if self._exists(name):
            return name
        with SchemaLock(self._cassandra, self.keyspace) as lock:
            if not self._exists(table):
                raise TopicNotFound(
                    f"table {table} was removed by another client; messages of its topic need "
                    "a new one: connect again"
                )
            if not self._exists(name):
                lock.renew()
                self._cassandra.schemaChange(
                    f'CREATE TABLE {self.qualified(name)} ("_node" text, "_bucket" bigint, '
                    '"_t" bigint, "_seq" bigint, "_chunk" int, "_data" blob, '
                    'PRIMARY KEY (("_node", "_bucket", "_t", "_seq"), "_chunk")) '
                    f"WITH comment = {quoteText(f'cassandra_ros chunks of {table}')} "
                    f"AND {_storage(ttl, CHUNK_TTL_MARGIN_SEC)} "
                    "AND compression = {'class': 'LZ4Compressor', 'chunk_length_in_kb': 64, "
                    "'min_compress_ratio': 1.1} AND speculative_retry = 'NEVER'",
                    what=f"making the table for large messages {name}",
                )
        return name

    def _exists(self, name: str) -> bool:
        return bool(
            self._cassandra.execute(
                "SELECT table_name FROM system_schema.tables "
                "WHERE keyspace_name = ? AND table_name = ?",
                (self.keyspace, name),
                what=f"looking for table {name}",
            )
        )

    def alterComment(self, table: str, metadata: TopicMetadata) -> None:
        """Replace the comment of a table, under the lock."""
        with SchemaLock(self._cassandra, self.keyspace) as lock:
            lock.renew()
            self._cassandra.schemaChange(
                f"ALTER TABLE {self.qualified(table)} "
                f"WITH comment = {quoteText(metadata.toComment())}",
                what=f"changing the metadata of topic {metadata.topic}",
            )
        self.tables(fresh=True)

    def dropTopic(self, topic: str) -> list[str]:
        """Drop all tables of a topic and what belongs to them; return their names."""
        with SchemaLock(self._cassandra, self.keyspace) as lock:
            tables = [name for name, m in self._read().items() if m.topic == topic]
            for table in tables:
                for name in (table, chunkTableName(table)):
                    lock.renew()
                    self._cassandra.schemaChange(
                        f"DROP TABLE IF EXISTS {self.qualified(name)}",
                        what=f"dropping table {name}",
                    )
                self._cassandra.forget(table)
        self.tables(fresh=True)
        return tables


def _storage(ttl: int, margin: int) -> str:
    if not ttl:
        return (
            "compaction = {'class': 'UnifiedCompactionStrategy', 'scaling_parameters': 'T4'} "
            "AND default_time_to_live = 0"
        )
    minutes = max(1, ttl // _WINDOWS // 60)
    return (
        "compaction = {'class': 'TimeWindowCompactionStrategy', "
        f"'compaction_window_unit': 'MINUTES', 'compaction_window_size': {minutes}}} "
        f"AND default_time_to_live = {ttl + margin} AND gc_grace_seconds = 10800"
    )
