# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which buckets of a store need not be read, because a store that is named before it has them.

The books of a store say what another store has acknowledged (``store/tables/copy_books.py``). That
is believed of a bucket only while nothing has changed on either side since: both directories list
it as closed, with the heartbeats that the books noted. So a message that was deleted in the other
store still comes from this one. In all other cases both stores are read.

Books and directories are read before any message is: what is copied while an answer is read may
lie behind the place up to which the other store was read.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Collection, Iterable, Mapping, NamedTuple, Sequence
from uuid import UUID

from cassandra_ros.errors import AccessDenied
from cassandra_ros.keys import MAX_NS, writer_of
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import Read, Skip, TimeRange, Whose
from cassandra_ros.store.tables.copy_books import CopiedTable, CopyBooks, target_id
from cassandra_ros.store.tables.directory import SLOT_BUCKETS, BucketRow, slot_of
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

if TYPE_CHECKING:
    from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
    from cassandra_ros.stores.fleet.fleet_row import FleetRow

_log = logging.getLogger(__name__)

Topics = Mapping[str, Collection[str]]
"""Name of a store → names of the topics that are read there."""
BOOK_SLOTS = 64
"""Maximum number of slots of a table, each of one robot, whose books are read; with more, all
stores are read."""
MOST_RANGES = 64
"""Maximum number of time ranges that are read between those that the directory counts."""


class _Copy(NamedTuple):
    """The table of another store that takes the rows of a table."""

    store: str
    target: UUID
    table: str


@dataclass
class _Buckets:
    """The buckets of one table and robot, in the time range of a read."""

    copy: _Copy
    there: set[int] = field(default_factory=set)
    """Those that the other store has whole."""
    here: set[int] = field(default_factory=set)
    """Those that have to be read here."""


class FleetBooks:
    """The books of the stores of one question, as far as they concern stores named before.

    Args:
        stores: The stores that are asked.
        believed: Whether the books count. What another store has acknowledged is read there by a
            quorum, perhaps not by fewer of its nodes.
    """

    def __init__(self, stores: FleetAnswer, *, believed: bool) -> None:
        self._stores = stores
        self._copies: dict[str, dict[str, _Copy]] = {}
        """Store → name of a table → its copy."""
        names = list(stores.catalogs) if believed else []
        books = stores.each({name: stores.catalogs[name] for name in names[1:]}, _entries)
        if not any(books.values()):
            return
        ids = stores.each(stores.catalogs, _identity)
        tables = stores.each(stores.catalogs, lambda c: c.keyspace.schema.listing().visible)
        for name, entries in books.items():
            for store in names[: names.index(name)]:  # of several the first one
                for entry in entries:
                    metadata = tables.get(name, {}).get(entry.table)
                    other = tables.get(store, {}).get(entry.there)
                    if entry.target == ids.get(store) and _may_replace(metadata, other):
                        copy = _Copy(store, entry.target, entry.there)
                        self._copies.setdefault(name, {}).setdefault(entry.table, copy)

    def spared(self, topics: Topics, read: Read) -> Spared:
        """Return which buckets need not be read, as books and directories are now."""
        work_of = {
            name: partial(self._read, topics, name, read)
            for name in topics
            if any(self._is_asked(copy) for copy in self._copies.get(name, {}).values())
        }
        return Spared(self._stores, topics, self._stores.each(work_of, lambda work: work()))

    def _is_asked(self, copy: _Copy) -> bool:
        """Return whether the store with a copy answers, as far as is known."""
        return copy.store not in self._stores.missing

    def _read(self, topics: Topics, store: str, read: Read) -> dict[tuple[str, str], _Buckets]:
        """Return the buckets of a store by table and robot.

        Tables whose rows are all to be read here are left out.

        Args:
            topics: The topics that are read in each store.
        """
        catalog = self._stores.catalogs[store]
        buckets_of: dict[tuple[str, str], _Buckets] = {}
        for table in catalog.tables(list(topics[store])):
            copy = self._copies[store].get(table.name)
            if copy is None or not self._is_asked(copy) or table.named:
                continue
            if table.metadata.topic not in topics.get(copy.store, ()):
                continue
            ends = (slot_of(table.bucket_of(min(t, MAX_NS))) for t in read.time_range)
            nodes = read.whose.nodes
            slots = [
                (slot, node)
                for slot, node in catalog.keyspace.directory.nodes(table.name, *ends)
                if nodes is None or node in nodes
            ]
            if len(slots) <= BOOK_SLOTS:
                for slot, node in slots:
                    buckets = buckets_of.setdefault((table.name, node), _Buckets(copy))
                    self._compare(catalog, table.name, (slot, node), buckets)
        return buckets_of

    def _compare(
        self, catalog: Catalog, table: str, place: tuple[int, str], buckets: _Buckets
    ) -> None:
        """Add the buckets of a slot and robot of a table.

        Args:
            place: Slot and node; the other store has the same slots, or nothing is confirmed.
        """
        copy = buckets.copy
        rows = _entries_of(catalog, table, place)
        confirmed = _confirmed_beats(catalog, copy, table, place, rows)
        catalog_of = {copy.store: self._stores.catalogs[copy.store]} if confirmed else {}
        rows_of = self._stores.each(catalog_of, lambda c: _entries_of(c, copy.table, place))
        rows_there = [row for answer in rows_of.values() for row in answer]
        beats = {(row.bucket, row.writer): row.heartbeat for row in rows_there if row.closed}
        for row in rows:
            key = row.bucket, row.writer
            same = key in confirmed and beats.get(key) == confirmed[key]
            (buckets.there if same else buckets.here).add(row.bucket)
        # Rows of several writers may be in a bucket: it is read as a whole, or not at all.
        buckets.there -= buckets.here


