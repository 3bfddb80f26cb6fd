# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics, robots, events and rows of a question, found in all stores that it asks."""

from __future__ import annotations

import heapq
import logging
from functools import partial
from itertools import islice
from typing import Iterator, Mapping, Sequence

from cassandra_ros.arguments import check_nodes, spellings
from cassandra_ros.errors import DefinitionError, EventNotFound, InvalidOption, RunNotFound
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, told
from cassandra_ros.stores.fleet.fleet_row import (
    FleetRow,
    arrival_order,
    key_order,
    read_once,
    resumed,
)
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic, find_topic
from cassandra_ros.topics.catalog import Conditions
from cassandra_ros.topics.event_finder import MOST_EVENTS, EventChoice
from cassandra_ros.topics.event_times import EventTimes, merged_events
from cassandra_ros.topics.query_result import Condition
from cassandra_ros.topics.row_finder import Where, checked_where
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow

_log = logging.getLogger(__name__)


def whose_of(answer: FleetAnswer, node: str | None, run: RunName) -> Whose:
    """Return the robot, and the writers that a run has in any store; raises RunNotFound.

    A robot that no store has is told by a warning.
    """
    nodes = check_nodes(node)
    if node is not None:
        robot = node
        reasons = answer.each(answer.catalogs, lambda c: c.keyspace.runs.unknown_robot(robot))
        if reasons and all(reasons.values()):
            _log.warning("no store of the fleet has the robot: %s", "; ".join(reasons.values()))
    return Whose(nodes, None if run is None else writers_of(answer, run))


def writers_of(answer: FleetAnswer, run: RunName) -> frozenset[int]:
    """Return the writers that a run has in any store; raises RunNotFound."""
    reasons: list[str] = []

    def find(name: str) -> frozenset[int]:
        try:
            return answer.catalogs[name].keyspace.runs.writers(run) or frozenset()
        except RunNotFound as exc:
            reasons.append(f"{name}: {exc}")
            return frozenset()

    writers_by_store = answer.each({name: name for name in answer.catalogs}, find)
    writers = frozenset().union(*writers_by_store.values())
    if not writers:
        away = f"; these do not answer: {told(answer.missing)}" if answer.partial else ""
        raise RunNotFound(f"no store of the fleet has run {run!r:.80} – {'; '.join(reasons)}{away}")
    return writers


def events_of(
    answer: FleetAnswer, name: str | None, like: str | None, within: TimeRange, whose: Whose
) -> Iterator[Event]:
    """Yield the events of all stores in order of their starts, each once."""
    finders = {store: c.keyspace.events.find for store, c in answer.catalogs.items()}
    begins = {store: partial(find, name, like, within, whose) for store, find in finders.items()}
    return merged_events(answer.rows(begins).values())


def times_of_events(answer: FleetAnswer, choice: EventChoice, read: Read) -> EventTimes:
    """Return the times of the events of a choice, of all stores, that meet a read.

    Raises:
        EventNotFound: No store has such an event.
        InvalidOption: There are too many.
    """
    name, before, after = choice
    low, high = read.time_range
    within = TimeRange(max(0, low - after), min(LAST_NS, high + before))
    events = list(islice(events_of(answer, name, None, within, read.whose), MOST_EVENTS + 1))
    if len(events) > MOST_EVENTS:
        raise InvalidOption(
            f"there are more than {MOST_EVENTS} events {name!r:.80}: give a shorter time range"
        )
    if not events:
        away = f"; these do not answer: {told(answer.missing)}" if answer.partial else ""
        raise EventNotFound(
            f"no store of the fleet has an event {name!r:.80} of this time, robot and run{away}"
        )
    return EventTimes(events, before, after)


def topic_names(answer: FleetAnswer) -> list[str]:
    """Return the names of the topics of all stores, sorted.

    A topic that one store has with the leading slash and another without it is listed once, as the
    first store spells it. If one store has both, these are two topics.
    """
    listed: set[str] = set()
    for names in answer.each(answer.catalogs, lambda c: c.names(fresh=False)).values():
        for name in names:
            _, other = spellings(name)
            if other in names or other not in listed:
                listed.add(name)
    return sorted(listed)


def topics_of(answer: FleetAnswer, names: Sequence[str] | None) -> list[FleetTopic]:
    """Return topics, each once whatever its spelling; None = all that can be read."""
    topics: dict[frozenset[tuple[str, str]], FleetTopic] = {}
    for name in topic_names(answer) if names is None else names:
        try:
            topic = find_topic(answer, name)
        except DefinitionError as exc:
            if names is not None:
                raise
            _log.error("topic %s is left out, it cannot be read here: %s", name, exc)
            continue
        topics.setdefault(frozenset(topic.names.items()), topic)
    return list(topics.values())


def conditions_of(
    answer: FleetAnswer, topics: Sequence[FleetTopic], where: Conditions
) -> dict[str, Where]:
    """Return topic → condition, of each topic that has one, by the names of FleetTopic.

    Raises:
        TopicNotFound: No store has a topic of ``where``.
        InvalidOption: A topic of ``where`` is not read or has two conditions, or it is no mapping.
    """
    if where is None:
        return {}
    if not isinstance(where, Mapping):
        raise InvalidOption(f"where= is a mapping of topics to conditions, not {where!r:.80}")
    conditions: dict[str, Where] = {}
    for name, condition in where.items():
        topic = find_topic(answer, name).name
        if topic not in [fleet_topic.name for fleet_topic in topics]:
            raise InvalidOption(f"there is a condition for topic {topic}, which is not read")
        if topic in conditions:
            raise InvalidOption(f"there are two conditions for topic {topic}; join them")
        conditions[topic] = condition
    return conditions


def rows_of(topic: FleetTopic, read: Read, where: Where | None) -> Iterator[FleetRow]:
    """Yield the rows of a read that satisfy a condition."""
    if where is None:
        return topic.read(read)
    condition = Condition(*checked_where(where))
    if read.only is None:
        return condition.rows(topic, read)
    return filter(condition.test(topic.tables, read.whose), topic.read(read))


def merged_topics(
    answer: FleetAnswer,
    topics: Sequence[FleetTopic],
    read: Read,
    conditions: Mapping[str, Where],
    received: bool,
) -> Iterator[FleetRow]:
    """Yield the rows of several topics in one order; those without a condition are read together.

    Args:
        read: In ascending order. With a position after which rows are read, by keys only.
        conditions: Topic → condition, as conditions_of returns them.
        received: Whether the time range and the order are those of receive times.
    """
    if read.after is not None:
        return resumed(read, lambda r: merged_topics(answer, topics, r, conditions, received))
    order = arrival_order if received else key_order
    # Store → topics that are read together: no condition, and no names, whose newest row counts.
    plain: dict[str, list[str]] = {name: [] for name in answer.catalogs}
    streams: list[Iterator[FleetRow]] = []
    for topic in topics:
        where = conditions.get(topic.name)
        if where is None and topic.key_format != "hash":
            for store, name in topic.names.items():
                plain.setdefault(store, []).append(name)
        elif received and where is not None:
            test = Condition(*checked_where(where)).test(topic.tables, read.whose)
            streams.append(filter(test, topic.received(read)))
        else:
            streams.append(topic.received(read) if received else rows_of(topic, read, where))

    def begin(store: str, read: Read) -> Iterator[StoredRow]:
        catalog = answer.catalogs[store]
        return catalog.merged(catalog.tables(plain[store]), {}, read, received=received)

    begins = {store: partial(begin, store) for store, names in plain.items() if names}
    streams.append(read_once(answer, begins, plain, read, order))
    return heapq.merge(*streams, key=order)
