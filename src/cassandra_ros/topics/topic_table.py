# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic table with its ROS side: the definition and the format that its columns follow."""

from __future__ import annotations

import hashlib
import logging
import threading
from functools import partial
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

from cassandra_ros.errors import DefinitionError, InvalidName
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.formats.table import format_class
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.definition import Definition, parse_definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.row_table import Indexed, NewRow, RowTable, Shadows, encode_long
from cassandra_ros.store.schema import Schema

_log = logging.getLogger(__name__)

_Value = Callable[[bytes], Tuple[Optional[bytes], bool]]
"""From a serialised message to its value in an index, None = unset, and whether it is odd."""


class TopicTable(RowTable):
    """Rows of one topic, one md5 and one format."""

    def __init__(
        self,
        cassandra: Cassandra,
        keyspace: str,
        name: str,
        metadata: TopicMetadata,
        definition: Optional[Definition],
    ) -> None:
        self.definition = definition
        """None where the stored definition is not one; the rows are bytes then."""
        self.format: CassandraTopic_ = format_class(metadata.format)(
            metadata.msg_type, metadata.md5sum, definition
        )
        columns = tuple(self.format.getColValidationClasses())
        super().__init__(cassandra, keyspace, name, metadata, columns)
        self.key_part = _key_part(metadata, definition)
        """The field that is the key, where there is one."""
        timed = self.key_part is None or self.key_part.is_time
        self.value_part = None if timed else self.key_part
        """The field by whose value rows are found, where there is one."""
        self.classes: dict[int, Any] = {}
        """Message classes by the number of the connection."""
        self._indexes: tuple[Mapping[str, str], dict[str, IndexField]] = ({}, {})

    @property
    def msg_type(self) -> str:
        """Type of the first connection, 'pkg/Name'."""
        return self.metadata.msg_type

    @property
    def by_field(self) -> bool:
        """Whether each field has a column of its own."""
        return self.format.BY_FIELD

    @property
    def valued(self) -> bool:
        """Whether rows are found by the value of a field that is no time."""
        return self.value_part is not None

    @property
    def index_fields(self) -> dict[str, IndexField]:
        """The indexes that conditions can use, by their field, as the comment lists them now."""
        indexes, definition = self.metadata.indexes, self.definition
        known, fields = self._indexes
        if definition is not None and known != indexes:
            fields = {}
            for field, shadow in indexes.items():
                if self.digest is not None and self.digest.field == field:
                    continue  # holds whole arrays, not their elements
                try:
                    fields[field] = IndexField(definition, field, shadow)
                except InvalidName as exc:
                    topic = self.metadata.topic
                    _log.warning("an index of topic %s is not used: %s", topic, exc)
            self._indexes = indexes, fields
        return fields

    @property
    def digest(self) -> Optional[KeyPart]:
        """The key field whose index holds the md5 of a whole array, where there is one."""
        part = self.value_part
        return part if part is not None and part.digest else None

    def shadows(self) -> Optional[Shadows]:
        """Return the indexes that a bucket which is opened now is filled with; None = none."""
        values: dict[str, _Value] = {i.shadow: i.value for i in self.index_fields.values()}
        part = self.digest
        if part is not None:
            values[self.metadata.indexes[part.field]] = partial(_digest, part)
        if not values:
            return None
        every = tuple(values.values())
        if len(every) == 1:
            return Shadows(tuple(values), lambda wire: _alone(every[0](wire)))
        return Shadows(tuple(values), lambda wire: _together([value(wire) for value in every]))

    def make_row(self, received: int, seq: int, conn: int, wire: bytes, name: str = "") -> NewRow:
        """Make the row of a message: its columns, and its place by the topic's key format.

        Args:
            received: When it was received, ns.
            seq: Writer id << 32 | counter.
            conn: Number of its connection.
            wire: The serialised message.
            name: Where messages are kept under names: this one's; '' = the topic's.
        """
        metadata = self.metadata
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
        t = self.key_part.time(wire)
        columns = (*columns, encode_long(received))
        # What has no time lies where it was received; nsecs may pass the end of time.
        t = received if t is None else min(t, MAX_NS)
        return NewRow(t, seq, conn, wire, columns, odd, raw)


class TopicTables:
    """The topic tables of a keyspace as objects, made once each. Thread-safe."""

    def __init__(self, cassandra: Cassandra, schema: Schema) -> None:
        self._cassandra = cassandra
        self._schema = schema
        self._made: dict[str, TopicTable] = {}
        self._mutex = threading.Lock()

    def get(self, name: str, metadata: TopicMetadata) -> TopicTable:
        """Return the object of a table; its metadata follow the comment."""
        with self._mutex:
            table = self._made.get(name)
            if table is None:
                definition = definition_in(metadata)
                table = TopicTable(
                    self._cassandra, self._schema.keyspace, name, metadata, definition
                )
                self._made[name] = table
            table.metadata = metadata
            return table

    def by_name(self, name: str) -> Optional[TopicTable]:
        """Return a table by its name, or None where there is none of this name now."""
        metadata = self._schema.tables().get(name)
        return None if metadata is None else self.get(name, metadata)

    def of_topic(self, topic: str) -> list[TopicTable]:
        """List the tables of a topic: one for each md5 and format."""
        tables = sorted(self._schema.tables().items())
        return [self.get(name, m) for name, m in tables if m.topic == topic]


def _digest(part: KeyPart, wire: bytes) -> tuple[Optional[bytes], bool]:
    value = part.value(wire)
    return (None, True) if value is None else (part.index(value), False)


def _alone(value: tuple[Optional[bytes], bool]) -> Indexed:
    return value[:1], value[1]


def _together(values: Sequence[tuple[Optional[bytes], bool]]) -> Indexed:
    return [value for value, _ in values], any(odd for _, odd in values)


def definition_in(metadata: TopicMetadata) -> Optional[Definition]:
    """Return the definition that a comment holds, None where it is unusable."""
    try:
        return parse_definition(metadata.msg_type, metadata.definition, metadata.md5sum)
    except DefinitionError as exc:
        _log.debug("topic %s has no usable definition: %s", metadata.topic, exc)
        return None


def _key_part(metadata: TopicMetadata, definition: Optional[Definition]) -> Optional[KeyPart]:
    # A definition that lacks the field has neither index nor receive time; its rows lie by time.
    able = metadata.own_time or metadata.key_part in metadata.indexes
    if metadata.key_format != "msg_part" or definition is None or not able:
        return None
    return KeyPart(definition, metadata.key_part)
