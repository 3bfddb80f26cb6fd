# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class CassandraTopic: the messages of one topic (paper section 3, figure 1)."""

from __future__ import annotations

from typing import Any, Iterator, Optional, Sequence

from cassandra_ros.errors import InvalidKey, MessageNotFound, TopicNotFound, TypeMismatch
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.keys import Position
from cassandra_ros.messages.definition import Definition, definitionOf
from cassandra_ros.messages.stamps import Stamp, toNs
from cassandra_ros.topics.absence import absentText
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.meta_view import MetaView
from cassandra_ros.topics.reading import LAST_NS
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.wish import Wish

_REQUIRED: Any = object()
_NEAREST = ("before", "after", "either")

Time = Any
"""genpy.Time or Stamp, int (ns), float (s) or ISO 8601 text."""


class CassandraTopic:
    """The stored messages of one topic. Got from RosCassandra, safe to share between threads.

    Attributes:
        name: The topic's name as it is stored.
    """

    def __init__(self, keyspace: Keyspace, adder: Adder, name: str, wish: Wish) -> None:
        self._keyspace = keyspace
        self._adder = adder
        self.name = name
        self._wish = wish

    @property
    def tables(self) -> list[TopicTable]:
        """The tables of the topic, one for each md5 and format; none before the first message."""
        return self._keyspace.tables.ofTopic(self.name)

    # ---------------------------------------------------------------- adding

    def addData(self, msg: Any, key: Optional[Time] = None, nodeID: Optional[str] = None) -> Stamp:
        """Store one message; return when it is acknowledged.

        Args:
            msg: A message object of the topic's type.
            key: Its time; None = now, by the node's clock where one runs in this process.
            nodeID: Who produced it; None = the nodeID of addTopic.

        Returns:
            The row key: an exact time that also knows the row.

        Raises:
            TypeMismatch: The message is of another type; nothing is stored.
            InvalidKey, ClockNotSet, WriteFailed.
        """
        table = self._tableFor(msg)
        t = self._adder.now() if key is None else toNs(key)
        return self._adder.add(table, msg, t, self._wish.nodeID if nodeID is None else nodeID)

    def makeTable(self, definition: Definition) -> TopicTable:
        """Find or make the table for messages of this definition, in the topic's format."""
        return self._keyspace.makeTable(self._wish.metadata(self.name, definition), definition)

    def _tableFor(self, msg: Any) -> TopicTable:
        definition = definitionOf(type(msg))
        tables = self.tables
        fitting = [t for t in tables if t.metadata.md5sum == definition.md5sum]
        wished = [t for t in fitting if t.metadata.format == self._wish.format]
        if wished or (fitting and not self._wish.asked):
            return (wished or fitting)[0]
        if tables and not fitting:
            stored = tables[0].metadata
            raise TypeMismatch(
                f"topic {self.name} holds {stored.msg_type} [{stored.md5sum}], the message is "
                f"{definition.type} [{definition.md5sum}]; nothing was stored"
            )
        return self.makeTable(definition)

    # ---------------------------------------------------------------- getting

    def getData(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nearest: Optional[str] = None,
        default: Any = _REQUIRED,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
    ) -> Any:
        """Return one message, or those of a stretch of time.

        Args:
            key: A time; with to_key the lower end.
            to_key: The upper end. Both ends are included.
            nearest: 'before' (at or before key), 'after' (at or after) or 'either'.
            default: Returned instead of raising when there is no message at key.
            nodeID: Only messages of this node; None = of all.
            limit: At most so many messages of a stretch.

        Returns:
            With to_key a list in the order of time, else one message: of several with the same
            stamp the first that arrived.

        Raises:
            MessageNotFound: No message at key (also a KeyError).
            InvalidKey: A key cannot be one.
        """
        if to_key is not None:
            stretch = self.rows(key, to_key, nodeID=nodeID, limit=limit)
            return [row.message() for row in stretch]
        if key is None:
            raise InvalidKey(
                "getData needs a key (and to_key for a stretch of time); items() walks "
                f"through all messages of topic {self.name}"
            )
        row = self.getRow(key, nearest=nearest, nodeID=nodeID)
        if row is None:
            if default is not _REQUIRED:
                return default
            raise MessageNotFound(self._absent(key, nearest, nodeID))
        return row.message()

    def getRow(
        self, key: Time, *, nearest: Optional[str] = None, nodeID: Optional[str] = None
    ) -> Optional[StoredRow]:
        """Find one stored row as getData does; None where there is none."""
        t = toNs(key)
        if nearest is not None and nearest not in _NEAREST:
            raise InvalidKey(f"nearest={nearest!r} is none of {', '.join(_NEAREST)}")
        if nearest is None:
            if isinstance(key, Stamp) and key.table and nodeID in (None, key.node):
                table = self._keyspace.tables.byName(key.table)
                if table is not None and table.metadata.topic == self.name:
                    return self._keyspace.rows.exact(table, t, key.node or "", key.seq or 0)
            return self._keyspace.rows.at(self._stored(), t, _nodes(nodeID))
        before = after = None
        if nearest != "after":
            before = next(self.rows(0, t, nodeID=nodeID, limit=1, reverse=True), None)
        if nearest != "before":
            after = next(self.rows(t, nodeID=nodeID, limit=1), None)
        if before is None or after is None:
            return before or after
        return before if t - before.t <= after.t - t else after

    def _absent(self, key: Time, nearest: Optional[str], nodeID: Optional[str]) -> str:
        near = self.getRow(toNs(key), nearest="either", nodeID=nodeID) if nearest is None else None
        return absentText(self.name, key, nearest, nodeID, None if near is None else near.t)

    def items(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        reverse: bool = False,
    ) -> Iterator[tuple[Stamp, Any]]:
        """Walk lazily through (key, message) in the order of time, any number of them.

        Args:
            key: Lower end, included; None = the first message.
            to_key: Upper end, included; None = the last message.
            nodeID: Only messages of this node; None = of all.
            limit: At most so many.
            reverse: Newest first.
        """
        for row in self.rows(key, to_key, nodeID=nodeID, limit=limit, reverse=reverse):
            yield row.key, row.message()

    def rows(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
    ) -> Iterator[StoredRow]:
        """Walk as items does, without making message objects.

        Args:
            after: Begin behind this row (a cursor).
        """
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        return self._keyspace.rows.read(
            self._stored(), low, high, nodes=_nodes(nodeID), after=after, reverse=reverse,
            limit=limit,
        )  # fmt: skip

    def _stored(self) -> list[TopicTable]:
        tables = self.tables
        if not tables and not self._wish.pending:
            raise TopicNotFound(
                f"topic {self.name} is not stored in keyspace {self._keyspace.name} any more"
            )
        return tables

    def first(self, nodeID: Optional[str] = None) -> Optional[Stamp]:
        """Return the key of the oldest message; None when there is none."""
        row = next(self.rows(nodeID=nodeID, limit=1), None)
        return None if row is None else row.key

    def last(self, nodeID: Optional[str] = None) -> Optional[Stamp]:
        """Return the key of the newest message; None when there is none."""
        row = next(self.rows(nodeID=nodeID, limit=1, reverse=True), None)
        return None if row is None else row.key

    # ---------------------------------------------------------------- counting and removing

    def countTopicData(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        nodeID: Optional[str] = None,
    ) -> int:
        """Count the messages with key <= time <= to_key, without reading them."""
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        return self._keyspace.rows.count(self._stored(), low, high, _nodes(nodeID))

    def removeData(
        self, key: Time, to_key: Optional[Time] = None, nodeID: Optional[str] = None
    ) -> int:
        """Delete the messages at key, or with key <= time <= to_key; return how many.

        A key that the store returned means its one message, a bare time all of that time.

        Raises:
            MessageNotFound: There is no message at key (without to_key).
        """
        low = toNs(key)
        if to_key is None and isinstance(key, Stamp) and key.table and nodeID in (None, key.node):
            row = self.getRow(key)
            if row is None:
                raise MessageNotFound(self._absent(key, None, nodeID))
            return self._keyspace.rows.deleteRow(row)
        high = low if to_key is None else toNs(to_key)
        count = self._keyspace.rows.delete(self._stored(), low, high, _nodes(nodeID))
        if not count and to_key is None:
            raise MessageNotFound(self._absent(key, None, nodeID))
        return count

    # ---------------------------------------------------------------- metadata and format

    @property
    def getMeta(self) -> MetaView:
        """The metadata: ``getMeta['msg_type']`` or ``getMeta('msg_type')``."""
        tables = self.tables
        metadata = tables[0].metadata if tables else self._wish.metadata(self.name, None)
        directory = self._keyspace.directory
        found = {n for t in tables for _, n in directory.nodes(t.name, -(2**63), LAST_NS)}
        return MetaView(metadata, sorted(found))

    @property
    def format(self) -> CassandraTopic_:
        """The format object of the topic's first table.

        Raises:
            TopicNotFound: The type is not known before the first message.
        """
        tables = self.tables
        if not tables:
            raise TopicNotFound(f"topic {self.name} has no type yet: its first message fixes it")
        return tables[0].format

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the format's columns: name → CQL type (paper listing 3)."""
        return self.format.getColValidationClasses()

    def encode(self, msg: Any) -> EncodedMessage:
        """Translate a message into columns (paper 3.1)."""
        return self.format.encode(msg)

    def decode(self, data: EncodedMessage) -> Any:
        """Translate columns back into a message (paper 3.1)."""
        return self.format.decode(data)

    def __repr__(self) -> str:
        return f"CassandraTopic({self.name!r})"


def _nodes(nodeID: Optional[str]) -> Optional[Sequence[str]]:
    return None if nodeID is None else (nodeID,)
