# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are not stored yet, as the query language knows rows and tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import FrozenSet, Mapping, Optional

from cassandra_ros.errors import CassandraRosError, InvalidOption
from cassandra_ros.formats.table import FALLBACK_FORMAT
from cassandra_ros.keys import Position
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Disk, Stays
from cassandra_ros.topics.message_writer import usable_definition


class _NoRuns:
    """Runs by name: a message that is not stored yet belongs to none."""

    def called(self, text: str) -> FrozenSet[int]:
        """Return those of a name: none."""
        return frozenset()


class _NoPlaces:
    """Where a robot was is known of what is stored."""

    def stays(
        self, disk: Disk, node: Optional[str] = None, writers: Optional[FrozenSet[int]] = None
    ) -> Stays:
        """Refuse to answer."""
        raise InvalidOption(
            "NEAR asks where a robot was, and that is known of stored messages only: record them, "
            "and ask then"
        )


class UnstoredTable:
    """What a condition needs of a table, for messages that are in none yet."""

    name = ""
    named = False
    by_field = packed = False
    columns: tuple[str, ...] = ()
    longest_text = 0
    runs = _NoRuns()
    places = _NoPlaces()

    def __init__(self, connection: Connection) -> None:
        self.definition: Optional[Definition] = None
        try:
            self.definition, _ = usable_definition(connection, FALLBACK_FORMAT)
            self.msg_type, self.name = connection.type, connection.md5sum
        except CassandraRosError:  # not even a header
            self.msg_type = ""
        self.index_fields: Mapping[str, IndexField] = {}


@dataclass
class UnstoredRow:
    """What a condition needs of a stored message, for one that is not stored yet."""

    table: UnstoredTable
    topic: str
    node: str
    t: int
    wire: bytes
    size: int
    name: str = ""
    columns: tuple[Optional[bytes], ...] = ()
    run: str = ""

    @property
    def key(self) -> Stamp:
        """When it came."""
        return Stamp.from_ns(self.t)

    @property
    def position(self) -> Position:
        """Its place among what came."""
        return Position(self.t, self.node, 0, "")
