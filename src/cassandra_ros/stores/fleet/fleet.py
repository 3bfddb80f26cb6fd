# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Fleet: the topics of several stores, asked as one."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from operator import itemgetter
from typing import Any, Iterable, Iterator, Sequence

from cassandra_ros.arguments import check_limit, check_seconds, check_topics
from cassandra_ros.errors import InvalidKey, InvalidOption, InvalidQuery, MessageNotFound
from cassandra_ros.messages.stamps import Time
from cassandra_ros.query.tree.parse import parse_statement
from cassandra_ros.query.tree.syntax import Select
from cassandra_ros.read import LAST_NS, Named, Read, TimeRange
from cassandra_ros.store.connection.address import ANSWER_SEC, DEFAULT_KEYSPACE
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, FleetList, FleetRows, settled, told
from cassandra_ros.stores.fleet.fleet_info import FleetTopicInfo, describe_topic
from cassandra_ros.stores.fleet.fleet_reads import (
    conditions_of,
    events_of,
    merged_topics,
    rows_of,
    times_of_events,
    topic_names,
    topics_of,
    whose_of,
)
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.stores.fleet.fleet_store import FleetStore, read_places
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic, find_topic, topic_of
from cassandra_ros.topics.catalog import Conditions
from cassandra_ros.topics.event_finder import EventChoice, EventRule
from cassandra_ros.topics.query_result import QueryResult
from cassandra_ros.topics.row_finder import NEAREST, AnyKey, Where, is_ours, range_between
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import Key

_log = logging.getLogger(__name__)
_REQUIRED = object()
"""Default of ``default`` in getData: without a message it raises."""


