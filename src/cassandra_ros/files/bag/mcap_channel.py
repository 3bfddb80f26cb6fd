# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Convert a ROS 1 connection to a schema and a channel of an MCAP and back, byte for byte.

Schema and channel follow MCAP's profile ``ros1``. The other fields of the connection header are the
metadata of the channel. If header or number cannot be computed from these, they are stored in two
metadata fields of our own, see HEADER_FIELD and NUMBER.
"""

from __future__ import annotations

import base64
from typing import NamedTuple

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from cassandra_ros.errors import BagError, CassandraRosError
from cassandra_ros.files.bag.bag_reader import check_header
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import (
    Connection,
    cut_definition,
    join_definition,
    live_connection,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import ANY_MD5

HEADER_FIELD = "cassandra_ros.header"
"""Name of the metadata field with the offset of the message definition in the header, and the
header without the definition in base64: ``20:EAAA…``."""
NUMBER = "cassandra_ros.number"
"""Name of the metadata field with the connection number, if this is not the channel's id."""

_TRUTH = {"true": "1", "false": "0"}
"""Values of the field ``latching``: in the profile ``ros1`` -> in a ROS connection header."""


class ChannelText(NamedTuple):
    """The fields of a schema and a channel, without their ids and the topic."""

    type: str
    definition: bytes
    metadata: dict[str, str]
    """Metadata of the channel."""


def to_channel(connection: Connection) -> ChannelText:
    """Return the schema and channel of a connection, by which to_connection gets the same header.

    The caller adds the metadata field NUMBER where the channel gets another id.

    Raises:
        CorruptMessage: The header of the connection is malformed. check_header refuses such.
    """
    header, offset, definition = cut_definition(connection.header)
    metadata = {}
    for name, value in sorted(connection.fields.items()):
        if name not in ("topic", "type", "message_definition") and _is_text(name, value):
            metadata[name] = value.decode("utf-8")
    if metadata.get("latching") in _TRUTH.values():
        metadata["latching"] = "true" if connection.latching else "false"
    type_name = connection.type
    if not _is_text(type_name, b""):
        type_name = type_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    text = ChannelText(type_name, definition, metadata)
    if _header(connection.topic, text) != connection.header:
        metadata[HEADER_FIELD] = f"{offset}:{base64.b64encode(header).decode('ascii')}"
    return text


def to_connection(channel: Channel, schema: Schema | None) -> Connection:
    """Return the connection of a ROS 1 channel.

    Raises:
        BagError: The metadata fields HEADER_FIELD or NUMBER are damaged, or the header.
    """
    connection = unchecked_connection(channel, schema)
    check_header(connection.header, _place(channel))
    return connection


def unchecked_connection(channel: Channel, schema: Schema | None, where: str = "") -> Connection:
    """Return the connection of a ROS 1 channel, whose header check_header may refuse.

    Args:
        schema: The schema of the channel; None = it has none.
        where: Name of the file in the error text; '' = the caller names it.

    Raises:
        BagError: The metadata fields HEADER_FIELD or NUMBER are damaged.
    """
    place = _place(channel, where)
    text = ChannelText("", b"", channel.metadata)
    if schema is not None:
        text = ChannelText(schema.name, schema.data, channel.metadata)
    try:
        header = _header(channel.topic, text)
        if HEADER_FIELD in channel.metadata:
            header = _stored_header(channel.metadata[HEADER_FIELD], text.definition)
        number = int(channel.metadata.get(NUMBER, channel.id))
        if not 0 <= number < 2**32:
            raise ValueError(f"{number} is out of range")
    except ValueError as exc:
        raise BagError(
            f"{place} is damaged: its metadata {HEADER_FIELD} or {NUMBER}: {exc}"
        ) from exc
    return Connection(channel.topic, header, number)


def _place(channel: Channel, where: str = "") -> str:
    return f"{where + ': ' if where else ''}channel {channel.id} (topic {channel.topic})"


def why_foreign(channel: Channel, schema: Schema | None) -> str:
    """Return why the messages of a channel are not ROS 1 messages, in words; '' = they are."""
    if channel.message_encoding != MessageEncoding.ROS1:
        return f"its messages are encoded as {channel.message_encoding!r}, not 'ros1'"
    if schema is None and not channel.metadata.get("type"):
        return "it has no schema, which would name its type"
    if schema is not None and schema.encoding != SchemaEncoding.ROS1:
        return f"its schema is written in {schema.encoding!r}, not 'ros1msg'"
    return ""


def _header(topic: str, text: ChannelText) -> bytes:
    """Build the connection header of a channel; its fields are sorted as in roscpp.

    to_channel and to_connection both use it: if its result changes, files that were written without
    HEADER_FIELD give other headers.
    """
    fields: dict[str, str | bytes] = {"topic": topic, "type": text.type, **text.metadata}
    for name in (HEADER_FIELD, NUMBER):
        fields.pop(name, None)
    latching = fields.get("latching")
    if isinstance(latching, str):
        fields["latching"] = _TRUTH.get(latching, latching)
    fields.setdefault("md5sum", _md5sum(str(fields["type"]), text.definition))
    fields["message_definition"] = text.definition
    return live_connection(topic, dict(sorted(fields.items()))).header


def _md5sum(type_name: str, definition: bytes) -> str:
    """Return the md5 of a definition; ANY_MD5 if it cannot be computed."""
    text = definition.decode("utf-8", "surrogateescape")
    try:
        # A writer may leave out the definition. Then the installed type is the best guess.
        parsed = (
            parse_definition(type_name, text) if text.strip() else installed_definition(type_name)
        )
        return parsed.md5sum
    except CassandraRosError:
        return ANY_MD5  # the md5sum of a subscriber that accepts any type


def _stored_header(text: str, definition: bytes) -> bytes:
    """Return the header in a metadata field HEADER_FIELD; raises ValueError if it is damaged."""
    offset, _, coded = text.partition(":")
    return join_definition(base64.b64decode(coded, validate=True), int(offset), definition)


def _is_text(name: str, value: bytes) -> bool:
    """Return whether the metadata of a channel, which are UTF-8, can hold a field."""
    try:
        name.encode("utf-8")
        value.decode("utf-8")
    except UnicodeError:
        return False
    return True
