# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topics of a keyspace: added, found, listed, removed by name, and read several at once."""

from __future__ import annotations

import difflib
import heapq
import logging
import re
import shlex
import threading
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from typing import Iterable, Iterator, Mapping, Optional, Sequence, Tuple

from cassandra_ros.arguments import check_nodes, check_topic, check_topics, spellings
from cassandra_ros.errors import (
    CassandraRosError,
    DefinitionError,
    InvalidName,
    InvalidOption,
    MessageNotFound,
    TopicExists,
    TopicNotFound,
)
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.ros_master import topic_type
from cassandra_ros.messages.stamps import Time, duration_ns
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.places.whereabouts import Whereabouts
from cassandra_ros.read import EVERYBODY, LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.event_finder import (
    AroundRule,
    EventChoice,
    EventRule,
    WindowRule,
    merge_windows,
)
from cassandra_ros.topics.event_times import Reads
from cassandra_ros.topics.indexes import check_unnamed, no_index_in_blocks
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_adder import MessageAdder
from cassandra_ros.topics.new_tables import Wish, check_packed
from cassandra_ros.topics.removal import delete_time_range
from cassandra_ros.topics.row_finder import Clock, Filter, Where, time_range_between
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_places import StoredPlaces
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import TopicInfo, count_rows, describe
from cassandra_ros.topics.topic_table import TopicTable, stored_format

_log = logging.getLogger(__name__)

Conditions = Optional[Mapping[str, Where]]
"""Topic → condition."""
Pair = Tuple[StoredRow, Optional[StoredRow]]
"""A row, and its partner in another stream; None = it has no partner."""


