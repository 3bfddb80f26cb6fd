# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every format can do (paper section 3.1)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Mapping, NamedTuple, Sequence

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import deserialize, message_class, raw_class, serialize
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.message_stacks import Int64Array


class EncodedMessage(NamedTuple):
    """A message as the values of its row."""

    columns: Sequence[bytes | None]
    """Values in CQL's encoding, in the order of getColValidationClasses; None = left unset."""
    odd: bool
    """Whether some field is not held exactly in its column (``_odd``)."""
    raw: bytes | None
    """The wire bytes where the columns cannot give them back (``_raw``), else None."""


class CassandraTopic_(ABC):
    """One storage format of one message type.

    Args:
        msg_type: 'pkg/Name'.
        md5sum: As the connection says.
        definition: The checked definition; None when it is unusable.
    """

    NAME: str
    """By which it is chosen, and stored in the comment."""
    BY_FIELD = False
    """Whether each field has a column of its own, which conditions can be checked on."""
    PACKED = False
    """Whether a row of the table is a block of many messages; see ``formats/packed.py``."""
    TOGETHER = False
    """Whether many messages are turned into rows quicker than one by one."""
    COLUMNS: Mapping[str, str]
    """CQL type of each column by name, where all types of messages have the same."""

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        self.msg_type = msg_type
        self.md5sum = md5sum
        self.definition = definition

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.msg_type}>"

    def _usable(self) -> Definition:
        """Return the definition, or raise DefinitionError where it is unusable."""
        if self.definition is None:
            needs = f"format {self.NAME} needs the definition of {self.msg_type}"
            raise DefinitionError(f"{needs}, which is unusable: use binary")
        return self.definition

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the CQL type of each column by name, in the order of the columns."""
        return dict(self.COLUMNS)

    def table_columns(self) -> dict[str, str]:
        """Return the CQL type of each column that its tables have beside those of all formats."""
        return self.getColValidationClasses()

    @abstractmethod
    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Turn wire bytes into column values; never fails, whatever the bytes are."""

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return of each message its columns as they stand in a request, each behind its size.

        None is given for a message that encode_wire is to turn: it is not exact in its columns,
        or not like the others.
        """
        return [None] * len(wires)

    def decode_together(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> Sequence[bytes | None]:
        """Return the messages of many rows, of these sizes, as decode_wire does.

        Args:
            data: In which the columns of each lie from one of the starts to one of the ends, each
                column behind its size.

        Returns:
            None for a message that decode_wire is to make, also where there may be none.
        """
        return [None] * len(starts)

    @abstractmethod
    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return the wire bytes of a row, exactly as they were, or raise CorruptMessage."""

    def describe(self) -> list[dict[str, str | None]]:
        """Return what the table's comment says about each column."""
        return []

    def require_class(self) -> None:
        """Make sure that message objects can be made, or raise DefinitionError."""
        if self.definition is None:
            raise DefinitionError(f"the definition of {self.msg_type} is unusable")
        message_class(self.definition)

    def encode(self, msg: Any) -> EncodedMessage:
        """Turn a message into column values; TypeMismatch: a field holds what its type cannot."""
        return self.encode_wire(serialize(msg))

    def decode(self, encoded: EncodedMessage) -> Any:
        """Turn column values into a message; bytes only where the definition is unusable.

        Raises CorruptMessage: they are none; DefinitionError: no class can be made of the type.
        """
        wire = self.decode_wire(encoded.columns, encoded.raw)
        known = self.definition
        cls = raw_class(self.msg_type, self.md5sum) if known is None else message_class(known)
        return deserialize(cls, wire)
