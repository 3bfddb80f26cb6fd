# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows copied as they are stored: the bytes of their columns go from SELECT to INSERT undecoded.

Only the columns of the key, the size and the marks of a row are looked at. The chunks of a large
message are acknowledged before its row is sent, as by every writer.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Iterable, Iterator, NamedTuple, Protocol, Sequence

from cassandra.query import BatchStatement, BatchType, BoundStatement

from cassandra_ros.keys import writer_of
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.cql_names import quote_name
from cassandra_ros.store.connection.driver_errors import translate
from cassandra_ros.store.connection.requests import Flight, Patience, RawRow
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.rows.writer import WRITE_BATCH_BYTES, WRITE_BATCH_ROWS
from cassandra_ros.store.tables.directory import BucketRow, BucketTotals
from cassandra_ros.store.tables.row_table import (
    ALL,
    KEYS,
    UNSET,
    Order,
    PartitionKey,
    RowTable,
    bind,
    decode_long,
    encode_int,
)
from cassandra_ros.store.tables.schema import CHUNK_TTL_MARGIN_SEC, Schema

PAGE_BYTES = 1024 * 1024
"""Approximate size of a page of rows, bytes."""
MAX_PAGE_ROWS = 2000
UNKNOWN_ROW_BYTES = 16 * 1024
"""Assumed size of a row, bytes, if the directory does not tell."""
PAGE_CHUNKS = 4
KEY_PAGE_ROWS = 5000
GIVE_UP_SEC = 30.0
"""How long a row is retried, s. It can be copied again later."""


@dataclass(frozen=True)
class StoredColumns:
    """Columns of rows that two tables store alike, after the partition key."""

    read: tuple[str, ...]
    """Their names in the table that is read."""
    write: tuple[str, ...]
    """Their names in the table that is written."""
    fields: tuple[str, ...] = ()
    """Fields whose indexes both tables have; their columns are the last ones."""

    def position(self, name: str) -> int:
        """Return the position of one of our own columns; -1 = there is no such column."""
        return self.read.index(name) if name in self.read else -1


def shared_columns(source: RowTable, target: RowTable) -> StoredColumns | None:
    """Return the columns of the rows of two tables; None if they store messages differently."""
    here, there = source.metadata, target.metadata
    names = layout_of(source).stored_columns
    is_alike = here.format == there.format and source.named == target.named
    if not is_alike or names != layout_of(target).stored_columns:
        return None
    # A block must lie in one bucket, and readers look back as far as its table says.
    fits = target.bucket_ns % source.bucket_ns == 0 and there.span_ns >= here.span_ns
    if here.span_ns and not fits:
        return None
    fields = tuple(name for name in here.indexes if name in there.indexes)
    return StoredColumns(
        (*names, *(here.indexes[name] for name in fields)),
        (*names, *(there.indexes[name] for name in fields)),
        fields,
    )


class Part(NamedTuple):
    """The rows of one partition that are copied."""

    node: str
    where: int | str
    """A bucket, or the name of messages."""
    writers: frozenset[int] | None = None
    """Writer ids whose rows are copied; None = all."""
    ends: tuple[Order, Order] = ALL
    """Keys of the first and the last row; a block that reaches into this range is copied whole."""
    since_us: int = 0
    """Rows written up to this server time are left out, us."""
    keys: frozenset[Order] | None = None
    """Keys of the rows; None = all that the other fields choose."""
    page_rows: int = PAGE_BYTES // UNKNOWN_ROW_BYTES


class Destination(Protocol):
    """What prepares for the rows of a table, and counts them. Called on the thread of ``copy``."""

    def open(self, node: str, bucket: int, writer: int) -> None:
        """Prepare for rows of a writer in a bucket of the target, before the first one is sent."""

    def connect(self, conn: int) -> None:
        """Prepare for rows of a connection, before the first one is sent."""

    def sent(self, nbytes: int) -> None:
        """Note a number of bytes that are sent; it may wait."""


@dataclass
class CopyCounts:
    """Numbers of what was copied: of what was sent, until ``copy`` has returned."""

    messages: int = 0
    bytes: int = 0
    """Number of bytes of columns and chunks that were sent."""
    totals: dict[tuple[str, int, int], BucketTotals] = field(default_factory=dict)
    """Node, bucket of the target and writer → counts of the rows; empty for tables of blocks."""
    damaged: list[str] = field(default_factory=list)
    """Error texts of rows that cannot be copied because they are damaged here."""


