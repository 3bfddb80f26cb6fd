# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the messages of a replay come from: one keyspace, or all stores of a fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Collection, Iterator, Mapping, Protocol, Sequence, Union

from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.playing.stored_ranges import StoredRange, stored_ranges
from cassandra_ros.read import Read, Whose
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.event_finder import EventChoice
from cassandra_ros.topics.event_times import EventTimes, Reads
from cassandra_ros.topics.overview.latched_messages import Latched, LatchedFinder, tests_of
from cassandra_ros.topics.row_finder import Filter, Where
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow

if TYPE_CHECKING:
    from cassandra_ros.stores.fleet.fleet_row import FleetRow

PlayedRow = Union[StoredRow, "FleetRow"]
"""A stored message: of one store, or of several."""


class PlayedStore(Protocol):
    """The store of a replay. Its errors are those of class Catalog."""

    @property
    def called(self) -> str:
        """The store in words, for errors."""

    @property
    def missing(self) -> Mapping[str, str]:
        """The stores of a fleet that did not answer, or not to the end → why."""

    def names(self) -> Collection[str]:
        """Return the names of all topics."""

    def name_of(self, topic: str) -> str:
        """Return the name of a topic as it is stored; raises TopicNotFound."""

    def check_readable(self, topic: str) -> None:
        """Raise DefinitionError if the messages of a topic cannot be read here."""

    def whose(self, node: str | None, run: RunName) -> Whose:
        """Check nodeID and run, and return their Whose; raises RunNotFound or InvalidName."""

    def ranges(self, topics: Sequence[str], whose: Whose) -> list[StoredRange]:
        """Return the time ranges in which the runs have messages of some topics."""

    def event_times(self, choice: EventChoice, whose: Whose) -> EventTimes:
        """Return the times of the events of a choice; raises EventNotFound or InvalidOption."""

    def run_names(self) -> Mapping[int, str]:
        """Return writer id → name of all runs."""

    def connections(self, tables: Collection[str]) -> Iterator[tuple[str, int, Connection]]:
        """Yield the connections of some tables by name: table, number, connection."""

    def losses(self, topics: Sequence[str], read: Read) -> Sequence[Loss]:
        """Return the losses of topics that meet a read."""

    def rows(self, topics: Sequence[str], reads: Reads, where: Conditions) -> Iterator[PlayedRow]:
        """Yield the rows of topics by receive time, part after part."""

    def hits(self, topic: str, condition: Where, read: Read) -> Iterator[PlayedRow]:
        """Yield the rows of a topic that satisfy a condition, by receive time."""

    def latched(self, topics: Sequence[str], whose: Whose, where: Conditions) -> Latched[PlayedRow]:
        """Return the latched messages of topics; the last ones satisfy their conditions."""


class PlayedKeyspace:
    """The messages of one keyspace, see PlayedStore."""

    missing: Mapping[str, str] = {}

    def __init__(self, catalog: Catalog) -> None:
        self._catalog, self._keyspace = catalog, catalog.keyspace
        self.called = f"keyspace {self._keyspace.name}"

    def names(self) -> set[str]:
        """Return the names of all topics."""
        return {topic.name for topic in self._catalog.all(None)}

    def name_of(self, topic: str) -> str:
        """Return the name of a topic as it is stored; raises TopicNotFound."""
        return self._catalog.get(topic).name

    def check_readable(self, topic: str) -> None:
        """Raise DefinitionError if the messages of a topic cannot be read here."""
        _ = self._catalog.get(topic).tables

    def whose(self, node: str | None, run: RunName) -> Whose:
        """Check nodeID and run, and return their Whose; raises RunNotFound or InvalidName."""
        return self._catalog.whose(node, run)

    def ranges(self, topics: Sequence[str], whose: Whose) -> list[StoredRange]:
        """Return the time ranges in which the runs have messages of some topics."""
        return stored_ranges(self._keyspace, self._catalog.tables(topics), whose)

    def event_times(self, choice: EventChoice, whose: Whose) -> EventTimes:
        """Return the times of the events of a choice; raises EventNotFound or InvalidOption."""
        return self._keyspace.events.chosen(choice, Read(whose=whose))

    def run_names(self) -> dict[int, str]:
        """Return writer id → name of all runs."""
        return {run.writer: run.name for run in self._keyspace.registry.runs()}

    def connections(self, tables: Collection[str]) -> Iterator[tuple[str, int, Connection]]:
        """Yield the connections of some tables by name: table, number, connection."""
        return self._keyspace.connections.of_tables(tables)

    def losses(self, topics: Sequence[str], read: Read) -> list[Loss]:
        """Return the losses of topics that meet a read."""
        return self._keyspace.runs.losses(topics, read)

    def rows(self, topics: Sequence[str], reads: Reads, where: Conditions) -> Iterator[StoredRow]:
        """Yield the rows of topics by receive time, part after part."""
        return self._catalog.read_parts(topics, reads, where, received=True)

    def hits(self, topic: str, condition: Where, read: Read) -> Iterator[StoredRow]:
        """Yield the rows of a topic that satisfy a condition, by receive time."""
        stored_topic = self._catalog.get(topic)
        if any(table.metadata.own_time or table.named for table in stored_topic.tables):
            return self._catalog.read([topic], read, {topic: condition}, received=True)
        return Filter(stored_topic, condition, read.whose).rows(read, bare=True)

    def latched(self, topics: Sequence[str], whose: Whose, where: Conditions) -> LatchedFinder:
        """Return the latched messages of topics; the last ones satisfy their conditions."""
        tests = tests_of(self._catalog, where, whose)
        return LatchedFinder(self._keyspace, self._catalog.tables(topics), whose, tests)
