# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The copy of messages that are stored under names, with all versions of each.

The directory does not list them, so the keys of all of them are read each time, here; what is
written into the target is only what was written here since the last time.
"""

from __future__ import annotations

from typing import Callable, Iterable, NamedTuple, Sequence
from uuid import UUID

from cassandra_ros.keys import writer_of
from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.rows.fetch import KEY_PAGE_ROWS
from cassandra_ros.store.rows.verbatim import Part, VerbatimCopy
from cassandra_ros.store.tables.copy_books import CopiedBucket, CopyBooks
from cassandra_ros.store.tables.row_table import RowTable, bind, decode_long
from cassandra_ros.stores.copying.bucket_copy import SEEN_MARGIN_US, CopyCount, CopySelection
from cassandra_ros.stores.copying.converted_copy import ConvertedCopy
from cassandra_ros.stores.copying.deletions import delete_missing_names
from cassandra_ros.stores.copying.table_pair import TablePair
from cassandra_ros.stores.copying.target_buckets import TargetBuckets
from cassandra_ros.topics.topic_table import TopicTable


class NamedRow(NamedTuple):
    """What a copy needs to know of a message with a name."""

    node: str
    name: str
    t: int
    writer: int
    size: int
    written_us: int
    """Server time at which it was written, us."""


def named_rows(table: RowTable, selection: CopySelection) -> list[NamedRow]:
    """Return the selected messages of a table whose rows have names (a scan of keys).

    Args:
        selection: Its ``deletions`` does not matter.
    """

    def read(rows: Iterable[RawRow]) -> list[NamedRow]:
        return [_named_row(values) for values in rows]

    statement = bind(table.select_names('WRITETIME("_conn")'), (), KEY_PAGE_ROWS)
    (low, high), whose = selection.time_range, selection.whose
    return [
        row
        for row in table.collect(statement, read)
        if low <= row.t <= high
        and (whose.nodes is None or row.node in whose.nodes)
        and (whose.writers is None or row.writer in whose.writers)
    ]


def _named_row(values: RawRow) -> NamedRow:
    """Return a row of select_names with its time of writing."""
    node, name, t, seq, size, _, _, *received, written = values
    t, seq = received or (t, seq)  # where the key holds others, these are in columns of their own
    texts = (node or b"").decode(), (name or b"").decode()
    numbers = decode_long(t), writer_of(decode_long(seq)), decode_long(size), decode_long(written)
    return NamedRow(*texts, *numbers)


class NamedCopy:
    """Copies the messages of a table whose rows have names, and writes the books.

    Args:
        target: Id of the target in the books.
        sent: Called with each number of bytes before they are sent; it may wait.
    """

    def __init__(
        self,
        pair: TablePair,
        books: CopyBooks,
        target: UUID,
        selection: CopySelection,
        sent: Callable[[int], None],
    ) -> None:
        self._pair = pair
        self._books, self._id = books, target
        self._selection = selection
        self._sent = sent

    def run(self, *, again: bool = False) -> CopyCount:
        """Copy what was written since the last time, and note that in the books.

        The books are written only if all messages are selected and none is damaged.

        Args:
            again: Copy everything, and delete nothing there.
        """
        pair, count = self._pair, CopyCount()
        # Before the rows are read: what is written later is copied the next time.
        seen = pair.here.cassandra.server_time_us()
        rows = named_rows(pair.source, self._selection)
        books = {} if again else self._books_by_writer()
        if self._selection.deletions:
            count.deleted = delete_missing_names(pair, frozenset(books)) if books else 0
        late = [row for row in rows if row.written_us > _since(books.get(row.writer))]
        if pair.columns is None:
            for node in sorted({row.node for row in late}):
                with ConvertedCopy(pair, node, self._sent) as converted:
                    converted.copy_names(self._selection.whose)
                count.messages += converted.messages
                count.bytes += converted.bytes
        else:
            self._copy_as_stored(late, count)
        if self._selection.whole and not count.damaged:
            self._note(rows, seen)
        return count

    def _books_by_writer(self) -> dict[int, CopiedBucket]:
        """Return what the books say, by writer; of several nodes the entry that was seen first.

        Entries of other tables there do not count: these were removed or converted.
        """
        slots = self._books.slots(self._id, self._pair.source.name)
        book_of: dict[int, CopiedBucket] = {}
        for book in self._books.buckets(self._id, self._pair.source.name, slots):
            if book.there in self._pair.names:
                other = book_of.get(book.writer)
                if other is None or book.seen < other.seen:
                    book_of[book.writer] = book
        return book_of

    def _copy_as_stored(self, late: Sequence[NamedRow], count: CopyCount) -> None:
        """Copy rows as they are stored; set the numbers in ``count``."""
        pair = self._pair
        if pair.columns is None or not late:
            return
        buckets = TargetBuckets(pair, {}, self._sent)
        there = pair.there
        copy = VerbatimCopy(
            pair.source, pair.target, pair.columns, there.cassandra, there.schema, buckets
        )
        writers_of: dict[tuple[str, str], set[int]] = {}
        first_us: dict[tuple[str, str], int] = {}
        for row in late:
            key = (row.node, row.name)
            writers_of.setdefault(key, set()).add(row.writer)
            first_us[key] = min(first_us.get(key, row.written_us), row.written_us)
        for (node, name), writers in writers_of.items():
            # Versions of this name that were written before are there.
            copy.copy(Part(node, name, frozenset(writers), since_us=first_us[node, name] - 1))
        count.messages, count.bytes = copy.counts.messages, copy.counts.bytes
        count.damaged = copy.counts.damaged

    def _note(self, rows: Iterable[NamedRow], seen: int) -> None:
        """Write in the books that all rows are there which were written before ``seen``, us."""
        table: TopicTable = self._pair.source
        groups: dict[tuple[str, int], list[NamedRow]] = {}
        for row in rows:
            groups.setdefault((row.node, row.writer), []).append(row)
        for (node, writer), group in groups.items():
            entry = CopiedBucket(
                node=node,
                bucket=0,
                writer=writer,
                there=self._pair.target.name,
                heartbeat=None,
                seen=seen,
                final=False,
                rule="",
                rows=len(group),
                n=len(group),
                bytes=sum(row.size for row in group),
                t_max=max(row.t for row in group),
            )
            self._books.put_bucket(self._id, table.name, entry)


def _since(book: CopiedBucket | None) -> int:
    """Return the server time up to which the rows of a writer are there by the books, us."""
    return 0 if book is None else book.seen - SEEN_MARGIN_US
