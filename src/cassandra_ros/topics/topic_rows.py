# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stored rows of one topic: walked through, found, without making message objects."""

from __future__ import annotations

from typing import Any, Iterator, Optional

from cassandra_ros.arguments import check_limit, check_nodes, check_text
from cassandra_ros.errors import InvalidKey, TopicNotFound
from cassandra_ros.keys import NAMED_FORMATS, Position
from cassandra_ros.messages.stamps import Stamp, isIsoText, toNs
from cassandra_ros.query.protocols import Chooser
from cassandra_ros.topics.filtering import Filter, Where
from cassandra_ros.topics.finding import Finder
from cassandra_ros.topics.reading import Columns
from cassandra_ros.topics.selection import LAST_NS, valueOfText
from cassandra_ros.topics.stored_row import Key, StoredRow
from cassandra_ros.topics.topic_facts import TopicFacts
from cassandra_ros.topics.topic_table import TopicTable

Time = Any
"""genpy.Time or Stamp, int (ns), float (s) or ISO 8601 text."""
AnyKey = Any
"""A Time, or what else is the topic's key: a name, or the value of a field."""


class TopicRows(TopicFacts):
    """Rows of one topic by time, name or value; see CassandraTopic."""

    def getRow(
        self,
        key: Any,
        *,
        nearest: Optional[str] = None,
        nodeID: Optional[str] = None,
        where: Optional[Where] = None,
    ) -> Optional[StoredRow]:
        """Find one stored row as getData does; None where there is none."""
        return self._finder(nodeID, where).find(key, nearest)

    def _finder(self, nodeID: Optional[str], where: Optional[Where] = None) -> Finder:
        tables = self._stored()
        passing = None if where is None else Filter(self, where, nodeID)
        key_format = tables[0].metadata.key_format if tables else self._wish.key_format
        return Finder(self._keyspace, self.name, key_format, tables, nodeID, passing)

    def keyOfText(self, text: str) -> AnyKey:
        """Read a key that a person typed, by what the topic's keys are.

        A name is the text itself; a time is integer nanoseconds or ISO 8601; the value of a
        field is a number, true or false, or text, as the field is. Where values are keys a time
        is ISO 8601 only.

        Raises:
            InvalidKey: The text is no key of the topic.
        """
        check_text("text", text, error=InvalidKey)
        tables = self._stored()
        if self._wish.key_format in NAMED_FORMATS or any(table.named for table in tables):
            return text
        valued = [table for table in tables if table.valued]
        if valued and not isIsoText(text):
            return valueOfText(valued, text)
        if valued:
            return Stamp.fromNs(toNs(text))
        text = text.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 40 else text

    def versions(
        self, name: str, *, nodeID: Optional[str] = None, reverse: bool = False
    ) -> Iterator[StoredRow]:
        """Walk through the messages under one name, by time, without making objects."""
        check_text("name", name, error=InvalidKey)
        return self._finder(nodeID).many(name, None, reverse=reverse)

    def rows(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        columns: Optional[Columns] = None,
        chooser: Optional[Chooser] = None,
    ) -> Iterator[StoredRow]:
        """Walk through messages by their time, as items does, without making objects.

        Args:
            key, to_key: Ends, both included, whatever the topic's keys are; None = open.
            nodeID, limit, reverse: As items takes them.
            after: Begin behind this row (a cursor).
            columns: Gives for a table those of its columns to read, in their order, None = all;
                a row fetches the others when its bytes are asked for.
            chooser: Tells what the server may leave out (a query.protocols.Chooser).
        """
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        if not isinstance(after, (Position, type(None))):
            raise InvalidKey(f"after={after!r:.80} is no place: give the position of a row")
        return self._keyspace.rows.read(
            *(self._stored(), low, high),
            nodes=check_nodes(nodeID),
            after=after,
            reverse=reverse,
            limit=check_limit(limit),
            columns=columns,
            chooser=chooser,
        )

    def _stored(self) -> list[TopicTable]:
        tables, wish = self.tables, self._wish
        known = (self.name, wish.format) in self._keyspace.schema.seen
        if not tables and (known or not wish.pending):
            raise TopicNotFound(
                f"topic {self.name} is not stored in keyspace {self._keyspace.name} any more"
            )
        return tables

    def first(self, nodeID: Optional[str] = None) -> Optional[Key]:
        """Return the key of the oldest message; None when there is none."""
        row = next(self.rows(nodeID=nodeID, limit=1), None)
        return None if row is None else row.key

    def last(self, nodeID: Optional[str] = None) -> Optional[Key]:
        """Return the key of the newest message; None when there is none."""
        row = next(self.rows(nodeID=nodeID, limit=1, reverse=True), None)
        return None if row is None else row.key
