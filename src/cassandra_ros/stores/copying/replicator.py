# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Replicator: copies the topics of one keyspace into another store."""

from __future__ import annotations

import hashlib
import math
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import chain, takewhile
from typing import Callable, Iterable, Iterator, Mapping, Sequence
from uuid import UUID

from cassandra_ros.arguments import check_topics
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import (
    CassandraRosError,
    ConnectionFailed,
    InvalidOption,
    KeyspaceNotFound,
    StoreUnavailable,
)
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Time
from cassandra_ros.read import EVERYBODY, Read, TimeRange, Whose
from cassandra_ros.store.connection.requests import sent_ahead
from cassandra_ros.store.tables.copy_books import CopiedBucket, CopiedTable, CopyBooks, target_id
from cassandra_ros.store.tables.directory import BucketRow, slot_of
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.stores.copying.bucket_copy import (
    Books,
    BucketGroup,
    CopyCount,
    CopySelection,
    PieceCopy,
)
from cassandra_ros.stores.copying.context_copy import (
    copy_events,
    copy_headers,
    copy_losses,
    copy_metadata,
    copy_runs,
)
from cassandra_ros.stores.copying.converted_copy import Choose
from cassandra_ros.stores.copying.deletions import delete_removed
from cassandra_ros.stores.copying.named_copy import NamedCopy, named_rows
from cassandra_ros.stores.copying.rules import CopyRule, CopyRules
from cassandra_ros.stores.copying.store_comparison import StoreComparison, compare_stores
from cassandra_ros.stores.copying.table_pair import TablePair, find_pair
from cassandra_ros.topics.event_times import EventTimes
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.table_copy import Progress

PIECES_AT_ONCE = 4
"""Number of pieces of a table that are copied at the same time, a thread each."""
_ENDING = (StoreUnavailable, ConnectionFailed, KeyspaceNotFound)
"""Errors that end a copy; all others concern one topic, which is reported as refused."""


@dataclass
class TopicCopy(CopyCount):
    """What was copied of one topic."""

    topic: str = ""
    format: str = ""
    """Format in which the messages are kept there."""
    refused: str = ""
    """Why the topic, or a part of it, was not copied; '' = it was."""
    left: int = 0
    """Approximate number of messages in pieces that were not begun: the time was over, or the
    copy is paused."""


