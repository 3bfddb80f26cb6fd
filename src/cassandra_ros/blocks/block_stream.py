# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of one bucket of blocks, in order from either end.

Blocks of several writers and connections overlap. So a message is yielded as soon as no block that
is still to be read can hold an earlier one. Whole buckets are read by pages of blocks. A read of
few messages or of few blocks, or one in descending order, first reads the headers and then the
blocks in the order in which it needs them (``BlockQueue``).
"""

from __future__ import annotations

import heapq
import logging
from typing import Iterator, Sequence, Union

from cassandra_ros.blocks.block_row import HEADER, WHOLE, BlockRow
from cassandra_ros.blocks.bucket_read import (
    BLOCK_BYTES,
    GROWTH,
    MAX_BLOCKS,
    BucketRead,
    OpenedBlock,
    WaitingRows,
    key_of,
)
from cassandra_ros.connection.driver_errors import DRIVER_ERRORS
from cassandra_ros.connection.paging import PagedRead, RawRow
from cassandra_ros.connection.protocol import RawPage
from cassandra_ros.errors import SchemaConflict
from cassandra_ros.tables.row_table import MAX_SEQ, MIN_SEQ, Order, TableRow, Terms

_log = logging.getLogger(__name__)

MAX_AT_ONCE = 100
"""Maximum number of blocks that one statement fetches by their keys."""
FIRST_HEADERS = 16
"""Number of headers in the first page of a read of few messages; later pages are larger."""
MAX_HEADERS = 5000
FEW_ROWS = 8
"""Minimum number of rows that are made of a block in a read of few messages."""

_Item = Union[BlockRow, OpenedBlock]
"""A block that has to be fetched, or the rest of a block of which some messages were taken."""


class Headers:
    """Reads the headers of the blocks of a bucket, in the order of reading, as far as needed."""

    def __init__(self, part: BucketRead) -> None:
        self._part = part
        self._count = FIRST_HEADERS if part.wanted else MAX_HEADERS
        self._filters = part.filters
        if part.filters is not None:
            self._asked = self._filtered(part.filters)
        else:
            self._asked = [part.ask(HEADER, self._count)]
        # Sent together with the headers, which saves a round trip.
        early = part.wanted and part.filters is None
        self._early = part.ask(WHOLE, part.early) if early else None
        self.more = bool(self._asked)
        self.last: Order | None = None
        """Key of the last block whose header was read."""
        self._behind: RawRow | None = None

    def take_early(self) -> PagedRead | None:
        """Return, once, the read of the first whole blocks; None = there is no such read."""
        early, self._early = self._early, None
        return early

    def _filtered(self, filters: Sequence[Terms]) -> list[PagedRead]:
        try:
            return [self._part.ask(HEADER, MAX_HEADERS, terms=terms) for terms in filters]
        except SchemaConflict as exc:
            return self._unfiltered(exc)

    def _unfiltered(self, exc: object) -> list[PagedRead]:
        """Read the headers of all blocks, if a server forbids filtering or is too slow at it."""
        topic = self._part.table.metadata.topic
        _log.info("topic %s is read whole, the server does not filter it: %s", topic, exc)
        self._filters = None
        return [self._part.ask(HEADER, MAX_HEADERS)]

    def read(self) -> list[BlockRow]:
        """Read the next page of headers."""
        if self._filters is not None:
            return self._every()
        if not self._asked:
            self._count = min(MAX_HEADERS, GROWTH * self._count)
            self._asked = [self._part.ask(HEADER, self._count, self._behind)]
        asked = self._asked.pop()
        page: Sequence[RawRow] = next((p for p in asked.pages(ahead=False) if p), ())
        self.more = bool(page) and asked.more
        if self.more:
            self._behind, self.last = page[-1], key_of(page[-1])
        return self._part.blocks(page)

    def _every(self) -> list[BlockRow]:
        """Read all headers that pass one of the filters, some 100 bytes a block."""
        self.more = False
        try:
            rows = [row for asked in self._asked for row in asked.rows()]
        except DRIVER_ERRORS as exc:
            rows = list(self._unfiltered(exc)[0].rows())
        found = {block.key: block for block in self._part.blocks(rows)}
        return [found[key] for key in sorted(found, reverse=self._part.reverse)]


class _Batch:
    """Blocks that are being fetched, in the order in which they are needed.

    Args:
        wanted: Number of messages that the read takes from them; 0 = all.
        early: A read that was sent before, which may return some of the blocks.
    """

    def __init__(
        self, part: BucketRead, taken: list[_Item], wanted: int, early: PagedRead | None = None
    ) -> None:
        self._part = part
        self.taken, self.wanted = taken, wanted
        self._open = [item for item in taken if isinstance(item, OpenedBlock)]
        headers = [item for item in taken if isinstance(item, BlockRow)]
        self._here: list[BlockRow] = []
        if early is not None:
            keys = {header.key for header in headers}
            self._here = [row for row in part.blocks(early.page()) if row.key in keys]
        here = {row.key for row in self._here}
        missing = [header for header in headers if header.key not in here]
        self._asked = part.fetch(missing) if missing else None

    def blocks(self) -> Iterator[OpenedBlock]:
        """Yield the blocks, unpacked."""
        yield from self._open
        came = [] if self._asked is None else self._part.blocks(self._asked.page())
        for row in self._here + came:
            opened = self._part.open(row)
            if opened.left:
                yield opened


class BlockQueue:
    """The blocks of a bucket that still have messages to yield, in the order of need.

    In ascending order this is the order of their first messages, in which they are stored. In
    descending order it is that of their last messages, because an earlier block may end later.
    """

    def __init__(self, part: BucketRead, headers: Headers) -> None:
        self._part = part
        self._headers = headers
        self._known: list[tuple[Order, int, _Item]] = []
        self._count = 0
        self._wanted, self._bytes = part.wanted, part.page_bytes
        if part.wanted:
            self._bytes = min(part.page_bytes, BLOCK_BYTES)

    def batch(self) -> _Batch | None:
        """Request the blocks that are needed next; None if all blocks were read."""
        while self._headers.more and not self._is_known():
            self.read()
        taken, wanted = self._take(), self._wanted
        if self._part.wanted:
            self._wanted *= GROWTH
            self._bytes = min(self._part.page_bytes, GROWTH * self._bytes)
        early = self._headers.take_early()
        return _Batch(self._part, taken, wanted, early) if taken else None

    def read(self) -> None:
        """Read more headers."""
        for header in self._headers.read():
            self._add(header)

    def _add(self, item: _Item) -> None:
        self._count += 1
        turn = (-self._end(item), 0) if self._part.reverse else item.key
        heapq.heappush(self._known, (turn, self._count, item))

    def _end(self, item: _Item) -> int:
        """Return the time of the last message of a block that is in the range to be read."""
        return min(item.last, self._part.ends[1][0])

    def rows(self, batch: _Batch) -> Iterator[list[TableRow]]:
        """Yield rows of each block; of a large block only as many as are wanted, the rest later."""
        for block in batch.blocks():
            taken = block
            if batch.wanted and block.block is not None:
                taken = block.take(max(FEW_ROWS, batch.wanted), reverse=self._part.reverse)
                if block.left:
                    self._add(block)
            yield self._part.rows(taken)

    def _is_known(self) -> bool:
        """Return whether no block with an unread header is needed before the first known one."""
        if self._part.reverse:
            return bool(self._known) and -self._known[0][0][0] > self._unread_end
        # Only the next header tells up to which key the first block can be yielded. The rest of a
        # block of which messages were taken may begin after blocks whose headers are not read yet.
        last = self._headers.last
        return len(self._known) > 1 and (last is None or self._known[0][0] <= last)

    @property
    def _unread_end(self) -> int:
        """Latest time that a message of a block with an unread header may have."""
        last = self._headers.last
        return MAX_SEQ if last is None else last[0] + self._part.table.metadata.span_ns

    def _take(self) -> list[_Item]:
        """Take the blocks that may hold the first message, and as many as are wanted."""
        found: list[_Item] = []
        count, size = self._wanted or MAX_SEQ, self._bytes
        first = self._known[0][0][0] if self._known else 0
        if not self._part.reverse:  # earlier blocks may hold the first message too
            first = max(first, self._part.ends[0][0])
        while self._known and len(found) < MAX_AT_ONCE:
            turn, _, item = self._known[0]
            if found and turn[0] > first and (size < item.size or count <= 0):
                break
            found.append(heapq.heappop(self._known)[2])
            count, size = count - item.left, size - item.size
        return found

    def bound_up(self, coming: _Batch | None) -> Order | None:
        """Return a key before which no further message comes; None = no message comes."""
        if coming is not None:
            return coming.taken[0].key
        ends = [self._known[0][0]] if self._known else []
        if self._headers.more and self._headers.last is not None:
            ends.append(self._headers.last)
        return min(ends, default=None)

    def bound_down(self, coming: _Batch | None) -> int:
        """Return a time after which no further message comes in descending order."""
        known = self._known_end(coming)
        return max(known, self._unread_end) if self._headers.more else known

    def look(self, coming: _Batch | None) -> bool:
        """Read more headers if that may lower the bound; return whether headers were read."""
        short = self._headers.more and self._unread_end > self._known_end(coming)
        if short:
            self.read()
        return short

    def _known_end(self, coming: _Batch | None) -> int:
        first = [-self._known[0][0][0]] if self._known else []
        if coming is not None:
            first.append(self._end(coming.taken[0]))
        return max(first, default=MIN_SEQ)


def upwards(part: BucketRead, needed: BlockQueue) -> Iterator[TableRow]:
    """Yield the rows of a bucket in the order (t, seq)."""
    held, coming = WaitingRows(), needed.batch()
    while coming is not None:
        for rows in needed.rows(coming):
            held.add(rows)
        # A read of few messages gets the rows at hand before more blocks are requested.
        coming = None if part.wanted else needed.batch()
        bound = needed.bound_up(coming)
        yield from held.rest() if bound is None else held.until(bound, part.node)
        coming = coming or needed.batch()
    yield from held.rest()


def downwards(part: BucketRead, needed: BlockQueue) -> Iterator[TableRow]:
    """Yield the rows of a bucket, newest first."""
    held, coming = WaitingRows(), needed.batch()
    while coming is not None:
        for rows in needed.rows(coming):
            held.add(rows)
        coming = None if part.wanted else needed.batch()
        found = held.beyond(needed.bound_down(coming))
        while held and not found and needed.look(coming):
            found = held.beyond(needed.bound_down(coming))
        yield from found
        coming = coming or needed.batch()
    yield from reversed(held.rest())


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
        self._asked: PagedRead | None = part.ask(WHOLE, self._count)

    def __iter__(self) -> Iterator[tuple[list[BlockRow], Order | None]]:
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
        keys: list[Order | None] = [*(block.key for block in blocks[1:]), behind]
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
