# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tables for new messages: the wish of addTopic, the choice of a format, and making the tables."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Mapping, NamedTuple, Sequence

from cassandra_ros.arguments import (
    check_fields,
    check_key_format,
    check_new_node,
    check_new_topic,
    check_text,
    check_ttl,
    check_user_keys,
)
from cassandra_ros.errors import (
    InvalidKey,
    InvalidName,
    InvalidOption,
    TopicExists,
    TopicNotFound,
    TypeMismatch,
    WriteFailed,
)
from cassandra_ros.keys import NAMED_FORMATS, SECOND_NS
from cassandra_ros.messages.definition import Definition, definition_of
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.metadata import DEFAULT_FORMAT, TopicMetadata, shadow_column
from cassandra_ros.store.tables.lengths import MIN_SPAN_NS, UNKNOWN_SPAN_NS, limit_for_ttl
from cassandra_ros.store.tables.schema import Planner, Schema, TablePlan, TableWish
from cassandra_ros.topics.topic_table import (
    TopicTable,
    TopicTables,
    kind_of,
    stored_format,
    type_texts,
)


def wished_topic(
    topic: str,
    format: str | None,
    node: str = "",
    ttl: int = 0,
    comment: str = "",
    user: Mapping[str, Any] | None = None,
    index: Sequence[str] = (),
) -> TopicMetadata:
    """Check the arguments of addTopic, and return them as metadata without a type."""
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


def with_key(metadata: TopicMetadata, key_format: str | None, key_part: str) -> TopicMetadata:
    """Return metadata with the requested key; '' = as the topic is stored."""
    return metadata.with_(key_format=check_key_format(key_format, key_part), key_part=key_part)


@dataclass(frozen=True)
class Wish:
    """The request of addTopic; kept until the first message tells the type."""

    metadata: TopicMetadata
    """Metadata without a type; key_format '' = as stored, else 'time'; indexes are to be made."""
    has_format: bool
    """Whether addTopic named the format; otherwise it is the stored one."""
    pending: bool
    """Whether it was added in this process and may have no table yet."""

    def check(self, stored: TopicMetadata, definition: Definition | None) -> None:
        """Raise TopicExists if the topic is stored with other values than requested.

        Args:
            stored: Metadata of one of its tables.
            definition: Definition of the requested type; None = no type was requested.
        """
        metadata = self.metadata
        differences = []
        if definition is not None and not definition.kind.fits(kind_of(stored)):
            differences.append(f"type {type_texts(stored, _with_type(metadata, definition))[0]}")
        key = (metadata.key_format, metadata.key_part)
        if metadata.key_format and key != (stored.key_format, stored.key_part):
            differences.append(f"key_format {stored.key_format} {stored.key_part}".rstrip())
        if metadata.ttl and metadata.ttl != stored.ttl:
            differences.append(f"ttl {stored.ttl} s")
        if differences:
            raise TopicExists(
                f"topic {stored.topic} is stored already with {', '.join(differences)}; give the "
                "same, or remove the topic first"
            )


_log = logging.getLogger(__name__)


class NewTable(NamedTuple):
    """A table for new messages: the arguments of NewTables.make."""

    metadata: TopicMetadata
    definition: Definition | None
    large: bool = False


def _table_wish(table: NewTable) -> TableWish:
    """Return what the schema finds a table by, or makes it from."""
    metadata, definition, large = table
    key = (metadata.topic, kind_of(metadata), metadata.format)
    return TableWish(key, planner(metadata, definition), large)


