# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic in several stores, as the query language reads it: each message once."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Callable, Iterator, Mapping, Sequence, TypeVar

from cassandra_ros.errors import InvalidQuery, SchemaConflict, StoreUnavailable, TopicNotFound
from cassandra_ros.query.tree.syntax import Select
from cassandra_ros.read import EVERYBODY, Read, TimeRange, Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, told
from cassandra_ros.stores.fleet.fleet_row import FleetRow, arrival_order, read_once, resumed
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.row_finder import AnyKey, Finder
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

_T = TypeVar("_T")


class FleetTopic:
    """The stored messages of one topic in the stores that have it; a source of the query language.

    Args:
        answer: The stores.
        topics: The topic in each store that has it, by the store's name.

    Attributes:
        name: Name of the topic, as the first store spells it.
        tables: Its tables in all stores.
        key_format: Its key format, the same in all stores.

    Raises:
        SchemaConflict: The stores have different key formats.
        StoreUnavailable: No store with the topic answers any more.
    """

    def __init__(self, answer: FleetAnswer, topics: Mapping[str, CassandraTopic]) -> None:
        self._answer = answer
        tables_by_store = answer.each(topics, lambda topic: list(topic.tables))
        self.name = next(iter(topics.values())).name
        self._topics = {name: topics[name] for name in tables_by_store}
        if not self._topics:
            raise self._no_store_error()
        self.tables = [table for tables in tables_by_store.values() for table in tables]
        self.key_format = _key_format(self.name, tables_by_store)

    @property
    def names(self) -> Mapping[str, str]:
        """Name of each store that has the topic → the topic's name there."""
        return {store: topic.name for store, topic in self._topics.items()}

    def read_of(self, key: AnyKey, to_key: AnyKey, whose: Whose) -> Read:
        """Return the read of a time range, or of the messages with one key; see Finder.read_of.

        Raises:
            StoreUnavailable: No store with the topic answers any more.
        """
        return self._by_finder(whose, lambda finder: finder.read_of(key, to_key))

    def read_of_one(self, key: AnyKey, whose: Whose = EVERYBODY) -> Read:
        """Return the read of the messages with a single key; raises like read_of."""
        return self._by_finder(whose, lambda finder: finder.one(key))

    def key_of_text(self, text: str) -> AnyKey:
        """Return the key in a text that a user typed, see CassandraTopic.keyOfText."""
        return self._by_finder(EVERYBODY, lambda finder: finder.of_text(text))

    def _by_finder(self, whose: Whose, work: Callable[[Finder], _T]) -> _T:
        """Return what a function of a Finder gives: all stores are asked, the first one counts."""

        def ask(name: str) -> _T:
            keyspace, tables = self._answer.catalogs[name].keyspace, self._topics[name].tables
            return work(Finder(keyspace, self.name, self.key_format, tables, whose))

        results = self._answer.each({name: name for name in self._topics}, ask)
        if not results:
            raise self._no_store_error()
        return next(iter(results.values()))

    def _no_store_error(self) -> StoreUnavailable:
        missing = told(self._answer.missing)
        return StoreUnavailable(f"no store with topic {self.name} answers any more: {missing}")

    def read(self, read: Read) -> Iterator[FleetRow]:
        """Yield the messages of a read in its order, each once."""
        return resumed(read, self._read)

    def in_order(self, read: Read, least: object) -> Iterator[FleetRow]:
        """Yield the messages of ``read``, one by one, since several stores may have each."""
        return self.read(read)

    def _read(self, read: Read) -> Iterator[FleetRow]:
        """Yield the messages of a read, which names no position."""
        streams = {name: topic.read for name, topic in self._topics.items()}
        rows = read_once(self._answer, streams, self._names_by_store(), read)
        return rows if self.key_format != "hash" else self._newest(rows)

    def received(self, read: Read) -> Iterator[FleetRow]:
        """Yield the messages received in the time range of a read, by receive time, each once."""

        def begin(store: str, read: Read) -> Iterator[StoredRow]:
            topic, keyspace = self._topics[store], self._answer.catalogs[store].keyspace
            return keyspace.rows.received(topic.tables, read)

        streams = {store: partial(begin, store) for store in self._topics}
        rows = read_once(self._answer, streams, self._names_by_store(), read, arrival_order)
        return rows if self.key_format != "hash" else self._newest(rows)

    def count(self, read: Read) -> int:
        """Return the number of messages of a read, each counted once.

        One store counts by its directory; where several have to be read, the keys are read. What a
        store had that does not answer is missing.
        """
        if len(self._topics) == 1:
            return sum(self._answer.each(self._topics, lambda t: t.count(read)).values())
        keys_read = replace(read, columns=lambda table: (), chooser=None, wanted=None)

        def count(store: str, time_range: TimeRange) -> int:
            return self._topics[store].count(replace(read, time_range=time_range))

        counts, shared = self.divided(read, count)
        reads = (replace(keys_read, time_range=time_range) for time_range in shared)
        return sum(counts) + sum(1 for time_range in reads for _ in self.read(time_range))

    def divided(
        self, read: Read, work: Callable[[str, TimeRange], _T]
    ) -> tuple[list[_T], list[TimeRange]]:
        """Call a function with the first store and each time range for which it alone is read.

        So a store can count by its directory where, by the books, it has all messages.

        Returns:
            The results, and the time ranges of the read for which several stores must be read. They
            begin and end with buckets of the first store; [] and the whole range if it cannot be
            divided.
        """
        tables = self._answer.each(self._topics, lambda topic: list(topic.tables))
        first = next(iter(self._topics))
        first_tables = tables.get(first, [])
        named = any(table.named for store_tables in tables.values() for table in store_tables)
        if len(first_tables) != 1 or named or read.only is not None:
            return [], [read.time_range]
        spared = self._answer.books.spared(self._names_by_store(), read)
        shared = spared.shared(tables, read) if spared else None
        if shared is None:
            return [], [read.time_range]
        alone: list[TimeRange] = []  # what lies between the shared time ranges
        low, high = read.time_range
        for time_range in (*shared, TimeRange(high + 1, high)):
            if low < time_range.low:
                alone.append(TimeRange(low, time_range.low - 1))
            low = time_range.high + 1
        results: list[_T] = []
        for time_range in alone:
            results += self._answer.each({first: time_range}, partial(work, first)).values()
        if len(results) < len(alone):  # the store went away, and others have the messages, too
            return [], [read.time_range]
        return results, shared

    def _names_by_store(self) -> dict[str, list[str]]:
        """Return the topic as fleet_books.Topics."""
        return {store: [name] for store, name in self.names.items()}

    def countBuckets(self) -> int:
        """Return the number of partitions in all stores."""
        buckets = self._answer.each(self._topics, lambda topic: topic.countBuckets())
        return sum(buckets.values())

    def _newest(self, rows: Iterator[FleetRow]) -> Iterator[FleetRow]:
        """Yield, of the rows under one name, only the one that was stored last.

        Each store has one of them, the stores perhaps others. The keys of all stores are read.
        """
        newest: dict[tuple[str, str], tuple[int, int]] = {}
        for places in self._answer.each(self._topics, _places_of).values():
            for key, place in places:
                newest[key] = max(place, newest.get(key, place))
        for row in rows:
            place = row.t, row.seq
            if place >= newest.get((row.node, row.name), place):
                yield row


