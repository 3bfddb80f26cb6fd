# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class TopicTable: a topic table with the definition, format and indexes of its messages."""

from __future__ import annotations

import hashlib
import logging
import threading
from functools import lru_cache, partial
from itertools import repeat
from typing import Any, Callable, Iterable, List, Mapping, Optional, Sequence, Tuple, TypeVar

from cassandra_ros.errors import CorruptMessage, DefinitionError, InvalidName, InvalidQuery
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.classes import message_class, raw_class
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.definition import Definition, read_definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.metadata import Kind, TopicMetadata, message_kind, type_text
from cassandra_ros.query.protocols import Places as RobotPlaces
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.row_table import Indexed, NewRow, RowTable, Shadows, encode_long
from cassandra_ros.store.tables.schema import Schema, TableListing
from cassandra_ros.topics.event_finder import Events
from cassandra_ros.topics.run_finder import Runs
from cassandra_ros.topics.stored_headers import ConnectionCache

_log = logging.getLogger(__name__)
_T = TypeVar("_T")

MAX_CLASSES = 1024
"""Maximum number of connections of a table with a cached message class. Anonymous publishers come
without end."""
MAX_LATER_BYTES = 64 * 1024
"""Size in bytes above which the columns of a message are made with its row. Those of a smaller one
are made when its batch is sent, for many messages together, which is faster."""


_new_row = partial(tuple.__new__, NewRow)  # faster than NewRow._make, which is written in Python


