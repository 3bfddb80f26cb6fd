# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A message that one store of a fleet has, or several, and rows of several stores merged."""

from __future__ import annotations

import heapq
from dataclasses import replace
from functools import partial
from itertools import chain, dropwhile, groupby, repeat
from typing import Any, Callable, Iterator, Mapping, Sequence, Tuple, TypeVar

from cassandra_ros.errors import CassandraRosError, CorruptMessage, MessageNotFound
from cassandra_ros.keys import Position
from cassandra_ros.messages.classes import deserialize
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.read import Read, TimeRange
from cassandra_ros.stores.fleet.fleet_answer import AWAY, FleetAnswer, Missing, told
from cassandra_ros.stores.fleet.fleet_books import Topics
from cassandra_ros.topics.stored_row import Key, MessageIdentity, StoredRow

_T = TypeVar("_T")
StoreRow = Tuple[str, StoredRow]
"""Name of a store, and its row of a message."""
More = Callable[["FleetRow"], Sequence[StoreRow]]
"""Function that returns the copies of a message in stores that were not read for it."""
Order = Tuple[int, str, int]
"""Time, ns, node and seq: the same for the rows of one message in all stores."""


class FleetRow:
    """One message. Unpacks like rosbag's: ``topic, msg, t = row``; t is the key time.

    Bytes that were not read yet come from the first store that answers, in the order of the fleet.

    Args:
        copies: The rows of the message in the stores that gave it, at least one.
        answer: The stores.
        more: Finds the copies in stores that were not read for it; None = no other store has it.

    Attributes:
        t, received, node, seq, name, size: As in StoredRow, the same in all stores.
        columns, conn, table: As in StoredRow, those of the first store.
    """

    __slots__ = (
        *("_answer", "_copies", "_lost", "_more", "columns", "conn", "name", "node", "received"),
        *("seq", "size", "t", "table"),
    )

    def __init__(
        self, copies: Sequence[StoreRow], answer: FleetAnswer, more: More | None = None
    ) -> None:
        row = copies[0][1]
        self._more = more  # None = it was called, or there are no other copies
        # _lost: whether the answer has counted the message as left out.
        self._copies, self._answer, self._lost = copies, answer, False
        self.t, self.node, self.seq, self.name = row.t, row.node, row.seq, row.name
        self.received, self.size, self.conn = row.received, row.size, row.conn
        self.columns, self.table = row.columns, row.table

    def __iter__(self) -> Iterator[Any]:
        t = Stamp.from_ns(self.t, self.node, self.seq, self.table.name)
        return iter((self.topic, self.message(), t))

    def __repr__(self) -> str:
        return f"<FleetRow {self.topic} {iso_time(self.t)}: in {', '.join(self.stores)}>"

    @property
    def stores(self) -> list[str]:
        """Names of the stores that gave the message, in the order of the fleet."""
        return [name for name, _ in self._copies]

    @property
    def missing(self) -> Missing:
        """The stores that did not answer so far → why: those of the whole answer.

        All rows of the answer share this mapping, and it grows while they are read.
        """
        return self._answer.missing

    @property
    def partial(self) -> bool:
        """Whether a store did not answer so far."""
        return self._answer.partial

    def ask(self, work: Callable[[StoredRow], _T]) -> _T:
        """Return the result of a function of a row: of the first store that answers, and is sound.

        If no store that has the message answers any more, it is counted as left out.

        Raises:
            CorruptMessage, MessageNotFound: No store gives a result: the first error of those that
                answer.
            MessageNotFound: No store that has the message answers any more.
        """
        missing = self._answer.missing
        problem: CassandraRosError | None = None
        away = ""
        # What was read of a store that is away now can still be used: last.
        copies = sorted(self._copies, key=lambda copy: copy[0] in missing)
        for name, row in chain(copies, self._further_copies()):
            try:
                return work(row)
            except AWAY as exc:
                self._answer.lose(name, exc)
                away = away or name
            except (MessageNotFound, CorruptMessage) as exc:
                problem = problem or exc
        if away and not self._lost and not isinstance(problem, CorruptMessage):
            self._lost = True  # counted once, though it may be asked again
            self._answer.leave_out(away)
        raise problem or MessageNotFound(
            f"the message of topic {self.topic} at {self.t} is only in stores that do not answer "
            f"any more: {told(missing)}"
        )

    def _further_copies(self) -> Iterator[StoreRow]:
        """Yield the copies in stores that were not read, because another store has the message.

        They are looked for once, and kept.
        """
        if self._more is not None:
            more, self._more = self._more(self), None
            self._copies = [*self._copies, *more]
            yield from more

    @property
    def topic(self) -> str:
        """Name of the topic in which the message is stored."""
        return self._copies[0][1].topic

    @property
    def run(self) -> str:
        """Name of the run that stored the message, or its writer id if the run has no name."""
        return self.ask(lambda row: row.run)

    @property
    def position(self) -> Position:
        """Position of the row in all stores, whose tables have other names: without a table."""
        return self._copies[0][1].position._replace(table="")

    @property
    def identity(self) -> MessageIdentity:
        """Identity of the message in all stores."""
        return (self.t, self.node, self.seq, self.name)

    @property
    def arrival(self) -> tuple[int, str, int, str]:
        """Position of the row in the order of reads by receive time; the table is the first one."""
        return (self.received, self.node, self.seq, self.table.name)

    @property
    def key(self) -> Key:
        """Row key: exact time or name, with the place of the row in the first store."""
        return self._copies[0][1].key

    @property
    def wire(self) -> bytes:
        """The serialised message, byte for byte as it was sent.

        Raises:
            MessageNotFound: It was deleted meanwhile, or no store that has it answers any more.
            CorruptMessage: It is damaged in each store.
        """
        return self.ask(lambda row: row.wire)

    def keep_wire(self) -> bytes:
        """Return the serialised message, and release the columns from which it was made."""
        wire = self.ask(lambda row: row.keep_wire())
        self.columns = ()
        return wire

    @property
    def connection(self) -> Connection:
        """The connection over which the message came."""
        return self.ask(lambda row: row.connection)

    @property
    def type(self) -> str:
        """Message type as its connection names it, 'pkg/Name'."""
        return self.connection.type

    @property
    def md5sum(self) -> str:
        """md5 of the message definition."""
        return self.table.metadata.md5sum

    def message_class(self) -> Any:
        """Return the class of the message: installed, generated, or RawMessage. Errors as wire."""
        return self.ask(lambda row: row.message_class())

    def message(self) -> Any:
        """Deserialise the message.

        Raises:
            CorruptMessage: The bytes are not a message of the type.
            MessageNotFound: No store that has it answers any more.
        """
        wire = self.wire
        return deserialize(self.message_class(), wire)


