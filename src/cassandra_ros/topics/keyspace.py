# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A connected keyspace: the parts that writers, readers and topics share."""

from __future__ import annotations

from typing import Callable, Sequence

from cassandra_ros.query.protocols import Places as RobotPlaces
from cassandra_ros.read import Whose
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.event_table import EventTable
from cassandra_ros.store.tables.index_changes import IndexChanges
from cassandra_ros.store.tables.place_index import PlaceIndex
from cassandra_ros.store.tables.registry import Registry
from cassandra_ros.store.tables.schema import Schema
from cassandra_ros.store.tables.side_tables import SideTables
from cassandra_ros.topics.event_finder import Events
from cassandra_ros.topics.new_tables import NewTables
from cassandra_ros.topics.row_reader import FollowingReader, RowReader
from cassandra_ros.topics.run_finder import Runs
from cassandra_ros.topics.stored_headers import ConnectionCache
from cassandra_ros.topics.stored_totals import ALL_BUCKETS, holds_any
from cassandra_ros.topics.topic_table import TopicTable, TopicTables, kind_of


class Keyspace:
    """One keyspace of a cluster; the first write makes it and its side tables.

    Its attributes are its parts, each for one purpose; their classes describe these.

    Args:
        robots: Returns the lookup of the robots' places in the keyspace.
    """

    def __init__(self, cassandra: Cassandra, name: str, robots: Callable[[], RobotPlaces]) -> None:
        self.cassandra = cassandra
        self.name = name
        self.side_tables = SideTables(cassandra, name)
        self.schema = Schema(cassandra, self.side_tables, kind_of)
        self.indexes = IndexChanges(self.schema)
        self.directory = Directory(cassandra, self.side_tables)
        self.registry = Registry(self.side_tables)
        self.place_index = PlaceIndex(self.side_tables)
        self.connections = ConnectionCache(self.registry)
        self.runs = Runs(name, self.registry, self._has_written, self._all_nodes)
        self.events = Events(name, EventTable(self.side_tables), self.runs)
        self.tables = TopicTables(
            cassandra, self.schema, self.connections, self.runs, robots, self.events
        )
        self.new_tables = NewTables(self.schema, self.tables)
        self.rows = FollowingReader(RowReader(cassandra, self.directory))

    def _has_written(self, writer: int) -> bool:
        return holds_any(self.directory, self._all_tables(), Whose(None, frozenset([writer])))

    def _all_nodes(self) -> list[str]:
        return self.nodes(self._all_tables())

    def _all_tables(self) -> list[TopicTable]:
        listed = self.schema.tables(fresh=True)
        return [self.tables.get(name, metadata) for name, metadata in listed.items()]

    def delete_entries(self, table: str) -> None:
        """Delete what directory, registry and index of places say of a table that is not read."""
        self.directory.delete_entries(table)
        self.registry.delete_entries(table)
        self.place_index.delete_entries(table)

    def nodes(self, tables: Sequence[TopicTable]) -> list[str]:
        """Return the nodeIDs that have stored messages in some tables, sorted."""
        directory = self.directory
        return sorted({node for t in tables for _, node in directory.nodes(t.name, *ALL_BUCKETS)})
