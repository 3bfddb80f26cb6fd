# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of one bucket of blocks, in order from either end.

Blocks of several writers and connections overlap. So a message is yielded as soon as no block that
is still to be read can hold an earlier one. Whole buckets are read by pages of blocks. A read of
few messages or of few blocks, or one in descending order, first reads the headers and then the
blocks in the order in which it needs them.
"""

from __future__ import annotations

from typing import Iterator, List, Optional, Sequence, Tuple

from cassandra_ros.blocks.block_queue import BlockQueue, Headers, downwards, upwards
from cassandra_ros.blocks.block_row import WHOLE, BlockRow
from cassandra_ros.blocks.bucket_read import (
    BLOCK_BYTES,
    GROWTH,
    MAX_BLOCKS,
    BucketRead,
    OpenedBlock,
    WaitingRows,
    key_of,
)
from cassandra_ros.connection.paging import PagedRead, RawRow
from cassandra_ros.connection.protocol import RawPage
from cassandra_ros.tables.row_table import Order, TableRow

ROWS_AT_ONCE = 200


def stream(part: BucketRead) -> Iterator[TableRow]:
    """Yield the rows of a bucket in the order (t, seq), or newest first.

    Sends the request at once.
    """
    if part.filters is None and not part.reverse and not part.wanted:
        return _whole(part, _Pages(part))
    needed = BlockQueue(part, Headers(part))
    return downwards(part, needed) if part.reverse else upwards(part, needed)


def opened(part: BucketRead) -> Iterator[OpenedBlock]:
    """Yield the blocks of a bucket in the order of their keys; sends the request at once."""
    return _opened(part, _Pages(part))


def _opened(part: BucketRead, pages: _Pages) -> Iterator[OpenedBlock]:
    for blocks, _ in pages:
        for block in blocks:
            found = part.open(block)
            if found.left:
                yield found


class _Pages:
    """All blocks of a bucket, page by page; the next page is requested ahead."""

    def __init__(self, part: BucketRead) -> None:
        self._part = part
        self._count = max(1, part.page_bytes // BLOCK_BYTES)
        self._asked: Optional[PagedRead] = part.ask(WHOLE, self._count)

    def __iter__(self) -> Iterator[Tuple[List[BlockRow], Optional[Order]]]:
        """Yield blocks, and a key that all blocks of later pages lie after.

        None = the last page.
        """
        while self._asked is not None:
            asked = self._asked
            page: Sequence[RawRow] = next((p for p in asked.pages(ahead=False) if p), ())
            # All are unpacked before the next page is read, so their bytes need not be copied.
            blocks = self._part.blocks(page.views() if isinstance(page, RawPage) else page)
            self._asked = None
            if not page or not asked.more:
                yield blocks, None
                return
            if blocks:
                mean = sum(block.size for block in blocks) // len(blocks) + 1
                most = min(MAX_BLOCKS, GROWTH * self._count)
                self._count = max(1, min(most, self._part.page_bytes // mean))
            self._asked = self._part.ask(WHOLE, self._count, page[-1])
            yield blocks, key_of(page[-1])


def _whole(part: BucketRead, pages: _Pages) -> Iterator[TableRow]:
    held = WaitingRows()
    for blocks, behind in pages:
        keys: List[Optional[Order]] = [*(block.key for block in blocks[1:]), behind]
        for block, bound in zip(blocks, keys):
            opened = part.open(block)
            if not held and opened.left and (bound is None or opened.last < bound[0]):
                # The block overlaps no other. Its rows are made in small groups, because Python's
                # collector walks through all rows that exist at the same time.
                while opened.left:
                    yield from part.rows(opened.take(ROWS_AT_ONCE, reverse=False))
                continue
            held.add(part.rows(opened))
            yield from held.rest() if bound is None else held.until(bound, part.node)
        if behind is None:
            break
    yield from held.rest()