class Spared:
    """The buckets that need not be read for one read; false if all are to be read.

    If a store of ``targets`` goes away, what it should have given is to be read in the others.

    Args:
        stores: The stores that are asked.
        topics: The topics that are read.
        buckets: Name of a store → its buckets by table and robot.
    """

    def __init__(
        self,
        stores: FleetAnswer,
        topics: Topics,
        buckets: Mapping[str, Mapping[tuple[str, str], _Buckets]],
    ) -> None:
        self._stores, self._topics = stores, topics
        self._buckets = {
            store: store_buckets
            for store, store_buckets in buckets.items()
            if any(table_buckets.there for table_buckets in store_buckets.values())
        }
        self.targets = {
            table_buckets.copy.store
            for store_buckets in self._buckets.values()
            for table_buckets in store_buckets.values()
        }
        """The stores that are read instead."""

    def __bool__(self) -> bool:
        return bool(self._buckets)

    def skip(self, store: str) -> Skip | None:
        """Return which buckets of a store are left out; None = none."""
        return partial(self._is_spared, store) if store in self._buckets else None

    def _is_spared(self, store: str, table: TopicTable, node: str, bucket: int) -> bool:
        """Return whether a bucket of a store need not be read, since another store gives it.

        Asked while rows are read: not any more if the other store is missing by then.
        """
        buckets = self._buckets.get(store, {}).get((table.name, node))
        return (
            buckets is not None
            and bucket in buckets.there
            and buckets.copy.store not in self._stores.missing
        )

    def copies(self, row: FleetRow) -> list[tuple[str, StoredRow]]:
        """Return the rows of a message in the stores that were not read for it, by their names."""
        writers = frozenset([writer_of(row.seq)])
        read = Read(TimeRange(row.t, row.t), Whose((row.node,), writers))

        def find(store: str) -> list[StoredRow]:
            catalog = self._stores.catalogs[store]
            rows = catalog.keyspace.rows.read(catalog.tables([row.topic]), read)
            return [stored_row for stored_row in rows if stored_row.seq == row.seq]

        sparing_stores = [name for name in self._buckets if row.topic in self._topics[name]]
        names = {name: name for name in sparing_stores if name not in row.stores}
        rows_of = self._stores.each(names, find)
        return [(name, stored_row) for name, rows in rows_of.items() for stored_row in rows]

    def shared(
        self, tables: Mapping[str, Sequence[TopicTable]], read: Read
    ) -> list[TimeRange] | None:
        """Return the time ranges of a read in which not only the first store has to be read.

        Args:
            tables: The tables of a topic in each store, the first of which has one.

        Returns:
            Ranges in order that begin and end with buckets of the first store; None = too many, or
            a store that should be read instead of another does not answer any more.
        """
        (first_table,), *_ = tables.values()
        length, (low, high) = first_table.bucket_ns, read.time_range
        others = {name: partial(self._busy, name, tables[name], read) for name in list(tables)[1:]}
        ranges_of = self._stores.each(others, lambda busy: list(busy()))
        if not self.targets.isdisjoint(self._stores.missing):
            return None
        merged: list[TimeRange] = []
        for begin, end in sorted(
            time_range for ranges in ranges_of.values() for time_range in ranges
        ):
            first, last = begin // length * length, (end // length + 1) * length - 1
            if merged and first <= merged[-1].high + 1:
                before = merged.pop()
                first, last = before.low, max(before.high, last)
            merged.append(TimeRange(max(low, first), min(high, last)))
        return merged if len(merged) <= MOST_RANGES else None

    def _busy(self, store: str, tables: Sequence[TopicTable], read: Read) -> Iterable[TimeRange]:
        """Yield the time ranges of the buckets that have to be read in a store, in no order."""
        catalog, nodes = self._stores.catalogs[store], read.whose.nodes
        for table in tables:
            length = table.bucket_ns
            first, last = (table.bucket_of(min(t, MAX_NS)) for t in read.time_range)
            slots = catalog.keyspace.directory.nodes(table.name, slot_of(first), slot_of(last))
            for slot, node in slots:
                if nodes is None or node in nodes:
                    for row in _entries_of(catalog, table.name, (slot, node)):
                        is_spared = self._is_spared(store, table, node, row.bucket)
                        if first <= row.bucket <= last and not is_spared:
                            yield TimeRange(row.bucket * length, (row.bucket + 1) * length - 1)


