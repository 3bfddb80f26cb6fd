# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The layout of a table whose rows are blocks of messages; see store/tables/table_layout.py."""

from __future__ import annotations

from functools import partial
from typing import Iterator, Sequence

from cassandra.query import PreparedStatement

from cassandra_ros.keys import Position
from cassandra_ros.read import Read, Writers
from cassandra_ros.store.blocks.block_counts import count_part, recount
from cassandra_ros.store.blocks.block_lookup import MessageFinder, answer_one, ask_one
from cassandra_ros.store.blocks.block_stream import (
    EARLY_BLOCKS,
    BucketRead,
    block_portions,
    stream,
)
from cassandra_ros.store.tables.directory import BucketTotals
from cassandra_ros.store.tables.held_portions import rows_in_order
from cassandra_ros.store.tables.row_table import (
    FIRST,
    LAST,
    MAX_SEQ,
    MIN_SEQ,
    TableRow,
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
    ends_of,
)


class BlockLayout(TableLayout):
    """Blocks are found by their headers and unpacked; their messages are merged."""

    filters_headers = True

    @property
    def stored_columns(self) -> tuple[str, ...]:
        """Names of the columns of a block after its partition key."""
        return self._table.block_columns

    def inserts(self, shadows: Sequence[str]) -> tuple[PreparedStatement, PreparedStatement]:
        """Return the INSERT of a block, twice: blocks have no indexes, and all columns."""
        insert = self._table.insert_block()
        return insert, insert

    def open(
        self, plan: BucketPlan, read: Read, queries: Queries, *, together: bool = False
    ) -> Iterator[TableRow | Portion]:
        """Request the first blocks of a bucket; return all of its messages in order."""
        columns = None if read.columns is None else read.columns(self._table)
        bare = columns is not None and not columns  # the caller needs no field
        bucket = self._bucket(plan, read, queries, bare=bare)
        few = bucket.reverse or bucket.wanted
        messages = stream(bucket) if few else block_portions(bucket)
        if read.chooser is None or queries is None:
            return messages
        return count_for_chooser(plan, read.chooser, messages)

    def _bucket(
        self, plan: BucketPlan, read: Read, queries: Queries, *, bare: bool = False
    ) -> BucketRead:
        """Return the read of the blocks of a bucket that pass one of some queries; None = all."""
        table, chooser = self._table, read.chooser
        return BucketRead(
            table,
            plan.node,
            plan.bucket,
            ends_of(plan, read),
            read.reverse,
            read.whose.writers,
            bare=bare,
            filters=None if queries is None else [terms for terms, _ in queries],
            sift=None if chooser is None else chooser.sift(table),
            opened=None if chooser is None else partial(chooser.opened, table),
            wanted=plan.first_rows,
            early=min(EARLY_BLOCKS, len({row.writer for row in plan.rows})),
            page_bytes=plan.page_bytes,
        )

    def finder(self) -> Finder:
        """Return what finds messages one after the other, none of them ahead.

        The block of one message may hold the next ones, too.
        """
        finder = MessageFinder(self._table)
        return lambda position: partial(finder.find, position)

    def ask(self, position: Position, *, any_seq: bool = False) -> Answer:
        """Request the blocks that may hold a message; any_seq: the first of its time and node."""
        request = ask_one(self._table, position, any_seq=any_seq)
        return partial(answer_one, self._table, position, request, any_seq=any_seq)

    def ask_side(self, node: str, t: int, *, reverse: bool) -> Side:
        """Request the first message of a node in the bucket of a time, from this time on."""
        table = self._table
        ends = (FIRST, (t, LAST[1])) if reverse else ((t, FIRST[1]), LAST)
        bucket = BucketRead(table, node, table.bucket_of(t), ends, reverse, wanted=1)
        return partial(_lowest_first, stream(bucket))

    def keys(self, node: str, bucket: int, low: int, high: int) -> Iterator[MessageKey]:
        """Read the keys of the messages in [low, high], ns; blocks with one are unpacked."""
        ends = (low, MIN_SEQ), (high, MAX_SEQ)
        blocks = BucketRead(self._table, node, bucket, ends, bare=True)
        for row in rows_in_order(block_portions(blocks)):
            yield MessageKey(row.t, row.seq, row.size, row.nchunks > 0, row.odd)

    def count(self, node: str, bucket: int, ends: tuple[int, int], writers: Writers = None) -> int:
        """Return the number of messages; only blocks at both ends are unpacked."""
        return count_part(self._table, node, bucket, *ends, writers)

    def recount(self, node: str, bucket: int) -> dict[int, BucketTotals]:
        """Count the messages of a bucket by writer id, by the headers of its blocks."""
        return recount(self._table, node, bucket)


def _lowest_first(messages: Iterator[TableRow]) -> Sequence[TableRow]:
    """Return the lowest of the first messages that have the same time, as a list of at most one."""
    first_rows: list[TableRow] = []
    for row in messages:
        if first_rows and row.t != first_rows[0].t:
            break
        first_rows.append(row)
    return first_rows and [min(first_rows)]
