# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keeps a store under a size: what another store has acknowledged is deleted first, oldest first.

Whole buckets of one writer are deleted, and none that a client is writing. What no store has is
deleted only if that is asked for, and is then a loss.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import NamedTuple
from uuid import UUID

from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.copy_books import CopiedBucket, CopyBooks
from cassandra_ros.store.tables.directory import BucketRow, slot_of
from cassandra_ros.store.tables.registry import Loss, LossKind
from cassandra_ros.stores.copying.bucket_copy import is_settled
from cassandra_ros.stores.copying.copy_status import uncopied as uncopied_of
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.removal import delete_time_range
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.retention_rules import Retained

_log = logging.getLogger(__name__)

NEARLY_FULL = 0.8
"""Share of the maximum size that is not copied from which a warning is given."""


@dataclass
class QuotaReport:
    """What was deleted, or would be, to keep a store under a size."""

    max_bytes: int
    """Maximum size, serialised bytes."""
    bytes: int = 0
    """Serialised bytes of all messages with a time key afterwards."""
    uncopied_bytes: int = 0
    """Bytes of these messages that no other store has acknowledged."""
    topics: dict[str, Retained] = field(default_factory=dict)
    """Numbers of messages by topic, of topics with a time key."""

    @property
    def share(self) -> float:
        """Share of the maximum size in use by messages that no other store has."""
        return self.uncopied_bytes / self.max_bytes if self.max_bytes else 1.0

    @property
    def nearly_full(self) -> bool:
        """Whether messages that no other store has take nearly all of the maximum size."""
        return self.share >= NEARLY_FULL


class Quota:
    """A maximum size of a store, which a program keeps while it runs.

    Args:
        max_bytes, uncopied: As in keep_under.
    """

    def __init__(self, max_bytes: int, *, uncopied: bool = False) -> None:
        self._max_bytes, self._uncopied = max_bytes, uncopied
        self.report: QuotaReport | None = None
        """Report of the last ``keep``; None = there was none yet."""

    def keep(self, catalog: Catalog) -> None:
        """Delete messages until the store is small enough; warn when it becomes nearly full."""
        before = self.report is not None and self.report.nearly_full
        self.report = keep_under(catalog, self._max_bytes, uncopied=self._uncopied)
        if self.report.nearly_full and not before:
            share = f"{self.report.share:.0%}"
            _log.warning("messages that no other store has take %s of the maximum size", share)


class _Entry(NamedTuple):
    """A bucket of one writer, which is deleted as a whole, and what the books say of it."""

    table: TopicTable
    row: BucketRow
    books: list[tuple[UUID, CopiedBucket]]
    """Targets and their books that confirm all its messages."""
    others: list[tuple[UUID, CopiedBucket]]
    """The other targets of the table and their books, which have some of its messages or none."""
    uncopied_bytes: int
    """Approximate bytes of the messages that no other store has."""


def keep_under(
    catalog: Catalog, max_bytes: int, *, uncopied: bool = False, dry_run: bool = False
) -> QuotaReport:
    """Delete messages until the topics with a time key take at most a number of bytes.

    Args:
        uncopied: Also delete messages that no other store has, if there is no other way.
        dry_run: Only count the messages.

    Returns:
        What was deleted. The store may still be larger: buckets that a client writes stay.
    """
    catalog.adder.close()  # the buckets that this program writes are settled then
    books = CopyBooks(catalog.keyspace.side_tables)
    report, entries = QuotaReport(max_bytes), _entries(catalog, books)
    for table, row, *_ in entries:
        topic = table.metadata.topic
        report.topics.setdefault(topic, Retained(topic)).messages += row.rows
    report.bytes = sum(entry.row.bytes for entry in entries)
    report.uncopied_bytes = sum(entry.uncopied_bytes for entry in entries)
    # What another store has goes first, and of that the oldest.
    entries.sort(key=lambda entry: (not entry.books, entry.row.t_max))
    for entry in entries:
        if report.bytes <= max_bytes:
            break
        if not is_settled(entry.row) or not (entry.books or uncopied):
            continue
        if not (dry_run or _delete(catalog, books, entry)):
            continue
        report.topics[entry.table.metadata.topic].dropped += entry.row.rows
        report.bytes -= entry.row.bytes
        report.uncopied_bytes -= entry.uncopied_bytes
    return report


def _entries(catalog: Catalog, books: CopyBooks) -> list[_Entry]:
    """Return the buckets of all topics with a time key that have messages."""
    directory = catalog.keyspace.directory
    targets: dict[str, set[UUID]] = {}
    """Table → the targets that have it in their books."""
    for entry in books.tables():
        if not entry.gone:
            targets.setdefault(entry.table, set()).add(entry.target)
    entries = []
    for table in catalog.tables(None):
        if table.named:
            continue
        # By robot: the books have the heartbeats of cr_bucket.
        listed = directory.buckets_by_robot(table.name, -(2**63), 2**63 - 1)
        unexpired = [row for row in listed if not row.expired(table.metadata.ttl)]
        rows = [row for row in recount_open_buckets(directory, table, unexpired) if row.rows]
        slots = sorted({(slot_of(row.bucket), row.node) for row in rows})
        books_of: dict[tuple[str, int, int], list[tuple[UUID, CopiedBucket]]] = {}
        for target in targets.get(table.name, ()):
            for book in books.buckets(target, table.name, slots):
                key = (book.node, book.bucket, book.writer)
                books_of.setdefault(key, []).append((target, book))
        for row in rows:
            place = (row.node, row.bucket, row.writer)
            # A target whose books do not list the bucket has nothing of it.
            book_of = dict.fromkeys(targets.get(table.name, ()), CopiedBucket(*place))
            book_of.update(books_of.get(place, []))
            confirming: list[tuple[UUID, CopiedBucket]] = []
            others: list[tuple[UUID, CopiedBucket]] = []
            for target, book in book_of.items():
                confirms = book.confirms(row, [book.there])
                (confirming if confirms else others).append((target, book))
            messages = 0 if confirming else uncopied_of(table, row, [b for _, b in others]).messages
            entries.append(_Entry(table, row, confirming, others, row.bytes * messages // row.rows))
    return entries


def _delete(catalog: Catalog, books: CopyBooks, entry: _Entry) -> bool:
    """Delete the messages of an entry.

    Returns:
        False: The bucket has changed since the entry was listed, and nothing was deleted.
    """
    table, row, confirming, others, _ = entry
    rows_now = catalog.keyspace.directory.find(table.name, row.node, row.bucket)
    now = next((now_row for now_row in rows_now if now_row.writer == row.writer), row)
    if not is_settled(now) or now.rows > row.rows:
        return False
    if confirming and not any(book.confirms(now, [book.there]) for _, book in confirming):
        return False
    for target, book in (*confirming, *others):
        # Before the deletion, so that no copy repeats it there, also where only some messages are.
        books.release(target, table.name, book)
    low = row.bucket * table.bucket_ns
    time_range = TimeRange(low, low + table.bucket_ns - 1)
    whose = Whose((row.node,), frozenset([row.writer]))
    # Before the deletion, too: the rows are looked at.
    lost = None if confirming else uncopied_of(table, row, [book for _, book in others])
    count = delete_time_range(catalog.keyspace, [table], Read(time_range, whose))
    if lost is not None and min(count, lost.messages):
        place = (table.metadata.topic, row.node, row.writer, LossKind.NO_ROOM)
        times = lost.t_min, lost.t_max
        catalog.keyspace.registry.put_loss(Loss(*place, *times, min(count, lost.messages)))
    return True
