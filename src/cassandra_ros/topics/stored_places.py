# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What places/ needs of a keyspace: its topics, and when which run has messages of one."""

from __future__ import annotations

from itertools import islice
from typing import Callable, FrozenSet, List, Optional, Sequence, Tuple

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.sources import ArraySource
from cassandra_ros.places.stored import Extent
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.tables.directory import BucketRow
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.replaced_tables import followed
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable

_LONG_NS = 600 * SECOND_NS
"""In longer buckets, as imports have, it is looked where the messages of an open one lie."""


class StoredPlaces:
    """The topics of a keyspace, for those who ask where its robots were."""

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
        """List all topics, sorted by name."""
        return self._topics()

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """List the nodeIDs that have messages of a topic, sorted."""
        return self._keyspace.nodes(self._tables(topic))

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """List when runs of a node have messages of a topic, as far as that touches [low, high]."""
        directory, whose = self._keyspace.directory, Whose([node])

        def extents(tables: Sequence[TopicTable]) -> List[Extent]:
            found = []
            for table in tables:
                if table.named:
                    continue
                ends = (table.bucket_of(max(0, low)), table.bucket_of(high))
                for row in buckets_of(directory, table, whose, ends):
                    if row.closed and not row.rows:
                        continue
                    # What is said of an open bucket is an estimate.
                    inside = (row.t_min, row.t_max) if row.closed else self._ends(table, row)
                    if inside is not None and inside[0] <= high and inside[1] >= low:
                        found.append(Extent(table.name, row.writer, *inside))
            return found

        return followed(self._tables(topic), extents)

    def _ends(self, table: TopicTable, row: BucketRow) -> Optional[Tuple[int, int]]:
        """Return between which times a node may have messages in a bucket; None = it has none."""
        length = table.metadata.bucket_ns
        time_range = TimeRange(row.bucket * length, (row.bucket + 1) * length - 1)
        if length <= _LONG_NS:
            return time_range.low, time_range.high
        found = []
        for reverse in (False, True):
            read = Read(
                time_range,
                Whose((row.node,)),
                reverse=reverse,
                columns=lambda table: (),
                wanted=1,
            )
            found += [each.t for each in islice(self._keyspace.rows.read([table], read), 1)]
        return (min(found), max(found)) if found else None

    def run_nodes(self, writers: FrozenSet[int]) -> Optional[FrozenSet[str]]:
        """Return the nodeIDs of the runs of some writers; None where a writer has no run."""
        return self._keyspace.runs.nodes(writers)

    def run_text(self, writer: int) -> str:
        """Return what RUN says of the messages of a writer."""
        return self._keyspace.runs.text(writer)

    def _tables(self, topic: ArraySource) -> List[TopicTable]:
        return self._keyspace.tables.of_topic(topic.name)
