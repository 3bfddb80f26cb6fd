# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows of any topics, by time, name or value, without message objects.

``RowReader`` reads the rows of given tables. A read goes on while a table is replaced by another
one, because its topic is converted (``FollowingReader``, ``followed``). The old table is dropped
some seconds after the new one became visible. A reader of the old table then gets an error, and
goes on in the new table after the last row that it yielded: rows have the same positions there,
except those that were given another robot (``setRuns`` says what a read sees then).
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import repeat
from typing import Callable, Iterable, Iterator, Mapping, Sequence, TypeVar, Union

from cassandra_ros.errors import InvalidKey, TopicNotFound
from cassandra_ros.keys import Position, RowName, is_after
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.messages.wire.message_stacks import planes_of
from cassandra_ros.query.arrays.batch import (
    Batch,
    CheckOf,
    LeastOf,
    PartsOf,
    StackedBatch,
    Window,
    row_batches,
)
from cassandra_ros.query.protocols import Table
from cassandra_ros.read import Named, Read, Valued, Whose
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.rows.fetch import (
    RowKey,
    beside,
    fetch_row,
    fetch_rows,
    first_at,
    keys_by_shadow,
    list_names,
    versions,
)
from cassandra_ros.store.rows.reader import read_portions, read_rows
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.held_portions import rows_of
from cassandra_ros.store.tables.row_table import TableRow
from cassandra_ros.store.tables.table_layout import Portion, StackedMessages
from cassandra_ros.topics.stored_row import StoredRow, chunks_ahead
from cassandra_ros.topics.topic_table import TableSet, TopicTable


