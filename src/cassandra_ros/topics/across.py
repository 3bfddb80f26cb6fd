# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of several topics of a RosCassandra, in the order of time."""

from __future__ import annotations

import heapq
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence

from cassandra_ros.arguments import check_nodes, check_topics
from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import durationNs, toNs
from cassandra_ros.topics.asking import Asking
from cassandra_ros.topics.filtering import Filter, Where
from cassandra_ros.topics.nearest import Pair, nearestPairs
from cassandra_ros.topics.selection import LAST_NS
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_rows import Time
from cassandra_ros.topics.topic_table import TopicTable

Conditions = Optional[Mapping[str, Where]]


class AcrossTopics(Asking):
    """Reads several topics at once; see RosCassandra."""

    def readMessages(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        received: bool = False,
        where: Conditions = None,
    ) -> Iterator[StoredRow]:
        """Walk lazily through the rows of several topics, merged by time.

        Memory: some pages of rows for all topics together, and for each that has a condition.

        Args:
            topics: Their names, or one; None = all.
            key, to_key: Ends, both included; None = open.
            nodeID: Only messages of this node; None = of all.
            received: By the time of reception, as a bag has them, also where a topic's key is
                another time.
            where: Topic -> condition, a text or (text, parameters): of these topics only the
                messages that satisfy it.

        Raises:
            TopicNotFound: One of the topics is not stored.
            InvalidName: topics or nodeID are no names.
            InvalidOption: A condition is for a topic that is not read.
            InvalidQuery: A condition is none; shows it with a caret under the spot.
        """
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        names = check_topics(topics)
        filters = self._filters(where, names, nodeID)
        return self._merged(self._tables(names), filters, low, high, nodeID, received)

    def nearestMessages(
        self,
        topic_a: str,
        topic_b: str,
        tolerance: Any,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        where: Conditions = None,
        unpaired: bool = False,
    ) -> Iterator[Pair]:
        """Pair each message of one topic with the message of another that is nearest in time.

        Pairs are (row, row), lazily in the order of the first topic's key times. A message of the
        second may be the partner of several. Of two that are equally near the earlier one is
        taken, of equal times the first. One without a partner is left out, as by ROS's
        ApproximateTime; with ``unpaired`` it comes with None, as by pandas' merge_asof.

        Args:
            topic_a: Each of its messages looks for a partner.
            topic_b: Where the partners are.
            tolerance: How far a partner may be, before or behind: seconds or a Duration.
            key, to_key: Ends for the first topic, both included; None = open. Partners may lie
                outside of them.
            nodeID: Only messages of this node; None = of all: partners may be of two nodes.
            where: Topic -> condition, as readMessages takes it: what does not satisfy it is
                nobody's partner.
            unpaired: Give (row, None) for messages that have no partner.

        Raises:
            TopicNotFound: One of the topics is not stored.
            InvalidOption: A condition is for another topic.
            InvalidKey: tolerance is no length of time, or negative.
            InvalidQuery: A condition is none.
        """
        reach = durationNs(tolerance)
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        first, second = self._topics.get(topic_a), self._topics.get(topic_b)
        filters = self._filters(where, (topic_a, topic_b), nodeID)
        rows = self._merged(first.tables, filters, low, high, nodeID)
        ends = max(0, low - reach), min(LAST_NS, high + reach)
        partners = self._merged(second.tables, filters, *ends, nodeID)
        return nearestPairs(rows, partners, reach, unpaired)

    def _tables(self, topics: Optional[Iterable[str]]) -> List[TopicTable]:
        if topics is None:
            return self._topics.readableTables()
        # A topic may be named twice: with and without its leading slash.
        named = {topic.name: topic for topic in map(self._topics.get, topics)}
        return [table for topic in named.values() for table in topic.tables]

    def _filters(
        self, where: Conditions, topics: Optional[Iterable[str]], nodeID: Optional[str]
    ) -> Dict[str, Filter]:
        if where is None:
            return {}
        if not isinstance(where, Mapping):
            raise InvalidOption(f"where= is a mapping of topics to conditions, not {where!r:.80}")
        read = None if topics is None else {self._topics.get(name).name for name in topics}
        found: Dict[str, Filter] = {}
        for name, condition in where.items():
            topic = self._topics.get(name)
            if read is not None and topic.name not in read:
                listing = ", ".join(sorted(read)) or "none"
                raise InvalidOption(
                    f"there is a condition for topic {topic.name}, which is not among those that "
                    f"are read: {listing}"
                )
            if topic.name in found:
                raise InvalidOption(f"there are two conditions for topic {topic.name}; join them")
            found[topic.name] = Filter(topic, condition, nodeID)
        return found

    def _merged(
        self,
        tables: Sequence[TopicTable],
        filters: Mapping[str, Filter],
        low: int,
        high: int,
        nodeID: Optional[str],
        received: bool = False,
    ) -> Iterator[StoredRow]:
        rows, nodes = self.parts.rows, check_nodes(nodeID)
        read = rows.received if received else rows.read
        by_topic: Dict[str, List[TopicTable]] = {name: [] for name in filters}
        free: List[TopicTable] = []
        for table in tables:
            by_topic.get(table.metadata.topic, free).append(table)
        if not any(by_topic.values()):
            return read(free, low, high, nodes=nodes)
        streams = [read(free, low, high, nodes=nodes)] if free else []
        for name, own in by_topic.items():
            if received and any(t.metadata.own_time and not t.named for t in own):
                # Read by a time that its key is not: the store cannot look for both.
                every = rows.received(own, low, high, nodes=nodes)
                streams.append(filter(filters[name].test, every))
            elif own:
                streams.append(filters[name].rows(low, high))
        return heapq.merge(*streams, key=_arrival if received else _position)


def _position(row: StoredRow) -> Any:
    return row.position


def _arrival(row: StoredRow) -> Any:
    return row.arrival
