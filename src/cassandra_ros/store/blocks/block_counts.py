# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Number of messages in a bucket of blocks, by the headers of the blocks where possible."""

from __future__ import annotations

from typing import FrozenSet, Iterator, Optional

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.blocks.block_row import (
    HEADER_COLUMNS,
    Block,
    BlockRow,
    ask_blocks,
    read_block,
    read_blocks,
)
from cassandra_ros.store.tables.row_table import ALL, MAX_SEQ, MIN_SEQ, RowTable, encode_long

PAGE_HEADERS = 5000
_AT_ONCE = 16
"""Maximum number of blocks that are fetched and unpacked together."""

Writers = Optional[FrozenSet[int]]
"""Writer ids; None = all."""


def headers(
    table: RowTable,
    node: str,
    bucket: int,
    low: int | None = None,
    high: int | None = None,
    writers: Writers = None,
) -> Iterator[BlockRow]:
    """Read, without their bytes, the blocks with a time range that meets [low, high], ns.

    A table in which each message has its own row has none.

    Args:
        low, high: None = the beginning, or the end, of the bucket.
    """
    if not table.packed:
        return
    begin = bucket * table.metadata.bucket_ns
    ends, terms = list(ALL), []
    if low is not None and low > begin:
        ends[0] = max(begin, low - table.metadata.span_ns), MIN_SEQ
        terms.append(("_last", ">=", encode_long(low)))
    if high is not None:
        ends[1] = high, MAX_SEQ
    request = table.select_range(
        HEADER_COLUMNS,
        table.partition_key(node, bucket),
        (ends[0], ends[1]),
        terms=tuple(terms),
        page_rows=PAGE_HEADERS,
        what="counting",
    )
    for values in request.rows():
        row = read_block(table, values)
        if row is not None and (writers is None or row.writer in writers):
            yield row


def opened(table: RowTable, node: str, bucket: int, rows: Iterator[BlockRow]) -> Iterator[Block]:
    """Read and unpack blocks with known headers; blocks deleted meanwhile are left out.

    Raises:
        CorruptMessage: A block is damaged.
    """
    partition_key = table.partition_key(node, bucket)
    keys = [row.key for row in rows]
    for n in range(0, len(keys), _AT_ONCE):
        request = ask_blocks(table, partition_key, keys[n : n + _AT_ONCE])
        for row in read_blocks(table, request.page()):
            yield Block(table, node, row)


def count_part(
    table: RowTable, node: str, bucket: int, low: int, high: int, writers: Writers = None
) -> int:
    """Count the messages with a time in [low, high]; only blocks at both ends are unpacked."""
    count, edges = 0, []
    for row in headers(table, node, bucket, low, high, writers):
        if low <= row.t and row.last <= high:
            count += row.left
        else:
            edges.append(row)
    ends = (low, MIN_SEQ), (high, MAX_SEQ)
    blocks = opened(table, node, bucket, iter(edges))
    return count + sum(len(block.between(*ends)) for block in blocks)


class RemainingMessages:
    """Number, bytes and time range of the messages that are left in a block.

    Args:
        block: The block, unpacked. None = it is counted by its header: its bytes and its time range
            include deleted messages, and ``largest`` is the mean.

    Attributes:
        largest: Size of the largest message, bytes; 0 = it is in chunks.
    """

    def __init__(self, row: BlockRow, block: Block | None = None) -> None:
        self.count, self.bytes = row.left, row.size
        self.t_min, self.t_max = row.t, row.last
        self.largest = 0 if row.nchunks else -(-row.size // max(row.messages, 1))
        if block is None:
            return
        places = block.between(*ALL)
        self.bytes = int(block.sizes[places].sum())
        if len(places):
            self.t_min, self.t_max = (int(block.times[places[n]]) for n in (0, -1))
            self.largest = 0 if row.nchunks else int(block.sizes[places].max())


def measure(
    table: RowTable, node: str, bucket: int
) -> Iterator[tuple[BlockRow, RemainingMessages]]:
    """Yield the counts of each block; only blocks with deleted messages are unpacked.

    Of these the ones after a damaged block are counted by their headers.
    """
    cut = []
    for row in headers(table, node, bucket):
        if not len(row.gone):
            yield row, RemainingMessages(row)
        elif row.left:
            cut.append(row)
    by_key = {row.key: row for row in cut}
    try:
        for block in opened(table, node, bucket, iter(cut)):
            by_key.pop(block.row.key, None)
            if block.row.left:
                yield block.row, RemainingMessages(block.row, block)
    except CorruptMessage:
        # The headers still tell the number of messages.
        for row in by_key.values():
            yield row, RemainingMessages(row)
