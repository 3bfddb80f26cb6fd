# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What poses are read from: topics whose fields come as arrays."""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional, Protocol, Sequence

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Row
from cassandra_ros.query.source import Source, Writers


class ArraySource(Source[Row], Protocol):
    """The stored messages of one topic, and their fields as arrays, as CassandraTopic has them."""

    def getArrays(
        self,
        fields: Sequence[str],
        key: Optional[Stamp] = None,
        to_key: Optional[Stamp] = None,
        *,
        nodeID: Optional[str] = None,
        run: Writers = None,
    ) -> Dict[str, Any]:
        """Return fields of the messages in [key, to_key] as numpy arrays."""


Find = Callable[[str], ArraySource]
"""Returns a topic by its name, as RosCassandra.getTopic does; raises TopicNotFound."""


def find_stored(find: Find, name: str) -> Optional[ArraySource]:
    """Return a topic by its name; None where it is not stored, as one of tf's two may be."""
    try:
        return find(name)
    except TopicNotFound:
        return None


def arrays_between(
    topic: ArraySource,
    fields: Sequence[str],
    low: int,
    high: int,
    node: Optional[str],
    writers: Writers,
) -> Dict[str, Any]:
    """Return fields of the messages with a row key in [low, high], ns."""
    # As stamps they are times for certain: a small int might be refused as seconds.
    ends = (Stamp.from_ns(max(0, low)), Stamp.from_ns(min(high, MAX_NS)))
    return topic.getArrays(fields, *ends, nodeID=node, run=writers)


def key_behind(
    topic: ArraySource, time: int, node: Optional[str], writers: Writers
) -> Optional[int]:
    """Return the first row key of a topic behind a time, ns; None where there is none."""
    if time >= MAX_NS:
        return None
    rows = topic.rows(max(0, time + 1), nodeID=node, limit=1, run=writers)
    return next((row.t for row in rows), None)


def last_key(topic: ArraySource, node: Optional[str], writers: Writers) -> Optional[int]:
    """Return the last row key of a topic; None where it has no message."""
    return next(
        (row.t for row in topic.rows(nodeID=node, limit=1, reverse=True, run=writers)), None
    )
