# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows out of Cassandra: any number of tables and nodes, merged in the one order, by pages."""

from __future__ import annotations

import heapq
from collections import deque
from typing import Deque, Iterator, Sequence, Tuple, Union

from cassandra_ros.store.bucket_stream import BucketStream, Piece, Scan
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.row_table import RowTable, TableRow

PAGE_BYTES = 2 * 1024 * 1024
ALL_PAGES_BYTES = 16 * 1024 * 1024
"""What all streams of one merged read may hold together, about."""
MAX_PAGE_ROWS = 5000
AHEAD = 16
"""Buckets that the server filters at once."""
UNKNOWN_ROW_BYTES = 32 * 1024
"""Assumed where the directory knows nothing yet of a bucket (opened seconds ago)."""
_ROW_OVERHEAD = 64

_Order = Tuple[Union[int, str, Tuple[int, ...]], ...]


def readRows(directory: Directory, tables: Sequence[RowTable], scan: Scan) -> Iterator[TableRow]:
    """Yield the rows of several tables in the order (t, node, seq, table), or its reverse.

    Memory is bounded: one or two pages for each table and node that has rows at the time.
    """
    pieces = _pieces(directory, tables, scan)
    sign = -1 if scan.reverse else 1
    heap: list[tuple[_Order, int, TableRow, Iterator[TableRow]]] = []
    waiting = _Prefetched(pieces, scan)
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


def _order(row: TableRow, sign: int) -> _Order:
    if sign > 0:
        return row[:4]
    return (-row.t, _inverted(row.node), -row.seq, _inverted(row.table))


def _inverted(text: str) -> tuple[int, ...]:
    # Closed by a number above all others: of two texts the longer one comes first.
    return (*(-ord(c) for c in text), 1)


def _pieces(directory: Directory, tables: Sequence[RowTable], scan: Scan) -> list[Piece]:
    found: list[Piece] = []
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
    pages = len(streams) + (1 if scan.chooser is None else AHEAD)
    page_bytes = min(PAGE_BYTES, max(64 * 1024, ALL_PAGES_BYTES // (2 * pages)))
    for table, rows in groups:
        by_bucket: dict[tuple[str, int], list[BucketRow]] = {}
        for row in rows:
            by_bucket.setdefault((row.node, row.bucket), []).append(row)
        length = table.metadata.bucket_ns
        for (node, bucket), group in by_bucket.items():
            start = min((bucket + 1) * length, high + 1) if scan.reverse else bucket * length
            rows_a_page = _pageRows(group, page_bytes)
            found.append(Piece(start, table, node, bucket, group, rows_a_page))
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
    """The buckets still to be read, the next ones asked for before their turn comes.

    Where whole buckets are read, one is asked for ahead. Where the server filters them, little
    comes of each and many are worked on at once; but not from the start, for whoever only wants
    the first row.
    """

    def __init__(self, pieces: list[Piece], scan: Scan) -> None:
        self._scan = scan
        self._pieces = pieces
        self._next = 0
        self._asked: Deque[BucketStream] = deque()
        self._ahead = 1

    @property
    def left(self) -> bool:
        return self._next < len(self._pieces)

    def opensBefore(self, t: int, sign: int) -> bool:
        """Say whether the next bucket may hold rows that come before or at t."""
        return (self._pieces[self._next].start - t) * sign <= 0

    def take(self) -> Iterator[TableRow]:
        end = self._next + 1 + self._ahead
        for piece in self._pieces[self._next + len(self._asked) : end]:
            self._asked.append(BucketStream(piece, self._scan))
        self._next += 1
        stream = self._asked.popleft()
        self._ahead = min(2 * self._ahead, AHEAD) if stream.filtered else 1
        return stream.rows()
