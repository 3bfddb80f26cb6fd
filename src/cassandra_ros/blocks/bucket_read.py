# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is read of one bucket of blocks, and rows of it that wait for their turn."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Callable, FrozenSet, Iterable, List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.blocks.block_row import (
    Block,
    BlockRow,
    ask_blocks,
    read_block,
    stand_in,
)
from cassandra_ros.blocks.codec import Longs, Unpacked
from cassandra_ros.connection.driver_errors import is_refused
from cassandra_ros.connection.paging import Asked, RawRow
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
"""Assumed of a block, in its first page."""
EARLY_BLOCKS = 2
"""Where it is not known how many writers there are: those of several overlap."""
MAX_BLOCKS = 512
"""Of one page."""
GROWTH = 4
"""How much more is read than the time before, where little was wanted at first."""

Sift = Callable[[Unpacked], Optional[NDArray[np.bool_]]]
"""From a block to a mask of the messages that may be wanted; None = all may be."""
_Bound = Tuple[object, ...]


@dataclass
class BucketRead:
    """What is read of one bucket.

    Attributes:
        ends: The first and the last message.
        writers: Only of these writer ids; None = of all.
        bare: No bytes are wanted.
        filters: What the server is to check, in several ways; None = nothing.
        sift: What leaves out messages that are not wanted, once they are unpacked.
        opened: Told of each block how many messages it has, and how many of those became rows.
        wanted: So few messages are probably taken; 0 = all.
        early: So many blocks are asked for beside their headers then: mostly those that are needed.
        page_bytes: Serialised bytes that may be held at once, about.
    """

    table: RowTable
    node: str
    bucket: int
    ends: Tuple[Order, Order] = ALL
    reverse: bool = False
    writers: Optional[FrozenSet[int]] = None
    bare: bool = False
    filters: Optional[Sequence[Terms]] = None
    sift: Optional[Sift] = None
    opened: Callable[[int, int], None] = field(default=lambda messages, kept: None)
    wanted: int = 0
    early: int = EARLY_BLOCKS
    page_bytes: int = 2 * 1024 * 1024

    def __post_init__(self) -> None:
        self._place = self.table.place(self.node, self.bucket)
        begin = self.bucket * self.table.metadata.bucket_ns
        low = self.ends[0][0]
        # A block that begins before may reach in.
        self.first = max(begin, low - self.table.metadata.span_ns) if low > begin else begin
        self.reaching: Terms = (("_last", ">=", encode_long(low)),) if self.first < low else ()

    def ask(
        self,
        names: str,
        count: int,
        last: Optional[RawRow] = None,
        terms: Terms = (),
    ) -> Asked:
        """Ask for blocks behind the last one that was read, so many at once."""
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

    def fetch(self, headers: Sequence[BlockRow]) -> Asked:
        """Ask for blocks of which the headers are known."""
        return ask_blocks(self.table, self._place, [header.key for header in headers])

    def blocks(self, page: Iterable[RawRow]) -> List[BlockRow]:
        """Read the blocks of a page, those that are wanted."""
        found = (read_block(self.table, values) for values in page)
        return [block for block in found if block is not None and self.wants(block)]

    def wants(self, block: BlockRow) -> bool:
        """Say whether a block may hold messages that are wanted."""
        written = self.writers is None or block.writer in self.writers
        return written and block.last >= self.ends[0][0] and block.left > 0

    def open(self, row: BlockRow) -> Opened:
        """Unpack a block, and find what is wanted of it; it is noted what that took.

        Raises:
            CorruptMessage: It is damaged and begins before what is read: no row would tell of it.
        """
        try:
            block = Block(self.table, self.node, row)
        except CorruptMessage as exc:
            if row.key < self.ends[0]:
                raise
            _log.warning("%s", exc)
            inside = self.ends[0] <= row.key <= self.ends[1]
            return Opened(row, None, np.arange(inside))
        places = block.between(*self.ends)
        if self.sift is not None and block.unpacked is not None and len(places):
            mask = self.sift(block.unpacked)
            if mask is not None:
                places = places[mask[places]]
        self.opened(len(block), len(places))
        return Opened(row, block, places)

    def rows(self, opened: Opened) -> List[TableRow]:
        """Make the rows that are left of a block, in order."""
        if opened.block is None:
            return [stand_in(self.table, self.node, opened.row)] * len(opened.places)
        return opened.block.rows(opened.places, bare=self.bare) if opened.left else []


class Opened:
    """What is wanted of a block that is unpacked, or has to be without that it can.

    Attributes:
        row: The block in its table.
        block: None where it cannot be read.
        places: Positions of the messages of which no rows are made yet.
    """

    size = 0
    """Of bytes that are still to be read."""

    def __init__(self, row: BlockRow, block: Optional[Block], places: Longs) -> None:
        self.row, self.block, self.places = row, block, places

    @property
    def left(self) -> int:
        """How many messages there are."""
        return len(self.places)

    @property
    def key(self) -> Order:
        """Key of the first message."""
        if self.block is None:
            return self.row.key
        place = self.places[0]
        return int(self.block.times[place]), int(self.block.seqs[place])

    @property
    def last(self) -> int:
        """Time of the last message, ns."""
        return self.row.t if self.block is None else int(self.block.times[self.places[-1]])

    def take(self, count: int, *, reverse: bool) -> Opened:
        """Take so many messages at most, from the end or the beginning on."""
        cut = max(0, self.left - count) if reverse else min(count, self.left)
        parts = self.places[:cut], self.places[cut:]
        taken, self.places = parts[::-1] if reverse else parts
        return Opened(self.row, self.block, taken)


class Held:
    """Rows of overlapping blocks, in order, until nothing can come before them."""

    def __init__(self) -> None:
        self._rows: List[TableRow] = []
        self._sorted = True

    def add(self, rows: List[TableRow]) -> None:
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
            self._rows.sort()  # runs, which are merged
            self._sorted = True

    def until(self, key: Order, node: str) -> List[TableRow]:
        """Take the rows up to a key, included."""
        self._sort()
        cut = _bisect(self._rows, (key[0], node, key[1] + 1))
        found, self._rows = self._rows[:cut], self._rows[cut:]
        return found

    def beyond(self, t: int) -> List[TableRow]:
        """Take the rows behind a time, the newest first."""
        self._sort()
        cut = _bisect(self._rows, (t + 1,))
        found, self._rows = self._rows[cut:], self._rows[:cut]
        return found[::-1]

    def rest(self) -> List[TableRow]:
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
    """Read the key of a row."""
    t, seq = (int.from_bytes(value or b"", "big", signed=True) for value in values[:2])
    return t, seq
