# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The selection of the messages of a file: topics, time range, robots, runs and conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.read import Nodes, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.row_finder import Where, range_between
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.route import Parameter
from cassandra_ros.viewing.selection_parameters import END, NODES, RUNS, START, TOPICS, whose_of

_WHERE = Parameter(
    "where",
    "lines",
    "'TOPIC: CONDITION': only messages of the topic that satisfy the condition, written as in CQL; "
    "other topics are complete.",
)
SELECTION = (TOPICS, START, END, NODES, RUNS, _WHERE)
"""Parameters that ``read_selection`` reads."""


@dataclass(frozen=True)
class MessageSelection:
    """A selection of messages."""

    topics: tuple[str, ...] | None
    """Stored names of the topics, sorted; None = all."""
    start: Stamp | None
    """First time of reception, included; None = not limited."""
    end: Stamp | None
    """Last time of reception, included; None = not limited."""
    whose: Whose
    where: Mapping[str, Where]
    """Condition by topic. If several robots are selected, it restricts the messages to them."""

    @property
    def node(self) -> str | None:
        """NodeID of the selected robot; None = all, or several, which ``where`` selects."""
        nodes = self.whose.nodes
        return nodes[0] if nodes is not None and len(nodes) == 1 else None

    @property
    def time_range(self) -> TimeRange:
        """Selected time range, ns."""
        return range_between(self.start, self.end)


def read_selection(call: ApiCall) -> MessageSelection:
    """Read the parameters SELECTION of a call.

    Raises:
        TopicNotFound, RunNotFound: A topic or run is not stored.
        InvalidOption: The start lies after the end, a condition has no topic, or a topic has two
            conditions.
    """
    start, end = (_stamp(call.time_ns(name)) for name in ("start", "end"))
    if start is not None and end is not None and start > end:
        raise InvalidOption(f"start {start} lies after end {end}")
    catalog, names, whose = call.catalog, call.texts("topics"), whose_of(call)
    topics = tuple(sorted({catalog.get(name).name for name in names})) if names else None
    where = _of_nodes(catalog, topics, _conditions(catalog, call.lines("where")), whose.nodes)
    return MessageSelection(topics, start, end, whose, where)


def _stamp(ns: int | None) -> Stamp | None:
    # A stamp instead of an integer, which would mean seconds if it is small.
    return None if ns is None else Stamp.from_ns(ns)


def _conditions(catalog: Catalog, lines: tuple[str, ...]) -> dict[str, Where]:
    conditions: dict[str, Where] = {}
    for line in lines:
        topic, _, condition = (text.strip() for text in line.partition(":"))
        if not (topic and condition):
            raise InvalidOption(f"where {line[:200]!r} is not of the form 'TOPIC: CONDITION'")
        name = catalog.get(topic).name
        if name in conditions:
            raise InvalidOption(f"where has two conditions for {name}; join them with AND or OR")
        conditions[name] = condition
    return conditions


def _of_nodes(
    catalog: Catalog, topics: tuple[str, ...] | None, where: dict[str, Where], nodes: Nodes
) -> dict[str, Where]:
    """Add the selected robots to the conditions if there are several: reads take one, or all."""
    if nodes is None or len(nodes) == 1:
        return where
    names = [topic.name for topic in catalog.all(None)] if topics is None else topics
    of_them = f"NODE IN ({', '.join('?' * len(nodes))})"
    conditions: dict[str, Where] = dict(where)
    for name in names:
        own = where.get(name)
        conditions[name] = (of_them if own is None else f"({own}) AND {of_them}", nodes)
    return conditions