class VerbatimCopy:
    """Copies partitions of one table into another one that stores messages alike.

    Args:
        columns: Result of ``shared_columns`` for the two tables.
        there: Connection of the target.
        schema: Makes the chunk table of the target when it is first needed.
    """

    def __init__(
        self,
        source: RowTable,
        target: RowTable,
        columns: StoredColumns,
        there: Cassandra,
        schema: Schema,
        destination: Destination,
    ) -> None:
        self._source, self._target = source, target
        self._columns = columns
        self._there, self._schema = there, schema
        self._destination = destination
        self.counts = CopyCounts()
        self._flight = Flight(there.send_raw, Patience(GIVE_UP_SEC), there.outage)
        self._failures: list[BaseException] = []
        """Errors of statements that were given up; the driver's thread appends them."""
        self._mutex = threading.Lock()
        # Positions of columns in a row that is read; -1 = there is no such column.
        position = columns.position
        self._chunks_at = position("_nchunks")
        self._odd_at, self._gone_at = position("_odd"), position("_gone")
        self._count_at, self._last_at = position("_n"), position("_last")
        self._arrival_at = position("_arrival")
        self._expires = bool(source.metadata.ttl and target.metadata.ttl)
        # After the stored columns each row has its write time, and its lifetime if it expires.
        extra = ['WRITETIME("_conn")'] + ['TTL("_conn")'] * self._expires
        self._names = ", ".join([*map(quote_name, columns.read), *extra])
        self._width = len(columns.read)

    def copy(self, partition: Part) -> None:
        """Copy the rows of a partition; return when the target has acknowledged all of them.

        Rows that are damaged here are left out and listed in ``counts``.

        Raises:
            CassandraRosError: Rows could not be stored. Of the partition some rows may be there.
        """
        source = self._source
        low, high = partition.ends
        # An earlier block may reach into the range; the span of a single message is 0.
        low = (max(low[0] - source.metadata.span_ns, ALL[0][0]), low[1])
        request = source.select_range(
            self._names,
            source.partition_key(partition.node, partition.where),
            (low, high),
            page_rows=partition.page_rows,
            what="copying",
        )
        for page in request.pages():
            self._copy_page(partition, [row for row in page if self._takes(partition, row)])
            self._check()
        self._flight.wait()
        self._check()

    def _takes(self, partition: Part, row: RawRow) -> bool:
        """Return whether a row is to be copied."""
        if row[2] is None:  # only the value of an index, or a mark of a deletion, is left
            return False
        if partition.since_us and decode_long(row[self._width]) <= partition.since_us:
            return False
        if self._last_at >= 0 and decode_long(row[self._last_at]) < partition.ends[0][0]:
            return False
        if (
            partition.keys is not None
            and (decode_long(row[0]), decode_long(row[1])) not in partition.keys
        ):
            return False
        return partition.writers is None or self._writer(row) in partition.writers

    def _writer(self, row: RawRow) -> int:
        """Return the writer id of a row; where equal messages are stored once, ``_seq`` is 0."""
        at = self._arrival_at if self._arrival_at >= 0 else 1
        return writer_of(decode_long(row[at]))

    def _copy_page(self, partition: Part, rows: Sequence[RawRow]) -> None:
        """Send rows; if some have chunks, wait before until all chunks are acknowledged."""
        for conn in {row[2] for row in rows}:
            self._destination.connect(decode_long(conn))
        groups: dict[int, list[RawRow]] = {}
        for row in rows:
            bucket = 0 if self._target.named else self._target.bucket_of(decode_long(row[0]))
            groups.setdefault(bucket, []).append(row)
        ready: dict[int, list[RawRow]] = {}
        for bucket, group in groups.items():
            for writer in {self._writer(row) for row in group}:
                self._destination.open(partition.node, bucket, writer)
            ready[bucket] = [row for row in group if self._copy_chunks(partition, bucket, row)]
        if any(row[self._chunks_at] is not None for row in rows):
            self._flight.wait()  # a row is the commit mark of its chunks
            self._check()
        for bucket, group in ready.items():
            for batch in _batches(group):
                self._send(partition, bucket, batch)

    def _partition_key(self, partition: Part, bucket: int) -> PartitionKey:
        """Encode the partition key of the target; ``bucket`` is ignored for rows with names."""
        return self._target.partition_key(
            partition.node, partition.where if self._target.named else bucket
        )

    def _copy_chunks(self, partition: Part, bucket: int, row: RawRow) -> bool:
        """Send the chunks of a row, if it has any; return whether the row must be sent, too.

        It must not be sent if chunks are missing here, or if messages were deleted here from a
        block that the target has.
        """
        if self._gone_at >= 0 and row[self._gone_at] is not None:
            # What was deleted here stays there: a block that is there is not written again.
            key = decode_long(row[0]), decode_long(row[1])
            there = self._target.select_range(
                KEYS, self._partition_key(partition, bucket), (key, key), page_rows=1
            )
            if any(there.rows()):
                return False
        if row[self._chunks_at] is None:
            return True
        source, chunk_count = self._source, decode_long(row[self._chunks_at])
        self._schema.ensure_chunk_table(self._target)
        expires = self._expires and row[self._width + 1] is not None
        insert = self._target.insert_stored_chunk() if expires else self._target.insert_chunk()
        row_key = row[0] or b"", row[1] or b""
        partition_key = self._partition_key(partition, bucket)
        where = source.partition_key(partition.node, partition.where)
        select = bind(source.select_chunks(), (*where, *row_key), PAGE_CHUNKS)
        request, numbers = source.send(select, "copying"), set()
        for number, data in request.rows():
            values = [*partition_key, *row_key, number or b"", data or b""]
            if expires:
                values.append(encode_int(self._lifetime_sec(row) + CHUNK_TTL_MARGIN_SEC))
            self._submit(bind(insert, values), len(data or b""))
            numbers.add(number)
        if len(numbers) == chunk_count:
            return True
        self.counts.damaged.append(
            f"the message of topic {source.metadata.topic} at {decode_long(row[0])} is incomplete: "
            f"{len(numbers)} of {chunk_count} chunks; 'cassandra_bag check' tells more"
        )
        return False

    def _lifetime_sec(self, row: RawRow) -> int:
        """Return the remaining lifetime of a row, s."""
        return max(1, decode_long(row[self._width + 1]))

    def _send(self, partition: Part, bucket: int, rows: Sequence[RawRow]) -> None:
        """Send rows of one bucket of the target as one batch, and count them."""
        target, partition_key = self._target, self._partition_key(partition, bucket)
        insert = target.insert_stored(self._columns.write, expires=self._expires)
        statements, nbytes = [], 0
        for row in rows:
            values = [*partition_key, *(UNSET if v is None else v for v in row[: self._width])]
            if self._expires:
                values.append(encode_int(self._lifetime_sec(row)))
            statements.append((True, insert.query_id, values))
            nbytes += _size(row)
            self._count(partition.node, bucket, row)
        bound = BoundStatement(insert)
        bound.values = list(partition_key)
        batch = BatchStatement(BatchType.UNLOGGED)
        batch.is_idempotent = True
        # Does at once what BatchStatement.add does row by row.
        batch._statements_and_parameters = statements
        batch.routing_key, batch.keyspace = bound.routing_key, insert.keyspace
        self._submit(batch, nbytes)

    def _submit(self, statement: BatchStatement | BoundStatement, nbytes: int) -> None:
        self._destination.sent(nbytes)
        self.counts.bytes += nbytes
        self._flight.submit(statement, nbytes, self._note)

    def _note(self, exc: BaseException | None) -> None:
        """Note the outcome of a statement; see Outcome."""
        if exc is not None:
            with self._mutex:
                self._failures.append(exc)

    def _check(self) -> None:
        """Raise the first error of a statement that was given up."""
        if self._failures:
            exc = self._failures[0]
            what = f"copying topic {self._source.metadata.topic}"
            raise translate(exc, what, self._there.outage.nodes()) from exc

    def _count(self, node: str, bucket: int, row: RawRow) -> None:
        """Count the messages of a row that is sent."""
        counts = self.counts
        if (
            self._count_at >= 0
        ):  # a block; the positions of deleted messages begin with their number
            gone = row[self._gone_at]
            deleted = decode_long(gone[:4]) if gone else 0
            counts.messages += decode_long(row[self._count_at]) - deleted
            return
        counts.messages += 1
        key = node, bucket, self._writer(row)
        totals = counts.totals.setdefault(key, BucketTotals())
        chunked = row[self._chunks_at] is not None
        odd = row[self._odd_at] is not None
        totals.count(decode_long(row[0]), decode_long(row[3]), chunked, odd)


