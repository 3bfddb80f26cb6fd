# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows from Cassandra: of any number of tables and nodes, merged in one order, page by page.

A read of few rows requests the buckets in which the last read of its tables began at the same time
as the directory. It uses the answer only if the directory names the same buckets. That saves one
round trip and never changes the result.
"""

from __future__ import annotations

import heapq
from collections import deque
from typing import (
    Collection,
    Iterable,
    Iterator,
    Sequence,
    Tuple,
    Union,
)

from cassandra_ros.read import Read
from cassandra_ros.store.connection.requests import GROWTH
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.directory import BucketRow, BucketWalk, Directory
from cassandra_ros.store.tables.held_portions import HeldPortions, place_of, rows_of
from cassandra_ros.store.tables.row_table import MIN_SEQ, RowTable, TableRow
from cassandra_ros.store.tables.table_layout import BucketPlan, Portion, Queries

PAGE_BYTES = 2 * 1024 * 1024
"""Approximate maximum size of a page, bytes."""
ALL_PAGES_BYTES = 16 * 1024 * 1024
"""Approximate maximum size of the pages of all streams of one merged read, bytes."""
MAX_PAGE_ROWS = 5000
FILTERED_BUCKETS_AHEAD = 16
"""Maximum number of buckets that the server filters at the same time."""
UNKNOWN_ROW_BYTES = 32 * 1024
"""Assumed size of the rows of a bucket that the directory has no counts of yet, bytes."""
_ROW_OVERHEAD = 64
"""Approximate memory that a row takes in addition to its message, bytes."""
MERGED_ROWS = 16
"""Minimum number of rows requested from each of several streams for a read of few rows."""
SMALL_FIRST_PAGE_ROWS = 5000
"""Maximum number of wanted rows for which the first pages are smaller than whole ones."""
MOST_FIRST = 8
"""Maximum number of buckets requested before the directory has answered. If a read begins in more
buckets, the directory is read first."""
_Order = Tuple[object, ...]
"""What rows are compared by, in the direction of reading."""
_Request = Tuple[str, str, int, int, int, int]
"""Table, node, bucket, and the sizes of pages."""
_Messages = Iterator[Union[TableRow, Portion]]
"""The messages of a bucket, in the order of the read."""


def _takes_few(read: Read) -> bool:
    """Return whether probably less than a page of rows will be taken."""
    return read.wanted is not None and read.wanted <= SMALL_FIRST_PAGE_ROWS


def _first_and_last(read: Read, table: RowTable) -> tuple[int, int]:
    """Return the first and the last bucket of a table that may hold rows of a read."""
    low, high = read.time_range
    if read.after is not None and read.reverse:
        high = min(high, read.after.t)
    elif read.after is not None:
        low = max(low, read.after.t)
    return table.bucket_of(low), table.bucket_of(high)


def _may_hold(read: Read, bucket: Sequence[BucketRow]) -> bool:
    """Return whether a bucket may hold rows of a read: the directory may list too many."""
    writers = read.whose.writers
    if writers is not None and not any(row.writer in writers for row in bucket):
        return False
    low, high = read.time_range
    return any(
        not row.closed or (row.rows and row.t_min <= high and row.t_max >= low) for row in bucket
    )


def read_rows(directory: Directory, tables: Sequence[RowTable], read: Read) -> Iterator[TableRow]:
    """Yield the rows of several tables in the order (t, node, seq, table), or its reverse.

    Memory: one or two pages for each table and node that has rows at the time.
    """
    for message in _Merge(_BucketQueue(directory, tables, read), read).messages():
        if isinstance(message, TableRow):
            yield message
        else:
            yield from rows_of(message)


def read_portions(
    directory: Directory, tables: Sequence[RowTable], read: Read
) -> Iterator[TableRow | Sequence[Portion]]:
    """Yield the messages of several tables in the same order: rows, and portions together.

    The messages of portions that come together may lie between each other; no other message does.
    """
    return _Merge(_BucketQueue(directory, tables, read, together=True), read).messages()


class _Merge:
    """Merges the messages of buckets.

    Args:
        waiting: The buckets.
        read: What is read.
    """

    def __init__(self, waiting: _BucketQueue, read: Read) -> None:
        self._waiting = waiting
        self._sign = -1 if read.reverse else 1
        self._count = 0
        self._heap: list[tuple[_Order, int, TableRow | Portion, _Messages]] = []
        """The next message of each open bucket, and the others; the number of the entry between
        them, so that the heap never compares two messages."""

    def _push(self, message: TableRow | Portion, stream: _Messages) -> None:
        self._count += 1
        heapq.heappush(self._heap, (_order(message, self._sign), self._count, message, stream))

    def _push_next(self, stream: _Messages) -> None:
        message = next(stream, None)
        if message is not None:
            self._push(message, stream)

    def messages(self) -> Iterator[TableRow | Sequence[Portion]]:
        """Yield rows, and portions together."""
        heap, waiting, sign = self._heap, self._waiting, self._sign
        held = HeldPortions()
        while True:
            is_due = waiting.has_next and (not heap or waiting.opens_before(heap[0][2].t, sign))
            if held:
                # All that comes next comes at this place or after it.
                place = place_of(heap[0][2]) if heap else None
                if is_due:
                    place = waiting.start, "", MIN_SEQ, ""
                is_row = bool(heap) and not is_due and isinstance(heap[0][2], TableRow)
                if place is None or is_row or held.are_enough(place):
                    portions = held.take(place)
                    if portions:
                        yield portions
            if is_due:
                self._push_next(waiting.next_messages())
                continue
            if not heap:
                return
            _, _, message, stream = heapq.heappop(heap)
            if not isinstance(message, TableRow):
                held.add(message)
                self._push_next(stream)
                continue
            yield message
            if held:
                self._push_next(stream)
                continue
            # While one stream is before all others it does not need the heap.
            limit = heap[0][0] if heap else None
            for following in stream:
                if isinstance(following, TableRow):
                    late = limit is not None and _order(following, sign) > limit
                    if not late and not (
                        waiting.has_next and waiting.opens_before(following.t, sign)
                    ):
                        yield following
                        continue
                self._push(following, stream)
                break


def _order(message: TableRow | Portion, sign: int) -> _Order:
    """Return what messages are compared by; sign: 1 = ascending, -1 = descending.

    Portions are read ascending only, and have the place of their first message.
    """
    if sign > 0 or not isinstance(message, TableRow):
        return place_of(message)
    return (-message.t, _invert(message.node), -message.seq, _invert(message.table))


def _invert(text: str) -> tuple[int, ...]:
    """Return what sorts texts in descending order."""
    # The last number is above all others, so of two texts the longer one comes first.
    return (*(-ord(c) for c in text), 1)


def _walk(directory: Directory, table: RowTable, read: Read) -> BucketWalk:
    """Return the walk through the buckets of a table that may hold rows of a read."""
    return BucketWalk(
        directory,
        table.name,
        table.metadata,
        *_first_and_last(read, table),
        read.whose.nodes,
        reverse=read.reverse,
        few=_takes_few(read),
    )


def _plans(table: RowTable, walk: BucketWalk, read: Read) -> Iterator[BucketPlan]:
    """Yield the buckets of a table that may hold rows of a read, in order of their beginnings.

    They have no sizes of pages yet. Among them are entries without rows: see BucketPlan.
    """
    length = table.metadata.bucket_ns
    high = read.time_range.high
    if read.after is not None:
        high = min(high, read.after.t)
    for bucket, group in walk.groups():
        if group and not _may_hold(read, group):
            continue
        if group and read.skip is not None and read.skip(table, group[0].node, bucket):
            continue
        start = min((bucket + 1) * length, high + 1) if read.reverse else bucket * length
        yield BucketPlan(start, table, group[0].node if group else "", bucket, group)


def foresee(
    directory: Directory, tables: Sequence[RowTable], read: Read
) -> tuple[list[BucketPlan], int]:
    """Return the buckets in which a read probably begins, and the number of nodes of its tables.

    Both are what the last read of the same tables in the same direction met; there are no buckets
    if that is unknown, or if it began in too many.
    """
    buckets: list[BucketPlan] = []
    streams = 0
    for table in tables:
        first_nodes, groups = directory.first.get((table.name, read.reverse), ((), ()))
        nodes = [
            node for node in first_nodes if read.whose.nodes is None or node in read.whose.nodes
        ]
        streams += len(nodes)
        low, high = _first_and_last(read, table)
        buckets += [
            BucketPlan(0, table, group[0].node, group[0].bucket, group)
            for group in groups
            if group[0].node in nodes and low <= group[0].bucket <= high and _may_hold(read, group)
        ]
    return (buckets if len(buckets) <= MOST_FIRST else []), streams


def _note_first(
    directory: Directory,
    walks: Iterable[tuple[RowTable, Collection[str]]],
    plans: Iterable[BucketPlan],
    read: Read,
) -> None:
    """Cache the buckets in which a read began, and the nodes that were found in each table."""
    groups: dict[str, list[Sequence[BucketRow]]] = {}
    for plan in plans:
        if plan.rows:
            groups.setdefault(plan.table.name, []).append(plan.rows)
    for table, nodes in walks:
        if table.name in groups:
            directory.first[table.name, read.reverse] = tuple(nodes), groups[table.name]


def _begins(plan: BucketPlan) -> tuple[int, str, str]:
    """Return what the buckets of several tables are sorted by."""
    return plan.start, plan.node, plan.table.name


def _request(plan: BucketPlan) -> _Request:
    """Return what distinguishes the request for a bucket from others of the same read."""
    sizes = plan.page_rows, plan.page_bytes, plan.first_rows
    return (plan.table.name, plan.node, plan.bucket, *sizes)


def _page_rows(group: Sequence[BucketRow], page_bytes: int) -> int:
    """Return the number of rows of a page of a bucket, by its entries in the directory."""
    count = sum(row.rows for row in group)
    if not count:
        return max(1, page_bytes // UNKNOWN_ROW_BYTES)
    mean = sum(row.bytes for row in group) / count + _ROW_OVERHEAD
    # Even a page of rows that are all as large as the largest must fit into memory.
    largest = max(row.largest for row in group) + _ROW_OVERHEAD
    rows = min(page_bytes / mean, 8 * page_bytes / largest)
    return max(1, min(MAX_PAGE_ROWS, int(rows)))


class _BucketQueue:
    """The buckets that are still to be read; the next ones are requested ahead.

    Of whole buckets one is requested ahead. Of filtered buckets, which return few rows, many are
    requested ahead, but not from the start, because the caller may need only the first row. If few
    rows are wanted, the buckets that hold that many are requested: one, those that begin at the
    same time, and more if the directory lists fewer rows in these. The numbers grow as rows are
    taken.

    Args:
        directory, tables, read: What is read.
        together: Whether portions are preferred to rows that have only some columns.

    Attributes:
        has_next: Whether there are buckets to be read.
        start: Time at which the next bucket begins, ns; see BucketPlan.
    """

    def __init__(
        self,
        directory: Directory,
        tables: Sequence[RowTable],
        read: Read,
        *,
        together: bool = False,
    ) -> None:
        self._directory = directory
        self._read = read
        self._together = together
        self._rows = max(1, read.wanted or 1)
        """Number of rows that are wanted of the next buckets, if few are."""
        self._few = _takes_few(read)
        self._early: dict[_Request, _Messages] = {}
        """Buckets that were requested before the directory answered."""
        if self._few and (read.chooser is None or not read.chooser.checks):
            self._foresee(directory, tables)
        walks = [(table, _walk(directory, table, read)) for table in tables]
        plans = [_plans(table, walk, read) for table, walk in walks]
        self._plans = heapq.merge(*plans, key=_begins, reverse=read.reverse)
        self._next = next(self._plans, None)
        self._asked: deque[tuple[BucketPlan, _Messages, bool]] = deque()
        """Requested buckets, their rows, and whether the server filters them."""
        self._ahead = 0 if self._few else 1
        """Number of buckets that are requested in addition to the next one."""
        self._listed = 0
        """Number of rows, by the directory, of the buckets that were taken."""
        self._unnoted = walks if self._few else []
        """The walks until it was noted in which buckets they began."""
        self._divide_among(sum(len(walk.met) for _, walk in walks))
        self._update_next()

    def _divide_among(self, streams: int) -> None:
        """Divide the memory, and the number of wanted rows, among these streams."""
        self._streams = max(1, streams)

    def _page_bytes(self, table: RowTable) -> int:
        """Return the size of a page of a table's bucket, by the number of buckets read at once."""
        # For filtered blocks only headers are requested ahead, for filtered rows the rows.
        checks = self._read.chooser is not None and not layout_of(table).filters_headers
        pages = self._streams + (FILTERED_BUCKETS_AHEAD if self._few or checks else 1)
        return min(PAGE_BYTES, max(64 * 1024, ALL_PAGES_BYTES // (2 * pages)))

    def _foresee(self, directory: Directory, tables: Sequence[RowTable]) -> None:
        """Request the buckets that are probably read first, before the directory answers."""
        plans, streams = foresee(directory, tables, self._read)
        self._divide_among(streams)
        for plan in map(self._set_size, plans):
            self._early[_request(plan)] = self._open(plan, None)

    def _update_next(self) -> None:
        """Set ``has_next`` and ``start`` by the next bucket."""
        first = self._asked[0][0] if self._asked else self._next
        self.has_next = first is not None
        self.start = 0 if first is None else first.start

    def opens_before(self, t: int, sign: int) -> bool:
        """Return whether the next bucket may hold rows that come before or at t, ns.

        Args:
            sign: 1 = ascending, -1 = descending.
        """
        return (self.start - t) * sign <= 0

    def _open(self, plan: BucketPlan, queries: Queries) -> _Messages:
        """Request the first messages of a bucket by some queries; return all of them."""
        return layout_of(plan.table).open(plan, self._read, queries, together=self._together)

    def next_messages(self) -> _Messages:
        """Remove the next bucket from the queue, and return the iterator over its messages.

        Before, this bucket and some that follow it are requested, if they are not yet. The caller
        has checked ``has_next``; it may read the iterator while it asks for further buckets.
        """
        self._request_ahead()
        self._note_first_buckets()
        plan, rows, filtered = self._asked.popleft()
        self._update_next()
        self._listed += max(1, plan.listed) if plan.rows else 0
        if not self._few or (self._listed >= self._rows and self.start != plan.start):
            self._ahead = min(max(1, 2 * self._ahead), FILTERED_BUCKETS_AHEAD) if filtered else 1
            self._rows = min(GROWTH * self._rows, MAX_PAGE_ROWS)
        return rows

    def _request_ahead(self) -> None:
        """Request buckets, in their order, up to the first that need not be requested yet."""
        while self._next is not None and self._is_due(self._next):
            self._ask(self._next)
            self._next = next(self._plans, None)

    def _note_first_buckets(self) -> None:
        """Note once, for ``foresee``, in which buckets a read of few rows has begun."""
        if self._unnoted:
            walks = [(table, walk.met) for table, walk in self._unnoted]
            _note_first(self._directory, walks, [b for b, _, _ in self._asked], self._read)
            self._unnoted = []

    def _is_due(self, plan: BucketPlan) -> bool:
        """Return whether a bucket must be requested now, in addition to those that already are."""
        if not self._asked or (plan.rows and len(self._asked) <= self._ahead):
            return True
        if not self._few or not plan.rows or len(self._asked) > FILTERED_BUCKETS_AHEAD:
            return False
        entries = self._listed + sum(other.listed for other, _, _ in self._asked)
        return plan.start == self._asked[0][0].start or entries < self._rows

    def _set_size(self, plan: BucketPlan) -> BucketPlan:
        """Return a bucket with the sizes of its pages."""
        rows = min(self._rows, max(MERGED_ROWS, 2 * self._rows // self._streams))
        page_bytes = self._page_bytes(plan.table)
        return plan._replace(
            page_rows=_page_rows(plan.rows, page_bytes),
            page_bytes=page_bytes,
            first_rows=rows if self._few else 0,
        )

    def _ask(self, plan: BucketPlan) -> None:
        """Request a bucket, unless that was done early; an entry without rows has none."""
        if not plan.rows:
            self._asked.append((plan, iter(()), False))
            return
        plan, chooser = self._set_size(plan), self._read.chooser
        queries = None if chooser is None else chooser.choose(plan.table, plan.rows)
        early = self._early.pop(_request(plan), None) if queries is None else None
        rows = self._open(plan, queries) if early is None else early
        self._asked.append((plan, rows, queries is not None))
