# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A connected keyspace: the parts that writers, readers and topics share."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any, Mapping, Optional, Sequence

from cassandra_ros.errors import InvalidKey, InvalidName, TopicExists, TypeMismatch, WriteFailed
from cassandra_ros.formats.table import DEFAULT_FORMAT, FALLBACK_FORMAT, format_class
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition, definition_of
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.metadata import TopicMetadata, shadow_column
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import Directory, limit_for_ttl
from cassandra_ros.store.index.changes import IndexChanges
from cassandra_ros.store.registry import Registry
from cassandra_ros.store.schema import Planned, Schema
from cassandra_ros.store.side_tables import SideTables
from cassandra_ros.topics.connections import ConnectionCache
from cassandra_ros.topics.reading import RowReader
from cassandra_ros.topics.removal import Removal
from cassandra_ros.topics.topic_table import TopicTable, TopicTables, definition_in
from cassandra_ros.topics.totals import TopicTotals

_log = logging.getLogger(__name__)


class Keyspace:
    """One keyspace of a cluster; it and its side tables are made by what first writes.

    Each of its parts, which are its attributes, does one thing in it; their classes say which.

    Raises:
        InvalidName: The name is not 1 to 48 letters, digits and underscores.
    """

    def __init__(self, cassandra: Cassandra, name: str) -> None:
        self.cassandra = cassandra
        self.name = name
        self.side_tables = SideTables(cassandra, name)
        self.schema = Schema(cassandra, self.side_tables)
        self.indexes = IndexChanges(cassandra, self.schema)
        self.directory = Directory(cassandra, self.side_tables)
        self.registry = Registry(cassandra, self.side_tables)
        self.connections = ConnectionCache(self.registry)
        self.tables = TopicTables(cassandra, self.schema)
        self.rows = RowReader(cassandra, self.directory, self.connections)
        self.totals = TopicTotals(self.directory)
        self.removal = Removal(cassandra, self.directory)

    def format_for(self, topic: str, md5sum: str = "", asked: Optional[str] = None) -> str:
        """Decide in which format new messages of a topic are kept.

        Args:
            topic: Its name.
            md5sum: Of the messages, where that is known.
            asked: The format that somebody named; it goes before all others.

        Returns:
            Unasked the format of the table that was made last, of this md5 where there is one: a
            stored topic stays in its format. Of a topic that is not stored yet DEFAULT_FORMAT.

        Raises:
            UnknownFormat: There is no format of the name that was asked for.
        """
        if asked is not None and asked != "":
            format_class(asked)
            return asked
        tables = [m for m in self.schema.tables().values() if m.topic == topic]
        # One publisher without a usable definition must not decide for all others.
        chosen = [m for m in tables if m.format != FALLBACK_FORMAT or definition_in(m)] or tables
        newest = max(chosen, key=lambda m: (m.md5sum == md5sum, m.date, m.format), default=None)
        return DEFAULT_FORMAT if newest is None else newest.format

    def make_table(self, metadata: TopicMetadata, definition: Optional[Definition]) -> TopicTable:
        """Find the table for a topic, md5 and format, or make it.

        Args:
            metadata: What its comment is to say; columns, date and bucket are completed here, and
                what the topic's other tables say holds for this one. Of its indexes the fields
                count; one that the type has not is left out.
            definition: The checked definition, or None.

        Raises:
            InvalidKey: The type has no such field as key_part, and the topic is new.
        """
        for table in self.tables.of_topic(metadata.topic):
            if (table.metadata.md5sum, table.metadata.format) == (metadata.md5sum, metadata.format):
                return table
        fmt = format_class(metadata.format)(metadata.msg_type, metadata.md5sum, definition)

        def plan(others: Sequence[TopicMetadata]) -> Planned:
            wanted = _beside(metadata, others)
            wanted, shadows = _indexed(wanted, definition, new=not others)
            wanted = wanted.with_(
                bucket_ns=limit_for_ttl(wanted.bucket_ns, wanted.ttl),
                columns=tuple(fmt.describe()),
                date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
            )
            return wanted, fmt.getColValidationClasses(), shadows

        key = (metadata.topic, metadata.md5sum, metadata.format)
        name = self.schema.ensure_table(key, plan)
        found = self.tables.by_name(name)
        if found is None:
            raise WriteFailed(
                f"the table of topic {metadata.topic} was dropped as soon as it was made: another "
                "client removes this topic; try again"
            )
        return found

    def wished_table(self, topic: str, wish: Wish, definition: Definition) -> TopicTable:
        """Find or make the table for messages of this definition, in the format asked for."""
        for path in wish.index:
            IndexField(definition, path, "")  # raises InvalidName where there is none
        table = self.make_table(wish.metadata(topic, definition), definition)
        wish.check(table.metadata, None)  # another client may have been quicker
        return table

    def table_for(self, topic: str, wish: Wish, msg: Any) -> TopicTable:
        """Find or make the table for a message.

        Raises:
            TypeMismatch: It is none, or of another type than the topic.
        """
        if not hasattr(type(msg), "_md5sum"):  # nor has a class, in place of its object
            raise TypeMismatch(
                f"{msg!r:.80} is no message: give topic {topic} a message object, as "
                "std_msgs.msg.String(data='x'); nothing was stored"
            )
        definition = definition_of(type(msg))
        tables = self.tables.of_topic(topic)
        fitting = [t for t in tables if t.metadata.md5sum == definition.md5sum]
        wished = [t for t in fitting if t.metadata.format == wish.format]
        if wished or (fitting and not wish.asked):
            return (wished or fitting)[0]
        if tables and not fitting:
            stored = tables[0].metadata
            raise TypeMismatch(
                f"topic {topic} holds {stored.msg_type} [{stored.md5sum}], the message is "
                f"{definition.type} [{definition.md5sum}]; nothing was stored"
            )
        return self.wished_table(topic, wish, definition)

    def nodes(self, tables: Sequence[TopicTable]) -> list[str]:
        """List the nodeIDs that have stored messages in some tables."""
        ends = (-(2**63), 2**63 - 1)
        return sorted({node for t in tables for _, node in self.directory.nodes(t.name, *ends)})


