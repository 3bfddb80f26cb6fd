# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Deletion of stored rows: first a mark in the directory, then the row, then its chunks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import chain, islice
from typing import Collection, Dict, Iterable, List, Sequence, Tuple, Union

from cassandra_ros.places.paths import LONGEST_GAP_NS
from cassandra_ros.read import Read, Whose
from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.blocks.block_deletion import BlockDeletion
from cassandra_ros.store.rows.layouts import RowLayout
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.row_table import BlockKey
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.row_reader import current
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import buckets_of, group_by_bucket
from cassandra_ros.topics.topic_table import TopicTable

REMOVED_ROWS_AT_ONCE = 512
"""Number of rows of which the deletions are sent together."""

_Partition = Tuple[TopicTable, str, Union[int, str]]
"""Table, node, and bucket or name."""
_Key = Tuple[int, int, bool]
"""``_t`` and ``_seq`` as stored, and whether the message has chunks."""
_Series = Dict[_Partition, List[List[_Key]]]
"""Keys to delete, in order; between two lists of a partition lies a row that stays."""


class _Deletion(ABC):
    """Deletes messages of one partition: of a bucket, or those with one name."""

    def __init__(self, space: Keyspace, partition: _Partition) -> None:
        self._space = space
        self._partition = partition
        self._table, self._node, self._where = partition

    @abstractmethod
    def time_range(self, read: Read, writers: Collection[int], until_us: int) -> int:
        """Delete the messages of a bucket in the time range of a read, and of its writers.

        Args:
            writers: Writer ids of all messages in the bucket.
            until_us: A time of the server before the directory was read, us.

        Returns:
            The number of messages that were deleted.
        """

    @abstractmethod
    def rows(self, rows: Sequence[StoredRow]) -> None:
        """Delete messages."""

    def _mark(self) -> None:
        """Note the deletion in the directory, again for each group of messages.

        A reader may have counted the bucket and closed it in between.

        Raises:
            SchemaConflict: The table is being converted, and so its messages are not deleted.
        """
        self._space.schema.listing().check_staying(self._table.name)
        if isinstance(self._where, int):
            _mark_deleted(self._space.directory, self._table, self._node, self._where)

    def _delete_chunks(self, keys: Iterable[_Key]) -> None:
        """Delete the chunks of messages, after their rows: a row is their commit mark."""
        chunked = [(self._node, self._where, t, seq) for t, seq, large in keys if large]
        if chunked:
            statement, what = self._table.delete_one(chunks=True), _deleting(self._table)
            self._space.cassandra.execute_many(statement, chunked, what=what)


class _RowDeletion(_Deletion):
    """Deletes rows, each of which is a message."""

    def time_range(self, read: Read, writers: Collection[int], until_us: int) -> int:
        """Delete all rows at once if they are of the read's writers, else one by one."""
        wanted = read.whose.writers
        if wanted is None or wanted.issuperset(writers):
            return self._whole(*read.time_range, until_us)
        return self._between(read) if wanted.intersection(writers) else 0

    def _whole(self, low: int, high: int, until_us: int) -> int:
        """Delete the rows that were written up to a server time; return their number."""
        table, node, bucket = self._table, self._node, int(self._where)
        self._space.schema.listing().check_staying(table.name)
        keys: list[_Key] = []
        newest_us = 0
        for t, seq, large, written_us in RowLayout(table).written(node, bucket, low, high):
            if written_us <= until_us:
                keys.append((t, seq, large))
                newest_us = max(newest_us, written_us)
        if keys:
            marked = _mark_deleted(self._space.directory, table, node, bucket)
            # Rows that arrive in the range now, and were not counted, are newer than all of these.
            params = (newest_us, node, bucket, *keys[0][:2], *keys[-1][:2])
            statement = table.delete_range(older=True)
            self._space.cassandra.execute(statement, params, what=_deleting(table))
            # Rows of writers that opened the bucket in between may have been deleted too.
            _mark_deleted(self._space.directory, table, node, bucket, marked)
            self._delete_chunks(keys)
        return len(keys)

    def _between(self, read: Read) -> int:
        """Delete the rows of the writers of a read, between those of others, which stay."""
        rows = RowLayout(self._table).keys(self._node, int(self._where), *read.time_range)
        keys = ((row.t, row.seq, row.chunked) for row in rows if read.whose.wrote(row.seq))
        deleted = 0
        while some := list(islice(keys, REMOVED_ROWS_AT_ONCE)):
            self.keys(some)
            deleted += len(some)
        return deleted

    def rows(self, rows: Sequence[StoredRow]) -> None:
        """Delete rows one by one, and then their chunks."""
        self.keys(list(map(_key_of, rows)))

    def keys(self, keys: Sequence[_Key]) -> None:
        """Delete rows by their keys, one by one: those that are added in between stay."""
        self._mark()
        params = [(self._node, self._where, t, seq) for t, seq, _ in keys]
        statement, what = self._table.delete_one(), _deleting(self._table)
        self._space.cassandra.execute_many(statement, params, what=what)
        self._delete_chunks(keys)

    def ranges(self, ranges: Sequence[Sequence[_Key]], until_us: int) -> None:
        """Delete ranges of rows of a bucket that were written up to a server time.

        The chunks of their messages stay.
        """
        self._mark()
        where = self._node, self._where
        params = [(until_us, *where, *keys[0][:2], *keys[-1][:2]) for keys in ranges]
        statement, what = self._table.delete_range(older=True), _deleting(self._table)
        self._space.cassandra.execute_many(statement, params, what=what)


