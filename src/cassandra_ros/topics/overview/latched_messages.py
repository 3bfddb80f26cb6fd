# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Latched messages: those that a subscriber at a past time would have received first.

A connection is latched if its header says ``latching=1``. A late subscriber of such a topic gets
the last message of each publisher. So a time range that is played or exported needs these messages
from before the range, of the runs that have messages in the range.
"""

from __future__ import annotations

import logging
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Callable, Dict, Iterable, Iterator, Protocol, Sequence, Tuple, TypeVar

from cassandra_ros.arguments import check_topics
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import EVERYBODY, LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.directory import STALE_SEC, BucketRow
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)

Source = Tuple[str, int]
"""nodeID and writer id of a run."""
Publisher = Tuple[Source, int]
"""A run, and the number of one of its connections in a table."""
Tests = Dict[str, Callable[[StoredRow], bool]]
"""Topic → test whether a message is wanted; of topics that are not in it all messages are."""


class LatchedRow(Protocol):
    """What is asked of a row here, see StoredRow."""

    @property
    def node(self) -> str:
        """NodeID."""

    @property
    def seq(self) -> int:
        """Writer id << 32 | counter."""

    @property
    def conn(self) -> int:
        """Number of its connection."""

    @property
    def connection(self) -> Connection:
        """The connection."""

    @property
    def table(self) -> TopicTable:
        """Table of the message."""

    @property
    def arrival(self) -> tuple[int, str, int, str]:
        """Position of the row in the order of reads by receive time."""


_Row = TypeVar("_Row", bound=LatchedRow, covariant=True)


class Latched(Protocol[_Row]):
    """Finds latched messages, see LatchedFinder."""

    @property
    def latches(self) -> bool:
        """Whether there is a latched connection."""

    def is_latched(self, row: LatchedRow) -> bool:
        """Return whether a message came over a latched connection."""

    def before(self, t: int, to: int = LAST_NS) -> Sequence[_Row]:
        """Return the last latched message before t of each publisher with messages in [t, to]."""

    def sources(self, t: int, to: int) -> frozenset[Source]:
        """Return the runs that have messages of any topic in [t, to]."""

    def of_sources(self, sources: frozenset[Source], t: int, since: int = 0) -> Sequence[_Row]:
        """Return the last latched message in [since, t) of each publisher of some runs."""


def latched_before(
    catalog: Catalog,
    t: int,
    topics: Iterable[str] | None = None,
    *,
    to: int | None = None,
    nodeID: str | None = None,
    run: RunName = None,
    where: Conditions = None,
) -> list[StoredRow]:
    """Find the last latched message before a time of each publisher of some topics.

    Only runs (recordings, imports) that have messages of any topic in the time range that begins at
    t are searched. Rows of topics without latched connections are not read.

    Args:
        t: Receive time at which the range begins, ns; a message at t itself is in the range.
        topics: Names of topics; None = all.
        to: Last receive time of the range, ns; None = open.
        nodeID: nodeID whose messages are searched; None = all.
        run: Run whose messages are searched, by name or writer id; None = all.
        where: Topic → condition that the last message of the topic must satisfy.

    Returns:
        The rows in order of their receive times; their messages are fetched when accessed.

    Raises:
        TopicNotFound, RunNotFound: One of the topics, or the run, is not stored.
        InvalidName, InvalidQuery: As readMessages.
    """
    names, whose = check_topics(topics), catalog.whose(nodeID, run)
    finder = LatchedFinder(
        catalog.keyspace, catalog.tables(names), whose, tests_of(catalog, where, whose)
    )
    return finder.before(t, LAST_NS if to is None else to)


def tests_of(catalog: Catalog, where: Conditions, whose: Whose) -> Tests:
    """Return for each topic with a condition the test whether a row satisfies the condition."""
    return {name: f.test for name, f in catalog.filters(where, None, whose).items()}


class LatchedFinder:
    """Finds latched messages of some tables; caches which of their connections are latched.

    Args:
        keyspace: Keyspace of the tables.
        tables: Tables of the requested topics.
        whose: Nodes and writers whose messages are searched.
        tests: Topic → test whether a message is wanted.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        tables: Sequence[TopicTable],
        whose: Whose = EVERYBODY,
        tests: Tests | None = None,
    ) -> None:
        self._keyspace = keyspace
        self._tables = tables
        self._whose = whose
        self._tests = tests or {}

    @cached_property
    def _latched_connections(self) -> dict[str, frozenset[int]]:
        """Table → numbers of its latched connections."""
        connections: dict[str, set[int]] = {}
        names = {table.name for table in self._tables}
        for table, conn, connection in self._keyspace.connections.of_tables(names):
            if is_latched(connection):
                connections.setdefault(table, set()).add(conn)
        return {table: frozenset(conns) for table, conns in connections.items()}

    def of(self, whose: Whose) -> LatchedFinder:
        """Return a finder for other robots and writers of the same tables."""
        _ = self._latched_connections  # both have it then
        other = copy(self)
        other._whose = whose
        return other

    @property
    def latches(self) -> bool:
        """Whether the tables have a latched connection."""
        return bool(self._latched_connections)

    def is_latched(self, row: LatchedRow) -> bool:
        """Return whether a message came over a latched connection."""
        if row.table.name in {table.name for table in self._tables}:
            return row.conn in self._latched_connections.get(row.table.name, ())
        return is_latched(row.connection)  # the row's table has replaced one of them

    def before(self, t: int, to: int = LAST_NS) -> list[StoredRow]:
        """Return the last latched message before t of each publisher; see latched_before."""
        return self.of_sources(self.sources(t, to), t) if self.latches and t > 0 else []

    def of_sources(self, sources: frozenset[Source], t: int, since: int = 0) -> list[StoredRow]:
        """Return the last latched message in [since, t) of each publisher of some runs.

        They are in the order of their receive times, and satisfy the condition of their topic: if
        the last one does not, an earlier one is returned.
        """
        tables = [table for table in self._tables if table.name in self._latched_connections]
        rows = [row for table in tables for row in self._last(table, t, since, sources)]
        return sorted(rows, key=lambda row: row.arrival)

    def sources(self, t: int, to: int) -> frozenset[Source]:
        """Return the runs that have messages of any topic in [t, to]."""
        runs: set[Source] = set()
        # Over all topics: the requested topic may have been sent once, long before the range.
        for name, metadata in sorted(self._keyspace.schema.tables().items()):
            if metadata.named or metadata.own_time:
                continue  # their rows are not ordered by receive time
            length = metadata.bucket_ns
            ends, directory = (t // length, to // length), self._keyspace.directory
            entries = directory.buckets(name, metadata, *ends, self._whose.nodes)
            writers = self._whose.writers
            rows = [row for row in entries if writers is None or row.writer in writers]
            for row in self._count_open(name, metadata, rows):
                if not row.closed or (row.rows and row.t_min <= to and row.t_max >= t):
                    runs.add((row.node, row.writer))
        return frozenset(runs)

    def _count_open(
        self, name: str, metadata: TopicMetadata, rows: Sequence[BucketRow]
    ) -> list[BucketRow]:
        """Count the open buckets that a killed recorder left; living ones stay open."""
        stale_rows = [row for row in rows if not row.closed and row.age_sec > STALE_SEC]
        if not stale_rows:
            return list(rows)
        table = self._keyspace.tables.get(name, metadata)
        recounts = recount_open_buckets(self._keyspace.directory, table, stale_rows)
        others = [row for row in rows if row.closed or row.age_sec <= STALE_SEC]
        return [*others, *(row._replace(closed=True) for row in recounts)]

    def _last(
        self, table: TopicTable, t: int, since: int, sources: frozenset[Source]
    ) -> Iterable[StoredRow]:
        """Return the rows of of_sources of one table, in any order."""
        if table.named or table.metadata.own_time:
            return self._last_of_all(table, t, since, sources)
        return self._last_by_time(table, t, since, sources)

    def _last_by_time(
        self, table: TopicTable, t: int, since: int, sources: frozenset[Source]
    ) -> Iterator[StoredRow]:
        """Yield rows from newest to oldest until each latched connection of each run has one."""
        length, conns = table.metadata.bucket_ns, self._latched_connections[table.name]
        robots = tuple({node for node, _ in sources})
        buckets = self._keyspace.directory.buckets(
            table.name, table.metadata, since // length, (t - 1) // length, robots
        )
        # Only buckets that a run of the range has written to.
        entries = [row for row in buckets if (row.node, row.writer) in sources]
        if not entries:
            return
        missing = {((row.node, row.writer), conn) for row in entries for conn in conns}
        time_range = TimeRange(max(since, min(row.bucket for row in entries) * length), t - 1)
        whose = Whose(
            tuple({row.node for row in entries}), frozenset(row.writer for row in entries)
        )
        back = Read(time_range, whose, reverse=True, wanted=len(missing))
        for row in self._rows(table, back):
            publisher = publisher_of(row)
            if publisher in missing and self._passes(row):
                missing.discard(publisher)
                yield row
                if not missing:
                    return

    def _last_of_all(
        self, table: TopicTable, t: int, since: int, sources: frozenset[Source]
    ) -> Iterator[StoredRow]:
        """Return the rows of of_sources of a table whose key is not the receive time.

        All of its rows are read, because they are not in the order of receive times.
        """
        last: dict[Publisher, StoredRow] = {}
        conns = self._latched_connections[table.name]
        for row in self._rows(table, Read(whose=self._whose)):
            source, conn = publisher = publisher_of(row)
            if not since <= row.received < t or conn not in conns:
                continue
            # A row without a writer id is taken in any case: equal messages may share it.
            if source[1] and source not in sources:
                continue
            earlier = last.get(publisher)
            if (earlier is None or earlier.arrival < row.arrival) and self._passes(row):
                last[publisher] = row
        return iter(last.values())

    def _rows(self, table: TopicTable, read: Read) -> Iterator[StoredRow]:
        # The keys of rows are enough, unless there is a condition for the messages.
        columns = None if table.metadata.topic in self._tests else lambda table: ()
        return self._keyspace.rows.read([table], replace(read, columns=columns))

    def _passes(self, row: StoredRow) -> bool:
        """Return whether a message satisfies the condition of its topic."""
        test = self._tests.get(row.topic)
        return test is None or test(row)


_RowT = TypeVar("_RowT", bound=LatchedRow)


class LatchedRecord:
    """The latched messages of one source that were given already."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, Publisher], tuple[int, str, int, str]] = {}
        """Table and publisher → arrival of its message that was given last."""
        self._looked: dict[Source, int] = {}
        """For each robot and writer the time up to which latched messages were searched for, ns."""

    def changes(self, finder: Latched[_RowT], low: int, high: int) -> list[_RowT]:
        """Return the messages latched before ``low`` and not given yet; record them as given."""
        if not finder.latches:
            return []
        sources = finder.sources(low, high)
        # A run that was not met before is searched from the beginning.
        since = min((self._looked.get(source, 0) for source in sources), default=low)
        rows = [row for row in finder.of_sources(sources, low, since) if self._is_new(row)]
        for row in rows:
            self.note(row)
        self._looked.update(dict.fromkeys(sources, low))
        return rows

    def _is_new(self, row: LatchedRow) -> bool:
        """Return whether no message of this publisher that came as late was given yet."""
        last = self._last.get((row.table.name, publisher_of(row)))
        return last is None or last < row.arrival

    def note(self, row: LatchedRow) -> None:
        """Record a message as given."""
        self._last[row.table.name, publisher_of(row)] = row.arrival


def publisher_of(row: LatchedRow) -> Publisher:
    """Return the publisher of a message: its run, and the number of its connection in the table."""
    return (row.node, split_seq(row.seq)[0]), row.conn


def is_latched(connection: Connection) -> bool:
    """Return whether a connection's header has latching=1; False if the header is damaged."""
    try:
        return connection.latching
    except CorruptMessage as exc:
        _log.debug("topic %s is taken as not latched: %s", connection.topic, exc)
        return False
