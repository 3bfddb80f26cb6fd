# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of a topic by its keys and conditions: found, read, counted, deleted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, Callable, Iterator, Sequence, Tuple, Union

from cassandra_ros.arguments import check_limit, check_message_name
from cassandra_ros.errors import InvalidKey, InvalidQuery, MessageNotFound
from cassandra_ros.keys import NAMED_FORMATS, SECOND_NS, RowName
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.messages.stamps import (
    SECONDS_BELOW,
    Stamp,
    Time,
    is_iso_text,
    is_time,
    iso_time,
    other_unit,
    to_ns,
)
from cassandra_ros.query.arrays.batch import (
    Batch,
    CheckOf,
    PartsOf,
    ReadBatches,
    only_keys,
    row_batches,
)
from cassandra_ros.query.protocols import Source
from cassandra_ros.read import EVERYBODY, LAST_NS, Named, Read, TimeRange, Valued, Whose
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.query_result import BatchReader, Condition
from cassandra_ros.topics.removal import delete_rows, delete_time_range
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import count_rows
from cassandra_ros.topics.topic_table import TopicTable

Clock = Callable[[], Time]
"""Returns the time of a message that is added without a key."""
AnyKey = Any
"""A Time, or another key of a topic: a name, or the value of a field."""


def range_between(key: Time | None, to_key: Time | None) -> TimeRange:
    """Return the time range between two times; None = open."""
    low = 0 if key is None else to_ns(key)
    return TimeRange(low, LAST_NS if to_key is None else to_ns(to_key))


NEAREST = ("before", "after", "either")
_NEAR_NS = 256
"""Maximum error of a present time after its conversion to a float, ns."""


def is_ours(key: AnyKey) -> bool:
    """Return whether a key was given by the store and so belongs to one message."""
    return isinstance(key, (RowName, Stamp)) and bool(key.table)


