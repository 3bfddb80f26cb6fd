# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A connected keyspace: the parts that writers, readers and topics share."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Callable, Mapping, Optional, Sequence, TypeVar

from cassandra_ros.arguments import (
    check_fields,
    check_key_format,
    check_new_node,
    check_new_topic,
    check_text,
    check_ttl,
    check_user_keys,
)
from cassandra_ros.connection.cassandra import Cassandra
from cassandra_ros.errors import (
    InvalidKey,
    InvalidName,
    InvalidOption,
    InvalidQuery,
    TopicExists,
    TopicNotFound,
    TypeMismatch,
    WriteFailed,
)
from cassandra_ros.formats.table import DEFAULT_FORMAT, FALLBACK_FORMAT, format_class
from cassandra_ros.keys import NAMED_FORMATS, SECOND_NS
from cassandra_ros.messages.definition import Definition, definition_of
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.metadata import TopicMetadata, shadow_column
from cassandra_ros.query.protocols import Places as RobotPlaces
from cassandra_ros.tables.directory import (
    MIN_SPAN_NS,
    UNKNOWN_SPAN_NS,
    Directory,
    limit_for_ttl,
)
from cassandra_ros.tables.index_changes import IndexChanges
from cassandra_ros.tables.place_index import PlaceIndex
from cassandra_ros.tables.registry import Registry
from cassandra_ros.tables.schema import Planned, Planner, Schema
from cassandra_ros.tables.side_tables import SideTables
from cassandra_ros.topics.key_selection import Whose
from cassandra_ros.topics.replaced_tables import Following
from cassandra_ros.topics.row_reader import RowReader
from cassandra_ros.topics.run_finder import Runs
from cassandra_ros.topics.stored_headers import ConnectionCache
from cassandra_ros.topics.stored_totals import holds_any
from cassandra_ros.topics.topic_table import TopicTable, TopicTables, definition_in

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