class Fleet:
    """Several stores, asked as one. Safe to share between threads.

    Messages come in the order of time, each once though several stores have it: a copy keeps its
    time, robot, writer and name. A store that does not answer in time, from the beginning or in the
    middle, is in ``missing`` of the answer, with the reason, and then ``partial`` is true. The next
    question asks it again. A store that lacks the keyspace or the topic is not missing.

    Args:
        stores: Each is HOST[:PORT][/KEYSPACE], or the name of a section of the file. Of messages
            that several stores have, the bytes are read from the first.
        file: File of stores, see doc/fleet.md; None = no file.
        keyspace: Keyspace of stores that name none.
        answer_sec: Maximum time to wait for a connection, and for each answer, s.
        cqlshrc, credentials: Files with the login for stores that name none, as in class Cassandra.
        consistency: Name of a consistency level, as in class Cassandra.

    Attributes:
        stores: The stores, in this order.

    Raises:
        InvalidOption: A store is given twice or is not of this form, or the file is not valid.
    """

    def __init__(
        self,
        stores: Sequence[str],
        *,
        file: str | None = None,
        keyspace: str = DEFAULT_KEYSPACE,
        answer_sec: float = ANSWER_SEC,
        cqlshrc: str | None = None,
        credentials: str | None = None,
        consistency: str = "LOCAL_QUORUM",
    ) -> None:
        limit_sec = check_seconds("answer_sec", answer_sec)
        if not limit_sec:
            raise InvalidOption("answer_sec=0: no store answers at once; give seconds, as 10.0")
        places = read_places(stores, file, keyspace, cqlshrc, credentials)
        self.stores = [FleetStore(place, consistency, limit_sec) for place in places]

    def close(self) -> None:
        """Close the connections. A second call does nothing."""
        for store in self.stores:
            store.close()

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Fleet of {', '.join(store.name for store in self.stores)}>"

    def hurry(self) -> None:
        """End all waits soon, because the program has to end; a signal handler may call it."""
        for store in self.stores:
            store.hurry()

    def topics(self) -> FleetList[str]:
        """Return the names of all topics, sorted.

        A topic that one store has as scan and another as /scan is listed once, as the first store
        spells it.

        Raises:
            StoreUnavailable: No store answers.
        """
        answer = FleetAnswer(self.stores)
        return FleetList(topic_names(answer), answer)

    def info(
        self,
        topics: Iterable[str] | None = None,
        *,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> FleetList[FleetTopicInfo]:
        """Describe what is stored, by topic, type and robot; each message is counted once.

        If several stores have messages of a robot in a topic, the keys of all of them are read,
        except where the first store has all of them by the books of the others.

        Args:
            topics, nodeID, run: As in RosCassandra.info.

        Raises:
            TopicNotFound: No store has one of the topics; the text names all stores.
            StoreUnavailable: No store answers.
        """
        names, answer = check_topics(topics), FleetAnswer(self.stores)

        def describe() -> list[FleetTopicInfo]:
            whose = whose_of(answer, nodeID, run)
            stored_topics = topics_of(answer, names)
            return [
                info for topic in stored_topics for info in describe_topic(answer, topic, whose)
            ]

        return FleetList(settled(answer, describe), answer)

    def rows(
        self,
        topic: str,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        reverse: bool = False,
        where: Where | None = None,
        run: RunName = None,
    ) -> FleetRows[FleetRow]:
        """Read the rows of a topic lazily, in order of time, without making message objects.

        Args:
            topic: Its name, as in RosCassandra.getTopic.
            key, to_key, nodeID, limit, reverse, where, run: As in CassandraTopic.items, also the
                errors.

        Raises:
            TopicNotFound: No store has the topic; the text names all stores.
            SchemaConflict: The stores have different key formats for it.
            StoreUnavailable: No store answers.
        """
        limit, answer = check_limit(limit), FleetAnswer(self.stores)

        def begin() -> Iterator[FleetRow]:
            whose = whose_of(answer, nodeID, run)
            stored_topic = find_topic(answer, topic)
            read = replace(stored_topic.read_of(key, to_key, whose), reverse=reverse, wanted=limit)
            return islice(rows_of(stored_topic, read, where), limit)

        return FleetRows(settled(answer, begin), answer)

    def items(
        self,
        topic: str,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        reverse: bool = False,
        where: Where | None = None,
        run: RunName = None,
    ) -> FleetRows[tuple[Key, Any]]:
        """Read (key, message) pairs of a topic lazily, in order of time.

        Args:
            topic, key, to_key, nodeID, limit, reverse, where, run: As in rows, also the errors.
        """
        rows = self.rows(
            topic,
            key,
            to_key,
            nodeID=nodeID,
            limit=limit,
            reverse=reverse,
            where=where,
            run=run,
        )
        return rows.mapped(_with_messages)

    def getRow(
        self,
        topic: str,
        key: AnyKey,
        *,
        nearest: str | None = None,
        nodeID: str | None = None,
        where: Where | None = None,
        run: RunName = None,
    ) -> FleetRow | None:
        """Return one row, found as in getData; None if there is no such row.

        Args:
            topic, key, nearest, nodeID, where, run: As in getData, also the errors.
        """
        answer = FleetAnswer(self.stores)
        find = partial(find_row, answer, topic, key, nearest, where, nodeID, run)
        return settled(answer, find)

    def getData(
        self,
        topic: str,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        *,
        nearest: str | None = None,
        default: Any = _REQUIRED,
        nodeID: str | None = None,
        limit: int | None = None,
        where: Where | None = None,
        run: RunName = None,
    ) -> Any:
        """Return one message, or a FleetList of those of a time range.

        If a store does not answer, a single message comes with a warning in the log; getRow returns
        its row, which tells which stores are missing.

        Args:
            topic: As in rows.
            key, to_key, nearest, default, nodeID, limit, where, run: As in CassandraTopic.getData,
                also the errors.

        Raises:
            MessageNotFound: There is no message at key; the text names the missing stores.
            TopicNotFound, SchemaConflict, StoreUnavailable: As in rows.
        """
        if to_key is not None:
            options = {"nodeID": nodeID, "limit": limit, "where": where, "run": run}
            pairs = self.items(topic, key, to_key, **options)  # type: ignore[arg-type]
            return pairs.listed(itemgetter(1))
        if key is None:
            raise InvalidKey("getData needs a key (and to_key for a time range); items() reads all")
        answer = FleetAnswer(self.stores)
        find = partial(find_row, answer, topic, key, nearest, where, nodeID, run)
        row = settled(answer, find)
        if row is not None:
            message = row.message()
            if answer.partial:
                _log.warning("these stores do not answer: %s", told(answer.missing))
            return message
        if default is not _REQUIRED:
            return default
        text = f"no store of the fleet has a message of topic {topic} at {key!r:.80}"
        if answer.partial:
            text += f"; these do not answer: {told(answer.missing)}"
        raise MessageNotFound(text)

    def readMessages(
        self,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        received: bool = False,
        where: Conditions = None,
        run: RunName = None,
        event: EventRule = None,
    ) -> FleetRows[FleetRow]:
        """Read the rows of several topics lazily, merged by time.

        A row unpacks like a message of rosbag: ``for topic, msg, t in fleet.readMessages()``.

        Args:
            topics, key, to_key, nodeID, received, where, run, event: As in
                RosCassandra.readMessages, also the errors; the events are those of all stores.

        Raises:
            TopicNotFound: No store has one of the topics; the text names all stores.
            EventNotFound: No store has such an event of that time, robot and run.
        """
        names, answer = check_topics(topics), FleetAnswer(self.stores)

        def begin() -> Iterator[FleetRow]:
            read = Read(range_between(key, to_key), whose_of(answer, nodeID, run))
            stored_topics = topics_of(answer, names)
            conditions = conditions_of(answer, stored_topics, where)
            choice = EventChoice.of(event)
            parts = [read]
            if choice is not None:
                parts = times_of_events(answer, choice, read).reads(read)
            return chain.from_iterable(
                merged_topics(answer, stored_topics, event_read, conditions, received)
                for event_read in parts
            )

        return FleetRows(settled(answer, begin), answer)

    def events(
        self,
        name: str | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        like: str | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> FleetRows[Event]:
        """Read events lazily, in order of their starts, each once.

        If an event has ended in one store and lasts in a copy, it has ended.

        Args:
            name, key, to_key, like, nodeID, run: As in RosCassandra.events, also the errors.
        """
        answer = FleetAnswer(self.stores)

        def begin() -> Iterator[Event]:
            whose = whose_of(answer, nodeID, run)
            return events_of(answer, name, like, range_between(key, to_key), whose)

        return FleetRows(settled(answer, begin), answer)

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        run: RunName = None,
    ) -> FleetList[tuple[Any, ...]]:
        """Run a SELECT statement over all stores; return its rows, a list with ``.columns``.

        Order, LIMIT, groups and aggregates are made of the merged messages, so each counts once.

        Args:
            statement, params, nodeID, limit, run: As in RosCassandra.executeCQL.

        Raises:
            InvalidQuery: The statement is not valid or not a SELECT, no store has its topic, or it
                has NEAR; the text shows the place.
            RunNotFound: No store has the run.
            SchemaConflict, StoreUnavailable: As in rows.
        """
        rows = self.iterCQL(statement, params, nodeID=nodeID, limit=limit, run=run)
        return rows.listed(tuple)

    def iterCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        run: RunName = None,
    ) -> FleetRows[tuple[Any, ...]]:
        """Run a SELECT statement lazily; return an iterator with ``.columns``. See executeCQL."""
        limit = check_limit(limit)
        select = parse_statement(statement, params)
        if not isinstance(select, Select):
            reason = "a fleet is only read: run the statement at the store that it changes"
            text = select.text
            raise InvalidQuery(text, len(text) - len(text.lstrip()), reason)
        answer = FleetAnswer(self.stores)

        def begin() -> QueryResult:
            whose = whose_of(answer, nodeID, run)
            return QueryResult(select, topic_of(answer, select), whose, limit=limit)

        result = settled(answer, begin)
        return FleetRows(iter(result), answer, result.columns)


