# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of topics: made under the schema lock, found by their comments, dropped for good.

While a new table is being filled to replace others, its comment names the tables that it replaces.
Everything follows from this comment: one change of it, from filling to filled, makes the new table
visible and the old tables invisible at once. So a client that reads the comments sees either the
old tables or the new one (``TableListing``).
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Callable, Collection, Iterable, Mapping, NamedTuple, Sequence, Tuple

from cassandra_ros.errors import CassandraRosError, SchemaConflict, TopicNotFound
from cassandra_ros.metadata import SHADOW, Kind, TopicMetadata, from_comment
from cassandra_ros.store.connection.cassandra import Cassandra, CqlRow, SchemaChange
from cassandra_ros.store.connection.cql_names import (
    chunk_table_name,
    qualified,
    quote_name,
    quote_text,
    table_name,
)
from cassandra_ros.store.tables.index_builds import IndexBuilds
from cassandra_ros.store.tables.row_table import RowTable
from cassandra_ros.store.tables.side_tables import SchemaLock, SideTables


class TableListing:
    """The topic tables of a keyspace, by their comments at one moment. Immutable.

    Attributes:
        every: Name → metadata of all tables.
        visible: Name → metadata of the tables that are read.
        heirs: Table that was replaced → the table that has its messages now.
        leaving: Table that is read → the table that is being filled to replace it.
        by_topic: Topic → names of its tables that are read, sorted.
    """

    def __init__(self, every: Mapping[str, TopicMetadata]) -> None:
        self.every = every
        # What a table that is being filled replaces is still read.
        filled = {name: m for name, m in every.items() if not m.filling}
        replaced = {old for m in filled.values() for old in m.replaces}
        self.visible = {name: m for name, m in filled.items() if name not in replaced}
        self.heirs = {old: name for name, m in self.visible.items() for old in m.replaces}
        self.leaving = {
            old: name
            for name, m in every.items()
            if m.filling
            for old in m.replaces
            if old in self.visible
        }
        self.by_topic: dict[str, list[str]] = {}
        for name, m in sorted(self.visible.items()):
            self.by_topic.setdefault(m.topic, []).append(name)

    def takes_rows(self, table: str) -> bool:
        """Return whether new messages may go into a table; not if it is being replaced."""
        return table not in self.leaving and table not in self.heirs

    def check_staying(self, table: str) -> None:
        """Raise SchemaConflict if a table was replaced or is being replaced."""
        heir = self.leaving.get(table) or self.heirs.get(table)
        if heir is None:
            return
        metadata = self.every[heir]
        if not metadata.filling:
            raise SchemaConflict(
                f"topic {metadata.topic} was converted to format {metadata.format} meanwhile; "
                "do it again"
            )
        raise SchemaConflict(
            f"topic {metadata.topic} is being converted to format {metadata.format}; do it again "
            f"when that has ended. If no client is at it any more, 'cassandra_bag convert "
            f"{metadata.topic} --format {metadata.format}' finishes it"
        )


_log = logging.getLogger(__name__)

CACHE_SEC = 2.0
"""Maximum age of the cached list of tables, s. Other clients add and drop tables."""
_FEW_TABLES = 64
"""Maximum number of changed comments that are read one by one; more are read with all others."""
_COMMENTS = "table_name, comment, writetime(comment)"
_COLUMNS = "column_name, type"
"""Columns of system_schema.tables and of system_schema.columns that are read."""
NEW_TABLE_BUILD_SEC = 2.0
"""How long messages of a new table wait until Cassandra begins to build its indexes, s."""

