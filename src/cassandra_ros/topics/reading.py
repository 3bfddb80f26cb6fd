# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows of any topics, by time, name or value. No message object is made."""

from __future__ import annotations

import heapq
from itertools import islice
from typing import Callable, Iterable, Iterator, Mapping, Optional, Sequence, Union

from cassandra_ros.errors import CorruptMessage, InvalidKey, MessageNotFound
from cassandra_ros.keys import Position, RowName, isBehind
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Chooser
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.fetch import (
    Wanted,
    fetchRows,
    firstAt,
    keysByShadow,
    listNames,
    versions,
)
from cassandra_ros.store.large import readChunks
from cassandra_ros.store.reader import Query, Scan, readRows
from cassandra_ros.store.row_table import RowTable, TableRow
from cassandra_ros.topics.connections import Connections
from cassandra_ros.topics.selection import LAST_NS, AnyKey, Named, Selection, Stretch, Valued
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

Nodes = Optional[Sequence[str]]
Columns = Callable[[TopicTable], Optional[Sequence[str]]]


class _OfTopics:
    """A chooser that knows topic tables, for the store, which knows only rows.

    Args:
        chooser: Decides about topic tables.
        tables: By their names.
    """

    def __init__(self, chooser: Chooser, tables: Mapping[str, TopicTable]) -> None:
        self._chooser = chooser
        self._tables = tables

    def choose(self, table: RowTable, bucket: Sequence[BucketRow]) -> Optional[Sequence[Query]]:
        """Ask it about the topic table."""
        return self._chooser.choose(self._tables[table.name], bucket)

    def few(self, table: RowTable) -> bool:
        """Ask it about the topic table."""
        return self._chooser.few(self._tables[table.name])

    def learn(self, table: RowTable, bucket: Sequence[BucketRow], found: int) -> None:
        """Tell it about the topic table."""
        self._chooser.learn(self._tables[table.name], bucket, found)


