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
from cassandra_ros.store.tables.directory import BucketTotals
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


def recount(table: RowTable, node: str, bucket: int) -> dict[int, BucketTotals]:
    """Count the messages of a bucket by writer id; only blocks with deleted messages are unpacked.

    Of these the ones after a damaged block are counted by their headers: their bytes and time range
    include deleted messages. ``largest`` of a block that is not unpacked is its mean.
    """
    by_writer: dict[int, BucketTotals] = {}

    def add(row: BlockRow, block: Block | None = None) -> None:
        nbytes, ends, largest = row.size, (row.t, row.last), -(-row.size // max(row.messages, 1))
        if block is not None:
            places = block.between(*ALL)
            sizes, times = block.sizes[places], block.times[places]
            nbytes, largest = int(sizes.sum()), int(sizes.max())
            ends = int(times[0]), int(times[-1])
        totals = by_writer.setdefault(row.writer, BucketTotals())
        totals.add(row.left, nbytes, 0 if row.nchunks else largest, ends, row.odd)

    cut = []
    for row in headers(table, node, bucket):
        if not len(row.gone):
            add(row)
        elif row.left:
            cut.append(row)
    by_key = {row.key: row for row in cut}
    try:
        for block in opened(table, node, bucket, iter(cut)):
            by_key.pop(block.row.key, None)
            if block.row.left:
                add(block.row, block)
    except CorruptMessage:
        # The headers still tell the number of messages.
        for row in by_key.values():
            add(row)
    return by_writer
