# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The keyspaces of a cluster that hold topics."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Counter as Counts
from typing import Mapping

from cassandra_ros.errors import UnsupportedSchema
from cassandra_ros.metadata import from_comment
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.side_tables import SIDE_TABLES


@dataclass(frozen=True)
class KeyspaceInfo:
    """A keyspace with topics, or with our side tables."""

    name: str
    topics: int
    tables: int
    """Number of topic tables: one for each definition and format of a topic."""
    copies: Mapping[str, int]
    """Data centre → number of its nodes that keep each row; 'any' = all data centres."""


def list_keyspaces(cassandra: Cassandra) -> list[KeyspaceInfo]:
    """Return the keyspaces that hold topics or our side tables, sorted by name."""
    what = "listing the keyspaces"
    factors = cassandra.execute(
        "SELECT keyspace_name, replication FROM system_schema.keyspaces", what=what
    )
    replication: dict[str, Mapping[str, str]] = dict(factors)
    rows = cassandra.execute(
        "SELECT keyspace_name, table_name, comment FROM system_schema.tables", what=what
    )
    topics: dict[str, set[str]] = {}
    tables: Counts[str] = Counter()
    for keyspace, table, comment in rows:
        if table in SIDE_TABLES:
            topics.setdefault(keyspace, set())
        try:
            metadata = from_comment(comment or "", f"{keyspace}.{table}")
        except UnsupportedSchema:
            continue  # of another version; connecting to this keyspace raises an error
        if metadata is not None and not metadata.filling:
            topics.setdefault(keyspace, set()).add(metadata.topic)
            tables[keyspace] += 1
    return [
        KeyspaceInfo(name, len(topics[name]), tables[name], _copies(replication.get(name) or {}))
        for name in sorted(topics)
    ]


def tables_of_others(cassandra: Cassandra, keyspace: str) -> list[str]:
    """Return the tables of a keyspace, sorted, if none of them is ours; otherwise []."""
    names = "table_name, comment"
    rows = cassandra.system_schema("tables", names, keyspace)
    for table, comment in rows:
        try:
            if table in SIDE_TABLES or from_comment(comment or "", f"{keyspace}.{table}"):
                return []
        except UnsupportedSchema:
            return []  # of another version
    return sorted(table for table, _ in rows)


def _copies(replication: Mapping[str, str]) -> dict[str, int]:
    """Return KeyspaceInfo.copies for the replication options of a keyspace."""
    factors = {name: text for name, text in replication.items() if name != "class"}
    return {
        "any" if name == "replication_factor" else name: int(text)
        for name, text in factors.items()
        if text.isdigit()
    }
