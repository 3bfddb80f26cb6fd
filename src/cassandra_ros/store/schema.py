# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topics' tables: made under the lock, found by reading comments, dropped for good."""

from __future__ import annotations

import logging
import threading
import time
from typing import Callable, Collection, Mapping, Sequence, Tuple

from cassandra_ros.errors import CassandraRosError, SchemaConflict, TopicNotFound
from cassandra_ros.metadata import SHADOW, TopicMetadata, fromComment
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.index.builds import awaitBuilds
from cassandra_ros.store.index.compaction import Compaction
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import chunkTableName, quoteName, quoteText, tableName
from cassandra_ros.store.side_tables import SideTables
from cassandra_ros.store.table_storage import (
    createChunkTable,
    createTable,
    finishTable,
    ownColumns,
)

_log = logging.getLogger(__name__)

CACHE_SEC = 2.0
"""How old the list of tables may be: other clients add definitions and drop topics."""
BUILD_SEC = 2.0
"""How long messages wait until Cassandra begins to build the indexes of their new table."""


Planned = Tuple[TopicMetadata, Mapping[str, str], Mapping[str, str]]
"""What a comment will say (the generation is chosen here), the columns of the format, and the
columns with an index, both name → CQL type."""
Planner = Callable[[Sequence[TopicMetadata]], Planned]