class _PackedDeletion(_Deletion):
    """Deletes messages out of blocks; those that another writer adds meanwhile stay."""

    def time_range(self, read: Read, writers: Collection[int], until_us: int) -> int:
        """Delete the messages of a read, whose blocks are found by their headers."""
        low, high = read.time_range
        block_rows = headers(
            self._table, self._node, int(self._where), low, high, read.whose.writers
        )
        deleted = 0
        while some := list(islice(block_rows, REMOVED_ROWS_AT_ONCE)):
            self._mark()
            blocks = self._blocks()
            deleted += blocks.time_range(some, low, high)
            self._delete_chunks((*key, True) for key in blocks.large)
        return deleted

    def rows(self, rows: Sequence[StoredRow]) -> None:
        """Delete messages by their places in their blocks, and then their chunks."""
        cuts: dict[BlockKey, set[int]] = {}
        for row in rows:
            block, place = row.block
            if block is not None:
                cuts.setdefault(block, set()).add(place)
        self._mark()
        self._blocks().cut(cuts)
        self._delete_chunks(map(_key_of, rows))

    def _blocks(self) -> BlockDeletion:
        return BlockDeletion(self._space.cassandra, self._table, self._node, int(self._where))


def _deletion_in(space: Keyspace, partition: _Partition) -> _Deletion:
    """Return what deletes messages of a partition, by the layout of its table."""
    if partition[0].packed:
        return _PackedDeletion(space, partition)
    return _RowDeletion(space, partition)


def delete_time_range(space: Keyspace, tables: Sequence[TopicTable], read: Read) -> int:
    """Delete the rows in the time range of a read, of its nodes and writers; return their number.

    Rows that are stored meanwhile stay, or are deleted and counted too.
    """
    low, high = read.time_range
    whose = read.whose
    deleted = 0
    # Taken before the directory is read: rows of buckets that are opened later stay.
    until_us = space.cassandra.server_time_us()
    for table in current(tables):
        ends = table.bucket_of(low), table.bucket_of(high)
        rows = buckets_of(space.directory, table, Whose(whose.nodes), ends)
        if whose.writers is not None or high - low < LONGEST_GAP_NS:
            # The robot's way between the remaining poses may now lead over deleted ones.
            mine = {r.bucket for r in rows if whose.writers is None or r.writer in whose.writers}
            _withdraw_places(space, table, mine, low, high)
        for (node, bucket), bucket_rows in sorted(group_by_bucket(rows).items()):
            deletion = _deletion_in(space, (table, node, bucket))
            deleted += deletion.time_range(read, {row.writer for row in bucket_rows}, until_us)
    return deleted


