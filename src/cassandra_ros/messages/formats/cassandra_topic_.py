# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interface of all formats (paper section 3.1)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import deserialize, message_class, raw_class, serialize
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.message_stacks import Int64Array
from cassandra_ros.messages.wire.zones import NO_ZONES, ZoneMap, Zones


class EncodedMessage(NamedTuple):
    """The values of a message's row."""

    columns: Sequence[bytes | None]
    """Encoded values in the order of getColValidationClasses; None = unset."""
    odd: bool
    """Whether some column does not hold its field exactly (column ``_odd``)."""
    raw: bytes | None
    """The wire bytes if they cannot be rebuilt from the columns (column ``_raw``), else None."""


class CassandraTopic_(ABC):
    """One storage format of one message type.

    Args:
        msg_type: 'pkg/Name'.
        md5sum: md5 that the connection header gives.
        definition: The checked definition; None if it is unusable.
    """

    NAME: str
    """Name of the format, as users give it and as it is stored in the table's comment."""
    BY_FIELD = False
    """Whether each field has a column of its own, on which conditions can be checked."""
    PACKED = False
    """Whether a row of the table is a block of many messages, as in format ``packed``."""
    TOGETHER = False
    """Whether encode_together is faster than encode_wire for each message."""
    COLUMNS: Mapping[str, str]
    """CQL type of each column by name, if they are the same for all message types."""
    zone_map: ZoneMap | None = None
    """Finds the bounds of the values in a block; None where a row is not a block."""

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        self.msg_type = msg_type
        self.md5sum = md5sum
        self.definition = definition
        self.zones: Callable[[Sequence[bytes]], Zones] = _without_zones
        """Returns the bounds of the values in serialised messages; any bytes will do."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.msg_type}>"

    def _usable(self) -> Definition:
        """Return the definition; DefinitionError: it is unusable."""
        if self.definition is None:
            needs = f"format {self.NAME} needs the definition of {self.msg_type}"
            raise DefinitionError(f"{needs}, which is unusable: use binary")
        return self.definition

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the CQL type of each column by name, in column order."""
        return dict(self.COLUMNS)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in their order."""
        return tuple(self.getColValidationClasses())

    @property
    def zone_columns(self) -> tuple[str, ...]:
        """Names of the columns that bound the values in a block."""
        return () if self.zone_map is None else tuple(self.zone_map.columns)

    def table_columns(self) -> dict[str, str]:
        """Return the CQL type of each column of its tables that not all formats have, by name."""
        return self.getColValidationClasses()

    @abstractmethod
    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Return the column values of a message; accepts any bytes."""

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return for each message its columns as in a request, each after its size.

        None is returned for a message that must be converted by encode_wire: its columns are
        inexact, or it differs from the other messages.
        """
        return [None] * len(wires)

    def decode_together(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> Sequence[bytes | None]:
        """Return the messages of many rows, like decode_wire for each.

        Args:
            data: Buffer with the columns of the rows, each column after its size.
            starts: Offset of each row.
            ends: Offset after each row.
            sizes: Size of each message, bytes.

        Returns:
            The messages; None for each that must be decoded by decode_wire, because its row may be
            malformed.
        """
        return [None] * len(starts)

    @abstractmethod
    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return exactly the wire bytes that were stored in a row.

        CorruptMessage: malformed row.
        """

    def describe(self) -> list[dict[str, str | None]]:
        """Return the description of each column for the table's comment."""
        return []

    def require_class(self) -> None:
        """Check that message objects can be made; else raise DefinitionError."""
        if self.definition is None:
            raise DefinitionError(f"the definition of {self.msg_type} is unusable")
        message_class(self.definition)

    def encode(self, msg: Any) -> EncodedMessage:
        """Return the column values of a message.

        TypeMismatch: a value does not fit its field's type.
        """
        return self.encode_wire(serialize(msg))

    def decode(self, encoded: EncodedMessage) -> Any:
        """Return the message of column values; its bytes if the definition is unusable.

        Raises CorruptMessage: the values are malformed; DefinitionError: the type's class cannot be
            made.
        """
        wire = self.decode_wire(encoded.columns, encoded.raw)
        definition = self.definition
        cls = (
            raw_class(self.msg_type, self.md5sum)
            if definition is None
            else message_class(definition)
        )
        return deserialize(cls, wire)


def _without_zones(wires: Sequence[bytes]) -> Zones:
    return NO_ZONES
