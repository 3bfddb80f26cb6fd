# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows out of Cassandra: any number of tables and nodes, merged in the one order, by pages."""

from __future__ import annotations

import heapq
from typing import Any, Callable, Iterator, NamedTuple, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import MAX_SEQ, MIN_SEQ, RowTable, TableRow, bind, encodeLong

PAGE_BYTES = 2 * 1024 * 1024
ALL_PAGES_BYTES = 16 * 1024 * 1024
"""What all streams of one merged read may hold together, about."""
MAX_PAGE_ROWS = 5000
UNKNOWN_ROW_BYTES = 32 * 1024
"""Assumed where the directory knows nothing yet of a bucket (opened seconds ago)."""
_ROW_OVERHEAD = 64


class Scan(NamedTuple):
    """What to read: t in [low, high], rows after a position, by chosen columns."""

    low: int
    high: int
    after: Position | None = None
    nodes: Sequence[str] | None = None
    reverse: bool = False
    columns: Callable[[RowTable], Sequence[str]] | None = None
    """Which of the format's columns to read; None = all."""


class _Piece(NamedTuple):
    start: int
    table: RowTable
    node: str
    bucket: int
    page_rows: int


def readRows(
    cassandra: Cassandra, directory: Directory, tables: Sequence[RowTable], scan: Scan
) -> Iterator[TableRow]:
    """Yield the rows of several tables in the order (t, node, seq, table), or its reverse.

    Memory is bounded: one or two pages for each table and node that has rows at the time.
    """
    pieces = _pieces(directory, tables, scan)
    sign = -1 if scan.reverse else 1
    heap: list[tuple[Any, int, TableRow, Iterator[TableRow]]] = []
    waiting = _Prefetched(cassandra, pieces, scan)
    count = 0
    while heap or waiting.left:
        while waiting.left and (not heap or waiting.opensBefore(heap[0][2].t, sign)):
            stream = waiting.take()
            row = next(stream, None)
            if row is not None:
                count += 1
                heapq.heappush(heap, (_order(row, sign), count, row, stream))
        if not heap:
            return
        _, number, row, stream = heapq.heappop(heap)
        # While one stream is ahead of all others it needs no heap.
        limit = heap[0][0] if heap else None
        while True:
            yield row
            following = next(stream, None)
            if following is None:
                break
            row = following
            if waiting.left and waiting.opensBefore(row.t, sign):
                heapq.heappush(heap, (_order(row, sign), number, row, stream))
                break
            if limit is not None and _order(row, sign) > limit:
                heapq.heappush(heap, (_order(row, sign), number, row, stream))
                break


def _order(row: TableRow, sign: int) -> Any:
    if sign > 0:
        return row[:4]
    return (-row.t, _inverted(row.node), -row.seq, _inverted(row.table))


def _inverted(text: str) -> tuple[int, ...]:
    # Closed by a number above all others: of two texts the longer one comes first.
    return (*(-ord(c) for c in text), 1)


