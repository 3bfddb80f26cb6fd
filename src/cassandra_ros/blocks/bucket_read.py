# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A read of one bucket of blocks, and rows of overlapping blocks that wait for their turn."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Callable, Iterable, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.blocks.block_row import Block, BlockRow, ask_blocks, read_block, stand_in
from cassandra_ros.blocks.codec import Longs, Unpacked
from cassandra_ros.connection.driver_errors import is_refused
from cassandra_ros.connection.paging import PagedRead, RawRow
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.tables.row_table import (
    ALL,
    MAX_SEQ,
    MIN_SEQ,
    Order,
    RowTable,
    TableRow,
    Terms,
    encode_long,
)

_log = logging.getLogger(__name__)

BLOCK_BYTES = 256 * 1024
"""Assumed size of a block before the first page is read, bytes."""
EARLY_BLOCKS = 2
"""Number of blocks read before their headers, if the number of overlapping writers is unknown."""
MAX_BLOCKS = 512
"""Maximum number of blocks in a page."""
GROWTH = 4
"""Ratio between the sizes of two consecutive requests of a read of few messages."""

Sift = Callable[[Unpacked], Optional[NDArray[np.bool_]]]
"""Returns a mask of the messages of a block that may be wanted; None = all."""
_Bound = Tuple[object, ...]


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
        self._place = self.table.place(self.node, self.bucket)
        begin = self.bucket * self.table.metadata.bucket_ns
        low = self.ends[0][0]
        # An earlier block may reach into the range.
        self.first = max(begin, low - self.table.metadata.span_ns) if low > begin else begin
        self.reaching: Terms = (("_last", ">=", encode_long(low)),) if self.first < low else ()

    def ask(
        self, names: str, count: int, last: RawRow | None = None, terms: Terms = ()
    ) -> PagedRead:
        """Request ``count`` blocks a page, those after the last row that was read."""
        low, high = self.ends
        past = last is not None and last[0] is not None and last[0] >= encode_long(low[0])
        reaching = () if past and not self.reverse else self.reaching
        return self.table.select_range(
            names,
            self._place,
            ((self.first, MIN_SEQ), (high[0], MAX_SEQ)),
            terms=(*terms, *reaching),
            page_rows=count,
            reverse=self.reverse,
            last=last,
            refused=is_refused if terms else None,
        )

    def fetch(self, headers: Sequence[BlockRow]) -> PagedRead:
        """Request blocks with known headers."""
        return ask_blocks(self.table, self._place, [header.key for header in headers])

    def blocks(self, page: Iterable[RawRow]) -> list[BlockRow]:
        """Return the blocks of a page that may hold messages to read."""
        found = (read_block(self.table, values) for values in page)
        return [block for block in found if block is not None and self.wants(block)]

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
        places = block.between(*self.ends)
        if self.sift is not None and block.unpacked is not None and len(places):
            mask = self.sift(block.unpacked)
            if mask is not None:
                places = places[mask[places]]
        if self.opened is not None:
            self.opened(len(block), len(places))
        return OpenedBlock(row, block, places)

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
        places: Positions of the messages that have not been made into rows yet.
    """

    size = 0
    """Number of bytes that are still to be fetched."""

    def __init__(self, row: BlockRow, block: Block | None, places: Longs) -> None:
        self.row, self.block, self.places = row, block, places

    @property
    def left(self) -> int:
        """Number of remaining messages."""
        return len(self.places)

    @property
    def key(self) -> Order:
        """Key of the first remaining message."""
        if self.block is None:
            return self.row.key
        place = self.places[0]
        return int(self.block.times[place]), int(self.block.seqs[place])

    @property
    def last(self) -> int:
        """Key time of the last remaining message, ns."""
        return self.row.t if self.block is None else int(self.block.times[self.places[-1]])

    def take(self, count: int, *, reverse: bool) -> OpenedBlock:
        """Take at most ``count`` messages, from the beginning or (reverse) from the end."""
        cut = max(0, self.left - count) if reverse else min(count, self.left)
        parts = self.places[:cut], self.places[cut:]
        taken, self.places = parts[::-1] if reverse else parts
        return OpenedBlock(self.row, self.block, taken)


class WaitingRows:
    """Sorted rows of overlapping blocks, kept until no earlier row can come."""

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
        """Take the rows up to a key, which is included."""
        self._sort()
        cut = _bisect(self._rows, (key[0], node, key[1] + 1))
        found, self._rows = self._rows[:cut], self._rows[cut:]
        return found

    def beyond(self, t: int) -> list[TableRow]:
        """Take the rows after a time, newest first."""
        self._sort()
        cut = _bisect(self._rows, (t + 1,))
        found, self._rows = self._rows[cut:], self._rows[:cut]
        return found[::-1]

    def rest(self) -> list[TableRow]:
        """Take all rows."""
        self._sort()
        found, self._rows = self._rows, []
        return found


def _bisect(rows: Sequence[TableRow], bound: _Bound) -> int:
    low, high = 0, len(rows)
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < bound:
            low = middle + 1
        else:
            high = middle
    return low


def key_of(values: RawRow) -> Order:
    """Return ``_t`` and ``_seq`` of raw values."""
    t, seq = (int.from_bytes(value or b"", "big", signed=True) for value in values[:2])
    return t, seq
