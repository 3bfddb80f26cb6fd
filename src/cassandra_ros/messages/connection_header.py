# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Connection headers: who publishes what on a topic, kept byte for byte."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Iterator, Mapping

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition

_LENGTH = struct.Struct("<I")
_DEFINITION = b"message_definition"
"""Name of the field that cut_definition cuts out."""
LATCHED_FROM = "latched_from"
"""Name of a header field that only bags have. It marks the connection of a message that was latched
before the first message of the bag, and holds the receive time of that message, ns since 1970."""
ROBOT = "cassandra_ros.node"
"""Name of a header field that only exported files of several robots have: the robot (nodeID) whose
messages came over the connection."""


def _text_field(name: str) -> cached_property[str]:
    """Return the property of a Connection that is one of its ``fields``, '' without that field."""
    return cached_property(lambda connection: _text(connection.fields.get(name, b"")))


@dataclass(frozen=True)
class Connection:
    """One publisher's connection to a topic.

    Properties that read the header raise CorruptMessage where ``fields`` does, if they do not say
    otherwise.
    """

    topic: str
    header: bytes
    """Header fields as ROS writes them: for each a uint32 length (little endian) and name=value."""
    number: int = -1
    """Number of the connection in its bag; -1 for a live connection."""

    @cached_property
    def fields(self) -> dict[str, bytes]:
        """The header fields by name. CorruptMessage: the bytes are not a connection header."""
        return {_text(name): value for name, value, _ in _walk(self.header, self.topic)}

    type = _text_field("type")
    """Message type, 'pkg/Name', not checked; '' when the header has no such field."""
    md5sum = _text_field("md5sum")
    """md5 of the definition as the publisher gave it; '' when the header has no such field."""
    definition_text = _text_field("message_definition")
    """Message definition; bytes that are not UTF-8 are kept as surrogates."""
    callerid = _text_field("callerid")
    """Name of the publishing node; '' when the header has no such field."""

    @cached_property
    def latching(self) -> bool:
        """Whether the publisher latches its last message."""
        return self.fields.get("latching") == b"1"

    @property
    def from_before(self) -> bool:
        """Whether the message was latched before the bag's first message, see latched_from.

        False for a malformed header.
        """
        try:
            return LATCHED_FROM in self.fields
        except CorruptMessage:
            return False  # latched_from writes only well-formed headers

    def latched_from(self, received_ns: int) -> Connection:
        """Return the connection for a message that was latched before the first message of a bag.

        A connection that is already marked is returned unchanged.

        Args:
            received_ns: Receive time of that message, ns since 1970.
        """
        if self.from_before:
            return self
        return self._with_field(LATCHED_FROM, str(received_ns))

    def of_robot(self, node: str) -> Connection:
        """Return the connection with the field ROBOT, as a file of several robots has it."""
        return replace(self._with_field(ROBOT, node), number=self.number)

    @property
    def robot(self) -> str | None:
        """Robot in the field ROBOT, '' = one without name; None = no such field, or malformed."""
        try:
            name = self.fields.get(ROBOT)
        except CorruptMessage:
            return None  # of_robot writes only well-formed headers
        return None if name is None else _text(name)

    def _with_field(self, name: str, value: str) -> Connection:
        """Return the connection with one more field; it has no number."""
        field = _bytes(name) + b"=" + _bytes(value)
        return Connection(self.topic, self.header + _LENGTH.pack(len(field)) + field)


def live_connection(topic: str, header: Mapping[str, str | bytes]) -> Connection:
    """Make a connection from rospy's ``_connection_header``; any field may be missing."""
    fields = [_bytes(name) + b"=" + _bytes(value) for name, value in header.items()]
    return Connection(topic, b"".join(_LENGTH.pack(len(field)) + field for field in fields))


def api_connection(topic: str, definition: Definition, callerid: str) -> Connection:
    """Make the connection of the messages that addData stores."""
    header = {"topic": topic, "type": definition.type, "md5sum": definition.md5sum}
    header.update(message_definition=definition.text, callerid=callerid)
    return live_connection(topic, header)


def cut_definition(header: bytes) -> tuple[bytes, int, bytes]:
    """Cut the value of message_definition out of a header.

    Return the header without the value, the value's offset (-1: no such field, or a malformed
    header) and the value. The field's length prefix stays unchanged, so that join_definition is
    the exact inverse.
    """
    try:
        definitions = [(value, at) for name, value, at in _walk(header, "") if name == _DEFINITION]
    except CorruptMessage:
        definitions = []
    if not definitions:
        return header, -1, b""
    definition, offset = definitions[-1]
    return header[:offset] + header[offset + len(definition) :], offset, definition


def join_definition(header_without: bytes, offset: int, definition: bytes) -> bytes:
    """Put the definition back where cut_definition cut it out."""
    rest = header_without
    return rest if offset < 0 else rest[:offset] + definition + rest[offset:]


def _walk(header: bytes, topic: str) -> Iterator[tuple[bytes, bytes, int]]:
    """Yield name, value and offset of the value of each field; CorruptMessage: it is malformed."""
    at, what = 0, f"the connection header of {topic or 'a topic'} is"
    while at < len(header):
        if at + 4 > len(header):
            raise CorruptMessage(f"{what} cut short")
        (length,) = _LENGTH.unpack_from(header, at)
        field = header[at + 4 : at + 4 + length]
        name, equals, value = field.partition(b"=")
        if len(field) != length or not equals:
            raise CorruptMessage(f"{what} malformed at byte {at}")
        yield name, value, at + 4 + len(name) + 1
        at += 4 + length


def _text(value: bytes) -> str:
    return value.decode("utf-8", "surrogateescape")


def _bytes(value: str | bytes) -> bytes:
    """Return a text as bytes, the inverse of _text."""
    if isinstance(value, bytes):
        return value
    try:
        return value.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return value.encode("utf-8", "surrogatepass")
