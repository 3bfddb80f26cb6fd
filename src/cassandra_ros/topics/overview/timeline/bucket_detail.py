# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times of messages within their buckets, by keys and headers of blocks, up to a limit.

Pieces with the fewest messages to read come first, so that most pieces become exact.
"""

from __future__ import annotations

import threading
from itertools import islice
from typing import Sequence

import numpy as np

from cassandra_ros.read import Whose
from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.topics.overview.timeline.range_counts import MessageKeys, RangeCounts
from cassandra_ros.topics.overview.timeline.time_cells import (
    WIDE_CELLS,
    Bools,
    Longs,
    Scale,
    TimeRanges,
)

MAX_KEYS = 30_000
"""Maximum number of messages whose keys are read for one picture."""
MAX_PICTURE_BLOCKS = 5000
"""Maximum number of headers of blocks that are read for one picture."""
_BLOCK_MESSAGES = 256
"""Assumed minimum number of messages in a block, except for blocks of about half a second."""


class _Budget:
    """Numbers of keys and headers that may still be read."""

    def __init__(self) -> None:
        self.keys = MAX_KEYS
        self.blocks = MAX_PICTURE_BLOCKS

    def take_keys(self, count: int) -> bool:
        """Subtract keys that were read; return whether enough were left.

        If not, none are left: no later piece is read by keys.
        """
        enough = count <= self.keys
        self.keys = max(0, self.keys - count)
        return enough

    def take_blocks(self, count: int) -> bool:
        """Take blocks as take_keys takes keys; after a refusal no later piece is read by blocks."""
        enough = count <= self.blocks
        self.blocks = max(0, self.blocks - count)
        return enough


def refined(
    pieces: Sequence[RangeCounts], scale: Scale, whose: Whose, gone: threading.Event
) -> list[RangeCounts]:
    """Return pieces in more detail, where buckets cover several cells or have no final counts.

    Args:
        pieces: Counts of tables and robots; there are as many, in the same order, in the result.
        whose: Robots and writers whose messages count.
        gone: If it is set, no more keys are read.
    """
    detailed, budget = list(pieces), _Budget()
    coarse = [_coarse(piece, scale) for piece in pieces]
    costs = [_cost(piece, mask, scale) for piece, mask in zip(pieces, coarse)]
    for number in sorted(range(len(detailed)), key=costs.__getitem__):
        if gone.is_set():
            break
        if coarse[number].any() and not detailed[number].sampled:
            better = _better(detailed[number], coarse[number], costs[number], scale, whose, budget)
            detailed[number] = better or detailed[number]
    return detailed


def _cost(piece: RangeCounts, coarse: Bools, scale: Scale) -> float:
    """Return the approximate number of messages to read for the coarse time ranges of a piece."""
    ranges = piece.time_ranges
    messages = ranges.messages * ranges.shares(scale.start, scale.end)
    return float(messages[coarse].sum())


def _coarse(piece: RangeCounts, scale: Scale) -> Bools:
    """Return which time ranges are worth reading in detail."""
    ranges = piece.time_ranges
    near = (ranges.first <= scale.end) & (ranges.last >= scale.start)
    spans = scale.cells_of(ranges.last) - scale.cells_of(ranges.first)
    wide = (spans >= WIDE_CELLS - 1) & (ranges.messages > 2)
    cut = (ranges.first < scale.start) | (ranges.last > scale.end)
    return np.asarray(near & (wide | cut | ~ranges.sure))


def _better(
    piece: RangeCounts, coarse: Bools, cost: float, scale: Scale, whose: Whose, budget: _Budget
) -> RangeCounts | None:
    """Return a piece with its coarse buckets read in detail; None if that is too much to read.

    Args:
        cost: Approximate number of their messages.
    """
    buckets = np.unique(piece.buckets[coarse])
    stays = ~np.isin(piece.buckets, buckets)
    rest = piece._replace(time_ranges=piece.time_ranges.where(stays), buckets=piece.buckets[stays])
    if cost <= budget.keys:
        keys = _keys(piece, buckets, scale, whose, budget)
        return None if keys is None else rest._replace(keys=MessageKeys.joined([piece.keys, keys]))
    if piece.table.packed and cost <= budget.blocks * _BLOCK_MESSAGES:
        blocks = _blocks(piece, buckets, scale, whose, budget)
        if blocks is not None:
            time_ranges, of_buckets = blocks
            return rest._replace(
                time_ranges=TimeRanges.joined([rest.time_ranges, time_ranges]),
                buckets=np.concatenate([rest.buckets, of_buckets]),
            )
    return None


def _keys(
    piece: RangeCounts, buckets: Longs, scale: Scale, whose: Whose, budget: _Budget
) -> MessageKeys | None:
    """Return the messages of some buckets in the picture; None = more than the budget permits."""
    rows: list[tuple[int, int, int]] = []
    for bucket in map(int, buckets):
        scan = layout_of(piece.table).keys(piece.node, bucket, scale.start, scale.end)
        keys = [(t, seq, size) for t, seq, size, *_ in islice(scan, budget.keys + 1)]
        # The bucket may have more messages than the directory says.
        if not budget.take_keys(len(keys)):
            return None
        rows += [(t, seq, size) for t, seq, size in keys if whose.wrote(seq)]
    return MessageKeys(*np.array(rows, np.int64).reshape(-1, 3).T)


def _blocks(
    piece: RangeCounts, buckets: Longs, scale: Scale, whose: Whose, budget: _Budget
) -> tuple[TimeRanges, Longs] | None:
    """Return the blocks of some buckets as time ranges, with their buckets; None as ``_keys``."""
    rows: list[tuple[int, ...]] = []
    for bucket in map(int, buckets):
        read = headers(piece.table, piece.node, bucket, scale.start, scale.end, whose.writers)
        block_rows = list(islice(read, budget.blocks + 1))
        if not budget.take_blocks(len(block_rows)):
            return None
        rows += [
            (block.t, block.last, block.left, block.size, block.writer, not len(block.gone), bucket)
            for block in block_rows
            if block.left
        ]
    columns = np.array(rows, np.int64).reshape(-1, 7).T
    first, last, messages, size, writer, sure, of_buckets = columns
    return TimeRanges(first, last, messages, size, writer, sure.astype(bool)), of_buckets
