# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Zones of blocks, which stand in their rows beside the bytes: no block is unpacked for them."""

from __future__ import annotations

from typing import Iterator, NamedTuple, Sequence

from cassandra_ros.store.blocks.block_row import HEADER_COLUMNS, BlockRow, read_block
from cassandra_ros.store.blocks.block_stream import BucketRead, as_portions
from cassandra_ros.store.connection.cql_names import quote_name
from cassandra_ros.store.connection.requests import PagedRead, RawRow
from cassandra_ros.store.tables.row_table import TableRow
from cassandra_ros.store.tables.table_layout import Portion

PAGE_BLOCKS = 5000
BOUNDS_BLOCKS_AT_ONCE = 16
"""Maximum number of blocks that one statement fetches by their keys."""
_WIDTH = HEADER_COLUMNS.count(",") + 1


class BlockZones(NamedTuple):
    """A block of which only the header and zone columns were read."""

    header: BlockRow
    values: RawRow
    """Encoded values of the requested zone columns; None = the block has no such value."""

    @property
    def exact(self) -> bool:
        """Whether the zones hold for the messages that are left in the block."""
        header = self.header
        return header.left == header.messages and not header.odd


def ask_bounds(bucket: BucketRead, columns: Sequence[str]) -> PagedRead:
    """Request the headers of the blocks of a bucket, with some of their zone columns.

    ``read_bounds`` takes the answer.
    """
    return bucket.ask(", ".join([HEADER_COLUMNS, *map(quote_name, columns)]), PAGE_BLOCKS)


def read_bounds(bucket: BucketRead, request: PagedRead) -> Iterator[BlockZones]:
    """Yield the requested blocks that hold messages to be read."""
    for values in request.rows():
        header = read_block(bucket.table, values[:_WIDTH])
        if header is not None and bucket.wants(header):
            yield BlockZones(header, values[_WIDTH:])


def open_blocks(bucket: BucketRead, headers: Sequence[BlockRow]) -> Iterator[TableRow | Portion]:
    """Fetch the messages of blocks of a bucket with known headers."""
    for n in range(0, len(headers), BOUNDS_BLOCKS_AT_ONCE):
        page = bucket.fetch(headers[n : n + BOUNDS_BLOCKS_AT_ONCE]).page()
        yield from as_portions(bucket, bucket.blocks(page))
