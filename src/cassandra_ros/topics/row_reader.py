# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows of any topics, by time, name or value, without message objects."""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import repeat
from typing import Iterable, Iterator, Optional, Sequence, Union

from cassandra_ros.arrays.stacked_values import MessageBlock
from cassandra_ros.connection.cassandra import Cassandra
from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, RowName, is_after
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.read import Named, Read, Valued, Whose
from cassandra_ros.store.fetch import (
    RowKey,
    beside,
    fetch_row,
    fetch_rows,
    first_at,
    keys_by_shadow,
    list_names,
    versions,
)
from cassandra_ros.store.reader import read_blocks, read_rows
from cassandra_ros.tables.directory import Directory
from cassandra_ros.tables.row_table import TableRow
from cassandra_ros.topics.block_messages import messages_of
from cassandra_ros.topics.stored_row import StoredRow, chunks_ahead
from cassandra_ros.topics.topic_table import TopicTable


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
            rows = self._valued(tables, read.only, read)
        else:
            rows = self._timed(tables, read)
        yield from self._stored(rows, tables)

    def _timed(self, tables: Sequence[TopicTable], read: Read) -> Iterable[TableRow]:
        timed = [table for table in tables if not table.named]
        rows: Iterable[TableRow] = read_rows(self._directory, timed, read)
        if len(timed) == len(tables):
            return rows
        named = self._named([t for t in tables if t.named], read)
        return heapq.merge(rows, named, key=lambda row: row.position, reverse=read.reverse)

    def blocks(self, tables: Sequence[TopicTable], read: Read) -> Optional[Iterator[MessageBlock]]:
        """Read the messages of a time range as whole blocks; None if a table is not packed.

        Only time range, nodes and writers of the read count.
        """
        if not all(table.packed for table in tables):
            return None
        return messages_of(read_blocks(self._directory, tables, read), tables)

    def _stored(
        self, rows: Iterable[TableRow], tables: Sequence[TopicTable]
    ) -> Iterator[StoredRow]:
        if len(tables) == 1:
            made: Iterable[StoredRow] = map(StoredRow, rows, repeat(tables[0]))
        else:
            by_name = {table.name: table for table in tables}
            made = (StoredRow(row, by_name[row.table]) for row in rows)
        for row in chunks_ahead(made):
            self._cassandra.require_open()  # so that an iterator ends when the connection is closed
            yield row

    def _named(self, tables: Sequence[TopicTable], read: Read) -> Iterator[TableRow]:
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
        nodes = read.whose.nodes
        streams = []
        for table in tables:
            if table.named:
                known = {node for _, node in self._directory.nodes(table.name, 0, 0)}
                asked = sorted(known if nodes is None else known.intersection(nodes))
                streams.append(versions(table, only.name, asked, reverse=read.reverse))
        merged = heapq.merge(*streams, key=lambda row: row.position, reverse=read.reverse)
        return (row for row in merged if read.whose.has(row) and _inside(row.position, read))

    def _valued(self, tables: Sequence[TopicTable], only: Valued, read: Read) -> Iterator[TableRow]:
        keys: list[Iterator[RowKey]] = []
        problems: list[InvalidKey] = []
        parts = [(table, table.value_part) for table in tables if table.value_part is not None]
        for table, part in parts:
            try:
                value = part.encode(only.value)
            except InvalidKey as exc:
                problems.append(exc)
                continue
            if value is not None:
                keys.append(self._keys_of(table, part, value, read.whose))
        if problems and len(problems) == len(parts):
            raise problems[0]  # the field has the value's type in none of the tables
        merged: Iterable[RowKey] = heapq.merge(*keys, key=lambda key: key.position)
        merged = (key for key in merged if _inside(key.position, read))
        yield from fetch_rows(reversed(list(merged)) if read.reverse else merged)

    def _keys_of(
        self, table: TopicTable, part: KeyPart, wanted: bytes, whose: Whose
    ) -> Iterator[RowKey]:
        index = part.index(wanted)
        if index is not None:
            shadow = table.metadata.indexes[part.field]
            keys = keys_by_shadow(self._directory, table, shadow, index, whose.nodes)
            yield from (key for key in keys if whose.wrote(key.position.seq))
            return
        # The text is too long for the index: its rows are marked as odd.
        for row in self.read([table], Read(whose=whose)):
            if row.odd and part.value(row.wire) == wanted:
                yield RowKey(table, row.position)

    def received(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Yield the rows received in the time range of a read, in order of their receive times.

        For topics whose key is a time in the message all keys are listed first.
        """
        foreign = {t.name: t for t in tables if t.metadata.own_time and not t.named}
        own = self.read([t for t in tables if t.name not in foreign], read)
        low, high = read.time_range
        listing = Read(whose=read.whose, columns=lambda table: ())
        keys = sorted(
            (r.received, r.node, r.seq, r.table, r.position)
            for r in read_rows(self._directory, list(foreign.values()), listing)
            if low <= r.received <= high
        )
        wanted = (RowKey(foreign[position.table], position) for *_, position in keys)
        late = self._stored(fetch_rows(wanted), tables)
        return heapq.merge(own, late, key=lambda row: row.arrival)

    def exact(self, table: TopicTable, key: Union[Stamp, RowName]) -> Optional[StoredRow]:
        """Return one row by a key that the store gave: one SELECT."""
        t, name = (key.t, str(key)) if isinstance(key, RowName) else (key.ns, "")
        position = Position(t, key.node or "", key.seq or 0, table.name, name)
        row = fetch_row(table, position)
        return None if row is None else StoredRow(row, table)

    def at(self, tables: Sequence[TopicTable], read: Read) -> Optional[StoredRow]:
        """Return the first row of a read whose time range is one time."""
        timed = [table for table in tables if not table.named]
        if read.whose.writers is not None:  # the first row may be of another writer
            return next(self.read(timed, replace(read, wanted=1)), None)
        row = first_at(self._directory, timed, read.time_range.low, read.whose.nodes)
        return next(self._stored([] if row is None else [row], tables), None)

    def beside(
        self, tables: Sequence[TopicTable], t: int, whose: Whose, ways: Sequence[bool]
    ) -> Optional[Sequence[StoredRow]]:
        """Return the rows nearest to a time; None if this fast way does not work.

        See fetch.beside.
        """
        if whose.writers is not None or any(table.named for table in tables):
            return None
        rows = beside(self._directory, tables, t, whose.nodes, ways) if tables else None
        return None if rows is None else list(self._stored(rows, tables))


def _inside(position: Position, read: Read) -> bool:
    """Return whether a row with one name or value is in the time range and after the cursor."""
    low, high = read.time_range
    return low <= position.t <= high and is_after(position, read.after, read.reverse)
