# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A read of one bucket in which each message has its own row: all rows, or those of queries.

All rows of a bucket are read, or those that pass the server's filter.
"""

from __future__ import annotations

import heapq
import logging
from functools import partial
from itertools import chain
from typing import Iterable, Iterator, Sequence

from cassandra.query import PreparedStatement

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.read import Query, Read
from cassandra_ros.store.connection.driver_errors import DRIVER_ERRORS, is_refused
from cassandra_ros.store.connection.protocol import RawPage
from cassandra_ros.store.connection.requests import PagedRead, RawRow
from cassandra_ros.store.rows.page_rows import rows_of_page
from cassandra_ros.store.tables.row_table import (
    KEYS,
    Order,
    TableRow,
    bind,
    decode_long,
    encode_int,
    encode_orders,
)
from cassandra_ros.store.tables.table_layout import BucketPlan, Portion, ends_of

_log = logging.getLogger(__name__)

KEYS_AT_ONCE = 100
"""Maximum number of rows that one statement fetches by their keys."""
KEYED_SHARE = 0.04
"""Largest share of a bucket's rows that is fetched by key after filtering. Above it the server
returns whole rows."""
TURNED_PAGES = 2
"""Maximum number of pages of an index that are held in memory to reverse their order."""


class RowStream:
    """The rows of one bucket that match one query. The first request is sent when it is made.

    Args:
        plan, read: What is read.
        query: What the server checks.
        together: Whether the messages of pages come as portions, also if a condition is checked on
            them.

    Attributes:
        refused: Whether the server refused the query, so that all rows are read.
    """

    def __init__(
        self, plan: BucketPlan, read: Read, query: Query, *, together: bool = False
    ) -> None:
        self._plan = plan
        self._read = read
        columns = None if read.columns is None else read.columns(plan.table)
        self._columns = plan.table.columns if columns is None else columns
        # The messages of a page are made together. They come as rows in descending order, and if a
        # condition is checked on their columns.
        checked = read.chooser is not None and read.chooser.checks
        self._together = columns is None and (together or not checked)
        self._partition_key = plan.table.partition_key(plan.node, plan.bucket)
        self._terms, indexed = query
        # To filter a row the server needs fewer columns than to return it. If few rows pass, only
        # their keys are requested, and then these rows.
        filtered = bool(self._terms) and not indexed
        self._keyed = filtered and read.chooser is not None and read.chooser.few(plan.table)
        # The server cannot reverse the order of the rows of an index.
        self._turned = read.reverse and indexed
        self.refused = False
        # A writer id is the upper half of a _seq.
        writers = read.whose.writers
        self._heads = None if writers is None else {encode_int(writer) for writer in writers}
        self._at_once = min(KEYS_AT_ONCE, plan.page_rows)
        """Maximum number of rows that are fetched together by their keys."""
        self._early: tuple[Sequence[RawRow], PagedRead | None] = ((), None)
        """Keys of rows that were requested on the driver's thread, and this request."""
        self._asked = self._start(None)

    def _start(self, last: RawRow | None) -> PagedRead:
        """Request the rows after the last one that was read."""
        table = self._plan.table
        if self._keyed:
            self._prepared_by_keys()  # now: the driver's thread must not wait for the server
        try:
            return table.select_range(
                KEYS if self._keyed else table.listing(self._columns),
                self._partition_key,
                ends_of(self._plan, self._read),
                terms=self._terms,
                page_rows=self._plan.page_rows,
                first_rows=0 if self._turned or last else self._plan.first_rows,
                reverse=self._read.reverse and not self._turned,
                last=last,
                refused=is_refused if self._terms else None,
                on_page=self._fetch_early if self._keyed else None,
            )
        except SchemaConflict as exc:
            if not self._terms:
                raise
            return self._all(exc, last)

    def _all(self, exc: object, last: RawRow | None) -> PagedRead:
        """Go on with all rows, if a server forbids filtering or is too slow at it."""
        topic = self._plan.table.metadata.topic
        _log.info("topic %s is read whole, the server does not filter it: %s", topic, exc)
        self._terms, self._turned, self._keyed, self.refused = (), False, False, True
        return self._start(last)

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows in the order of reading."""
        for message in self.messages():
            if isinstance(message, TableRow):
                yield message
            else:
                yield from message.rows()

    def messages(self) -> Iterator[TableRow | Portion]:
        """Yield the rows in the order of reading, those that were read together as portions."""
        return chain.from_iterable(self._pages())

    def _pages(self) -> Iterator[Iterable[TableRow | Portion]]:
        """Yield the rows page by page, in the order of reading."""
        if self._turned:
            rows = self._read_turned()
            if rows is not None:
                rows.sort(key=_bucket_order, reverse=True)
                yield rows
                return
            # All rows, from the newest on.
            self._asked = self._all("an index does not give its rows, or too many", None)
        last: RawRow | None = None
        while True:
            try:
                for page in self._asked.pages():
                    if self._keyed and self._are_too_many(page):
                        break
                    yield self._rows_of(self._fetch(page) if self._keyed else page)
                    last = self._asked.last
                else:
                    return
                # From here on whole rows are filtered.
                self._keyed = False
                self._asked = self._start(last)
            except DRIVER_ERRORS as exc:
                self._asked = self._all(exc, last)

    def _are_too_many(self, keys: Sequence[RawRow]) -> bool:
        """Return whether there are so many keys that requesting whole rows is faster."""
        if len(keys) <= KEYS_AT_ONCE:
            return False
        span = abs(decode_long(keys[-1][0]) - decode_long(keys[0][0]))
        return len(keys) > KEYED_SHARE * self._plan.listed_in(span)

    def _read_turned(self) -> list[TableRow] | None:
        """Read the rows of an index, ascending; None if that fails or they are too many."""
        rows: list[TableRow] = []
        try:
            for page in self._asked.pages():
                rows.extend(self._rows_one_by_one(page))
                if len(rows) > TURNED_PAGES * self._plan.page_rows:
                    return None
        except DRIVER_ERRORS as exc:
            _log.info("topic %s by an index: %s", self._plan.table.metadata.topic, exc)
            return None
        return rows

    def _rows_of(self, values: Iterable[RawRow]) -> Iterable[TableRow | Portion]:
        """Make rows of a page, or of some rows; leave out those of other writers, and expired ones.

        The messages of a page are made together where possible.
        """
        rows: Iterable[TableRow | Portion] | None = None
        if self._together and self._heads is None and isinstance(values, RawPage):
            rows = rows_of_page(self._plan.table, self._plan.node, values)
        return self._rows_one_by_one(values) if rows is None else rows

    def _rows_one_by_one(self, values: Iterable[RawRow]) -> Iterable[TableRow]:
        """Make the rows that ``_rows_of`` makes, each by itself."""
        table, node, heads = self._plan.table, self._plan.node, self._heads
        if heads is not None:
            values = (row for row in values if (row[1] or b"")[:4] in heads)
        if table.metadata.ttl:
            values = (row for row in values if not table.is_rest(row))
        return map(partial(table.row_from_values, node), values)

    def _fetch(self, keys: Sequence[RawRow]) -> Iterator[RawRow]:
        """Fetch the rows of keys, in their order. Rows that were deleted meanwhile are missing."""
        for n in range(0, len(keys), self._at_once):
            batch = keys[n : n + self._at_once]
            early, request = self._early
            if request is None or early != batch:
                request = self._ask_by_keys(batch)
            yield from request.page()

    def _fetch_early(self, keys: Sequence[RawRow]) -> None:
        """Request the first rows as soon as their keys are here, on the driver's thread."""
        if keys and not self._are_too_many(keys):
            batch = keys[: self._at_once]
            self._early = batch, self._ask_by_keys(batch)

    def _prepared_by_keys(self) -> PreparedStatement:
        """Return the statement that fetches rows by their keys."""
        return self._plan.table.select_these(self._columns, reverse=self._read.reverse)

    def _ask_by_keys(self, batch: Sequence[RawRow]) -> PagedRead:
        """Request the rows of at most _at_once keys, in one page."""
        values = (*self._partition_key, encode_orders([(t or b"", seq or b"") for t, seq in batch]))
        return self._plan.table.send(bind(self._prepared_by_keys(), values, self._at_once))


def merged(read: Read, streams: Sequence[RowStream]) -> Iterator[TableRow]:
    """Yield the rows of several queries in one order, without duplicates."""
    last = None
    row_streams = [stream.rows() for stream in streams]
    for row in heapq.merge(*row_streams, key=_bucket_order, reverse=read.reverse):
        if _bucket_order(row) != last:
            last = _bucket_order(row)
            yield row


def _bucket_order(row: TableRow) -> Order:
    """Return what the rows of a bucket are sorted by."""
    return row.t, row.seq