OWN_COLUMNS = {
    "_conn": "bigint",
    "_size": "int",
    "_nchunks": "int",
    "_crc": "bigint",
    "_odd": "boolean",
    "_raw": "blob",
}
"""Our own columns after the key that the tables of all formats have, name → CQL type."""
KEY_TYPES = {"_bucket": "bigint", "_key": "text"}
"""Type of the second part of the partition key: the bucket, or the name of a message."""
_WINDOWS = 25
"""Number of compaction windows in a TTL. The files of a window expire together."""
CHUNK_TTL_MARGIN_SEC = 86_400
"""How much longer than its row a chunk stays, s, because it is written before the row."""
_ROWS = "compression = {'class': 'LZ4Compressor', 'chunk_length_in_kb': 16}"
_PACKED = (  # compressed data stay as they are, with a checksum
    "compression = {'class': 'LZ4Compressor', 'chunk_length_in_kb': 64, 'min_compress_ratio': 1.1}"
)
_UNFINISHED = (
    "cassandra_ros makes the indexes of this table; one that stays like this was left by a "
    "client that died, is empty, and may be dropped"
)
"""Comment of a table whose indexes are being made: no listing has it, so nothing is written."""

TablePlan = Tuple[TopicMetadata, Mapping[str, str], Mapping[str, str]]
"""Metadata for a comment (``create`` chooses the generation), the columns of the format, and the
columns with an index, both name → CQL type."""
Planner = Callable[[Sequence[TopicMetadata]], TablePlan]
"""Plans a table, given the metadata of the tables that its topic has or that it replaces."""


class TableWish(NamedTuple):
    """A table for new messages that is looked for, and made if it is missing."""

    key: tuple[str, Kind, str]
    """Topic, kind and format."""
    plan: Planner
    """Called under the lock if the table must be made, with the metadata of the topic's other
    tables."""
    large: bool = False
    """Whether a table that is made gets its chunk table too."""


class _NewTable(NamedTuple):
    """A table that is about to be made, with its name."""

    name: str
    metadata: TopicMetadata
    columns: Mapping[str, str]
    """All columns, name → CQL type."""
    large: bool
    """Whether it gets its chunk table, too."""

    @property
    def shadows(self) -> Collection[str]:
        """Names of the columns with an index."""
        return self.metadata.indexes.values()

    def statement(self, keyspace: str) -> SchemaChange:
        """Return the statement that makes the table, without its indexes."""
        columns = ", ".join(f"{quote_name(c)} {cql}" for c, cql in self.columns.items())
        metadata, merged = self.metadata, not self.shadows
        # Without indexes the table can be listed and its files merged at once.
        comment = metadata.to_comment() if merged else _UNFINISHED
        return (
            f"CREATE TABLE {qualified(keyspace, self.name)} ({columns}, "
            f'PRIMARY KEY (("_node", "{metadata.partition}"), "_t", "_seq")) '
            f"WITH comment = {quote_text(comment)} AND {_storage(metadata.ttl, merged=merged)} "
            f"AND {_PACKED if metadata.packed else _ROWS}",
            f"making the table of topic {metadata.topic}",
        )