class Keyspace:
    """One keyspace of a cluster; it and its side tables are made by what first writes.

    Each of its parts, which are its attributes, does one thing in it; their classes say which.

    Args:
        robots: Returns where the robots of the keyspace were.
    """

    def __init__(self, cassandra: Cassandra, name: str, robots: Callable[[], RobotPlaces]) -> None:
        self.cassandra = cassandra
        self.name = name
        self.side_tables = SideTables(cassandra, name)
        self.schema = Schema(cassandra, self.side_tables)
        self.indexes = IndexChanges(self.schema)
        self.directory = Directory(cassandra, self.side_tables)
        self.registry = Registry(self.side_tables)
        self.place_index = PlaceIndex(self.side_tables)
        self.connections = ConnectionCache(self.registry)
        self.runs = Runs(name, self.registry, self._has_written)
        self.tables = TopicTables(cassandra, self.schema, self.connections, self.runs, robots)
        self.rows = Following(RowReader(cassandra, self.directory))

    def _has_written(self, writer: int) -> bool:
        whose, every = Whose(None, frozenset([writer])), self.schema.tables(fresh=True)
        tables = [self.tables.get(name, metadata) for name, metadata in every.items()]
        return holds_any(self.directory, tables, whose)

    def naming(self, make: Callable[[], _T]) -> _T:
        """Make what names fields of topics; anew where one is unknown and tables have changed.

        Raises:
            InvalidQuery: No table has the field now.
        """
        known = self.schema.listing()
        try:
            return make()
        except InvalidQuery:
            if self.schema.listing(fresh=True).visible == known.visible:
                raise
            return make()

    def format_for(self, topic: str, md5sum: str = "", asked: Optional[str] = None) -> str:
        """Decide in which format new messages of a topic are kept.

        That is the one that was asked for, or raises UnknownFormat; else that of the table that was
        made last, of this md5 where there is one: a stored topic stays in its format.
        """
        if asked is not None and asked != "":
            format_class(asked)
            return asked
        tables = [m for m in self.schema.tables().values() if m.topic == topic]
        # One publisher without a usable definition must not decide for all others.
        chosen = [m for m in tables if m.format != FALLBACK_FORMAT or definition_in(m)] or tables
        newest = max(chosen, key=lambda m: (m.md5sum == md5sum, m.date, m.format), default=None)
        return DEFAULT_FORMAT if newest is None else newest.format

    def make_table(
        self, metadata: TopicMetadata, definition: Optional[Definition], *, large: bool = False
    ) -> TopicTable:
        """Find the table for a topic, kind and format, or make it.

        Args:
            metadata: What its comment is to say; columns, date and what is '' or 0 are completed
                here, and what the topic's other tables say holds for this one. Of its indexes the
                fields count; one that the type has not is left out.
            definition: The checked definition, or None.
            large: The table for large messages, too, for which they would wait later.

        Raises:
            InvalidKey: The type has no such field as key_part, and the topic is new.
        """
        key = (metadata.topic, metadata.kind, metadata.format)
        name = self.schema.ensure_table(key, self.planner(metadata, definition))
        found = self.tables.by_name(name)
        if found is None:
            raise WriteFailed(
                f"the table of topic {metadata.topic} was dropped as soon as it was made: another "
                "client removes this topic; try again"
            )
        if large:
            with suppress(TopicNotFound):  # removed since: the first message meets that again
                self.schema.ensure_chunk_table(found)
        return found

    def planner(self, metadata: TopicMetadata, definition: Optional[Definition]) -> Planner:
        """Return what plans the table for make_table, given what the topic's other tables say."""
        fmt = format_class(metadata.format)(metadata.msg_type, metadata.md5sum, definition)

        def plan(others: Sequence[TopicMetadata]) -> Planned:
            wanted = _beside(metadata, others)
            if fmt.PACKED:
                check_packed(wanted, definition)
                wanted = wanted.with_(indexes={})
            wanted, shadows = _indexed(wanted, definition, new=not others)
            bucket_ns = wanted.bucket_ns or _default_bucket(definition)
            bucket_ns = limit_for_ttl(bucket_ns, wanted.ttl)
            wanted = wanted.with_(
                key_format=wanted.key_format or "time",
                bucket_ns=bucket_ns,
                span_ns=_span(wanted.span_ns, bucket_ns) if fmt.PACKED else 0,
                columns=tuple(fmt.describe()),
                replaces=(),
                filling=False,
                date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
            )
            return wanted, fmt.table_columns(), shadows

        return plan

    def wished_table(self, wish: Wish, definition: Definition) -> TopicTable:
        """Find or make the table for messages of this definition, in the format asked for."""
        for path in wish.metadata.indexes:
            IndexField(definition, path, "")  # raises InvalidName where there is none
        kind, md5sum, text = definition.type, definition.md5sum, definition.text
        metadata = wish.metadata.with_(msg_type=kind, md5sum=md5sum, definition=text)
        table = self.make_table(metadata, definition)
        wish.check(table.metadata, None)  # another client may have been quicker
        return table

    def table_for(self, wish: Wish, msg: Any) -> TopicTable:
        """Find or make the table for a message; TypeMismatch where it is none of the topic's."""
        topic = wish.metadata.topic
        if not hasattr(type(msg), "_md5sum"):  # nor has a class, in place of its object
            raise TypeMismatch(
                f"{msg!r:.80} is no message: give topic {topic} a message object, as "
                "std_msgs.msg.String(data='x'); nothing was stored"
            )
        definition = definition_of(type(msg))
        tables = self.tables.of_topic(topic)
        fitting = [t for t in tables if t.metadata.md5sum == definition.md5sum]
        wished = [t for t in fitting if t.metadata.format == wish.metadata.format]
        if wished or (fitting and not wish.asked):
            return (wished or fitting)[0]
        if tables and not fitting:
            stored = tables[0].metadata
            raise TypeMismatch(
                f"topic {topic} holds {stored.msg_type} [{stored.md5sum}], the message is "
                f"{definition.type} [{definition.md5sum}]; nothing was stored"
            )
        return self.wished_table(wish, definition)

    def nodes(self, tables: Sequence[TopicTable]) -> list[str]:
        """List the nodeIDs that have stored messages in some tables."""
        ends = (-(2**63), 2**63 - 1)
        return sorted({node for t in tables for _, node in self.directory.nodes(t.name, *ends)})


