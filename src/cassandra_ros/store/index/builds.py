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
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.index.compaction import PAUSE_SEC, tasks
from cassandra_ros.store.lock import SchemaLock

_BUILD = "secondary index build"


def awaitBuilds(
    cassandra: Cassandra,
    keyspace: str,
    table: str,
    names: AbstractSet[str],
    lock: SchemaLock,
    seconds: float,
) -> None:
    """Wait until every node in reach has built the indexes of a table, or is at the last of them.

    Args:
        names: Of all of them that the schema has.
        seconds: How long.

    Raises:
        StoreUnavailable: A node has not begun by then.
    """
    deadline = time.monotonic() + seconds
    while not _begunOnEach(cassandra, keyspace, table, names):
        if time.monotonic() > deadline:
            raise StoreUnavailable(
                f"Cassandra has not begun to build an index of table {table} within "
                f"{seconds:.0f} s: it builds one after the other, and is busy with those of "
                "other tables (nodetool compactionstats); ask again when that has ended"
            )
        lock.renew()
        time.sleep(PAUSE_SEC)


def _begunOnEach(cassandra: Cassandra, keyspace: str, table: str, names: AbstractSet[str]) -> bool:
    listed = cassandra.executeOnEach(
        "SELECT table_name, index_name, is_building FROM system_views.sai_column_indexes "
        "WHERE keyspace_name = ?",
        (keyspace,),
        what=f"waiting for an index of table {table}",
    )
    at_work = tasks(cassandra, keyspace, table)
    return all(
        begun(
            names,
            {name: unbuilt for owner, name, unbuilt in rows if owner == table},
            any(kind == _BUILD for kind, _ in at_work.get(node, ())),
        )
        for node, rows in listed.items()
    )


def begun(names: AbstractSet[str], listed: Mapping[str, bool], at_work: bool) -> bool:
    """Tell whether a node has begun to build every index of a table.

    Args:
        names: Indexes that the schema has.
        listed: Those that the node knows, name → whether it waits for being built or is at it.
        at_work: It builds one of the table.
    """
    unbuilt = sum(listed.values())
    # With two of them the one that it builds may be the other.
    return names <= listed.keys() and (not unbuilt or (unbuilt == 1 and at_work))
