# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copies the messages of some tables into another table of the same definition, and compares."""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import islice
from operator import attrgetter
from typing import Callable, Iterator, Mapping, Optional, Sequence, Tuple

from cassandra_ros.errors import CassandraRosError, CorruptMessage, WriteFailed
from cassandra_ros.keys import split_seq, writer_of
from cassandra_ros.read import EVERYTHING, Read, TimeRange, Whose
from cassandra_ros.store.blocks.block_builder import limits_for
from cassandra_ros.store.rows.fetch import RowKey, fetch_row, fetch_rows, list_names
from cassandra_ros.store.rows.verbatim import row_keys
from cassandra_ros.store.tables.expiry import (
    left_by_name,
    left_in_bucket,
    rounded,
    set_lifetime,
    written_by_name,
)
from cassandra_ros.store.tables.row_table import Order
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import Handle, MessageWriter
from cassandra_ros.topics.row_reader import RowReader
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import (
    buckets_of,
    count_rows,
    group_by_bucket,
    writers_of,
)
from cassandra_ros.topics.topic_table import TopicTable

Progress = Optional[Callable[[int, int], None]]
"""Called with the number of messages that are done and the number of all messages."""
TOLD = 100
"""Number of messages between two calls of the progress function."""
NewRobots = Mapping[Tuple[int, str], str]
"""Writer id and nodeID of messages that get another nodeID → that nodeID."""
WRITERS_AT_ONCE = 16
"""Maximum number of writers copied at the same time, a thread each. With more writers the rows are
read several times."""


_Reader = Callable[[], Iterator[StoredRow]]
"""Reads some rows of an old table, with the nodeID that they have in the new one."""


