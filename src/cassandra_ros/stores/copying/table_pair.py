# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A table of ours and the table of another store that takes its rows: found, checked, or made."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Iterator, Sequence

from cassandra_ros.arguments import spellings
from cassandra_ros.errors import SchemaConflict
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import Read
from cassandra_ros.store.rows.verbatim import StoredColumns, shared_columns
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.new_tables import check_packed
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable, stored_format, type_texts
from cassandra_ros.topics.upkeep.conversion import block_span


@dataclass
class TablePair:
    """A table here and its counterpart there.

    Attributes:
        columns: Columns that go as they are stored; None = each message is decoded and encoded.
    """

    here: Keyspace
    there: Keyspace
    source: TopicTable
    target: TopicTable
    columns: StoredColumns | None
    _connections: set[int] = field(default_factory=set, repr=False)
    """Numbers of the connections that were written there."""
    _mutex: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def topic(self) -> str:
        """Name of the topic, here and there."""
        return self.source.metadata.topic

    @property
    def names(self) -> set[str]:
        """Names of the table there, and of the tables that it has replaced."""
        return {self.target.name, *self.target.metadata.replaces}

    def connect(self, conn: int) -> None:
        """Write a connection header with its definition there, before rows that refer to it.

        Thread-safe: two threads may write the same header, and both return when it is there.
        """
        with self._mutex:
            if conn in self._connections:
                return
        header = self.here.registry.get_header(self.source.name, conn)
        if header is not None:
            self.there.registry.put_headers([(self.target.name, conn, header)])
        with self._mutex:
            self._connections.add(conn)

    def rows_there(self, read: Read) -> Iterator[StoredRow]:
        """Yield the rows that the table there has of a read, without columns."""
        keys_read = Read(read.time_range, read.whose, columns=lambda table: ())
        return self.there.rows.read([self.target], keys_read)

    def filled(self, shadows: frozenset[str]) -> frozenset[str]:
        """Return the index columns there that have values if those here have them.

        Args:
            shadows: Index columns here that have values.
        """
        if self.columns is None:
            return frozenset()
        here, there = self.source.metadata.indexes, self.target.metadata.indexes
        return frozenset(there[f] for f in self.columns.fields if here[f] in shadows)


def find_pair(
    here: Keyspace,
    there: Keyspace,
    source: TopicTable,
    format: str | None,
    name_before: str,
    *,
    thinned: bool,
) -> TablePair:
    """Find the table there that takes the rows of a table, or make it.

    Args:
        format: Format there; None = as the topic is stored there, or else as here.
        name_before: Name of the table there that took rows before, by the books; '' = none did.
        thinned: Whether a rule leaves out some messages, so that blocks are made anew.

    Raises:
        SchemaConflict: There is another topic, type, key or lifetime under this name; the topic is
            kept in another format there; or the table there is being converted.
        DefinitionError: The messages cannot be stored in this format.
        UnknownFormat: There is no such format.
    """
    metadata = source.metadata
    tables = _tables_there(there, metadata)
    _check_renamed(there, metadata, name_before)
    for table in tables:
        _check_alike(metadata, table.metadata)
    candidates = _of_kind(here, source, tables)
    if tables and not candidates and not _has_kinds(here, metadata.topic, tables):
        ours, theirs = type_texts(metadata, tables[0].metadata)
        raise _refusal(metadata, f"type {ours}", theirs)
    # There may be a table of another format there, too: what is in one must not go to the other.
    took = there.schema.listing().heirs.get(name_before, name_before)
    took_before = [t for t in tables if t.name == took and t.kind.fits(source.kind)]
    candidates = took_before or candidates
    if format is not None and all(table.definition is None for table in candidates or [source]):
        format = FALLBACK_FORMAT
    name = _format_there(metadata, [table.metadata for table in candidates], format)
    # Before a table is made there, and again with that table.
    _check_lifetime(metadata, name, alike=name == metadata.format and not thinned)
    target = next((table for table in candidates if table.metadata.format == name), None)
    if target is None:
        target = _make(here, there, source, name)
    else:
        there.schema.listing().check_staying(target.name)
    columns = shared_columns(source, target)
    _check_lifetime(target.metadata, name, alike=columns is not None and not thinned)
    lengths = [(t.bucket_ns, t.metadata.span_ns) for t in (source, target)]
    differ = columns is None or thinned or source.metadata.cut or bool(source.metadata.replaces)
    differ = differ or lengths[0] != lengths[1]
    if differ and target.metadata.noting_cut() != target.metadata:
        # An import of the same bag there must know that blocks begin at other messages.
        there.schema.change_topic(metadata.topic, TopicMetadata.noting_cut)
    return TablePair(here, there, source, target, columns)


def find_existing(here: Keyspace, there: Keyspace, source: TopicTable) -> TablePair | None:
    """Return a table with its counterpart there; None = it has none yet. No table is made.

    Raises:
        SchemaConflict: There is another topic, type or key under this name.
    """
    metadata = source.metadata
    tables = _tables_there(there, metadata)
    for table in tables:
        _check_alike(metadata, table.metadata)
    candidates = _of_kind(here, source, tables)
    if not candidates:
        return None
    name = _format_there(metadata, [table.metadata for table in candidates], None)
    target = next(table for table in candidates if table.metadata.format == name)
    return TablePair(here, there, source, target, shared_columns(source, target))