@dataclass(frozen=True)
class Finder:
    """Finds the rows of one topic by keys."""

    keyspace: Keyspace
    topic: str
    """Name of the topic."""
    key_format: str
    tables: Sequence[TopicTable]
    whose: Whose = EVERYBODY
    where: Filter | None = None
    """Condition that the messages must pass; None = no condition."""

    def many(
        self, key: AnyKey, to_key: AnyKey, *, limit: int | None = None, reverse: bool = False
    ) -> Iterator[StoredRow]:
        """Yield the rows in the time range from key to to_key, or those with one key.

        A time alone begins a time range that is open at its end; a name or value is one key.
        """
        limit = check_limit(limit)
        read = replace(self.read_of(key, to_key), reverse=reverse, wanted=limit)
        return islice(self._rows(read), limit)

    def _rows(self, read: Read, *, bare: bool = False) -> Iterator[StoredRow]:
        """Yield the rows of a read that satisfy the condition."""
        if self.where is not None and read.only is None:
            return self.where.rows(read, bare=bare)
        rows = self.keyspace.rows.read(self.tables, read)
        return rows if self.where is None else filter(self.where.test, rows)

    def batches(self, key: AnyKey, to_key: AnyKey) -> ReadBatches:
        """Return how to read the messages of ``many`` as batches, in any order."""
        return partial(self._batches, self.read_of(key, to_key))

    def _batches(self, read: Read, parts: PartsOf) -> Iterator[Batch]:
        """Yield the messages of a read that satisfy the condition, as batches."""
        if read.only is not None:
            return row_batches(self._rows(read), parts)

        def read_batches(read: Read, check: CheckOf | None = None) -> Iterator[Batch]:
            if isinstance(read.only, Named):  # a condition on KEY names the messages
                try:
                    check_message_name(self.topic, read.only.name)
                except InvalidKey:
                    return iter(())  # no message has an invalid name
            return self.keyspace.rows.batches(self.tables, read, parts, check)

        return read_batches(read) if self.where is None else self.where.batches(read, read_batches)

    def count(self, key: AnyKey, to_key: AnyKey) -> int:
        """Return the number of rows of ``many``.

        Those of a time range without a condition are counted by the directory where possible.
        """
        read = self.read_of(key, to_key)
        if read.only is None and self.where is None:
            return count_rows(self.keyspace.directory, self.tables, read)
        # Without fields in the condition no message is needed, only its key.
        if self.where is not None and self.where.names_fields:
            return sum(map(len, self._batches(read, only_keys)))
        return sum(1 for _ in self._rows(read, bare=True))

    def remove(self, key: AnyKey, to_key: AnyKey) -> int:
        """Delete the rows at key, or those of ``many``; see CassandraTopic.removeData."""
        if key is None and to_key is None and self.where is None and self.whose.writers is None:
            raise InvalidKey(
                "removeData needs a key (and to_key for a time range), where= or run=; "
                f"truncateTopic removes all messages of topic {self.topic}"
            )
        if key is None or to_key is not None:
            return self._remove(self.read_of(key, to_key))
        if is_ours(key):
            # Only this message, not others of the same time.
            row = self._exact(key, self._table_of(key)) if self.whose.has(key) else None
            count = 0 if row is None else delete_rows(self.keyspace, [row])
        else:
            count = self._remove(self.one(key))
        if not count:
            raise MessageNotFound(self.absent(key, None))
        return count

    def _remove(self, read: Read) -> int:
        """Delete the rows of a read that satisfy the condition; return their number."""
        if read.only is None and self.where is None and not self._is_named:
            return delete_time_range(self.keyspace, self.tables, read)
        return delete_rows(self.keyspace, self._rows(read, bare=True))

    def find(self, key: AnyKey, nearest: str | None) -> StoredRow | None:
        """Return the row that getData means by a key; None if there is no such row."""
        if nearest is not None:
            return self._near(key, nearest)
        table = self._table_of(key) if is_ours(key) and self.whose.has(key) else None
        if table is not None:
            return self._exact(key, table)
        read = self.one(key)
        if read.only is None:
            return self._at(read)
        newest = isinstance(read.only, Named)  # of one name the newest; of equal values the first
        return next(self._rows(replace(read, reverse=newest)), None)

    def _at(self, read: Read) -> StoredRow | None:
        """Return the row at a time: of several the first in the order of all reads."""
        if self.where is None:
            return self.keyspace.rows.at(self.tables, read)
        return next(self._rows(replace(read, wanted=1)), None)

    def _table_of(self, key: AnyKey) -> TopicTable | None:
        """Return the table of a key that the store gave; None if it was dropped."""
        table = self.keyspace.tables.holding(key.table)
        return table if table is not None and table.metadata.topic == self.topic else None

    def _exact(self, key: AnyKey, table: TopicTable | None) -> StoredRow | None:
        """Return the row of a key that the store gave, if it satisfies the condition."""
        row = None if table is None else self.keyspace.rows.exact(table, key)
        passes = row is None or self.where is None or self.where.test(row)
        return row if passes else None

    def _near(self, key: AnyKey, nearest: str) -> StoredRow | None:
        """Return the row nearest to a time, one of NEAREST; None if no row is on that side."""
        if nearest not in NEAREST:
            raise InvalidKey(f"nearest={nearest!r} is not one of {', '.join(NEAREST)}")
        read = self.one(key)
        if read.only is not None:
            kind = "names" if isinstance(read.only, Named) else "values of a field"
            raise InvalidKey(
                f"the keys of topic {self.topic} are {kind}, which have no order: none is "
                "nearest; leave nearest out"
            )
        refuse_units(self.keyspace, self.tables, key)
        return self._nearest(read.time_range.low, nearest)

    def _nearest(self, t: int, nearest: str) -> StoredRow | None:
        """Return the row nearest to a time, ns; of two equally near ones the earlier one."""
        ways = {"before": [True], "after": [False], "either": [True, False]}[nearest]
        if self.where is None:
            near = self.keyspace.rows.beside(self.tables, t, self.whose, ways)
            if near is not None:
                return min(near, key=lambda row: abs(row.t - t))
        before = after = None
        low = 0
        if nearest != "before":
            after = next(self._rows(Read(TimeRange(t, LAST_NS), self.whose, wanted=1)), None)
            if after is not None and nearest == "either":
                low = max(0, t - (after.t - t))  # earlier rows are further away
        if nearest != "after":
            back = Read(TimeRange(low, t), self.whose, reverse=True, wanted=2)
            for row in self._rows(back):
                if before is not None and row.t != before.t:
                    break
                before = row  # in descending order the last of equal stamps comes first
        return before or after

    def absent(self, key: AnyKey, nearest: str | None) -> str:
        """Return an error text for a key without a message, with the nearest one and a hint."""
        read = self.one(key)
        text = f"topic {self.topic} has no message"
        if self.whose.nodes is not None:
            text += f" of node {self.whose.nodes[0]}"
        if self.whose.writers is not None:
            text += " of this run"
        if self.where is not None:
            text += f" that satisfies {self.where.text!r:.200}"
        if isinstance(read.only, Named):
            name = str(key)[:80]
            return f"{text} under the name {name!r}; items() lists the names that there are"
        if read.only is not None:
            return f"{text} whose key field is {key!r:.80}"
        t = read.time_range.low
        text += f" {nearest or 'at'} {iso_time(t)} ({t} ns)"
        if isinstance(key, int) and 0 < t < SECONDS_BELOW:
            return text + "; integers are nanoseconds; did you mean seconds (a float)?"
        near = None
        # With a condition the nearest message may be far away and take long to find.
        if nearest is None and self.where is None:
            near = self._nearest(t, "either")
        if near is None:
            return text
        if abs(near.t - t) > _NEAR_NS:
            return text + f"; the nearest lies at {iso_time(near.t)} ({near.t} ns)"
        secs, nsecs = divmod(near.t, SECOND_NS)
        return text + (
            f"; one lies {abs(near.t - t)} ns away: write the time as "
            f"{{secs: {secs}, nsecs: {nsecs}}}: a number goes through a float"
        )

    @property
    def _is_named(self) -> bool:
        return self.key_format in NAMED_FORMATS

    @cached_property
    def _key_parts(self) -> list[KeyPart]:
        """Key fields of the tables whose messages are found by a value."""
        return [t.value_part for t in self.tables if t.value_part is not None]

    def read_of(self, key: AnyKey, to_key: AnyKey) -> Read:
        """Return the read of the time range from key to to_key, or of the messages with one key."""
        if key is None and to_key is None:
            return Read(whose=self.whose)
        if self._is_named and to_key is not None:
            raise InvalidKey(
                f"messages of topic {self.topic} are kept under names (key_format "
                f"{self.key_format}), and names have no order: there is no range between two of "
                "them; give one key, or none for all"
            )
        if to_key is None and (self._is_named or self._is_value(key)):
            return self.one(key)
        if self._is_value(key) or self._is_value(to_key):
            raise InvalidKey(
                f"the key of topic {self.topic} is its field {self._key_parts[0].field}, and its "
                "messages are in the order of time: a range goes from one genpy.Time to "
                "another; ask for a range of values with executeCQL"
            )
        return Read(time_range_between(self.keyspace, self.tables, key, to_key), self.whose)

    def one(self, key: AnyKey) -> Read:
        """Return the read of the messages with a single key: a time, a name, or a value."""
        if self._is_named:
            return Read(whose=self.whose, only=Named(check_message_name(self.topic, key)))
        if self._is_value(key):
            return Read(whose=self.whose, only=Valued(key))
        t = to_ns(key)
        return Read(TimeRange(t, t), self.whose)

    def _is_value(self, key: AnyKey) -> bool:
        """Return whether a key is the value of a field; a genpy.Time is always a time."""
        return bool(self._key_parts) and key is not None and not is_time(key)

    def of_text(self, text: str) -> AnyKey:
        """Return the key in a text that a user typed; see CassandraTopic.keyOfText."""
        if self._is_named or any(table.named for table in self.tables):
            return text
        if self._key_parts:
            return Stamp.from_ns(to_ns(text)) if is_iso_text(text) else self._value(text)
        text = text.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 40 else text

    def _value(self, text: str) -> AnyKey:
        """Return a value of the first table that accepts the text.

        Text fields last: they accept all.
        """
        problem: InvalidKey | None = None
        for key_part in sorted(self._key_parts, key=lambda key_part: key_part.is_text):
            try:
                return key_part.from_text(text)
            except InvalidKey as exc:
                problem = problem or exc
        raise problem or InvalidKey(f"{text!r:.80} is not a key")


