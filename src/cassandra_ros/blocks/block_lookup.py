# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Single messages out of blocks, by their keys: one SELECT each."""

from __future__ import annotations

from typing import List, Optional

from cassandra_ros.blocks.block_row import WHOLE, Block, read_blocks
from cassandra_ros.connection.paging import Asked
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import COUNTER_BITS, Position, writer_of
from cassandra_ros.tables.row_table import (
    MAX_SEQ,
    MIN_SEQ,
    RowTable,
    TableRow,
    bind,
    encode_long,
)

KEPT_BLOCKS = 16
"""So many are kept while messages are found one after the other."""
_PAGE_BLOCKS = 16


def ask_over(table: RowTable, node: str, t: int, writer: Optional[int] = None) -> Asked:
    """Ask for the blocks that may hold a message of a time, of one writer or (None) of all.

    No block lasts longer than the table says, so none that begins before that is looked at.
    """
    bucket = table.bucket_of(t)
    first = max(t - table.metadata.span_ns, bucket * table.metadata.bucket_ns)
    seqs = MIN_SEQ, MAX_SEQ
    if writer is not None:
        seqs = writer << COUNTER_BITS, ((writer + 1) << COUNTER_BITS) - 1
    bounds = (first, t, *seqs, t)
    values = (*table.place(node, bucket), *map(encode_long, bounds))
    return table.send(bind(table.select_over(WHOLE), values, _PAGE_BLOCKS))


def ask_one(table: RowTable, position: Position, *, any_seq: bool) -> Asked:
    """Ask for the blocks of a message, or of the first one of its time."""
    t, node, seq = position[:3]
    return ask_over(table, node, t, None if any_seq else writer_of(seq))


def answer_one(
    table: RowTable, position: Position, asked: Asked, *, any_seq: bool = False
) -> Optional[TableRow]:
    """Find a message in the blocks that were asked for; None where there is none.

    Raises:
        CorruptMessage: It is in no block that can be read, but one cannot be read.
    """
    t, node, seq = position[:3]
    ends = ((t, MIN_SEQ), (t, MAX_SEQ)) if any_seq else ((t, seq), (t, seq))
    found: List[TableRow] = []
    problem: Optional[CorruptMessage] = None
    for row in read_blocks(table, asked.rows()):
        try:
            block = Block(table, node, row)
        except CorruptMessage as exc:
            problem = exc
            continue
        first = block.first(*ends)
        found += [] if first is None else [first]
    if problem is not None and not found:
        raise problem
    return min(found, default=None)


class Finder:
    """Finds messages of one table one after the other: a block that holds several is read once."""

    def __init__(self, table: RowTable) -> None:
        self._table = table
        self._kept: List[tuple[str, Block]] = []

    def find(self, position: Position) -> Optional[TableRow]:
        """Return the row of a message, None where there is none; raises as answer_one does."""
        found = self._known(position)
        if found is None:
            self._read(position)
            found = self._known(position)
        return found

    def _known(self, position: Position) -> Optional[TableRow]:
        t, node, seq = position[:3]
        for number, (owner, block) in enumerate(self._kept):
            inside = block.row.t <= t <= block.row.last
            if owner == node and inside and writer_of(seq) == block.row.writer:
                found = block.first((t, seq), (t, seq))
                if found is not None:
                    self._kept.insert(0, self._kept.pop(number))
                    return found
        return None

    def _read(self, position: Position) -> None:
        t, node, seq = position[:3]
        problem: Optional[CorruptMessage] = None
        found: List[Block] = []
        for row in read_blocks(self._table, ask_one(self._table, position, any_seq=False).rows()):
            try:
                found.append(Block(self._table, node, row))
            except CorruptMessage as exc:
                problem = exc
        # First the one that has it: of many connections more come than are kept.
        found.sort(key=lambda block: not len(block.between((t, seq), (t, seq))))
        self._kept = ([(node, block) for block in found] + self._kept)[:KEPT_BLOCKS]
        held = bool(found) and len(found[0].between((t, seq), (t, seq))) > 0
        if problem is not None and not held:
            raise problem
