# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``ros``: one typed column per field, named by its path (paper, listing 3)."""

from __future__ import annotations

from typing import Sequence

from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.message_stacks import Int64Array
from cassandra_ros.messages.wire.permuter import permuter
from cassandra_ros.messages.wire.wire_plan import wire_plan

INLINE_BYTES = 512 * 1024
"""Of larger messages only the scalar fields get columns: the row holds all bytes anyway."""


class CassandraTopic_ros(CassandraTopic_):
    """Columns that CQL can ask, exact to the bit.

    Arrays of numbers are blobs as on the wire, arrays of messages a list for each field of
    their elements. Where a column cannot give a field back (time with nsecs of 10**9, text that
    is no UTF-8, ...) it is unset and the row also holds the wire bytes. So do all rows of types
    with more than 64 fields, of which only the first 64 scalar ones have columns.
    """

    NAME = "ros"
    BY_FIELD = True
    TOGETHER = True

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self.plan = wire_plan(self._usable())

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the columns in the order of the fields on the wire."""
        return {column.name: column.cql_type for column in self.plan.columns}

    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Walk the bytes once."""
        plan = self.plan
        columns, odd = (plan.walk if len(wire) <= INLINE_BYTES else plan.walk_scalars)(wire)
        return EncodedMessage(columns, odd, wire if odd or not plan.complete else None)

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Turn those of one layout at once."""
        if not self.plan.complete:
            return [None] * len(wires)
        return permuter(self.plan.definition).rows(wires)

    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Build the bytes of the columns, unless the row has them."""
        return self.plan.build(columns) if raw is None else raw

    def decode_together(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> Sequence[bytes | None]:
        """Turn those of one layout back at once."""
        if not self.plan.complete:
            return [None] * len(starts)
        return permuter(self.plan.definition).wires(data, starts, ends, sizes)

    def describe(self) -> list[dict[str, str | None]]:
        """Return what each column holds: field, ROS type, and the array of messages, if any.

        A field without a CQL type has no column and lies in ``_raw`` only.
        """
        types = self.getColValidationClasses()
        keys, every = ("name", "cql", "field", "type", "array"), self.plan.all_columns
        rows = [(c.name, types.get(c.name), c.name, c.field_type, c.array) for c in every]
        return [dict(zip(keys, row)) for row in rows]