def unit_meant(keyspace: Keyspace, tables: Sequence[TopicTable], key: object) -> str:
    """Return why an integer of ns was meant in another unit; '' = it was not.

    It was if it lies long before the first message of the tables. Without a message it is not known
    to be, and the result is '' too.
    """
    if not other_unit(key, LAST_NS):  # nothing has to be read
        return ""
    timed = [table for table in tables if not table.named]
    first = next(keyspace.rows.read(timed, Read(wanted=1)), None)
    unit_text = "" if first is None else other_unit(key, first.t)
    if first is None or not unit_text:
        return ""
    return (
        f"{key} means nanoseconds since 1970, long before the first message of topic "
        f"{first.topic}; {unit_text}"
    )


def refuse_units(keyspace: Keyspace, tables: Sequence[TopicTable], *keys: object) -> None:
    """Raise InvalidKey for integers meant in another unit: they match all messages, or none."""
    for key in keys:
        reason = unit_meant(keyspace, tables, key)
        if reason:
            raise InvalidKey(reason)


def time_range_between(
    keyspace: Keyspace, tables: Sequence[TopicTable], key: Time | None, to_key: Time | None
) -> TimeRange:
    """Return the time range between two times, None = open; refuses keys in another unit."""
    time_range = range_between(key, to_key)
    refuse_units(keyspace, tables, key, to_key)
    return time_range


