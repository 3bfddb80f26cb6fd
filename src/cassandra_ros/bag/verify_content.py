# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare only what was said: for a live recording of a bag that was played."""

from __future__ import annotations

from typing import Any, Dict, Iterable, Iterator, Mapping

from cassandra_ros.bag.alignment import Alignment, Content
from cassandra_ros.bag.differences import (
    Progress,
    VerifyReport,
    describePlace,
    fingerprint,
    rowFingerprint,
)
from cassandra_ros.bag.order import Ordered, readInOrder
from cassandra_ros.bag.reader import BagReader
from cassandra_ros.bag.topics import chosenConnections
from cassandra_ros.messages.connection import Connection
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.topics.stored_row import StoredRow


def verifyContent(
    rosCas: RosCassandra,
    path: Any,
    topics: Iterable[str] | None = None,
    nodeID: str | None = None,
    mapping: Mapping[str, str] | None = None,
    start: Any = None,
    end: Any = None,
    progress: Progress | None = None,
) -> VerifyReport:
    """Compare each topic's messages in their order by type, md5sum and bytes alone.

    Times and connections are not compared: they differ when a bag was played and recorded live.
    Memory: two pages of rows for each topic, and what readInOrder needs; of a topic whose key is a
    time in the message, all keys.

    Args:
        rosCas: Connected to a keyspace.
        path: The bag.
        topics: Only these topics of the bag; None = all.
        nodeID: Only what this node recorded; None = all nodes.
        mapping: Topic of the bag -> topic under which it was recorded.
        start: First time of reception (genpy.Time, int ns, float s, text); None = open.
        end: Last time, included; None = open.
        progress: Told how far it is.

    Raises:
        BagError: The bag cannot be read to its end.
        TopicNotFound: The bag has no such topic.
    """
    renamed = dict(mapping or {})
    with BagReader(path) as reader:
        numbers = chosenConnections(reader, topics)
        report = VerifyReport(reader.path, "all stored messages on its topics, by content")
        present = {topic.name for topic in rosCas.getAllTopics()}
        alignments: Dict[str, Alignment] = {}
        for topic in sorted({reader.connections[n].topic for n in numbers}):
            name = renamed.get(topic, topic)
            rows: Iterator[StoredRow] = iter(())
            if name in present:
                # In the order of the bag, whatever the topic's key is.
                rows = rosCas.readMessages([name], start, end, nodeID=nodeID, received=True)
            alignments[topic] = Alignment(map(_stored, rows), report)
        connections = list(reader.connections.values())
        for wanted in readInOrder(reader, lambda message: fingerprint(message.data), numbers):
            connection = connections[wanted.rank]
            alignments[connection.topic].add(_ofBag(wanted, connection))
            if progress is not None:
                progress(1)
        for alignment in alignments.values():
            alignment.finish()
    return report


def _ofBag(wanted: Ordered, connection: Connection) -> Content:
    place = f"{describePlace(connection.topic, wanted.t_ns)}: message {wanted.position} of the bag"
    return Content(connection.type, connection.md5sum, wanted.value, place)


def _stored(row: StoredRow) -> Content:
    return Content(
        row.type, row.md5sum, rowFingerprint(row), describePlace(row.topic, row.received)
    )
