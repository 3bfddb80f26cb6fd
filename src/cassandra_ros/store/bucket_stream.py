# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of one bucket, page after page, all of them or those that the server lets through."""

from __future__ import annotations

import heapq
import logging
import struct
from typing import Any, Iterator, Sequence

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.driver_errors import DRIVER_ERRORS, isRefused
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    RowTable,
    TableRow,
    bind,
    decodeLong,
    encodeLong,
)
from cassandra_ros.store.scan import Piece, Query, Scan

_log = logging.getLogger(__name__)

_INT = struct.Struct(">i")
_ALL: Query = ((), False)
KEYS_AT_ONCE = 100
"""Rows that are fetched with one statement."""
TURNED_PAGES = 2
"""So many pages of what an index finds are held to be turned."""


class BucketStream:
    """The rows of one bucket in their order; the first pages are asked for at once.

    Attributes:
        filtered: The server leaves rows out.
    """

    def __init__(self, cassandra: Cassandra, piece: Piece, scan: Scan) -> None:
        self._piece = piece
        self._scan = scan
        chosen = None if scan.chooser is None else scan.chooser.choose(piece.table, piece.rows)
        self.filtered = chosen is not None
        queries = [_ALL] if chosen is None else chosen
        # All queries of a bucket share what one may hold.
        piece = piece._replace(page_rows=max(1, piece.page_rows // max(1, len(queries))))
        self._streams = [_Stream(cassandra, piece, scan, query) for query in queries]

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

    def __init__(self, cassandra: Cassandra, piece: Piece, scan: Scan, query: Query) -> None:
        self._cassandra = cassandra
        self._piece = piece
        self._scan = scan
        self._low = _lowest(piece, scan)
        self._high = _highest(piece, scan)
        self._terms, indexed = query
        # To look at a row the server needs fewer columns than to answer with it: where it lets
        # few through, only their keys are asked for, and then these rows.
        filtered = bool(self._terms) and not indexed
        self._keyed = filtered and scan.chooser is not None and scan.chooser.few(piece.table)
        # The server cannot turn the order of what an index finds.
        self._turned = scan.reverse and indexed
        self.refused = False
        """The server did not do what it was asked for; all rows are read."""
        self._statement: Any = None
        self._future: Any = None
        self._at_once = min(KEYS_AT_ONCE, piece.page_rows)
        self._early: tuple[Sequence[Any], Any] = ((), None)
        self._start()

    def _start(self) -> None:
        table, terms = self._piece.table, [term[:2] for term in self._terms]
        reverse = self._scan.reverse and not self._turned
        columns = None if self._keyed else self._columns()
        try:
            self._statement = table.selectRange(columns, reverse=reverse, terms=terms)
        except SchemaConflict as exc:
            if not self._terms:
                raise
            self._readAll(exc)
            return
        self._future = self._ask()

    def _columns(self) -> Sequence[str]:
        wanted = None if self._scan.columns is None else self._scan.columns(self._piece.table)
        return self._piece.table.columns if wanted is None else wanted

    def _ask(self) -> Any:
        bounds = [encodeLong(v) for v in (*self._low, *self._high)]
        key = (self._piece.node.encode(), encodeLong(self._piece.bucket))
        values = [value for _, _, value in self._terms]
        bound = bind(self._statement, (*key, *bounds, *values))
        bound.fetch_size = self._piece.page_rows
        future = self._cassandra.sendRaw(bound)
        if self._keyed:
            # Prepared before: the driver's thread must not wait for the server.
            self._these()
            future.add_callback(self._fetchEarly)
        return future

    def _fetchEarly(self, keys: Sequence[Any]) -> None:
        """Ask for the first rows as soon as their keys are here, on the driver's thread."""
        if keys:
            part = keys[: self._at_once]
            self._early = part, self._askThese(part)

    def _these(self) -> Any:
        wanted = _rowsOf(self._piece.table, self._columns(), self._scan.reverse)
        return self._cassandra.prepare(wanted)

    def _askThese(self, part: Sequence[Any]) -> Any:
        place = (self._piece.node.encode(), encodeLong(self._piece.bucket))
        bound = bind(self._these(), (*place, _pairs(part)))
        bound.fetch_size = self._at_once
        return self._cassandra.sendRaw(bound)

    def _readAll(self, exc: object) -> None:
        """Go on with all rows from here: a server may forbid to filter, or be too slow at it."""
        _log.info(
            "topic %s is read whole, the server does not filter it: %s",
            *(self._piece.table.metadata.topic, exc),
        )
        self._terms, self._turned, self._keyed, self.refused = (), False, False, True
        self._start()

    def _page(self) -> list[Any]:
        patience = Patience(f"reading topic {self._piece.table.metadata.topic}")
        while True:
            try:
                return self._future.result().current_rows  # type: ignore[no-any-return]
            except DRIVER_ERRORS as exc:
                if self._terms and isRefused(exc):
                    self._readAll(exc)
                    continue
                patience.wait(exc)
                self._future = self._ask()

    def rows(self) -> Iterator[TableRow]:
        if self._turned:
            found: list[TableRow] = []
            for row in self._pages():
                if not self._turned or len(found) >= TURNED_PAGES * self._piece.page_rows:
                    break
                found.append(row)
            else:
                yield from sorted(found, key=_place, reverse=True)
                return
            # Too much to be held, or the index failed: from the newest on, all rows.
            del found
            self._low, self._high = (
                _lowest(self._piece, self._scan),
                _highest(self._piece, self._scan),
            )
            self._readAll("an index finds too many rows to turn their order")
        yield from self._pages()

    def _pages(self) -> Iterator[TableRow]:
        table, node = self._piece.table, self._piece.node
        make = table.rowFromValues
        while True:
            page = self._page()
            more = self._future.has_more_pages
            if page and more:
                # Where a later page fails the rest is asked for from here.
                t, seq = map(decodeLong, page[-1][:2])
                if self._scan.reverse and not self._turned:
                    self._high = (t, seq - 1)
                elif not self._turned:
                    self._low = (t, seq + 1)
            if more:
                self._future.start_fetching_next_page()
            for values in self._fetched(page) if self._keyed else page:
                if not table.isRest(values):
                    yield make(node, values)
            if not more:
                return

    def _fetched(self, keys: Sequence[Any]) -> Iterator[Any]:
        """Fetch the rows of keys, in their order."""
        table = self._piece.table
        parts = [keys[n : n + self._at_once] for n in range(0, len(keys), self._at_once)]
        for part in parts:
            patience = Patience(f"reading topic {table.metadata.topic}")
            asked, future = self._early
            if asked != part:
                future = self._askThese(part)
            while True:
                try:
                    rows = future.result().current_rows
                    break
                except DRIVER_ERRORS as exc:
                    patience.wait(exc)
                    future = self._askThese(part)
            yield from rows


def _rowsOf(table: RowTable, columns: Sequence[str], reverse: bool) -> str:
    order = ' ORDER BY "_t" DESC, "_seq" DESC' if reverse else ""
    return (
        f'SELECT {table.listing(columns)} FROM {table.qualified} WHERE "_node" = ? AND '
        f'"{table.partition}" = ? AND ("_t", "_seq") IN ?{order}'
    )


def _pairs(keys: Sequence[Any]) -> bytes:
    """Encode (t, seq), each encoded already, as a list of tuples."""
    size = _INT.pack(8)
    pairs = (size + t + size + seq for t, seq in keys)
    return _INT.pack(len(keys)) + b"".join(_INT.pack(24) + pair for pair in pairs)


def _lowest(piece: Piece, scan: Scan) -> tuple[int, int]:
    after = scan.after
    if after is None or scan.reverse or after.t < scan.low:
        return (scan.low, MIN_SEQ)
    if piece.node != after.node:
        return (after.t + (piece.node < after.node), MIN_SEQ)
    if piece.table.name > after.table:
        return (after.t, after.seq)
    return (after.t, after.seq + 1) if after.seq < MAX_SEQ else (after.t + 1, MIN_SEQ)


def _highest(piece: Piece, scan: Scan) -> tuple[int, int]:
    after = scan.after
    if after is None or not scan.reverse or after.t > scan.high:
        return (scan.high, MAX_SEQ)
    if piece.node != after.node:
        return (after.t - (piece.node > after.node), MAX_SEQ)
    return (after.t, after.seq - (piece.table.name >= after.table))
