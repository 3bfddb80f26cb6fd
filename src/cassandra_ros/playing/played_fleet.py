# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of all stores of a fleet as a replay reads them, each once."""

from __future__ import annotations

from functools import partial
from itertools import chain
from typing import Collection, Iterator, Mapping, Sequence

from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.playing.stored_ranges import StoredRange, stored_ranges
from cassandra_ros.read import LAST_NS, Read, Whose
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, Missing, settled
from cassandra_ros.stores.fleet.fleet_reads import (
    conditions_of,
    merged_topics,
    times_of_events,
    topic_names,
    topics_of,
    whose_of,
)
from cassandra_ros.stores.fleet.fleet_row import FleetRow, arrival_order, merged_rows
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic, find_topic
from cassandra_ros.topics.catalog import Conditions
from cassandra_ros.topics.event_finder import EventChoice
from cassandra_ros.topics.event_times import EventTimes, Reads
from cassandra_ros.topics.overview.latched_messages import (
    LatchedFinder,
    LatchedRow,
    Publisher,
    Source,
    is_latched,
    publisher_of,
    tests_of,
)
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow


class PlayedFleet:
    """The messages of a fleet, see playing.played_store.PlayedStore.

    A store that does not answer is asked nothing more for this replay: it is in ``missing``.

    Raises:
        StoreUnavailable: No store answers.
    """

    called = "the fleet"

    def __init__(self, fleet: Fleet) -> None:
        self._answer = FleetAnswer(fleet.stores)
        """The stores that have answered all requests of this replay."""

    @property
    def missing(self) -> Missing:
        """The stores that did not answer, or not to the end → why."""
        return self._answer.missing

    def names(self) -> Collection[str]:
        """Return the names of all topics."""
        return topic_names(self._answer)

    def name_of(self, topic: str) -> str:
        """Return the name of a topic as the first store spells it; raises TopicNotFound."""
        return find_topic(self._answer, topic).name

    def check_readable(self, topic: str) -> None:
        """Raise DefinitionError if the messages of a topic cannot be read here."""
        find_topic(self._answer, topic)

    def whose(self, node: str | None, run: RunName) -> Whose:
        """Check nodeID and run, and return their Whose; raises RunNotFound or InvalidName."""
        return settled(self._answer, lambda: whose_of(self._answer, node, run))

    def ranges(self, topics: Sequence[str], whose: Whose) -> list[StoredRange]:
        """Return the time ranges in which the runs have messages of some topics."""

        def find(store: str) -> list[StoredRange]:
            catalog = self._answer.catalogs[store]
            return stored_ranges(catalog.keyspace, catalog.tables(names[store]), whose)

        names = _names(self._topics(topics))
        return list(chain.from_iterable(self._answer.each(_keys(names), find).values()))

    def event_times(self, choice: EventChoice, whose: Whose) -> EventTimes:
        """Return the times of the events of a choice; raises EventNotFound or InvalidOption."""
        return settled(
            self._answer, lambda: times_of_events(self._answer, choice, Read(whose=whose))
        )

    def run_names(self) -> dict[int, str]:
        """Return writer id → name of all runs."""
        runs = self._answer.each(self._answer.catalogs, lambda c: list(c.keyspace.registry.runs()))
        return {run.writer: run.name for store_runs in runs.values() for run in store_runs}

    def connections(self, tables: Collection[str]) -> Iterator[tuple[str, int, Connection]]:
        """Yield the connections of some tables by name: table, number, connection."""
        connections = self._answer.each(
            self._answer.catalogs, lambda c: list(c.keyspace.connections.of_tables(tables))
        )
        return chain.from_iterable(connections.values())

    def losses(self, topics: Sequence[str], read: Read) -> list[Loss]:
        """Return the losses of topics that meet a read, each once."""
        losses = self._answer.each(
            self._answer.catalogs, lambda c: c.keyspace.runs.losses(topics, read)
        )
        return list(dict.fromkeys(chain.from_iterable(losses.values())))

    def rows(self, topics: Sequence[str], reads: Reads, where: Conditions) -> Iterator[FleetRow]:
        """Yield the rows of topics by receive time, part after part."""

        def begin() -> Iterator[FleetRow]:
            played_topics = topics_of(self._answer, topics)
            conditions = conditions_of(self._answer, played_topics, where)
            return chain.from_iterable(
                merged_topics(self._answer, played_topics, read, conditions, True)
                for read in reads.parts
            )

        return settled(self._answer, begin)

    def hits(self, topic: str, condition: Where, read: Read) -> Iterator[FleetRow]:
        """Yield the rows of a topic that satisfy a condition, by receive time."""
        return self.rows([topic], Reads(read, [read]), {topic: condition})

    def latched(self, topics: Sequence[str], whose: Whose, where: Conditions) -> FleetLatched:
        """Return the latched messages of topics; the last ones satisfy their conditions."""
        played_topics = self._topics(topics)
        conditions = settled(
            self._answer, lambda: conditions_of(self._answer, played_topics, where)
        )
        names = _names(played_topics)

        def make(store: str) -> LatchedFinder:
            catalog = self._answer.catalogs[store]
            wanted = {
                topic.names[store]: conditions[topic.name]
                for topic in played_topics
                if store in topic.names and topic.name in conditions
            }
            tests = tests_of(catalog, wanted, whose)
            return LatchedFinder(catalog.keyspace, catalog.tables(names[store]), whose, tests)

        return FleetLatched(self._answer, self._answer.each(_keys(names), make))

    def _topics(self, topics: Sequence[str]) -> list[FleetTopic]:
        return settled(self._answer, lambda: topics_of(self._answer, topics))


