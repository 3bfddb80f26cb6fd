# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large messages: their bytes in pieces, written before their row and checked when read."""

from __future__ import annotations

import zlib
from typing import Any, Iterator

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import (
    CHUNK_BYTES,
    RowTable,
    TableRow,
    bind,
    encodeInt,
)

_PAGE_CHUNKS = 4


def isLarge(size: int) -> bool:
    """Say whether a message of this many bytes is stored in chunks."""
    return size > CHUNK_BYTES


def chunkCount(size: int) -> int:
    """Return how many chunks a message of this many bytes has."""
    return -(-size // CHUNK_BYTES)


def checksum(wire: bytes) -> int:
    """CRC-32 of a whole message, unsigned."""
    return zlib.crc32(wire) & 0xFFFFFFFF


def pieces(wire: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (number, bytes) of each chunk of a message."""
    view = memoryview(wire)
    for number in range(chunkCount(len(wire))):
        yield number, bytes(view[number * CHUNK_BYTES : (number + 1) * CHUNK_BYTES])


def readChunks(cassandra: Cassandra, table: RowTable, row: TableRow) -> bytes:
    """Read the bytes of a large message.

    Raises:
        CorruptMessage: Chunks are missing, or size or checksum do not agree with the row.
    """
    bound = bind(table.selectChunks(), table.keyOf(row))
    bound.fetch_size = _PAGE_CHUNKS
    parts = _parts(cassandra, bound, table, row)
    wire = b"".join(parts)
    if len(parts) != row.nchunks or len(wire) != row.size or checksum(wire) != row.crc:
        raise CorruptMessage(
            f"the message of topic {table.metadata.topic} at {row.t} is incomplete: "
            f"{len(parts)} of {row.nchunks} chunks, {len(wire)} of {row.size} bytes"
            f"{'' if len(wire) != row.size else ', wrong checksum'}; repair the cluster, or "
            "import or record it again"
        )
    return wire


def _parts(cassandra: Cassandra, bound: Any, table: RowTable, row: TableRow) -> list[bytes]:
    patience = Patience(f"reading a large message of topic {table.metadata.topic}")
    while True:
        parts: list[bytes] = []
        try:
            for number, data in cassandra.sendRaw(bound).result():
                if number != encodeInt(len(parts)) or len(parts) >= row.nchunks:
                    break
                parts.append(data)
            return parts
        except DRIVER_ERRORS as exc:
            patience.wait(exc)