class TopicTable(RowTable):
    """A table with messages of one topic, one kind and one format."""

    def __init__(
        self,
        cassandra: Cassandra,
        keyspace: str,
        name: str,
        metadata: TopicMetadata,
        connections: ConnectionCache,
        runs: Runs,
        heir: Callable[[str, bool], TopicTable | None],
        robots: Callable[[], RobotPlaces],
        events: Events,
    ) -> None:
        self.definition = definition = definition_in(metadata)
        """Checked definition; None = the stored one is not usable, and rows are bytes then."""
        self.kind = _kind(metadata, definition)
        """Kind of its messages."""
        self.format: CassandraTopic_ = format_class(metadata.format)(
            metadata.msg_type, metadata.md5sum, definition
        )
        self.zone_map = self.format.zone_map
        """Zone columns of the table's blocks; None = a row is a message, or has no zones."""
        # Neither of the two is noted of a type that lacks the key field, or whose definition was
        # unusable when the table was made: then rows are found by receive time.
        has_field = metadata.own_time or metadata.key_part in metadata.indexes
        key_definition = definition if has_field and metadata.key_format == "msg_part" else None
        self.key_part = (
            None if key_definition is None else KeyPart(key_definition, metadata.key_part)
        )
        """The key field; None = the key is not a field."""
        timed = self.key_part is None or self.key_part.is_time
        self.value_part = None if timed else self.key_part
        """The key field by whose value rows are found; None = there is no such field."""
        key_part = self.value_part
        self.digest = key_part if key_part is not None and key_part.digest else None
        """The key field whose index holds the md5 of a whole array; None = there is no such
        field."""
        self._index_columns = IndexColumns(metadata.topic, definition, self.digest)
        super().__init__(cassandra, keyspace, name, metadata, self.format, self._index_columns)
        self.msg_type = metadata.msg_type
        self.by_field = self.format.BY_FIELD
        self.connections = connections
        self.runs = runs
        self.events = events
        self._heir = heir
        self._robots = robots
        self.message_class: Callable[[int], Any] = lru_cache(MAX_CLASSES)(self._message_class)
        """Return the class for a connection, by its number: installed, generated or RawMessage.

        Raises CorruptMessage if the connection is missing."""
        self._is_encoded_later = metadata.key_format == "time" and self.format.TOGETHER
        """Whether columns of messages up to MAX_LATER_BYTES are made when their batch is sent."""

    def __repr__(self) -> str:
        return f"<TopicTable {self.name} of {self.metadata.topic}: {self.msg_type}>"

    def heir(self, fresh: bool) -> TopicTable | None:
        """Return the table that has replaced this one; None if it was not replaced.

        Args:
            fresh: Read the comments now; otherwise they are up to 2 s old.
        """
        return self._heir(self.name, fresh)

    @property
    def places(self) -> RobotPlaces:
        """Lookup of the robots' places in the keyspace."""
        return self._robots()

    @property
    def index_fields(self) -> dict[str, IndexField]:
        """Indexes that conditions can use, by field, as the comment lists them now."""
        return self._index_columns.fields(self.metadata.indexes)

    def connection(self, conn: int) -> Connection:
        """Return a connection by its number; raises CorruptMessage if it is missing."""
        try:
            return self.connections.get(self.name, conn)
        except CorruptMessage:
            heir = self.heir(True)  # the headers are deleted with a replaced table
            if heir is None:
                raise
            return heir.connection(conn)

    def _message_class(self, conn: int) -> Any:
        definition, md5sum = self.definition, self.metadata.md5sum
        connection = self.connection(conn)
        if definition is None:
            return raw_class(connection.type, md5sum)
        try:
            text = connection.definition_text
            if connection.type != definition.type or (text and text != definition.text):
                # The same md5 under another name, as tf/tfMessage and tf2_msgs/TFMessage, or with
                # another text.
                definition = read_definition(connection.type, text, md5sum)
            return message_class(definition)
        except DefinitionError as exc:
            topic = self.metadata.topic
            _log.debug("messages of topic %s are given back as bytes: %s", topic, exc)
            return raw_class(connection.type, md5sum)

    def make_row(self, received: int, seq: int, conn: int, wire: bytes, name: str = "") -> NewRow:
        """Return the row of a message: its columns, and its key by the topic's key format.

        The columns are None if they are made later. Otherwise those of the receive time follow
        those of the format, in the order of ``TopicMetadata.received_columns``.

        Args:
            received: Receive time, ns.
            name: Name of the message, for key format ``manual``; '' = the topic's name.
        """
        metadata = self.metadata
        if self._is_encoded_later and len(wire) <= MAX_LATER_BYTES:
            return NewRow(received, seq, conn, wire, None)
        columns, odd, raw = self.format.encode_wire(wire)
        if metadata.key_format == "time":
            return NewRow(received, seq, conn, wire, columns, odd, raw)
        if metadata.key_format == "manual":
            return NewRow(received, seq, conn, wire, columns, odd, raw, name or metadata.topic)
        if metadata.key_format == "hash":
            columns = (*columns, encode_long(received), encode_long(seq))
            digest = hashlib.md5(metadata.msg_type.encode("utf-8") + b"\0" + wire).hexdigest()
            return NewRow(0, 0, conn, wire, columns, odd, raw, digest)
        if self.key_part is None or self.value_part is not None:
            return NewRow(received, seq, conn, wire, columns, odd, raw)
        if not self.packed:  # blocks hold the receive time themselves
            columns = (*columns, encode_long(received))
        return NewRow(self.key_time(received, wire), seq, conn, wire, columns, odd, raw)

    def make_rows(
        self, times: Sequence[int], seqs: Sequence[int], conn: int, wires: Sequence[bytes]
    ) -> list[NewRow]:
        """Return rows of one or more messages; empty if some columns must be made now.

        Columns of these rows are made later, so the receive times are the key times.
        """
        if not self._is_encoded_later or max(map(len, wires)) > MAX_LATER_BYTES:
            return []
        columns = raws = repeat(None)
        odds, names = repeat(False), repeat("")
        fields = zip(times, seqs, repeat(conn), wires, columns, odds, raws, names)
        return list(map(_new_row, fields))

    def key_time(self, received: int, wire: bytes) -> int:
        """Return the key time of a message, ns: its key field, or else its receive time."""
        t = None if self.key_part is None else self.key_part.time(wire)
        # A message without a valid time has its receive time; nsecs may exceed the maximum time.
        return received if t is None else min(t, MAX_NS)


