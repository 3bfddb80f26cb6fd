# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows of any topics: read, counted, described, deleted. No message object is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Iterator, Optional, Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import Position
from cassandra_ros.store.chunks import readChunks
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.counting import scanKeys, settle
from cassandra_ros.store.directory import BucketRow, Directory
from cassandra_ros.store.lookup import firstAt, rowAt
from cassandra_ros.store.reader import Scan, readRows
from cassandra_ros.store.row_table import RowTable, TableRow
from cassandra_ros.topics.connections import Connections
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

LAST_NS = 2**63 - 1


@dataclass(frozen=True)
class TopicInfo:
    """What is stored of one topic, in one table, by one node."""

    topic: str
    type: str
    md5sum: str
    format: str
    node: str
    count: int
    bytes: int
    """Serialised bytes of the messages."""
    first_ns: Optional[int]
    last_ns: Optional[int]
    odd: int
    """Messages with a field that is not held exactly in its column."""
    buckets: int
    bucket_ns: int
    ttl: int
    table: str
    largest_bucket: int
    """Messages in the fullest bucket."""


class Rows:
    """Reads the rows of one keyspace."""

    def __init__(
        self, cassandra: Cassandra, directory: Directory, connections: Connections
    ) -> None:
        self._cassandra = cassandra
        self._directory = directory
        self._connections = connections

    def read(
        self,
        tables: Sequence[TopicTable],
        low: int,
        high: int,
        *,
        nodes: Optional[Sequence[str]] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        limit: Optional[int] = None,
        columns: Optional[Callable[[RowTable], Sequence[str]]] = None,
    ) -> Iterator[StoredRow]:
        """Yield rows with t in [low, high] in the order (t, node, seq, table), lazily."""
        scan = Scan(low, high, after, nodes, reverse, columns)
        by_name = {table.name: table for table in tables}
        connection_of = self._connections.get
        left = limit
        for row in readRows(self._cassandra, self._directory, tables, scan):
            if left is not None:
                if left <= 0:
                    return
                left -= 1
            yield StoredRow(row, by_name[row.table], self._wire, connection_of)

    def exact(self, table: TopicTable, t: int, node: str, seq: int) -> Optional[StoredRow]:
        """Read one row by its whole key: one SELECT."""
        row = rowAt(self._cassandra, table, t, node, seq)
        return None if row is None else self._stored(row, table)

    def at(
        self, tables: Sequence[TopicTable], t: int, nodes: Optional[Sequence[str]]
    ) -> Optional[StoredRow]:
        """Read the first row with exactly this time."""
        row = firstAt(self._cassandra, self._directory, tables, t, nodes)
        if row is None:
            return None
        return self._stored(row, next(table for table in tables if table.name == row.table))

    def _stored(self, row: TableRow, table: TopicTable) -> StoredRow:
        return StoredRow(row, table, self._wire, self._connections.get)

    def _wire(self, table: TopicTable, row: TableRow) -> bytes:
        if row.nchunks:
            return readChunks(self._cassandra, table, row)
        wire = table.format.decodeWire(row.columns, row.raw)
        if len(wire) != row.size:
            raise CorruptMessage(
                f"the message of topic {table.metadata.topic} at {row.t} has {len(wire)} bytes "
                f"instead of {row.size}: its columns were changed by somebody else"
            )
        return wire

    # ---------------------------------------------------------------- counting

    def count(
        self, tables: Sequence[TopicTable], low: int, high: int, nodes: Optional[Sequence[str]]
    ) -> int:
        """Count rows with t in [low, high]: whole closed buckets by the directory."""
        total = 0
        for table in tables:
            length = table.metadata.bucket_ns
            rows = self._directory.buckets(
                table.name, table.bucketOf(low), table.bucketOf(high), nodes
            )
            inner = [
                r for r in rows if low <= r.bucket * length and (r.bucket + 1) * length - 1 <= high
            ]
            settled = settle(self._cassandra, self._directory, table, inner)
            total += sum(row.rows for row in settled)
            edges = {(r.node, r.bucket) for r in rows} - {(r.node, r.bucket) for r in inner}
            for node, bucket in edges:
                total += sum(1 for _ in scanKeys(self._cassandra, table, node, bucket, low, high))
        return total

    def info(self, tables: Sequence[TopicTable]) -> list[TopicInfo]:
        """Describe what is stored, by table and node; counts come from the directory."""
        found: list[TopicInfo] = []
        for table in tables:
            rows = self._directory.buckets(table.name, -(2**63), LAST_NS)
            settled = settle(self._cassandra, self._directory, table, rows)
            for node in sorted({row.node for row in settled}) or [table.metadata.nodeID]:
                found.append(_describe(table, node, [r for r in settled if r.node == node]))
        return found

    # ---------------------------------------------------------------- deleting

    def delete(
        self, tables: Sequence[TopicTable], low: int, high: int, nodes: Optional[Sequence[str]]
    ) -> int:
        """Delete rows with t in [low, high], and their chunks; return how many there were."""
        deleted = 0
        for table in tables:
            rows = self._directory.buckets(
                table.name, table.bucketOf(low), table.bucketOf(high), nodes
            )
            for node, bucket in sorted({(row.node, row.bucket) for row in rows}):
                writers = [r.writer for r in rows if (r.node, r.bucket) == (node, bucket)]
                deleted += self._deleteBucket(table, node, bucket, writers, low, high)
        return deleted

    def deleteRow(self, row: StoredRow) -> int:
        """Delete one message; return 1."""
        table, node, bucket = row.table, row.node, row.table.bucketOf(row.t)
        writers = [found.writer for found in self._directory.find(table.name, node, bucket)]
        key = (row.t, row.seq)
        self._deleteKeys(table, node, bucket, writers, [(*key, row.chunked)], key, key)
        return 1

    def _deleteBucket(
        self, table: TopicTable, node: str, bucket: int, writers: list[int], low: int, high: int
    ) -> int:
        found = scanKeys(self._cassandra, table, node, bucket, low, high)
        keys = [(t, seq, large) for t, seq, _, large, _ in found]
        if keys:
            ends = keys[0][:2], keys[-1][:2]
            self._deleteKeys(table, node, bucket, writers, keys, *ends)
        return len(keys)

    def _deleteKeys(
        self,
        table: TopicTable,
        node: str,
        bucket: int,
        writers: list[int],
        keys: list[tuple[int, int, bool]],
        first: tuple[int, int],
        last: tuple[int, int],
    ) -> None:
        what = f"deleting from topic {table.metadata.topic}"
        for writer in writers:
            self._directory.markDeleted(table.name, node, bucket, writer, table.metadata.ttl)
        params = (node, bucket, *first, *last)
        self._cassandra.execute(table.deleteRange(), params, what=what)
        # The row goes first: it is the commit mark of its chunks.
        chunked = [(node, bucket, t, seq) for t, seq, large in keys if large]
        if chunked:
            self._cassandra.executeMany(table.deleteChunks(), chunked, what=what)


def _describe(table: TopicTable, node: str, rows: list[BucketRow]) -> TopicInfo:
    filled = [row for row in rows if row.rows]
    metadata = table.metadata
    by_bucket: dict[int, int] = {}
    for row in filled:
        by_bucket[row.bucket] = by_bucket.get(row.bucket, 0) + row.rows
    return TopicInfo(
        topic=metadata.topic,
        type=metadata.msg_type,
        md5sum=metadata.md5sum,
        format=metadata.format,
        node=node,
        count=sum(row.rows for row in filled),
        bytes=sum(row.bytes for row in filled),
        first_ns=min((row.t_min for row in filled), default=None),
        last_ns=max((row.t_max for row in filled), default=None),
        odd=sum(row.odd for row in filled),
        buckets=len(by_bucket),
        bucket_ns=metadata.bucket_ns,
        ttl=metadata.ttl,
        table=table.name,
        largest_bucket=max(by_bucket.values(), default=0),
    )
