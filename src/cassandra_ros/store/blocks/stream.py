# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of one bucket of blocks, in order from either end.

Blocks overlap: those of several writers, and those of several connections. So messages go out as
soon as no block that is still to be read can hold one before them. Whole buckets are read by pages
of blocks. Else, where few messages are wanted, or those of few blocks, or the newest first, their
headers are read, and then the blocks in the order in which they are needed.
"""

from __future__ import annotations

import heapq
import logging
from dataclasses import dataclass, field
from typing import (
    Callable,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
)

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage, SchemaConflict
from cassandra_ros.store.blocks.block_row import (
    HEADER,
    WHOLE,
    Block,
    BlockRow,
    ask_blocks,
    read_blocks,
    stand_in,
)
from cassandra_ros.store.blocks.codec import Unpacked
from cassandra_ros.store.driver_errors import DRIVER_ERRORS, is_refused
from cassandra_ros.store.paging import Asked, RawRow
from cassandra_ros.store.row_table import (
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
MAX_BLOCKS = 512
"""Of one page."""
MAX_AT_ONCE = 100
"""Blocks that are fetched with one statement, by their keys."""
FIRST_HEADERS = 16
"""Of the first page of headers, where few messages are wanted; the next ones are larger."""
FIRST_BLOCKS = 2
"""So many are asked for beside it: mostly those that are needed."""
MAX_HEADERS = 5000
GROWTH = 4
"""How much more is read than the time before, where little was wanted at first."""

Sift = Callable[[Unpacked], Optional[NDArray[np.bool_]]]
"""From a block to a mask of the messages that may be wanted; None = all may be."""
_Bound = Tuple[object, ...]


@dataclass
class Part:
    """What is read of one bucket.

    Attributes:
        ends: The first and the last message.
        writers: Only of these writer ids; None = of all.
        bare: No bytes are wanted.
        filters: What the server is to check, in several ways; None = nothing.
        sift: What leaves out messages that are not wanted, once they are unpacked.
        opened: Told of each block how many messages it has, and how many of those became rows.
        wanted: So few messages are probably taken; 0 = all.
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
        return self.table.stretch(
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
        low = self.ends[0][0]
        found = read_blocks(self.table, page, self.writers)
        return [block for block in found if block.last >= low and block.left > 0]

    def rows(self, block: BlockRow) -> List[TableRow]:
        """Make the rows of a block that are wanted, in order; it is noted what that took."""
        try:
            found = Block(self.table, self.node, block)
        except CorruptMessage as exc:
            _log.warning("%s", exc)
            inside = self.ends[0] <= block.key <= self.ends[1]
            return [stand_in(self.table, self.node, block)] if inside else []
        places = found.between(*self.ends)
        if self.sift is not None and found.unpacked is not None and len(places):
            mask = self.sift(found.unpacked)
            if mask is not None:
                places = places[mask[places]]
        self.opened(len(found), len(places))
        return found.rows(places, bare=self.bare) if len(places) else []


def stream(part: Part) -> Iterator[TableRow]:
    """Yield the rows of a bucket in the order (t, seq), or newest first. It is asked at once."""
    if part.filters is None and not part.reverse and not part.wanted:
        return _whole(part, _Pages(part))
    needed = _Needed(part, _Headers(part))
    return _downwards(part, needed) if part.reverse else _upwards(part, needed)


# ---------------------------------------------------------------- by pages of blocks


class _Pages:
    """The blocks of a bucket, all of them, page by page; the next one is asked for ahead."""

    def __init__(self, part: Part) -> None:
        self._part = part
        self._count = max(1, part.page_bytes // BLOCK_BYTES)
        self._asked: Optional[Asked] = part.ask(WHOLE, self._count)

    def __iter__(self) -> Iterator[Tuple[List[BlockRow], Optional[Order]]]:
        """Yield blocks, and the key that those of later pages lie behind; None = none come."""
        while self._asked is not None:
            asked = self._asked
            page: List[RawRow] = next((p for p in asked.pages(ahead=False) if p), [])
            blocks = self._part.blocks(page)
            self._asked = None
            if not page or not asked.more:
                yield blocks, None
                return
            if blocks:
                mean = sum(block.size for block in blocks) // len(blocks) + 1
                most = min(MAX_BLOCKS, GROWTH * self._count)
                self._count = max(1, min(most, self._part.page_bytes // mean))
            self._asked = self._part.ask(WHOLE, self._count, page[-1])
            yield blocks, _key(page[-1])


def _key(values: RawRow) -> Order:
    t, seq = (int.from_bytes(value or b"", "big", signed=True) for value in values[:2])
    return t, seq


def _whole(part: Part, pages: _Pages) -> Iterator[TableRow]:
    held = _Held()
    for blocks, behind in pages:
        for block in blocks:
            held.add(part.rows(block))
        if behind is None:
            break
        yield from held.until(behind, part.node)
    yield from held.rest()


class _Held:
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


# ---------------------------------------------------------------- by their headers


class _Headers:
    """Headers of the blocks of a bucket, in the order of reading, as far as they are needed."""

    def __init__(self, part: Part) -> None:
        self._part = part
        self._count = FIRST_HEADERS if part.wanted else MAX_HEADERS
        self._filters = part.filters
        if part.filters is not None:
            self._asked = self._filtered(part.filters)
        else:
            self._asked = [part.ask(HEADER, self._count)]
        # In the same moment: one round trip less.
        early = part.wanted and part.filters is None
        self.early = part.ask(WHOLE, FIRST_BLOCKS) if early else None
        """The first blocks themselves."""
        self.more = bool(self._asked)
        self.last: Optional[Order] = None
        """Where the last one lies that was read."""
        self._behind: Optional[RawRow] = None

    def _filtered(self, filters: Sequence[Terms]) -> List[Asked]:
        try:
            return [self._part.ask(HEADER, MAX_HEADERS, terms=terms) for terms in filters]
        except SchemaConflict as exc:
            return self._unfiltered(exc)

    def _unfiltered(self, exc: object) -> List[Asked]:
        """Go on with all blocks: a server may forbid to filter, or be too slow at it."""
        topic = self._part.table.metadata.topic
        _log.info("topic %s is read whole, the server does not filter it: %s", topic, exc)
        self._filters = None
        return [self._part.ask(HEADER, MAX_HEADERS)]

    def read(self) -> List[BlockRow]:
        """Read more of them."""
        if self._filters is not None:
            return self._every()
        if not self._asked:
            self._count = min(MAX_HEADERS, GROWTH * self._count)
            self._asked = [self._part.ask(HEADER, self._count, self._behind)]
        asked = self._asked.pop()
        page: List[RawRow] = next((p for p in asked.pages(ahead=False) if p), [])
        self.more = bool(page) and asked.more
        if self.more:
            self._behind, self.last = page[-1], _key(page[-1])
        return self._part.blocks(page)

    def _every(self) -> List[BlockRow]:
        """Read all that the server finds, in one way or several: some 100 bytes a block."""
        self.more = False
        try:
            rows = [row for asked in self._asked for row in asked.rows()]
        except DRIVER_ERRORS as exc:
            rows = list(self._unfiltered(exc)[0].rows())
        found = {block.key: block for block in self._part.blocks(rows)}
        return [found[key] for key in sorted(found, reverse=self._part.reverse)]


class _Batch:
    """Blocks on their way, in the order in which they are needed.

    Args:
        early: Asked for already, and may hold some of them.
    """

    def __init__(self, part: Part, headers: List[BlockRow], early: Optional[Asked] = None) -> None:
        self._part = part
        self.headers = headers
        self._here: List[BlockRow] = []
        if early is not None:
            wanted = {header.key for header in headers}
            self._here = [row for row in part.blocks(early.page()) if row.key in wanted]
        here = {row.key for row in self._here}
        missing = [header for header in headers if header.key not in here]
        self._asked = part.fetch(missing) if missing else None

    def rows(self) -> Iterator[List[TableRow]]:
        """Yield the rows of each block."""
        came = [] if self._asked is None else self._part.blocks(self._asked.page())
        return map(self._part.rows, self._here + came)


class _Needed:
    """The headers of blocks that are still to be read, in the order in which they are needed.

    Upwards that is the order of their first messages, as they lie; downwards that of their last
    ones: one that lies before another may end behind it.
    """

    def __init__(self, part: Part, headers: _Headers) -> None:
        self._part = part
        self._headers = headers
        self._known: List[Tuple[int, int, BlockRow]] = []
        self._count = 0
        self._wanted, self._bytes = part.wanted, part.page_bytes
        if part.wanted:
            self._bytes = min(part.page_bytes, BLOCK_BYTES)

    def batch(self) -> Optional[_Batch]:
        """Ask for the blocks that are needed next; None where all were."""
        while self._headers.more and not self._is_known():
            self.read()
        taken = self._take()
        if self._part.wanted:
            self._wanted *= GROWTH
            self._bytes = min(self._part.page_bytes, GROWTH * self._bytes)
        early, self._headers.early = self._headers.early, None
        return _Batch(self._part, taken, early) if taken else None

    def read(self) -> None:
        """Read more headers."""
        for header in self._headers.read():
            self._count += 1
            # A heap: upwards they come in order.
            heapq.heappush(self._known, (self._turn(header), self._count, header))

    def _turn(self, header: BlockRow) -> int:
        """Return when a block is needed: the less the sooner."""
        low, high = self._part.ends
        return -min(header.last, high[0]) if self._part.reverse else max(header.t, low[0])

    def _is_known(self) -> bool:
        """Say whether none that is not read is needed before the first one that is."""
        if self._part.reverse:
            return bool(self._known) and -self._known[0][0] > self._unread_end
        return len(self._known) > 1  # the next one tells how far the first one is all

    @property
    def _unread_end(self) -> int:
        """Time of the last message that a block may hold whose header is not read yet."""
        last = self._headers.last
        return MAX_SEQ if last is None else last[0] + self._part.table.metadata.span_ns

    def _take(self) -> List[BlockRow]:
        """Take blocks: those that may hold the first message, and as many as are wanted."""
        found: List[BlockRow] = []
        count, size = self._wanted or MAX_SEQ, self._bytes
        first = self._known[0][0] if self._known else 0
        while self._known and len(found) < MAX_AT_ONCE:
            turn, _, header = self._known[0]
            if found and turn != first and (size < header.size or count <= 0):
                break
            found.append(heapq.heappop(self._known)[2])
            count, size = count - header.left, size - header.size
        return found

    def bound_up(self, coming: Optional[_Batch]) -> Optional[Order]:
        """Return the key that no block lies before which is still to come; None = none comes."""
        if coming is not None:
            return coming.headers[0].key
        if self._known:
            return self._known[0][2].key
        return self._headers.last if self._headers.more else None

    def bound_down(self, coming: Optional[_Batch]) -> int:
        """Return the time that no message lies behind which is still to come."""
        known = self._known_end(coming)
        return max(known, self._unread_end) if self._headers.more else known

    def look(self, coming: Optional[_Batch]) -> bool:
        """Read more headers where that may lower the bound downwards; say whether it was done."""
        short = self._headers.more and self._unread_end > self._known_end(coming)
        if short:
            self.read()
        return short

    def _known_end(self, coming: Optional[_Batch]) -> int:
        first = [-self._known[0][0]] if self._known else []
        if coming is not None:
            first.append(-self._turn(coming.headers[0]))
        return max(first, default=MIN_SEQ)


def _upwards(part: Part, needed: _Needed) -> Iterator[TableRow]:
    held, coming = _Held(), needed.batch()
    while coming is not None:
        for rows in coming.rows():
            held.add(rows)
        # Who wants few is given those before more is asked for.
        coming = None if part.wanted else needed.batch()
        bound = needed.bound_up(coming)
        yield from held.rest() if bound is None else held.until(bound, part.node)
        coming = coming or needed.batch()
    yield from held.rest()


def _downwards(part: Part, needed: _Needed) -> Iterator[TableRow]:
    held, coming = _Held(), needed.batch()
    while coming is not None:
        for rows in coming.rows():
            held.add(rows)
        coming = None if part.wanted else needed.batch()
        found = held.beyond(needed.bound_down(coming))
        while held and not found and needed.look(coming):
            found = held.beyond(needed.bound_down(coming))
        yield from found
        coming = coming or needed.batch()
    yield from reversed(held.rest())
