# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows are deleted: the row first, then its chunks, and the directory told before."""

from __future__ import annotations

from typing import Optional, Sequence, Union

from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.counting import scanKeys
from cassandra_ros.store.directory import Directory
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable


class Removal:
    """Deletes rows of one keyspace."""

    def __init__(self, cassandra: Cassandra, directory: Directory) -> None:
        self._cassandra = cassandra
        self._directory = directory

    def delete(
        self, tables: Sequence[TopicTable], low: int, high: int, nodes: Optional[Sequence[str]]
    ) -> int:
        """Delete rows with t in [low, high], and their chunks; return how many there were."""
        deleted = 0
        for table in tables:
            rows = self._directory.buckets(
                table.name, table.bucketOf(low), table.bucketOf(high), nodes, table.metadata.ttl
            )
            for node, bucket in sorted({(row.node, row.bucket) for row in rows}):
                writers = [r.writer for r in rows if (r.node, r.bucket) == (node, bucket)]
                deleted += self._deleteBucket(table, node, bucket, writers, low, high)
        return deleted

    def deleteRow(self, row: StoredRow) -> int:
        """Delete one message; return 1."""
        table, node = row.table, row.node
        key = table.storedOrder(row.t, row.seq)
        keys = [(*key, row.chunked)]
        if table.named:
            self._deleteKeys(table, node, row.name, keys, key, key)
            return 1
        bucket = table.bucketOf(row.t)
        writers = [found.writer for found in self._directory.find(table.name, node, bucket)]
        self._markDeleted(table, node, bucket, writers)
        self._deleteKeys(table, node, bucket, keys, key, key)
        return 1

    def _deleteBucket(
        self, table: TopicTable, node: str, bucket: int, writers: list[int], low: int, high: int
    ) -> int:
        found = scanKeys(self._cassandra, table, node, bucket, low, high)
        keys = [(t, seq, large) for t, seq, _, large, _ in found]
        if keys:
            ends = keys[0][:2], keys[-1][:2]
            self._markDeleted(table, node, bucket, writers)
            self._deleteKeys(table, node, bucket, keys, *ends)
        return len(keys)

    def _markDeleted(self, table: TopicTable, node: str, bucket: int, writers: list[int]) -> None:
        for writer in writers:
            self._directory.markDeleted(table.name, node, bucket, writer, table.metadata.ttl)

    def _deleteKeys(
        self,
        table: TopicTable,
        node: str,
        partition: Union[int, str],
        keys: list[tuple[int, int, bool]],
        first: tuple[int, int],
        last: tuple[int, int],
    ) -> None:
        what = f"deleting from topic {table.metadata.topic}"
        params = (node, partition, *first, *last)
        self._cassandra.execute(table.deleteRange(), params, what=what)
        # The row goes first: it is the commit mark of its chunks.
        chunked = [(node, partition, t, seq) for t, seq, large in keys if large]
        if chunked:
            self._cassandra.executeMany(table.deleteChunks(), chunked, what=what)
