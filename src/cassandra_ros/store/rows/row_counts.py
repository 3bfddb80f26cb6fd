# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Counts of rows: from the directory for closed buckets, by reading for the others."""

from __future__ import annotations

import logging
from itertools import filterfalse
from typing import Iterator

from cassandra_ros.errors import AccessDenied, ConnectionFailed, StoreUnavailable
from cassandra_ros.keys import split_seq, writer_of
from cassandra_ros.store.blocks.block_counts import count_part as count_blocks
from cassandra_ros.store.blocks.block_counts import measure
from cassandra_ros.store.blocks.block_stream import BucketRead, stream
from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.tables.directory import STALE_SEC, BucketRow, BucketTotals, Directory
from cassandra_ros.store.tables.row_table import (
    COUNTED_COLUMNS,
    MAX_SEQ,
    MIN_SEQ,
    RowTable,
    decode_long,
)

_log = logging.getLogger(__name__)

COUNT_PAGE_ROWS = 5000


def scan_keys(
    table: RowTable, node: str, bucket: int, low: int, high: int
) -> Iterator[tuple[int, int, int, bool, bool]]:
    """Yield (t, seq, size, chunked, odd) of the rows of a bucket with t in [low, high].

    In a table of blocks these are the messages; all blocks that hold one are read.
    """
    if table.packed:
        ends = (low, MIN_SEQ), (high, MAX_SEQ)
        for message in stream(BucketRead(table, node, bucket, ends, bare=True)):
            yield message.t, message.seq, message.size, message.nchunks > 0, message.odd
        return
    for row in _rows(table, node, bucket, low, high, COUNTED_COLUMNS):
        t, seq, size = map(decode_long, row[:3])
        yield t, seq, size, row[3] is not None, row[4] is not None


def scan_written(
    table: RowTable, node: str, bucket: int, low: int, high: int
) -> Iterator[tuple[int, int, bool, int]]:
    """Yield (t, seq, chunked, written) of the rows of a bucket with t in [low, high].

    ``written`` is the server's write time, microseconds since 1970. Not for tables of blocks.
    """
    for row in _rows(table, node, bucket, low, high, f'{COUNTED_COLUMNS}, WRITETIME("_size")'):
        t, seq, written = map(decode_long, (row[0], row[1], row[5]))
        yield t, seq, row[3] is not None, written


def _rows(
    table: RowTable, node: str, bucket: int, low: int, high: int, columns: str
) -> Iterator[RawRow]:
    """Yield columns, encoded, of the rows of a bucket with t in [low, high]."""
    request = table.select_range(
        columns,
        table.partition_key(node, bucket),
        ((low, MIN_SEQ), (high, MAX_SEQ)),
        page_rows=COUNT_PAGE_ROWS,
        what="counting",
    )
    return filterfalse(table.is_rest, request.rows())


def count_part(
    table: RowTable,
    node: str,
    bucket: int,
    ends: tuple[int, int],
    writers: frozenset[int] | None = None,
) -> int:
    """Return the number of messages of writers (None = all) with a time in ``ends``, inclusive."""
    if table.packed:
        return count_blocks(table, node, bucket, *ends, writers)
    keys = scan_keys(table, node, bucket, *ends)
    return sum(writers is None or writer_of(seq) in writers for _, seq, *_ in keys)


def recount(table: RowTable, node: str, bucket: int) -> dict[int, BucketTotals]:
    """Count the rows that one bucket has now, by writer id."""
    by_writer: dict[int, BucketTotals] = {}
    if table.packed:
        for block, rest in measure(table, node, bucket):
            totals = by_writer.setdefault(block.writer, BucketTotals())
            totals.add(rest.count, rest.bytes, rest.largest, (rest.t_min, rest.t_max), block.odd)
        return by_writer
    for t, seq, size, chunked, odd in scan_keys(table, node, bucket, -(2**63), MAX_SEQ):
        by_writer.setdefault(split_seq(seq)[0], BucketTotals()).count(t, size, chunked, odd)
    return by_writer


def recount_open_buckets(
    directory: Directory, table: RowTable, rows: list[BucketRow]
) -> list[BucketRow]:
    """Return the same rows of the directory with present counts where the stored ones may be old.

    Buckets that are not closed are counted anew by their messages, and in a table with a TTL all
    buckets are. If a bucket has no living writer any more, its counts are written to the directory.
    """
    # In a table with a TTL rows expire one by one, which the directory does not know.
    final = not table.metadata.ttl
    if final and all(row.closed for row in rows):
        return rows
    by_bucket: dict[tuple[str, int], list[BucketRow]] = {}
    for row in rows:
        by_bucket.setdefault((row.node, row.bucket), []).append(row)
    present_rows: list[BucketRow] = []
    for (node, bucket), group in by_bucket.items():
        if final and all(row.closed for row in group):
            present_rows.extend(group)
            continue
        # The entries that a recount compares itself with are read before it.
        writers = {row.writer for row in group if not row.closed and row.age_sec > STALE_SEC}
        entries = directory.find(table.name, node, bucket) if writers else []
        recounts = recount(table, node, bucket)
        for row in entries:
            if row.writer in writers and row.age_sec > STALE_SEC:
                _write_back(directory, table, row, recounts.get(row.writer, BucketTotals()))
        for row in group:
            totals = recounts.get(row.writer, BucketTotals())
            present_rows.append(row._replace(**vars(totals)))
    return present_rows


def _write_back(
    directory: Directory, table: RowTable, row: BucketRow, totals: BucketTotals
) -> None:
    """Write the counts of a bucket to the directory, if that is possible now."""
    try:
        directory.put_recount(table.name, row, totals, table.metadata.ttl)
    except (AccessDenied, StoreUnavailable, ConnectionFailed) as exc:
        # A reader may lack the right to write, or be too late: its count is right all the same.
        _log.debug("the recount of topic %s was not kept: %s", table.metadata.topic, exc)
