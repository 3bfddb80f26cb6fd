# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keyspaces, and the tables that stand beside the topics' own in each of them."""

from __future__ import annotations

import logging
import uuid

from cassandra_ros.errors import KeyspaceNotFound
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import checkKeyspace, quoteName, quoteText

_log = logging.getLogger(__name__)

_LOCK = "cr_lock"
_LOCK_COLUMNS = "name text PRIMARY KEY, owner uuid"

SIDE_TABLES = {
    # Connection headers: the definition is cut out of the header and its place kept.
    "cr_connection": (
        "tbl text, conn bigint, topic text, number int, header blob, def_offset int, "
        "md5sum text, def_hash blob, PRIMARY KEY ((tbl, conn))"
    ),
    # md5sum does not tell one text from another (comments), so the hash of the text does.
    "cr_definition": "md5sum text, hash blob, text blob, PRIMARY KEY ((md5sum, hash))",
    # Directory: which (slot, node) a table has, and every bucket of each of them by writer.
    "cr_node": "tbl text, slot bigint, node text, PRIMARY KEY ((tbl), slot, node)",
    "cr_bucket": (
        "tbl text, node text, slot bigint, bucket bigint, writer bigint, state text, "
        "heartbeat timestamp, n bigint, bytes bigint, largest bigint, t_min bigint, "
        "t_max bigint, odd bigint, deleted boolean, filled frozen<set<text>>, "
        "PRIMARY KEY ((tbl, node, slot), bucket, writer)"
    ),
    # Each recording or import; its writer id is the upper half of the _seq of its rows.
    "cr_run": (
        "node text, writer bigint, kind text, name text, source text, format text, "
        "host text, started timestamp, ended timestamp, labels frozen<map<text, text>>, "
        "stored frozen<map<text, bigint>>, lost frozen<map<text, bigint>>, "
        "PRIMARY KEY ((writer), node)"
    ),
}
_COMMENT = "cassandra_ros side table, schema version 1"


def keyspaceExists(cassandra: Cassandra, keyspace: str) -> bool:
    """Say whether the cluster has this keyspace."""
    return bool(
        cassandra.execute(
            "SELECT keyspace_name FROM system_schema.keyspaces WHERE keyspace_name = ?",
            (checkKeyspace(keyspace),),
            what=f"looking for keyspace {keyspace}",
        )
    )


def makeKeyspace(cassandra: Cassandra, keyspace: str) -> None:
    """Make a keyspace and its side tables where they are missing (design: factor min(3, nodes)).

    Warns when the replication factor of an existing one is below min(3, nodes).
    """
    wanted = min(3, cassandra.liveNodes())
    if not keyspaceExists(cassandra, keyspace):
        replication = (
            f"{{'class': 'NetworkTopologyStrategy', "
            f"{quoteText(cassandra.localDatacenter())}: {wanted}}}"
        )
        cassandra.schemaChange(
            f"CREATE KEYSPACE IF NOT EXISTS {quoteName(keyspace)} WITH replication = {replication}",
            what=f"making keyspace {keyspace}",
        )
    _warnOfFactor(cassandra, keyspace, wanted)
    missing = ({_LOCK, *SIDE_TABLES}) - _tables(cassandra, keyspace)
    if _LOCK in missing:
        _makeLockTable(cassandra, keyspace)
    if missing - {_LOCK}:
        with SchemaLock(cassandra, keyspace) as lock:
            for name in sorted(set(SIDE_TABLES) - _tables(cassandra, keyspace)):
                lock.renew()
                cassandra.schemaChange(
                    f"CREATE TABLE IF NOT EXISTS {quoteName(keyspace)}.{name} "
                    f"({SIDE_TABLES[name]}) WITH comment = {quoteText(_COMMENT)}",
                    what=f"making table {name}",
                )


def _makeLockTable(cassandra: Cassandra, keyspace: str) -> None:
    # The lock cannot guard its own making. A fixed id lets racing clients make the same table,
    # and its columns never change; it is never dropped while the keyspace stands.
    table_id = uuid.uuid5(uuid.NAMESPACE_URL, f"cassandra_ros/{keyspace}/{_LOCK}")
    cassandra.schemaChange(
        f"CREATE TABLE IF NOT EXISTS {quoteName(keyspace)}.{_LOCK} ({_LOCK_COLUMNS}) "
        f"WITH id = {table_id} AND gc_grace_seconds = 3600",
        what=f"making table {_LOCK}",
    )


def _tables(cassandra: Cassandra, keyspace: str) -> set[str]:
    rows = cassandra.execute(
        "SELECT table_name FROM system_schema.tables WHERE keyspace_name = ?",
        (keyspace,),
        what=f"listing the tables of keyspace {keyspace}",
    )
    return {row[0] for row in rows}


def _warnOfFactor(cassandra: Cassandra, keyspace: str, wanted: int) -> None:
    rows = cassandra.execute(
        "SELECT replication FROM system_schema.keyspaces WHERE keyspace_name = ?",
        (keyspace,),
        what=f"reading the replication of keyspace {keyspace}",
    )
    if not rows:
        raise KeyspaceNotFound(f"keyspace {keyspace} is gone; connectToKeyspace makes it anew")
    factors = [int(v) for k, v in rows[0][0].items() if k != "class" and str(v).isdigit()]
    if factors and min(factors) < wanted:
        _log.warning(
            "keyspace %s keeps %d copies of each row where this cluster could keep %d; "
            "a lost node loses data: ALTER KEYSPACE … WITH replication, then repair",
            keyspace,
            min(factors),
            wanted,
        )
