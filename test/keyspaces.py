# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keyspaces for the tests: made once, emptied and used again, which costs less than a new one."""

from __future__ import annotations

import collections
import contextlib
import uuid

from cassandra_ros.store.tables.side_tables import LATER_TABLES, SIDE_TABLES

MOST_TABLES = 50
"""What a keyspace may hold of earlier tests: each change of its schema goes through all of it."""
LOCK = "cr_lock"
HIDE = "UPDATE system_schema.tables SET comment = '' WHERE keyspace_name = %s AND table_name = %s"
"""Statement that takes a table's comment, by which it is found."""
KEYS = {
    "cr_connection": ("tbl", "conn"),
    "cr_definition": ("md5sum", "hash"),
    "cr_node": ("tbl",),
    "cr_bucket": ("tbl", "node", "slot"),
    "cr_active": ("tbl", "slot"),
    "cr_run": ("writer",),
    "cr_loss": ("topic",),
    "cr_context": ("writer",),
    "cr_sent": ("writer", "node"),
    "cr_place": ("frame", "robot", "size", "x", "y"),
    "cr_placed": ("tbl",),
    "cr_event": ("slot",),
    "cr_event_slot": ("named", "name"),
    "cr_copy": ("target",),
    "cr_copied": ("target", "tbl", "node", "slot"),
    "cr_copied_beat": ("target", "tbl", "node", "slot"),
    "cr_lock": ("name",),
}
"""Partition keys of the side tables."""


class Keyspaces:
    """Lends empty keyspaces that have their side tables.

    Args:
        cql: A session of the bare driver.
        connect: Makes a RosCassandra.
    """

    def __init__(self, cql, connect):
        self._cql = cql
        self._connect = connect
        self._spare = []
        self._side = None
        """What there is to know of the keyspace and of each side table, by name; see _schema."""

    @contextlib.contextmanager
    def lend(self):
        """Yield the name of one; what a test has changed in its schema is not lent again."""
        name = self._spare.pop() if self._spare else self._make()
        emptied = False
        try:
            yield name
            emptied = self._emptied(name)
        finally:
            if emptied:
                self._spare.append(name)
            else:
                self._cql.execute(f"DROP KEYSPACE IF EXISTS {name}")

    def close(self):
        for name in self._spare:
            self._cql.execute(f"DROP KEYSPACE {name}")

    def _make(self):
        name = new_name()
        # Not in the commit log, or its tables would be flushed to be dropped.
        self._cql.execute(
            f"CREATE KEYSPACE {name} WITH durable_writes = false AND replication = "
            "{'class': 'NetworkTopologyStrategy', 'datacenter1': 1}"
        )
        with self._connect(keyspace=name) as store:
            # Later tables are made by the tests that need them. In the first they all are, to know
            # how they look.
            store.catalog.keyspace.side_tables.make(*(LATER_TABLES if self._side is None else ()))
        if self._side is None:
            self._side = self._schema(name)
        return name

    def _emptied(self, name):
        query = "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = %s"
        tables = self._cql.execute(query, (name,)).all()
        if len(tables) > MOST_TABLES:
            return False
        for table, comment in tables:
            if not table.startswith("cr_") and comment:
                # The table is not found any more. To drop it, or to change it by ALTER, the server
                # would read the schema of all keyspaces.
                self._cql.execute(HIDE, (name, table))
        side = self._schema(name)
        if any(self._side.get(what) != known for what, known in side.items()):
            return False
        if not side.keys() >= {"", LOCK, *SIDE_TABLES}:
            return False
        for table in side.keys() - {""}:
            key = KEYS[table]
            marks = " AND ".join(f"{column} = %s" for column in key)
            rows = self._cql.execute(f"SELECT DISTINCT {', '.join(key)} FROM {name}.{table}")
            for row in rows:
                self._cql.execute(f"DELETE FROM {name}.{table} WHERE {marks}", tuple(row))
        return True

    def _schema(self, name):
        """Return what there is to know of a keyspace, as '', and of each of its side tables."""
        what = {
            "keyspaces": "durable_writes, replication",
            "tables": "table_name, comment, compaction, default_time_to_live",
            "columns": "table_name, column_name, type, kind, position",
        }
        schema = collections.defaultdict(list)
        for table, columns in what.items():
            query = f"SELECT {columns} FROM system_schema.{table} WHERE keyspace_name = %s"
            for row in self._cql.execute(query, (name,)):
                of = "" if table == "keyspaces" else row[0]
                if table == "keyspaces" or of in KEYS:
                    schema[of].append(str(row))
        return dict(schema)


def new_name():
    return f"t_{uuid.uuid4().hex[:16]}"