def _beside(metadata: TopicMetadata, others: Sequence[TopicMetadata]) -> TopicMetadata:
    """Return the metadata of a table beside others of its topic: what they say holds for it."""
    if not others:
        return metadata
    first = others[0]
    if all(other.kind != metadata.kind for other in others):
        was, now = (f"{each.msg_type} [{each.md5sum}]" for each in (first, metadata))
        text = "topic %s was stored with type %s and goes on with %s in a table of its own; "
        _log.warning(text + "reading merges both", metadata.topic, was, now)
    elif metadata.format not in (formats := {other.format for other in others}):
        was, now = ", ".join(sorted(formats)), metadata.format
        text = "topic %s is stored in format %s and goes on in format %s in a table of its own; "
        text += "reading merges both, and 'cassandra_bag convert' makes one of them"
        _log.warning(text, metadata.topic, was, now)
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
    wished, shadows, by_hash = list(metadata.indexes), {}, metadata.key_format == "hash"
    metadata = metadata.with_(own_time=by_hash, indexes={}, index_count=0)
    if metadata.key_format == "msg_part":
        try:
            if definition is None:
                none = "has no usable definition to find a key field in"
                raise InvalidKey(f"{metadata.msg_type} {none}")
            part = KeyPart(definition, metadata.key_part)
        except InvalidKey as exc:
            if new:
                raise
            _log.warning("messages of topic %s: %s; these are found by time", metadata.topic, exc)
        else:
            metadata = metadata.with_(own_time=part.is_time)
            if not part.is_time:
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


def check_packed(metadata: TopicMetadata, definition: Optional[Definition] = None) -> None:
    """Raise InvalidOption where messages cannot lie in blocks, for their key is no time."""
    key_format, part = metadata.key_format, metadata.key_part
    if key_format not in NAMED_FORMATS and key_format != "msg_part":
        return
    if key_format == "msg_part":
        if definition is None:
            return
        try:
            if KeyPart(definition, part).is_time:
                return
        except InvalidKey:
            return  # these messages are found by time
    what = f"key_part={part!r}, which is no time" if part else f"key_format={key_format!r}"
    raise InvalidOption(
        f"topic {metadata.topic} cannot be kept in format packed, whose messages lie in blocks by "
        f"their time, with {what}: choose another format for it, or key_format='time' for a new "
        "topic"
    )


def _span(wanted: int, bucket_ns: int) -> int:
    """Return how much time a block may cover, ns; wanted 0 = nobody knows the rate."""
    return min(max(wanted or UNKNOWN_SPAN_NS, MIN_SPAN_NS), bucket_ns)


def _default_bucket(definition: Optional[Definition]) -> int:
    """Return the bucket length where the rate is unknown: 1 min for types with arrays."""
    arrays = definition is None or any(
        field.is_array for spec in definition.specs.values() for field in spec.fields
    )
    return (60 if arrays else 600) * SECOND_NS


def wished_topic(
    topic: str,
    format: Optional[str],
    node: str,
    ttl: int,
    comment: str,
    user: Optional[Mapping[str, Any]],
    index: Sequence[str],
) -> TopicMetadata:
    """Check what addTopic was given, and return it as metadata without a type."""
    return TopicMetadata(
        topic=check_new_topic(topic),
        msg_type="",
        md5sum="",
        format="" if format is None else format,
        bucket_ns=0,
        nodeID=check_new_node(node),
        ttl=check_ttl(ttl),
        comment=check_text("comment", comment),
        user=check_user_keys({} if user is None else user),
        indexes=dict.fromkeys(check_fields("index", index), ""),
    )


def with_key(wanted: TopicMetadata, key_format: Optional[str], key_part: str) -> TopicMetadata:
    """Return them with the key that was asked for, '' = as the topic is stored."""
    return wanted.with_(key_format=check_key_format(key_format, key_part), key_part=key_part)


@dataclass(frozen=True)
class Wish:
    """What addTopic asked for; kept until the first message tells the type."""

    metadata: TopicMetadata
    """Without a type; key_format '' = as it is stored, else 'time'; indexes are to be made."""
    asked: bool
    """addTopic named the format; else it is the one that is stored."""
    pending: bool
    """Added in this process, perhaps without a table yet."""

    def check(self, stored: TopicMetadata, definition: Optional[Definition]) -> None:
        """Raise TopicExists where the topic is stored in another way than asked for."""
        wrong, wanted = [], self.metadata
        if definition is not None and definition.md5sum != stored.md5sum:
            wrong.append(f"type {stored.msg_type} [{stored.md5sum}]")
        key = (wanted.key_format, wanted.key_part)
        if wanted.key_format and key != (stored.key_format, stored.key_part):
            wrong.append(f"key_format {stored.key_format} {stored.key_part}".rstrip())
        if wanted.ttl and wanted.ttl != stored.ttl:
            wrong.append(f"ttl {stored.ttl} s")
        if wrong:
            raise TopicExists(
                f"topic {stored.topic} is stored already with {', '.join(wrong)}; give the "
                "same, or remove the topic first"
            )
