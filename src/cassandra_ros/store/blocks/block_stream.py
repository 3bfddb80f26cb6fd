# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A read of one bucket of blocks: its messages, in order from either end.

``BucketRead`` says what is read. Blocks of several writers and connections overlap. A whole bucket
is read block by block (``block_portions``); a block is unpacked when its messages are needed. A
read of few messages, or one in descending order, first reads headers and then the blocks in the
order in which it needs them (``BlockQueue``). A message is yielded as soon as no block that is
still to be read can hold an earlier one (``WaitingRows``).
"""

from __future__ import annotations

import heapq
import logging
from bisect import bisect_left
from dataclasses import dataclass
from itertools import chain
from typing import Callable, Iterable, Iterator, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage, SchemaConflict
from cassandra_ros.read import Sift, Terms
from cassandra_ros.store.blocks.block_row import (
    HEADER_COLUMNS,
    WHOLE_BLOCK_COLUMNS,
    Block,
    BlockRow,
    ask_blocks,
    read_block,
    stand_in,
)
from cassandra_ros.store.blocks.codec import Longs
from cassandra_ros.store.connection.driver_errors import DRIVER_ERRORS, is_refused
from cassandra_ros.store.connection.protocol import RawPage
from cassandra_ros.store.connection.requests import PagedRead, RawRow
from cassandra_ros.store.tables.row_table import (
    ALL,
    MAX_SEQ,
    MIN_SEQ,
    Order,
    RowTable,
    TableRow,
    encode_long,
)
from cassandra_ros.store.tables.table_layout import Portion, StackedMessages

_log = logging.getLogger(__name__)

BLOCK_BYTES = 256 * 1024
"""Assumed size of a block before the first page is read, bytes."""
EARLY_BLOCKS = 2
"""Number of blocks read before their headers, if the number of overlapping writers is unknown."""
STREAM_PAGE_BLOCKS = 512
"""Maximum number of blocks in a page."""
GROWTH = 4
"""Ratio between the sizes of two consecutive requests of a read of few messages."""

Flags = NDArray[np.bool_]


@dataclass
class BucketRead:
    """A read of one bucket: what is read, and how.

    Attributes:
        ends: Keys of the first and the last message to read, both included.
        writers: Writer ids whose messages are read; None = all.
        bare: Rows are made without their bytes.
        filters: Conditions for the server; a block must pass one of them. None = no conditions.
        sift: Selects messages of a block after it was unpacked.
        opened: Called for each block with its number of messages and the number that became rows;
            None = not called.
        wanted: Number of messages that will probably be taken; 0 = all.
        early: Number of blocks that a read of few messages requests together with the headers.
        page_bytes: Approximate limit of serialised bytes in memory.
    """

    table: RowTable
    node: str
    bucket: int
    ends: tuple[Order, Order] = ALL
    reverse: bool = False
    writers: frozenset[int] | None = None
    bare: bool = False
    filters: Sequence[Terms] | None = None
    sift: Sift | None = None
    opened: Callable[[int, int], None] | None = None
    wanted: int = 0
    early: int = EARLY_BLOCKS
    page_bytes: int = 2 * 1024 * 1024

    def __post_init__(self) -> None:
        self._partition_key = self.table.partition_key(self.node, self.bucket)
        begin = self.bucket * self.table.metadata.bucket_ns
        low = self.ends[0][0]
        # An earlier block may reach into the range. All messages of a block are in one bucket.
        self.first = max(begin, low - self.table.metadata.span_ns) if low > begin else begin
        """Key time from which blocks may have messages to read, ns."""
        self.reaching: Terms = (("_last", ">=", encode_long(low)),) if self.first < low else ()
        """Condition that leaves out the blocks that end before the range."""

    def ask(
        self, names: str, count: int, last: RawRow | None = None, terms: Terms = ()
    ) -> PagedRead:
        """Request ``count`` blocks a page, those after the last row that was read.

        Args:
            names: Columns to read, as CQL, beginning with those of the key.
            terms: Further conditions for the server, which may refuse them: see PagedRead.
        """
        low, high = self.ends
        # Blocks after one that begins in the range end in it: the server need not filter them. Key
        # times are not negative, so their bytes are in the order of the numbers.
        is_inside = last is not None and last[0] is not None and last[0] >= encode_long(low[0])
        reaching = () if is_inside and not self.reverse else self.reaching
        return self.table.select_range(
            names,
            self._partition_key,
            ((self.first, MIN_SEQ), (high[0], MAX_SEQ)),
            terms=(*terms, *reaching),
            page_rows=count,
            reverse=self.reverse,
            last=last,
            refused=is_refused if terms else None,
        )

    def fetch(self, headers: Sequence[BlockRow]) -> PagedRead:
        """Request blocks with known headers."""
        return ask_blocks(self.table, self._partition_key, [header.key for header in headers])

    def blocks(self, page: Iterable[RawRow]) -> list[BlockRow]:
        """Return the blocks of a page that may hold messages to read."""
        rows = (read_block(self.table, values) for values in page)
        return [block for block in rows if block is not None and self.wants(block)]

    def wants(self, block: BlockRow) -> bool:
        """Return whether a block may hold messages to read."""
        written = self.writers is None or block.writer in self.writers
        return written and block.last >= self.ends[0][0] and block.left > 0

    def open(self, row: BlockRow) -> OpenedBlock:
        """Unpack a block, select its messages to read, and report both numbers to ``opened``.

        Raises:
            CorruptMessage: The block is damaged and begins before the range, so no row stands for
                it.
        """
        try:
            block = Block(self.table, self.node, row)
        except CorruptMessage as exc:
            if row.key < self.ends[0]:
                raise
            _log.warning("%s", exc)
            inside = self.ends[0] <= row.key <= self.ends[1]
            return OpenedBlock(row, None, np.arange(inside))
        places, unsure = block.between(*self.ends), None
        if self.sift is not None and block.unpacked is not None and len(places):
            mask, unsure = self.sift(block.unpacked)
            if mask is not None:
                places = places[mask[places]]
        if self.opened is not None:
            self.opened(len(block), len(places))
        return OpenedBlock(row, block, places, unsure)

    def rows(self, opened: OpenedBlock) -> list[TableRow]:
        """Return the rows of the remaining messages of a block, in order."""
        if opened.block is None:
            return [stand_in(self.table, self.node, opened.row)] * len(opened.places)
        return opened.block.rows(opened.places, bare=self.bare) if opened.left else []


class OpenedBlock:
    """The messages of a block that are to be read, or of a damaged block.

    Attributes:
        row: The row of the block.
        block: The unpacked block; None if it is damaged.
        places: Positions of the messages that have not been made into rows yet, ascending. A
            damaged block has one if it begins in the range, for the row that stands for it.
        unsure: By position in the block, whether a message has to be checked again, because the
            sift is not sure; None = all have to be.
    """

    size = 0
    """Number of bytes that are still to be fetched."""

    def __init__(
        self, row: BlockRow, block: Block | None, places: Longs, unsure: Flags | None = None
    ) -> None:
        self.row, self.block, self.places, self.unsure = row, block, places, unsure

    @property
    def left(self) -> int:
        """Number of remaining messages."""
        return len(self.places)

    @property
    def key(self) -> Order:
        """Key of the first remaining message, of which there must be one."""
        if self.block is None:
            return self.row.key
        place = self.places[0]
        return int(self.block.times[place]), int(self.block.seqs[place])

    @property
    def last(self) -> int:
        """Key time of the last remaining message, ns."""
        return self.row.t if self.block is None else int(self.block.times[self.places[-1]])

    def split_until(self, last: Order) -> OpenedBlock:
        """Remove and return the messages up to a key, included.

        Of a damaged block it is the row that stands for it.
        """
        if self.block is None:
            return self.split_off(self.left, reverse=False)
        place = self.block.first_after(last)
        return self.split_off(int(self.places.searchsorted(place)), reverse=False)

    def split_off(self, count: int, *, reverse: bool) -> OpenedBlock:
        """Remove and return at most ``count`` messages from the beginning or (reverse) the end."""
        cut = max(0, self.left - count) if reverse else min(count, self.left)
        parts = self.places[:cut], self.places[cut:]
        places, self.places = parts[::-1] if reverse else parts
        return OpenedBlock(self.row, self.block, places, self.unsure)


class WaitingRows:
    """Rows of overlapping blocks of one node and table, kept until no earlier row can come."""

    def __init__(self) -> None:
        self._rows: list[TableRow] = []
        self._sorted = True

    def add(self, rows: list[TableRow]) -> None:
        """Add the rows of a block, which are in order."""
        if not rows:
            return
        if not self._rows or rows[-1] < self._rows[0]:
            self._rows = rows + self._rows
            return
        self._sorted = self._sorted and self._rows[-1] < rows[0]
        self._rows.extend(rows)

    def __bool__(self) -> bool:
        return bool(self._rows)

    def _sort(self) -> None:
        if not self._sorted:
            self._rows.sort()  # sorted runs, which sort() merges
            self._sorted = True

    def until(self, key: Order, node: str) -> list[TableRow]:
        """Take the rows up to a key, which is included, in order."""
        self._sort()
        cut = bisect_left(self._rows, (key[0], node, key[1] + 1))
        rows, self._rows = self._rows[:cut], self._rows[cut:]
        return rows

    def beyond(self, t: int) -> list[TableRow]:
        """Take the rows after a time, newest first."""
        self._sort()
        cut = bisect_left(self._rows, (t + 1,))
        rows, self._rows = self._rows[cut:], self._rows[:cut]
        return rows[::-1]

    def rest(self) -> list[TableRow]:
        """Take all rows, in order."""
        self._sort()
        rows, self._rows = self._rows, []
        return rows


def key_of(values: RawRow) -> Order:
    """Return ``_t`` and ``_seq`` of raw values."""
    t, seq = (int.from_bytes(value or b"", "big", signed=True) for value in values[:2])
    return t, seq


KEYED_BLOCKS_AT_ONCE = 100
"""Maximum number of blocks that one statement fetches by their keys."""
FIRST_HEADERS = 16
"""Number of headers in the first page of a read of few messages; later pages are larger."""
STREAM_PAGE_HEADERS = 5000
"""Maximum number of headers in a page."""
MIN_BLOCK_ROWS = 8
"""Minimum number of rows that are made of a block in a read of few messages."""

_Item = Union[BlockRow, OpenedBlock]
"""A block that has to be fetched, or the rest of a block of which some messages were taken."""


class Headers:
    """Reads the headers of the blocks of a bucket, in the order of reading, as far as needed.

    With filters all of them are read at once, because several queries give them in several orders.

    Attributes:
        more: Whether there are further headers to read.
        last: Key of the last block whose header was read; None = of none yet.
    """

    def __init__(self, bucket: BucketRead) -> None:
        self._bucket = bucket
        self._count = FIRST_HEADERS if bucket.wanted else STREAM_PAGE_HEADERS
        self._filters = bucket.filters
        if bucket.filters is not None:
            self._asked = self._ask_filters(bucket.filters)
        else:
            self._asked = [bucket.ask(HEADER_COLUMNS, self._count)]
        # Sent together with the headers, which saves a round trip.
        early = bucket.wanted and bucket.filters is None
        self._early = bucket.ask(WHOLE_BLOCK_COLUMNS, bucket.early) if early else None
        self.more = bool(self._asked)
        self.last: Order | None = None
        self._last_row: RawRow | None = None

    def take_early(self) -> PagedRead | None:
        """Return, at the first call, the read of the first whole blocks; None = it was not sent."""
        early, self._early = self._early, None
        return early

    def _ask_filters(self, filters: Sequence[Terms]) -> list[PagedRead]:
        """Request the headers of the blocks that pass each filter."""
        try:
            return [
                self._bucket.ask(HEADER_COLUMNS, STREAM_PAGE_HEADERS, terms=terms)
                for terms in filters
            ]
        except SchemaConflict as exc:
            return self._ask_all(exc)

    def _ask_all(self, exc: object) -> list[PagedRead]:
        """Read the headers of all blocks, if a server forbids filtering or is too slow at it."""
        topic = self._bucket.table.metadata.topic
        _log.info("topic %s is read whole, the server does not filter it: %s", topic, exc)
        self._filters = None
        return [self._bucket.ask(HEADER_COLUMNS, STREAM_PAGE_HEADERS)]

    def read(self) -> list[BlockRow]:
        """Read the next page of headers."""
        if self._filters is not None:
            return self._read_filtered()
        if not self._asked:
            self._count = min(STREAM_PAGE_HEADERS, GROWTH * self._count)
            self._asked = [self._bucket.ask(HEADER_COLUMNS, self._count, self._last_row)]
        request = self._asked.pop()
        page: Sequence[RawRow] = next((p for p in request.pages(ahead=False) if p), ())
        self.more = bool(page) and request.more
        if self.more:
            self._last_row, self.last = page[-1], key_of(page[-1])
        return self._bucket.blocks(page)

    def _read_filtered(self) -> list[BlockRow]:
        """Read all headers that pass one of the filters, some 100 bytes a block."""
        self.more = False
        try:
            rows = [row for request in self._asked for row in request.rows()]
        except DRIVER_ERRORS as exc:
            rows = list(self._ask_all(exc)[0].rows())
        by_key = {block.key: block for block in self._bucket.blocks(rows)}
        return [by_key[key] for key in sorted(by_key, reverse=self._bucket.reverse)]


class _Batch:
    """Blocks that are being fetched, in the order in which they are needed.

    Args:
        taken: The blocks, as they were in the queue.
        wanted: Number of messages that the read takes from them; 0 = all.
        early: A read that was sent before, which may return some of the blocks.
    """

    def __init__(
        self, bucket: BucketRead, taken: list[_Item], wanted: int, early: PagedRead | None = None
    ) -> None:
        self._bucket = bucket
        self.taken, self.wanted = taken, wanted
        self._open = [item for item in taken if isinstance(item, OpenedBlock)]
        headers = [item for item in taken if isinstance(item, BlockRow)]
        self._here: list[BlockRow] = []
        if early is not None:
            keys = {header.key for header in headers}
            self._here = [row for row in bucket.blocks(early.page()) if row.key in keys]
        here = {row.key for row in self._here}
        missing = [header for header in headers if header.key not in here]
        self._asked = bucket.fetch(missing) if missing else None

    def blocks(self) -> Iterator[OpenedBlock]:
        """Yield the blocks that have messages to read, unpacked, in no order."""
        yield from self._open
        fetched = [] if self._asked is None else self._bucket.blocks(self._asked.page())
        for row in self._here + fetched:
            opened = self._bucket.open(row)
            if opened.left:
                yield opened


class BlockQueue:
    """The blocks of a bucket that still have messages to yield, in the order of need.

    In ascending order this is the order of their first messages, in which they are stored. In
    descending order it is that of their last messages, because an earlier block may end later.
    """

    def __init__(self, bucket: BucketRead, headers: Headers) -> None:
        self._bucket = bucket
        self._headers = headers
        self._pending: list[tuple[Order, int, _Item]] = []
        """Heap of the blocks with known headers: turn (see _add), number, block."""
        self._count = 0
        """Number of blocks that were added: with it no two entries of the heap are equal."""
        self._wanted, self._bytes = bucket.wanted, bucket.page_bytes
        """Limits of the next batch: messages (0 = none), serialised bytes."""
        if bucket.wanted:
            self._bytes = min(bucket.page_bytes, BLOCK_BYTES)

    def batch(self) -> _Batch | None:
        """Request the blocks that are needed next, more each time; None if all were read."""
        while self._headers.more and not self._is_first_certain():
            self.read()
        items, wanted = self._take(), self._wanted
        if self._bucket.wanted:
            self._wanted *= GROWTH
            self._bytes = min(self._bucket.page_bytes, GROWTH * self._bytes)
        early = self._headers.take_early()
        return _Batch(self._bucket, items, wanted, early) if items else None

    def read(self) -> None:
        """Read one more page of headers."""
        for header in self._headers.read():
            self._add(header)

    def _add(self, item: _Item) -> None:
        """Add a block, or its rest, in its turn: by its first key, in descending order its end."""
        self._count += 1
        turn = (-self._end(item), 0) if self._bucket.reverse else item.key
        heapq.heappush(self._pending, (turn, self._count, item))

    def _end(self, item: _Item) -> int:
        """Return the time of the last message of a block that is in the range to be read."""
        return min(item.last, self._bucket.ends[1][0])

    def rows(self, batch: _Batch) -> Iterator[list[TableRow]]:
        """Yield rows of each block; of a large block only as many as are wanted, the rest later."""
        for block in batch.blocks():
            head = block
            if batch.wanted and block.block is not None:
                head = block.split_off(
                    max(MIN_BLOCK_ROWS, batch.wanted), reverse=self._bucket.reverse
                )
                if block.left:
                    self._add(block)
            yield self._bucket.rows(head)

    def _is_first_certain(self) -> bool:
        """Return whether no block with an unread header is needed before the first pending one."""
        if self._bucket.reverse:
            return bool(self._pending) and -self._pending[0][0][0] > self._unread_end
        # Only the next header tells up to which key the first block can be yielded. The rest of a
        # block of which messages were taken may begin after blocks whose headers are not read yet.
        last = self._headers.last
        return len(self._pending) > 1 and (last is None or self._pending[0][0] <= last)

    @property
    def _unread_end(self) -> int:
        """Latest time that a message of a block with an unread header may have."""
        last = self._headers.last
        return MAX_SEQ if last is None else last[0] + self._bucket.table.metadata.span_ns

    def _take(self) -> list[_Item]:
        """Take the blocks that may hold the first message, and as many as are wanted."""
        items: list[_Item] = []
        messages_left, bytes_left = self._wanted or MAX_SEQ, self._bytes
        first = self._pending[0][0][0] if self._pending else 0
        if not self._bucket.reverse:  # earlier blocks may hold the first message too
            first = max(first, self._bucket.ends[0][0])
        while self._pending and len(items) < KEYED_BLOCKS_AT_ONCE:
            turn, _, item = self._pending[0]
            is_enough = bytes_left < item.size or messages_left <= 0
            if items and turn[0] > first and is_enough:
                break
            heapq.heappop(self._pending)
            items.append(item)
            messages_left -= item.left
            bytes_left -= item.size
        return items

    def bound_up(self) -> Order | None:
        """Return a key before which no further message comes, ascending; None = no message comes.

        The last batch must have been read.
        """
        ends = [self._pending[0][0]] if self._pending else []
        if self._headers.more and self._headers.last is not None:
            ends.append(self._headers.last)
        return min(ends, default=None)

    def bound_down(self, coming: _Batch | None) -> int:
        """Return a time after which no further message comes, descending.

        Args:
            coming: The batch that was requested and not read yet.
        """
        end = self._pending_end(coming)
        return max(end, self._unread_end) if self._headers.more else end

    def look(self, coming: _Batch | None) -> bool:
        """Read more headers if that may lower bound_down; return whether headers were read."""
        may_lower = self._headers.more and self._unread_end > self._pending_end(coming)
        if may_lower:
            self.read()
        return may_lower

    def _pending_end(self, coming: _Batch | None) -> int:
        """Return the latest time of the messages of pending blocks and of a batch."""
        first = [-self._pending[0][0][0]] if self._pending else []
        if coming is not None:
            first.append(self._end(coming.taken[0]))
        return max(first, default=MIN_SEQ)


def upwards(bucket: BucketRead, needed: BlockQueue) -> Iterator[TableRow]:
    """Yield the first rows of a bucket, of which few are wanted, in the order (t, seq)."""
    buffer, coming = WaitingRows(), needed.batch()
    while coming is not None:
        for rows in needed.rows(coming):
            buffer.add(rows)
        # The rows at hand come before more blocks are requested.
        bound = needed.bound_up()
        yield from buffer.rest() if bound is None else buffer.until(bound, bucket.node)
        coming = needed.batch()
    yield from buffer.rest()


def downwards(bucket: BucketRead, needed: BlockQueue) -> Iterator[TableRow]:
    """Yield the rows of a bucket, newest first."""
    buffer, coming = WaitingRows(), needed.batch()
    while coming is not None:
        for rows in needed.rows(coming):
            buffer.add(rows)
        # A read of few messages gets the rows at hand before more blocks are requested.
        coming = None if bucket.wanted else needed.batch()
        sure_rows = buffer.beyond(needed.bound_down(coming))
        while buffer and not sure_rows and needed.look(coming):
            sure_rows = buffer.beyond(needed.bound_down(coming))
        yield from sure_rows
        coming = coming or needed.batch()
    yield from reversed(buffer.rest())


BLOCK_ROWS_AT_ONCE = 200
"""Maximum number of rows that are made at once of a block."""


def stream(bucket: BucketRead) -> Iterator[TableRow]:
    """Yield the rows of a bucket in the order (t, seq) if few are wanted, or newest first.

    Sends the request at once.
    """
    needed = BlockQueue(bucket, Headers(bucket))
    return downwards(bucket, needed) if bucket.reverse else upwards(bucket, needed)


def block_portions(bucket: BucketRead) -> Iterator[TableRow | Portion]:
    """Yield all messages of a bucket, its blocks in the order of their first messages.

    The blocks of several writers overlap. Sends the request at once.
    """
    if bucket.filters is None:
        return as_portions(bucket, chain.from_iterable(_Pages(bucket)))
    return as_portions(bucket, _blocks_by_headers(bucket, Headers(bucket)))


def as_portions(bucket: BucketRead, blocks: Iterable[BlockRow]) -> Iterator[TableRow | Portion]:
    """Yield the messages of blocks; a message whose bytes are in chunks is a row."""
    for block in blocks:
        if block.nchunks:
            yield from bucket.rows(bucket.open(block))
        else:
            yield BlockPortion(bucket, block)


def _blocks_by_headers(bucket: BucketRead, headers: Headers) -> Iterator[BlockRow]:
    """Yield the blocks of headers, fetched by their keys; some are requested ahead."""
    count = max(1, min(KEYED_BLOCKS_AT_ONCE, bucket.page_bytes // BLOCK_BYTES))
    request: PagedRead | None = None
    while headers.more or request is not None:
        rows = headers.read() if headers.more else []
        for begin in range(0, max(1, len(rows)), count):
            asked = rows[begin : begin + count]
            next_request = bucket.fetch(asked) if asked else None
            if request is not None:
                yield from bucket.blocks(request.page())
            request = next_request


class _Pages:
    """All blocks of a bucket, page by page; the next page is requested ahead."""

    def __init__(self, bucket: BucketRead) -> None:
        self._bucket = bucket
        self._count = max(1, bucket.page_bytes // BLOCK_BYTES)
        self._asked: PagedRead | None = bucket.ask(WHOLE_BLOCK_COLUMNS, self._count)

    def __iter__(self) -> Iterator[list[BlockRow]]:
        """Yield the blocks of each page."""
        while self._asked is not None:
            request = self._asked
            page: Sequence[RawRow] = next((p for p in request.pages(ahead=False) if p), ())
            # Their bytes need not be copied, as they are unpacked soon.
            blocks = self._bucket.blocks(page.views() if isinstance(page, RawPage) else page)
            self._asked = None
            if page and request.more:
                if blocks:
                    mean = sum(block.size for block in blocks) // len(blocks) + 1
                    most = min(STREAM_PAGE_BLOCKS, GROWTH * self._count)
                    self._count = max(1, min(most, self._bucket.page_bytes // mean))
                self._asked = self._bucket.ask(WHOLE_BLOCK_COLUMNS, self._count, page[-1])
            yield blocks


class BlockPortion(Portion):
    """The messages to read of a block with bytes, or some of them. It is unpacked when needed.

    Args:
        bucket: What is read.
        row: The block.
        opened: Its messages; None = it is not unpacked yet.
        ends: Keys of the first and the last of them; None = those that the row and the read tell.
    """

    def __init__(
        self,
        bucket: BucketRead,
        row: BlockRow,
        opened: OpenedBlock | None = None,
        ends: tuple[Order, Order] | None = None,
    ) -> None:
        self.table, self.node = bucket.table, bucket.node
        low, high = bucket.ends
        first = max(row.key, low)
        # The end that a damaged row tells may be any number.
        self.ends = ends or (first, max(first, min((row.last, MAX_SEQ), high)))
        self.most = row.left if opened is None else opened.left
        self.nbytes = row.size * self.most // row.messages
        self._bucket, self._row, self._block = bucket, row, opened

    @property
    def _opened(self) -> OpenedBlock:
        if self._block is None:
            self._block = self._bucket.open(self._row)
        return self._block

    def __len__(self) -> int:
        return self._opened.left

    def _cut(self, last: Order) -> tuple[Portion, Portion]:
        """Return the messages up to a key, included, and the others."""
        rest, (first, end) = self._opened, self.ends
        head = rest.split_until(last)
        after = last[0], last[1] + 1
        return (
            BlockPortion(self._bucket, self._row, head, (first, last)),
            BlockPortion(self._bucket, self._row, rest, (after, end)),
        )

    def rows(self) -> Iterable[TableRow]:
        """Return the messages as rows, in order; a row stands for a damaged block."""
        # In small groups, because Python's collector walks through all rows that exist at the same
        # time.
        while self._opened.left:
            head = self._opened.split_off(BLOCK_ROWS_AT_ONCE, reverse=False)
            yield from self._bucket.rows(head)

    def stacked(self) -> StackedMessages | None:
        """Return the bytes of the messages; None = the block is damaged."""
        block, places, unsure = self._opened.block, self._opened.places, self._opened.unsure
        if block is None or block.unpacked is None:
            return None
        chosen = np.zeros(len(block), np.bool_)
        chosen[places] = True
        return StackedMessages(
            self.table,
            self.node,
            times=block.times[places],
            seqs=block.seqs[places],
            groups=[(group.members, group.stored, group.rises) for group in block.unpacked.groups],
            chosen=chosen,
            unsure=None if unsure is None else unsure[places],
        )
