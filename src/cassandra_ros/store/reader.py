# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows out of Cassandra: any number of tables and nodes, merged in the one order, by pages.

Of each bucket all rows are read, or those that the server lets through.
"""

from __future__ import annotations

import heapq
import logging
from collections import deque
from typing import (
    Callable,
    Deque,
    Iterable,
    Iterator,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    Union,
)

from cassandra.query import PreparedStatement

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.keys import Position
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.driver_errors import DRIVER_ERRORS, is_refused
from cassandra_ros.store.paging import Asked, RawRow
from cassandra_ros.store.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    Order,
    RowTable,
    TableRow,
    bind,
    encode_int,
    encode_long,
)

_log = logging.getLogger(__name__)

PAGE_BYTES = 2 * 1024 * 1024
ALL_PAGES_BYTES = 16 * 1024 * 1024
"""What all streams of one merged read may hold together, about."""
MAX_PAGE_ROWS = 5000
AHEAD = 16
"""Buckets that the server filters at once."""
UNKNOWN_ROW_BYTES = 32 * 1024
"""Assumed where the directory knows nothing yet of a bucket (opened seconds ago)."""
_ROW_OVERHEAD = 64
KEYS_AT_ONCE = 100
"""Rows that are fetched with one statement."""
TURNED_PAGES = 2
"""So many pages of what an index finds are held to be turned."""
_Order = Tuple[Union[int, str, Tuple[int, ...]], ...]

Terms = Tuple[Tuple[str, str, bytes], ...]
"""Column, operator and encoded value; all of them hold."""
Query = Tuple[Terms, bool]
"""What the server is to check, and whether it finds the rows by an index."""


class Chooser(Protocol):
    """Decides, bucket by bucket, what the server is to check."""

    def choose(self, table: RowTable, bucket: Sequence[BucketRow]) -> Optional[Sequence[Query]]:
        """Return the queries whose rows together are those of the bucket that may be wanted.

        None = all rows of the bucket; empty = none of them.
        """

    def few(self, table: RowTable) -> bool:
        """Say whether the server is expected to let few rows of a bucket through."""

    def learn(self, table: RowTable, bucket: Sequence[BucketRow], found: int) -> None:
        """Take note of how many rows the queries of a bucket found."""


class Scan(NamedTuple):
    """What to read: t in [low, high], rows after a position, by chosen columns."""

    low: int
    high: int
    after: Optional[Position] = None
    nodes: Optional[Sequence[str]] = None
    reverse: bool = False
    columns: Optional[Callable[[RowTable], Optional[Sequence[str]]]] = None
    """Which of the format's columns to read, in their order; None = all."""
    chooser: Optional[Chooser] = None
    """None = all rows."""


class Piece(NamedTuple):
    """The part of one bucket that a scan reads."""

    start: int
    """Where in time it begins, in the direction of reading, ns."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """What its writers say in the directory."""
    page_rows: int


_ALL: Query = ((), False)


class BucketStream:
    """The rows of one bucket in their order; the first pages are asked for at once.

    Attributes:
        filtered: The server leaves rows out.
    """

    def __init__(self, piece: Piece, scan: Scan) -> None:
        self._piece = piece
        self._scan = scan
        chosen = None if scan.chooser is None else scan.chooser.choose(piece.table, piece.rows)
        self.filtered = chosen is not None
        queries = [_ALL] if chosen is None else chosen
        # All queries of a bucket share what one may hold.
        piece = piece._replace(page_rows=max(1, piece.page_rows // max(1, len(queries))))
        self._streams = [_Stream(piece, scan, query) for query in queries]

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows; one that several queries find comes once."""
        if not self.filtered:
            return self._streams[0].rows()
        return self._found()

    def _found(self) -> Iterator[TableRow]:
        streams = [stream.rows() for stream in self._streams]
        count, last = 0, None
        for row in heapq.merge(*streams, key=_place, reverse=self._scan.reverse):
            if _place(row) != last:
                last = _place(row)
                count += 1
                yield row
        if self._scan.chooser is not None and not any(s.refused for s in self._streams):
            self._scan.chooser.learn(self._piece.table, self._piece.rows, count)


def _place(row: TableRow) -> tuple[int, int]:
    return row.t, row.seq


