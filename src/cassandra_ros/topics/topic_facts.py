# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is known of a topic beside its messages: metadata, tables, format."""

from __future__ import annotations

from typing import Any

from cassandra_ros.arguments import check_text, check_user_keys
from cassandra_ros.errors import TopicNotFound, TypeMismatch
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.meta_view import MetaView
from cassandra_ros.topics.selection import LAST_NS
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.wish import Wish


class TopicFacts:
    """Metadata, tables and format of one topic."""

    def __init__(self, keyspace: Keyspace, name: str, wish: Wish) -> None:
        self._keyspace = keyspace
        self.name = name
        self._wish = wish

    @property
    def tables(self) -> list[TopicTable]:
        """The tables of the topic, one for each md5 and format; none before the first message."""
        return self._keyspace.tables.ofTopic(self.name)

    @property
    def getMeta(self) -> MetaView:
        """The metadata: ``getMeta['msg_type']`` or ``getMeta('msg_type')``."""
        tables = self.tables
        metadata = tables[0].metadata if tables else self._wish.metadata(self.name, None)
        directory = self._keyspace.directory
        found = {n for t in tables for _, n in directory.nodes(t.name, -(2**63), LAST_NS)}
        indexes = {field: "" for t in tables for field in t.metadata.indexes}
        return MetaView(metadata.with_(indexes=indexes or metadata.indexes), sorted(found))

    def countBuckets(self) -> int:
        """Count the partitions: stretches of time of a node in a table; 0 for named messages."""
        directory = self._keyspace.directory
        rows = [
            (table.name, row.node, row.bucket)
            for table in self.tables
            for row in directory.buckets(table.name, -(2**63), LAST_NS, ttl=table.metadata.ttl)
        ]
        return len(set(rows))

    def setMeta(self, **keys: Any) -> None:
        """Set keys of your own in the topic's metadata: ``setMeta(site='lab')``.

        Args:
            keys: Values that JSON gives back as they are (texts, finite numbers, bools, lists,
                dicts whose keys are texts); None removes a key. ``comment`` sets the topic's
                comment; the other keys of getMeta are facts and cannot be set.

        Raises:
            InvalidName: A key cannot be set, or not to this value.
            InvalidOption: The comment is no text.
            TopicNotFound: The topic has no type yet, so there is no table to note it in.
        """
        comment = keys.pop("comment", None)
        if comment is not None:
            check_text("comment", comment)
        check_user_keys(keys)
        if not self.tables:
            raise TopicNotFound(
                f"topic {self.name} has no type yet: its first message fixes it; give metadata= "
                "to addTopic"
            )

        def change(metadata: TopicMetadata) -> TopicMetadata:
            every = {**metadata.user, **keys}
            user = {name: value for name, value in every.items() if value is not None}
            return metadata.with_(
                user=user, comment=metadata.comment if comment is None else comment
            )

        self._keyspace.schema.changeTopic(self.name, change)

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
        """Translate columns back into a message (paper 3.1).

        Raises:
            TypeMismatch: data is not what encode returns.
        """
        if not isinstance(data, EncodedMessage):
            raise TypeMismatch(f"{data!r:.80} is no encoded message: give what encode returned")
        return self.format.decode(data)