def _beside(metadata: TopicMetadata, others: Sequence[TopicMetadata]) -> TopicMetadata:
    """Return the metadata of a table beside others of its topic: what they say holds for it."""
    if not others:
        return metadata
    first = others[0]
    if all(other.md5sum != metadata.md5sum for other in others):
        was, now = (f"{each.msg_type} [{each.md5sum}]" for each in (first, metadata))
        text = "topic %s was stored with type %s and goes on with %s in a table of its own; "
        _log.warning(text + "reading merges both", metadata.topic, was, now)
    elif metadata.format not in (formats := {other.format for other in others}):
        was, now = ", ".join(sorted(formats)), metadata.format
        text = "topic %s is stored in format %s and goes on in format %s in a table of its own; "
        _log.warning(text + "reading merges both", metadata.topic, was, now)
    return metadata.with_(
        key_format=first.key_format,
        key_part=first.key_part,
        ttl=metadata.ttl or first.ttl,
        nodeID=metadata.nodeID or first.nodeID,
        comment=metadata.comment or first.comment,
        user=metadata.user or first.user,
        indexes={**metadata.indexes, **{field: "" for m in others for field in m.indexes}},
    )


def _indexed(
    metadata: TopicMetadata, definition: Optional[Definition], new: bool
) -> tuple[TopicMetadata, dict[str, str]]:
    """Return the metadata with the indexes of the table, and the columns that carry them."""
    wished = list(metadata.indexes)
    part = _key_part(metadata, definition, new)
    own_time = metadata.key_format == "hash" or (part is not None and part.is_time)
    metadata = metadata.with_(own_time=own_time, indexes={}, index_count=0)
    shadows = {}
    if part is not None and not part.is_time:
        metadata = metadata.with_index(part.field, 0)
        shadows[shadow_column(0)] = part.cql_type
    for path in wished:
        if definition is None or metadata.named or path in metadata.indexes:
            continue
        try:
            index = IndexField(definition, path, shadow_column(metadata.next_shadow))
        except InvalidName as exc:
            _log.info("messages of topic %s are stored without an index: %s", metadata.topic, exc)
            continue
        metadata = metadata.with_index(path, metadata.next_shadow)
        shadows[index.shadow] = index.cql_type
    return metadata, shadows