def row_keys(table: RowTable, node: str, bucket: int, writers: frozenset[int]) -> dict[Order, int]:
    """Return the keys of the rows, or blocks, of writers in a bucket → their write times, us."""
    names = f'{KEYS}, WRITETIME("_conn")'
    request = table.select_range(names, table.partition_key(node, bucket), page_rows=KEY_PAGE_ROWS)
    keys = ((decode_long(row[0]), decode_long(row[1]), row[2]) for row in request.rows())
    return {
        (t, seq): decode_long(written)
        for t, seq, written in keys
        if written is not None and writer_of(seq) in writers
    }


def page_rows(rows: Iterable[BucketRow]) -> int:
    """Return the number of rows of a page, by what the directory says of their bucket."""
    entries = list(rows)
    count, nbytes = sum(row.rows for row in entries), sum(row.bytes for row in entries)
    mean = nbytes / count + 100 if count and nbytes else UNKNOWN_ROW_BYTES
    return max(1, min(MAX_PAGE_ROWS, int(PAGE_BYTES / mean)))


def _batches(rows: Sequence[RawRow]) -> Iterator[Sequence[RawRow]]:
    """Cut rows of one partition into batches."""
    first = nbytes = 0
    for n, row in enumerate(rows):
        size = _size(row)
        if n > first and (nbytes + size > WRITE_BATCH_BYTES or n - first >= WRITE_BATCH_ROWS):
            yield rows[first:n]
            first, nbytes = n, 0
        nbytes += size
    if first < len(rows):
        yield rows[first:]


def _size(row: RawRow) -> int:
    """Return the size of a row in a request, bytes."""
    return sum(len(value) + 4 for value in row if value is not None)