Where = Union[str, Tuple[str, Sequence[Any]]]
"""A condition: the text after WHERE in CQL, or the text and the values of its ``?``."""


def checked_where(where: Where) -> tuple[str, Sequence[Any]]:
    """Return the text and the parameters of a condition. Raises InvalidQuery."""
    pair = (where, ()) if isinstance(where, str) else where
    is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
    if not (is_pair and isinstance(pair[0], str)):
        hint = "where= takes a condition as text, or a pair (text, parameters)"
        raise InvalidQuery(repr(where)[:200], 0, hint)
    return pair


class Filter:
    """The rows of one topic that satisfy a condition.

    Attributes:
        text: The condition as given.
        test: Returns whether a row of the topic satisfies it, whatever its node.

    Raises:
        InvalidQuery: The condition does not fit the tables that the topic has now.
    """

    def __init__(
        self,
        topic: Source[StoredRow],
        where: Where,
        whose: Whose = EVERYBODY,
    ) -> None:
        self.text, params = checked_where(where)
        self._topic = topic
        self._condition = Condition(self.text, params)
        self.test = self._condition.test(topic.tables, whose)

    @property
    def names_fields(self) -> bool:
        """Whether the condition names fields of the messages, not only KEY, NODE, RUN and times."""
        return self._condition.names_fields(self._topic.tables)

    def rows(self, read: Read, *, bare: bool = False) -> Iterator[StoredRow]:
        """Yield the rows of a read that satisfy the condition; see Condition.rows."""
        return self._condition.rows(self._topic, read, bare=bare)

    def batches(self, read: Read, read_batches: BatchReader) -> Iterator[Batch]:
        """Yield the messages of a read that satisfy the condition; see Condition.batches."""
        return self._condition.batches(self._topic.tables, read, read_batches)
