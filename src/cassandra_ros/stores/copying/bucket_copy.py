# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The copy of one piece of a table: its rows, the directory there, and then the books here."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import Callable, Iterator, Mapping, NamedTuple, Sequence, Tuple
from uuid import UUID

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.read import ALWAYS, EVERYBODY, TimeRange, Whose
from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.rows.verbatim import Part, VerbatimCopy, page_rows, row_keys
from cassandra_ros.store.tables.copy_books import CopiedBucket, CopyBooks
from cassandra_ros.store.tables.directory import STALE_SEC, BucketRow, slot_of
from cassandra_ros.store.tables.row_table import MAX_SEQ, MIN_SEQ, Order
from cassandra_ros.stores.copying.converted_copy import Choose, ConvertedCopy
from cassandra_ros.stores.copying.deletions import delete_missing
from cassandra_ros.stores.copying.table_pair import TablePair
from cassandra_ros.stores.copying.target_buckets import TargetBuckets

SEEN_MARGIN_US = 3_000_000
"""How long before a read a row may have got its write time and not be visible yet, us. A row that
took longer is found when no client writes its bucket any more: then all keys are compared."""

_Entry = Tuple[int, int]
"""Bucket and writer id."""
Books = Mapping[_Entry, CopiedBucket]
"""What the books of a target say of the buckets of one table and node."""


class BucketGroup(NamedTuple):
    """Buckets of one node that are copied together, since they lie in one bucket there."""

    node: str
    entries: Sequence[BucketRow]
    """What the directory says of them, one for each bucket and writer."""

    @property
    def keys(self) -> set[_Entry]:
        """Buckets and writers."""
        return {(row.bucket, row.writer) for row in self.entries}


@dataclass(frozen=True)
class CopySelection:
    """The messages of a topic that are copied, and whether deletions are repeated."""

    time_range: TimeRange = ALWAYS
    """Time range of the keys."""
    whose: Whose = EVERYBODY
    """Robots and writers whose messages are copied."""
    deletions: bool = False
    """Whether messages that were deleted here after they were copied are deleted there."""

    @property
    def whole(self) -> bool:
        """Whether all messages are selected."""
        return self.time_range == ALWAYS and self.whose == EVERYBODY


@dataclass
class CopyCount:
    """Numbers of what was copied and deleted."""

    messages: int = 0
    """Number of messages that were sent."""
    bytes: int = 0
    """Number of bytes that were sent; where messages are decoded, of serialised messages."""
    deleted: int = 0
    """Number of messages that were deleted there."""
    damaged: list[str] = field(default_factory=list)
    """Error texts of messages that are damaged here."""

    def add(self, other: CopyCount) -> None:
        """Add the numbers of another part."""
        self.messages += other.messages
        self.bytes += other.bytes
        self.deleted += other.deleted
        self.damaged += other.damaged


def is_settled(row: BucketRow) -> bool:
    """Return whether no client writes a bucket."""
    return row.closed or row.age_sec > STALE_SEC