class Catalog:
    """Finds topics by name, with or without the leading slash. Thread-safe.

    Topics that were added without a type exist only here until their first message.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str, clock: Clock | None) -> None:
        self.keyspace = Keyspace(cassandra, keyspace, robots=lambda: self.places)
        self.adder = MessageAdder(self.keyspace, clock)
        self._pending: dict[str, Wish] = {}
        """Topics that were added without a type, until a table of them is listed."""
        self._mutex = threading.Lock()
        self.stored_places = StoredPlaces(self.keyspace, self.get, lambda: self.all(None))
        """The topics, for lookups of the robots' places."""
        self.places = Whereabouts(self.stored_places, self.keyspace.place_index)
        """Lookup of the robots' places in the keyspace."""

    def add(
        self, metadata: TopicMetadata, msg_type: str | None, ask_master: bool = True
    ) -> CassandraTopic:
        """Make a topic, or find it; see RosCassandra.addTopic. Format '' = as it is stored.

        Without ``msg_type`` and ``ask_master`` its first message makes it, and fixes its type.
        """
        topic = metadata.topic
        if metadata.indexes:
            check_unnamed(topic, metadata.key_format)
        self.keyspace.schema.tables(fresh=True)
        format_name = self.keyspace.new_tables.format_for(topic, format=metadata.format)
        wish = Wish(
            metadata.with_(format=format_name), has_format=metadata.format != "", pending=True
        )
        stored = self.keyspace.tables.of_topic(topic)
        if format_class(format_name).PACKED:
            check_packed(stored[0].metadata if stored else wish.metadata)
            if metadata.indexes and not any(table.metadata.takes_index for table in stored):
                raise no_index_in_blocks(topic)
        definition = self._definition_for(topic, msg_type, ask_master and not stored)
        for table in stored:
            wish.check(table.metadata, definition)
        new_topic = CassandraTopic(self.keyspace, self.adder, wish)
        if not any(table.metadata.format == format_name for table in stored):
            # Of an earlier topic of this name; if it stayed, the new one would count as removed.
            self.keyspace.schema.seen.discard((topic, format_name))
            with self._mutex:
                self._pending[topic] = wish
        if definition is not None:
            try:
                self.keyspace.new_tables.for_wish(wish, definition)
            except CassandraRosError:
                with self._mutex:
                    self._pending.pop(topic, None)
                raise
        for field in metadata.indexes:
            if new_topic.tables and not new_topic.hasIndex(field):
                new_topic.createIndex(field)
        return new_topic

    def _definition_for(
        self, topic: str, msg_type: str | None, ask_master: bool
    ) -> Definition | None:
        """Return the definition of the given type, or of the type that the ROS master knows.

        None if there is no such type, or that of the master is not installed.
        """
        if msg_type is not None:
            return installed_definition(msg_type)
        master_type = topic_type(topic) if ask_master else None
        try:
            return None if master_type is None else installed_definition(master_type)
        except DefinitionError as exc:
            _log.info("the type of topic %s is fixed by its first message: %s", topic, exc)
            return None

    def get(self, topic: str) -> CassandraTopic:
        """Return a topic; raises TopicNotFound with similar names."""
        name = self._find(topic, fresh=False) or self._find(topic, fresh=True)
        if name is not None:
            return self._topic(name)
        names = self.names()
        near = difflib.get_close_matches(topic, names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"it holds {len(names)} topics"
        if not names:
            hint = self.keyspace.side_tables.absence() or hint
        hint = self._other_meaning(topic) or hint
        raise TopicNotFound(
            f"topic {topic!r} is not stored in keyspace {self.keyspace.name}; {hint}"
        )

    def _other_meaning(self, name: str) -> str:
        """Say what has a name that is not a topic's; '' = nothing."""
        base = name.rsplit("/", 1)[-1]
        for run in self.keyspace.registry.runs() if base else ():
            if run.name in (name, base):
                option = f"--run {shlex.quote(run.name)}"
                return f"it is the name of a run: {option} (in Python run=) selects its messages"
            if run.node == base:
                option = f"--node-id {shlex.quote(run.node)}"
                return f"it is a robot: {option} (in Python nodeID=) selects its messages"
        if base.lower().endswith((".bag", ".mcap")):
            return "a file is stored with 'cassandra_bag import', and is then a run: --run"
        return ""

    def exists(self, topic: str) -> bool:
        """Return whether get would find the topic."""
        return self._find(topic, fresh=True) is not None

    def all(self, pattern: str | None) -> list[CassandraTopic]:
        """Return the topics whose whole name matches a regular expression, sorted."""
        try:
            expression = re.compile(".*" if pattern is None else pattern, re.DOTALL)
        except (re.error, OverflowError, RecursionError) as exc:
            raise InvalidName(f"{pattern!r:.80} is not a regular expression: {exc}") from exc
        return [self._topic(name) for name in sorted(self.names()) if expression.fullmatch(name)]

    def names(self, *, fresh: bool = True) -> set[str]:
        """Return the names of all topics; fresh: ask the server, else by comments up to 2 s old."""
        listing = self.keyspace.schema.listing(fresh=fresh)
        with self._mutex:
            for name, wish in list(self._pending.items()):
                if (name, wish.metadata.format) in self.keyspace.schema.seen:
                    del self._pending[name]  # its first message has been stored
            return {*listing.by_topic, *self._pending}

    def is_written(self, topic: str) -> bool:
        """Return whether a client, such as a recorder, is writing messages of a topic now."""
        return self._are_written(self.tables([topic]))

    def _are_written(self, tables: Sequence[TopicTable]) -> bool:
        """Return whether a bucket of some tables is open, and its writer alive."""
        directory = self.keyspace.directory
        return any(
            row.writing and row.age_sec <= STALE_SEC
            for table in tables
            for row in directory.buckets(table.name, table.metadata, 0, table.bucket_of(LAST_NS))
        )

    def remove(self, topic: str, *, renew: bool = False) -> int:
        """Delete a topic with all its messages; renew: keep the topic itself.

        If renew is set and a client is writing the topic, only the messages that were there at the
        beginning are deleted.

        Returns:
            The number of deleted messages.

        Raises:
            TopicNotFound: There is no such topic.
        """
        name, space = self.get(topic).name, self.keyspace
        self.adder.close()
        tables: list[TopicTable] = []
        with suppress(DefinitionError):  # a topic that cannot be read here can still be removed
            tables = self.tables([name])
        if renew and self._are_written(tables):
            # Dropping its table would also drop later messages, which no count contains.
            space.registry.forget_losses(name)
            return sum(
                delete_time_range(space, [table], Read()) for table in tables if not table.named
            )
        removed = count_rows(space.directory, tables, Read())
        for table in space.schema.drop_topic(name, renew=renew):
            space.delete_entries(table)
        space.registry.forget_losses(name)
        if not renew:
            with self._mutex:
                self._pending.pop(name, None)
        return removed

    def rename(self, topic: str, new_name: str) -> None:
        """Give a topic another name, also one without a type.

        Raises:
            TopicNotFound: There is no such topic.
            TopicExists: A topic has the new name, with or without the leading slash.
            SchemaConflict, StoreUnavailable: The name cannot be changed now.
        """
        name = self.get(topic).name
        if name in spellings(new_name):
            raise TopicExists(
                f"topic {name} is found as {new_name} already, because the leading slash may be "
                "left out: give another name"
            )

        def check(tables: Mapping[str, TopicMetadata]) -> None:
            stored = {*self._pending, *(m.topic for m in tables.values())}
            for other in stored.intersection(spellings(new_name)):
                raise TopicExists(
                    f"topic {name} cannot be renamed: {other} is stored already; remove or "
                    "rename that first"
                )

        with self._mutex:
            wish = self._pending.get(name)
        if wish is None or self.keyspace.tables.of_topic(name):
            self.keyspace.schema.change_topic(name, lambda m: m.with_(topic=new_name), check)
        else:
            check(self.keyspace.schema.tables(fresh=True))
        self.keyspace.registry.rename_losses(name, new_name)
        self.keyspace.registry.rename_counts(name, new_name)
        self.adder.close()
        with self._mutex:
            if self._pending.pop(name, None) is not None and wish is not None:
                metadata = wish.metadata.with_(topic=new_name)
                self._pending[new_name] = replace(wish, metadata=metadata)

    def _find(self, topic: str, fresh: bool) -> str | None:
        """Return the stored name of a topic, which may differ in the slash; None = not stored."""
        check_topic(topic)
        names = self.names(fresh=fresh)
        return next((name for name in spellings(topic) if name in names), None)

    def _topic(self, name: str) -> CassandraTopic:
        """Return the topic with a stored name."""
        with self._mutex:
            wish = self._pending.get(name)
        # By the comments alone: a table that cannot be read must not hide the other topics.
        listing = self.keyspace.schema.listing()
        tables = [listing.visible[table] for table in listing.by_topic.get(name, ())]
        if wish is None and not tables:
            raise TopicNotFound(f"topic {name} was removed from keyspace {self.keyspace.name}")
        if wish is None:
            # Metadata for a further table of the topic, without the facts of this one table.
            blank = tables[0].with_(
                **dict.fromkeys(("msg_type", "md5sum", "definition", "date"), ""),
                bucket_ns=0,
                format=stored_format(tables),
                indexes={},
                index_names={},
            )
            wish = Wish(blank, has_format=False, pending=False)
        wish = replace(wish, pending=not tables)
        return CassandraTopic(self.keyspace, self.adder, wish)

    def tables(self, topics: Iterable[str] | None) -> list[TopicTable]:
        """Return the tables of some topics, None = of all topics that can be read.

        They are those of this moment: a table that is made or replaced later is not among them.
        Readers that must follow changes take a ``TableSet``.

        Raises:
            TopicNotFound: A topic is not stored, or was removed meanwhile.
        """
        if topics is not None:
            self.keyspace.schema.tables(fresh=True)
            # A topic may be given twice: with and without its leading slash.
            named = {topic.name: topic for topic in map(self.get, topics)}
            return [table for topic in named.values() for table in topic.tables]
        tables: list[TopicTable] = []
        for topic in self.all(None):
            try:
                tables.extend(topic.tables)
            except DefinitionError as exc:
                _log.error("topic %s is left out, it cannot be read here: %s", topic.name, exc)
        return tables

    def time_range(
        self, topics: Iterable[str] | None, key: Time | None, to_key: Time | None
    ) -> TimeRange:
        """Return the time range between two times, None = open; see time_range_between."""
        if key is None and to_key is None:
            return TimeRange()
        return time_range_between(self.keyspace, self.tables(topics), key, to_key)

    def read_of(
        self,
        topics: Iterable[str] | None,
        key: Time | None,
        to_key: Time | None,
        whose: Whose,
    ) -> Read:
        """Return the read of some topics between two times, None = open; see time_range."""
        return Read(self.time_range(topics, key, to_key), whose)

    def reads_of(
        self,
        topics: Iterable[str] | None,
        key: Time | None,
        to_key: Time | None,
        whose: Whose,
        event: EventRule = None,
        around: AroundRule = None,
    ) -> Reads:
        """Return the reads of some topics between two times.

        With ``event`` during these events, with ``around`` around these messages.

        Raises:
            EventNotFound: There is no such event of that time, robot and run.
            MessageNotFound, TopicNotFound, InvalidQuery: See _reads_around.
            InvalidName, InvalidKey, InvalidOption: The event, or a time, is not valid, or both
                event and around are given.
        """
        whole, choice = self.read_of(topics, key, to_key, whose), EventChoice.of(event)
        rule = None if around is None else WindowRule.of(around[0], *map(duration_ns, around[1:]))
        if choice is not None and around is not None:
            raise InvalidOption("an event and around were given: give one of them")
        if rule is not None:
            return self._reads_around(whole, rule)
        if choice is None:
            return Reads(whole, [whole])
        return Reads(whole, self.keyspace.events.chosen(choice, whole).reads(whole))

    def _reads_around(self, whole: Read, rule: WindowRule) -> Reads:
        """Return the reads around the messages that satisfy a rule, by receive time.

        Raises:
            MessageNotFound: No message satisfies it.
            TopicNotFound, InvalidQuery: The topic is not stored, or the condition is not valid.
        """
        name = self.get(rule.topic).name
        hits = self.read([name], whole, {name: rule.condition}, received=True)
        times = (row.received for row in hits)
        windows = merge_windows(times, rule.before, rule.after, whole.time_range)
        reads = [replace(whole, time_range=window) for window in windows]
        if not reads:
            raise MessageNotFound(
                f"no message of topic {name} of this time, robot and run satisfies "
                f"{rule.condition!r:.200}: nothing lies around one"
            )
        return Reads(whole, reads)

    def whose(self, node: str | None, run: RunName) -> Whose:
        """Check nodeID and run, and return their Whose; raises RunNotFound or InvalidName.

        A warning names a robot without messages, once. It is no error: they may come later.
        """
        writers = None if run is None else self.keyspace.runs.writers(run)
        nodes = check_nodes(node)
        self.keyspace.runs.check_robot(node)
        return Whose(nodes, writers)

    def filters(
        self, where: Conditions, topics: Iterable[str] | None, whose: Whose = EVERYBODY
    ) -> dict[str, Filter]:
        """Return the filter of each topic with a condition.

        Args:
            topics: Topics that are read; None = all. A condition for another topic is an error.
            whose: Robots and writers whose messages are tested.

        Raises:
            InvalidOption: ``where`` is no mapping, or has another topic, or one topic twice.
            TopicNotFound, InvalidQuery: A topic is not stored, or a condition is not valid.
        """
        if where is None:
            return {}
        if not isinstance(where, Mapping):
            raise InvalidOption(f"where= is a mapping of topics to conditions, not {where!r:.80}")
        self.keyspace.schema.tables(fresh=True)
        read_topics = None if topics is None else {self.get(name).name for name in topics}
        filters: dict[str, Filter] = {}
        for name, condition in where.items():
            topic = self.get(name)
            if read_topics is not None and topic.name not in read_topics:
                listing = ", ".join(sorted(read_topics)) or "none"
                raise InvalidOption(
                    f"there is a condition for topic {topic.name}, which is not among those that "
                    f"are read: {listing}"
                )
            if topic.name in filters:
                raise InvalidOption(f"there are two conditions for topic {topic.name}; join them")
            filters[topic.name] = Filter(topic, condition, whose)
        return filters

    def infos(
        self, topics: Iterable[str] | None, node: str | None = None, run: RunName = None
    ) -> list[TopicInfo]:
        """Describe what is stored; see RosCassandra.info."""
        tables, whose = self.tables(check_topics(topics)), self.whose(node, run)
        losses = self.keyspace.runs.losses(None, Read(whose=whose))
        return describe(self.keyspace.directory, tables, whose, losses)

    def read(
        self,
        topics: Iterable[str] | None,
        read: Read,
        where: Conditions = None,
        *,
        received: bool = False,
    ) -> Iterator[StoredRow]:
        """Yield the rows of several topics lazily, merged by time; see RosCassandra.readMessages.

        Args:
            received: Whether the time range and the order are those of receive times.
        """
        return self.read_parts(topics, Reads(read, [read]), where, received=received)

    def read_parts(
        self,
        topics: Iterable[str] | None,
        reads: Reads,
        where: Conditions = None,
        *,
        received: bool = False,
    ) -> Iterator[StoredRow]:
        """Yield the rows of several topics lazily, one part of the reads after the other."""
        filters, tables = self.filters(where, topics, reads.whole.whose), self.tables(topics)
        if len(reads.parts) == 1:
            return self.merged(tables, filters, reads.parts[0], received=received)
        return chain.from_iterable(
            self.merged(tables, filters, read, received=received) for read in reads.parts
        )

    def merged(
        self,
        tables: Sequence[TopicTable],
        filters: Mapping[str, Filter],
        read: Read,
        *,
        received: bool = False,
    ) -> Iterator[StoredRow]:
        """Yield lazily the rows of some tables that pass their filters, merged by time.

        Args:
            filters: Topic → its filter. Rows of other topics all pass.
            received: As in ``read``.
        """
        rows_of = self.keyspace.rows.received if received else self.keyspace.rows.read
        by_topic: dict[str, list[TopicTable]] = {name: [] for name in filters}
        free: list[TopicTable] = []
        for table in tables:
            by_topic.get(table.metadata.topic, free).append(table)
        if not any(by_topic.values()):
            return rows_of(free, read)
        streams = [rows_of(free, read)] if free else []
        for name, topic_tables in by_topic.items():
            if received and any(t.metadata.own_time and not t.named for t in topic_tables):
                # Read by receive times, while the condition is read by key times.
                streams.append(filter(filters[name].test, rows_of(topic_tables, read)))
            elif topic_tables:
                streams.append(filters[name].rows(read))
        return heapq.merge(*streams, key=attrgetter("arrival" if received else "position"))


def nearest_pairs(
    first: Iterator[StoredRow],
    second: Iterator[StoredRow],
    tolerance_ns: int,
    unpaired: bool = False,
) -> Iterator[Pair]:
    """Pair each row of one stream with the nearest row of another; holds two rows of the latter.

    Of two equally near rows the earlier one is taken, of equal times the first.

    Args:
        first, second: Rows in order of time.
        tolerance_ns: Maximum distance of a partner, ns.
        unpaired: Yield rows of the first stream without a partner as (row, None).
    """
    before: StoredRow | None = None
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
            return  # later rows are even further away


def _nearer(t: int, before: StoredRow | None, ahead: StoredRow | None) -> StoredRow | None:
    """Return the row nearer to a time, ns, the earlier of two equally near ones; None = no row."""
    if before is None or ahead is None:
        return before or ahead
    return before if t - before.t <= ahead.t - t else ahead
