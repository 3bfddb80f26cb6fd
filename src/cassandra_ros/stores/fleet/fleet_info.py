# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the stores of a fleet have of a topic, each message counted once."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import Iterator

from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.printable import shown
from cassandra_ros.read import ALWAYS, Read, TimeRange, Whose
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic
from cassandra_ros.topics.stored_totals import TopicInfo, describe


@dataclass(repr=False)
class FleetTopicInfo:
    """Numbers of one topic with one message type by one robot, in all stores together."""

    topic: str
    type: str
    md5sum: str
    node: str
    key: str
    """Key of a message: 'time', 'hash', 'manual', or the name of the key field."""
    count: int = 0
    """Number of messages, each counted once."""
    bytes: int = 0
    """Number of their serialised bytes."""
    first_ns: int | None = None
    last_ns: int | None = None
    """First and last key time, ns; None = no message has one."""
    formats: list[str] = field(default_factory=list)
    """Formats of the tables, each once."""
    stores: dict[str, int] = field(default_factory=dict)
    """Number of messages in each store that has some."""

    def __repr__(self) -> str:
        node = f" of {shown(self.node)}" if self.node else ""
        text = f"{self.type}, messages: {self.count}, bytes: {self.bytes}"
        if self.first_ns is not None and self.last_ns is not None:
            text += f", from {iso_time(self.first_ns)} to {iso_time(self.last_ns)}"
        stores = ", ".join(f"{name} {count}" for name, count in self.stores.items())
        return f"<FleetTopicInfo {shown(self.topic)}{node}: {text}; {stores}>"

    def extend(self, first_ns: int | None, last_ns: int | None, count: int, nbytes: int) -> None:
        """Add messages of a time range; None = they have no times."""
        self.count += count
        self.bytes += nbytes
        if first_ns is not None and last_ns is not None:
            self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
            self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)


def describe_topic(
    answer: FleetAnswer, topic: FleetTopic, whose: Whose
) -> Iterator[FleetTopicInfo]:
    """Yield the numbers of a topic, by type and robot.

    What one store has alone is counted by its directory. If several stores have messages of a
    robot, the keys of these are read, except where only the first store needs to be asked.
    """

    def ask(whose: Whose, store: str, time_range: TimeRange = ALWAYS) -> list[TopicInfo]:
        """Return what the directory of a store tells."""
        catalog = answer.catalogs[store]
        tables = catalog.tables([topic.names[store]])
        return describe(catalog.keyspace.directory, tables, whose, (), time_range)

    by_store = answer.each({store: store for store in topic.names}, partial(ask, whose))
    by_node: dict[str, dict[str, list[TopicInfo]]] = defaultdict(dict)
    for store, infos in by_store.items():
        for info in infos:
            by_node[info.node].setdefault(store, []).append(info)
    for node, infos_by_store in sorted(by_node.items()):
        totals: dict[str, FleetTopicInfo] = {}
        filled = [store for store, infos in infos_by_store.items() if any(i.count for i in infos)]
        for store, infos in infos_by_store.items():
            for info in infos:
                total = totals.setdefault(info.md5sum, _blank(topic.name, info))
                _note(total, store, info)
                if len(filled) < 2:
                    total.extend(info.first_ns, info.last_ns, info.count, info.bytes)
        if len(filled) > 1:
            read = Read(whose=Whose.of(node).both(whose), columns=lambda table: ())
            alone, shared = topic.divided(read, partial(ask, read.whose))
            for info in chain.from_iterable(alone):
                if info.md5sum in totals:  # a type may have been stored meanwhile: it is left out
                    totals[info.md5sum].extend(info.first_ns, info.last_ns, info.count, info.bytes)
            for shared_range in shared:
                for row in topic.read(replace(read, time_range=shared_range)):
                    if row.md5sum in totals:
                        totals[row.md5sum].extend(row.t, row.t, 1, row.size)
        yield from totals.values()


def _blank(topic: str, info: TopicInfo) -> FleetTopicInfo:
    """Return an object without messages, for those that ``info`` describes."""
    return FleetTopicInfo(topic, info.type, info.md5sum, info.node, info.key)


def _note(total: FleetTopicInfo, store: str, info: TopicInfo) -> None:
    """Add what one store has, but not to the numbers of all stores together."""
    if info.count:
        total.stores[store] = total.stores.get(store, 0) + info.count
    if info.format not in total.formats:
        total.formats.append(info.format)
