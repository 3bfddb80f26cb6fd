# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The last messages before a moment: everything that a view of this moment has to show."""

from __future__ import annotations

from itertools import islice
from typing import Callable, Iterator, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.read import EVERYBODY, Read, TimeRange, Whose
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.overview.latched_messages import LatchedFinder, Source
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

TRANSFORM_TYPES = frozenset({"tf2_msgs/TFMessage", "tf/tfMessage"})
"""Types with a single message that holds only some of the frames."""
TRANSFORMS_NS = SECOND_NS
"""How far back to look for transforms, ns. A node that publishes /tf steadily sends every frame at
least once in this time."""
LATCHED_RUN_NS = 60 * SECOND_NS
"""Maximum distance between the moment and messages of a run whose latched messages hold then,
ns."""


class Latest:
    """Finds the last messages of some topics before a moment; caches the latched connections.

    Args:
        keyspace: Keyspace of the tables.
        tables: Tables of the topics. Tables of key format hash, whose messages have no time, are
            ignored.
        whose: Robots and runs whose messages count. Messages with names, such as maps, are not part
            of a recording: they count for every run, and also those without a nodeID count.
    """

    def __init__(
        self, keyspace: Keyspace, tables: Sequence[TopicTable], whose: Whose = EVERYBODY
    ) -> None:
        self._keyspace = keyspace
        self._whose = whose
        self._by_topic: dict[str, list[TopicTable]] = {}
        for table in tables:
            self._by_topic.setdefault(table.metadata.topic, []).append(table)
        timed = [table for table in tables if not table.named]
        self._latched = LatchedFinder(keyspace, timed, whose)

    def before(
        self, t: int, since: int = 0, sources: frozenset[Source] | None = None
    ) -> list[StoredRow]:
        """Return the last messages of each topic, in order of time.

        They are: the last message; for transforms all messages of the last second; for latched
        topics the last message of each publisher, however old; for topics with names the newest
        message of each name, or its first one if all were stored later.

        Args:
            t: The moment, ns; a message at t itself counts.
            since: Minimum time of messages that are not latched, ns.
            sources: Runs whose latched messages count; None = as sources_at finds them.
        """
        latest: dict[tuple[object, ...], StoredRow] = {}
        for rows in (self._last(t, since), self._latched_before(t, since, sources)):
            latest.update(((row.topic, *row.identity), row) for row in rows)
        return sorted(latest.values(), key=lambda row: row.position)

    def _last(self, t: int, since: int) -> Iterator[StoredRow]:
        """Yield the last messages of each topic, without regard to latched connections."""
        for tables in self._by_topic.values():
            timed = [table for table in tables if not table.named]
            manual = [table for table in tables if table.metadata.key_format == "manual"]
            if timed:
                yield from self._last_by_time(timed, t, since)
            if manual:
                yield from self._newest_of_names(manual, t)

    def _last_by_time(self, tables: Sequence[TopicTable], t: int, since: int) -> list[StoredRow]:
        """Return a topic's last message in [since, t], or its transforms of the last second."""
        rows = self._keyspace.rows
        if any(table.msg_type in TRANSFORM_TYPES for table in tables):
            steady = TimeRange(max(since, t - TRANSFORMS_NS), t)
            transforms = list(rows.read(tables, Read(steady, self._whose)))
            if transforms:
                return transforms
        near = rows.beside(tables, t, self._whose, [True])
        if near is None:
            back = Read(TimeRange(since, t), self._whose, reverse=True, wanted=1)
            near = list(islice(rows.read(tables, back), 1))
        return [row for row in near if row.t >= since]

    def _newest_of_names(self, tables: Sequence[TopicTable], t: int) -> Sequence[StoredRow]:
        """Return for each node and name the last row up to t, else the first one after t."""
        nodes = self._whose.nodes
        whose = Whose(None if nodes is None else (*nodes, ""))
        read = Read(whose=whose, columns=lambda table: ())
        newest: dict[tuple[str, str], StoredRow] = {}
        for row in self._keyspace.rows.read(tables, read):
            key = (row.node, row.name)
            if row.t <= t or key not in newest:
                newest[key] = row
        return list(newest.values())

    def sources(self, low: int, high: int) -> frozenset[Source]:
        """Return the runs that have messages of any topic in [low, high]."""
        return self._latched.sources(low, high)

    def _latched_before(
        self, t: int, since: int, sources: frozenset[Source] | None
    ) -> Sequence[StoredRow]:
        """Return the latched messages at or before t of the runs that count."""
        if not self._latched.latches:
            return []
        if sources is None:
            sources = sources_at(self.sources, t, since)
        return self._latched.of_sources(sources, t + 1)


def sources_at(
    find: Callable[[int, int], frozenset[Source]], t: int, since: int
) -> frozenset[Source]:
    """Return the runs whose latched messages hold at t: those around it or, without any, before it.

    Args:
        find: Returns the runs that have messages in a time range, ns.
        since: Start of the time range before t, ns.
    """
    return find(max(0, t - LATCHED_RUN_NS), t + LATCHED_RUN_NS) or find(since, t)