class TableSet(List[TopicTable]):
    """The tables of one topic, the oldest first: one for each kind and format.

    It is the state of one listing and does not change; ``renewed`` returns the present set. A read
    renews the set it is given, so it includes tables that were made before it began. A plain list
    of tables stands for these tables alone.

    Args:
        tables: The tables.
        listing: The listing in which they were found.
        renew: Returns the present set for this one and ``fresh``.
    """

    def __init__(
        self,
        tables: Iterable[TopicTable],
        listing: TableListing,
        renew: Callable[[TableSet, bool], TableSet],
    ) -> None:
        super().__init__(tables)
        self.listing = listing
        self._renew = renew

    def renewed(self, *, fresh: bool) -> TableSet:
        """Return the present tables of the topic, with replaced ones exchanged.

        Args:
            fresh: Ask the server; otherwise a listing that this client has may be used.
        """
        return self._renew(self, fresh)


class TopicTables:
    """The topic tables of a keyspace as objects, one for each. Thread-safe.

    Args:
        robots: Returns the lookup of the robots' places in the keyspace.
    """

    def __init__(
        self,
        cassandra: Cassandra,
        schema: Schema,
        connections: ConnectionCache,
        runs: Runs,
        robots: Callable[[], RobotPlaces],
        events: Events,
    ) -> None:
        self._cassandra = cassandra
        self._schema = schema
        self._connections = connections
        self._runs = runs
        self._robots = robots
        self._events = events
        self._tables: dict[str, TopicTable] = {}
        self._mutex = threading.Lock()

    def get(self, name: str, metadata: TopicMetadata) -> TopicTable:
        """Return the one object of a table; it takes over ``metadata``, from the latest listing."""
        with self._mutex:
            table = self._tables.get(name)
            if table is None:
                table = self._tables[name] = TopicTable(
                    self._cassandra,
                    self._schema.keyspace,
                    name,
                    metadata,
                    self._connections,
                    self._runs,
                    self._heir,
                    self._robots,
                    self._events,
                )
            elif table.metadata is not metadata:
                table.follow(metadata)
            return table

    def by_name(self, name: str) -> TopicTable | None:
        """Return a table by its name; None if there is no table with this name now."""
        metadata = self._schema.tables().get(name)
        return None if metadata is None else self.get(name, metadata)

    def _heir(self, name: str, fresh: bool) -> TopicTable | None:
        listing = self._schema.listing(fresh=fresh)
        heir = listing.heirs.get(name)
        return None if heir is None else self.get(heir, listing.visible[heir])

    def holding(self, name: str) -> TopicTable | None:
        """Return the table that has the messages of a table with this name.

        None if it was dropped.
        """
        listing = self._schema.listing()
        if name not in listing.every and name not in listing.heirs:
            self._schema.tables(fresh=True)  # another client may have made it just now
        return self.by_name(name) or self._heir(name, False)

    def naming(self, make: Callable[[], _T]) -> _T:
        """Call ``make``; call it again if a field is unknown and the tables have changed.

        Raises:
            InvalidQuery: No table has the field now.
        """
        listing = self._schema.listing()
        try:
            return make()
        except InvalidQuery:
            if self._schema.listing(fresh=True).visible == listing.visible:
                raise
            return make()

    def of_topic(self, topic: str, *, fresh: bool = False) -> TableSet:
        """Return the tables of a topic, the oldest first: one for each kind and format."""
        return self._table_set(topic, self._schema.listing(fresh=fresh))

    def _table_set(self, topic: str, listing: TableListing, more: Iterable[str] = ()) -> TableSet:
        """Return the tables of a topic in a listing, and ``more``, by their names."""
        names = dict.fromkeys([*listing.by_topic.get(topic, ()), *more])
        tables = [self.get(name, listing.visible[name]) for name in names]
        # Names of columns depend on the order: a later definition must not change them.
        tables.sort(key=lambda table: (table.metadata.date, table.name))
        return TableSet(tables, listing, partial(self._renew, topic))

    def _renew(self, topic: str, old: TableSet, fresh: bool) -> TableSet:
        """Return the present set for an old one; the old one itself if no table is left."""
        # The server tells of a new table before it answers a read that began later. For an empty
        # set there is no such read, so the server is asked.
        listing = self._schema.listing(fresh=fresh or not old)
        if listing is old.listing:
            return old
        # By their names, because a topic that was renamed keeps its tables.
        heirs = (listing.heirs.get(table.name, table.name) for table in old)
        present = self._table_set(
            topic, listing, [name for name in heirs if name in listing.visible]
        )
        return present or old


