# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What places/ needs of a keyspace: its topics, and when which run has messages of one."""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Sequence

from cassandra_ros.places.sources import ArraySource
from cassandra_ros.places.stored import Extent
from cassandra_ros.topics.following import followed
from cassandra_ros.topics.selection import Whose
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.totals import buckets_of

if TYPE_CHECKING:
    from cassandra_ros.topics.cassandra_topic import CassandraTopic
    from cassandra_ros.topics.catalog import Catalog


class StoredPlaces:
    """The topics of a keyspace, for those who ask where its robots were."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog

    def find(self, name: str) -> CassandraTopic:
        """Return a topic by its name; raises TopicNotFound."""
        return self._catalog.get(name)

    def topics(self) -> Sequence[CassandraTopic]:
        """List all topics, sorted by name."""
        return self._catalog.all(None)

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """List the nodeIDs that have messages of a topic, sorted."""
        return self._catalog.keyspace.nodes(self._tables(topic))

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """List when runs of a node have messages of a topic, as far as that touches [low, high]."""
        directory, whose = self._catalog.keyspace.directory, Whose([node])

        def extents(tables: Sequence[TopicTable]) -> List[Extent]:
            found = []
            for table in tables:
                if table.named:
                    continue
                length = table.metadata.bucket_ns
                ends = (table.bucket_of(max(0, low)), table.bucket_of(high))
                for row in buckets_of(directory, table, whose, ends):
                    if row.closed and not row.rows:
                        continue
                    # What is said of an open bucket is an estimate.
                    inside = (row.t_min, row.t_max) if row.closed else _ends(row.bucket, length)
                    if inside[0] <= high and inside[1] >= low:
                        found.append(Extent(table.name, row.writer, *inside))
            return found

        return followed(self._tables(topic), extents)

    def run_text(self, writer: int) -> str:
        """Return what RUN says of the messages of a writer."""
        return self._catalog.keyspace.runs.text(writer)

    def _tables(self, topic: ArraySource) -> List[TopicTable]:
        return self._catalog.keyspace.tables.of_topic(topic.name)


def _ends(bucket: int, length: int) -> tuple[int, int]:
    return bucket * length, (bucket + 1) * length - 1
