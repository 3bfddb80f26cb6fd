# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reads that go on while a table is replaced by another one, because its topic is converted.

The old table is dropped some seconds after the new one became visible. A reader of the old table
then gets an error, and goes on in the new table after the last row that it yielded: rows have the
same positions there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Iterator, Optional, Sequence, TypeVar, Union

from cassandra_ros.arrays.stacked_values import MessageBlock
from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import RowName
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.read import Read, Whose
from cassandra_ros.topics.row_reader import RowReader
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable, WholeTopic

_T = TypeVar("_T")
Tables = Sequence[TopicTable]


def current(tables: Tables, *, fresh: bool = False) -> Tables:
    """Return tables with replaced ones exchanged for those that replaced them; each once.

    For a whole topic the result includes tables that were made since.
    """
    if isinstance(tables, WholeTopic):
        return tables.now(fresh=fresh)
    found = {}
    for table in tables:
        now = table.heir(fresh) or table
        found[now.name] = now
    return list(found.values())


def followed(tables: Tables, work: Callable[[Tables], _T]) -> _T:
    """Call ``work`` with tables; call it again if one of them was replaced and dropped meanwhile.

    For a whole topic it is also called again if the topic has a table that was made before.
    """
    tables = current(tables)
    while True:
        try:
            done = work(tables)
            if not _left(tables):
                return done
            tables = current(tables)
        except TopicNotFound as exc:
            tables = _replaced(tables, exc)


def _left(tables: Tables) -> bool:
    """Return whether one of the tables was replaced, so that it may have been dropped.

    Then the directory may have no entries of it any more, and less than everything was read. The
    same holds if a whole topic has a table that was not read. After an answer of the server this
    includes every change acknowledged before the read began (``connection/protocol.py``).
    """
    return not _same(tables, current(tables))


def _same(tables: Tables, now: Tables) -> bool:
    return now is tables or {table.name for table in now} == {table.name for table in tables}


def _replaced(tables: Tables, gone: TopicNotFound) -> Tables:
    """Return the present tables; raise the error if none of them is new."""
    now = current(tables, fresh=True)
    if _same(tables, now):
        raise gone
    return now


class FollowingReader:
    """Reads the rows of one keyspace with the methods of RowReader, in replaced tables too."""

    def __init__(self, rows: RowReader) -> None:
        self._rows = rows

    def read(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield rows in order; ``read.after`` may name a table that was replaced."""
        after, last = read.after, None
        while True:
            tables = current(tables)
            if last is not None:
                after = last.position
            behind = None if after is None else after.among((t.name for t in tables), read.reverse)
            try:
                found = self._rows.read(tables, replace(read, after=behind))
                first = next(found, None)
                if last is None and _left(tables):
                    continue  # no row was yielded yet
                if first is not None:
                    tables = list(tables)  # tables made from now on need not be read
                    last = first
                    yield first
                for row in found:
                    last = row
                    yield row
                if not _left(tables):
                    return
            except TopicNotFound as exc:
                tables = _replaced(tables, exc)

    def blocks(self, tables: Tables, read: Read) -> Optional[Iterator[MessageBlock]]:
        """Read whole blocks, like RowReader; raises TopicNotFound if a table was replaced."""
        tables = current(tables)
        found = self._rows.blocks(tables, read)
        return None if found is None else _unless_left(tables, found)

    def received(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield the rows received in the time range of a read, in order of their receive times."""
        last: Optional[StoredRow] = None
        while True:
            tables = current(tables)
            given = None if last is None else last.arrival[:3]
            try:
                for row in self._rows.received(tables, read):
                    if given is None or row.arrival[:3] > given:
                        last = row
                        yield row
                if not _left(tables):
                    return
            except TopicNotFound as exc:
                tables = _replaced(tables, exc)

    def exact(self, table: TopicTable, key: Union[Stamp, RowName]) -> Optional[StoredRow]:
        """Return one row by a key that the store gave: one SELECT."""
        return followed([table], lambda now: self._rows.exact(now[0], key))

    def at(self, tables: Tables, read: Read) -> Optional[StoredRow]:
        """Return the first row of a read whose time range is one time."""
        return followed(tables, lambda now: self._rows.at(now, read))

    def beside(
        self, tables: Tables, t: int, whose: Whose, ways: Sequence[bool]
    ) -> Optional[Sequence[StoredRow]]:
        """Return the rows nearest to a time.

        None if this fast way does not work and ``read`` must.
        """
        return followed(tables, lambda now: self._rows.beside(now, t, whose, ways))


def _unless_left(tables: Tables, blocks: Iterator[MessageBlock]) -> Iterator[MessageBlock]:
    yield from blocks
    if _left(tables):
        raise TopicNotFound("a table was replaced while it was read")