class Schema:
    """Topic tables of one keyspace. Thread-safe; the list of tables is cached until it changes.

    Args:
        kind_of: Returns the kind of a table's messages by its metadata.
    """

    def __init__(
        self,
        cassandra: Cassandra,
        side_tables: SideTables,
        kind_of: Callable[[TopicMetadata], Kind],
    ) -> None:
        self._cassandra = cassandra
        self._kind_of = kind_of
        self.keyspace = side_tables.keyspace
        self._side_tables = side_tables
        self._listing: TableListing | None = None
        self._parsed: dict[str, tuple[object, TopicMetadata | None]] = {}
        """Tables by name: when their comment was written, and what it says; None = no topic's."""
        self._read_at = 0.0
        """Monotonic time before the listing was read, s."""
        self._changes = cassandra.schema_changes.of(side_tables.keyspace)
        self._mark: object = None
        """Mark of the changes before the listing was read; another one = the listing is old."""
        self.seen: set[tuple[str, str]] = set()
        """(topic, format) of every table that was ever listed by this object."""
        self._mutex = threading.Lock()
        """Held while comments are read, so one thread reads them for all."""

    def lock(self) -> SchemaLock:
        """Make the side tables if they are missing and return the lock of the schema."""
        self._side_tables.make()
        return SchemaLock(self._cassandra, self.keyspace)

    def qualified(self, table: str) -> str:
        """Return the quoted name of a table with its keyspace."""
        return qualified(self.keyspace, table)

    def tables(self, *, fresh: bool = False) -> Mapping[str, TopicMetadata]:
        """Return the tables that are read, name → metadata; from comments at most 2 s old."""
        return self.listing(fresh=fresh).visible

    def listing(self, *, fresh: bool = False) -> TableListing:
        """Return all topic tables, also replaced ones, by comments at most 2 s old, or fresh."""
        with self._mutex:
            # Taken before the read: a change during it makes the listing old.
            now, mark = time.monotonic(), self._changes.mark
            old = mark is not self._mark or now - self._read_at > CACHE_SEC
            if self._listing is None or fresh or old:
                self._listing = TableListing(self._read())
                self._read_at, self._mark = now, mark
            return self._listing

    def latest(self, table: str, fallback: TopicMetadata) -> TopicMetadata:
        """Return the metadata of a table; ``fallback`` if they cannot be read now."""
        try:
            return self.tables().get(table, fallback)
        except CassandraRosError as exc:
            # Not a reason to lose a message: the directory says which indexes its row is in.
            _log.warning("topic %s keeps the indexes it had: %s", fallback.topic, exc)
            return fallback

    def takes_rows(self, table: str) -> bool:
        """Return whether new messages may go into a table; True if that cannot be read now."""
        try:
            return self.listing().takes_rows(table)
        except CassandraRosError as exc:
            _log.debug("table %s is written to as before: %s", table, exc)
            return True

    def format_after(self, table: str, format_name: str) -> str:
        """Return the format for further messages of a table: the new one if it is replaced."""
        listing = self.listing()
        heir = listing.leaving.get(table) or listing.heirs.get(table)
        return format_name if heir is None else listing.every[heir].format

    def _comments(self, table: str = "") -> list[CqlRow]:
        """Read name, comment and its time for all tables (''), or for one table, if it exists."""
        return self._cassandra.system_schema("tables", _COMMENTS, self.keyspace, table)

    def _read(self) -> dict[str, TopicMetadata]:
        """Read the comments of all topic tables; those that have not changed are not parsed again.

        The caller holds the mutex.
        """
        entries: dict[str, tuple[object, TopicMetadata | None]] = {}
        changed = []
        if self._parsed:
            names = "table_name, writetime(comment)"
            for name, time_us in self._cassandra.system_schema("tables", names, self.keyspace):
                entry = self._parsed.get(name)
                if entry is not None and entry[0] == time_us:
                    entries[name] = entry
                else:
                    changed.append(name)
        reads_all = len(changed) > _FEW_TABLES or not self._parsed
        for name, comment, time_us in self._comments() if reads_all else self._comments_of(changed):
            entries[name] = (time_us, from_comment(comment or "", f"{self.keyspace}.{name}"))
        self._parsed = entries
        return self._note({name: metadata for name, (_, metadata) in entries.items()})

    def _note(self, tables: Mapping[str, TopicMetadata | None]) -> dict[str, TopicMetadata]:
        """Return those that are topic tables, and note them as seen."""
        topic_tables = {name: metadata for name, metadata in tables.items() if metadata is not None}
        self.seen.update((m.topic, m.format) for m in topic_tables.values() if not m.filling)
        return topic_tables

    def _comments_of(self, tables: Sequence[str]) -> list[CqlRow]:
        """Read name, comment and its time for some tables, of those that exist."""
        rows = self._cassandra.system_schema_of("tables", _COMMENTS, self.keyspace, tables)
        return [row for answer in rows for row in answer]

    def tables_of(self, topic: str) -> dict[str, TopicMetadata]:
        """Return the tables of a topic that readers see, read anew; the caller holds the lock.

        Raises:
            TopicNotFound: The topic was removed.
            SchemaConflict: The topic is being converted.
        """
        listing = self.listing(fresh=True)
        tables = {name: m for name, m in listing.visible.items() if m.topic == topic}
        if not tables:
            raise TopicNotFound(f"topic {topic} is not stored in {self.keyspace} any more")
        for name in tables:
            listing.check_staying(name)
        return tables

    def ensure_tables(self, wishes: Sequence[TableWish]) -> list[str | None]:
        """Find the tables for new messages, or make those that are missing; return their names.

        All are made under one lock, with one reading of the comments before and one after. A name
        is None if the table was dropped as soon as it was made.

        Raises:
            SchemaConflict: The lock is not free, or ran out, or a table is not what was made.
        """
        listing = self.listing()
        if any(self._find(listing, wish) is None for wish in wishes):
            with self.lock() as lock:
                self._make_missing(wishes, lock)
                listing = self.listing()
        return [self._find(listing, wish) for wish in wishes]

    def _make_missing(self, wishes: Sequence[TableWish], lock: SchemaLock) -> None:
        """Make the tables that are missing, under the lock; one for all wishes that are alike."""
        listing = self.listing(fresh=True)
        tables: list[_NewTable] = []
        for wish in wishes:
            topic = wish.key[0]
            planned = [table.metadata for table in tables if table.metadata.topic == topic]
            is_planned = any(self._is_for(m, wish) for m in planned)
            if not is_planned and self._find(listing, wish) is None:
                present = [listing.visible[name] for name in listing.by_topic.get(topic, ())]
                tables.append(_new_table(*wish.plan([*present, *planned]), large=wish.large))
        self._make(tables, lock)
        self._check(tables)

    def _is_for(self, metadata: TopicMetadata, wish: TableWish) -> bool:
        """Return whether a table is one of the topic, kind and format of a wish."""
        topic, kind, format_name = wish.key
        alike = (metadata.topic, metadata.format) == (topic, format_name)
        return alike and self._kind_of(metadata) == kind

    def _find(self, listing: TableListing, wish: TableWish) -> str | None:
        """Return the table for new messages of a topic, kind and format; None = not in the listing.

        Of several it is the one that came from a conversion: a repeated import finds its rows
        there.
        """
        names = [
            name
            for name in listing.by_topic.get(wish.key[0], ())
            if name not in listing.leaving and self._is_for(listing.visible[name], wish)
        ]
        return max(names, key=lambda name: bool(listing.visible[name].replaces), default=None)

    def create(self, planned: TablePlan, lock: SchemaLock) -> str:
        """Make a table as planned, under the lock, and check it; return its name."""
        table = _new_table(*planned)
        self._make([table], lock)
        self._check([table])
        return table.name

    def _make(self, tables: Sequence[_NewTable], lock: SchemaLock) -> None:
        """Make tables with their indexes, and then their chunk tables."""
        lock.change_all([table.statement(self.keyspace) for table in tables])
        for table in tables:
            for shadow in table.shadows:
                lock.renew()
                self.create_sai_index(table.name, shadow)
            if table.shadows:
                self._finish(table.name, table.metadata, lock)
        lock.change_all(
            [_chunk_statement(self.keyspace, t.name, t.metadata) for t in tables if t.large]
        )

    def _finish(self, name: str, metadata: TopicMetadata, lock: SchemaLock) -> None:
        """List a table by its comment and let its files be merged, after its indexes were built."""
        merged, builds = True, self.index_builds(name, lock)
        try:
            builds.await_builds(
                {name + shadow for shadow in metadata.indexes.values()}, NEW_TABLE_BUILD_SEC
            )
        except CassandraRosError as exc:
            # Not a reason to lose the messages that wait for the table.
            merged = False
            _log.warning("topic %s: %s", metadata.topic, exc)
            builds.tell_paused()
        comment = quote_text(metadata.to_comment())
        lock.change(
            f"ALTER TABLE {self.qualified(name)} WITH comment = {comment} "
            f"AND {_storage(metadata.ttl, merged=merged)}",
            what=f"finishing the table of topic {metadata.topic}",
        )

    def index_builds(self, table: str, lock: SchemaLock) -> IndexBuilds:
        """Return the builds of a table's indexes on the nodes."""
        return IndexBuilds(self._cassandra, self.keyspace, table, lock)

    def create_sai_index(self, table: str, shadow: str) -> None:
        """Make the index on a shadow column if it is missing; under the lock."""
        self._cassandra.schema_change(
            f"CREATE INDEX IF NOT EXISTS {quote_name(table + shadow)} ON {self.qualified(table)} "
            f"({quote_name(shadow)}) USING 'sai'",
            what=f"making an index of table {table}",
        )

    def _check(self, tables: Sequence[_NewTable]) -> None:
        """Read new tables back; raises SchemaConflict if one is not what was made."""
        names = [table.name for table in tables]
        read = {
            name: (time_us, from_comment(comment or "", f"{self.keyspace}.{name}"))
            for name, comment, time_us in self._comments_of(names)
        }
        by_name = {name: metadata for name, (_, metadata) in read.items()}
        with self._mutex:
            self._parsed = {**self._parsed, **read}
            every = self._listing.every if self._listing else {}
            self._listing = TableListing({**every, **self._note(by_name)})
            # The lock excludes changes by other clients, so all that were pushed are our own.
            self._mark = self._changes.mark
        columns = self._cassandra.system_schema_of("columns", _COLUMNS, self.keyspace, names)
        for table, table_columns in zip(tables, columns):
            if dict(table_columns) != table.columns or by_name.get(table.name) != table.metadata:
                raise SchemaConflict(
                    f"table {self.keyspace}.{table.name} of topic {table.metadata.topic} is not "
                    "what was asked for (columns or comment differ): another client changed it at "
                    "the same time; remove the topic and try again"
                )

    def columns(self, table: str) -> dict[str, str]:
        """Return the columns of a table, name → CQL type."""
        return dict(self._cassandra.system_schema("columns", _COLUMNS, self.keyspace, table))

    def ensure_chunk_table(self, table: RowTable) -> None:
        """Make the chunk table for a topic's large messages if it is missing, under the lock.

        Raises:
            TopicNotFound: The table was dropped.
        """
        if not table.has_chunks and not self._comments(chunk_table_name(table.name)):
            with self.lock() as lock:
                self._make_chunk_table(table.name, table.metadata, lock)
        table.note_chunks()

    def _make_chunk_table(self, table: str, metadata: TopicMetadata, lock: SchemaLock) -> None:
        """Make a chunk table, unless another client was first."""
        if not self._comments(table):
            raise TopicNotFound(
                f"table {table} was removed by another client; messages of its topic need "
                "a new one: connect again"
            )
        if not self._comments(chunk_table_name(table)):
            lock.change_all([_chunk_statement(self.keyspace, table, metadata)])

    def change_topic(
        self,
        topic: str,
        change: Callable[[TopicMetadata], TopicMetadata],
        check: Callable[[Mapping[str, TopicMetadata]], None] = lambda tables: None,
    ) -> None:
        """Change the comments of a topic's tables, also of those that are replaced or being filled.

        Args:
            change: Returns the new metadata of a table.
            check: Called under the lock before any change, with all tables of the keyspace that
                are read; may raise.

        Raises:
            TopicNotFound: The topic was removed.
        """
        with self.lock() as lock:
            every = self.listing(fresh=True).every
            if not any(metadata.topic == topic for metadata in self.tables().values()):
                raise TopicNotFound(f"topic {topic} is not stored in {self.keyspace} any more")
            check(self.tables())
            for name, metadata in every.items():
                if metadata.topic == topic:
                    self.set_comment(name, change(metadata), lock)
        self.tables(fresh=True)

    def set_comment(self, table: str, metadata: TopicMetadata, lock: SchemaLock) -> None:
        """Write metadata into the comment of a table."""
        comment = quote_text(metadata.to_comment())
        lock.change(
            f"ALTER TABLE {self.qualified(table)} WITH comment = {comment}",
            what=f"changing the metadata of topic {metadata.topic}",
        )

    def drop_topic(self, topic: str, *, renew: bool = False) -> list[str]:
        """Drop all tables of a topic; return their names and those of tables that they replaced.

        Args:
            renew: Make empty tables in their place, before they are dropped: one for each kind and
                format, with the indexes that the old one has.
        """
        with self.lock() as lock:
            listing = self.listing(fresh=True)
            tables = {name: m for name, m in listing.every.items() if m.topic == topic}
            if renew:
                # With new names, so that a writer with an old listing cannot write into them.
                one_each = {
                    (self._kind_of(m), m.format): (name, m.with_(replaces=(), cut=False))
                    for name, m in tables.items()
                    if name in listing.visible
                }
                for name, metadata in one_each.values():
                    columns, shadows = self.columns(name), metadata.indexes.values()
                    for shadow in [c for c in columns if c.startswith(SHADOW) and c not in shadows]:
                        del columns[shadow]
                    self._make([_new_table(metadata, columns)], lock)
            self.drop(tables, lock)
        self.tables(fresh=True)
        return [*tables, *{old for m in tables.values() for old in m.replaces}.difference(tables)]

    def drop(self, tables: Iterable[str], lock: SchemaLock) -> None:
        """Drop some tables with their chunk tables, under the lock.

        The chunk table goes first: it is found by the name of the other one.
        """
        for table in tables:
            for name in (chunk_table_name(table), table):
                # Only the maker of a table may drop it, and a missing one has no maker.
                if self._comments(name):
                    lock.change(
                        f"DROP TABLE IF EXISTS {self.qualified(name)}",
                        what=f"dropping table {name}",
                    )
            self._cassandra.forget(table)


