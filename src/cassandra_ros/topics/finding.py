# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows by whatever their topic's key is: found, walked through, counted, removed."""

from __future__ import annotations

from itertools import islice
from typing import Any, Callable, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.arguments import check_limit, check_nodes
from cassandra_ros.errors import InvalidKey, InvalidQuery, MessageNotFound
from cassandra_ros.keys import RowName
from cassandra_ros.messages.stamps import Stamp, isoTime, toNs
from cassandra_ros.query.conditions import Condition
from cassandra_ros.query.protocols import Source, Table
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.selection import (
    LAST_NS,
    AnyKey,
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
        where: Only messages that pass it; None = all.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        topic: str,
        key_format: str,
        tables: Sequence[TopicTable],
        nodeID: Optional[str],
        where: Optional[Filter] = None,
    ) -> None:
        self._keyspace = keyspace
        self._topic = topic
        self._key_format = key_format
        self._tables = tables
        self._node = nodeID
        self._where = where
        self._nodes = check_nodes(nodeID)

    def many(
        self,
        key: AnyKey,
        to_key: AnyKey,
        *,
        limit: Optional[int] = None,
        reverse: bool = False,
    ) -> Iterator[StoredRow]:
        """Walk through the rows that key and to_key mean, as the ends of a stretch or alone."""
        return self._select(self._several(key, to_key), limit=limit, reverse=reverse)

    def _select(
        self,
        wanted: Selection,
        *,
        reverse: bool = False,
        limit: Optional[int] = None,
        bare: bool = False,
    ) -> Iterator[StoredRow]:
        check_limit(limit)
        if self._where is None:
            return self._keyspace.rows.select(
                self._tables, wanted, nodes=self._nodes, limit=limit, reverse=reverse
            )
        if isinstance(wanted, Stretch):
            return islice(self._where.rows(*wanted, reverse=reverse, bare=bare), limit)
        rows = self._keyspace.rows.select(self._tables, wanted, nodes=self._nodes, reverse=reverse)
        return islice(filter(self._where.test, rows), limit)

    def columns(
        self, key: AnyKey, to_key: AnyKey, columns: Callable[[Table], Sequence[str]]
    ) -> Iterator[StoredRow]:
        """Walk through the rows of ``many``; of a stretch of time only these columns are read."""
        wanted = self._several(key, to_key)
        if self._where is not None or not isinstance(wanted, Stretch):
            return self._select(wanted)
        return self._keyspace.rows.read(self._tables, wanted, nodes=self._nodes, columns=columns)

    def count(self, key: AnyKey, to_key: AnyKey) -> int:
        """Count the rows of ``many``, of a whole stretch of time without reading them."""
        wanted = self._several(key, to_key)
        if isinstance(wanted, Stretch) and self._where is None:
            return self._keyspace.totals.count(self._tables, *wanted, self._nodes)
        return sum(1 for _ in self._select(wanted, bare=True))

    def remove(self, key: AnyKey, to_key: AnyKey) -> int:
        """Delete the rows at key, or those of ``many`` without key or with to_key.

        Returns:
            How many.

        Raises:
            MessageNotFound: There is none at key (without to_key).
            InvalidKey: Nothing says which.
        """
        if key is None and to_key is None and self._where is None:
            raise InvalidKey(
                "removeData needs a key (and to_key for a stretch of time), or where=; "
                f"truncateTopic removes all messages of topic {self._topic}"
            )
        single = key is not None and to_key is None
        count = self._remove(key, to_key, single)
        if single and not count:
            raise MessageNotFound(self.absent(key, None))
        return count

    def _remove(self, key: AnyKey, to_key: AnyKey, single: bool) -> int:
        removal = self._keyspace.removal
        if single and self.isExact(key):
            row = self._exact(key)  # and no other of the same time
            return 0 if row is None else removal.deleteRows([row])
        wanted = self._one(key) if single else self._several(key, to_key)
        if isinstance(wanted, Stretch) and self._where is None:
            return removal.delete(self._tables, *wanted, self._nodes)
        return removal.deleteRows(self._select(wanted, bare=True))

    def _one(self, key: AnyKey) -> Selection:
        return selectOne(self._topic, self._key_format, self._tables, key)

    def _several(self, key: AnyKey, to_key: AnyKey) -> Selection:
        return selectMany(self._topic, self._key_format, self._tables, key, to_key)

    def find(self, key: AnyKey, nearest: Optional[str]) -> Optional[StoredRow]:
        """Find the one row that getData means by a key; None where there is none."""
        if nearest is not None:
            return self._near(key, nearest)
        if self.isExact(key) and self._tableOf(key) is not None:
            return self._exact(key)
        wanted = self._one(key)
        if isinstance(wanted, Stretch):
            return self._at(wanted.low)
        newest = isinstance(wanted, Named)  # of several versions; of equal values the first
        return next(self._select(wanted, reverse=newest, limit=1), None)

    def _at(self, t: int) -> Optional[StoredRow]:
        """Find the row at a time, ns: of several the first in the order of all reads."""
        if self._where is None:
            return self._keyspace.rows.at(self._tables, t, self._nodes)
        return next(self._select(Stretch(t, t), limit=1), None)

    def _tableOf(self, key: AnyKey) -> Optional[TopicTable]:
        """Return the table in which a key of ours lies; None where it is gone."""
        table = self._keyspace.tables.byName(key.table)
        return table if table is not None and table.metadata.topic == self._topic else None

    def _exact(self, key: AnyKey) -> Optional[StoredRow]:
        table = self._tableOf(key)
        return None if table is None else self._passing(self._keyspace.rows.exact(table, key))

    def _passing(self, row: Optional[StoredRow]) -> Optional[StoredRow]:
        if row is None or self._where is None or self._where.test(row):
            return row
        return None

    def isExact(self, key: AnyKey) -> bool:
        """Say whether a key is one that the store gave: it knows its row."""
        known = isinstance(key, (RowName, Stamp)) and bool(key.table)
        return known and self._node in (None, key.node)

    def _near(self, key: AnyKey, nearest: str) -> Optional[StoredRow]:
        if nearest not in NEAREST:
            raise InvalidKey(f"nearest={nearest!r} is none of {', '.join(NEAREST)}")
        wanted = self._one(key)
        if not isinstance(wanted, Stretch):
            kind = "names" if isinstance(wanted, Named) else "values of a field"
            raise InvalidKey(
                f"the keys of topic {self._topic} are {kind}, which have no order: none is "
                "nearest; leave nearest out"
            )
        t, low = toNs(key), 0
        before = after = None
        if nearest != "before":
            after = next(self._select(Stretch(t, LAST_NS), limit=1), None)
            if after is not None and nearest == "either":
                low = max(0, t - (after.t - t))  # what lies before that is further away
        if nearest != "after":
            before = next(self._select(Stretch(low, t), limit=1, reverse=True), None)
        # Backwards the last of equal stamps comes first.
        return after if before is None else self._at(before.t) or before

    def absent(self, key: AnyKey, nearest: Optional[str]) -> str:
        """Say that there is no message at a key, and what lies near."""
        wanted = self._one(key)
        which = _which(self._node, self._where)
        if not isinstance(wanted, Stretch):
            return absentName(self._topic, key, which, isinstance(wanted, Named))
        # The nearest that satisfies a condition may be far, and long to look for.
        look = nearest is None and self._where is None
        near = self._near(toNs(key), "either") if look else None
        return absentText(self._topic, key, nearest, which, None if near is None else near.t)