def _check_lifetime(metadata: TopicMetadata, format_name: str, *, alike: bool) -> None:
    """Raise SchemaConflict if rows would get a new lifetime, because they are encoded anew.

    Args:
        format_name: Format of the rows there.
        alike: Whether the rows go as they are stored, with what is left of their lifetime.
    """
    if metadata.ttl and not alike:
        raise SchemaConflict(
            f"topic {metadata.topic} is not copied: its messages expire (ttl {metadata.ttl} s), "
            f"and in format {format_name} there they would stay longer; copy it in its own format "
            f"{metadata.format}"
        )


def _tables_there(there: Keyspace, metadata: TopicMetadata) -> Sequence[TopicTable]:
    """Return the tables of the topic there; raises SchemaConflict for another spelling of it."""
    listing = there.schema.listing()
    for name in spellings(metadata.topic):
        if name != metadata.topic and name in listing.by_topic:
            raise _refusal(metadata, f"name {metadata.topic}", name)
    return there.tables.of_topic(metadata.topic)


def _check_renamed(there: Keyspace, metadata: TopicMetadata, name_before: str) -> None:
    """Raise SchemaConflict if the table that took the rows before has another topic now."""
    listing = there.schema.listing()
    name = listing.heirs.get(name_before, name_before)
    other = listing.visible.get(name)
    if other is not None and other.topic != metadata.topic:
        raise _refusal(
            metadata, f"name {metadata.topic}", f"{other.topic}, since it was renamed at one side"
        )


def _check_alike(here: TopicMetadata, other: TopicMetadata) -> None:
    """Raise SchemaConflict if the keys or lifetimes of messages differ."""
    keys = [f"{m.key_format} {m.key_part}".rstrip() for m in (here, other)]
    if keys[0] != keys[1]:
        raise _refusal(here, f"key format {keys[0]}", keys[1])
    if other.ttl and here.ttl != other.ttl:
        raise _refusal(here, f"ttl {here.ttl} s", f"{other.ttl} s")


def _refusal(metadata: TopicMetadata, ours: str, theirs: str) -> SchemaConflict:
    return SchemaConflict(
        f"topic {metadata.topic} is not copied: it has {ours} here, and {theirs} there; rename or "
        "remove it at one side"
    )


def _of_kind(
    here: Keyspace, source: TopicTable, tables: Sequence[TopicTable]
) -> Sequence[TopicTable]:
    """Return the tables there for the messages of a table.

    They have its kind. Otherwise the definition may be unusable at one side only: then
    they are those of its md5, without the counterparts of other tables of the topic here.
    """
    alike = [table for table in tables if table.kind == source.kind]
    kinds = {table.kind for table in here.tables.of_topic(source.metadata.topic)}
    return alike or [t for t in tables if t.kind.fits(source.kind) and t.kind not in kinds]


def _has_kinds(here: Keyspace, topic: str, tables: Sequence[TopicTable]) -> bool:
    """Return whether one of the types there may be one that the topic has here, too."""
    kinds = {table.kind for table in here.tables.of_topic(topic)}
    return any(table.kind.fits(kind) for table in tables for kind in kinds)


def _format_there(
    metadata: TopicMetadata, tables: Sequence[TopicMetadata], format: str | None
) -> str:
    """Return the format for the rows there, in which a topic is kept that is there already.

    A second table of another format would hold messages that are in the first one, too.

    Args:
        tables: Metadata of the tables there that may take the rows, if any.
        format: Format that was asked for; None = none was.

    Raises:
        SchemaConflict: The topic is kept in another format there.
        UnknownFormat: There is no such format.
    """
    formats = {other.format for other in tables}
    if format is not None:
        format_class(format)  # raises UnknownFormat
        if formats and format not in formats:
            raise SchemaConflict(
                f"topic {metadata.topic} is not copied: format {format} was asked for, and it is "
                f"kept in format {', '.join(sorted(formats))} there; 'cassandra_bag convert' "
                "changes that there"
            )
        return format
    if not formats or metadata.format in formats:
        return metadata.format
    return stored_format(tables, metadata.md5sum)


def _make(here: Keyspace, there: Keyspace, source: TopicTable, format_name: str) -> TopicTable:
    """Make the table there; raises DefinitionError if the format cannot hold the messages."""
    metadata = source.metadata
    fmt = format_class(format_name)
    if fmt.PACKED:
        check_packed(metadata, source.definition)
    same_format = format_name == metadata.format
    if not same_format and format_name != FALLBACK_FORMAT:
        fmt(metadata.msg_type, metadata.md5sum, source.definition).require_class()
    span_ns = metadata.span_ns
    if fmt.PACKED and not same_format:
        connections = len(list(here.registry.headers([source.name])))
        span_ns = block_span(here, [source], connections)
    metadata_there = metadata.with_(format=format_name, span_ns=span_ns)
    return there.new_tables.make(metadata_there, source.definition)