@dataclass
class CopyReport:
    """What was copied, by topic."""

    place: str
    """Address and keyspace of the target."""
    topics: dict[str, TopicCopy] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    """Patterns of rules that matched no topic."""

    @property
    def messages(self) -> int:
        """Number of messages that were sent."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def complete(self) -> bool:
        """Whether nothing was refused, and nothing is left."""
        return not any(topic.refused or topic.left for topic in self.topics.values())


class Replicator:
    """Copies topics of a keyspace into another store, and keeps books of what is there.

    What is copied keeps its place: writer ids, times, order, robot and connection. So a copy may be
    cut off, repeated, or made by two programs at once, and ends in the same rows. Rows and blocks
    go as they are stored. Connections, runs, losses and metadata go with them.

    Args:
        source: The store with the topics; its user must be able to write, for the books.
        target: The store that gets them, connected to a keyspace, which is made if it is missing.
        topics: Names of topics, or one name; None = all.
        key, to_key: First and last key time, both included; None = open. Blocks are not cut.
        nodeID, run: As in readMessages.
        format: Format there of topics that are new there; None = as they are stored here.
        with_deletions: Delete there what was deleted here after it was copied.
        rules: Rules by topic, as read_rules returns them; None = all is copied.
        rate: Maximum number of bytes that are sent in a second; None = that of the rules.

    Raises:
        InvalidOption: Source and target are the same keyspace, or with_deletions and a source that
            is read from fewer copies than a quorum.
        UnsupportedSchema: The target has another schema version.
        TopicNotFound, RunNotFound, InvalidName, InvalidKey: As readMessages.
    """

    def __init__(
        self,
        source: RosCassandra,
        target: RosCassandra,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        run: RunName = None,
        format: str | None = None,
        with_deletions: bool = False,
        rules: CopyRules | None = None,
        rate: float | None = None,
    ) -> None:
        self._catalog = source.catalog
        self._here, self._there = source.catalog.keyspace, target.catalog.keyspace
        self._names = check_topics(topics)
        whose = self._catalog.whose(nodeID, run)
        time_range = self._catalog.time_range(self._names, key, to_key)
        self._selection = CopySelection(time_range, whose, with_deletions)
        self._format = format
        self._rules = rules or CopyRules([CopyRule()])
        self._bandwidth = Bandwidth(rate or self._rules.rate)
        self._limits: dict[CopyRule, Bandwidth] = {}
        """Bandwidths of the rules that have a rate of their own, in addition to that of all."""
        self.paused = threading.Event()
        """While it is set no further piece is begun. Any thread may set it."""
        where = self._there.cassandra
        self.place = f"{','.join(where.hosts)}:{where.port}/{self._there.name}"
        self._books = CopyBooks(self._here.side_tables)
        self._target: UUID | None = None
        """Id of the target; None = it had no tables yet when it was looked up last."""
        self._connected: set[str] = set()
        """Tables of which all connections were copied."""
        self._there.schema.tables(fresh=True)  # raises UnsupportedSchema
        id_there = target_id(self._there.cassandra, self._there.name)
        if with_deletions and not self._here.cassandra.finds_all_written:
            raise InvalidOption(
                "with_deletions needs a consistency level of a quorum in the source: with fewer "
                "copies, messages that are only missed would be deleted in the target"
            )
        if id_there is not None and id_there == target_id(self._here.cassandra, self._here.name):
            raise InvalidOption(f"{self.place} is the store itself: give another one")

    @property
    def sent_bytes(self) -> int:
        """Number of bytes that were sent by all copies of this object."""
        return self._bandwidth.sent_bytes

    def __repr__(self) -> str:
        return f"<Replicator of keyspace {self._here.name} to {self.place}>"

    def copy(
        self, progress: Progress = None, *, again: bool = False, max_sec: float | None = None
    ) -> CopyReport:
        """Copy what the target does not have yet, by the books.

        A topic that cannot be copied is reported, and the others are copied.

        Args:
            progress: Called with the number of messages that are done, and of all.
            again: Copy everything, whatever the books say.
            max_sec: Time after which no further piece is begun, s; the report says what is left.

        Raises:
            StoreUnavailable, ConnectionFailed: One of the stores does not answer. What was copied
                stays, and the next copy goes on there.
            KeyspaceNotFound: One of the keyspaces was removed.
        """
        report = CopyReport(self.place)
        self._there.side_tables.make()
        self._books.make()
        self._target = target_id(self._there.cassandra, self._there.name)
        tables = self._tables()
        entries: dict[str, CopiedTable] = {}
        for entry in self._books.tables():
            if entry.target == self._id:
                entries[entry.table] = entry
            elif entry.place == self.place and not entry.gone:
                self._books.bury(entry)  # another keyspace is at this place now
        if self._selection.deletions and self._names is None:
            self._delete_removed(entries, report)
        report.unused = self._rules.unused(sorted({table.metadata.topic for table in tables}))
        runs = self._here.registry.runs() if any(r.selects_runs for r in self._rules.rules) else []
        work = []
        for table in tables:
            rule = self._rules.of(table.metadata.topic)
            if rule is None:
                self._leave_out(table, entries)
            elif pair := self._pair(table, rule, entries, report):
                work.append(self._work(pair, rule, runs, again))
        copy_headers(
            [
                table_work.pair
                for table_work in work
                if table_work.pair.source.name not in self._connected
            ]
        )
        self._connected.update(table_work.pair.source.name for table_work in work)
        work.sort(key=lambda table_work: (table_work.rule.order, table_work.mean_bytes))
        ends = math.inf if max_sec is None else time.monotonic() + max_sec
        tell = _Tell(progress, sum(table_work.messages for table_work in work))
        for table_work in work:
            self._copy_table(table_work, report, tell, again, ends)
        self._copy_context(report, work)
        return report

    def _leave_out(self, table: TopicTable, entries: dict[str, CopiedTable]) -> None:
        """Note in the books that no rule takes a table: they name no table there."""
        before = entries.get(table.name)
        entry = CopiedTable(self._id, table.name, self.place, table.metadata.topic)
        if before is not None:
            self._doubt_removed(table, before.there)
        if before != entry:
            self._books.put_table(entry)

    def compare(self, progress: Progress = None, *, repair: bool = False) -> StoreComparison:
        """Compare the selected topics with those of the target, bucket by bucket.

        Messages there of other writers, such as other robots, do not matter. All times are
        compared, also if a time range was given.

        Args:
            progress: Called with the number of buckets that were compared, and of all.
            repair: If there are differences, copy the selected topics again, whatever the books
                say, and compare them once more. What is only there stays.

        Raises:
            StoreUnavailable, ConnectionFailed: One of the stores does not answer.
        """
        here, there = self._here, self._there
        whose = self._selection.whose
        result = compare_stores(here, there, self._tables(), whose, self.place, progress)
        if repair and not result.equal:
            self.copy(again=True)
            result = compare_stores(here, there, self._tables(), whose, self.place)
        return result

    @property
    def _id(self) -> UUID:
        """Id of the target in the books; raises KeyspaceNotFound."""
        if self._target is None:
            self._target = target_id(self._there.cassandra, self._there.name)
        if self._target is None:
            raise KeyspaceNotFound(f"{self.place} was removed meanwhile; copy again")
        return self._target

    def _tables(self) -> list[TopicTable]:
        """Return the tables of the selected topics, after both listings were read anew."""
        self._here.schema.tables(fresh=True)
        self._there.schema.tables(fresh=True)
        return self._catalog.tables(self._names)

    def _pair(
        self,
        table: TopicTable,
        rule: CopyRule,
        entries: dict[str, CopiedTable],
        report: CopyReport,
    ) -> TablePair | None:
        """Return a table with its counterpart; None if it is refused, which is reported.

        The books get its entry.

        Args:
            entries: Table → entry in the books of this target.
        """
        topic, entry = table.metadata.topic, entries.get(table.name)
        there = entry.there if entry is not None else ""
        result = report.topics.setdefault(topic, TopicCopy(topic=topic))
        try:
            if rule.thins and table.named:
                raise InvalidOption(f"messages of topic {topic} have names and cannot be thinned")
            pair = find_pair(
                self._here,
                self._there,
                table,
                self._format or rule.format,
                there,
                thinned=rule.thins,
            )
            copy_metadata(pair)
        except _ENDING:
            raise
        except CassandraRosError as exc:
            self._doubt_removed(table, there)
            self._refuse(table, there, result, str(exc))
            return None
        result.format = pair.target.metadata.format
        if there and there not in pair.names:  # the table there was removed
            self._books.doubt(self._id, table.name, pair.names)
        new = CopiedTable(self._id, table.name, self.place, topic, pair.target.name)
        if new != entry:
            self._books.put_table(new)
        return pair

    def _doubt_removed(self, table: TopicTable, there: str) -> None:
        """Confirm nothing of a table whose counterpart there was removed; '' = it has none."""
        listing = self._there.schema.listing()
        if there and listing.heirs.get(there, there) not in listing.visible:
            self._books.doubt(self._id, table.name, ())

    def _refuse(self, table: TopicTable, there: str, result: TopicCopy, reason: str) -> None:
        """Note in the report and in the books why a table is not copied; the first reason stays."""
        result.refused = result.refused or reason
        topic = table.metadata.topic
        entry = CopiedTable(self._id, table.name, self.place, topic, there, reason)
        self._books.put_table(entry)

    def _selection_of(self, rule: CopyRule, runs: Sequence[Run]) -> CopySelection:
        """Return the selection for the topics of a rule."""
        if not rule.selects_runs:
            return self._selection
        writers = frozenset(run.writer for run in runs if rule.takes(run))
        whose = self._selection.whose.both(Whose(None, writers))
        return replace(self._selection, whose=whose)

    def _work(self, pair: TablePair, rule: CopyRule, runs: Sequence[Run], again: bool) -> _Work:
        """Return what is to be copied of a table; note in the books what its rule leaves out."""
        source, selection = pair.source, self._selection_of(rule, runs)
        if source.named:
            rows = named_rows(source, selection)
            size = sum(row.size for row in rows)
            return _Work(pair, rule, selection, messages=len(rows), bytes=size)
        low, high = selection.time_range
        first, last = source.bucket_of(low), source.bucket_of(min(high, MAX_NS))
        whose, ttl = selection.whose, source.metadata.ttl
        # By robot: the books have the heartbeats of cr_bucket.
        listed = self._here.directory.buckets_by_robot(source.name, first, last, whose.nodes)
        rows_here = [row for row in listed if not row.expired(ttl)]
        # ``entries`` are taken by the rule, ``late`` is what the target lacks of them.
        entries = [r for r in rows_here if whose.writers is None or r.writer in whose.writers]
        times = self._times_of(rule)
        slots = sorted({(slot_of(row.bucket), row.node) for row in rows_here})
        book_of = {
            (book.node, book.bucket, book.writer): book
            for book in self._books.buckets(self._id, source.name, slots)
        }
        work = _Work(pair, rule, selection, times=times)
        if times is not None:
            without = [row for row in entries if not work.spans(row)]
            self._note_left_out(source, pair.target.name, without, book_of)
            entries = [row for row in entries if work.spans(row)]
        late = [row for row in entries if again or not work.has(row, book_of)]
        work.pieces = list(_pieces(pair, late, entries))
        work.messages, work.bytes = sum(row.rows for row in late), sum(row.bytes for row in late)
        work.writers = {row.writer for row in entries}
        # A copy of one robot or run says nothing of the others.
        if rule.selects_runs and self._selection.whose == EVERYBODY:
            others = [row for row in rows_here if row.writer not in (whose.writers or ())]
            self._note_left_out(source, pair.target.name, others, book_of)
        for (node, bucket, writer), book in book_of.items():
            work.books.setdefault(node, {})[bucket, writer] = book
        return work

    def _times_of(self, rule: CopyRule) -> EventTimes | None:
        """Return the times of the events of a rule; None = it takes messages of all time.

        Events of all runs count, also if the rule takes messages of some runs only: a mark that
        another program made belongs to no run, or to that of the program.
        """
        if not rule.event:
            return None
        events = self._here.events.find(rule.event, whose=self._selection.whose)
        return EventTimes(events, rule.before_ns, rule.after_ns)

    def _note_left_out(
        self,
        source: TopicTable,
        there: str,
        rows: Sequence[BucketRow],
        books: dict[tuple[str, int, int], CopiedBucket],
    ) -> None:
        """Note in the books that a rule takes no message of some buckets: so they do not wait.

        Args:
            there: Name of the table there.
            books: What the books say, by node, bucket and writer. A bucket that has not changed
                since they were written is passed over.
        """
        for row in rows:
            book = books.get((row.node, row.bucket, row.writer))
            if book is not None and book.heartbeat == row.heartbeat:
                continue
            entry = CopiedBucket(
                node=row.node,
                bucket=row.bucket,
                writer=row.writer,
                there=there,
                heartbeat=row.heartbeat,
                rule="run",  # not '': that would say that all messages were copied
                rows=row.rows,
                t_max=max(0, row.t_max),
            )
            self._books.put_bucket(self._id, source.name, entry)

    def _throttle_of(self, rule: CopyRule) -> Callable[[int], None]:
        """Return the function that waits until bytes of a rule's topics may be sent."""
        if rule.rate is None:
            return self._bandwidth.sent
        limit = self._limits.setdefault(rule, Bandwidth(rule.rate))

        def sent(nbytes: int) -> None:
            limit.sent(nbytes)
            self._bandwidth.sent(nbytes)

        return sent

    def _choose(self, work: _Work) -> Choose | None:
        """Return the reader of the messages that a rule takes; None = it takes all."""
        rule, source, times = work.rule, work.pair.source, work.times
        if not rule.thins:
            return None

        # By event, then by condition, then by period.
        def taken(read: Read) -> Iterator[StoredRow]:
            parts = [read] if times is None else times.reads(read)
            return chain.from_iterable(map(passing_rows, parts))

        def passing_rows(read: Read) -> Iterator[StoredRow]:
            if not rule.where:
                return self._here.rows.read([source], read)
            conditions = {source.metadata.topic: rule.where}
            (passing,) = self._catalog.filters(conditions, None, read.whose).values()
            return (row for row in passing.rows(read) if row.table is source)

        if not rule.every_ns:
            return taken
        begin = work.selection.time_range.low

        def thinned(read: Read) -> Iterator[StoredRow]:
            # A read is one bucket, or the part of it that the time range of the copy has.
            low, period = read.time_range.low, rule.every_ns
            start = max(begin, low // period * period)
            # A period may have begun in an earlier bucket.
            earlier = replace(read, time_range=TimeRange(start, low - 1))
            if not rule.where:
                earlier = replace(earlier, columns=lambda table: ())
            rows = taken(earlier) if start < low else iter(())
            return _first_of_periods(taken(read), period, _Earlier(low // period, rows))

        return thinned

    def _copy_table(
        self, work: _Work, report: CopyReport, tell: _Tell, again: bool, ends: float
    ) -> None:
        """Copy a table; what is refused or damaged is reported.

        Args:
            ends: Monotonic time after which no further piece is begun, s. Messages with names are
                copied all the same.
        """
        pair = work.pair
        result = report.topics[pair.topic]
        try:
            if not pair.source.named:
                self._copy_pieces(work, result, tell, again, ends)
            elif not self.paused.is_set():
                sent = self._throttle_of(work.rule)
                named = NamedCopy(pair, self._books, self._id, work.selection, sent)
                result.add(named.run(again=again))
                tell.add(work.messages)
        except _ENDING:
            raise
        except CassandraRosError as exc:
            self._refuse(pair.source, pair.target.name, result, str(exc))
        if result.damaged:
            more = f" (and {len(result.damaged) - 1} more)" if len(result.damaged) > 1 else ""
            self._refuse(pair.source, pair.target.name, result, f"{result.damaged[0]}{more}")

    def _copy_pieces(
        self, work: _Work, result: TopicCopy, tell: _Tell, again: bool, ends: float
    ) -> None:
        """Copy the pieces of a table, some at the same time; see _copy_table."""
        sent, choose = self._throttle_of(work.rule), self._choose(work)
        copy = PieceCopy(
            work.pair, self._books, self._id, work.selection, sent, choose, work.thinning_of
        )
        # Conversions of one table exclude each other by a lock; they take one thread.
        threads = PIECES_AT_ONCE if work.pair.columns is not None and choose is None else 1
        pieces = list(work.pieces)
        # Asked before each piece is begun, not before all.
        begun = takewhile(lambda _: time.monotonic() < ends and not self.paused.is_set(), pieces)
        done = 0
        with ThreadPoolExecutor(threads, "cassandra_ros-copy") as pool:

            def begin(piece: BucketGroup) -> tuple[BucketGroup, Future[CopyCount]]:
                books: Books = work.books.get(piece.node, {})
                return piece, pool.submit(copy.run, piece, books, again=again)

            for piece, future in sent_ahead(map(begin, begun), threads):
                result.add(future.result())
                tell.add(sum(row.rows for row in piece.entries))
                done += 1
        result.left += sum(row.rows for piece in pieces[done:] for row in piece.entries)

    def _copy_context(self, report: CopyReport, work: Sequence[_Work]) -> None:
        """Copy runs and losses of what was copied, and the events of its robots and runs.

        If all robots, runs and topics are selected, also those of which there are no messages.
        """
        everything = self._names is None and self._selection.whose == EVERYBODY
        everything = everything and not any(rule.selects_runs for rule in self._rules.rules)
        writers = None if everything else {w for table_work in work for w in table_work.writers}
        if not everything and any(table_work.pair.source.named for table_work in work):
            named = [table_work.pair.source for table_work in work if table_work.pair.source.named]
            named_writers = (
                row.writer for table in named for row in named_rows(table, self._selection)
            )
            writers = {*(writers or ()), *named_writers}
        topics = self._there.schema.listing(fresh=True).by_topic
        copy_runs(self._here, self._there, writers, topics)
        copied = {name for name, topic in report.topics.items() if not topic.refused}
        if everything:
            lost = {loss.topic for loss in self._here.registry.losses()}
            copied |= lost - set(report.topics)  # topics of which nothing could be stored
        copy_losses(self._here, self._there, copied, writers)
        copy_events(self._here, self._there, self._selection.time_range, self._selection.whose)

    def _delete_removed(self, entries: dict[str, CopiedTable], report: CopyReport) -> None:
        """Delete there what was copied of tables that were removed here."""
        listing = self._here.schema.listing()
        for name, entry in entries.items():
            if name in listing.every:
                continue
            if name in listing.heirs:  # converted: its messages are in another table
                self._books.forget_table(self._id, name)
                continue
            result = report.topics.setdefault(entry.topic, TopicCopy(topic=entry.topic))
            result.deleted += delete_removed(self._here, self._there, self._books, self._id, entry)


@dataclass
class _Work:
    """What is to be copied of one table."""

    pair: TablePair
    rule: CopyRule
    selection: CopySelection
    """That of the replicator, with the writers that the rule takes."""
    times: EventTimes | None = None
    """Times of the events during which messages are copied; None = of all time."""
    pieces: Sequence[BucketGroup] = ()
    """Pieces with something to copy, in order of time; () for messages with names."""
    books: dict[str, dict[tuple[int, int], CopiedBucket]] = field(default_factory=dict)
    """Node → what the books say of its buckets."""
    messages: int = 0
    """Approximate number of messages to copy."""
    bytes: int = 0
    """Serialised bytes of these messages."""
    writers: set[int] = field(default_factory=set)
    """Writers with messages that the rule takes; empty for messages with names."""
    _spans: dict[tuple[str, int], list[TimeRange]] = field(default_factory=dict)

    def thinning_of(self, row: BucketRow) -> str:
        """Return what the books call the messages that the rule takes of a bucket.

        It changes with the events, so that an event that is added later is copied then.
        """
        if self.times is None:
            return self.rule.thinning
        spans = repr(self.spans(row)).encode()
        return f"{self.rule.thinning}, {hashlib.md5(spans).hexdigest()}"

    def spans(self, row: BucketRow) -> list[TimeRange]:
        """Return the time ranges of the events in a bucket of a robot."""
        spans = self._spans.get((row.node, row.bucket))
        if spans is None:
            length = self.pair.source.bucket_ns
            low = row.bucket * length
            whole = Read(TimeRange(low, low + length - 1), Whose((row.node,)))
            parts = [] if self.times is None else self.times.reads(whole)
            spans = self._spans[row.node, row.bucket] = [
                event_read.time_range for event_read in parts
            ]
        return spans

    def has(self, row: BucketRow, books: Mapping[tuple[str, int, int], CopiedBucket]) -> bool:
        """Return whether by the books the target has all that the rule takes of a bucket."""
        book = books.get((row.node, row.bucket, row.writer))
        return book is not None and book.confirms(row, self.pair.names, self.thinning_of(row))

    @property
    def mean_bytes(self) -> float:
        """Mean size of the messages: topics with small ones go first."""
        return self.bytes / max(1, self.messages)


class _Tell:
    """Calls the progress function, if there is one.

    Args:
        progress: Called with the number of messages that are done, and of all.
        total: Expected number of all messages; there may be more.
    """

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._done, self._total = progress, 0, total

    def add(self, messages: int) -> None:
        """Add a number of messages that are done."""
        self._done += messages
        if self._progress is not None:
            self._progress(self._done, max(self._done, self._total))


class _Earlier:
    """The messages of a period that lie in buckets before; no more of them are read than needed.

    Args:
        period: Number of the period.
        rows: The messages, in any order.
    """

    def __init__(self, period: int, rows: Iterator[StoredRow]) -> None:
        self.period, self._rows = period, rows
        self._seen: set[int] = set()
        """Numbers of the connections of the messages that were read."""

    def has(self, conn: int) -> bool:
        """Return whether one of them is of a connection."""
        while conn not in self._seen:
            row = next(self._rows, None)
            if row is None:
                return False
            self._seen.add(row.conn)
        return True


def _first_of_periods(
    rows: Iterable[StoredRow], period_ns: int, earlier: _Earlier
) -> Iterator[StoredRow]:
    """Yield the first message of each period, for each connection.

    Args:
        rows: Messages in order of time.
        earlier: Messages of the first period that lie before.
    """
    last: dict[int, int] = {}
    for row in rows:
        period = row.t // period_ns
        if last.get(row.conn) != period:
            last[row.conn] = period
            if period != earlier.period or not earlier.has(row.conn):
                yield row


def _pieces(
    pair: TablePair, late: Iterable[BucketRow], entries: Iterable[BucketRow]
) -> Iterator[BucketGroup]:
    """Yield the pieces with something to copy, in order of time.

    Args:
        late: Entries of the directory with something to copy.
        entries: All entries that the rule takes, also these. A piece has those of its buckets.
    """
    length_here, length_there = pair.source.bucket_ns, pair.target.bucket_ns
    # Buckets that lie in one bucket there go together, so that it is opened and closed once.
    ratio = length_there // length_here if length_there % length_here == 0 else 1
    late_groups = {(row.node, row.bucket // ratio) for row in late}
    groups: dict[tuple[int, str], list[BucketRow]] = {}
    for row in entries:
        if (row.node, row.bucket // ratio) in late_groups:
            groups.setdefault((row.bucket // ratio, row.node), []).append(row)
    for (_, node), rows in sorted(groups.items()):
        yield BucketGroup(node, rows)


class Bandwidth:
    """Lets at most a number of bytes a second pass, for all threads together.

    Args:
        bytes_per_sec: The limit, above 0; None = no limit.
    """

    def __init__(self, bytes_per_sec: float | None) -> None:
        if bytes_per_sec is not None and not 0 < bytes_per_sec < float("inf"):
            raise InvalidOption(f"{bytes_per_sec!r} is not a rate: give bytes a second above 0")
        self._rate = bytes_per_sec
        self._free = 0.0
        """Monotonic time from which the next bytes may be sent, s."""
        self._mutex = threading.Lock()
        self.sent_bytes = 0

    def sent(self, nbytes: int) -> None:
        """Wait until these bytes may be sent. They are counted at once."""
        with self._mutex:
            self.sent_bytes += nbytes
            if self._rate is None:
                return
            now = time.monotonic()
            begin = max(now, self._free)
            self._free = begin + nbytes / self._rate
        time.sleep(max(0.0, begin - now))
