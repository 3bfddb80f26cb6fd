# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stored messages of one topic, which a recorder may be writing at the same time."""

from __future__ import annotations

from typing import Iterator

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import StoredRow

RUNNING_REPORT_SEC = 25.0
"""Maximum age of a bucket's last report for its writer to count as running, s.

A writer reports on its open buckets every 10 s.
"""
_LOOK_BACK_NS = 86_400 * SECOND_NS
"""Maximum length of a bucket, ns: how far from now the open buckets are searched for."""


class StoredPast:
    """The stored messages of a topic in the order of reception.

    Args:
        catalog: Catalog of the open keyspace.
        topic: Name of the topic.
        node: nodeID of the robot whose messages are read; None = all robots.
        run: Name or writer id of the run whose messages are read; None = all runs.

    Raises:
        RunNotFound: The keyspace has no such run.
    """

    def __init__(
        self,
        catalog: Catalog,
        topic: str,
        node: str | None = None,
        run: None | str | int = None,
    ) -> None:
        catalog.keyspace.runs.writers(run)
        self.topic = topic
        self._catalog = catalog
        self._node = node
        self._run = run

    def _whose(self) -> Whose:
        # Asked anew each time: a run that goes on may get writers.
        return self._catalog.whose(self._node, self._run)

    def exists(self) -> bool:
        """Return whether the keyspace has the topic."""
        return self._catalog.exists(self.topic)

    def losses(self, low: int) -> list[Loss]:
        """List the losses of the topic from the time ``low`` on, ns."""
        read = Read(TimeRange(low), self._whose())
        return self._catalog.keyspace.runs.losses([self.topic], read)

    def rows(self, low: int, high: int | None = None) -> Iterator[StoredRow]:
        """Yield the rows received from ``low`` to ``high``, ns, both included; None = no end.

        A topic that is not stored has no rows.
        """
        if high is not None and high < low:
            return
        time_range = TimeRange(low, LAST_NS if high is None else high)
        read = Read(time_range, self._whose())
        try:
            yield from self._catalog.read([self.topic], read, received=True)
        except TopicNotFound:
            return

    def is_written(self, now_ns: int) -> bool:
        """Return whether a writer has an open bucket of the topic and reported on it recently."""
        try:
            tables = self._catalog.get(self.topic).tables
        except TopicNotFound:
            return False
        directory = self._catalog.keyspace.directory
        nodes, writers = self._whose()
        for table in tables:
            if table.named:
                continue
            first = table.bucket_of(max(0, now_ns - _LOOK_BACK_NS))
            last = table.bucket_of(now_ns + _LOOK_BACK_NS)
            buckets = directory.buckets(table.name, table.metadata, first, last, nodes)
            if any(
                not row.closed
                and row.age_sec < RUNNING_REPORT_SEC
                and (writers is None or row.writer in writers)
                for row in buckets
            ):
                return True
        return False

    def may_be_written(self) -> bool:
        """Return whether the keyspace has a recording that has not ended, of any topic.

        That of a recorder that was killed counts, too.
        """
        runs = self._catalog.keyspace.registry.runs()
        return any(run.kind == "recording" and run.ended is None for run in runs)