def _pieces(directory: Directory, tables: Sequence[RowTable], scan: Scan) -> list[_Piece]:
    found: list[_Piece] = []
    low, high = scan.low, scan.high
    if scan.after is not None and scan.reverse:
        high = min(high, scan.after.t)
    elif scan.after is not None:
        low = max(low, scan.after.t)
    groups: list[tuple[RowTable, list[BucketRow]]] = []
    streams: set[tuple[str, str]] = set()
    for table in tables:
        ends = (table.bucketOf(low), table.bucketOf(high))
        rows = directory.buckets(table.name, *ends, scan.nodes, table.metadata.ttl)
        groups.append((table, rows))
        streams.update((table.name, row.node) for row in rows)
    page_bytes = min(PAGE_BYTES, max(64 * 1024, ALL_PAGES_BYTES // max(1, 2 * len(streams))))
    for table, rows in groups:
        by_bucket: dict[tuple[str, int], list[BucketRow]] = {}
        for row in rows:
            by_bucket.setdefault((row.node, row.bucket), []).append(row)
        length = table.metadata.bucket_ns
        for (node, bucket), group in by_bucket.items():
            start = min((bucket + 1) * length, high + 1) if scan.reverse else bucket * length
            found.append(_Piece(start, table, node, bucket, _pageRows(group, page_bytes)))
    found.sort(key=lambda p: (p.start, p.node, p.table.name), reverse=scan.reverse)
    return found


def _pageRows(group: list[BucketRow], page_bytes: int) -> int:
    count = sum(row.rows for row in group)
    if not count:
        return max(1, page_bytes // UNKNOWN_ROW_BYTES)
    mean = sum(row.bytes for row in group) / count + _ROW_OVERHEAD
    # A page of rows that are all as large as the largest must still be bearable.
    largest = max(row.largest for row in group) + _ROW_OVERHEAD
    rows = min(page_bytes / mean, 8 * page_bytes / largest)
    return max(1, min(MAX_PAGE_ROWS, int(rows)))


class _Prefetched:
    """The buckets still to be read, the next one asked for before its turn comes."""

    def __init__(self, cassandra: Cassandra, pieces: list[_Piece], scan: Scan) -> None:
        self._cassandra = cassandra
        self._pieces = pieces
        self._scan = scan
        self._next = 0
        self._asked: _Stream | None = None

    @property
    def left(self) -> bool:
        return self._next < len(self._pieces)

    def opensBefore(self, t: int, sign: int) -> bool:
        """Say whether the next bucket may hold rows that come before or at t."""
        return (self._pieces[self._next].start - t) * sign <= 0

    def take(self) -> Iterator[TableRow]:
        stream = self._asked or _Stream(self._cassandra, self._pieces[self._next], self._scan)
        self._next += 1
        self._asked = None
        if self.left:
            self._asked = _Stream(self._cassandra, self._pieces[self._next], self._scan)
        return stream.rows()


class _Stream:
    """The rows of one bucket; the first page is asked for at once."""

    def __init__(self, cassandra: Cassandra, piece: _Piece, scan: Scan) -> None:
        self._cassandra = cassandra
        self._piece = piece
        self._reverse = scan.reverse
        wanted = piece.table.columns if scan.columns is None else scan.columns(piece.table)
        self._statement = piece.table.selectRange(wanted, reverse=scan.reverse)
        self._low = _lowest(piece, scan)
        self._high = _highest(piece, scan)
        self._future = self._ask()

    def _ask(self) -> Any:
        bounds = [encodeLong(v) for v in (*self._low, *self._high)]
        key = (self._piece.node.encode(), encodeLong(self._piece.bucket))
        bound = bind(self._statement, (*key, *bounds))
        bound.fetch_size = self._piece.page_rows
        return self._cassandra.sendRaw(bound)

    def _page(self) -> list[Any]:
        patience = Patience(f"reading topic {self._piece.table.metadata.topic}")
        while True:
            try:
                return self._future.result().current_rows  # type: ignore[no-any-return]
            except DRIVER_ERRORS as exc:
                patience.wait(exc)
                self._future = self._ask()

    def rows(self) -> Iterator[TableRow]:
        table, node = self._piece.table, self._piece.node
        make = table.rowFromValues
        while True:
            page = self._page()
            more = self._future.has_more_pages
            if page and more:
                # Where a later page fails the rest is asked for from here.
                last = make(node, page[-1])
                if self._reverse:
                    self._high = (last.t, last.seq - 1)
                else:
                    self._low = (last.t, last.seq + 1)
            if more:
                self._future.start_fetching_next_page()
            for values in page:
                yield make(node, values)
            if not more:
                return


def _lowest(piece: _Piece, scan: Scan) -> tuple[int, int]:
    after = scan.after
    if after is None or scan.reverse or after.t < scan.low:
        return (scan.low, MIN_SEQ)
    if piece.node != after.node:
        return (after.t + (piece.node < after.node), MIN_SEQ)
    if piece.table.name > after.table:
        return (after.t, after.seq)
    return (after.t, after.seq + 1) if after.seq < MAX_SEQ else (after.t + 1, MIN_SEQ)


def _highest(piece: _Piece, scan: Scan) -> tuple[int, int]:
    after = scan.after
    if after is None or not scan.reverse or after.t > scan.high:
        return (scan.high, MAX_SEQ)
    if piece.node != after.node:
        return (after.t - (piece.node > after.node), MAX_SEQ)
    return (after.t, after.seq - (piece.table.name >= after.table))
