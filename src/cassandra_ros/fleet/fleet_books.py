# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which buckets of a store need not be read, because a store that is named before it has them.

The books of a store say what another store has acknowledged (``tables/copy_books.py``). That is
believed of a bucket only while nothing has changed on either side since: both directories list it
as closed, with the heartbeats that the books noted. So a message that was deleted in the other
store still comes from this one. In all other cases both stores are read.
"""

from __future__ import annotations

import logging
import time
from functools import lru_cache, partial
from typing import (
    Callable,
    Collection,
    Mapping,
    NamedTuple,
    Protocol,
    Sequence,
    TypeVar,
)
from uuid import UUID

from cassandra_ros.errors import AccessDenied
from cassandra_ros.keys import MAX_NS, writer_of
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import Read, Skip, TimeRange, Whose
from cassandra_ros.tables.copy_books import CopiedTable, CopyBooks, target_id
from cassandra_ros.tables.directory import SLOT_BUCKETS, BucketRow, slot_of
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_S = TypeVar("_S")

Topics = Mapping[str, Collection[str]]
"""Name of a store → names of the topics that are read there."""
_THERE, _HERE = 1, 2
"""State of a bucket: its messages are in the other store; it has to be read here."""
SLOTS_HELD = 256
"""Number of slots whose states are kept in memory, 4 KiB each."""
FRESH_SEC = 10.0
"""Maximum age of a state, s. What is deleted in the other store later than that, while an answer is
read, may be left out."""
MOST_RANGES = 64
"""Maximum number of time ranges that are read between those that the directory counts."""


class StoredPlace(Protocol):
    """A message, as FleetRow has it."""

    t: int
    node: str
    seq: int

    @property
    def topic(self) -> str:
        """Name of the topic."""


class Stores(Protocol):
    """The stores that a question is asked, as FleetAnswer has them."""

    catalogs: dict[str, Catalog]
    missing: dict[str, str]

    def each(self, values: Mapping[str, _S], work: Callable[[_S], _T]) -> dict[str, _T]:
        """Call a function with a value of each store that answers."""


class _Copy(NamedTuple):
    """The table of another store that takes the rows of a table."""

    store: str
    target: UUID
    table: str


class FleetBooks:
    """The books of the stores of one question, as far as they concern stores named before.

    Args:
        stores: The stores that are asked.
        believed: Whether the books count. What another store has acknowledged is read there by a
            quorum, perhaps not by fewer of its nodes.
    """

    def __init__(self, stores: Stores, *, believed: bool) -> None:
        self._stores = stores
        self._copies: dict[tuple[str, str], _Copy] = {}
        self._states = lru_cache(SLOTS_HELD)(self._read_states)
        names = list(stores.catalogs) if believed else []
        books = stores.each({name: stores.catalogs[name] for name in names[1:]}, _entries)
        if not any(books.values()):
            return
        ids = stores.each(stores.catalogs, _identity)
        tables = stores.each(stores.catalogs, lambda c: c.keyspace.schema.listing().visible)
        for name, entries in books.items():
            for store in names[: names.index(name)]:
                for entry in entries:
                    mine = tables.get(name, {}).get(entry.table)
                    theirs = tables.get(store, {}).get(entry.there)
                    if entry.target == ids.get(store) and _are_alike(mine, theirs):
                        copy = _Copy(store, entry.target, entry.there)
                        self._copies.setdefault((name, entry.table), copy)

    def skips(self, topics: Topics) -> dict[str, Skip]:
        """Return which buckets need not be read, for each store of which some perhaps need not."""
        stores = {name for (name, _), copy in self._copies.items() if self._is_asked(copy)}
        return {name: partial(self._is_there, topics, name) for name in topics if name in stores}

    def targets(self, stores: Collection[str]) -> set[str]:
        """Return the stores that have, by the books of some stores, messages of these."""
        return {copy.store for (name, _), copy in self._copies.items() if name in stores}

    def _is_asked(self, copy: _Copy) -> bool:
        return copy.store not in self._stores.missing

    def _is_there(
        self, topics: Topics, store: str, table: TopicTable, node: str, bucket: int
    ) -> bool:
        copy = self._copies.get((store, table.name))
        if copy is None or not self._is_asked(copy):
            return False
        if table.metadata.topic not in topics.get(copy.store, ()):
            return False
        slot = slot_of(bucket)
        states = self._states(store, table.name, node, slot, _now())
        return states[bucket - slot * SLOT_BUCKETS] == _THERE and self._is_asked(copy)

    def _read_states(self, store: str, table: str, node: str, slot: int, _now: int) -> bytes:
        """Return the states of the buckets of a slot; 0 = there is no such bucket."""
        here, copy = self._stores.catalogs[store].keyspace, self._copies.get((store, table))
        first, states = slot * SLOT_BUCKETS, bytearray(SLOT_BUCKETS)
        rows = _entries_of(self._stores.catalogs[store], table, node, slot)
        beats: dict[tuple[int, int], object] = {}
        known: dict[tuple[int, int], object] = {}
        if copy is not None:
            books = CopyBooks(here.side_tables)
            noted = books.beats(copy.target, table, slot, node)
            entries = books.buckets(copy.target, table, [(slot, node)]) if noted else []
            sure = {(b.bucket, b.writer): b for b in entries if (b.bucket, b.writer) in noted}
            for row in rows:
                place = row.bucket, row.writer
                if place in sure and row.closed and sure[place].confirms(row, [copy.table]):
                    known[place] = noted[place]
        if copy is not None and known:
            asked = {copy.store: self._stores.catalogs[copy.store]}
            found = self._stores.each(asked, lambda c: _entries_of(c, copy.table, node, slot))
            theirs = [row for answer in found.values() for row in answer]
            beats = {(row.bucket, row.writer): row.heartbeat for row in theirs if row.closed}
        for row in rows:
            place, index = (row.bucket, row.writer), row.bucket - first
            same = place in known and beats.get(place) == known[place]
            states[index] = max(states[index], _THERE if same else _HERE)
        return bytes(states)

    def copies(self, topics: Topics, row: StoredPlace) -> list[tuple[str, StoredRow]]:
        """Return the rows of a message in the stores that were not read for it."""
        writers = frozenset([writer_of(row.seq)])
        read = Read(TimeRange(row.t, row.t), Whose((row.node,), writers))

        def find(store: str) -> list[StoredRow]:
            catalog = self._stores.catalogs[store]
            rows = catalog.keyspace.rows.read(catalog.tables([row.topic]), read)
            return [each for each in rows if each.seq == row.seq]

        copied = {name for name, _ in self._copies}
        spared = [name for name in topics if name in copied and row.topic in topics[name]]
        found = self._stores.each({name: name for name in spared}, find)
        return [(name, each) for name, rows in found.items() for each in rows]

    def shared(
        self, tables: Mapping[str, Sequence[TopicTable]], read: Read
    ) -> list[TimeRange] | None:
        """Return the time ranges of a read in which not only the first store has to be read.

        Args:
            tables: The tables of a topic in each store, the first of which has one.

        Returns:
            Ranges in order that begin and end with buckets of the first store; None = too many.
        """
        (own,), *_ = tables.values()
        length, (low, high) = own.bucket_ns, read.time_range
        others = {name: partial(self._busy, name, tables[name], read) for name in list(tables)[1:]}
        found = self._stores.each(others, lambda busy: busy())
        merged: list[TimeRange] = []
        for begin, end in sorted(each for ranges in found.values() for each in ranges):
            first, last = begin // length * length, (end // length + 1) * length - 1
            if merged and first <= merged[-1].high + 1:
                first, last = merged[-1].low, max(merged.pop().high, last)
            merged.append(TimeRange(max(low, first), min(high, last)))
        return merged if len(merged) <= MOST_RANGES else None

    def _busy(self, store: str, tables: Sequence[TopicTable], read: Read) -> list[TimeRange]:
        """Return the time ranges of the buckets of a store that have to be read there."""
        directory = self._stores.catalogs[store].keyspace.directory
        low, high = read.time_range
        nodes, found = read.whose.nodes, []
        for table in tables:
            length = table.bucket_ns
            ends = table.bucket_of(low), table.bucket_of(min(high, MAX_NS))
            for slot, node in directory.nodes(table.name, *map(slot_of, ends)):
                if nodes is None or node in nodes:
                    states = self._states(store, table.name, node, slot, _now())
                    places = [n for n, state in enumerate(states) if state == _HERE]
                    buckets = (slot * SLOT_BUCKETS + n for n in places)
                    found += [
                        TimeRange(bucket * length, (bucket + 1) * length - 1)
                        for bucket in buckets
                        if ends[0] <= bucket <= ends[1]
                    ]
        return found


def _now() -> int:
    """Return a number that changes when states have to be read again."""
    return int(time.monotonic() / FRESH_SEC)


def _identity(catalog: Catalog) -> UUID | None:
    return target_id(catalog.keyspace.cassandra, catalog.keyspace.name)


def _entries(catalog: Catalog) -> list[CopiedTable]:
    """Return the tables in the books of a store; none if the user may not read them."""
    try:
        entries = CopyBooks(catalog.keyspace.side_tables).tables()
    except AccessDenied as exc:
        _log.info("the books of copies are not used: %s", exc)
        return []
    return [entry for entry in entries if entry.there and not entry.gone]


def _are_alike(mine: TopicMetadata | None, theirs: TopicMetadata | None) -> bool:
    """Return whether a table may stand for another: it has the topic, and its rows stay."""
    if mine is None or theirs is None:
        return False
    return mine.topic == theirs.topic and not theirs.ttl


def _entries_of(catalog: Catalog, table: str, node: str, slot: int) -> list[BucketRow]:
    """Return the entries of cr_bucket of a slot; the books have its heartbeats."""
    first = slot * SLOT_BUCKETS
    place = (table, node, slot, first, first + SLOT_BUCKETS - 1)
    asked = catalog.keyspace.directory.begin_buckets([place])
    return [row for answer in asked for row in answer()]
