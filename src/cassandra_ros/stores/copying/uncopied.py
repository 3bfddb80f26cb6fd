# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which messages of a bucket a target does not have, by the times at which they were written here.

The books count the messages of a bucket as the directory lists them, which for a bucket that is
being written is too few for up to a minute. But all that was written before a copy read the bucket
was copied.
"""

from __future__ import annotations

from typing import Iterable, NamedTuple

from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.rows.verbatim import row_keys
from cassandra_ros.store.tables.copy_books import CopiedBucket
from cassandra_ros.store.tables.directory import BucketRow
from cassandra_ros.topics.topic_table import TopicTable


class Uncopied(NamedTuple):
    """The messages of a writer in a bucket that no target has."""

    messages: int
    t_min: int
    """Key time of the first of them, ns."""
    t_max: int


def uncopied(table: TopicTable, row: BucketRow, books: Iterable[CopiedBucket]) -> Uncopied:
    """Return what no target has of a bucket.

    Args:
        row: The bucket, with present counts.
        books: What the books of the targets say of it.
    """
    # A closed bucket that was copied without being confirmed was read from too few copies.
    books = [
        book
        for book in books
        if book.there and (book.final or not row.closed or book.heartbeat != row.heartbeat)
    ]
    # After a deletion those that were copied may be the deleted ones.
    there = 0 if row.cut else max((min(book.n, row.rows) for book in books), default=0)
    most = row.rows - there
    seen = max((book.seen for book in books if not book.rule), default=0)
    if not seen:
        return Uncopied(most, row.t_min, row.t_max)
    writers = frozenset([row.writer])
    written = row_keys(table, row.node, row.bucket, writers)
    late = {key for key, written_us in written.items() if written_us > seen}
    if table.packed:
        blocks = headers(table, row.node, row.bucket, writers=writers) if late else ()
        counts = [(b.messages - len(b.gone), b.t, b.last) for b in blocks if b.key in late]
    else:
        counts = [(1, t, t) for t, _ in late]
    return Uncopied(
        min(most, sum(messages for messages, _, _ in counts)),
        min((first for _, first, _ in counts), default=row.t_min),
        max((last for _, _, last in counts), default=row.t_max),
    )
