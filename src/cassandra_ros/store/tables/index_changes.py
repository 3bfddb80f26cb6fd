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
from cassandra_ros.store.tables import table_files
from cassandra_ros.store.tables.schema import Schema
from cassandra_ros.store.tables.side_tables import SchemaLock

TypeOf = Callable[[TopicMetadata], "str | None"]
"""Returns the CQL type of the shadow column of a field in a table; None if the type of the table's
messages lacks the field."""


class IndexChanges:
    """Adds and drops the indexes of the topics of one keyspace."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema

    def add(self, topic: str, field: str, type_of: TypeOf) -> None:
        """Make an index in every table of a topic that can have it; complete an unfinished one."""
        with self._schema.lock() as lock:
            for table, metadata in self._schema.tables_of(topic).items():
                cql_type, shadow = type_of(metadata), metadata.indexes.get(field)
                files = self._schema.files(table, lock)
                if shadow is None and cql_type is not None:
                    self._add_to(table, metadata, field, cql_type, lock)
                elif shadow is not None and table + shadow not in files.indexes():
                    self._make(table, shadow, lock)
                else:
                    files.resume()  # a client that died may have left it paused
        self._schema.tables(fresh=True)

    def _add_to(
        self, table: str, metadata: TopicMetadata, field: str, cql_type: str, lock: SchemaLock
    ) -> None:
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
        index, files = table + shadow, self._schema.files(table, lock)
        names = files.indexes()
        if index in names:
            # The old index may miss rows. If its build is still waiting, it would run without it.
            files.await_builds(names, table_files.BUILD_SEC)
            files.drop(index)
        files.pause()
        conflict = None
        # After an error it is not known whether and when the nodes make and build the index.
        with files.told():
            lock.renew()
            try:
                self._schema.create_sai_index(table, shadow)
            except SchemaConflict as exc:
                conflict = exc
            files.resume()
        if conflict:
            raise conflict

    def drop(self, topic: str, field: str) -> bool:
        """Drop an index in all tables of a topic, and unlisted ones.

        Return whether there was any.
        """
        has_dropped = False
        with self._schema.lock() as lock:
            for table, metadata in self._schema.tables_of(topic).items():
                # First resume merging: an index build that waits goes on without its index.
                files = self._schema.files(table, lock)
                files.resume()
                if field in metadata.indexes:
                    metadata = metadata.without_index(field)
                    self._schema.set_comment(table, metadata, lock)
                    has_dropped = True
                own_names = {table + shadow for shadow in metadata.indexes.values()}
                for name in files.indexes() - own_names:
                    files.drop(name)
                    has_dropped = True
        self._schema.tables(fresh=True)
        return has_dropped
