# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The directory: which buckets a table has, by node, and what lies in each.

A bucket's row is written *open* before its first data row, so the directory always lists a
superset of what is there. The values of a row count only when it is *closed*; of an open one
they are estimates. Heartbeats are the server's time: robots' clocks are wrong.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Iterable, NamedTuple, Sequence

from cassandra_ros.store.buckets import slotOf
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.names import quoteName
from cassandra_ros.store.patience import RETRY_SEC
from cassandra_ros.store.side_tables import SideTables

STALE_SEC = 60.0
"""An open bucket whose heartbeat is older than this has no living writer."""
HEARTBEAT_SEC = 10.0
TTL_MARGIN_SEC = 900
"""How much longer than its rows a bucket is listed: so long a row may be tried."""
CLOCKS_SEC = 2.0
"""How far the clocks of two servers may be apart."""


class BucketRow(NamedTuple):
    """What one writer put into one bucket."""

    node: str
    bucket: int
    writer: int
    closed: bool
    """The values hold."""
    heartbeat: Any
    rows: int
    bytes: int
    largest: int
    """Size of the largest message kept in its row, bytes."""
    t_min: int
    t_max: int
    odd: int
    age_sec: float
    """Seconds since the heartbeat, by the server's clock."""
    filled: frozenset[str] = frozenset()
    """Shadow columns that are filled in all rows of this writer in the bucket."""

    def expired(self, ttl: int) -> bool:
        """Say whether all rows of this writer in the bucket have outlived their ttl, seconds."""
        # A bucket is closed behind its last row; while it is open rows may come that were tried
        # for minutes.
        margin = CLOCKS_SEC if self.closed else TTL_MARGIN_SEC
        return self.age_sec > ttl + margin


@dataclass
class Totals:
    """Values of a bucket that a writer closes."""

    rows: int = 0
    bytes: int = 0
    largest: int = 0
    t_min: int = 2**63 - 1
    t_max: int = -1
    odd: int = 0

    def count(self, t: int, size: int, chunked: bool, odd: bool) -> None:
        """Add one row."""
        self.rows += 1
        self.bytes += size
        self.t_min = min(self.t_min, t)
        self.t_max = max(self.t_max, t)
        self.odd += odd
        if not chunked:
            self.largest = max(self.largest, size)


