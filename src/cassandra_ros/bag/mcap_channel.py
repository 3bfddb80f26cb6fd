# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A connection of ROS 1 as schema and channel of an MCAP, and back, byte for byte.

Schema and channel are those of MCAP's profile ``ros1``. The other fields of the connection's
header are the metadata of its channel. Where header and number do not follow from these, two fields
of ours say what they are, see HEADER and NUMBER.
"""

from __future__ import annotations

import base64
from typing import NamedTuple

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from cassandra_ros.bag.bag_index import check_header
from cassandra_ros.errors import BagError, CassandraRosError
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import (
    Connection,
    cut_definition,
    join_definition,
    live_connection,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import ANY_MD5

HEADER = "cassandra_ros.header"
"""The header in base64 without its definition, and at which byte that stood: ``20:EAAA…``."""
NUMBER = "cassandra_ros.number"
"""Number of the connection, where it is not the channel's id."""

_TRUTH = {"true": "1", "false": "0"}
"""How the profile writes the field ``latching``, and how ROS does."""


class ChannelText(NamedTuple):
    """What a schema and a channel are registered with, but their ids."""

    type: str
    definition: bytes
    metadata: dict[str, str]


def to_channel(connection: Connection) -> ChannelText:
    """Describe a connection; its number is left to the writer, who knows the channel's id."""
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
    found = ChannelText(type_name, definition, metadata)
    if _header(connection.topic, found) != connection.header:
        metadata[HEADER] = f"{offset}:{base64.b64encode(header).decode('ascii')}"
    return found


def to_connection(channel: Channel, schema: Schema | None, where: str) -> Connection:
    """Return the connection that a channel of ROS 1 stands for.

    Raises:
        BagError: Our own fields in its metadata are damaged.
    """
    place = f"{where}: channel {channel.id} (topic {channel.topic})"
    text = ChannelText("", b"", channel.metadata)
    if schema is not None:
        text = ChannelText(schema.name, schema.data, channel.metadata)
    try:
        header = _header(channel.topic, text)
        if HEADER in channel.metadata:
            header = _kept_header(channel.metadata[HEADER], text.definition)
        number = int(channel.metadata.get(NUMBER, channel.id))
        if not 0 <= number < 2**32:
            raise ValueError(f"{number} is out of range")
    except ValueError as exc:
        raise BagError(f"{place} is damaged: its metadata {HEADER} or {NUMBER}: {exc}") from exc
    check_header(header, place)
    return Connection(channel.topic, header, number)


def why_foreign(channel: Channel, schema: Schema | None) -> str:
    """Say in a few words why the messages of a channel are none of ROS 1; '' = they are."""
    if channel.message_encoding != MessageEncoding.ROS1:
        return f"its messages are encoded as {channel.message_encoding!r}, not 'ros1'"
    if schema is None and not channel.metadata.get("type"):
        return "it has no schema, which would name its type"
    if schema is not None and schema.encoding != SchemaEncoding.ROS1:
        return f"its schema is written in {schema.encoding!r}, not 'ros1msg'"
    return ""


def _header(topic: str, text: ChannelText) -> bytes:
    """Build the header that a channel stands for, its fields sorted as roscpp has them."""
    fields: dict[str, str | bytes] = {"topic": topic, "type": text.type, **text.metadata}
    for name in (HEADER, NUMBER):
        fields.pop(name, None)
    latching = fields.get("latching")
    if isinstance(latching, str):
        fields["latching"] = _TRUTH.get(latching, latching)
    fields.setdefault("md5sum", _md5sum(str(fields["type"]), text.definition))
    fields["message_definition"] = text.definition
    return live_connection(topic, dict(sorted(fields.items()))).header


def _md5sum(type_name: str, definition: bytes) -> str:
    text = definition.decode("utf-8", "surrogateescape")
    try:
        # Who has no definition leaves it out; an installed type then is the best guess.
        known = (
            parse_definition(type_name, text) if text.strip() else installed_definition(type_name)
        )
        return known.md5sum
    except CassandraRosError:
        return ANY_MD5  # as a subscriber says who takes any


def _kept_header(text: str, definition: bytes) -> bytes:
    offset, _, coded = text.partition(":")
    return join_definition(base64.b64decode(coded, validate=True), int(offset), definition)


def _is_text(name: str, value: bytes) -> bool:
    try:
        name.encode("utf-8")
        value.decode("utf-8")
    except UnicodeError:
        return False
    return True
