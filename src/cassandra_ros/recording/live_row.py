# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are not stored yet, in the form of rows and tables of the query language."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, Mapping, Sequence

from cassandra_ros.errors import CassandraRosError, InvalidOption
from cassandra_ros.keys import Position
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Disk, NamedTime, NamedTimes, Stays
from cassandra_ros.read import Read
from cassandra_ros.topics.message_writer import connection_kind, usable_definition


class _NoRuns:
    """An empty list of runs: a message that is not stored yet belongs to no run."""

    def called(self, text: str) -> frozenset[int]:
        """Return the writer ids of the runs with a name: an empty set."""
        return frozenset()

    def unknown(self, text: str) -> str:
        """Return '': the names of later runs are not known."""
        return ""

    def unknown_robot(self, node: str) -> str:
        """Return '': later robots are not known."""
        return ""

    def text(self, writer: int) -> str:
        """Return '': the message has no run."""
        return ""


class _NoPlaces:
    """A source of places that refuses: places of robots are known for stored messages only."""

    def stays(
        self, disk: Disk, node: str | None = None, writers: frozenset[int] | None = None
    ) -> Stays:
        """Raise InvalidOption."""
        raise InvalidOption(
            "NEAR asks where a robot was, which is known for stored messages only: record the "
            "messages, then query them with NEAR"
        )


class _NoEvents:
    """A source of events that refuses, as that of places does."""

    def called(self, name: str, like: bool, read: Read) -> Iterator[NamedTime]:
        """Raise InvalidOption."""
        raise self._refusal()

    def unknown(self, name: str, like: bool) -> str:
        """Raise InvalidOption."""
        raise self._refusal()

    def times(self, name: str, like: bool, read: Read, others: Sequence[NamedTimes] = ()) -> Stays:
        """Raise InvalidOption."""
        raise self._refusal()

    def _refusal(self) -> InvalidOption:
        return InvalidOption(
            "EVENT asks for events of a robot, which are known for stored messages only: record "
            "the messages, then query them with EVENT"
        )


class LiveTable:
    """The attributes of a table that a condition needs, for messages that are not stored yet."""

    name = ""
    named = False
    by_field = packed = False
    columns: tuple[str, ...] = ()
    longest_text = 0
    runs = _NoRuns()
    places = _NoPlaces()
    events = _NoEvents()

    def __init__(self, connection: Connection) -> None:
        self.definition: Definition | None = None
        """Definition of the messages; None = it cannot be used."""
        try:
            self.definition, _ = usable_definition(connection, FALLBACK_FORMAT)
            self.msg_type, self.name = connection.type, str(connection_kind(connection))
        except CassandraRosError:  # not even a header
            self.msg_type = ""
        self.index_fields: Mapping[str, IndexField] = {}


@dataclass
class LiveRow:
    """The attributes of a row that a condition needs, for a message that is not stored yet."""

    table: LiveTable
    topic: str
    node: str
    t: int
    wire: bytes
    size: int
    seq: int = 0
    name: str = ""
    columns: tuple[bytes | None, ...] = ()
    run: str = ""

    @property
    def key(self) -> Stamp:
        """Time of reception."""
        return Stamp.from_ns(self.t)

    @property
    def position(self) -> Position:
        """Position in the order of reception."""
        return Position(self.t, self.node, 0, "")
