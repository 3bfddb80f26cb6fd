# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which messages a file is made of: topics, a window of time, robots, runs and conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.read import Nodes, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.key_selection import range_between
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.choice import END, NODES, RUNS, START, TOPICS, whose_chosen
from cassandra_ros.viewing.route import Parameter

_WHERE = Parameter(
    "where",
    "lines",
    "'TOPIC: CONDITION': of this topic only messages that satisfy a condition as in CQL; the other "
    "topics stay whole.",
)
SELECTION = (TOPICS, START, END, NODES, RUNS, _WHERE)
"""The parameters that selected reads."""


@dataclass(frozen=True)
class Selected:
    """Messages that are asked for."""

    topics: tuple[str, ...] | None
    """Names as they are stored, sorted; None = all."""
    start: Stamp | None
    end: Stamp | None
    """Ends, by the time of reception, included; None = open."""
    whose: Whose
    where: Mapping[str, Where]
    """Topic -> condition, which also says of which robots where there are several: see node."""

    @property
    def node(self) -> str | None:
        """The one robot that is asked for; None: all, or several, which ``where`` tells."""
        nodes = self.whose.nodes
        return nodes[0] if nodes is not None and len(nodes) == 1 else None

    @property
    def time_range(self) -> TimeRange:
        """Both ends, ns."""
        return range_between(self.start, self.end)


def selected(call: Call) -> Selected:
    """Read the parameters SELECTION of a call.

    Raises:
        TopicNotFound, RunNotFound: A topic or run is not stored.
        InvalidOption: The start lies behind the end, or a condition has no topic, or two.
    """
    start, end = (_stamp(call.time_ns(name)) for name in ("start", "end"))
    if start is not None and end is not None and start > end:
        raise InvalidOption(f"start {start} lies behind end {end}")
    catalog, names, whose = call.catalog, call.texts("topics"), whose_chosen(call)
    topics = tuple(sorted({catalog.get(name).name for name in names})) if names else None
    where = _of_nodes(catalog, topics, _conditions(catalog, call.lines("where")), whose.nodes)
    return Selected(topics, start, end, whose, where)


def _stamp(ns: int | None) -> Stamp | None:
    # Not an integer: a small one would be taken for seconds that were meant.
    return None if ns is None else Stamp.from_ns(ns)


def _conditions(catalog: Catalog, lines: tuple[str, ...]) -> dict[str, Where]:
    found: dict[str, Where] = {}
    for line in lines:
        topic, _, condition = (part.strip() for part in line.partition(":"))
        if not (topic and condition):
            raise InvalidOption(f"where {line[:200]!r} is not of the form 'TOPIC: CONDITION'")
        name = catalog.get(topic).name
        if name in found:
            raise InvalidOption(f"where has two conditions for {name}; join them with AND or OR")
        found[name] = condition
    return found


def _of_nodes(
    catalog: Catalog,
    topics: tuple[str, ...] | None,
    where: dict[str, Where],
    nodes: Nodes,
) -> dict[str, Where]:
    """Add to the conditions that messages are of one of several robots: reads take one, or all."""
    if nodes is None or len(nodes) == 1:
        return where
    names = [topic.name for topic in catalog.all(None)] if topics is None else topics
    of_them = f"NODE IN ({', '.join('?' * len(nodes))})"
    found: dict[str, Where] = dict(where)
    for name in names:
        own = where.get(name)
        found[name] = (of_them if own is None else f"({own}) AND {of_them}", nodes)
    return found
