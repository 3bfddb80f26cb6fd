# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows by whatever their topic's key is: found, walked through, counted, removed."""

from __future__ import annotations

from typing import Any, Iterator, Optional, Sequence

from cassandra_ros.errors import InvalidKey, MessageNotFound
from cassandra_ros.keys import RowName
from cassandra_ros.messages.stamps import Stamp, toNs
from cassandra_ros.topics.absence import absentName, absentText
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.selection import (
    LAST_NS,
    Named,
    Selection,
    Stretch,
    selectMany,
    selectOne,
)
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

NEAREST = ("before", "after", "either")


class Finder:
    """Knows what a key means in one topic.

    Args:
        keyspace: Where.
        topic: The topic's name.
        key_format: The topic's.
        tables: Its tables.
        nodeID: Only messages of this node; None = of all.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        topic: str,
        key_format: str,
        tables: Sequence[TopicTable],
        nodeID: Optional[str],
    ) -> None:
        self._keyspace = keyspace
        self._topic = topic
        self._key_format = key_format or "time"
        self._tables = tables
        self._node = nodeID
        self._nodes = None if nodeID is None else (nodeID,)

    def many(
        self, key: Any, to_key: Any, *, limit: Optional[int] = None, reverse: bool = False
    ) -> Iterator[StoredRow]:
        """Walk through the rows that key and to_key mean, as the ends of a stretch or alone."""
        wanted = self._several(key, to_key)
        return self._keyspace.rows.select(
            self._tables, wanted, nodes=self._nodes, limit=limit, reverse=reverse
        )

    def count(self, key: Any, to_key: Any) -> int:
        """Count the rows of ``many``, of a stretch of time without reading them."""
        wanted = self._several(key, to_key)
        if isinstance(wanted, Stretch):
            return self._keyspace.totals.count(self._tables, *wanted, self._nodes)
        rows = self._keyspace.rows.select(self._tables, wanted, nodes=self._nodes)
        return sum(1 for _ in rows)

    def remove(self, key: Any, to_key: Any) -> int:
        """Delete the rows at key, or those of ``many`` where to_key is given; return how many.

        Raises:
            MessageNotFound: There is none at key (without to_key).
        """
        removal = self._keyspace.removal
        if to_key is None and self.isExact(key):
            row = self.find(key, None)
            count = 0 if row is None else removal.deleteRow(row)
        else:
            wanted = self._one(key) if to_key is None else self._several(key, to_key)
            if isinstance(wanted, Stretch):
                count = removal.delete(self._tables, *wanted, self._nodes)
            else:
                rows = self._keyspace.rows.select(self._tables, wanted, nodes=self._nodes)
                count = sum(removal.deleteRow(row) for row in rows)
        if not count and to_key is None:
            raise MessageNotFound(self.absent(key, None))
        return count

    def _one(self, key: Any) -> Selection:
        return selectOne(self._topic, self._key_format, self._tables, key)

    def _several(self, key: Any, to_key: Any) -> Selection:
        return selectMany(self._topic, self._key_format, self._tables, key, to_key)

    def find(self, key: Any, nearest: Optional[str]) -> Optional[StoredRow]:
        """Find the one row that getData means by a key; None where there is none."""
        if nearest is not None:
            return self._near(key, nearest)
        if self.isExact(key):
            table = self._keyspace.tables.byName(key.table)
            if table is not None and table.metadata.topic == self._topic:
                return self._keyspace.rows.exact(table, key)
        wanted = self._one(key)
        rows = self._keyspace.rows
        if isinstance(wanted, Stretch):
            return rows.at(self._tables, wanted.low, self._nodes)
        newest = isinstance(wanted, Named)  # of several versions; of equal values the first
        found = rows.select(self._tables, wanted, nodes=self._nodes, reverse=newest, limit=1)
        return next(found, None)

    def isExact(self, key: Any) -> bool:
        """Say whether a key is one that the store gave: it knows its row."""
        known = isinstance(key, (RowName, Stamp)) and bool(key.table)
        return known and self._node in (None, key.node)

    def _near(self, key: Any, nearest: str) -> Optional[StoredRow]:
        if nearest not in NEAREST:
            raise InvalidKey(f"nearest={nearest!r} is none of {', '.join(NEAREST)}")
        wanted = self._one(key)
        if not isinstance(wanted, Stretch):
            kind = "names" if isinstance(wanted, Named) else "values of a field"
            raise InvalidKey(
                f"the keys of topic {self._topic} are {kind}, which have no order: none is "
                "nearest; leave nearest out"
            )
        t, rows = toNs(key), self._keyspace.rows
        before = after = None
        if nearest != "after":
            back: Any = rows.read(self._tables, 0, t, nodes=self._nodes, limit=1, reverse=True)
            before = next(back, None)
        if nearest != "before":
            after = next(rows.read(self._tables, t, LAST_NS, nodes=self._nodes, limit=1), None)
        if before is None or after is None:
            return before or after
        return before if t - before.t <= after.t - t else after

    def absent(self, key: Any, nearest: Optional[str]) -> str:
        """Say that there is no message at a key, and what lies near."""
        wanted = self._one(key)
        if not isinstance(wanted, Stretch):
            return absentName(self._topic, key, self._node, isinstance(wanted, Named))
        near = self._near(toNs(key), "either") if nearest is None else None
        near_ns = None if near is None else near.t
        return absentText(self._topic, key, nearest, self._node, near_ns)
