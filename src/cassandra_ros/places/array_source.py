# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interface to the topics that poses are read from: their fields as arrays."""

from __future__ import annotations

from typing import Any, Callable, NamedTuple, Protocol, Sequence

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Row, Source
from cassandra_ros.read import Read, TimeRange, Whose, Writers


class ArraySource(Source[Row], Protocol):
    """Stored messages of one topic, with the method of CassandraTopic that returns arrays."""

    def getArrays(
        self,
        fields: Sequence[str],
        key: Stamp | None = None,
        to_key: Stamp | None = None,
        *,
        nodeID: str | None = None,
        run: Writers = None,
    ) -> dict[str, Any]:
        """Return fields of the messages in [key, to_key] as numpy arrays."""


TopicFinder = Callable[[str], ArraySource]
"""Function that returns a topic by its name, like RosCassandra.getTopic; raises TopicNotFound."""


def find_stored(find: TopicFinder, name: str) -> ArraySource | None:
    """Return a topic by its name, or None if it is not stored."""
    try:
        return find(name)
    except TopicNotFound:
        return None


def arrays_between(
    topic: ArraySource,
    fields: Sequence[str],
    low: int,
    high: int,
    node: str | None,
    writers: Writers,
) -> dict[str, Any]:
    """Return fields of the messages with a row key in [low, high], ns."""
    # Stamps, because a small int could be refused as a mistaken number of seconds.
    ends = (Stamp.from_ns(max(0, low)), Stamp.from_ns(min(high, MAX_NS)))
    return topic.getArrays(fields, *ends, nodeID=node, run=writers)


def key_after(topic: ArraySource, time: int, node: str | None, writers: Writers) -> int | None:
    """Return the first row key of a topic after a time, ns; None if there are no later rows."""
    if time >= MAX_NS:
        return None
    later = TimeRange(max(0, time + 1), MAX_NS)
    rows = topic.read(Read(later, Whose.of(node, writers), wanted=1))
    return next((row.t for row in rows), None)


def last_key(topic: ArraySource, node: str | None, writers: Writers) -> int | None:
    """Return the last row key of a topic, ns; None if it has no messages."""
    rows = topic.read(Read(whose=Whose.of(node, writers), reverse=True, wanted=1))
    return next((row.t for row in rows), None)


class Extent(NamedTuple):
    """A time range in which a run has, or may have, messages in a table."""

    table: str
    writer: int
    """Writer id of the run."""
    low: int
    high: int
    """First and last row key, ns, both included."""


class StoredTopics(Protocol):
    """The topics of a keyspace."""

    def find(self, name: str) -> ArraySource:
        """Return a topic by its name; raises TopicNotFound."""

    def topics(self) -> Sequence[ArraySource]:
        """Return all topics, sorted by name."""

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """Return the nodeIDs that have messages of a topic, sorted."""

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """Return the time ranges of a node's messages of a topic, by run, touching [low, high]."""

    def run_nodes(self, writers: frozenset[int]) -> frozenset[str] | None:
        """Return the nodeIDs of the runs of some writers; None if a writer has no run."""

    def run_text(self, writer: int) -> str:
        """Return the value of RUN for the messages of a writer."""