class FleetLatched:
    """The latched messages of some topics in all stores, see overview.latched_messages.Latched."""

    def __init__(self, answer: FleetAnswer, finders: Mapping[str, LatchedFinder]) -> None:
        self._answer, self._finders = answer, finders

    @property
    def latches(self) -> bool:
        """Whether a store has a latched connection of the topics."""
        return any(self._answer.each(self._finders, lambda finder: finder.latches).values())

    def is_latched(self, row: LatchedRow) -> bool:
        """Return whether a message came over a latched connection."""
        return is_latched(row.connection)

    def before(self, t: int, to: int = LAST_NS) -> list[FleetRow]:
        """Return the last latched message before t of each publisher with messages in [t, to]."""
        return self.of_sources(self.sources(t, to), t) if self.latches and t > 0 else []

    def sources(self, t: int, to: int) -> frozenset[Source]:
        """Return the runs that have messages of any topic in [t, to], in any store."""
        sources = self._answer.each(self._finders, lambda finder: finder.sources(t, to))
        return frozenset().union(*sources.values())

    def of_sources(self, sources: frozenset[Source], t: int, since: int = 0) -> list[FleetRow]:
        """Return the last latched message in [since, t) of each publisher of some runs."""

        def begin(finder: LatchedFinder) -> Iterator[StoredRow]:
            return iter(finder.of_sources(sources, t, since))

        streams = {store: partial(begin, finder) for store, finder in self._finders.items()}
        last: dict[tuple[str, Publisher], FleetRow] = {}
        for row in merged_rows(self._answer, streams, arrival_order):
            last[row.topic.lstrip("/"), publisher_of(row)] = row
        return sorted(last.values(), key=lambda row: row.arrival)


def _names(topics: Sequence[FleetTopic]) -> dict[str, list[str]]:
    """Return for each store the names that it has for some topics."""
    names: dict[str, list[str]] = {}
    for topic in topics:
        for store, name in topic.names.items():
            names.setdefault(store, []).append(name)
    return names


def _keys(names: Mapping[str, object]) -> dict[str, str]:
    """Return store → store, for ``FleetAnswer.each``, whose function then gets the name."""
    return {store: store for store in names}
