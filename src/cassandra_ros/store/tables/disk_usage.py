# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Disk that the nodes say that tables take now."""

from __future__ import annotations

from collections import Counter

from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.cql_names import chunk_table_name

_CHUNKS = chunk_table_name("")
"""End of the names of chunk tables."""
MIB = 1 << 20


def disk_usage(cassandra: Cassandra, keyspace: str) -> Counter[str]:
    """Return the bytes on disk of each table, with its chunks, on all reachable nodes together.

    Each node rounds up to whole MiB. Rows that a node still holds in memory are not counted.
    """
    answers = cassandra.execute_on_each(
        "SELECT table_name, mebibytes FROM system_views.disk_usage "
        "WHERE keyspace_name = ? ALLOW FILTERING",
        (keyspace,),
        what=f"asking how much disk the tables of keyspace {keyspace} take",
    )
    sizes: Counter[str] = Counter()
    for rows in answers.values():
        for name, mebibytes in rows:
            table = name[: -len(_CHUNKS)] if name.endswith(_CHUNKS) else name
            sizes[table] += mebibytes * MIB
    return sizes