class _Stream:
    """The rows of one bucket that one statement gives."""

    def __init__(self, piece: Piece, scan: Scan, query: Query) -> None:
        self._piece = piece
        self._scan = scan
        self._place = (piece.node.encode(), encode_long(piece.bucket))
        self._terms, indexed = query
        # To look at a row the server needs fewer columns than to answer with it: where it lets
        # few through, only their keys are asked for, and then these rows.
        filtered = bool(self._terms) and not indexed
        self._keyed = filtered and scan.chooser is not None and scan.chooser.few(piece.table)
        # The server cannot turn the order of what an index finds.
        self._turned = scan.reverse and indexed
        self.refused = False
        """The server did not do what it was asked for; all rows are read."""
        self._at_once = min(KEYS_AT_ONCE, piece.page_rows)
        self._early: Tuple[Sequence[RawRow], Optional[Asked]] = ((), None)
        self._asked = self._start(None)

    def _start(self, last: RawRow | None) -> Asked:
        """Ask for the rows behind the last one that was read."""
        table, terms = self._piece.table, [term[:2] for term in self._terms]
        reverse = self._scan.reverse and not self._turned
        columns = None if self._keyed else self._columns()
        try:
            statement = table.select_range(columns, reverse=reverse, terms=terms)
        except SchemaConflict as exc:
            if not self._terms:
                raise
            return self._all(exc, last)
        if self._keyed:
            self._these()  # prepared here: the driver's thread must not wait for the server
        return table.stretch(
            statement,
            self._place,
            (_lowest(self._piece, self._scan), _highest(self._piece, self._scan)),
            values=[value for _, _, value in self._terms],
            page_rows=self._piece.page_rows,
            reverse=reverse,
            last=last,
            refused=is_refused if self._terms else None,
            on_page=self._fetch_early if self._keyed else None,
        )

    def _columns(self) -> Sequence[str]:
        wanted = None if self._scan.columns is None else self._scan.columns(self._piece.table)
        return self._piece.table.columns if wanted is None else wanted

    def _all(self, exc: object, last: RawRow | None) -> Asked:
        """Go on with all rows from here: a server may forbid to filter, or be too slow at it."""
        topic = self._piece.table.metadata.topic
        _log.info("topic %s is read whole, the server does not filter it: %s", topic, exc)
        self._terms, self._turned, self._keyed, self.refused = (), False, False, True
        return self._start(last)

    def rows(self) -> Iterator[TableRow]:
        if self._turned:
            found = self._found()
            if found is not None:
                yield from sorted(found, key=_place, reverse=True)
                return
            # From the newest on, all rows.
            self._asked = self._all("an index does not give its rows, or too many", None)
        while True:
            try:
                for page in self._asked.pages():
                    yield from self._made(self._fetched(page) if self._keyed else page)
                return
            except DRIVER_ERRORS as exc:
                self._asked = self._all(exc, self._asked.last)

    def _found(self) -> list[TableRow] | None:
        """Read what an index finds, to be turned; None where that fails, or it is too much."""
        found: list[TableRow] = []
        try:
            for page in self._asked.pages():
                found.extend(self._made(page))
                if len(found) > TURNED_PAGES * self._piece.page_rows:
                    return None
        except DRIVER_ERRORS as exc:
            _log.info("topic %s by an index: %s", self._piece.table.metadata.topic, exc)
            return None
        return found

    def _made(self, values: Iterable[RawRow]) -> Iterator[TableRow]:
        table, node = self._piece.table, self._piece.node
        return (table.row_from_values(node, each) for each in values if not table.is_rest(each))

    def _fetched(self, keys: Sequence[RawRow]) -> Iterator[RawRow]:
        """Fetch the rows of keys, in their order."""
        for n in range(0, len(keys), self._at_once):
            part = keys[n : n + self._at_once]
            early, asked = self._early
            if asked is None or early != part:
                asked = self._ask_these(part)
            yield from asked.page()

    def _fetch_early(self, keys: Sequence[RawRow]) -> None:
        """Ask for the first rows as soon as their keys are here, on the driver's thread."""
        if keys:
            part = keys[: self._at_once]
            self._early = part, self._ask_these(part)

    def _these(self) -> PreparedStatement:
        return self._piece.table.select_these(self._columns(), reverse=self._scan.reverse)

    def _ask_these(self, part: Sequence[RawRow]) -> Asked:
        values = (*self._place, _pairs(part))
        return self._piece.table.send(bind(self._these(), values, self._at_once))


def _pairs(keys: Sequence[RawRow]) -> bytes:
    """Encode (t, seq), each encoded already, as a list of tuples."""
    size = encode_int(8)
    pairs = (encode_int(24) + size + (t or b"") + size + (seq or b"") for t, seq in keys)
    return encode_int(len(keys)) + b"".join(pairs)


def _lowest(piece: Piece, scan: Scan) -> Order:
    after = scan.after
    if after is None or scan.reverse or after.t < scan.low:
        return (scan.low, MIN_SEQ)
    if piece.node != after.node:
        return (after.t + (piece.node < after.node), MIN_SEQ)
    if piece.table.name > after.table:
        return (after.t, after.seq)
    return (after.t, after.seq + 1) if after.seq < MAX_SEQ else (after.t + 1, MIN_SEQ)


def _highest(piece: Piece, scan: Scan) -> Order:
    after = scan.after
    if after is None or not scan.reverse or after.t > scan.high:
        return (scan.high, MAX_SEQ)
    if piece.node != after.node:
        return (after.t - (piece.node > after.node), MAX_SEQ)
    return (after.t, after.seq - (piece.table.name >= after.table))


def read_rows(directory: Directory, tables: Sequence[RowTable], scan: Scan) -> Iterator[TableRow]:
    """Yield the rows of several tables in the order (t, node, seq, table), or its reverse.

    Memory is bounded: one or two pages for each table and node that has rows at the time.
    """
    pieces = _pieces(directory, tables, scan)
    sign = -1 if scan.reverse else 1
    heap: list[tuple[_Order, int, TableRow, Iterator[TableRow]]] = []
    waiting = _Prefetched(pieces, scan)
    count = 0
    while heap or waiting.left:
        while waiting.left and (not heap or waiting.opens_before(heap[0][2].t, sign)):
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
            if waiting.left and waiting.opens_before(row.t, sign):
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
        ends = (table.bucket_of(low), table.bucket_of(high))
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
            rows_a_page = _page_rows(group, page_bytes)
            found.append(Piece(start, table, node, bucket, group, rows_a_page))
    found.sort(key=lambda p: (p.start, p.node, p.table.name), reverse=scan.reverse)
    return found


def _page_rows(group: list[BucketRow], page_bytes: int) -> int:
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

    def opens_before(self, t: int, sign: int) -> bool:
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
