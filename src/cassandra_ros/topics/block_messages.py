# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of blocks, a whole block at a time, for callers that make arrays of them."""

from __future__ import annotations

import logging
from collections import deque
from functools import partial
from typing import Deque, Iterable, Iterator, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.arrays.stacked_values import MessageBlock
from cassandra_ros.blocks.bucket_read import BucketRead, OpenedBlock
from cassandra_ros.blocks.codec import Unpacked
from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.keys import writer_of
from cassandra_ros.messages.wire.message_stacks import ByteArray, Int64Array, as_planes
from cassandra_ros.topics.stored_row import StoredRow, chunks_ahead
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)


def messages_of(
    blocks: Iterable[Tuple[BucketRead, OpenedBlock]], tables: Sequence[TopicTable]
) -> Iterator[MessageBlock]:
    """Yield the messages to read of blocks; large messages, each a block of one, come last."""
    by_name = {table.name: table for table in tables}
    large: Deque[StoredRow] = deque()
    for part, opened in blocks:
        table, block, row = by_name[part.table.name], opened.block, opened.row
        if block is None or block.unpacked is None:
            large += [StoredRow(each, table) for each in part.rows(opened)]
            continue
        places, run = opened.places, partial(table.runs.text, row.writer)
        times, seqs = block.times[places], block.seqs[places]
        groups = _chosen(block.unpacked, places)
        yield MessageBlock(table, part.node, run, times, seqs, groups)
    # Rows are dropped one by one, because each keeps the bytes that were read of it.
    rows = (large.popleft() for _ in range(len(large)))
    yield from filter(None, map(_alone, chunks_ahead(rows)))


def _chosen(unpacked: Unpacked, places: Int64Array) -> Sequence[Tuple[Int64Array, ByteArray]]:
    if len(places) == len(unpacked):
        return [(group.members, group.planes) for group in unpacked.groups]
    kept = np.zeros(len(unpacked), bool)
    kept[places] = True
    numbers, chosen = np.cumsum(kept) - 1, []
    for group in unpacked.groups:
        inside = kept[group.members]
        if inside.any():
            chosen.append((numbers[group.members[inside]], group.planes[:, inside]))
    return chosen


def _alone(row: StoredRow) -> Optional[MessageBlock]:
    """Return a block of one message; None if the message was deleted meanwhile."""
    groups = []
    try:
        groups.append((np.zeros(1, np.int64), as_planes([row.wire])))
    except MessageNotFound:
        return None
    except CorruptMessage as exc:
        _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
    place = np.array([row.t], np.int64), np.array([row.seq], np.int64)
    run = partial(row.table.runs.text, writer_of(row.seq))
    return MessageBlock(row.table, row.node, run, *place, groups)