def definition_in(metadata: TopicMetadata) -> Definition | None:
    """Return the definition in a comment; None if it is unusable."""
    try:
        return read_definition(metadata.msg_type, metadata.definition, metadata.md5sum)
    except DefinitionError as exc:
        _log.debug("topic %s has no usable definition: %s", metadata.topic, exc)
        return None


def kind_of(metadata: TopicMetadata) -> Kind:
    """Return the kind of a table's messages."""
    return _kind(metadata, definition_in(metadata))


def _kind(metadata: TopicMetadata, definition: Definition | None) -> Kind:
    arrays = None if definition is None else definition.arrays
    return message_kind(metadata.md5sum, metadata.msg_type, arrays)


def type_texts(one: TopicMetadata, other: TopicMetadata) -> tuple[str, str]:
    """Return the types of two tables as texts for the user, see ``type_text``."""
    ours, theirs = kind_of(one), kind_of(other)
    return type_text(one.msg_type, ours, theirs), type_text(other.msg_type, theirs, ours)


def stored_format(tables: Sequence[TopicMetadata], md5sum: str = "") -> str:
    """Return the format of the table that was made last, for this md5 if there is one.

    Args:
        tables: Metadata of the tables of one topic, at least one.
    """
    # One publisher without a usable definition must not decide for all other publishers.
    usable = [m for m in tables if m.format != FALLBACK_FORMAT or definition_in(m)] or tables
    return max(usable, key=lambda m: (m.md5sum == md5sum, m.date, m.format)).format


_Value = Callable[[bytes], Tuple[Optional[bytes], bool]]
"""Returns the value of a serialised message in an index (None = unset), and whether it is odd."""


class IndexColumns:
    """Makes the index columns of one topic table.

    Args:
        topic: Name of the topic, for the log.
        definition: Definition of its messages; None = it is unusable.
        digest: The key field whose index holds the md5 of a whole array; None = no such field.
    """

    def __init__(self, topic: str, definition: Definition | None, digest: KeyPart | None) -> None:
        self._topic = topic
        self._definition = definition
        self._digest = digest
        self._cached: tuple[Mapping[str, str], dict[str, IndexField]] = ({}, {})
        """Indexes that ``fields`` got last, and its answer; one object, because threads share
        it."""

    def fields(self, indexes: Mapping[str, str]) -> dict[str, IndexField]:
        """Return the indexes that conditions can use, by field.

        Args:
            indexes: Indexed field → shadow column, as the table's comment says.
        """
        old_indexes, fields = self._cached
        if self._definition is not None and old_indexes != indexes:
            fields = {}
            for field, shadow in indexes.items():
                if self._digest is not None and self._digest.field == field:
                    continue  # an index of whole arrays, not of their elements
                try:
                    fields[field] = IndexField(self._definition, field, shadow)
                except InvalidName as exc:
                    _log.warning("an index of topic %s is not used: %s", self._topic, exc)
            self._cached = indexes, fields
        return fields

    def shadows(self, indexes: Mapping[str, str]) -> Shadows | None:
        """Return the columns of these indexes, with that of the digest; None if no one is left."""
        values: dict[str, _Value] = {i.shadow: i.value for i in self.fields(indexes).values()}
        if self._digest is not None:
            values[indexes[self._digest.field]] = partial(_digest_of, self._digest)
        if not values:
            return None
        encoders = tuple(values.values())

        def values_of(wire: bytes) -> Indexed:
            encoded: list[bytes | None] = []
            odd = False
            for encode in encoders:
                value, is_odd = encode(wire)
                encoded.append(value)
                odd = odd or is_odd
            return encoded, odd

        return Shadows(tuple(values), values_of)


def _digest_of(key_part: KeyPart, wire: bytes) -> tuple[bytes | None, bool]:
    """Return the md5 of the key field of a message, as a _Value does."""
    value = key_part.value(wire)
    return (None, True) if value is None else (key_part.index(value), False)