class RowReader:
    """Reads the rows of one keyspace."""

    def __init__(self, cassandra: Cassandra, directory: Directory) -> None:
        self._cassandra = cassandra
        self._directory = directory

    def read(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Yield rows in the order (t, node, seq, table), or its reverse, lazily.

        For topics with names all keys are listed first, and all rows are read. The server may leave
        out fewer rows than the chooser asks.
        """
        if isinstance(read.only, Named):
            rows: Iterable[TableRow] = self._versions(tables, read.only, read)
        elif read.only is not None:
            rows = self._by_value(tables, read.only, read)
        else:
            rows = self._by_time(tables, read)
        yield from self._stored_rows(rows, tables)

    def _by_time(self, tables: Sequence[TopicTable], read: Read) -> Iterable[TableRow]:
        """Yield the rows of a time range, those with names too, in the order of a read."""
        timed = [table for table in tables if not table.named]
        rows: Iterable[TableRow] = read_rows(self._directory, timed, read)
        if len(timed) == len(tables):
            return rows
        named = self._by_name([t for t in tables if t.named], read)
        return heapq.merge(rows, named, key=lambda row: row.position, reverse=read.reverse)

    def in_order(
        self, tables: Sequence[TopicTable], read: Read, least: LeastOf
    ) -> Iterator[StoredRow | Window]:
        """Yield the messages of a time range like ``read``; many of them come together.

        Args:
            tables: Tables whose keys are times.
            read: What is read.
            least: Minimum number of messages of a table that come together; see LeastOf.
        """
        messages = _rows_and_windows(read_portions(self._directory, tables, read), tables, least)
        for message in chunks_ahead(messages):
            self._cassandra.require_open()  # so that an iterator ends when the connection is closed
            yield message

    def _stored_rows(
        self, rows: Iterable[TableRow], tables: Sequence[TopicTable]
    ) -> Iterator[StoredRow]:
        """Yield rows of these tables as StoredRow, large messages requested ahead."""
        if len(tables) == 1:
            stored_rows: Iterable[StoredRow] = map(StoredRow, rows, repeat(tables[0]))
        else:
            by_name = {table.name: table for table in tables}
            stored_rows = (StoredRow(row, by_name[row.table]) for row in rows)
        for row in chunks_ahead(stored_rows):
            self._cassandra.require_open()  # so that an iterator ends when the connection is closed
            yield row

    def _by_name(self, tables: Sequence[TopicTable], read: Read) -> Iterator[TableRow]:
        """Yield the rows of tables with names in the order of a read, after listing all keys."""
        low, high = read.time_range
        keys = [
            RowKey(table, key.position)
            for table in tables
            for key in list_names(table, read.whose.nodes)
            if low <= key.position.t <= high
            and read.whose.wrote(key.position.seq)
            and is_after(key.position, read.after, read.reverse)
        ]
        keys.sort(key=lambda key: key.position, reverse=read.reverse)
        return fetch_rows(keys)

    def _versions(
        self, tables: Sequence[TopicTable], only: Named, read: Read
    ) -> Iterator[TableRow]:
        """Yield the rows of a read with one name; tables with a time key have none."""
        nodes = read.whose.nodes
        streams = []
        for table in tables:
            if table.named:
                # A table with names lists its nodes in slot 0.
                listed = {node for _, node in self._directory.nodes(table.name, 0, 0)}
                node_ids = sorted(listed if nodes is None else listed.intersection(nodes))
                streams.append(versions(table, only.name, node_ids, reverse=read.reverse))
        rows = heapq.merge(*streams, key=lambda row: row.position, reverse=read.reverse)
        return (row for row in rows if read.whose.has(row) and _inside(row.position, read))

    def _by_value(
        self, tables: Sequence[TopicTable], only: Valued, read: Read
    ) -> Iterator[TableRow]:
        """Yield the rows of a read whose key field has one value.

        Raises:
            InvalidKey: The field has another type in each table.
        """
        keys: list[Iterator[RowKey]] = []
        problems: list[InvalidKey] = []
        key_parts = [(table, table.value_part) for table in tables if table.value_part is not None]
        for table, key_part in key_parts:
            try:
                value = key_part.encode(only.value)
            except InvalidKey as exc:
                problems.append(exc)
                continue
            if value is not None:
                keys.append(self._keys_of(table, key_part, value, read.whose))
        if problems and len(problems) == len(key_parts):
            raise problems[0]
        row_keys: Iterable[RowKey] = heapq.merge(*keys, key=lambda key: key.position)
        row_keys = (key for key in row_keys if _inside(key.position, read))
        yield from fetch_rows(reversed(list(row_keys)) if read.reverse else row_keys)

    def _keys_of(
        self, table: TopicTable, key_part: KeyPart, value: bytes, whose: Whose
    ) -> Iterator[RowKey]:
        """Yield the keys of a table's rows with an encoded value, in the order of all reads."""
        index = key_part.index(value)
        if index is not None:
            shadow = table.metadata.indexes[key_part.field]
            keys = keys_by_shadow(self._directory, table, shadow, index, whose.nodes)
            yield from (key for key in keys if whose.wrote(key.position.seq))
            return
        # The text is too long for the index: its rows are marked as odd.
        for row in self.read([table], Read(whose=whose)):
            if row.odd and key_part.value(row.wire) == value:
                yield RowKey(table, row.position)

    def received(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Yield the rows received in the time range of a read, in order of their receive times.

        For topics whose key is a time in the message all keys are listed first. Of the read only
        time range, robots and writers count for these.
        """
        foreign = {t.name: t for t in tables if t.metadata.own_time and not t.named}
        rows = self.read([t for t in tables if t.name not in foreign], read)
        low, high = read.time_range
        listing = Read(whose=read.whose, columns=lambda table: ())
        keys = sorted(
            (r.received, r.node, r.seq, r.table, r.position)
            for r in read_rows(self._directory, list(foreign.values()), listing)
            if low <= r.received <= high
        )
        row_keys = (RowKey(foreign[position.table], position) for *_, position in keys)
        late = self._stored_rows(fetch_rows(row_keys), tables)
        return heapq.merge(rows, late, key=lambda row: row.arrival)

    def exact(self, table: TopicTable, key: Stamp | RowName) -> StoredRow | None:
        """Return one row by a key that the store gave, with one SELECT; None if it was deleted."""
        t, name = (key.t, str(key)) if isinstance(key, RowName) else (key.ns, "")
        position = Position(t, key.node or "", key.seq or 0, table.name, name)
        row = fetch_row(table, position)
        return None if row is None else StoredRow(row, table)

    def at(self, tables: Sequence[TopicTable], read: Read) -> StoredRow | None:
        """Return the first row of a read whose time range is one time; None if there is no row.

        Tables with names are left out.
        """
        timed = [table for table in tables if not table.named]
        if read.whose.writers is not None:  # the first row may be of another writer
            return next(self.read(timed, replace(read, wanted=1)), None)
        row = first_at(self._directory, timed, read.time_range.low, read.whose.nodes)
        return next(self._stored_rows([] if row is None else [row], tables), None)

    def beside(
        self, tables: Sequence[TopicTable], t: int, whose: Whose, ways: Sequence[bool]
    ) -> Sequence[StoredRow] | None:
        """Return the rows nearest to a time, one for each way; None if this does not work.

        See fetch.beside. It works only if a row of each way is in the bucket of the time.
        """
        if whose.writers is not None or any(table.named for table in tables):
            return None
        rows = beside(self._directory, tables, t, whose.nodes, ways) if tables else None
        return None if rows is None else list(self._stored_rows(rows, tables))


def _passing(
    messages: Iterable[StoredRow | Window], check: CheckOf | None
) -> Iterator[StoredRow | StackedBatch]:
    """Yield the rows, and the messages of windows, that satisfy a condition; None = all do."""
    table: TopicTable | None = None
    for message in messages:
        if isinstance(message, Window):
            for batch in message.batches:
                passing = batch if check is None else batch.passing(check(batch.table))
                if len(passing):
                    yield passing
            continue
        if check is None:
            yield message
            continue
        if message.table is not table:
            table = message.table
            hit = check(table).hit
        if hit(message):
            yield message


def _inside(position: Position, read: Read) -> bool:
    """Return whether a row is in the time range of a read, and after its cursor."""
    low, high = read.time_range
    return low <= position.t <= high and is_after(position, read.after, read.reverse)


_T = TypeVar("_T")
_Message = TypeVar("_Message", bound=Union[StoredRow, Window])
Tables = Sequence[TopicTable]


def current(tables: Tables, *, fresh: bool = False) -> Tables:
    """Return tables with replaced ones exchanged for those that replaced them; each once.

    For a whole topic the result includes tables that were made since.
    """
    if isinstance(tables, TableSet):
        return tables.renewed(fresh=fresh)
    present = {}
    for table in tables:
        now = table.heir(fresh) or table
        present[now.name] = now
    return list(present.values())


def followed(tables: Tables, work: Callable[[Tables], _T]) -> _T:
    """Call ``work`` with tables; call it again if one of them was replaced and dropped meanwhile.

    For a whole topic it is also called again if the topic has a table that was made before.
    """
    tables = current(tables)
    while True:
        try:
            result = work(tables)
            if not _was_replaced(tables):
                return result
            tables = current(tables)
        except TopicNotFound as exc:
            tables = _present_tables(tables, exc)


def _was_replaced(tables: Tables) -> bool:
    """Return whether one of the tables was replaced, so that it may have been dropped.

    Then the directory may have no entries of it any more, and less than everything was read. The
    same holds if a whole topic has a table that was not read. After an answer of the server this
    includes every change acknowledged before the read began (``store/connection/protocol.py``).
    """
    return not _same(tables, current(tables))


def _same(tables: Tables, now: Tables) -> bool:
    """Return whether the present tables are those that were read."""
    return now is tables or {table.name for table in now} == {table.name for table in tables}


def _present_tables(tables: Tables, error: TopicNotFound) -> Tables:
    """Return the present tables; raise the error if none of them is new."""
    now = current(tables, fresh=True)
    if _same(tables, now):
        raise error
    return now


class FollowingReader:
    """Reads the rows of one keyspace with the methods of RowReader, in replaced tables too."""

    def __init__(self, rows: RowReader) -> None:
        self._rows = rows

    def read(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield rows in order; ``read.after`` may name a table that was replaced."""
        return self._follow(tables, read, self._rows.read)

    def in_order(self, tables: Tables, read: Read, least: LeastOf) -> Iterator[StoredRow | Window]:
        """Yield the messages of ``read`` in the same order; many of them come together.

        Args:
            tables: The tables that are read.
            read: What is read; ``only`` is not set.
            least: Minimum number of messages of a table that come together; see LeastOf.
        """

        def begin(tables: Tables, read: Read) -> Iterator[StoredRow | Window]:
            if any(table.named for table in tables):
                return self._rows.read(tables, read)
            return self._rows.in_order(tables, read, least)

        return self._follow(tables, read, begin)

    def _follow(
        self, tables: Tables, read: Read, begin: Callable[[Tables, Read], Iterator[_Message]]
    ) -> Iterator[_Message]:
        """Yield messages in order.

        Each turn of the loop reads the present tables from the last yielded message on.
        """
        after, last = read.after, None
        while True:
            tables = current(tables)
            if last is not None:
                after = last.position
            start = None if after is None else after.among((t.name for t in tables), read.reverse)
            try:
                for row in begin(tables, replace(read, after=start)):
                    if last is None:
                        if _was_replaced(tables):
                            break  # no row was yielded yet
                        # A list stands for these tables alone: later ones need not be read.
                        tables = list(tables)
                    last = row
                    yield row
                else:
                    if not _was_replaced(tables):
                        return
            except TopicNotFound as exc:
                tables = _present_tables(tables, exc)

    def batches(
        self, tables: Tables, read: Read, parts: PartsOf, check: CheckOf | None = None
    ) -> Iterator[Batch]:
        """Yield the messages of a read that satisfy a condition, as batches, in any order.

        Args:
            tables: The tables that are read.
            read: What is read: ``reverse``, ``after``, ``wanted`` and ``columns`` are not set.
            parts: What is read of the rows of a table.
            check: The check of the condition; None = all messages satisfy it.
        """

        def columns(table: Table) -> Sequence[str] | None:
            if check is None:
                return parts(table).columns
            # The check finds its columns in a row that has these alone, or all of them. So whole
            # rows are read if more than the keys is needed.
            return check(table).columns if parts(table).only_keys else None

        read = replace(read, columns=columns)
        messages: Iterator[StoredRow | Window]
        if read.only is None:
            messages = self.in_order(tables, read, lambda table: 1)
        else:
            messages = self.read(tables, read)
        yield from row_batches(_passing(messages, check), parts)

    def received(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield the rows received in the time range of a read, in order of their receive times."""
        last: StoredRow | None = None
        while True:
            tables = current(tables)
            # Without the table, whose name is another one after a replacement.
            arrival = None if last is None else last.arrival[:3]
            try:
                for row in self._rows.received(tables, read):
                    if arrival is None or row.arrival[:3] > arrival:
                        last = row
                        yield row
                if not _was_replaced(tables):
                    return
            except TopicNotFound as exc:
                tables = _present_tables(tables, exc)

    def exact(self, table: TopicTable, key: Stamp | RowName) -> StoredRow | None:
        """Return one row by a key that the store gave; None if it was deleted."""
        return followed([table], lambda now: self._rows.exact(now[0], key))

    def at(self, tables: Tables, read: Read) -> StoredRow | None:
        """Return the first row of a read whose time range is one time, like RowReader."""
        return followed(tables, lambda now: self._rows.at(now, read))

    def beside(
        self, tables: Tables, t: int, whose: Whose, ways: Sequence[bool]
    ) -> Sequence[StoredRow] | None:
        """Return the rows nearest to a time, like RowReader; None = ``read`` must find them."""
        return followed(tables, lambda now: self._rows.beside(now, t, whose, ways))


def portion_batches(
    messages: Iterable[TableRow | Portion], table: TopicTable, parts: PartsOf
) -> Iterator[Batch]:
    """Yield messages of one table as batches, in any order.

    Args:
        messages: The messages as they were read.
        table: Their table.
        parts: What is read of the messages that are rows.
    """
    pieces = (message if isinstance(message, TableRow) else [message] for message in messages)
    read = _rows_and_windows(pieces, [table], lambda table: 1)
    return row_batches(_passing(chunks_ahead(read), None), parts)


def _rows_and_windows(
    messages: Iterable[TableRow | Sequence[Portion]],
    tables: Sequence[TopicTable],
    least: LeastOf,
) -> Iterator[StoredRow | Window]:
    """Yield rows, and portions as windows, or as rows if there are fewer messages than ``least``.

    Args:
        messages: Rows, and portions whose messages may lie between each other.
        tables: Their tables.
        least: Function of a table that returns for a portion how many messages are enough; None =
            they come one by one.
    """
    by_name = {table.name: table for table in tables}
    for message in messages:
        if isinstance(message, TableRow):
            yield StoredRow(message, by_name[message.table])
            continue
        batches = _batches_of(message, by_name, least)
        if batches is None:
            for row in rows_of(message):
                yield StoredRow(row, by_name[row.table])
        elif batches:
            yield Window(batches)


def _batches_of(
    portions: Sequence[Portion], tables: Mapping[str, TopicTable], least: LeastOf
) -> list[StackedBatch] | None:
    """Return the batches of portions; None = they have to come one by one."""
    leasts = {name: least(tables[name]) for name in {p.table.name for p in portions}}
    if None in leasts.values():
        return None
    batches: list[StackedBatch] = []
    needed = 0
    for portion in portions:
        stacked = portion.stacked()
        if stacked is None:
            return None  # the warning comes with the row
        if len(stacked.times):
            batches.append(_batch_of(tables[portion.table.name], stacked))
            needed += leasts[portion.table.name] or 0
    return batches if sum(map(len, batches)) >= needed else None


def _batch_of(table: TopicTable, stacked: StackedMessages) -> StackedBatch:
    """Return messages that lie together as a batch."""
    groups = [(n, planes_of(stored, rises)) for n, stored, rises in stacked.groups]
    _, node, times, seqs, _, chosen, unsure = stacked
    return StackedBatch(table, node, times, seqs, groups, chosen, unsure)