class NewTables:
    """Chooses the tables for new messages of a keyspace, and makes those that are missing."""

    def __init__(self, schema: Schema, tables: TopicTables) -> None:
        self._schema = schema
        self._tables = tables

    def format_for(self, topic: str, md5sum: str = "", format: str | None = None) -> str:
        """Return the format for new messages of a topic.

        It is the requested one (raises UnknownFormat). Without a request it is that of the table
        made last, for this md5 if there is one, so a stored topic stays in its format.
        """
        if format is not None and format != "":
            format_class(format)
            return format
        return self.stored_format(topic, md5sum) or DEFAULT_FORMAT

    def stored_format(self, topic: str, md5sum: str) -> str:
        """Return the format of the table of a topic that was made last; '' = it has no table.

        Of several tables one for this md5 is preferred.
        """
        listing = self._schema.listing()
        tables = [listing.visible[table] for table in listing.by_topic.get(topic, ())]
        return stored_format(tables, md5sum) if tables else ""

    def make(
        self, metadata: TopicMetadata, definition: Definition | None, *, large: bool = False
    ) -> TopicTable:
        """Find the table for a topic, kind and format, or make it.

        Args:
            metadata: Content of its comment. Columns, date and values that are '' or 0 are
                completed here; values of the topic's other tables hold for this one too. Of its
                indexes only the fields count; a field that the type lacks is left out.
            definition: The checked definition, or None.
            large: Make the chunk table too, for which large messages would have to wait later.

        Raises:
            InvalidKey: The type does not have the field key_part, and the topic is new.
            InvalidOption: The format is packed, and the key is not a time.
            WriteFailed: The table was dropped as soon as it was made.
            SchemaConflict, StoreUnavailable: The table cannot be made.
        """
        (name,) = self._schema.ensure_tables([_table_wish(NewTable(metadata, definition, large))])
        table = None if name is None else self._tables.by_name(name)
        if table is None:
            raise WriteFailed(
                f"the table of topic {metadata.topic} was dropped as soon as it was made: another "
                "client removes this topic; try again"
            )
        if large:
            with suppress(TopicNotFound):  # removed meanwhile: the first message gets this error
                self._schema.ensure_chunk_table(table)
        return table

    def make_all(self, tables: Sequence[NewTable]) -> list[TopicTable | None]:
        """Find or make several tables as ``make`` does each, those that are missing together.

        Return them; None = it was dropped as soon as it was made.
        """
        names = self._schema.ensure_tables(list(map(_table_wish, tables)))
        return [None if name is None else self._tables.by_name(name) for name in names]

    def for_wish(self, wish: Wish, definition: Definition) -> TopicTable:
        """Find or make the table for messages of this definition, in the requested format.

        Raises:
            InvalidName: An index is requested on a field that the type lacks.
            TopicExists: Another client has made the topic with other values.
            InvalidKey, InvalidOption, WriteFailed, SchemaConflict, StoreUnavailable: As ``make``.
        """
        for field in wish.metadata.indexes:
            IndexField(definition, field, "")  # raises InvalidName if there is no such field
        table = self.make(_with_type(wish.metadata, definition), definition)
        wish.check(table.metadata, None)  # another client may have made it first
        return table

    def for_message(self, wish: Wish, msg: Any) -> TopicTable:
        """Return the table for a message, made if missing; raises TypeMismatch for a wrong type."""
        topic = wish.metadata.topic
        if not hasattr(type(msg), "_md5sum"):  # also if a class is given in place of an object
            raise TypeMismatch(
                f"{msg!r:.80} is not a message: give topic {topic} a message object, as "
                "std_msgs.msg.String(data='x'); nothing was stored"
            )
        definition = definition_of(type(msg))
        tables = self._tables.of_topic(topic)
        fitting = [table for table in tables if table.kind == definition.kind]
        wished = [t for t in fitting if t.metadata.format == wish.metadata.format]
        if wished or (fitting and not wish.has_format):
            return (wished or fitting)[0]
        if tables and not any(table.kind.fits(definition.kind) for table in tables):
            old, new = type_texts(tables[0].metadata, _with_type(wish.metadata, definition))
            raise TypeMismatch(
                f"topic {topic} holds {old}, the message is {new}; nothing was stored: store "
                "it under another topic"
            )
        return self.for_wish(wish, definition)


def _with_type(metadata: TopicMetadata, definition: Definition) -> TopicMetadata:
    """Return metadata with the type of a definition."""
    return metadata.with_(
        msg_type=definition.type, md5sum=definition.md5sum, definition=definition.text
    )


def planner(metadata: TopicMetadata, definition: Definition | None) -> Planner:
    """Return the planner of a table for NewTables.make, which gets the topic's other metadata."""

    def plan(others: Sequence[TopicMetadata]) -> TablePlan:
        fmt = format_class(metadata.format)(metadata.msg_type, metadata.md5sum, definition)
        planned = _beside(metadata, others)
        if fmt.PACKED:
            check_packed(planned, definition)
            planned = planned.with_(indexes={})
        planned, shadows = _indexed(planned, definition, is_first=not others)
        bucket_ns = planned.bucket_ns or _default_bucket(definition)
        bucket_ns = limit_for_ttl(bucket_ns, planned.ttl)
        planned = planned.with_(
            key_format=planned.key_format or "time",
            bucket_ns=bucket_ns,
            span_ns=_span(planned.span_ns, bucket_ns) if fmt.PACKED else 0,
            columns=tuple(fmt.describe()),
            replaces=(),
            filling=False,
            date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        )
        return planned, fmt.table_columns(), shadows

    return plan