def key_order(row: StoredRow | FleetRow) -> Order:
    """Return the place of a message in the order of key times."""
    return row.t, row.node, row.seq


def arrival_order(row: StoredRow | FleetRow) -> Order:
    """Return the place of a message in the order of receive times."""
    return row.received, row.node, row.seq


def resumed(read: Read, begin: Callable[[Read], Iterator[FleetRow]]) -> Iterator[FleetRow]:
    """Yield the rows of a read after the position that it names, if it names one.

    The rows must come in ascending order of keys. A position has the table of one store; time, node
    and seq are the same in all stores.

    Args:
        begin: Begins to read; the read that it gets names no position.
    """
    after = read.after
    if after is None:
        return begin(read)
    time_range = TimeRange(max(read.time_range.low, after.t), read.time_range.high)
    rows = begin(replace(read, after=None, time_range=time_range))
    return dropwhile(lambda row: key_order(row) <= after[:3], rows)


def merged_rows(
    answer: FleetAnswer,
    streams: Mapping[str, Callable[[], Iterator[StoredRow]]],
    order: Callable[[StoredRow], Order] = key_order,
    *,
    reverse: bool = False,
    more: More | None = None,
) -> Iterator[FleetRow]:
    """Yield the messages of several stores in one order, each once.

    Copies keep time, node and seq, so the rows of one message follow one another. Rows of different
    tables of a store do so, too, if it has one message in two formats.

    Args:
        streams: Name of a store → function that begins to read its rows, in this order. The stores
            stand in the order of the fleet.
        order: Returns the place of a row.
        reverse: Whether they come from the last to the first.
        more: Finds copies in stores that were not read for a message.
    """

    def place(pair: StoreRow) -> Order:
        return order(pair[1])

    # With equal places the first store of the fleet comes first.
    pairs = [zip(repeat(name), rows) for name, rows in answer.rows(streams).items()]
    for _, group in groupby(heapq.merge(*pairs, key=place, reverse=reverse), key=place):
        copies: dict[tuple[str, str], list[StoreRow]] = {}
        for name, row in group:
            copies.setdefault((row.topic, row.name), []).append((name, row))
        for rows in copies.values():
            yield FleetRow(rows, answer, more)


def read_once(
    answer: FleetAnswer,
    streams: Mapping[str, Callable[[Read], Iterator[StoredRow]]],
    topics: Topics,
    read: Read,
    order: Callable[[StoredRow | FleetRow], Order] = key_order,
) -> Iterator[FleetRow]:
    """Yield the messages of a read in one order, each once.

    A store is not read for what, by its books, a store before it has. If that one goes away, the
    read goes on in the others, from the last message on.

    Args:
        streams: Name of a store → function that begins to read its rows.
        topics: Name of a store → names of the topics that are read there.
        order: Returns the place of a row; its first value is in the time range of the read.
    """
    # The place of the last message that was yielded, and topic and name of those at this place. By
    # them no message comes twice after the read has begun again.
    last: Order | None = None
    given: set[tuple[str, str]] = set()
    while True:
        # Few rows are read sooner than the books.
        many = read.only is None and read.wanted is None and len(streams) > 1
        spared = answer.books.spared(topics, read) if many else None
        targets: set[str] = spared.targets if spared else set()
        begins = {
            name: partial(begin, replace(read, skip=spared.skip(name) if spared else None))
            for name, begin in streams.items()
        }
        more = spared.copies if spared else None
        rows = merged_rows(answer, begins, order, reverse=read.reverse, more=more)
        if not spared and last is None:
            yield from rows
            return
        for row in rows:
            if not targets.isdisjoint(answer.missing):
                break  # this row, too, may come after one that only the lost store was read for
            place, identity = order(row), (row.topic, row.name)
            if place != last:
                if last is not None and (place < last) != read.reverse:
                    continue  # it was given before a store went away
                given.clear()
            elif identity in given:
                continue
            last = place
            given.add(identity)
            yield row
        if targets.isdisjoint(answer.missing):
            return
        if last is not None:
            low, high = read.time_range
            rest = TimeRange(low, last[0]) if read.reverse else TimeRange(last[0], high)
            read = replace(read, time_range=rest)
