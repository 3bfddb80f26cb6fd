# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times at which a robot may have been in a region: from the index, and where it is incomplete.

The index covers the time ranges in its ``IndexedPoses`` records, by run and table. A record is used
only while the frames are fixed to each other as they were when it was written, because otherwise
the places differ. The index may still hold visits whose messages were deleted, but it never lacks
one.
"""

from __future__ import annotations

from typing import Iterable, Iterator, Mapping, Sequence

from cassandra_ros.places.ground_cells import JOIN_NS, LONGEST_NS, GroundCell, cells_of
from cassandra_ros.places.paths import LONGEST_GAP_NS, clip_ranges, merge_ranges, subtract_ranges
from cassandra_ros.places.regions import Region
from cassandra_ros.places.robots import MAX_FRAMES, Robot
from cassandra_ros.places.stored_topics import Extent, StoredTopics
from cassandra_ros.places.track_windows import overlapping_pairs
from cassandra_ros.query.plan.bounds import NsRange
from cassandra_ros.store.tables.place_index import IndexedPoses, PlaceIndex, Square

_FIRST = LONGEST_NS + JOIN_NS
"""How long before a time a visit that lasts until then may have begun, ns."""


class Coverage:
    """Finds the times at which robots of a keyspace may have been in a region."""

    def __init__(self, stored: StoredTopics, index: PlaceIndex) -> None:
        self._stored = stored
        self._index = index

    def candidates(self, robot: Robot, region: Region, low: int, high: int) -> list[NsRange]:
        """Return the time ranges in [low, high], ns, with possible stays, sorted and disjoint."""
        extents = self._stored.extents(
            robot.topic, robot.node, low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
        )
        if not extents:
            return []
        cells = cells_of(region.box)
        records = [] if cells is None else self._valid_records(robot)
        ranges = list(uncovered_ranges(extents, records))
        if cells is not None and any(robot.frame in record.above for record in records):
            ranges += self._visits(robot, cells, low, high)
        return list(clip_ranges(merge_ranges(sorted(ranges)), low, high))

    def _valid_records(self, robot: Robot) -> list[IndexedPoses]:
        """Return the index records of a robot that are still valid."""
        tables = [table.name for table in robot.topic.tables]
        records = [
            record
            for record in self._index.placed(tables)
            if record.node == robot.node and record.robot in robot.keys
        ]
        fixed = robot.fixed() if records else {}
        return [record for record in records if is_valid(record, robot, fixed)]

    def _visits(
        self, robot: Robot, cells: Sequence[GroundCell], low: int, high: int
    ) -> Iterable[NsRange]:
        squares = [Square(robot.frame, key, *cell) for key in robot.keys for cell in cells]
        return self._index.visits(squares, robot.node, max(0, low) - _FIRST, high)


def is_valid(record: IndexedPoses, robot: Robot, fixed: Mapping[str, str]) -> bool:
    """Return whether an index record is still valid for a robot.

    Args:
        fixed: Parent and pose of each fixed frame, as it is now.
    """
    if not robot.name:
        return robot.frame in record.above
    if any(fixed.get(frame, "") != how for frame, how in record.above.items()):
        return False
    # A frame that did not exist has no visits, unless it was fixed to another frame since.
    absent = robot.frame not in record.frames and robot.frame not in fixed
    absent = absent and len(record.frames) < MAX_FRAMES
    return robot.frame in record.above or (
        absent and not any(how.startswith(f"{robot.frame} [") for how in fixed.values())
    )


def uncovered_ranges(extents: Sequence[Extent], index: Sequence[IndexedPoses]) -> Iterator[NsRange]:
    """Yield the time ranges that the index does not fully cover, in no order.

    These are the times of poses without an index record, those around the ends of records, and
    those at which several runs recorded: then each message is judged by the poses of its own run.
    """
    indexed: dict[tuple[str, int], list[NsRange]] = {}
    for record in index:
        indexed.setdefault((record.table, record.writer), []).append((record.low, record.high))
    for extent in extents:
        ranges = list(merge_ranges(sorted(indexed.get(extent[:2], ()))))
        for low, high in subtract_ranges([extent[2:]], ranges):
            yield low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
    for one, other in overlapping_pairs(extents):
        yield other.low - LONGEST_GAP_NS, min(one.high, other.high) + LONGEST_GAP_NS
    # The robot may have moved between the last pose of one run and the first pose of the next.
    there = {extent[:2] for extent in extents}
    last: int | None = None
    for low, high in sorted((n.low, n.high) for n in index if (n.table, n.writer) in there):
        if last is not None and last < low <= last + LONGEST_GAP_NS:
            yield last, low
        last = high if last is None else max(last, high)