def _new_table(
    metadata: TopicMetadata,
    columns: Mapping[str, str],
    shadows: Mapping[str, str] | None = None,
    large: bool = False,
) -> _NewTable:
    """Return a table with a name that no other table has had.

    Args:
        columns: Columns of the format; all columns if ``shadows`` is None.
        shadows: Columns with an index, name → CQL type.
    """
    if shadows is not None:
        columns = {**_own_columns(metadata), **columns, **shadows}
    final = metadata.with_(generation=time.time_ns())
    name = table_name(final.topic, final.md5sum, final.format, final.generation)
    return _NewTable(name, final, dict(columns), large)


def _chunk_statement(keyspace: str, table: str, metadata: TopicMetadata) -> SchemaChange:
    """Return the statement that makes the table for the large messages of a topic's table."""
    name, partition = chunk_table_name(table), metadata.partition
    return (
        f'CREATE TABLE {qualified(keyspace, name)} ("_node" text, "{partition}" '
        f'{KEY_TYPES[partition]}, "_t" bigint, "_seq" bigint, "_chunk" int, "_data" blob, '
        f'PRIMARY KEY (("_node", "{partition}", "_t", "_seq"), "_chunk")) '
        f"WITH comment = {quote_text(f'cassandra_ros chunks of {table}')} "
        f"AND {_storage(metadata.ttl, CHUNK_TTL_MARGIN_SEC)} "
        # A second request for a slow chunk would send the same large bytes twice.
        f"AND {_PACKED} AND speculative_retry = 'NEVER'",
        f"making the table for large messages {name}",
    )