class Schema:
    """Topic tables of one keyspace. Thread-safe; what it lists is cached until it changes.

    Args:
        cassandra: An open connection.
        side_tables: Those of the keyspace.
    """

    def __init__(self, cassandra: Cassandra, side_tables: SideTables) -> None:
        self._cassandra = cassandra
        self.keyspace = side_tables.keyspace
        self._side_tables = side_tables
        self._tables: dict[str, TopicMetadata] | None = None
        self._read_at = 0.0
        self.seen: set[tuple[str, str]] = set()
        """(topic, format) of every table that was ever listed here."""
        self._mutex = threading.Lock()

    def lock(self) -> SchemaLock:
        """Return the lock under which the schema is changed; side tables are made before."""
        self._side_tables.make()
        return SchemaLock(self._cassandra, self.keyspace)

    def qualified(self, table: str) -> str:
        """Return the quoted name of a table with its keyspace."""
        return f"{quoteName(self.keyspace)}.{quoteName(table)}"

    def tables(self, *, fresh: bool = False) -> Mapping[str, TopicMetadata]:
        """List the topic tables: name → metadata, from the comments.

        Args:
            fresh: Ask the server even where the answer was read within the last 2 s.
        """
        self._cassandra.require_open()
        with self._mutex:
            now = time.monotonic()
            if self._tables is None or fresh or now - self._read_at > CACHE_SEC:
                self._tables = self._read()
                self._read_at = now
            return self._tables

    def latest(self, table: str, known: TopicMetadata) -> TopicMetadata:
        """Return the metadata of a table, those known where they cannot be read now."""
        try:
            return self.tables().get(table, known)
        except CassandraRosError as exc:
            # No reason to lose a message: the directory is told which indexes its row is given.
            _log.warning("topic %s keeps the indexes it had: %s", known.topic, exc)
            return known

    def _comments(self, table: str = "") -> list[tuple[str, str]]:
        """Read (name, comment) of one table, where it is there, or of all."""
        query = "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = ?"
        return self._cassandra.execute(
            query + " AND table_name = ?" if table else query,
            (self.keyspace, table) if table else (self.keyspace,),
            what=f"looking for table {table}"
            if table
            else f"listing the topics of keyspace {self.keyspace}",
        )

    def _read(self, table: str = "") -> dict[str, TopicMetadata]:
        found = {}
        for name, comment in self._comments(table):
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

    def ensureTable(self, key: tuple[str, str, str], plan: Planner) -> str:
        """Make the table of a topic, or find the one that somebody made before.

        Args:
            key: Topic, md5sum and format.
            plan: Called where the table is to be made, under the lock, with what the comments of
                the topic's other tables say.

        Returns:
            The table's name.

        Raises:
            SchemaConflict: The table that came out is not the one that was asked for.
        """
        name = self.find(*key)
        if name is not None:
            return name
        with self.lock() as lock:
            self.tables(fresh=True)
            name = self.find(*key)
            if name is not None:
                return name
            others = [m for _, m in sorted(self.tables().items()) if m.topic == key[0]]
            wanted, columns, shadows = plan(others)
            wanted = wanted.with_(generation=time.time_ns())
            name = tableName(*key, wanted.generation)
            every = {**ownColumns(wanted), **columns, **shadows}
            self._createAll(name, wanted, every, shadows, lock)
            self._check(name, wanted, every)
        return name

    def _createAll(
        self,
        name: str,
        wanted: TopicMetadata,
        columns: Mapping[str, str],
        shadows: Collection[str],
        lock: SchemaLock,
    ) -> None:
        self._cassandra.schemaChange(
            createTable(self.qualified(name), wanted, columns, finished=not shadows),
            what=f"making the table of topic {wanted.topic}",
        )
        for shadow in shadows:
            lock.renew()
            self.createIndex(name, shadow)
        if shadows:
            self._finish(name, wanted, shadows, lock)

    def _finish(
        self, name: str, wanted: TopicMetadata, shadows: Collection[str], lock: SchemaLock
    ) -> None:
        """Let a table be found, by its comment, and its files be merged, with its indexes built."""
        merged, indexes = True, {name + shadow for shadow in shadows}
        try:
            awaitBuilds(self._cassandra, self.keyspace, name, indexes, lock, BUILD_SEC)
        except CassandraRosError as exc:
            # No reason to lose the messages that are waiting for it.
            merged = False
            _log.warning("topic %s: %s", wanted.topic, exc)
            Compaction(self._cassandra, self.keyspace, name, lock).tell()
        lock.renew()
        self._cassandra.schemaChange(
            finishTable(self.qualified(name), wanted, merged=merged),
            what=f"finishing the table of topic {wanted.topic}",
        )

    def createIndex(self, table: str, shadow: str) -> None:
        """Make the index that a shadow column carries, where it is missing; under the lock."""
        self._cassandra.schemaChange(
            f"CREATE INDEX IF NOT EXISTS {quoteName(table + shadow)} ON {self.qualified(table)} "
            f"({quoteName(shadow)}) USING 'sai'",
            what=f"making an index of table {table}",
        )

    def _check(self, name: str, wanted: TopicMetadata, columns: Mapping[str, str]) -> None:
        made = self._read(name)
        with self._mutex:
            self._tables = {**(self._tables or {}), **made}
        if self.columns(name) != dict(columns) or made.get(name) != wanted:
            raise SchemaConflict(
                f"table {self.keyspace}.{name} of topic {wanted.topic} is not what was asked "
                "for (columns or comment differ): another client changed it at the same time; "
                "remove the topic and try again"
            )

    def columns(self, table: str) -> dict[str, str]:
        """Read the columns of a table: name → CQL type."""
        rows = self._cassandra.execute(
            "SELECT column_name, type FROM system_schema.columns "
            "WHERE keyspace_name = ? AND table_name = ?",
            (self.keyspace, table),
            what=f"reading the columns of {table}",
        )
        return dict(rows)

    def ensureChunkTable(self, table: str, metadata: TopicMetadata) -> str:
        """Make the table for a topic's large messages where it is missing; return its name."""
        name = chunkTableName(table)
        if self._comments(name):
            return name
        with self.lock() as lock:
            if not self._comments(table):
                raise TopicNotFound(
                    f"table {table} was removed by another client; messages of its topic need "
                    "a new one: connect again"
                )
            if not self._comments(name):
                lock.renew()
                self._cassandra.schemaChange(
                    createChunkTable(self.qualified(name), table, metadata),
                    what=f"making the table for large messages {name}",
                )
        return name

    def changeTopic(
        self,
        topic: str,
        change: Callable[[TopicMetadata], TopicMetadata],
        check: Callable[[Mapping[str, TopicMetadata]], None] = lambda tables: None,
    ) -> None:
        """Change what the comments of a topic's tables say, under the lock.

        Args:
            topic: Its name.
            change: Makes the new metadata of a table from those it has now.
            check: Looks at all tables first, under the lock, and may raise.

        Raises:
            TopicNotFound: The topic is gone.
        """
        with self.lock() as lock:
            tables = self._read()
            check(tables)
            mine = {name: m for name, m in tables.items() if m.topic == topic}
            if not mine:
                raise TopicNotFound(f"topic {topic} is not stored in {self.keyspace} any more")
            for name, metadata in mine.items():
                lock.renew()
                self.setComment(name, change(metadata))
        self.tables(fresh=True)

    def setComment(self, table: str, metadata: TopicMetadata) -> None:
        """Change what the comment of a table says; under the lock."""
        self._cassandra.schemaChange(
            f"ALTER TABLE {self.qualified(table)} WITH comment = {quoteText(metadata.toComment())}",
            what=f"changing the metadata of topic {metadata.topic}",
        )

    def dropTopic(self, topic: str, *, renew: bool = False) -> list[str]:
        """Drop all tables of a topic and what belongs to them; return their names.

        Args:
            topic: Its name.
            renew: Make empty tables in their place first.
        """
        with self.lock() as lock:
            tables = {name: m for name, m in self._read().items() if m.topic == topic}
            if renew:
                # Made anew under other names: a writer that has not heard of it must not go on.
                one_each = {(m.md5sum, m.format): (name, m) for name, m in tables.items()}
                for name, metadata in one_each.values():
                    self._createEmpty(name, metadata, lock)
            for table in tables:
                for name in (table, chunkTableName(table)):
                    lock.renew()
                    self._cassandra.schemaChange(
                        f"DROP TABLE IF EXISTS {self.qualified(name)}",
                        what=f"dropping table {name}",
                    )
                self._cassandra.forget(table)
        self.tables(fresh=True)
        return list(tables)

    def _createEmpty(self, table: str, metadata: TopicMetadata, lock: SchemaLock) -> None:
        metadata = metadata.with_(generation=time.time_ns())
        key = (metadata.topic, metadata.md5sum, metadata.format)
        name = tableName(*key, metadata.generation)
        shadows = metadata.indexes.values()
        columns = self.columns(table).items()
        kept = {c: cql for c, cql in columns if c in shadows or not c.startswith(SHADOW)}
        lock.renew()
        self._createAll(name, metadata, kept, shadows, lock)
