# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keyspaces for the tests: made once, emptied and used again, which costs half of a new one."""

from __future__ import annotations

import contextlib
import uuid

MOST_TOPICS = 2
KEYS = {
    "cr_connection": ("tbl", "conn"),
    "cr_definition": ("md5sum", "hash"),
    "cr_node": ("tbl",),
    "cr_bucket": ("tbl", "node", "slot"),
    "cr_run": ("writer",),
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
        self._made = {}

    @contextlib.contextmanager
    def lend(self):
        """Yield the name of one; what a test has changed in its schema is not lent again."""
        name = self._spare.pop() if self._spare else self._make()
        try:
            yield name
        finally:
            if self._emptied(name):
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
        self._connect(keyspace=name).close()
        self._made[name] = self._schema(name)
        return name

    def _emptied(self, name):
        query = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s"
        topics = [t for (t,) in self._cql.execute(query, (name,)) if not t.startswith("cr_")]
        # Each drop makes the server flush its own tables, and so does that of a whole keyspace.
        if len(topics) > MOST_TOPICS or name not in self._made:
            return False
        for table in topics:
            self._cql.execute(f'DROP TABLE {name}."{table}"')
        if self._schema(name) != self._made[name]:
            return False
        for table, key in KEYS.items():
            marks = " AND ".join(f"{column} = %s" for column in key)
            rows = self._cql.execute(f"SELECT DISTINCT {', '.join(key)} FROM {name}.{table}")
            for row in rows:
                self._cql.execute(f"DELETE FROM {name}.{table} WHERE {marks}", tuple(row))
        return True

    def _schema(self, name):
        """Return what there is to know of a keyspace but its name and ids."""
        what = {
            "keyspaces": "durable_writes, replication",
            "tables": "table_name, comment, compaction, default_time_to_live",
            "columns": "table_name, column_name, type, kind, position",
        }
        return [
            str(row)
            for table, columns in what.items()
            for row in self._cql.execute(
                f"SELECT {columns} FROM system_schema.{table} WHERE keyspace_name = %s", (name,)
            )
        ]


def new_name():
    return f"t_{uuid.uuid4().hex[:16]}"
