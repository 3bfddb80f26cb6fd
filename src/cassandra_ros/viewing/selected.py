# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which messages a question is about: topics, a window of time, robots, runs and conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.topics.finding import Where
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.topics.runs import Writers
from cassandra_ros.topics.selection import Stretch, Whose
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.route import Parameter

SELECTION = (
    Parameter("topics", "texts", "Only these topics (default: all)."),
    Parameter("start", "time", "First time of reception (default: that of all)."),
    Parameter("end", "time", "Last time, included (default: that of all)."),
    Parameter("nodes", "texts", "Only messages of these robots, by nodeID (default: of all)."),
    Parameter(
        "runs", "texts", "Only messages of these runs, by name or writer id (default: of all)."
    ),
    Parameter(
        "where",
        "lines",
        "'TOPIC: CONDITION': of this topic only messages that satisfy a condition as in CQL; the "
        "other topics stay whole.",
    ),
)
"""The parameters that selected reads."""


@dataclass(frozen=True)
class Selected:
    """Messages that are asked for."""

    topics: tuple[str, ...] | None
    """Names as they are stored, sorted; None = all."""
    start: Stamp | None
    end: Stamp | None
    """Ends, included; None = open."""
    nodes: tuple[str, ...] | None
    """nodeIDs; None = all."""
    runs: tuple[str, ...] | None
    """As they were given; None = all."""
    writers: Writers
    """The writer ids of these."""
    where: Mapping[str, Where]
    """Topic -> condition; of several robots as readMessages takes them, see node."""

    @property
    def node(self) -> str | None:
        """The one robot that is asked for; None: all, or several, which ``where`` tells."""
        return self.nodes[0] if self.nodes is not None and len(self.nodes) == 1 else None

    @property
    def stretch(self) -> Stretch:
        """Both ends, ns."""
        return Stretch.between(self.start, self.end)

    @property
    def whose(self) -> Whose:
        """Whose messages are asked for."""
        return Whose(self.nodes, self.writers)


def selected(call: Call) -> Selected:
    """Read the parameters SELECTION of a call.

    Raises:
        TopicNotFound, RunNotFound: A topic or run is not stored.
        InvalidOption: The start lies behind the end, or a condition has no topic, or two.
    """
    start, end = (_stamp(call.time_ns(name)) for name in ("start", "end"))
    if start is not None and end is not None and start > end:
        raise InvalidOption(f"start {start} lies behind end {end}")
    store, runs = call.store, call.texts("runs") or None
    topics = _stored_names(store, call.texts("topics"))
    nodes = call.texts("nodes") or None
    nodes = None if nodes is None else tuple(sorted(set(nodes)))
    where = _of_nodes(store, topics, _conditions(store, call.lines("where")), nodes)
    return Selected(topics, start, end, nodes, runs, _writers(store, runs), where)


def _stamp(ns: int | None) -> Stamp | None:
    # Not an integer: a small one would be taken for seconds that were meant.
    return None if ns is None else Stamp.from_ns(ns)


def _stored_names(store: RosCassandra, topics: tuple[str, ...] | None) -> tuple[str, ...] | None:
    return None if not topics else tuple(sorted({store.getTopic(name).name for name in topics}))


def _writers(store: RosCassandra, runs: tuple[str, ...] | None) -> Writers:
    if runs is None:
        return None
    found = (store.parts.runs.writers(run) or frozenset() for run in runs)
    return frozenset(writer for each in found for writer in each)


def _conditions(store: RosCassandra, lines: tuple[str, ...]) -> dict[str, Where]:
    found: dict[str, Where] = {}
    for line in lines:
        topic, _, condition = (part.strip() for part in line.partition(":"))
        if not (topic and condition):
            raise InvalidOption(f"where {line[:200]!r} is not of the form 'TOPIC: CONDITION'")
        name = store.getTopic(topic).name
        if name in found:
            raise InvalidOption(f"where has two conditions for {name}; join them with AND or OR")
        found[name] = condition
    return found


def _of_nodes(
    store: RosCassandra,
    topics: tuple[str, ...] | None,
    where: dict[str, Where],
    nodes: tuple[str, ...] | None,
) -> dict[str, Where]:
    """Add to the conditions that messages are of one of several robots: reads take one, or all."""
    if nodes is None or len(nodes) == 1:
        return where
    names = topics if topics is not None else [topic.name for topic in store.getAllTopics()]
    of_them = f"NODE IN ({', '.join('?' * len(nodes))})"
    found: dict[str, Where] = dict(where)
    for name in names:
        own = where.get(name)
        found[name] = (of_them if own is None else f"({own}) AND {of_them}", nodes)
    return found