class TableCopy:
    """Copies rows with node, times, seq, connection, name, bytes, and remaining lifetime.

    Args:
        olds: Tables of one definition.
        new: Another table of any format, into which no other client writes.
        robots: Messages that get another nodeID; all others keep theirs.
    """

    def __init__(
        self,
        space: Keyspace,
        olds: Sequence[TopicTable],
        new: TopicTable,
        progress: Progress,
        robots: NewRobots,
    ) -> None:
        self._space = space
        self._olds = olds
        self._new = new
        self._robots = robots
        self._reader = RowReader(space.cassandra, space.directory)
        self._newest = self._newest_of_names()
        rows = count_rows(space.directory, olds, EVERYTHING)
        self._tell = _CopyProgress(progress, 2 * rows)
        names = {old.name for old in olds}
        self._limits = limits_for(sum(1 for _ in space.registry.headers(names)))

    def _newest_of_names(self) -> dict[tuple[str, str], tuple[int, int]]:
        """Return (node, name) → (time, seq) of equal messages, where they came last of all tables.

        It is empty if the key format is not hash, or if there is only one old table.
        """
        newest: dict[tuple[str, str], tuple[int, int]] = {}
        if self._new.metadata.key_format == "hash" and len(self._olds) > 1:
            for table in self._olds:
                for key in list_names(table, None):
                    t, node, seq, _, name = key.position
                    newest[node, name] = max(newest.get((node, name), (t, seq)), (t, seq))
        return newest

    def fill(self) -> None:
        """Write all rows into the new table."""
        writers = sorted(self._writers())
        for n in range(0, len(writers), WRITERS_AT_ONCE):
            some = frozenset(writers[n : n + WRITERS_AT_ONCE])
            if self._new.metadata.ttl:
                self._fill_expiring(some)
            else:
                self._write(self._rows(self._olds, Read(whose=Whose(None, some))))

    def _writers(self) -> set[int]:
        """Return the writer ids of all rows of the old tables."""
        tables = (writers_of(self._space.directory, table) for table in self._olds)
        return {writer for pairs in tables for writer, _ in pairs}

    def _fill_expiring(self, writers: frozenset[int]) -> None:
        """Write rows by remaining lifetime, which is set for all rows written from then on."""
        whose, ttl = Whose(None, writers), self._new.metadata.ttl
        readers: dict[int, list[_Reader]] = {}
        for table in self._olds:
            for lifetime, read_rows in self._expiring(table, whose):
                if lifetime:
                    readers.setdefault(rounded(lifetime, ttl), []).append(read_rows)
        for lifetime in sorted(readers):
            set_lifetime(self._space.schema, self._new.name, lifetime)
            self._write(row for read_rows in readers[lifetime] for row in read_rows())

    def _expiring(self, table: TopicTable, whose: Whose) -> Iterator[tuple[int, _Reader]]:
        """Yield the maximum remaining lifetime of some rows of a table, s, and their reader.

        With a lifetime of 0 there are no rows any more.
        """
        if table.named:
            by_left: dict[int, list[RowKey]] = {}
            for place, lifetime in left_by_name(table).items():
                if whose.wrote(place.seq):
                    lifetime = rounded(lifetime, table.metadata.ttl)
                    by_left.setdefault(lifetime, []).append(RowKey(table, place))
            for lifetime, row_keys in by_left.items():
                yield lifetime, self._fetching(table, row_keys)
            return
        length = table.metadata.bucket_ns
        buckets = group_by_bucket(buckets_of(self._space.directory, table, whose))
        for node, bucket in sorted(buckets):
            time_range = TimeRange(bucket * length, (bucket + 1) * length - 1)
            reader = self._reading(table, Read(time_range, Whose((node,), whose.writers)))
            yield left_in_bucket(table, node, bucket), reader

    def _reading(self, table: TopicTable, read: Read) -> _Reader:
        """Return the reader of the rows of a read."""
        return lambda: map(self._with_robot, self._reader.read([table], read))

    def _with_robot(self, row: StoredRow) -> StoredRow:
        """Give a row the nodeID that it has in the new table; its position stays the old one."""
        row.node = self._robots.get((writer_of(row.seq), row.node), row.node)
        return row

    def _in_order(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Yield rows in the order that they have in the new table, with the nodeID there."""
        rows = self._reader.read(tables, read)
        if not self._robots:
            return rows
        stay = (row for row in rows if (writer_of(row.seq), row.node) not in self._robots)
        streams: list[Iterator[StoredRow]] = [stay]
        for node in {node for _, node in self._robots}:
            writers = frozenset(writer for writer, old_node in self._robots if old_node == node)
            whose = read.whose.both(Whose((node,), writers))
            moved = self._reader.read(tables, replace(read, whose=whose))
            streams.append(map(self._with_robot, moved))
        return heapq.merge(*streams, key=attrgetter("identity"))

    def _rows(self, tables: Sequence[TopicTable], read: Read = EVERYTHING) -> Iterator[StoredRow]:
        """Yield the rows of tables in order, one of each identity.

        Raises:
            CorruptMessage: Two messages have the same identity: one table cannot hold both.
        """
        last: StoredRow | None = None
        for row in self._in_order(tables, read):
            if self._newest and (row.t, row.seq) != self._newest.get((row.node, row.name)):
                continue  # an equal message came later, into another table
            if last is not None and row.identity == last.identity:
                if row.wire != last.wire:
                    raise CorruptMessage(
                        f"topic {row.topic} has two messages at {row.t} of the same writer and "
                        f"number, in tables {last.table.name} and {row.table.name}: one table "
                        "cannot hold both. Remove one of them, and convert it again"
                    )
                continue  # the same message in two tables, of two formats
            last = row
            yield row

    def _write(self, rows: Iterator[StoredRow]) -> None:
        """Write rows of some writers, each under its own id; return when all are acknowledged."""
        opened: dict[int, MessageWriter] = {}
        handles: dict[tuple[int, int, str], Handle] = {}
        try:
            for row in rows:
                writer_id, counter = split_seq(row.seq)
                writer = opened.get(writer_id)
                if writer is None:
                    writer = opened[writer_id] = MessageWriter(
                        self._space, writer_id, ttl=None, limits=self._limits, given=True
                    )
                key = (writer_id, row.conn, row.node)
                handle = handles.get(key)
                if handle is None:
                    handle = handles[key] = writer.ready(
                        Handle(row.connection, self._new, row.conn, row.node, None)
                    )
                writer.write(handle, row.received, counter, row.wire, row.name)
                self._tell.one()
            for writer in opened.values():
                writer.flush()
        finally:
            error: CassandraRosError | None = None
            for writer in opened.values():
                try:
                    writer.close()
                except CassandraRosError as exc:
                    error = exc
        if error is not None:
            raise error

    def compare(self) -> int:
        """Compare all rows of the new table with those of the old ones; return their number.

        Raises:
            WriteFailed: They are not the same.
        """
        count = 0
        new_rows = self._rows([self._new])
        old_rows = self._rows(self._olds)
        new, old = next(new_rows, None), next(old_rows, None)
        while new is not None or old is not None:
            if new is not None and old is not None and new.identity == old.identity:
                self._check_equal(new, old)
                new, old = next(new_rows, None), next(old_rows, None)
                count += 1
                self._tell.one()
            elif old is not None and (new is None or old.identity < new.identity):
                self._check_expired(old)
                old = next(old_rows, None)
            elif new is not None:
                self._check_expired(new)
                new = next(new_rows, None)
        self._tell.end()
        return count

    def _check_equal(self, new: StoredRow, old: StoredRow) -> None:
        """Raise WriteFailed if the copy of a message differs from it."""
        same = (new.received, new.conn) == (old.received, old.conn)
        if not same or new.wire != old.wire:
            raise WriteFailed(
                f"the message of topic {old.topic} at {old.t} is not the same in the new table: "
                "nothing was converted; that is a mistake of this program, please report it"
            )

    def _check_expired(self, row: StoredRow) -> None:
        """Check that a row that is only old, or only new, has expired in the old tables.

        A row may stay a little longer in the new table than in the old ones.
        """
        # A new row is looked for in the old tables, also under the nodeID that it had there.
        tables, nodes = [row.table], [row.position.node]
        if row.table is self._new:
            tables = list(self._olds)
            nodes += [old for (_, old), node in self._robots.items() if node == row.node]
        positions = [row.position._replace(node=node) for node in nodes]
        is_gone = all(fetch_row(table, p) is None for table in tables for p in positions)
        if row.table.metadata.ttl and is_gone:
            return
        raise WriteFailed(
            f"the message of topic {row.topic} at {row.t} is only in one of the tables after the "
            "conversion: nothing was converted, and nothing is lost; convert it again"
        )

    def add_late(self, read: Read | None = None) -> int:
        """Copy the rows that came into the old tables after the copy; return their number.

        Args:
            read: Where they are looked for, a bucket; None = everywhere, which takes long.
        """
        if read is None:
            return self._add(self._not_there(self._rows(self._olds)))
        return self._add(self._missing(self._olds, read))

    def add_written_since(self, since_us: int) -> int:
        """Copy the rows that were written into the old tables after a server time, us.

        Other rows that are only there were deleted since from the new table.

        Returns:
            Their number.
        """
        count = 0
        for table in self._olds:
            if table.named:
                written = written_by_name(table).items()
                late = [RowKey(table, place) for place, us in written if us > since_us]
                count += self._add(self._not_there(self._fetching(table, late)()))
                continue
            buckets = group_by_bucket(buckets_of(self._space.directory, table))
            length = table.bucket_ns
            for (node, bucket), entries in sorted(buckets.items()):
                writers = frozenset(entry.writer for entry in entries)
                times = row_keys(table, node, bucket, writers)
                keys = {key for key, us in times.items() if us > since_us}
                low = bucket * length
                read = Read(TimeRange(low, low + length - 1), Whose((node,), writers))
                if keys:
                    count += self._add(r for r in self._missing([table], read) if _key(r) in keys)
        return count

    def _not_there(self, rows: Iterator[StoredRow]) -> Iterator[StoredRow]:
        """Return those of some rows that are not in the new table, each asked for alone."""
        return (
            row
            for row in rows
            if fetch_row(self._new, row.position._replace(node=row.node)) is None
        )

    def _missing(self, tables: Sequence[TopicTable], read: Read) -> Iterator[StoredRow]:
        """Return the rows of old tables in a bucket that are not in the new one."""
        # Of all robots, because the rows may have another one there.
        every_robot = replace(read, whose=Whose(None, read.whose.writers))
        present = {row.identity for row in self._rows([self._new], every_robot)}
        return (row for row in self._rows(tables, read) if row.identity not in present)

    def _fetching(self, table: TopicTable, keys: Sequence[RowKey]) -> _Reader:
        """Return the reader of the rows with some keys."""
        return lambda: (self._with_robot(StoredRow(row, table)) for row in fetch_rows(keys))

    def _add(self, late: Iterator[StoredRow]) -> int:
        """Write late rows into the new table, with the headers of their connections."""
        count = 0
        while some := list(islice(late, TOLD)):
            if not count:
                headers = self._space.registry.headers({old.name for old in self._olds})
                self._space.registry.put_headers(
                    [(self._new.name, conn, header) for _, conn, header in headers]
                )
            count += len(some)
            self._write(iter(some))
        return count


class _CopyProgress:
    """Calls the progress function of a copy."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress = progress
        self._done, self._total = 0, total

    def one(self) -> None:
        """Count a message as written or compared."""
        self._done += 1
        if not self._done % TOLD:
            self._tell()

    def end(self) -> None:
        """Tell that all is done; the total was an estimate."""
        self._total = self._done
        self._tell()

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress(self._done, max(self._done, self._total))


def _key(row: StoredRow) -> Order:
    """Return the key of a row with a message, or with the block that contains it."""
    block, _ = row.block
    return (row.t, row.seq) if block is None else (block.t, block.seq)
