# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of several topics of a keyspace, in the order of time."""

from __future__ import annotations

import heapq
from operator import attrgetter
from typing import Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import InvalidOption
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.finding import Filter, Where
from cassandra_ros.topics.reading import RowReader
from cassandra_ros.topics.selection import LAST_NS, Stretch
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

Conditions = Optional[Mapping[str, Where]]
"""Topic -> condition."""
Pair = Tuple[StoredRow, Optional[StoredRow]]


class AcrossTopics:
    """Reads several topics at once; see RosCassandra.readMessages and nearestMessages."""

    def __init__(self, rows: RowReader, catalog: Catalog) -> None:
        self._rows = rows
        self._topics = catalog

    def read(
        self,
        topics: Optional[Sequence[str]],
        stretch: Stretch,
        node: Optional[str],
        received: bool,
        where: Conditions,
    ) -> Iterator[StoredRow]:
        """Walk lazily through the rows of some topics, None = of all, merged by time."""
        filters = self._filters(where, topics, node)
        return self._merged(self.tables(topics), filters, stretch, node, received)

    def nearest(
        self,
        topic_a: str,
        topic_b: str,
        reach_ns: int,
        stretch: Stretch,
        node: Optional[str],
        where: Conditions,
        unpaired: bool,
    ) -> Iterator[Pair]:
        """Pair each row of one topic with the nearest of another, at most ``reach_ns`` away."""
        first, second = self._topics.get(topic_a), self._topics.get(topic_b)
        filters = self._filters(where, (topic_a, topic_b), node)
        rows = self._merged(first.tables, filters, stretch, node)
        low, high = max(0, stretch.low - reach_ns), min(LAST_NS, stretch.high + reach_ns)
        partners = self._merged(second.tables, filters, Stretch(low, high), node)
        return nearest_pairs(rows, partners, reach_ns, unpaired)

    def tables(self, topics: Optional[Iterable[str]]) -> List[TopicTable]:
        """List the tables of some topics, None = of all topics that can be read."""
        if topics is None:
            return self._topics.readable_tables()
        # A topic may be named twice: with and without its leading slash.
        named = {topic.name: topic for topic in map(self._topics.get, topics)}
        return [table for topic in named.values() for table in topic.tables]

    def _filters(
        self, where: Conditions, topics: Optional[Iterable[str]], node: Optional[str]
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
            found[topic.name] = Filter(topic, condition, node)
        return found

    def _merged(
        self,
        tables: Sequence[TopicTable],
        filters: Mapping[str, Filter],
        stretch: Stretch,
        node: Optional[str],
        received: bool = False,
    ) -> Iterator[StoredRow]:
        nodes = check_nodes(node)
        read = self._rows.received if received else self._rows.read
        by_topic: Dict[str, List[TopicTable]] = {name: [] for name in filters}
        free: List[TopicTable] = []
        for table in tables:
            by_topic.get(table.metadata.topic, free).append(table)
        if not any(by_topic.values()):
            return read(free, stretch, nodes=nodes)
        streams = [read(free, stretch, nodes=nodes)] if free else []
        for name, own in by_topic.items():
            if received and any(t.metadata.own_time and not t.named for t in own):
                # Read by a time that its key is not: the store cannot look for both.
                streams.append(filter(filters[name].test, read(own, stretch, nodes=nodes)))
            elif own:
                streams.append(filters[name].rows(stretch))
        return heapq.merge(*streams, key=attrgetter("arrival" if received else "position"))


def nearest_pairs(
    first: Iterator[StoredRow],
    second: Iterator[StoredRow],
    tolerance_ns: int,
    unpaired: bool = False,
) -> Iterator[Pair]:
    """Pair each row of one stream with the nearest one of another; two of that are held.

    Of two rows that are equally near the earlier one is taken, of equal times the first.

    Args:
        first, second: In the order of time.
        tolerance_ns: The largest distance of a partner, ns.
        unpaired: Give rows of the first that have no partner with None, else leave them out.
    """
    before: Optional[StoredRow] = None
    ahead = next(second, None)
    for row in first:
        while ahead is not None and ahead.t <= row.t:
            if before is None or before.t < ahead.t:
                before = ahead
            ahead = next(second, None)
        partner = _nearer(row.t, before, ahead)
        if partner is not None and abs(partner.t - row.t) <= tolerance_ns:
            yield row, partner
        elif unpaired:
            yield row, None
        elif ahead is None:
            return  # the rows that follow are further away still


def _nearer(t: int, before: Optional[StoredRow], ahead: Optional[StoredRow]) -> Optional[StoredRow]:
    if before is None or ahead is None:
        return before or ahead
    return before if t - before.t <= ahead.t - t else ahead
