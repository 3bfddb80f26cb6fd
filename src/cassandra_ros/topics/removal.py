# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows are deleted: the row first, then its chunks, and the directory told before."""

from __future__ import annotations

from itertools import islice
from typing import Dict, FrozenSet, Iterable, List, Optional, Sequence, Tuple, Union

from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.counting import scan_keys
from cassandra_ros.store.directory import Directory
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

ROWS_AT_ONCE = 512

_Partition = Tuple[TopicTable, str, Union[int, str]]
"""Table, node, and bucket or name."""
_Key = Tuple[int, int, bool]
"""As the store has them: time and counter; and whether there are chunks."""


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
                table.name, table.bucket_of(low), table.bucket_of(high), nodes, table.metadata.ttl
            )
            for node, bucket in sorted({(row.node, row.bucket) for row in rows}):
                deleted += self._delete_bucket(table, node, bucket, low, high)
        return deleted

    def delete_rows(self, rows: Iterable[StoredRow]) -> int:
        """Delete messages while they are found; return how many. Only some keys are held."""
        places = map(_place_of, rows)
        deleted = 0
        while True:
            some = list(islice(places, ROWS_AT_ONCE))
            if not some:
                return deleted
            groups: Dict[_Partition, List[_Key]] = {}
            for partition, key in some:
                groups.setdefault(partition, []).append(key)
            for (table, node, where), keys in groups.items():
                self._delete_some(table, node, where, keys)
            deleted += len(some)

    def _delete_some(
        self, table: TopicTable, node: str, partition: Union[int, str], keys: List[_Key]
    ) -> None:
        if isinstance(partition, int):
            # Anew for each group: a reader may count the bucket in between, and believe that.
            self._mark_deleted(table, node, partition)
        # Row by row: what another writer adds between two of them stays.
        params = [(node, partition, t, seq) for t, seq, _ in keys]
        what = f"deleting from topic {table.metadata.topic}"
        self._cassandra.execute_many(table.delete_one(), params, what=what)
        self._delete_chunks(table, node, partition, keys)

    def _delete_bucket(self, table: TopicTable, node: str, bucket: int, low: int, high: int) -> int:
        found = scan_keys(table, node, bucket, low, high)
        keys = [(t, seq, large) for t, seq, _, large, _ in found]
        if keys:
            marked = self._mark_deleted(table, node, bucket)
            params = (node, bucket, *keys[0][:2], *keys[-1][:2])
            what = f"deleting from topic {table.metadata.topic}"
            self._cassandra.execute(table.delete_range(), params, what=what)
            # Rows of who opened the bucket in between may be gone, too.
            self._mark_deleted(table, node, bucket, marked)
            self._delete_chunks(table, node, bucket, keys)
        return len(keys)

    def _mark_deleted(
        self, table: TopicTable, node: str, bucket: int, but: FrozenSet[int] = frozenset()
    ) -> FrozenSet[int]:
        """Mark the bucket for its writers of now, return them."""
        writers = frozenset(r.writer for r in self._directory.find(table.name, node, bucket))
        for writer in writers - but:
            place = (table.name, node, bucket, writer)
            self._directory.mark(place, table.metadata.ttl, deleted=True)
        return writers

    def _delete_chunks(
        self, table: TopicTable, node: str, partition: Union[int, str], keys: List[_Key]
    ) -> None:
        # After the rows: a row is the commit mark of its chunks.
        chunked = [(node, partition, t, seq) for t, seq, large in keys if large]
        if chunked:
            what = f"deleting from topic {table.metadata.topic}"
            self._cassandra.execute_many(table.delete_one(chunks=True), chunked, what=what)


def _place_of(row: StoredRow) -> Tuple[_Partition, _Key]:
    table = row.table
    where = row.name if table.named else table.bucket_of(row.t)
    return (table, row.node, where), (*table.stored_order(row.t, row.seq), row.chunked)
