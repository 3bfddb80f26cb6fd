# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Counting rows: from the directory where it is closed, live where it is not."""

from __future__ import annotations

import logging
from typing import Any, Iterator

from cassandra_ros.errors import ConnectionFailed, StoreUnavailable
from cassandra_ros.keys import splitSeq
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.directory import STALE_SEC, BucketRow, Directory, Totals
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import MAX_SEQ, MIN_SEQ, RowTable, bind, encodeLong

_log = logging.getLogger(__name__)

COUNT_PAGE_ROWS = 5000


def scanKeys(
    cassandra: Cassandra, table: RowTable, node: str, bucket: int, low: int, high: int
) -> Iterator[tuple[int, int, int, bool, bool]]:
    """Read (t, seq, size, chunked, odd) of the rows of a bucket with t in [low, high]."""
    start = (low, MIN_SEQ)
    patience = Patience(f"counting topic {table.metadata.topic}")
    while True:
        try:
            for key in _scanFrom(cassandra, table, node, bucket, start, high):
                start = (key[0], key[1] + 1)
                yield key
            return
        except DRIVER_ERRORS as exc:
            patience.wait(exc)


def _scanFrom(
    cassandra: Cassandra, table: RowTable, node: str, bucket: int, start: tuple[int, int], high: int
) -> Iterator[tuple[int, int, int, bool, bool]]:
    ends = (*start, high, MAX_SEQ)
    key = (node.encode(), encodeLong(bucket), *(encodeLong(end) for end in ends))
    bound = bind(table.selectKeys(), key)
    bound.fetch_size = COUNT_PAGE_ROWS
    future = cassandra.sendRaw(bound)
    while True:
        rows = future.result().current_rows
        more = future.has_more_pages
        if more:
            future.start_fetching_next_page()
        for row in rows:
            if row[2] is not None or not table.metadata.ttl:  # else only an index's value is left
                yield _key(row)
        if not more:
            return


def _key(row: tuple[Any, ...]) -> tuple[int, int, int, bool, bool]:
    t, seq, size, nchunks, odd = row
    number = int.from_bytes
    return (
        *(number(t, "big", signed=True), number(seq, "big", signed=True)),
        number(size or b"", "big"),
        nchunks is not None,
        odd is not None,
    )


def recount(cassandra: Cassandra, table: RowTable, node: str, bucket: int) -> dict[int, Totals]:
    """Count the rows of one bucket as they are now, by writer id."""
    found: dict[int, Totals] = {}
    for t, seq, size, chunked, odd in scanKeys(cassandra, table, node, bucket, -(2**63), MAX_SEQ):
        found.setdefault(splitSeq(seq)[0], Totals()).count(t, size, chunked, odd)
    return found


def settle(
    cassandra: Cassandra, directory: Directory, table: RowTable, rows: list[BucketRow]
) -> list[BucketRow]:
    """Replace the estimates of open buckets by counts of now.

    A recount is written back where the bucket has no living writer any more.

    Args:
        rows: Directory rows of one table.

    Returns:
        The same rows, each with values that are true now.
    """
    by_bucket: dict[tuple[str, int], list[BucketRow]] = {}
    for row in rows:
        by_bucket.setdefault((row.node, row.bucket), []).append(row)
    settled: list[BucketRow] = []
    for (node, bucket), group in by_bucket.items():
        # Rows of a topic with a TTL go one by one, and nobody tells the directory.
        if all(row.closed for row in group) and not table.metadata.ttl:
            settled.extend(group)
            continue
        counted = recount(cassandra, table, node, bucket)
        for row in group:
            totals = counted.get(row.writer, Totals())
            if not row.closed and row.age_sec > STALE_SEC:
                _writeBack(directory, table, row, totals)
            settled.append(
                row._replace(
                    rows=totals.rows,
                    bytes=totals.bytes,
                    largest=totals.largest,
                    t_min=totals.t_min,
                    t_max=totals.t_max,
                    odd=totals.odd,
                )
            )
    return settled


def _writeBack(directory: Directory, table: RowTable, row: BucketRow, totals: Totals) -> None:
    try:
        directory.putRecount(table.name, row, totals, table.metadata.ttl)
    except (StoreUnavailable, ConnectionFailed) as exc:
        # A reader may lack the right to write, or meet another one: the count is true all the same.
        _log.debug("the recount of topic %s was not kept: %s", table.metadata.topic, exc)