def find_row(
    answer: FleetAnswer,
    topic: str,
    key: AnyKey,
    nearest: str | None,
    where: Where | None,
    node: str | None,
    run: RunName,
) -> FleetRow | None:
    """Return the row that getData means by a key; None if there is no such row."""
    whose, stored_topic = whose_of(answer, node, run), find_topic(answer, topic)
    if nearest is not None:
        return _nearest(stored_topic, stored_topic.read_of(key, None, whose), nearest, where)
    read = stored_topic.read_of_one(key, whose)
    if is_ours(key) and whose.has(key):
        at = key.t if isinstance(read.only, Named) else key.ns
        rows = rows_of(stored_topic, read, where)
        return next((r for r in rows if (r.t, r.node, r.seq) == (at, key.node, key.seq)), None)
    newest = isinstance(read.only, Named)  # of one name the newest; of equal values the first
    return next(rows_of(stored_topic, replace(read, reverse=newest, wanted=1), where), None)


def _nearest(topic: FleetTopic, read: Read, nearest: str, where: Where | None) -> FleetRow | None:
    """Return the row nearest to the start of a read, on the side that ``nearest`` says.

    Of two that are equally near the earlier one counts.

    Raises:
        InvalidKey: ``nearest`` is unknown, or the keys have no order.
    """
    if nearest not in NEAREST:
        raise InvalidKey(f"nearest={nearest!r} is not one of {', '.join(NEAREST)}")
    if read.only is not None:
        raise InvalidKey(
            f"the keys of topic {topic.name} have no order: none is nearest; leave nearest out"
        )
    t = read.time_range.low
    before = after = None
    if nearest != "before":
        later = replace(read, time_range=TimeRange(t, LAST_NS), wanted=1)
        after = next(rows_of(topic, later, where), None)
    if nearest != "after":
        earlier = replace(read, time_range=TimeRange(0, t), reverse=True, wanted=2)
        for row in rows_of(topic, earlier, where):
            if before is not None and row.t != before.t:
                break
            before = row  # in descending order the last of equal stamps comes first
    if before is None or after is None:
        return before or after
    return before if t - before.t <= after.t - t else after


def _with_messages(rows: Iterable[FleetRow]) -> Iterator[tuple[Key, Any]]:
    """Yield key and message of rows.

    A message that was deleted meanwhile, or is only in stores that do not answer any more, is left
    out.
    """
    for row in rows:
        try:
            message = row.message()
        except MessageNotFound:
            continue
        yield row.key, message
