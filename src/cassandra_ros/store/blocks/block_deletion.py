# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Deletion of single messages in blocks, by marks at their positions.

A mark is only added, so two clients can mark at the same time. A block with a mark on every message
is deleted as a row. If the block was deleted meanwhile the mark remains as a row of its own, which
is deleted too.
"""

from __future__ import annotations

from typing import Collection, Mapping, Sequence

from cassandra_ros.store.blocks.block_counts import opened
from cassandra_ros.store.blocks.block_row import HEADER_COLUMNS, BlockRow, ask_blocks, read_block
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    BlockKey,
    Order,
    RowTable,
    decode_long,
)


class BlockDeletion:
    """Deletes messages of one bucket. The caller has marked it in the directory as deleted from.

    Attributes:
        large: Keys of deleted blocks whose message is in the chunk table.
    """

    def __init__(self, cassandra: Cassandra, table: RowTable, node: str, bucket: int) -> None:
        self._cassandra = cassandra
        self._table = table
        self._where = node, bucket
        self._what = f"deleting from topic {table.metadata.topic}"
        self.large: list[Order] = []

    def time_range(self, rows: Sequence[BlockRow], low: int, high: int) -> int:
        """Delete the messages with a time in [low, high], ns, from some blocks.

        Args:
            rows: Blocks of the bucket, of which the headers suffice.

        Returns:
            The number of messages that were deleted.
        """
        whole = [row for row in rows if low <= row.t and row.last <= high]
        self._delete([row.key for row in whole])
        self.large += [row.key for row in whole if row.nchunks]
        count = sum(row.left for row in whole)
        others = [row for row in rows if not (low <= row.t and row.last <= high)]
        cuts: dict[BlockKey, set[int]] = {}
        for block in opened(self._table, *self._where, iter(others)):
            places = block.between((low, MIN_SEQ), (high, MAX_SEQ))
            if len(places):
                cuts[block.row.block_key] = set(places.tolist())
                count += len(places)
        self.cut(cuts)
        return count

    def cut(self, cuts: Mapping[BlockKey, Collection[int]]) -> None:
        """Delete messages.

        Args:
            cuts: Block → positions of the messages in it.
        """
        whole = [key for key, places in cuts.items() if len(places) == key.messages]
        self._delete([(key.t, key.seq) for key in whole])
        others = {key: set(places) for key, places in cuts.items() if len(places) < key.messages}
        marks = [(places, *self._where, key.t, key.seq) for key, places in others.items()]
        if not marks:
            return
        self._cassandra.execute_many(self._table.mark_gone(), marks, what=self._what)
        self._clear([(key.t, key.seq) for key in others])

    def _clear(self, keys: Sequence[Order]) -> None:
        """Delete blocks that have no messages left, and marks without a block."""
        partition_key = self._table.partition_key(*self._where)
        empty: list[Order] = []
        alone: list[Order] = []
        for values in ask_blocks(self._table, partition_key, keys, HEADER_COLUMNS).page():
            row = read_block(self._table, values)
            if row is None:
                alone.append((decode_long(values[0]), decode_long(values[1])))
            elif not row.left:
                empty.append(row.key)
        self._delete(empty)
        self._run(self._table.unmark_gone(), alone)

    def _delete(self, keys: Sequence[Order]) -> None:
        self._run(self._table.delete_one(), keys)

    def _run(self, statement: str, keys: Sequence[Order]) -> None:
        params: list[tuple[object, ...]] = [(*self._where, *key) for key in keys]
        if params:
            self._cassandra.execute_many(statement, params, what=self._what)
