# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Indexes of stored topics, made and dropped under the schema lock while others read and write.

An index is a shadow column, an index on it, and its line in the comment, made in this order and
taken away in the other: what the comment lists is there. A column is never dropped, for a writer
that has a bucket open goes on filling it, and would lose its messages.
"""

from __future__ import annotations

import time
from typing import Callable

from cassandra_ros.errors import CassandraRosError, StoreUnavailable, TopicNotFound
from cassandra_ros.metadata import SHADOW, TopicMetadata, shadowColumn
from cassandra_ros.store.compaction import PAUSE_SEC, paused, resume, tasks
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import quoteName
from cassandra_ros.store.schema import Schema

TypeOf = Callable[[TopicMetadata], "str | None"]
"""CQL type of the shadow column of a field in a table; None where its type lacks the field."""

BUILD_SEC = 30.0
"""How long Cassandra may take to begin to build an index."""


class IndexChanges:
    """Adds and drops the indexes of the topics of one keyspace."""

    def __init__(self, cassandra: Cassandra, schema: Schema) -> None:
        self._cassandra = cassandra
        self._schema = schema

    def add(self, topic: str, field: str, type_of: TypeOf) -> None:
        """Make an index in every table of a topic that can have it; complete one that is there.

        Raises:
            TopicNotFound: The topic is gone.
        """
        with SchemaLock(self._cassandra, self._schema.keyspace) as lock:
            for table, metadata in self._tables(topic).items():
                cql_type = type_of(metadata)
                if field not in metadata.indexes and cql_type is not None:
                    self._addTo(table, metadata, field, cql_type, lock)
                elif field in metadata.indexes:
                    self._complete(table, metadata.indexes[field], lock)
        self._schema.tables(fresh=True)

    def _addTo(
        self, table: str, metadata: TopicMetadata, field: str, cql_type: str, lock: SchemaLock
    ) -> None:
        # A column that no comment has listed yet was left by somebody who died before that.
        columns, number = self._schema.columns(table), metadata.nextShadow
        while columns.get(shadowColumn(number), cql_type) != cql_type:
            number += 1
        shadow = shadowColumn(number)
        if shadow not in columns:
            lock.renew()
            self._cassandra.schemaChange(
                f"ALTER TABLE {self._schema.qualified(table)} ADD {quoteName(shadow)} {cql_type}",
                what=f"adding a column to table {table}",
            )
        self._complete(table, shadow, lock)
        lock.renew()
        self._schema.setComment(table, metadata.withIndex(field, number))

    def _complete(self, table: str, shadow: str, lock: SchemaLock) -> None:
        keyspace = self._schema.keyspace
        if table + shadow in self._names(table):
            resume(self._cassandra, keyspace, table, lock)
            return
        with paused(self._cassandra, keyspace, table, lock):
            lock.renew()
            self._schema.createIndex(table, shadow)
            try:
                self._awaitBuild(table, shadow, lock)
            except CassandraRosError:
                self._drop(table, table + shadow, lock)
                raise

    def _awaitBuild(self, table: str, shadow: str, lock: SchemaLock) -> None:
        """Wait until every node in reach has built an index, or is at it.

        It knows then which files the index covers, and they may be merged again.
        """
        keyspace = self._schema.keyspace
        deadline = time.monotonic() + BUILD_SEC
        while time.monotonic() < deadline:
            built = self._cassandra.executeOnEach(
                "SELECT is_queryable FROM system_views.sai_column_indexes "
                "WHERE keyspace_name = ? AND index_name = ?",
                (keyspace, table + shadow),
                what=f"waiting for an index of table {table}",
            )
            building = tasks(self._cassandra, keyspace, table)
            if all((True,) in rows or building.get(node) for node, rows in built.items()):
                return
            lock.renew()
            time.sleep(PAUSE_SEC)
        raise StoreUnavailable(
            f"Cassandra has not begun to build an index of table {table} within {BUILD_SEC:.0f} s: "
            "it builds one after the other, and is busy with those of other tables "
            "(nodetool compactionstats); ask again when that has ended"
        )

    def _drop(self, table: str, index: str, lock: SchemaLock) -> None:
        lock.renew()
        self._cassandra.schemaChange(
            f"DROP INDEX IF EXISTS {quoteName(self._schema.keyspace)}.{quoteName(index)}",
            what=f"dropping an index of table {table}",
        )

    def drop(self, topic: str, field: str) -> bool:
        """Drop an index in every table of a topic, and what others left behind in doing so.

        Returns:
            Whether there was anything to drop.

        Raises:
            TopicNotFound: The topic is gone.
        """
        done = False
        with SchemaLock(self._cassandra, self._schema.keyspace) as lock:
            for table, metadata in self._tables(topic).items():
                resume(self._cassandra, self._schema.keyspace, table, lock)
                if field in metadata.indexes:
                    metadata = metadata.withoutIndex(field)
                    lock.renew()
                    self._schema.setComment(table, metadata)
                    done = True
                kept = {table + shadow for shadow in metadata.indexes.values()}
                for name in self._names(table) - kept:
                    self._drop(table, name, lock)
                    done = True
        self._schema.tables(fresh=True)
        return done

    def _tables(self, topic: str) -> dict[str, TopicMetadata]:
        tables = self._schema.tables(fresh=True).items()
        mine = {name: metadata for name, metadata in tables if metadata.topic == topic}
        if not mine:
            raise TopicNotFound(f"topic {topic} is not stored in {self._schema.keyspace} any more")
        return mine

    def _names(self, table: str) -> set[str]:
        """Names of the indexes of ours that a table has."""
        rows = self._cassandra.execute(
            "SELECT index_name FROM system_schema.indexes "
            "WHERE keyspace_name = ? AND table_name = ?",
            (self._schema.keyspace, table),
            what=f"reading the indexes of table {table}",
        )
        return {name for (name,) in rows if name.startswith(table + SHADOW)}