def _key_part(
    metadata: TopicMetadata, definition: Optional[Definition], new: bool
) -> Optional[KeyPart]:
    """Return the key field of a table that is made, None where its type has none."""
    if metadata.key_format != "msg_part":
        return None
    try:
        if definition is None:
            raise InvalidKey(f"{metadata.msg_type} has no usable definition to find a key field in")
        return KeyPart(definition, metadata.key_part)
    except InvalidKey as exc:
        if new:
            raise
        _log.warning("messages of topic %s: %s; these are found by time", metadata.topic, exc)
        return None


def default_bucket(definition: Optional[Definition]) -> int:
    """Return the bucket length where the rate is unknown: 1 min for types with arrays."""
    arrays = definition is None or any(
        field.is_array for spec in definition.specs.values() for field in spec.fields
    )
    return (60 if arrays else 600) * SECOND_NS


@dataclass(frozen=True)
class Wish:
    """What addTopic asked for; kept until the first message tells the type."""

    format: str
    """'' = as it is stored; the catalog fills it in."""
    node: str = ""
    ttl: int = 0
    comment: str = ""
    key_format: str = ""
    """'' = as it is stored, else 'time'."""
    key_part: str = ""
    user: Mapping[str, Any] = field(default_factory=dict)
    index: tuple[str, ...] = ()
    """Fields that are to have an index."""
    asked: bool = True
    """addTopic named the format; else it is the one that is stored."""
    pending: bool = True
    """Added in this process, perhaps without a table yet."""

    @classmethod
    def stored(cls, metadata: TopicMetadata, format: str) -> Wish:
        """Return the wish for a topic as it is stored, and goes on in a format."""
        return cls(
            format=format,
            node=metadata.nodeID,
            ttl=metadata.ttl,
            comment=metadata.comment,
            key_format=metadata.key_format,
            key_part=metadata.key_part,
            user=metadata.user,
            asked=False,
        )

    def check(self, metadata: TopicMetadata, definition: Optional[Definition]) -> None:
        """Compare with what is stored.

        Raises:
            TopicExists: The topic is stored in another way than asked for.
        """
        wrong = []
        if definition is not None and definition.md5sum != metadata.md5sum:
            wrong.append(f"type {metadata.msg_type} [{metadata.md5sum}]")
        key = (self.key_format, self.key_part)
        if self.key_format and key != (metadata.key_format, metadata.key_part):
            wrong.append(f"key_format {metadata.key_format} {metadata.key_part}".rstrip())
        if self.ttl and self.ttl != metadata.ttl:
            wrong.append(f"ttl {metadata.ttl} s")
        if wrong:
            raise TopicExists(
                f"topic {metadata.topic} is stored already with {', '.join(wrong)}; give the "
                "same, or remove the topic first"
            )

    def metadata(self, topic: str, definition: Optional[Definition]) -> TopicMetadata:
        """Return what the comment of the topic's table is to say."""
        return TopicMetadata(
            topic=topic,
            msg_type=definition.type if definition else "",
            md5sum=definition.md5sum if definition else "",
            definition=definition.text if definition else "",
            format=self.format,
            bucket_ns=default_bucket(definition),
            ttl=self.ttl,
            nodeID=self.node,
            comment=self.comment,
            key_format=self.key_format or "time",
            key_part=self.key_part,
            user=self.user,
            indexes=dict.fromkeys(self.index, ""),
        )
