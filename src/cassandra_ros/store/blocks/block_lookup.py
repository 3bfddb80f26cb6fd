# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Single messages from blocks by their keys, with one SELECT each."""

from __future__ import annotations

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import COUNTER_BITS, Position, writer_of
from cassandra_ros.store.blocks.block_row import WHOLE_BLOCK_COLUMNS, Block, read_blocks
from cassandra_ros.store.connection.requests import PagedRead
from cassandra_ros.store.tables.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    RowTable,
    TableRow,
    bind,
    encode_long,
)

KEPT_BLOCKS = 16
"""Maximum number of unpacked blocks kept while messages are found one after the other."""
_PAGE_BLOCKS = 16


def ask_one(table: RowTable, position: Position, *, any_seq: bool) -> PagedRead:
    """Request the blocks that may hold a message, or (any_seq) any message of its time.

    The table's metadata limit the time range of a block, so earlier blocks are left out.
    """
    t, node, seq = position[:3]
    bucket = table.bucket_of(t)
    first = max(t - table.metadata.span_ns, bucket * table.metadata.bucket_ns)
    if any_seq:
        seqs = MIN_SEQ, MAX_SEQ
    else:  # those of its writer
        writer = writer_of(seq)
        seqs = writer << COUNTER_BITS, ((writer + 1) << COUNTER_BITS) - 1
    bounds = (first, t, *seqs, t)
    values = (*table.partition_key(node, bucket), *map(encode_long, bounds))
    return table.send(bind(table.select_over(WHOLE_BLOCK_COLUMNS), values, _PAGE_BLOCKS))


def answer_one(
    table: RowTable, position: Position, request: PagedRead, *, any_seq: bool = False
) -> TableRow | None:
    """Return the row of a message in the blocks of ``ask_one``; None if they do not hold it.

    With any_seq it is the first message of its time.

    Raises:
        CorruptMessage: No readable block holds the message, and a block cannot be read.
    """
    t, node, seq = position[:3]
    ends = ((t, MIN_SEQ), (t, MAX_SEQ)) if any_seq else ((t, seq), (t, seq))
    rows: list[TableRow] = []
    problem: CorruptMessage | None = None
    for row in read_blocks(table, request.rows()):
        try:
            block = Block(table, node, row)
        except CorruptMessage as exc:
            problem = exc
            continue
        first = block.first(*ends)
        rows += [] if first is None else [first]
    if problem is not None and not rows:
        raise problem
    return min(rows, default=None)


class MessageFinder:
    """Finds messages of one table one after the other; keeps blocks that may hold further ones."""

    def __init__(self, table: RowTable) -> None:
        self._table = table
        self._kept: list[tuple[str, Block]] = []
        """Nodes and their blocks, the block that was used last first."""

    def find(self, position: Position) -> TableRow | None:
        """Return the row of a message, None if there is no such row; raises like answer_one."""
        row = self._find_kept(position)
        if row is None:
            self._read(position)
            row = self._find_kept(position)
        return row

    def _find_kept(self, position: Position) -> TableRow | None:
        t, node, seq = position[:3]
        for number, (owner, block) in enumerate(self._kept):
            inside = block.row.t <= t <= block.row.last
            if owner == node and inside and writer_of(seq) == block.row.writer:
                row = block.first((t, seq), (t, seq))
                if row is not None:
                    self._kept.insert(0, self._kept.pop(number))
                    return row
        return None

    def _read(self, position: Position) -> None:
        """Read and keep the blocks that may hold a message."""
        t, node, seq = position[:3]
        problem: CorruptMessage | None = None
        blocks: list[Block] = []
        for row in read_blocks(self._table, ask_one(self._table, position, any_seq=False).rows()):
            try:
                blocks.append(Block(self._table, node, row))
            except CorruptMessage as exc:
                problem = exc
        # The block with the message first: a time may have more blocks than are kept.
        blocks.sort(key=lambda block: not len(block.between((t, seq), (t, seq))))
        self._kept = ([(node, block) for block in blocks] + self._kept)[:KEPT_BLOCKS]
        has_message = bool(blocks) and len(blocks[0].between((t, seq), (t, seq))) > 0
        if problem is not None and not has_message:
            raise problem
