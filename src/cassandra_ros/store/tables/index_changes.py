# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Indexes of stored topics, made and dropped under the schema lock during reads and writes.

An index consists of a shadow column, a Cassandra index on it, and an entry in the comment. They are
made in this order and removed in the reverse order, so what the comment lists exists. The column is
never dropped: a writer with an open bucket goes on filling it, and would lose its messages.
"""

from __future__ import annotations

from typing import Callable

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.metadata import TopicMetadata, shadow_column
from cassandra_ros.store.connection.cql_names import quote_name
from cassandra_ros.store.tables import index_builds
from cassandra_ros.store.tables.schema import Schema
from cassandra_ros.store.tables.side_tables import SchemaLock

TypeOf = Callable[[TopicMetadata], "str | None"]
"""Returns the CQL type of the shadow column of a field in a table; None if the type of the table's
messages lacks the field."""


class IndexChanges:
    """Adds and drops the indexes of the topics of one keyspace."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema

    def add_index(self, topic: str, field: str, type_of: TypeOf) -> None:
        """Make the index on a field in each table of a topic that can have it, or complete it.

        In the other tables merging is resumed if a client that died has left it paused.

        Raises:
            StoreUnavailable: Files of a table are merged for too long, or a build does not begin.
                Indexes of earlier tables stay; the call may be repeated.
            SchemaConflict: The server refuses the index.
        """
        with self._schema.lock() as lock:
            for table, metadata in self._schema.tables_of(topic).items():
                cql_type, shadow = type_of(metadata), metadata.indexes.get(field)
                builds = self._schema.index_builds(table, lock)
                if shadow is None and cql_type is not None:
                    self._add_to(table, metadata, field, cql_type, lock)
                elif shadow is not None and table + shadow not in builds.indexes():
                    self._make(table, shadow, lock)
                else:
                    builds.resume_merging()  # a client that died may have left it paused
        self._schema.tables(fresh=True)

    def _add_to(
        self, table: str, metadata: TopicMetadata, field: str, cql_type: str, lock: SchemaLock
    ) -> None:
        """Make column, index and entry in the comment of a table that has no index on the field."""
        # A column that no comment lists was left by a client that died before it wrote the comment.
        columns, number = self._schema.columns(table), metadata.next_shadow
        while columns.get(shadow_column(number), cql_type) != cql_type:
            number += 1
        shadow = shadow_column(number)
        if shadow not in columns:
            lock.change(
                f"ALTER TABLE {self._schema.qualified(table)} ADD {quote_name(shadow)} {cql_type}",
                what=f"adding a column to table {table}",
            )
        self._make(table, shadow, lock)
        self._schema.set_comment(table, metadata.with_index(field, number), lock)

    def _make(self, table: str, shadow: str, lock: SchemaLock) -> None:
        """Make an index; replace one that was left by a client that died before it was listed."""
        index, builds = table + shadow, self._schema.index_builds(table, lock)
        names = builds.indexes()
        if index in names:
            # The old index may miss rows. If its build is still waiting, it would run without it.
            builds.await_builds(names, index_builds.BUILD_START_SEC)
            builds.drop_index(index)
        builds.pause_merging()
        conflict = None
        # After an error it is not known whether and when the nodes make and build the index.
        with builds.paused_told():
            lock.renew()
            try:
                self._schema.create_sai_index(table, shadow)
            except SchemaConflict as exc:
                conflict = exc
            builds.resume_merging()
        if conflict:
            raise conflict

    def drop_index(self, topic: str, field: str) -> bool:
        """Drop the index on a field in all tables of a topic; return whether any index was dropped.

        In the same tables the indexes are dropped that no comment lists: a client that died while
        it made or dropped one has left it. The other indexes stay. Where merging is paused, it is
        resumed first, which waits until all builds of the table have begun.

        Raises:
            StoreUnavailable: A build of one of the tables does not begin. What was dropped before
                stays dropped; the call may be repeated.
        """
        has_dropped = False
        with self._schema.lock() as lock:
            for table, metadata in self._schema.tables_of(topic).items():
                # Before the drop: an index build that waits goes on without its index.
                self._schema.index_builds(table, lock).resume_merging()
                if field in metadata.indexes:
                    metadata = metadata.without_index(field)
                    self._schema.set_comment(table, metadata, lock)
                    has_dropped = True
                if self._drop_unlisted(table, metadata, lock):
                    has_dropped = True
        self._schema.tables(fresh=True)
        return has_dropped

    def _drop_unlisted(self, table: str, metadata: TopicMetadata, lock: SchemaLock) -> bool:
        """Drop the indexes of a table that its comment does not list; return whether any was."""
        builds = self._schema.index_builds(table, lock)
        listed = {table + shadow for shadow in metadata.indexes.values()}
        unlisted = builds.indexes() - listed
        for index in unlisted:
            builds.drop_index(index)
        return bool(unlisted)
