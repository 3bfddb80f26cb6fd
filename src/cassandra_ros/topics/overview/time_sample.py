# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of a topic that are evenly spaced in time, without reading those between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Iterable, Iterator, Sequence

from cassandra_ros.errors import MessageNotFound
from cassandra_ros.keys import RowName
from cassandra_ros.messages.stamps import Stamp, Time
from cassandra_ros.read import Writers
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.topics.stored_row import StoredRow


@dataclass(frozen=True)
class MessageChoice:
    """The messages of a topic from which a sample is taken."""

    start: Time | None = None
    end: Time | None = None
    """Key times of the first and the last message, both included; None = open."""
    node: str | None = None
    """nodeID; None = all."""
    writers: Writers = None
    """Writer ids; None = all."""
    where: Where | None = None
    """Condition that the messages satisfy; None = all messages."""
    event: EventRule = None
    """Events during which the messages were received, as in readMessages; None = at any time."""

    def rows(self, catalog: Catalog, topic: CassandraTopic) -> Iterator[StoredRow]:
        """Yield the rows in order of time; their messages are read when they are accessed."""
        if self.where is None and self.event is None:
            return topic.rows(
                self.start, self.end, nodeID=self.node, run=self.writers, columns=lambda table: ()
            )
        names, whose = [topic.name], catalog.whose(self.node, self.writers)
        reads = catalog.reads_of(names, self.start, self.end, whose, self.event)
        if self.where is not None:
            return catalog.read_parts(names, reads, {topic.name: self.where})
        keys = (topic.read(replace(read, columns=lambda table: ())) for read in reads.parts)
        return chain.from_iterable(keys)

    def last(self, topic: CassandraTopic) -> int:
        """Return the key time of the last message, ns; there must be one."""
        newest = topic.items(
            self.start,
            self.end,
            nodeID=self.node,
            limit=1,
            reverse=True,
            where=self.where,
            run=self.writers,
        )
        keys = (key for key, _ in newest)
        return next((key.t if isinstance(key, RowName) else key.ns for key in keys), 0)


def spaced_rows(
    catalog: Catalog, name: str, choice: MessageChoice, count: int, every_ns: int = 0
) -> Iterator[StoredRow]:
    """Choose messages of a topic that are evenly spaced between its first and last message.

    If there are at most ``count`` messages, all are chosen. Otherwise each is the nearest to one of
    the times and is found by this time. With an event the messages are evenly spaced by their
    numbers, so that none of the time between events counts. With a condition all messages that
    satisfy it are read once, and in topics with names the keys of all messages.

    Args:
        name: Name of the topic.
        choice: Messages to choose from.
        count: Maximum number of messages, at least 1.
        every_ns: Distance between two times, from the first message on, ns; 0 = such that ``count``
            times reach to the last message.

    Yields:
        Rows in order of time, each once.

    Raises:
        MessageNotFound: There is no such message.
        TopicNotFound, InvalidQuery: As readMessages.
    """
    topic = catalog.get(name)
    few = [(row.t, row.key) for row in islice(choice.rows(catalog, topic), count + 1)]
    if not few:
        raise MessageNotFound(
            f"topic {topic.name} has no such message: none of that time, event, robot, run or "
            "condition"
        )
    if len(few) <= count and not every_ns:
        rows = (topic.getRow(key) for _, key in few)
        yield from (row for row in rows if row is not None)  # None if it was deleted meanwhile
        return
    if choice.event is not None:
        during = choice.rows(catalog, topic)
        if every_ns:
            yield from islice(_apart(during, every_ns), count)
        else:
            total = sum(1 for _ in choice.rows(catalog, topic))
            yield from _share(during, total, count)
        return
    times = _times(few[0][0], choice.last(topic), count, every_ns)
    if choice.where is None and not isinstance(few[0][1], RowName):
        yield from _once(_look_up(topic, choice, times))
    else:
        yield from _once(nearest_rows(choice.rows(catalog, topic), times))


def _apart(rows: Iterable[StoredRow], every_ns: int) -> Iterator[StoredRow]:
    """Yield the rows that are at least some ns after the one before."""
    due = 0
    for row in rows:
        if row.t >= due:
            yield row
            due = row.t + every_ns


def _share(rows: Iterable[StoredRow], total: int, count: int) -> Iterator[StoredRow]:
    """Yield ``count`` of ``total`` rows, evenly spaced by their numbers; all if there are fewer."""
    last = -1
    for number, row in enumerate(rows):
        if number * count // total != last:
            last = number * count // total
            yield row


def _times(first: int, last: int, count: int, every_ns: int) -> Sequence[int]:
    """Return the times for which messages are looked for, both ends included, ns."""
    if every_ns:
        return range(first, last + 1, every_ns)[:count]
    gaps = max(1, count - 1)
    return [first + (last - first) * n // gaps for n in range(count)]


def _look_up(
    topic: CassandraTopic, choice: MessageChoice, times: Sequence[int]
) -> Iterator[StoredRow]:
    """Yield the nearest row for each of some times, ns, by a look-up for each."""
    for t in times:
        row = topic.getRow(
            Stamp.from_ns(t), nearest="either", nodeID=choice.node, run=choice.writers
        )
        if row is not None:
            yield row


def nearest_rows(rows: Iterable[StoredRow], times: Sequence[int]) -> Iterator[StoredRow]:
    """Yield the nearest row for each of some times, in their order; of two the earlier one.

    Args:
        rows: Rows in order of time; all are read.
        times: Ascending times, ns.
    """
    before: StoredRow | None = None
    times_left = iter(times)
    t = next(times_left, None)
    for row in rows:
        while t is not None and t <= row.t:
            yield row if before is None or row.t - t < t - before.t else before
            t = next(times_left, None)
        if t is None:
            return
        before = row
    while before is not None and t is not None:
        yield before
        t = next(times_left, None)


def _once(rows: Iterable[StoredRow]) -> Iterator[StoredRow]:
    """Yield rows without those that are the same message as the one before."""
    before = None
    for row in rows:
        if row.identity != before:
            yield row
        before = row.identity
