# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reading goes on where a table is replaced by another meanwhile: a topic is converted.

The old table is dropped some seconds after the new one became visible. Whoever is reading it then
is told that it is gone, and goes on in the new one behind the last row that he was given: the rows
have the same places there.
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
    """Return tables with those in place of them that have replaced some; each once.

    Of a whole topic those that were made since are among them.
    """
    if isinstance(tables, WholeTopic):
        return tables.now(fresh=fresh)
    found = {}
    for table in tables:
        now = table.heir(fresh) or table
        found[now.name] = now
    return list(found.values())


def followed(tables: Tables, work: Callable[[Tables], _T]) -> _T:
    """Do something with tables, anew where one of them was replaced and dropped meanwhile.

    It is done anew, too, where a whole topic has a table that was made before.
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
    """Say whether one of the tables was replaced, long enough ago for it to be dropped.

    Then the directory may know nothing of it any more, and what was read be less than all. So it is
    where a whole topic has a table that was not read. Asked after an answer of the server, it
    knows all that was acknowledged before the read began (``connection/schema_changes.py``).
    """
    return not _same(tables, current(tables))


def _same(tables: Tables, now: Tables) -> bool:
    return now is tables or {table.name for table in now} == {table.name for table in tables}


def _replaced(tables: Tables, gone: TopicNotFound) -> Tables:
    """Return the tables of now; raise the error where none of them is new."""
    now = current(tables, fresh=True)
    if _same(tables, now):
        raise gone
    return now


class Following:
    """Reads the rows of one keyspace as RowReader does, whose methods these are."""

    def __init__(self, rows: RowReader) -> None:
        self._rows = rows

    def read(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield rows in their order; ``read.after`` may name a table that was replaced."""
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
                    continue  # nothing was given yet
                if first is not None:
                    tables = list(tables)  # what is made from now on need not be read
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
        """Read whole blocks, as RowReader does; TopicNotFound where a table was replaced."""
        tables = current(tables)
        found = self._rows.blocks(tables, read)
        return None if found is None else _unless_left(tables, found)

    def received(self, tables: Tables, read: Read) -> Iterator[StoredRow]:
        """Yield the rows received in the time range of a read, in the order of their reception."""
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
        """Read one row by the key that the store gave: one SELECT."""
        return followed([table], lambda now: self._rows.exact(now[0], key))

    def at(self, tables: Tables, read: Read) -> Optional[StoredRow]:
        """Read the first row of a read whose time range is one time."""
        return followed(tables, lambda now: self._rows.at(now, read))

    def beside(
        self, tables: Tables, t: int, whose: Whose, ways: Sequence[bool]
    ) -> Optional[Sequence[StoredRow]]:
        """Find the rows nearest to a time, quickly; None where read has to."""
        return followed(tables, lambda now: self._rows.beside(now, t, whose, ways))


def _unless_left(tables: Tables, blocks: Iterator[MessageBlock]) -> Iterator[MessageBlock]:
    yield from blocks
    if _left(tables):
        raise TopicNotFound("a table was replaced while it was read")
