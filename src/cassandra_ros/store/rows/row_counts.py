# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Counts of rows: from the directory for closed buckets, by reading for the others."""

from __future__ import annotations

import logging

from cassandra_ros.errors import AccessDenied, ConnectionFailed, StoreUnavailable
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.directory import STALE_SEC, BucketRow, BucketTotals, Directory
from cassandra_ros.store.tables.row_table import RowTable

_log = logging.getLogger(__name__)


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
        recounts = layout_of(table).recount(node, bucket)
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
