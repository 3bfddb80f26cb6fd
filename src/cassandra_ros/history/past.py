# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is stored of one topic while somebody may be writing it."""

from __future__ import annotations

from typing import Iterator, List, Optional, Union

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.tables.registry import Loss
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import StoredRow

FRESH_SEC = 25.0
"""A writer says every 10 s that it lives, while it writes."""
_LOOK_BACK_NS = 86_400 * SECOND_NS
"""No bucket is longer."""


class Past:
    """The stored messages of a topic, by the time of reception.

    Args:
        catalog: Where it is stored.
        topic: Its name.
        node: Only messages of this nodeID; None = of all.
        run: Only messages of this run, by name or writer id; None = of all.

    Raises:
        RunNotFound: There is no such run.
    """

    def __init__(
        self,
        catalog: Catalog,
        topic: str,
        node: Optional[str] = None,
        run: Union[None, str, int] = None,
    ) -> None:
        catalog.keyspace.runs.writers(run)
        self.topic = topic
        self._catalog = catalog
        self._node = node
        self._run = run

    def exists(self) -> bool:
        """Say whether the topic is stored at all."""
        return self._catalog.exists(self.topic)

    def losses(self, low: int) -> List[Loss]:
        """List what was not recorded of the topic since a time, ns."""
        return self._catalog.losses([self.topic], low, None, self._node, self._run)

    def rows(self, low: int, high: Optional[int] = None) -> Iterator[StoredRow]:
        """Yield what was received in [low, high], ns; nothing of a topic that is not stored."""
        if high is not None and high < low:
            return
        # As stamps: an int near 0, a simulation's time, might be refused as seconds.
        first, last = Stamp.from_ns(low), None if high is None else Stamp.from_ns(high)
        try:
            yield from self._catalog.read(
                [self.topic], first, last, node=self._node, received=True, run=self._run
            )
        except TopicNotFound:
            return

    def is_written(self, now_ns: int) -> bool:
        """Say whether somebody has written the topic just now."""
        try:
            tables = self._catalog.get(self.topic).tables
        except TopicNotFound:
            return False
        directory = self._catalog.keyspace.directory
        writers = self._catalog.keyspace.runs.writers(self._run)
        nodes = None if self._node is None else (self._node,)
        for table in tables:
            if table.named:
                continue
            first = table.bucket_of(max(0, now_ns - _LOOK_BACK_NS))
            last = table.bucket_of(now_ns + _LOOK_BACK_NS)
            buckets = directory.buckets(table.name, first, last, nodes)
            if any(
                not row.closed
                and row.age_sec < FRESH_SEC
                and (writers is None or row.writer in writers)
                for row in buckets
            ):
                return True
        return False

    def may_be_written(self) -> bool:
        """Say whether a recording has begun in the keyspace that has not ended."""
        runs = self._catalog.keyspace.registry.runs()
        return any(run.kind == "recording" and run.ended is None for run in runs)
