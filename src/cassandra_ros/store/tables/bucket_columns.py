# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of the directory as columns of numbers, for timelines of 100,000 buckets.

As rows of Python objects they would take ten times as long as the server needs to send them.
"""

from __future__ import annotations

from functools import partial
from typing import Callable, Iterable, Iterator, NamedTuple, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.store.connection.cassandra import REQUESTS_AT_ONCE, Cassandra
from cassandra_ros.store.connection.requests import RawRow, await_answer, retried, sent_ahead
from cassandra_ros.store.tables.row_table import decode_long

Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]
SlotKey = Tuple[str, str, int]
"""Table, node and slot: a partition of the directory."""
SlotRange = Tuple[SlotKey, Sequence[int], int]
"""A partition; its buckets, as the ends of a range (both included) or one by one; row limit."""

ActiveRange = Tuple[str, int, int, int]
"""Table and slot: a partition of cr_active; first and last of its buckets."""

COLUMNS = "bucket, writer, state, deleted, heartbeat, n, bytes, t_min, t_max, toTimestamp(now())"
"""Columns of cr_bucket that ``columns_of`` converts, as CQL."""
PAGE_ROWS = 5000
ACTIVE_PAGE_ROWS = 20_000
"""Maximum number of rows in a page of cr_bucket, and of cr_active."""
_NO_LONG = bytes(8)
"""Encoded 0, in place of null."""
_NEVER = (-(2**63)).to_bytes(8, "big", signed=True)
"""In place of a heartbeat that is null."""


class BucketColumns(NamedTuple):
    """Rows of one partition of the directory in order: one entry for each bucket and writer."""

    bucket: Longs
    writer: Longs
    closed: Bools
    """Whether the counts are final; otherwise they are estimates."""
    writing: Bools
    """Whether the writer has not closed the bucket."""
    cut: Bools
    """Whether messages were deleted since the bucket was counted."""
    age_ms: Longs
    """Time since the heartbeat by the server's clock, ms; very large without a heartbeat."""
    rows: Longs
    """Number of messages; 0 if it is not known yet, or if all were deleted."""
    bytes: Longs
    t_min: Longs
    t_max: Longs
    """Key times of the first and the last message, ns; 0 if they are not known yet."""

    def where(self, mask: Bools) -> BucketColumns:
        """Return the entries for which ``mask`` is true."""
        return BucketColumns._make(column[mask] for column in self)


def read_columns(
    cassandra: Cassandra, table: str, slot_ranges: Iterable[SlotRange], *, single: bool = False
) -> Iterator[BucketColumns]:
    """Read partitions of cr_bucket, several at once; yield them in the order of ``slot_ranges``.

    Args:
        table: Qualified name of cr_bucket.
        slot_ranges: The partitions and their buckets; each is taken when a request can be sent.
        single: The buckets are listed one by one, otherwise they are the ends of a range.
    """
    which = "bucket IN ?" if single else "bucket >= ? AND bucket <= ?"
    cql = (
        f"SELECT {COLUMNS} FROM {table} WHERE tbl = ? AND node = ? AND slot = ? AND {which} LIMIT ?"
    )
    requests = (_ask(cassandra, cql, slot_range, single) for slot_range in slot_ranges)
    return (answer() for answer in sent_ahead(requests, REQUESTS_AT_ONCE))


def _ask(
    cassandra: Cassandra, cql: str, slot_range: SlotRange, single: bool
) -> Callable[[], BucketColumns]:
    """Request buckets of a partition of cr_bucket; return what waits for them."""
    key, buckets, limit = slot_range
    values = (*key, list(buckets), limit) if single else (*key, *buckets, limit)
    rows = _ask_rows(cassandra, cql, values, PAGE_ROWS)
    return lambda: columns_of(rows())


def _ask_rows(
    cassandra: Cassandra, cql: str, values: Sequence[object], page_rows: int
) -> Callable[[], list[RawRow]]:
    """Request rows as Cassandra stores their values; return what waits for all of them."""
    bound = cassandra.prepare(cql).bind(values)
    bound.fetch_size = page_rows
    futures = [cassandra.send_raw(bound)]

    def run() -> list[RawRow]:
        future = futures.pop() if futures else cassandra.send_raw(bound)
        return list(await_answer(future, outage))

    outage = cassandra.outage
    return partial(retried, "reading the directory of buckets", run, outage=outage)


def count_closed(
    cassandra: Cassandra, table: str, active_ranges: Iterable[ActiveRange]
) -> tuple[int, set[tuple[str, int]]]:
    """Count the messages in closed buckets of all robots.

    Args:
        table: Qualified name of cr_active.
        active_ranges: The partitions and their buckets.

    Returns:
        The number of messages; node and bucket of those in which some writer's counts are not
        final, which are not counted.
    """
    cql = (
        f"SELECT node, bucket, entry, deleted FROM {table} "
        "WHERE tbl = ? AND slot = ? AND bucket >= ? AND bucket <= ?"
    )
    total, uncounted = 0, set()
    requests = (_ask_rows(cassandra, cql, values, ACTIVE_PAGE_ROWS) for values in active_ranges)
    for answer in sent_ahead(requests, REQUESTS_AT_ONCE):
        rows = answer()
        not_final = {row[:2] for row in rows if not is_closed(row[2]) or row[3] == b"\1"}
        entries = [row[2] for row in rows if row[:2] not in not_final]
        total += int(_longs([messages_in(entry) for entry in entries if entry]).sum())
        uncounted |= {((node or b"").decode(), decode_long(bucket)) for node, bucket in not_final}
    return total, uncounted


def columns_of(rows: Sequence[RawRow]) -> BucketColumns:
    """Convert rows of COLUMNS, as Cassandra stores their values, to columns of numbers."""
    columns = list(zip(*rows)) or [()] * 10  # ten empty columns if there are no rows
    bucket, writer, state, deleted, beat, count, size, t_min, t_max, now = columns
    writing = np.array([text == b"open" for text in state], bool)
    cut = np.array([flag == b"\1" for flag in deleted], bool)
    closed = np.array([text == b"closed" for text in state], bool) & ~cut
    beats = _longs(beat, _NEVER)
    age = np.where(beats < 0, 2**62, _longs(now) - np.maximum(beats, 0))
    counts = [_longs(column) for column in (count, size, t_min, t_max)]
    return BucketColumns(_longs(bucket), _longs(writer), closed, writing, cut, age, *counts)


def _longs(values: Sequence[bytes | None], null: bytes = _NO_LONG) -> Longs:
    """Decode bigints; ``null`` is decoded in place of each None."""
    data = b"".join([null if value is None else value for value in values])
    return np.frombuffer(data, ">i8").astype(np.int64)


def is_closed(entry: bytes | None) -> bool:
    """Return whether the counts of an entry of cr_active are final; None = no entry."""
    return entry is not None and entry[0] == 1


def messages_in(entry: bytes) -> bytes:
    """Return the number of messages of an entry of cr_active, as a big-endian integer."""
    return entry[1:9]