def _identity(catalog: Catalog) -> UUID | None:
    """Return the id by which books know the keyspace."""
    return target_id(catalog.keyspace.cassandra, catalog.keyspace.name)


def _entries(catalog: Catalog) -> list[CopiedTable]:
    """Return the tables with a copy in the books of a store; [] if the user may not read them."""
    try:
        entries = CopyBooks(catalog.keyspace.side_tables).tables()
    except AccessDenied as exc:
        _log.info("the books of copies are not used: %s", exc)
        return []
    return [entry for entry in entries if entry.there and not entry.gone]


def _may_replace(metadata: TopicMetadata | None, other: TopicMetadata | None) -> bool:
    """Return whether ``other`` may be read instead of a table: same topic, and its rows stay.

    None = there is no such table any more.
    """
    if metadata is None or other is None:
        return False
    return metadata.topic == other.topic and not other.ttl


def _entries_of(catalog: Catalog, table: str, place: tuple[int, str]) -> list[BucketRow]:
    """Return the entries of cr_bucket of a slot and robot; the books have its heartbeats."""
    slot, node = place
    first = slot * SLOT_BUCKETS
    entries = (table, node, slot, first, first + SLOT_BUCKETS - 1)
    requests = catalog.keyspace.directory.begin_buckets([entries])
    return [row for answer in requests for row in answer()]


def _confirmed_beats(
    catalog: Catalog, copy: _Copy, table: str, place: tuple[int, str], rows: Sequence[BucketRow]
) -> dict[tuple[int, int], datetime]:
    """Return the heartbeats there that the books noted, by bucket and writer.

    Only those of closed buckets that the books confirm; {} if the user may not read the books.

    Args:
        rows: What the directory here says now of the slot and robot.
    """
    books = CopyBooks(catalog.keyspace.side_tables)
    try:
        beats_there = books.beats(copy.target, table, *place)
        entries = books.buckets(copy.target, table, [place]) if beats_there else []
    except AccessDenied as exc:
        _log.info("the books of copies are not used: %s", exc)
        return {}
    book_of = {(book.bucket, book.writer): book for book in entries}
    return {
        key: beats_there[key]
        for row in rows
        if (key := (row.bucket, row.writer)) in beats_there
        and key in book_of
        and row.closed
        and book_of[key].confirms(row, [copy.table])
    }