class Rows:
    """Reads the rows of one keyspace."""

    def __init__(
        self, cassandra: Cassandra, directory: Directory, connections: Connections
    ) -> None:
        self._cassandra = cassandra
        self._directory = directory
        self._connections = connections

    # ---------------------------------------------------------------- many

    def select(
        self,
        tables: Sequence[TopicTable],
        wanted: Selection,
        *,
        nodes: Nodes = None,
        reverse: bool = False,
        limit: Optional[int] = None,
    ) -> Iterator[StoredRow]:
        """Yield the rows that a selection means, in the order of time or newest first."""
        if isinstance(wanted, Stretch):
            return self.read(tables, wanted, nodes=nodes, reverse=reverse, limit=limit)
        if isinstance(wanted, Named):
            rows = self._versions(tables, wanted.name, nodes, reverse)
        else:
            rows = self._valued(tables, wanted, nodes, reverse)
        return islice(rows, limit)

    def read(
        self,
        tables: Sequence[TopicTable],
        stretch: Stretch,
        *,
        nodes: Nodes = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        limit: Optional[int] = None,
        columns: Optional[Columns] = None,
        chooser: Optional[Chooser] = None,
    ) -> Iterator[StoredRow]:
        """Yield rows with a time in a stretch in the order (t, node, seq, table), lazily.

        Of topics whose messages lie under names all keys are listed first, and all rows are read.

        Args:
            columns: Which of the format's columns to read, in their order; a row fetches the
                others when its bytes are asked for.
            chooser: What the server may leave out; it may leave out less.
        """
        by_name = {table.name: table for table in tables}
        scan = Scan(
            stretch.low,
            stretch.high,
            after,
            nodes,
            reverse,
            None if columns is None else (lambda table: columns(by_name[table.name])),
            None if chooser is None else _OfTopics(chooser, by_name),
        )
        timed = [table for table in tables if not table.named]
        rows: Iterable[TableRow] = readRows(self._directory, timed, scan)
        if len(timed) < len(tables):
            named = self._named([t for t in tables if t.named], scan)
            rows = heapq.merge(rows, named, key=lambda row: row.position, reverse=reverse)
        for row in islice(rows, limit):
            yield self._stored(row, by_name[row.table])

    def _named(self, tables: Sequence[TopicTable], scan: Scan) -> Iterator[TableRow]:
        keys = [
            Wanted(table, key.position)
            for table in tables
            for key in listNames(table, scan.nodes)
            if scan.low <= key.position.t <= scan.high
            and isBehind(key.position, scan.after, scan.reverse)
        ]
        keys.sort(key=lambda key: key.position, reverse=scan.reverse)
        return fetchRows(keys)

    def _versions(
        self, tables: Sequence[TopicTable], name: str, nodes: Nodes, reverse: bool
    ) -> Iterator[StoredRow]:
        by_name = {table.name: table for table in tables if table.named}
        streams = []
        for table in by_name.values():
            known = [node for _, node in self._directory.nodes(table.name, 0, 0)]
            asked = sorted(known if nodes is None else set(known) & set(nodes))
            streams.append(versions(table, name, asked, reverse=reverse))
        rows = heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)
        return (self._stored(row, by_name[row.table]) for row in rows)

    def _valued(
        self, tables: Sequence[TopicTable], wanted: Valued, nodes: Nodes, reverse: bool
    ) -> Iterator[StoredRow]:
        keys = [self._keysOf(table, value, nodes) for table, value in encoded(tables, wanted.value)]
        merged: Iterable[Wanted] = heapq.merge(*keys, key=lambda key: key.position)
        if reverse:
            merged = reversed(list(merged))
        by_name = {table.name: table for table in tables}
        for row in fetchRows(merged):
            yield self._stored(row, by_name[row.table])

    def _keysOf(self, table: TopicTable, wanted: bytes, nodes: Nodes) -> Iterator[Wanted]:
        part = table.keyPart()
        index = part.index(wanted)
        if index is not None:
            shadow = table.metadata.indexes[part.field]
            yield from keysByShadow(self._directory, table, shadow, index, nodes)
            return
        # A text that is too long for the index: its rows are marked, but not by a value.
        for row in self.read([table], Stretch(), nodes=nodes):
            if row.odd and part.value(row.wire) == wanted:
                yield Wanted(table, row.position)

    def received(
        self, tables: Sequence[TopicTable], stretch: Stretch, *, nodes: Nodes = None
    ) -> Iterator[StoredRow]:
        """Yield the rows that were received in a stretch, in the order of their reception.

        Of topics whose key is a time in the message all keys are listed first.
        """
        by_name = {table.name: table for table in tables}
        foreign = [t for t in tables if t.metadata.own_time and not t.named]
        own = self.read([t for t in tables if t not in foreign], stretch, nodes=nodes)
        scan = Scan(0, LAST_NS, None, nodes, columns=lambda table: ())
        found = readRows(self._directory, foreign, scan)
        keys = [
            (r.received, r.node, r.seq, r.table, r.position)
            for r in found
            if stretch.low <= r.received <= stretch.high
        ]
        keys.sort()
        wanted = (Wanted(by_name[position.table], position) for *_, position in keys)
        rows = fetchRows(wanted)
        late = (self._stored(row, by_name[row.table]) for row in rows)
        return heapq.merge(own, late, key=lambda row: row.arrival)

    # ---------------------------------------------------------------- one

    def exact(self, table: TopicTable, key: Union[Stamp, RowName]) -> Optional[StoredRow]:
        """Read one row by the key that the store gave: one SELECT."""
        name = str(key) if isinstance(key, RowName) else ""
        t = key.t if isinstance(key, RowName) else key.ns
        position = Position(t, key.node or "", key.seq or 0, table.name, name)
        rows = fetchRows([Wanted(table, position)], ahead=1)
        row = next(rows, None)
        return None if row is None else self._stored(row, table)

    def at(self, tables: Sequence[TopicTable], t: int, nodes: Nodes) -> Optional[StoredRow]:
        """Read the first row with exactly this time."""
        timed = [table for table in tables if not table.named]
        row = firstAt(self._directory, timed, t, nodes)
        if row is None:
            return None
        return self._stored(row, next(table for table in tables if table.name == row.table))

    def _stored(self, row: TableRow, table: TopicTable) -> StoredRow:
        self._cassandra.require_open()  # also an iterator says at once that it cannot go on
        return StoredRow(row, table, self.wire, self._connections.get)

    def wire(self, table: TopicTable, row: TableRow) -> bytes:
        """Return the serialised message of a row.

        Raises:
            CorruptMessage: Its chunks are incomplete, or its columns give another message.
        """
        if row.nchunks:
            return readChunks(table, row)
        if row.raw is None and len(row.columns) < len(table.columns):
            row = self._whole(table, row)
        wire = table.format.decodeWire(row.columns, row.raw)
        if len(wire) != row.size:
            raise CorruptMessage(
                f"the message of topic {table.metadata.topic} at {row.t} has {len(wire)} bytes "
                f"instead of {row.size}: its columns were changed by somebody else"
            )
        return wire

    def _whole(self, table: TopicTable, row: TableRow) -> TableRow:
        """Fetch a row of which only some columns were read."""
        found = next(fetchRows([Wanted(table, row.position)], ahead=1), None)
        if found is None:
            raise MessageNotFound(
                f"the message of topic {table.metadata.topic} at {row.t} was removed while it was "
                "read"
            )
        return found


def encoded(tables: Sequence[TopicTable], value: AnyKey) -> list[tuple[TopicTable, bytes]]:
    """Return the tables whose key field can have a value, each with the value for its index.

    Raises:
        InvalidKey: In none of them the field is of the value's kind.
    """
    found: list[tuple[TopicTable, bytes]] = []
    problems: list[InvalidKey] = []
    valued = [table for table in tables if table.valued]
    for table in valued:
        try:
            wanted = table.keyPart().encode(value)
        except InvalidKey as exc:
            problems.append(exc)
            continue
        if wanted is not None:
            found.append((table, wanted))
    if problems and len(problems) == len(valued):
        raise problems[0]
    return found
