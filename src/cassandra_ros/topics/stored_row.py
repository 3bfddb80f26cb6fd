# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A stored message as the library hands it on: bytes first, an object when asked for."""

from __future__ import annotations

import logging
from typing import Any, Callable, Optional, Union

from cassandra_ros.errors import DefinitionError
from cassandra_ros.keys import Position, RowName
from cassandra_ros.messages.classes import deserialize, messageClass, rawClass
from cassandra_ros.messages.connection import Connection
from cassandra_ros.messages.definition import parseDefinition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.row_table import TableRow
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)

MAX_CLASSES = 1024
"""Connections of a table whose message class is kept: anonymous publishers come without end."""

Key = Union[Stamp, RowName]
"""What finds one stored message again: a time, or the name under which it is kept."""


class StoredRow:
    """One message of one topic.

    Attributes:
        t: Key time, ns since 1970.
        node: nodeID, '' when nobody said.
        seq: Writer id << 32 | counter.
        conn: Number of its connection.
        size: Serialised bytes.
        table: The TopicTable in which it lies.
    """

    __slots__ = ("_connection_of", "_row", "_wire", "_wire_of", "table")

    def __init__(
        self,
        row: TableRow,
        table: TopicTable,
        wire_of: Callable[[TopicTable, TableRow], bytes],
        connection_of: Callable[[str, int], Connection],
    ) -> None:
        self._row = row
        self.table = table
        self._wire: Optional[bytes] = None
        self._wire_of = wire_of
        self._connection_of = connection_of

    @property
    def t(self) -> int:
        """Key time, ns."""
        return self._row.t

    @property
    def node(self) -> str:
        """The nodeID."""
        return self._row.node

    @property
    def seq(self) -> int:
        """Writer id << 32 | counter."""
        return self._row.seq

    @property
    def conn(self) -> int:
        """Number of the connection."""
        return self._row.conn

    @property
    def size(self) -> int:
        """Serialised bytes."""
        return self._row.size

    @property
    def chunked(self) -> bool:
        """Whether its bytes lie in the chunk table."""
        return self._row.nchunks > 0

    @property
    def odd(self) -> bool:
        """Whether some field is not held exactly in its column."""
        return self._row.odd

    @property
    def columns(self) -> tuple[Optional[bytes], ...]:
        """The format's columns, undecoded."""
        return self._row.columns

    @property
    def received(self) -> int:
        """When the message was received, ns."""
        return self._row.t if self._row.received < 0 else self._row.received

    @property
    def name(self) -> str:
        """The name under which it is kept; '' where it is found by time."""
        return self._row.name

    @property
    def topic(self) -> str:
        """The topic under which it is stored."""
        return self.table.metadata.topic

    @property
    def position(self) -> Position:
        """Its place in the order of all reads."""
        return self._row.position

    @property
    def arrival(self) -> tuple[int, str, int, str]:
        """Its place in the order of reads by the time of reception."""
        return (self.received, self._row.node, self._row.seq, self._row.table)

    @property
    def key(self) -> Key:
        """The row key: exact time or name, and where the row lies."""
        row = self._row
        if row.name:
            return RowName.of(row.position)
        return Stamp.fromNs(row.t, node=row.node, seq=row.seq, table=row.table)

    @property
    def wire(self) -> bytes:
        """The serialised message, byte for byte as it was sent."""
        if self._wire is None:
            self._wire = self._wire_of(self.table, self._row)
        return self._wire

    @property
    def connection(self) -> Connection:
        """The connection over which it came."""
        return self._connection_of(self.table.name, self._row.conn)

    @property
    def type(self) -> str:
        """Message type as its connection names it, 'pkg/Name'."""
        return self.connection.type

    @property
    def md5sum(self) -> str:
        """md5 of the message definition."""
        return self.table.metadata.md5sum

    def messageClass(self) -> Any:
        """Return the class of the message: installed, generated, or RawMessage."""
        known = self.table.classes.get(self._row.conn)
        if known is None:
            if len(self.table.classes) >= MAX_CLASSES:
                self.table.classes.clear()
            known = self.table.classes[self._row.conn] = self._findClass()
        return known

    def _findClass(self) -> Any:
        table, type_ = self.table, self.type
        definition = table.definition
        if definition is None:
            return rawClass(type_, self.md5sum)
        try:
            text = self.connection.definition_text
            if type_ != definition.type or (text and text != definition.text):
                # The same md5 under another name, as tf/tfMessage and tf2_msgs/TFMessage, or of
                # another text: it does not tell an array of messages from a single one.
                definition = parseDefinition(type_, text, self.md5sum)
            return messageClass(definition)
        except DefinitionError as exc:
            _log.debug("messages of topic %s are given back as bytes: %s", self.topic, exc)
            return rawClass(type_, self.md5sum)

    def message(self) -> Any:
        """Deserialise the message.

        Raises:
            CorruptMessage: The bytes are not a message of the type.
        """
        return deserialize(self.messageClass(), self.wire)