def _storage(ttl: int, margin: int = 0, *, merged: bool = True) -> str:
    """Return the options of a table as CQL.

    Args:
        ttl: How long its rows stay, s; 0 = for ever.
        margin: How much longer than ``ttl`` they stay, s.
        merged: Whether Cassandra merges the table's files; not while its indexes are made.
    """
    enabled = "" if merged else ", 'enabled': 'false'"
    if not ttl:
        return (
            "compaction = {'class': 'UnifiedCompactionStrategy', 'scaling_parameters': 'T4'"
            f"{enabled}}} AND default_time_to_live = 0"
        )
    minutes = max(1, ttl // _WINDOWS // 60)
    return (
        "compaction = {'class': 'TimeWindowCompactionStrategy', "
        f"'compaction_window_unit': 'MINUTES', 'compaction_window_size': {minutes}{enabled}}} "
        f"AND default_time_to_live = {ttl + margin} AND gc_grace_seconds = 10800"
    )


def _own_columns(metadata: TopicMetadata) -> dict[str, str]:
    """Return the columns that a topic's table has in every format: name → CQL type."""
    partition = metadata.partition
    return {
        **{"_node": "text", partition: KEY_TYPES[partition], "_t": "bigint", "_seq": "bigint"},
        **OWN_COLUMNS,
        **metadata.received_columns,
    }
