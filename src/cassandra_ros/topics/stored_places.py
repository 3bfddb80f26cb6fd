# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A keyspace as places/ sees it: its topics, and the times of messages of a run."""

from __future__ import annotations

from itertools import islice
from typing import Callable, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.array_source import ArraySource, Extent
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.tables.directory import BucketRow
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable

_LONG_NS = 600 * SECOND_NS
"""Length of a bucket, ns, above which the times of the messages in an open bucket are read."""


class StoredPlaces:
    """The topics of a keyspace, for lookups of the robots' places."""

    def __init__(
        self,
        keyspace: Keyspace,
        find: Callable[[str], CassandraTopic],
        topics: Callable[[], Sequence[CassandraTopic]],
    ) -> None:
        self._keyspace = keyspace
        self._find = find
        self._topics = topics

    def find(self, name: str) -> CassandraTopic:
        """Return a topic by its name; raises TopicNotFound."""
        return self._find(name)

    def topics(self) -> Sequence[CassandraTopic]:
        """Return all topics, sorted by name."""
        return self._topics()

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """Return the nodeIDs that have messages of a topic, sorted."""
        return self._keyspace.nodes(self._tables(topic))

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """Return the time ranges of a topic's messages by run of a node that meet [low, high]."""
        directory, whose = self._keyspace.directory, Whose([node])

        def read_extents(tables: Sequence[TopicTable]) -> list[Extent]:
            extents = []
            for table in tables:
                if table.named:
                    continue
                buckets = (table.bucket_of(max(0, low)), table.bucket_of(high))
                for row in buckets_of(directory, table, whose, buckets):
                    if row.closed and not row.rows:
                        continue
                    # The directory has only estimates for an open bucket.
                    ends = (row.t_min, row.t_max) if row.closed else self._open_ends(table, row)
                    if ends is not None and ends[0] <= high and ends[1] >= low:
                        extents.append(Extent(table.name, row.writer, *ends))
            return extents

        return followed(self._tables(topic), read_extents)

    def _open_ends(self, table: TopicTable, row: BucketRow) -> tuple[int, int] | None:
        """Return a time range with all of a node's messages in an open bucket; None = it has none.

        This is the time range of the bucket itself, unless the bucket is long.
        """
        length = table.metadata.bucket_ns
        time_range = TimeRange(row.bucket * length, (row.bucket + 1) * length - 1)
        if length <= _LONG_NS:
            return time_range.low, time_range.high
        times = []
        for reverse in (False, True):
            read = Read(
                time_range,
                Whose((row.node,)),
                reverse=reverse,
                columns=lambda table: (),
                wanted=1,
            )
            times += [first.t for first in islice(self._keyspace.rows.read([table], read), 1)]
        return (min(times), max(times)) if times else None

    def run_nodes(self, writers: frozenset[int]) -> frozenset[str] | None:
        """Return the nodeIDs of the runs of some writers; None if a writer has no run."""
        return self._keyspace.runs.nodes(writers)

    def run_text(self, writer: int) -> str:
        """Return the text of RUN for the messages of a writer."""
        return self._keyspace.runs.text(writer)

    def _tables(self, topic: ArraySource) -> list[TopicTable]:
        return self._keyspace.tables.of_topic(topic.name)