class PieceCopy:
    """Copies pieces of one table, and writes the books. Safe to share between threads.

    Args:
        target: Id of the target in the books.
        selection: Its ``whose`` does not matter: the pieces have only buckets of its robots and
            writers.
        sent: Called with each number of bytes before they are sent; it may wait.
        choose: Reads the messages that a rule takes; None = all are copied.
        rule: Returns what the books call the messages that a rule takes of a bucket; '' = all.
    """

    def __init__(
        self,
        pair: TablePair,
        books: CopyBooks,
        target: UUID,
        selection: CopySelection,
        sent: Callable[[int], None],
        choose: Choose | None,
        rule: Callable[[BucketRow], str],
    ) -> None:
        self._pair = pair
        self._books, self._id = books, target
        self._selection = selection
        self._sent = sent
        self._choose, self._rule = choose, rule

    def run(self, piece: BucketGroup, books: Books, *, again: bool = False) -> CopyCount:
        """Copy what is not confirmed of a piece, and note in the books what is then.

        The order matters: server time, directory, rows, directory again, books. So the books never
        say more than what is true, whatever clients write meanwhile.

        Args:
            books: What the books say.
            again: Copy all of it, and delete nothing there, whatever the books say.
        """
        here = self._pair.here
        seen = here.cassandra.server_time_us()
        before = self._present(piece)
        confirmed_books = {} if again else self._piece_books(before, books)
        rows = [row for row in before if not self._is_confirmed(row, confirmed_books)]
        count = CopyCount()
        if not rows:
            return count
        if self._selection.deletions:
            count.deleted = self._delete(piece.node, rows, confirmed_books)
        taken: dict[_Entry, tuple[int, int]] = {}
        after = self._transfer(piece, before, rows, confirmed_books, count, taken)
        for row in [] if count.damaged else rows:
            if self._is_covered(row):
                # With fewer copies than a quorum some rows may not have been seen.
                all_seen = here.cassandra.finds_all_written
                final = all_seen and is_settled(row) and _is_same(row, after)
                key = (row.bucket, row.writer)
                numbers = taken.get(key, (0, 0)) if self._choose else (row.rows, row.bytes)
                self._note(row, seen, final, numbers)
        return count

    def _present(self, piece: BucketGroup) -> list[BucketRow]:
        """Return what the directory says of a piece now."""
        directory, name, keys = self._pair.here.directory, self._pair.source.name, piece.keys
        buckets = sorted({bucket for bucket, _ in keys})
        rows = (row for bucket in buckets for row in directory.find(name, piece.node, bucket))
        return [row for row in rows if (row.bucket, row.writer) in keys]

    def _piece_books(self, rows: Sequence[BucketRow], books: Books) -> Books:
        """Return the entries of the books for the rows of a piece that still count.

        They are those of a table there that has the rows now, by no rule or by the present one.
        """
        piece_books: dict[_Entry, CopiedBucket] = {}
        for row in rows:
            book = books.get((row.bucket, row.writer))
            if book is not None and book.there in self._pair.names:
                if book.rule in ("", self._rule(row)):
                    piece_books[row.bucket, row.writer] = book
        return piece_books

    def _is_confirmed(self, row: BucketRow, books: Books) -> bool:
        """Return whether the target has all that the rule takes of a bucket, by the books."""
        book = books.get((row.bucket, row.writer))
        return book is not None and book.confirms(row, self._pair.names, self._rule(row))

    def _is_covered(self, row: BucketRow) -> bool:
        """Return whether a bucket is wholly in the time range."""
        (low, high), length = self._selection.time_range, self._pair.source.bucket_ns
        return low <= row.bucket * length and (row.bucket + 1) * length - 1 <= high

    def _transfer(
        self,
        piece: BucketGroup,
        before: Sequence[BucketRow],
        rows: Sequence[BucketRow],
        books: Books,
        count: CopyCount,
        taken: dict[_Entry, tuple[int, int]],
    ) -> list[BucketRow]:
        """Copy what is still to be copied of a piece; return what the directory here says then.

        Args:
            before: What the directory said of the piece before.
            rows: Those entries of ``before`` that are not confirmed.
            books: What the books say, see _piece_books.
            count: Gets the numbers of what was sent, and what is damaged.
            taken: Gets the number of messages that a rule takes, and of their bytes, by bucket and
                writer, if messages are decoded.
        """
        pair = self._pair
        parts: list[Part] = []
        for bucket in sorted({row.bucket for row in rows}):
            bucket_rows = [row for row in rows if row.bucket == bucket]
            parts += self._parts(piece.node, bucket_rows, books)
        columns = None if self._choose is not None else pair.columns
        if columns is None or self._is_cut_otherwise(piece, rows, books):
            # A block has messages that are later than its key.
            end = (self._selection.time_range.high, MAX_SEQ)
            parts = [bucket_part._replace(ends=(bucket_part.ends[0], end)) for bucket_part in parts]
            with ConvertedCopy(pair, piece.node, self._sent, self._choose) as converted:
                for bucket_part in parts:
                    converted.copy(bucket_part)
            taken.update(converted.taken)
            count.messages, count.bytes = converted.messages, converted.bytes
            return self._present(piece)
        filled: dict[int, frozenset[str]] = {}
        """Writer → index columns there that get values in all of its rows."""
        for row in rows:
            shadows = pair.filled(row.filled)
            filled[row.writer] = filled.get(row.writer, shadows) & shadows
        buckets = TargetBuckets(pair, filled, self._sent)
        copy = VerbatimCopy(
            pair.source, pair.target, columns, pair.there.cassandra, pair.there.schema, buckets
        )
        for row in rows:
            if is_settled(row) and (row.bucket, row.writer) in books:
                # It was left open there while it was written here, and is to be closed now.
                buckets.open(piece.node, self._bucket_there(row.bucket), row.writer)
        for bucket_part in parts:
            copy.copy(bucket_part)
        after = self._present(piece)
        writing = {row.writer for row in before if not (is_settled(row) and _is_same(row, after))}
        done = {row.writer for row in before} - writing
        # The counts are those of the rows that were sent now: not of all, if some were there.
        has_books = any((row.bucket, row.writer) in books for row in before)
        whole = not has_books and all(map(self._is_covered, rows))
        buckets.close(done, copy.counts.totals if whole else {})
        counts = copy.counts
        count.messages, count.bytes, count.damaged = counts.messages, counts.bytes, counts.damaged
        return after

    def _is_cut_otherwise(
        self, piece: BucketGroup, rows: Sequence[BucketRow], books: Books
    ) -> bool:
        """Return whether blocks there begin at other messages than ours.

        They came from a table that was converted since. With ours some messages would be there
        twice.
        """
        source, target = self._pair.source, self._pair.target
        row_books = [books.get((row.bucket, row.writer)) for row in rows]
        if all(book and book.there == target.name for book in row_books):
            return False
        writers = frozenset(row.writer for row in rows)
        buckets = sorted({row.bucket for row in rows})
        buckets_there = set(map(self._bucket_there, buckets))
        low, high = buckets[0] * source.bucket_ns, (buckets[-1] + 1) * source.bucket_ns - 1
        blocks_there = {
            (block.key, block.messages)
            for bucket in buckets_there
            for block in headers(target, piece.node, bucket, low, high, writers)
        }
        for bucket in buckets if blocks_there else ():
            for block in headers(source, piece.node, bucket, writers=writers):
                blocks_there.discard((block.key, block.messages))
        if blocks_there and target.metadata.ttl:
            raise SchemaConflict(
                f"topic {self._pair.topic} is not copied: it was converted since it was copied "
                "first, and its messages expire; remove it at one side"
            )
        return bool(blocks_there)

    def _bucket_there(self, bucket: int) -> int:
        """Return the bucket there in which a bucket begins."""
        return self._pair.target.bucket_of(bucket * self._pair.source.bucket_ns)

    def _parts(self, node: str, rows: Sequence[BucketRow], books: Books) -> Iterator[Part]:
        """Yield what is still to be copied of one bucket: one part, or none.

        Args:
            rows: Entries of the directory for this bucket, at least one.
        """
        source, (low, high) = self._pair.source, self._selection.time_range
        bucket, writers = rows[0].bucket, frozenset(row.writer for row in rows)
        ends = (low, MIN_SEQ), (high, MAX_SEQ)
        bucket_part = Part(node, bucket, writers, ends, page_rows=page_rows(rows))
        row_books = [books.get((row.bucket, row.writer)) for row in rows]
        booked = [book for book in row_books if book is not None]
        settled = any(map(is_settled, rows))
        decoded = self._pair.columns is None and settled
        if len(booked) < len(rows) or self._choose is not None or decoded:
            yield bucket_part  # a copy that decodes messages compares their keys itself
            return
        since_us = max(0, min(book.seen for book in booked) - SEEN_MARGIN_US)
        keys_here = row_keys(source, node, bucket, writers)
        keys = {key for key, written_us in keys_here.items() if written_us > since_us}
        if settled:  # then those are in it, too, of blocks that grew
            keys |= keys_here.keys() - self._keys_there(node, bucket, writers)
        if keys:
            first, last = max(min(keys), ends[0]), min(max(keys), ends[1])
            yield bucket_part._replace(ends=(first, last), keys=frozenset(keys))

    def _keys_there(self, node: str, bucket: int, writers: frozenset[int]) -> set[Order]:
        """Return the keys of the rows of writers there in the time range of a bucket here."""
        source, target = self._pair.source, self._pair.target
        low = bucket * source.bucket_ns
        high = low + source.bucket_ns - 1
        buckets = range(target.bucket_of(low), target.bucket_of(high) + 1)
        return {
            key
            for target_bucket in buckets
            for key in row_keys(target, node, target_bucket, writers)
        }

    def _delete(self, node: str, rows: Sequence[BucketRow], books: Books) -> int:
        """Delete there what was deleted here since it was copied; return the number of messages."""
        deleted = 0
        for row in rows:
            book = books.get((row.bucket, row.writer))
            if book is not None and not book.released and self._is_covered(row):
                if row.cut or is_settled(row):
                    released = partial(self._is_released, row)
                    deleted += delete_missing(self._pair, node, row.bucket, row.writer, released)
        return deleted

    def _is_released(self, row: BucketRow) -> bool:
        """Return whether the books say now that rows are deleted here because they are there."""
        slots = [(slot_of(row.bucket), row.node)]
        books = self._books.buckets(self._id, self._pair.source.name, slots)
        place = (row.bucket, row.writer)
        return any(book.released for book in books if (book.bucket, book.writer) == place)

    def _beat_there(self, row: BucketRow) -> datetime | None:
        """Return the heartbeat of the target's entry that stands for all rows of a bucket.

        Return None if no closed entry there does, or that is not certain: a fleet then reads both
        stores.
        """
        source, target = self._pair.source, self._pair.target
        if source.bucket_ns != target.bucket_ns or not self._pair.there.cassandra.finds_all_written:
            return None
        rows = self._pair.there.directory.find(target.name, row.node, row.bucket)
        entries = [r for r in rows if r.writer == row.writer and r.closed and r.rows >= row.rows]
        writers = frozenset([row.writer])
        if entries:
            # Messages that were deleted in a block there are not copied again.
            blocks = headers(target, row.node, row.bucket, writers=writers)
            entries = [] if any(len(block.gone) for block in blocks) else entries
        return entries[0].heartbeat if entries else None

    def _note(self, row: BucketRow, seen: int, final: bool, numbers: tuple[int, int]) -> None:
        """Write the entry of a bucket in the books, after all of it is acknowledged.

        Args:
            row: What the directory said before the rows were read.
            seen: Server time before that, us.
            final: See CopiedBucket.
            numbers: Number of messages that are there, and of their bytes.
        """
        entry = CopiedBucket(
            node=row.node,
            bucket=row.bucket,
            writer=row.writer,
            there=self._pair.target.name,
            heartbeat=row.heartbeat,
            seen=seen,
            final=final,
            rule=self._rule(row),
            rows=row.rows,
            n=numbers[0],
            bytes=numbers[1],
            t_max=max(row.t_max, 0),
        )
        self._books.put_bucket(self._id, self._pair.source.name, entry)
        if final and not entry.rule:
            beat = self._beat_there(row)
            self._books.put_beat(self._id, self._pair.source.name, entry, beat)


def _is_same(row: BucketRow, rows: Sequence[BucketRow]) -> bool:
    """Return whether an entry of the directory is among others, unchanged."""
    return any(
        (row.bucket, row.writer, row.heartbeat) == (r.bucket, r.writer, r.heartbeat) for r in rows
    )