class Directory:
    """Reads and writes cr_node and cr_bucket of one keyspace."""

    def __init__(self, cassandra: Cassandra, side_tables: SideTables) -> None:
        self._cassandra = cassandra
        self._side_tables = side_tables
        self._retry_sec = RETRY_SEC
        space = quoteName(side_tables.keyspace)
        self._nodes = (
            f"SELECT slot, node FROM {space}.cr_node WHERE tbl = ? AND slot >= ? AND slot <= ?"
        )
        self._add_node = (
            f"INSERT INTO {space}.cr_node (tbl, slot, node) VALUES (?, ?, ?) USING TTL ?"
        )
        self._buckets = (
            "SELECT bucket, writer, state, heartbeat, n, bytes, largest, t_min, t_max, odd, "
            f"deleted, filled, toTimestamp(now()) FROM {space}.cr_bucket "
            "WHERE tbl = ? AND node = ? AND slot = ? AND bucket >= ? AND bucket <= ?"
        )
        self._values = (
            f"INSERT INTO {space}.cr_bucket (tbl, node, slot, bucket, writer, state, heartbeat, "
            "filled, n, bytes, largest, t_min, t_max, odd) "
            "VALUES (?, ?, ?, ?, ?, ?, toTimestamp(now()), ?, ?, ?, ?, ?, ?, ?) USING TTL ?"
        )
        self._reopen = (
            f"INSERT INTO {space}.cr_bucket (tbl, node, slot, bucket, writer, state, heartbeat, "
            "filled) VALUES (?, ?, ?, ?, ?, 'open', toTimestamp(now()), ?) USING TTL ?"
        )
        self._deleted = (
            f"INSERT INTO {space}.cr_bucket (tbl, node, slot, bucket, writer, state, heartbeat, "
            "deleted) VALUES (?, ?, ?, ?, ?, 'open', toTimestamp(now()), true) USING TTL ?"
        )
        self._recount = (
            f"UPDATE {space}.cr_bucket USING TTL ? SET state = 'closed', filled = ?, "
            "n = ?, bytes = ?, largest = ?, t_min = ?, t_max = ?, odd = ?, deleted = false, "
            "heartbeat = toTimestamp(now()) "
            "WHERE tbl = ? AND node = ? AND slot = ? AND bucket = ? AND writer = ? "
            "IF heartbeat = ?"
        )
        self._drop = f"DELETE FROM {space}.cr_bucket WHERE tbl = ? AND node = ? AND slot = ?"
        self._drop_node = f"DELETE FROM {space}.cr_node WHERE tbl = ?"

    def patient(self, retry_sec: float) -> Directory:
        """Return the same directory for a writer that tries for so many seconds."""
        directory = copy(self)
        directory._retry_sec = retry_sec
        return directory

    def _run(self, cql: str, params: Sequence[Any], what: str) -> list[tuple[Any, ...]]:
        return self._cassandra.execute(cql, params, what=what, retry_sec=self._retry_sec)

    def nodes(self, table: str, first_slot: int, last_slot: int) -> list[tuple[int, str]]:
        """List the (slot, node) of a table in [first_slot, last_slot]."""
        if not self._side_tables.has("cr_node"):
            return []
        rows = self._run(
            self._nodes, (table, first_slot, last_slot), what="reading the directory of nodes"
        )
        return [(row[0], row[1]) for row in rows]

    def buckets(
        self,
        table: str,
        first: int,
        last: int,
        nodes: Sequence[str] | None = None,
        ttl: int = 0,
    ) -> list[BucketRow]:
        """List the buckets of a table in [first, last], one row for each writer.

        Args:
            nodes: Only these nodeIDs; None = all.
            ttl: Of the table's rows, seconds: buckets in which all have expired are left out.
        """
        if not self._side_tables.has("cr_bucket"):
            return []
        found = [
            (slot, node)
            for slot, node in self.nodes(table, slotOf(first), slotOf(last))
            if nodes is None or node in nodes
        ]
        answers = self._cassandra.executeMany(
            self._buckets,
            [(table, node, slot, first, last) for slot, node in found],
            what="reading the directory of buckets",
        )
        every = [_bucketRow(node, row) for (_, node), rows in zip(found, answers) for row in rows]
        return every if not ttl else [row for row in every if not row.expired(ttl)]

    def find(self, table: str, node: str, bucket: int) -> list[BucketRow]:
        """List the writers of one bucket."""
        if not self._side_tables.has("cr_bucket"):
            return []
        rows = self._run(
            self._buckets,
            (table, node, slotOf(bucket), bucket, bucket),
            what="reading the directory of buckets",
        )
        return [_bucketRow(node, row) for row in rows]

    def addNode(self, table: str, slot: int, node: str, ttl: int = 0) -> None:
        """Note that a node has buckets in this slot; before the first of them.

        Args:
            ttl: Seconds until the last row in the slot may have expired; 0 = never.
        """
        params = (table, slot, node, _ttl(ttl))
        self._run(self._add_node, params, what="writing the directory of nodes")

    def markDeleted(self, table: str, node: str, bucket: int, writer: int, ttl: int) -> None:
        """Mark a bucket as deleted from: no count holds until the next recount.

        A flag of its own, for a living writer closes the bucket with the counts of what it wrote.
        """
        self._run(
            self._deleted,
            (table, node, slotOf(bucket), bucket, writer, _ttl(ttl)),
            what="marking a bucket in the directory",
        )

    def open(
        self,
        table: str,
        node: str,
        bucket: int,
        writer: int,
        ttl: int,
        filled: Iterable[str] = (),
    ) -> None:
        """Mark a bucket as being written, with a fresh heartbeat.

        Args:
            filled: Shadow columns that all of the writer's rows in it have, and will have.
        """
        self._run(
            self._reopen,
            (table, node, slotOf(bucket), bucket, writer, set(filled), _ttl(ttl)),
            what="opening a bucket in the directory",
        )

    def put(
        self,
        table: str,
        node: str,
        bucket: int,
        writer: int,
        totals: Totals,
        closed: bool,
        ttl: int,
        filled: Iterable[str] = (),
    ) -> None:
        """Write the values of a bucket: final when closed, else estimates with a heartbeat.

        Args:
            filled: As in open.
        """
        self._run(
            self._values,
            (
                *(table, node, slotOf(bucket), bucket, writer, "closed" if closed else "open"),
                *(set(filled), *_values(totals)),
                _ttl(ttl),
            ),
            what="writing the directory of buckets",
        )

    def putRecount(self, table: str, row: BucketRow, totals: Totals, ttl: int) -> bool:
        """Close a bucket that has no living writer, unless something has changed in it meanwhile.

        Args:
            row: As it was read before the rows were.
            totals: What was counted.

        Returns:
            Whether it was done.
        """
        answer = self._cassandra.executeOnce(
            self._recount,
            (
                *(_ttl(ttl), set(row.filled), *_values(totals)),
                *(table, row.node, slotOf(row.bucket), row.bucket, row.writer, row.heartbeat),
            ),
            what="closing a bucket in the directory",
        )
        return bool(answer[0][0])

    def forget(self, table: str) -> None:
        """Remove all that is known of a table that was dropped."""
        for slot, node in self.nodes(table, -(2**63), 2**63 - 1):
            self._run(self._drop, (table, node, slot), what="clearing the directory of buckets")
        self._run(self._drop_node, (table,), what="clearing the directory")


def _ttl(ttl: int) -> int:
    return ttl + TTL_MARGIN_SEC if ttl else 0


def _values(totals: Totals) -> tuple[int, ...]:
    return (
        *(totals.rows, totals.bytes, totals.largest),
        *(totals.t_min, totals.t_max, totals.odd),
    )


def _bucketRow(node: str, row: tuple[Any, ...]) -> BucketRow:
    bucket, writer, state, heartbeat, n, size, largest, t_min, t_max, odd, *rest = row
    deleted, filled, now = rest
    age = (now - heartbeat).total_seconds() if heartbeat is not None else STALE_SEC + 1
    return BucketRow(
        *(node, bucket, writer, state == "closed" and not deleted, heartbeat),
        *(n or 0, size or 0, largest or 0, t_min or 0, t_max if t_max is not None else -1),
        *(odd or 0, age, frozenset(filled or ())),
    )
