# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Deletions made here, repeated in the target: of what the books say that it was copied."""

from __future__ import annotations

from typing import Callable
from uuid import UUID

from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.copy_books import CopiedTable, CopyBooks
from cassandra_ros.stores.copying.table_pair import TablePair
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.removal import delete_rows
from cassandra_ros.topics.upkeep.deletion import delete_of_table


def delete_missing(
    pair: TablePair, node: str, bucket: int, writer: int, released: Callable[[], bool]
) -> int:
    """Delete the messages of a writer there that its bucket here does not have any more.

    The caller knows that no client writes the bucket, or that rows were deleted in it.

    Args:
        released: Returns whether messages of the bucket are deleted here because they are there.

    Returns:
        The number of the messages that were deleted.
    """
    if _expire_here(pair):
        return 0
    length = pair.source.bucket_ns
    low, high = bucket * length, (bucket + 1) * length - 1
    whose = Whose((node,), frozenset([writer]))
    keys = {
        (t, seq)
        for t, seq, *_ in layout_of(pair.source).keys(node, bucket, low, high)
        if whose.wrote(seq)
    }
    # Asked after the keys were read: who releases a bucket says so before anything is deleted.
    if released():
        return 0
    rows = pair.rows_there(Read(TimeRange(low, high), whose))
    return delete_rows(pair.there, (row for row in rows if (row.t, row.seq) not in keys))


def delete_missing_names(pair: TablePair, writers: frozenset[int]) -> int:
    """Delete the messages with names of some writers there that are not here any more.

    Return their number.
    """
    if _expire_here(pair):
        return 0
    keys = {key.position._replace(table="") for key in list_names(pair.source, None)}
    rows = pair.rows_there(Read(whose=Whose(None, writers)))
    gone = (row for row in rows if row.position._replace(table="") not in keys)
    return delete_rows(pair.there, gone)


def _expire_here(pair: TablePair) -> bool:
    """Return whether messages expire here and stay there: one that is missing may have expired."""
    return bool(pair.source.metadata.ttl) and not pair.target.metadata.ttl


def delete_removed(
    here: Keyspace, there: Keyspace, books: CopyBooks, target: UUID, entry: CopiedTable
) -> int:
    """Delete there what was copied of a table that was removed here; return the number.

    The books forget the table afterwards.
    """
    table = there.tables.holding(entry.there)
    deleted = 0
    if table is not None:
        # The length of our buckets is not known any more: one ends where the next one begins.
        ends: dict[tuple[str, int], int] = {}
        copied = books.buckets(target, entry.table, books.slots(target, entry.table))
        for book in sorted(copied, key=lambda book: book.bucket):
            low = ends.get((book.node, book.writer), 0)
            ends[book.node, book.writer] = max(low, book.t_max + 1)
            if book.released or (book.rule and not book.n):
                continue  # deleted here for room, or never copied
            whose = Whose((book.node,), frozenset([book.writer]))
            time_range = TimeRange() if table.named else TimeRange(low, book.t_max)
            deleted += delete_of_table(there, table, Read(time_range, whose))
    books.forget_table(target, entry.table)
    return deleted