def _which(nodeID: Optional[str], where: Optional[Filter]) -> str:
    """Say which messages were asked for, besides their key."""
    whose = "" if nodeID is None else f" of node {nodeID}"
    return whose if where is None else f"{whose} that satisfies {where.text!r:.200}"


_SECONDS_BELOW = 10**12
_NEAR_NS = 256
"""Nanoseconds that a time of today may lose on its way through a float."""


def absentText(
    topic: str, key: AnyKey, nearest: Optional[str], which: str, near_ns: Optional[int]
) -> str:
    """Say that a topic has no message at a key.

    Args:
        topic: Its name.
        key: The time as it was asked for.
        nearest: The direction that was asked for, or None.
        which: Which messages were asked for, as ' of node r1'; '' = any.
        near_ns: Time of the nearest message where that is known, ns.
    """
    t = toNs(key)
    text = f"topic {topic} has no message{which} {nearest or 'at'} {isoTime(t)} ({t} ns)"
    if isinstance(key, int) and 0 < t < _SECONDS_BELOW:
        return text + "; integers are nanoseconds; did you mean seconds (a float)?"
    if near_ns is None:
        return text
    if abs(near_ns - t) <= _NEAR_NS:
        secs, nsecs = divmod(near_ns, 10**9)
        return text + (
            f"; one lies {abs(near_ns - t)} ns away: write the time as "
            f"{{secs: {secs}, nsecs: {nsecs}}}, for a number goes through a float"
        )
    return text + f"; the nearest lies at {isoTime(near_ns)} ({near_ns} ns)"


def absentName(topic: str, key: AnyKey, which: str, named: bool) -> str:
    """Say that a topic has no message under a name, or none with a value.

    Args:
        topic: Its name.
        key: As it was asked for.
        which: Which messages were asked for, as ' of node r1'; '' = any.
        named: Whether it is a name.
    """
    if not named:
        return f"topic {topic} has no message{which} whose key field is {key!r:.80}"
    return (
        f"topic {topic} has no message{which} under the name {str(key)[:80]!r}; "
        "items() lists the names that there are"
    )


Where = Union[str, Tuple[str, Sequence[Any]]]
"""A condition: what stands behind WHERE in CQL, or that and the values of its ``?``."""


class Filter:
    """The rows of one topic that satisfy a condition.

    A message satisfies a condition on the elements of an array of messages when one element does.

    Args:
        topic: Whose rows.
        where: The condition.
        nodeID: Only messages of this node; None = of all.

    Attributes:
        text: The condition as it was given.
        test: Tells whether a row of the topic satisfies it, whatever its node.

    Raises:
        InvalidQuery: It is no condition, or none on the topic's fields.
    """

    def __init__(
        self, topic: Source[StoredRow], where: Where, nodeID: Optional[str] = None
    ) -> None:
        self.text, params = _parts(where)
        self._topic = topic
        self._condition = Condition(self.text, params, nodeID)
        self.test = self._condition.test(topic.tables)

    def rows(
        self, low: int = 0, high: int = LAST_NS, *, reverse: bool = False, bare: bool = False
    ) -> Iterator[StoredRow]:
        """Walk through the rows with t in [low, high], ns, that satisfy it, in order of time.

        Args:
            low, high: Both included.
            reverse: Newest first.
            bare: Only keys are wanted, no messages.
        """
        return self._condition.rows(self._topic, low, high, reverse=reverse, bare=bare)


def _parts(where: object) -> Tuple[str, Sequence[Any]]:
    if isinstance(where, str):
        return where, ()
    if isinstance(where, (tuple, list)) and len(where) == 2 and isinstance(where[0], str):
        return where[0], where[1]
    raise InvalidQuery(
        repr(where)[:200], 0, "where= takes a condition as text, or a pair (text, parameters)"
    )
