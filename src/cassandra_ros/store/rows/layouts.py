# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The layout of a table in which each message has its own row; and which layout a table has."""

from __future__ import annotations

from functools import partial
from itertools import filterfalse
from typing import Iterator, Sequence

from cassandra.query import PreparedStatement

from cassandra_ros.keys import Position, writer_of
from cassandra_ros.read import Query, Read, Writers
from cassandra_ros.store.blocks.block_layout import BlockLayout
from cassandra_ros.store.connection.requests import PagedRead, RawRow
from cassandra_ros.store.rows.row_stream import RowStream, merged
from cassandra_ros.store.tables.directory import BucketTotals
from cassandra_ros.store.tables.row_table import (
    COUNTED_COLUMNS,
    FIRST,
    LAST,
    MAX_SEQ,
    MIN_SEQ,
    RowTable,
    TableRow,
    decode_long,
)
from cassandra_ros.store.tables.table_layout import (
    Answer,
    BucketPlan,
    Finder,
    MessageKey,
    Portion,
    Queries,
    Side,
    TableLayout,
    count_for_chooser,
)

COUNT_PAGE_ROWS = 5000
_EVERY_ROW: Query = ((), False)
"""The query without conditions."""


def layout_of(table: RowTable) -> TableLayout:
    """Return how the messages of a table lie in its rows."""
    return BlockLayout(table) if table.packed else RowLayout(table)


class RowLayout(TableLayout):
    """Rows are found by their keys, or by the server's filters and indexes."""

    filters_headers = False

    @property
    def stored_columns(self) -> tuple[str, ...]:
        """Names of the columns of a row after its partition key, without those of indexes."""
        return self._table.row_columns

    def inserts(self, shadows: Sequence[str]) -> tuple[PreparedStatement, PreparedStatement]:
        """Return the INSERT that most rows need, without the columns of chunks, and the whole."""
        return self._table.insert(shadows, full=False), self._table.insert(shadows)

    def open(
        self, plan: BucketPlan, read: Read, queries: Queries, *, together: bool = False
    ) -> Iterator[TableRow | Portion]:
        """Request the first rows of a bucket; return all of them in order."""
        # The queries of a bucket share the memory of one.
        share = plan._replace(page_rows=max(1, plan.page_rows // max(1, len(queries or ()))))
        streams = [
            RowStream(share, read, query, together=together)
            for query in ((_EVERY_ROW,) if queries is None else queries)
        ]
        messages: Iterator[TableRow | Portion]
        if len(streams) != 1:
            messages = merged(read, streams)
        else:  # one query returns no duplicates, and rows in order
            few = read.reverse or plan.first_rows
            messages = streams[0].rows() if few else streams[0].messages()
        if read.chooser is None or queries is None:
            return messages
        return count_for_chooser(
            plan, read.chooser, messages, lambda: any(stream.refused for stream in streams)
        )

    def finder(self) -> Finder:
        """Return what requests a row by its position."""
        return self.ask

    def ask(self, position: Position, *, any_seq: bool = False) -> Answer:
        """Request a row, also one with a name; any_seq: the first of its time and node."""
        table, (t, node, seq, _, name) = self._table, position
        partition_key = table.partition_key_of(node, t, name)
        order = (t, None) if any_seq else table.stored_order(t, seq)
        return partial(self._answer, position, table.ask_row(partition_key, *order))

    def _answer(self, position: Position, request: PagedRead) -> TableRow | None:
        """Return the row that was requested; None if there is no such row."""
        table = self._table
        for values in request.page()[:1]:
            if not table.is_rest(values):
                return table.row_from_values(position.node, values, position.name)
        return None

    def ask_side(self, node: str, t: int, *, reverse: bool) -> Side:
        """Request the first row of a node in the bucket of a time, from this time on."""
        table = self._table
        request = table.select_range(
            table.listing(),
            table.partition_key(node, table.bucket_of(t)),
            (FIRST, (t, LAST[1])) if reverse else ((t, FIRST[1]), LAST),
            page_rows=1 + reverse,  # two in descending order: see _first
            reverse=reverse,
        )
        return partial(self._first, node, request)

    def _first(self, node: str, request: PagedRead) -> Sequence[TableRow] | None:
        """Return the first row as a list of at most one; None if it is not known."""
        table, values = self._table, request.page()
        rows = [table.row_from_values(node, v) for v in values if not table.is_rest(v)]
        # Descending order begins with the last of several rows with the same time.
        if len(rows) < len(values) or len(rows) == 2 and rows[0].t == rows[1].t:
            return None
        return rows[:1]

    def keys(self, node: str, bucket: int, low: int, high: int) -> Iterator[MessageKey]:
        """Read the keys of the rows of a bucket with a time in [low, high], ns, in order."""
        for row in self._rows(node, bucket, low, high, COUNTED_COLUMNS):
            t, seq, size = map(decode_long, row[:3])
            yield MessageKey(t, seq, size, row[3] is not None, row[4] is not None)

    def written(
        self, node: str, bucket: int, low: int, high: int
    ) -> Iterator[tuple[int, int, bool, int]]:
        """Yield (t, seq, chunked, written) of the rows of a bucket with t in [low, high], ns.

        ``written`` is the server's write time, microseconds since 1970.
        """
        names = f'{COUNTED_COLUMNS}, WRITETIME("_size")'
        for row in self._rows(node, bucket, low, high, names):
            t, seq, written = map(decode_long, (row[0], row[1], row[5]))
            yield t, seq, row[3] is not None, written

    def _rows(self, node: str, bucket: int, low: int, high: int, columns: str) -> Iterator[RawRow]:
        """Yield columns, encoded, of the rows of a bucket with t in [low, high], ns."""
        request = self._table.select_range(
            columns,
            self._table.partition_key(node, bucket),
            ((low, MIN_SEQ), (high, MAX_SEQ)),
            page_rows=COUNT_PAGE_ROWS,
            what="counting",
        )
        return filterfalse(self._table.is_rest, request.rows())

    def count(self, node: str, bucket: int, ends: tuple[int, int], writers: Writers = None) -> int:
        """Return the number of rows of writers with a time in ``ends``, ns, both included."""
        keys = self.keys(node, bucket, *ends)
        return sum(writers is None or writer_of(key.seq) in writers for key in keys)

    def recount(self, node: str, bucket: int) -> dict[int, BucketTotals]:
        """Count the rows that a bucket has now, by writer id."""
        by_writer: dict[int, BucketTotals] = {}
        for t, seq, size, chunked, odd in self.keys(node, bucket, -(2**63), MAX_SEQ):
            by_writer.setdefault(writer_of(seq), BucketTotals()).count(t, size, chunked, odd)
        return by_writer