def _places_of(topic: CassandraTopic) -> list[tuple[tuple[str, str], tuple[int, int]]]:
    """Return node and name, and time and seq, of all messages of a topic with names."""
    keys = (key.position for table in topic.tables for key in list_names(table, None))
    return [((key.node, key.name), (key.t, key.seq)) for key in keys]


def _key_format(topic: str, tables_by_store: Mapping[str, Sequence[TopicTable]]) -> str:
    """Return the key format of a topic; raises SchemaConflict if it is not the same everywhere."""
    kinds: dict[tuple[str, str], str] = {}
    for name, tables in tables_by_store.items():
        for table in tables:
            kinds.setdefault((table.metadata.key_format, table.metadata.key_part), name)
    if len(kinds) > 1:
        texts = [f"{' '.join(kind).rstrip()} in {name}" for kind, name in kinds.items()]
        raise SchemaConflict(
            f"topic {topic} has key format {', and '.join(texts)}: these messages have no common "
            "order; ask each store alone"
        )
    return next(iter(kinds))[0] if kinds else "time"


def topic_of(answer: FleetAnswer, select: Select) -> FleetTopic:
    """Return the topic that a statement names; raises InvalidQuery if no store has it."""
    try:
        return find_topic(answer, select.topic)
    except TopicNotFound as exc:
        raise InvalidQuery(select.text, select.topic_position, str(exc)) from exc


def find_topic(answer: FleetAnswer, name: str) -> FleetTopic:
    """Return a topic by its name, with or without the leading slash, in the stores that have it.

    Raises:
        TopicNotFound: No store has it; the text names them all.
        SchemaConflict: The stores have different key formats.
    """
    reasons: dict[str, str] = {}

    def find(store: str) -> CassandraTopic | None:
        try:
            return answer.catalogs[store].get(name)
        except TopicNotFound as exc:
            reasons[store] = str(exc)
            return None

    topic_by_store = answer.each({store: store for store in answer.catalogs}, find)
    topics = {store: topic for store, topic in topic_by_store.items() if topic is not None}
    if not topics:
        text = "; ".join(f"{store}: {reasons[store]}" for store in topic_by_store)
        if answer.missing:
            text += f"; and these do not answer: {told(answer.missing)}"
        raise TopicNotFound(f"no store of the fleet has topic {name!r} – {text}")
    return FleetTopic(answer, topics)
