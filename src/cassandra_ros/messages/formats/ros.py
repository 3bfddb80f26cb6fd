# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``ros``: one typed column per field, named by its path (paper, listing 3)."""

from __future__ import annotations

from typing import Sequence

from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.messages.wire.message_stacks import Int64Array
from cassandra_ros.messages.wire.permuter import permuter
from cassandra_ros.messages.wire.wire_plan import wire_plan

INLINE_BYTES = 512 * 1024
"""Maximum size of a message whose lists and arrays get columns, bytes. All bytes of a larger
message are in chunks anyway."""


class CassandraTopic_ros(CassandraTopic_):
    """Columns that CQL queries can compare; together they give back the message exactly.

    Arrays of numbers are blobs as on the wire; an array of messages is a list for each field of its
    elements. If a column cannot hold a field exactly (a time with nsecs of 10**9, text that is not
    UTF-8, ...) it is unset and the row also holds the wire bytes. So do all rows of types with more
    than 64 fields, of which only the first 64 scalar ones have columns.
    """

    NAME = "ros"
    BY_FIELD = True
    TOGETHER = True

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self.plan = wire_plan(self._usable())

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the columns in wire order."""
        return {column.name: column.cql_type for column in self.plan.columns}

    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Return the columns of one message."""
        plan = self.plan
        columns, odd = (plan.walk if len(wire) <= INLINE_BYTES else plan.walk_scalars)(wire)
        return EncodedMessage(columns, odd, wire if odd or not plan.complete else None)

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return the columns of messages, converted together if they share a layout."""
        if not self.plan.complete:
            return [None] * len(wires)
        return permuter(self.plan.definition).rows(wires)

    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return the row's wire bytes if it holds them, else build them from the columns."""
        return self.plan.build(columns) if raw is None else raw

    def decode_together(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> Sequence[bytes | None]:
        """Return the messages of rows, converted together if they share a layout."""
        if not self.plan.complete:
            return [None] * len(starts)
        return permuter(self.plan.definition).wires(data, starts, ends, sizes)

    def describe(self) -> list[dict[str, str | None]]:
        """Return for each column the field, its ROS type, and its array of messages, if any.

        A field without a CQL type has no column; only ``_raw`` holds it.
        """
        types = self.getColValidationClasses()
        keys = ("name", "cql", "field", "type", "array")
        rows = [
            (c.name, types.get(c.name), c.name, c.field_type, c.array)
            for c in self.plan.all_columns
        ]
        return [dict(zip(keys, row)) for row in rows]
