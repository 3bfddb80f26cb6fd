# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows of any topics, by time, name or value. No message object is made."""

from __future__ import annotations

import heapq
from itertools import repeat
from typing import Callable, Iterable, Iterator, Optional, Sequence, Union, cast

from cassandra_ros.arrays.stacked_values import MessageBlock
from cassandra_ros.connection.cassandra import Cassandra
from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, RowName, is_behind
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.plan.pushdown import Pushdown
from cassandra_ros.store.fetch import (
    Wanted,
    beside,
    fetch_row,
    fetch_rows,
    first_at,
    keys_by_shadow,
    list_names,
    versions,
)
from cassandra_ros.store.reader import read_blocks, read_rows
from cassandra_ros.store.scan import Chooser, Scan
from cassandra_ros.tables.directory import Directory
from cassandra_ros.tables.row_table import RowTable, TableRow
from cassandra_ros.topics.block_messages import messages_of
from cassandra_ros.topics.chunks_ahead import chunks_ahead
from cassandra_ros.topics.key_selection import (
    EVERYBODY,
    LAST_NS,
    Named,
    Selection,
    TimeRange,
    Valued,
    Whose,
)
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

Columns = Callable[[TopicTable], Optional[Sequence[str]]]


class RowReader:
    """Reads the rows of one keyspace."""

    def __init__(self, cassandra: Cassandra, directory: Directory) -> None:
        self._cassandra = cassandra
        self._directory = directory

    def select(
        self,
        tables: Sequence[TopicTable],
        wanted: Selection,
        whose: Whose,
        reverse: bool,
        few: Optional[int] = None,
    ) -> Iterator[StoredRow]:
        """Yield the rows that a selection means, in the order of time or newest first.

        Args:
            few: How many are probably taken; None = all.
        """
        if isinstance(wanted, TimeRange):
            return self.read(tables, wanted, whose=whose, reverse=reverse, wanted=few)
        if isinstance(wanted, Named):
            rows = self._versions(tables, wanted.name, whose, reverse)
        else:
            rows = self._valued(tables, wanted, whose, reverse)
        return self._stored(rows, tables)

    def read(
        self,
        tables: Sequence[TopicTable],
        time_range: TimeRange,
        *,
        whose: Whose = EVERYBODY,
        after: Optional[Position] = None,
        reverse: bool = False,
        columns: Optional[Columns] = None,
        chooser: Optional[Pushdown] = None,
        wanted: Optional[int] = None,
    ) -> Iterator[StoredRow]:
        """Yield rows with a time in a stretch in the order (t, node, seq, table), lazily.

        Of topics whose messages lie under names all keys are listed first, and all rows are read.
        For columns, chooser and wanted see CassandraTopic.rows; the server may leave out less.
        """
        scan = Scan(
            *time_range,
            after,
            whose.nodes,
            reverse,
            # The store gives back the tables that it is given, which are TopicTables.
            cast("Optional[Callable[[RowTable], Optional[Sequence[str]]]]", columns),
            cast("Optional[Chooser]", chooser),
            whose.writers,
            wanted,
        )
        timed = [table for table in tables if not table.named]
        rows: Iterable[TableRow] = read_rows(self._directory, timed, scan)
        if len(timed) < len(tables):
            named = self._named([t for t in tables if t.named], scan, whose)
            rows = heapq.merge(rows, named, key=lambda row: row.position, reverse=reverse)
        yield from self._stored(rows, tables)

    def blocks(
        self, tables: Sequence[TopicTable], time_range: TimeRange, *, whose: Whose = EVERYBODY
    ) -> Optional[Iterator[MessageBlock]]:
        """Read the messages of a stretch as whole blocks; None where not all lie in such."""
        if not all(table.packed for table in tables):
            return None
        scan = Scan(*time_range, nodes=whose.nodes, writers=whose.writers)
        return messages_of(read_blocks(self._directory, tables, scan), tables)

    def _stored(
        self, rows: Iterable[TableRow], tables: Sequence[TopicTable]
    ) -> Iterator[StoredRow]:
        if len(tables) == 1:
            made: Iterable[StoredRow] = map(StoredRow, rows, repeat(tables[0]))
        else:
            by_name = {table.name: table for table in tables}
            made = (StoredRow(row, by_name[row.table]) for row in rows)
        for row in chunks_ahead(made):
            self._cassandra.require_open()  # also an iterator says at once that it cannot go on
            yield row

    def _named(self, tables: Sequence[TopicTable], scan: Scan, whose: Whose) -> Iterator[TableRow]:
        keys = [
            Wanted(table, key.position)
            for table in tables
            for key in list_names(table, scan.nodes)
            if scan.low <= key.position.t <= scan.high
            and whose.wrote(key.position.seq)
            and is_behind(key.position, scan.after, scan.reverse)
        ]
        keys.sort(key=lambda key: key.position, reverse=scan.reverse)
        return fetch_rows(keys)

    def _versions(
        self, tables: Sequence[TopicTable], name: str, whose: Whose, reverse: bool
    ) -> Iterator[TableRow]:
        streams = []
        for table in tables:
            if table.named:
                known = {node for _, node in self._directory.nodes(table.name, 0, 0)}
                asked = sorted(known if whose.nodes is None else known.intersection(whose.nodes))
                streams.append(versions(table, name, asked, reverse=reverse))
        merged = heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)
        return filter(whose.has, merged)

    def _valued(
        self, tables: Sequence[TopicTable], wanted: Valued, whose: Whose, reverse: bool
    ) -> Iterator[TableRow]:
        keys: list[Iterator[Wanted]] = []
        problems: list[InvalidKey] = []
        parts = [(table, table.value_part) for table in tables if table.value_part is not None]
        for table, part in parts:
            try:
                value = part.encode(wanted.value)
            except InvalidKey as exc:
                problems.append(exc)
                continue
            if value is not None:
                keys.append(self._keys_of(table, part, value, whose))
        if problems and len(problems) == len(parts):
            raise problems[0]  # in none of the tables the field is of the value's kind
        merged: Iterable[Wanted] = heapq.merge(*keys, key=lambda key: key.position)
        yield from fetch_rows(reversed(list(merged)) if reverse else merged)

    def _keys_of(
        self, table: TopicTable, part: KeyPart, wanted: bytes, whose: Whose
    ) -> Iterator[Wanted]:
        index = part.index(wanted)
        if index is not None:
            shadow = table.metadata.indexes[part.field]
            keys = keys_by_shadow(self._directory, table, shadow, index, whose.nodes)
            yield from (key for key in keys if whose.wrote(key.position.seq))
            return
        # A text that is too long for the index: its rows are marked, but not by a value.
        for row in self.read([table], TimeRange(), whose=whose):
            if row.odd and part.value(row.wire) == wanted:
                yield Wanted(table, row.position)

    def received(
        self, tables: Sequence[TopicTable], time_range: TimeRange, *, whose: Whose = EVERYBODY
    ) -> Iterator[StoredRow]:
        """Yield the rows that were received in a stretch, in the order of their reception.

        Of topics whose key is a time in the message all keys are listed first.
        """
        foreign = {t.name: t for t in tables if t.metadata.own_time and not t.named}
        own = self.read([t for t in tables if t.name not in foreign], time_range, whose=whose)
        nodes, writers = whose
        scan = Scan(0, LAST_NS, None, nodes, columns=lambda table: (), writers=writers)
        keys = sorted(
            (r.received, r.node, r.seq, r.table, r.position)
            for r in read_rows(self._directory, list(foreign.values()), scan)
            if time_range.low <= r.received <= time_range.high
        )
        wanted = (Wanted(foreign[position.table], position) for *_, position in keys)
        late = self._stored(fetch_rows(wanted), tables)
        return heapq.merge(own, late, key=lambda row: row.arrival)

    def exact(self, table: TopicTable, key: Union[Stamp, RowName]) -> Optional[StoredRow]:
        """Read one row by the key that the store gave: one SELECT."""
        t, name = (key.t, str(key)) if isinstance(key, RowName) else (key.ns, "")
        position = Position(t, key.node or "", key.seq or 0, table.name, name)
        row = fetch_row(table, position)
        return None if row is None else StoredRow(row, table)

    def at(self, tables: Sequence[TopicTable], t: int, whose: Whose) -> Optional[StoredRow]:
        """Read the first row with exactly this time."""
        timed = [table for table in tables if not table.named]
        if whose.writers is not None:  # the first of a partition may be another's
            return next(self.read(timed, TimeRange(t, t), whose=whose, wanted=1), None)
        row = first_at(self._directory, timed, t, whose.nodes)
        return next(self._stored([] if row is None else [row], tables), None)

    def beside(
        self, tables: Sequence[TopicTable], t: int, whose: Whose, ways: Sequence[bool]
    ) -> Optional[Sequence[StoredRow]]:
        """Find the rows nearest to a time, quickly; None where read has to; see fetch.beside."""
        if whose.writers is not None or any(table.named for table in tables):
            return None
        rows = beside(self._directory, tables, t, whose.nodes, ways) if tables else None
        return None if rows is None else list(self._stored(rows, tables))
