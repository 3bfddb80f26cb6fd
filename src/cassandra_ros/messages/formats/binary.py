# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``binary``: the wire bytes in one column. The fastest format; it needs no definition."""

from __future__ import annotations

import struct
from typing import Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.messages.wire.message_stacks import Int64Array

_pack_size = struct.Struct(">i").pack


class CassandraTopic_binary(CassandraTopic_):
    """The serialised message as a blob."""

    NAME = "binary"
    TOGETHER = True
    COLUMNS = {"_data": "blob"}

    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Return the bytes unchanged, as the only column."""
        return EncodedMessage((wire,), False, None)

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return each message after its size."""
        return [_pack_size(len(wire)) + wire for wire in wires]

    def decode_together(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> Sequence[bytes | None]:
        """Return the column of each row, without its size."""
        bounds = zip(starts.tolist(), ends.tolist())
        return [
            data[at + 4 : end] if data[at : at + 4] == _pack_size(end - at - 4) else None
            for at, end in bounds
        ]

    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return the only column."""
        wire = columns[0] if raw is None else raw
        if wire is None:
            raise CorruptMessage(f"a row of {self.msg_type} in format {self.NAME} has no bytes")
        return wire
