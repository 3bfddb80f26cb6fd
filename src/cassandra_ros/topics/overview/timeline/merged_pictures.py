# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of several stores as one, of which messages are counted once that several stores have.

A picture knows numbers of messages in time ranges, and single messages where it was drawn in
detail. If several stores have messages of a run in time ranges that overlap, those of the store
with the most messages count: there may be more. Single messages are counted exactly.
"""

from __future__ import annotations

from typing import Sequence

import numpy as np

from cassandra_ros.topics.overview.timeline.directory_reader import Ends
from cassandra_ros.topics.overview.timeline.lanes import Lane, Picture
from cassandra_ros.topics.overview.timeline.range_counts import MessageKeys, RangeCounts
from cassandra_ros.topics.overview.timeline.time_cells import Bools, Longs, TimeRanges


def merged_extent(pictures: Sequence[Picture]) -> Ends | None:
    """Return the times of the first and the last message; those with names count only alone."""
    timed = [picture.extent for picture in pictures if picture.extent and not picture.named]
    extents = timed or [picture.extent for picture in pictures if picture.extent]
    firsts, lasts = [first for first, _ in extents], [last for _, last in extents]
    return (min(firsts), max(lasts)) if extents else None


def merged_picture(pictures: Sequence[Picture], extent: Ends | None) -> Picture:
    """Return the picture of all stores.

    Args:
        pictures: The picture of each store, all of the same time range and number of cells.
        extent: Times of the first and the last of all selected messages, ns.
    """
    lanes: dict[tuple[str, str], list[Lane]] = {}
    for picture in pictures:
        for lane in picture.lanes:
            lanes.setdefault((lane.node, lane.topic), []).append(lane)
    scale = next((picture.scale for picture in pictures), None)
    ends = (0, 0) if scale is None else (scale.start, scale.end)
    unions = [_merge(lanes[key], ends) for key in sorted(lanes)]
    # A store whose messages of a topic were deleted still has the topic, of no robot.
    others = {lane.topic for lane in unions if lane.node}
    return Picture(
        extent, scale, [lane for lane in unions if lane.topic not in others or not _is_bare(lane)]
    )


def _is_bare(lane: Lane) -> bool:
    """Return whether a lane is of no robot and has no message."""
    return not lane.node and lane.times[0] is None


def _merge(lanes: Sequence[Lane], ends: Ends) -> Lane:
    """Return the lane of a topic and robot in all stores."""
    if len(lanes) == 1:
        return lanes[0]
    parts = [TimeRanges.joined([lane.time_ranges, _single(lane.keys)]) for lane in lanes]
    ranges = TimeRanges.joined(parts)
    store = np.repeat(np.arange(len(parts)), [len(time_ranges.first) for time_ranges in parts])
    kinds = [(len(lane.time_ranges.first), len(lane.keys.times)) for lane in lanes]
    single = np.concatenate([np.repeat([False, True], lengths) for lengths in kinds])
    seqs = np.concatenate(
        [np.r_[np.zeros(kinds[n][0], np.int64), lane.keys.seqs] for n, lane in enumerate(lanes)]
    )
    counts, shared = _counted_once(ranges, store, single, seqs)
    keys = ranges.where(counts & single)
    wide = ranges._replace(sure=ranges.sure & ~shared).where(counts & ~single)
    tables = [table for lane in lanes for table in lane.tables]
    piece = RangeCounts(
        tables[0],
        lanes[0].node,
        wide,
        np.full(len(wide.first), -1),
        any(lane.sampled for lane in lanes) or bool((shared & counts & single).any()),
        any(lane.writing for lane in lanes),
        MessageKeys(keys.first, seqs[counts & single], keys.bytes),
    )
    return Lane(lanes[0].topic, lanes[0].node, tables, [piece], ends)


def _single(keys: MessageKeys) -> TimeRanges:
    """Return messages as time ranges of one message each."""
    ones = np.ones(len(keys.times), np.int64)
    return TimeRanges(keys.times, keys.times, ones, keys.sizes, keys.writers, ones > 0)


def _counted_once(
    ranges: TimeRanges, store: Longs, single: Bools, seqs: Longs
) -> tuple[Bools, Bools]:
    """Choose the time ranges that count.

    Args:
        store: Number of the store of each time range.
        single: Which time ranges are single messages.
        seqs: Writer id << 32 | counter of each single message.

    Returns:
        Which time ranges count, and which overlap time ranges of the same run in another store.
    """
    # The first of those with equal times and seqs. So each single message counts once.
    is_first = np.zeros(len(store), bool)
    is_first[np.unique(np.stack([ranges.first, seqs]), axis=1, return_index=True)[1]] = True
    counts, shared = np.ones(len(store), bool), np.zeros(len(store), bool)
    order = np.lexsort((ranges.first, ranges.writer))
    for run in np.split(order, np.flatnonzero(np.diff(ranges.writer[order])) + 1):
        if not len(run) or (store[run] == store[run[0]]).all():
            continue
        # Time ranges of the run that overlap, directly or by others, are one group.
        reach = np.maximum.accumulate(ranges.last[run])
        group = np.cumsum(np.r_[False, ranges.first[run][1:] > reach[:-1]])
        totals = np.full((group[-1] + 1, store.max() + 1), -1)  # -1 = no messages, 0 = unknown
        totals[group, store[run]] = 0
        np.add.at(totals, (group, store[run]), ranges.messages[run])
        # In a group of single messages each counts once; in another the store with the most counts.
        exact = (np.bincount(group, ~single[run]) == 0)[group]
        most = store[run] == totals.argmax(axis=1)[group]
        counts[run] = np.where(exact, is_first[run], most)
        shared[run] = ((totals >= 0).sum(axis=1) > 1)[group] & ~exact
    return counts, shared