def _withdraw_places(
    space: Keyspace, table: TopicTable, buckets: Collection[int], low: int, high: int
) -> None:
    """Note that poses are deleted in these buckets, in [low, high], before that is done.

    The index of places then no longer covers these times, also where poses stay.
    """
    if buckets:
        length = table.metadata.bucket_ns
        low, high = max(low, min(buckets) * length), min(high, (max(buckets) + 1) * length - 1)
        space.place_index.withdraw(table.name, low, high)


def delete_rows(space: Keyspace, rows: Iterable[StoredRow]) -> int:
    """Delete messages while they are found; return their number. Only some keys are in memory."""
    deleted = 0
    rows = iter(rows)
    while some := list(islice(rows, REMOVED_ROWS_AT_ONCE)):
        groups: dict[_Partition, list[StoredRow]] = {}
        for row in some:
            groups.setdefault(_partition_of(row), []).append(row)
        for partition, group in groups.items():
            times = [row.t for row in group]
            space.place_index.withdraw(partition[0].name, min(times), max(times))
            _deletion_in(space, partition).rows(group)
        deleted += len(some)
    return deleted


def thin_rows(space: Keyspace, rated: Iterable[tuple[StoredRow, bool]], until_us: int) -> int:
    """Delete some of the rows of a time range; return their number.

    Consecutive rows are deleted together: each deletion leaves a tombstone, and Cassandra refuses
    to read a bucket with 100,000 of them.

    Args:
        rated: All rows of the time range in order, each with whether it is deleted.
        until_us: A time of the server before these were read, us: rows written later stay.
    """
    deleted = pending = 0
    series: _Series = {}
    rated = iter(rated)
    for row, is_deleted in rated:
        if row.table.packed:  # from the first row on, or if the topic was converted meanwhile
            rest = chain([(row, is_deleted)], rated)
            deleted += delete_rows(space, (other for other, goes in rest if goes))
            break
        row_series = series.setdefault(_partition_of(row), [[]])
        if is_deleted:
            row_series[-1].append(_key_of(row))
            pending += 1
        elif row_series[-1]:  # a row stays between two series
            row_series.append([])
        if pending == REMOVED_ROWS_AT_ONCE:
            _delete_series(space, series, until_us)
            deleted, pending, series = deleted + pending, 0, {}
    _delete_series(space, series, until_us)
    return deleted + pending


def _delete_series(space: Keyspace, series: _Series, until_us: int) -> None:
    """Delete rows: three or more consecutive ones as a range, the others one by one."""
    for partition, row_series in series.items():
        table = partition[0]
        ranges: list[list[_Key]] = []
        single: list[_Key] = []
        if row_series[0]:
            first, last = row_series[0][0], next(keys[-1] for keys in reversed(row_series) if keys)
            space.place_index.withdraw(table.name, first[0], last[0])
        for keys in row_series:
            # A range with chunks is not deleted at once: the chunks of a message that was written
            # after ``until_us``, and so stays, must stay too.
            if len(keys) > 2 and not any(chunked for _, _, chunked in keys):
                ranges.append(keys)
            else:
                single += keys
        deletion = _RowDeletion(space, partition)
        if single:
            deletion.keys(single)
        if ranges:
            deletion.ranges(ranges, until_us)


def _mark_deleted(
    directory: Directory, table: TopicTable, node: str, bucket: int, but: Collection[int] = ()
) -> set[int]:
    """Mark the bucket as deleted from, for its present writers except ``but``; return them all."""
    writers = {row.writer for row in directory.find(table.name, node, bucket)}
    for writer in writers.difference(but):
        directory.mark((table.name, node, bucket, writer), table.metadata.ttl, deleted=True)
    return writers


def _deleting(table: TopicTable) -> str:
    return f"deleting from topic {table.metadata.topic}"


def _partition_of(row: StoredRow) -> _Partition:
    table = row.table
    return table, row.node, row.name if table.named else table.bucket_of(row.t)


def _key_of(row: StoredRow) -> _Key:
    return (*row.table.stored_order(row.t, row.seq), row.chunked)
