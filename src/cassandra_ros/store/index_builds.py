# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How far the nodes are with building the indexes of a table.

Each node builds one index after the other, of all tables. When it begins with one it fixes which
files that covers, and they must not be merged before.
"""

from __future__ import annotations

import time
from typing import AbstractSet, Mapping

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.store.compaction import PAUSE_SEC, tasks
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock

BUILD_SEC = 30.0
"""How long Cassandra may take to begin to build an index."""
_BUILD = "secondary index build"


def awaitBuilds(
    cassandra: Cassandra, keyspace: str, table: str, names: AbstractSet[str], lock: SchemaLock
) -> None:
    """Wait until every node in reach has built the indexes of a table, or is at the last of them.

    Args:
        names: Of all of them that the schema has.

    Raises:
        StoreUnavailable: A node has not begun after 30 s.
    """
    deadline = time.monotonic() + BUILD_SEC
    while not _begunOnEach(cassandra, keyspace, table, names):
        if time.monotonic() > deadline:
            raise StoreUnavailable(
                f"Cassandra has not begun to build an index of table {table} within "
                f"{BUILD_SEC:.0f} s: it builds one after the other, and is busy with those of "
                "other tables (nodetool compactionstats); ask again when that has ended"
            )
        lock.renew()
        time.sleep(PAUSE_SEC)


def _begunOnEach(cassandra: Cassandra, keyspace: str, table: str, names: AbstractSet[str]) -> bool:
    what = f"waiting for an index of table {table}"
    # In this order: what is not built now, and is then neither waiting nor at work, has failed.
    listed = cassandra.executeOnEach(
        "SELECT table_name, index_name, is_queryable FROM system_views.sai_column_indexes "
        "WHERE keyspace_name = ?",
        (keyspace,),
        what=what,
    )
    building = tasks(cassandra, keyspace, table)
    queues = cassandra.executeOnEach(
        "SELECT active_tasks, pending_tasks FROM system_views.thread_pools "
        "WHERE name = 'SecondaryIndexManagement'",
        what=what,
    )
    return all(
        begun(
            names,
            {name: built for owner, name, built in rows if owner == table},
            building=any(kind == _BUILD for kind, _ in building.get(node, ())),
            idle=queues.get(node) == [(0, 0)],
        )
        for node, rows in listed.items()
    )


def begun(
    names: AbstractSet[str], listed: Mapping[str, bool], *, building: bool, idle: bool
) -> bool:
    """Tell whether a node has begun to build every index of a table.

    Args:
        names: Indexes that the schema has.
        listed: Those that the node knows, name → whether it is built.
        building: It builds one of the table.
        idle: It builds none of any table, and none waits.
    """
    missing = (names | listed.keys()) - {name for name, built in listed.items() if built}
    if not missing:
        return True
    # With two missing the one that it builds may be the other.
    return (idle and names <= listed.keys()) or (building and len(missing) == 1)