def _beside(metadata: TopicMetadata, others: Sequence[TopicMetadata]) -> TopicMetadata:
    """Return the metadata of a further table of a topic, with values of its other tables."""
    if not others:
        return metadata
    first = others[0]
    kind = kind_of(metadata)
    if all(kind_of(other) != kind for other in others):
        text = "topic %s was stored with type %s and goes on with %s in a table of its own; "
        _log.warning(text + "reading merges both", metadata.topic, *type_texts(first, metadata))
    elif metadata.format not in (formats := {other.format for other in others}):
        old_formats = ", ".join(sorted(formats))
        text = "topic %s is stored in format %s and goes on in format %s in a table of its own; "
        text += "reading merges both, and 'cassandra_bag convert' makes one of them"
        _log.warning(text, metadata.topic, old_formats, metadata.format)
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
    metadata: TopicMetadata, definition: Definition | None, is_first: bool
) -> tuple[TopicMetadata, dict[str, str]]:
    """Return metadata with ``own_time`` and the table's indexes, and the columns of these.

    A key field that is not a time gets the first index, in the shadow column 0.

    Args:
        metadata: Of its indexes only the fields count.
        is_first: Whether the topic has no other table. Then a type without the key field is an
            error; otherwise its messages are found by time.
    """
    fields, shadows = list(metadata.indexes), {}
    metadata = metadata.with_(own_time=metadata.key_format == "hash", indexes={}, index_count=0)
    if metadata.key_format == "msg_part":
        try:
            if definition is None:
                reason = "has no usable definition to find a key field in"
                raise InvalidKey(f"{metadata.msg_type} {reason}")
            key_part = KeyPart(definition, metadata.key_part)
        except InvalidKey as exc:
            if is_first:
                raise
            _log.warning("messages of topic %s: %s; these are found by time", metadata.topic, exc)
        else:
            metadata = metadata.with_(own_time=key_part.is_time)
            if not key_part.is_time:
                metadata = metadata.with_index(key_part.field, 0)
                shadows[shadow_column(0)] = key_part.cql_type
    for field in fields:
        if definition is None or metadata.named or field in metadata.indexes:
            continue
        try:
            index = IndexField(definition, field, shadow_column(metadata.next_shadow))
        except InvalidName as exc:
            _log.info("messages of topic %s are stored without an index: %s", metadata.topic, exc)
            continue
        metadata = metadata.with_index(field, metadata.next_shadow)
        shadows[index.shadow] = index.cql_type
    return metadata, shadows


def check_packed(metadata: TopicMetadata, definition: Definition | None = None) -> None:
    """Raise InvalidOption if messages cannot be in blocks, because their key is not a time.

    Args:
        definition: Their definition; None = unknown, and a key field may be a time.
    """
    key_format, key_part = metadata.key_format, metadata.key_part
    if key_format not in NAMED_FORMATS and key_format != "msg_part":
        return
    if key_format == "msg_part":
        if definition is None:
            return
        try:
            if KeyPart(definition, key_part).is_time:
                return
        except InvalidKey:
            return  # these messages are found by time
    of_part = f"key_part={key_part!r}, which is not a time"
    what = of_part if key_part else f"key_format={key_format!r}"
    raise InvalidOption(
        f"topic {metadata.topic} cannot be kept in format packed, whose messages lie in blocks by "
        f"their time, with {what}: choose another format for it, or key_format='time' for a new "
        "topic"
    )


def _span(span_ns: int, bucket_ns: int) -> int:
    """Return the maximum time range of a block, ns; span_ns 0 = the rate is unknown."""
    return min(max(span_ns or UNKNOWN_SPAN_NS, MIN_SPAN_NS), bucket_ns)


def _default_bucket(definition: Definition | None) -> int:
    """Return the bucket length if the rate is unknown, ns: 1 min for types with arrays."""
    arrays = definition is None or any(
        field.is_array for spec in definition.specs.values() for field in spec.fields
    )
    return (60 if arrays else 600) * SECOND_NS
