# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the books say: by target and topic what is copied, what waits, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, NamedTuple
from uuid import UUID

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.read import EVERYTHING
from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.rows.verbatim import row_keys
from cassandra_ros.store.tables.copy_books import CopiedBucket, CopiedTable, CopyBooks
from cassandra_ros.store.tables.directory import BucketRow, slot_of
from cassandra_ros.stores.copying.bucket_copy import CopySelection
from cassandra_ros.stores.copying.named_copy import named_rows
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_totals import buckets_of, count_rows
from cassandra_ros.topics.topic_table import TopicTable


@dataclass
class TopicStatus:
    """What a target has of a topic, by the books."""

    target: str
    """Address and keyspace of the target."""
    topic: str
    copied: int = 0
    """Number of messages that the target has acknowledged."""
    copied_bytes: int = 0
    left_out: int = 0
    """Number of messages that a rule does not take: neither copied nor waiting."""
    waiting: int = 0
    """Number of messages that are not confirmed there."""
    waiting_bytes: int = 0
    waiting_sec: float = 0.0
    """Approximate length of the time ranges of the messages that wait, added up over buckets and
    writers, s."""
    refused: str = ""
    """Why the topic was not copied the last time; '' = it was."""


def copy_status(catalog: Catalog, topics: Iterable[str] | None = None) -> list[TopicStatus]:
    """Return what each target has of topics (None = all), sorted by target and topic.

    A target that is gone is left out. Only the books and the tables here are read, so no target
    need answer.

    Raises:
        TopicNotFound: There is no such topic.
    """
    books = CopyBooks(catalog.keyspace.side_tables)
    entries: dict[UUID, dict[str, CopiedTable]] = {}
    for entry in books.tables():
        if not entry.gone:
            entries.setdefault(entry.target, {})[entry.table] = entry
    tables = catalog.tables(topics)
    statuses: dict[tuple[str, str], TopicStatus] = {}
    for target, entry_of in entries.items():
        place = next(iter(entry_of.values())).place
        for table in tables:
            topic = table.metadata.topic
            status = statuses.setdefault((place, topic), TopicStatus(place, topic))
            table_entry = entry_of.get(table.name)
            if table_entry is not None:
                status.refused = status.refused or table_entry.refused
                if not (table_entry.there or table_entry.refused):  # no rule takes the table
                    status.left_out += count_rows(catalog.keyspace.directory, [table], EVERYTHING)
                    continue
            _add(catalog, books, target, table, status)
    return [statuses[key] for key in sorted(statuses)]


def _add(
    catalog: Catalog, books: CopyBooks, target: UUID, table: TopicTable, status: TopicStatus
) -> None:
    """Add what a target has of a table, by the books, to the numbers of its topic."""
    if table.named:
        _add_named(books, target, table, status)
        return
    directory = catalog.keyspace.directory
    rows = recount_open_buckets(directory, table, buckets_of(directory, table))
    slots = sorted({(slot_of(row.bucket), row.node) for row in rows})
    books_of = {(b.node, b.bucket, b.writer): b for b in books.buckets(target, table.name, slots)}
    for row in rows:
        book = books_of.get((row.node, row.bucket, row.writer))
        # ``done`` counts the messages that were copied or left out by a rule; the rest waits.
        done, copied, nbytes, t_max = 0, 0, 0, row.t_min
        # With fewer messages than the book tells of, some were deleted: what is there may be new.
        not_fewer = book is not None and book.rows <= row.rows
        if book is not None and (row.cut or not_fewer or book.confirms(row, [book.there])):
            done, copied = min(book.rows, row.rows), min(book.n, row.rows)
            nbytes = book.bytes
            t_max = max(t_max, book.t_max)
            if row.cut or not (row.closed or book.rule or copied == row.rows):
                # The books have what the directory said of a bucket that was being written.
                done = copied = row.rows - uncopied(table, row, [book]).messages
                nbytes = row.bytes * copied // row.rows if row.rows else 0
        status.copied += copied
        status.copied_bytes += nbytes
        status.left_out += done - copied
        if row.rows > done:
            status.waiting += row.rows - done
            status.waiting_bytes += row.bytes * (row.rows - done) // row.rows
            status.waiting_sec += max(0, row.t_max - t_max) / SECOND_NS


def _add_named(books: CopyBooks, target: UUID, table: TopicTable, status: TopicStatus) -> None:
    """Add what a target has of a table whose rows have names."""
    stored_books = books.buckets(target, table.name, books.slots(target, table.name))
    seen = {(book.node, book.writer): book.seen for book in stored_books}
    for row in named_rows(table, CopySelection()):
        if row.written_us <= seen.get((row.node, row.writer), 0):
            status.copied += 1
            status.copied_bytes += row.size
        else:
            status.waiting += 1
            status.waiting_bytes += row.size


class Uncopied(NamedTuple):
    """The messages of a writer in a bucket that no target has."""

    messages: int
    t_min: int
    """Key time of the first of them, ns; the bucket's if that is not known."""
    t_max: int
    """Key time of the last of them, ns; the bucket's if that is not known."""


def uncopied(table: TopicTable, row: BucketRow, books: Iterable[CopiedBucket]) -> Uncopied:
    """Return what no target has of a bucket; where that is not known exactly, rather more.

    Args:
        row: The bucket of one writer, with present counts.
        books: What the books of the targets say of it.
    """
    # A closed bucket that was copied without being confirmed was read from too few copies.
    books = [
        book
        for book in books
        if book.there and (book.final or not row.closed or book.heartbeat != row.heartbeat)
    ]
    # After a deletion those that were copied may be the deleted ones.
    copied = 0 if row.cut else max((min(book.n, row.rows) for book in books), default=0)
    most = row.rows - copied
    # A rule may have left out some of the rows that were written before the copy.
    seen = max((book.seen for book in books if not book.rule), default=0)
    if not seen:
        return Uncopied(most, row.t_min, row.t_max)
    writers = frozenset([row.writer])
    written = row_keys(table, row.node, row.bucket, writers)
    late = {key for key, written_us in written.items() if written_us > seen}
    counts = {key: (1, key[0], key[0]) for key in late}
    # A row without a header holds one message.
    for block in headers(table, row.node, row.bucket, writers=writers) if late else ():
        if block.key in late:
            counts[block.key] = (block.left, block.t, block.last)
    return Uncopied(
        min(most, sum(messages for messages, _, _ in counts.values())),
        min((first for _, first, _ in counts.values()), default=row.t_min),
        max((last for _, _, last in counts.values()), default=row.t_max),
    )
