# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""When a robot may have been in a region: by the index as far as it goes, else any time.

The index goes as far as somebody noted (``Placed``), by run and table, and only while it knows the
frames as they are known now: where a frame was fixed to another one since, places are others. What
no longer is stored may stay in it; what it lacks is never left out.
"""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

from cassandra_ros.places.ground_cells import JOIN_NS, LONGEST_NS, Cell, cells_of
from cassandra_ros.places.paths import LONGEST_GAP_NS, Span, clipped, merged, without
from cassandra_ros.places.regions import Region
from cassandra_ros.places.robots import MOST_FRAMES, Robot
from cassandra_ros.places.stored import Extent, Stored
from cassandra_ros.places.track_windows import overlaps
from cassandra_ros.tables.place_index import Placed, PlaceIndex, Square

_FIRST = LONGEST_NS + JOIN_NS
"""So long before a time a visit that reaches it may have begun."""


class Coverage:
    """Tells when robots of a keyspace may have been somewhere."""

    def __init__(self, stored: Stored, index: PlaceIndex) -> None:
        self._stored = stored
        self._index = index

    def candidates(self, robot: Robot, region: Region, low: int, high: int) -> List[Span]:
        """Return the stretches of [low, high], ns, in which it may be, in order and apart."""
        extents = self._stored.extents(
            robot.topic, robot.node, low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
        )
        if not extents:
            return []
        cells = cells_of(region.box)
        noted = [] if cells is None else self._noted(robot)
        found = list(uncovered(extents, noted))
        if cells is not None and any(robot.frame in each.above for each in noted):
            found += self._visits(robot, cells, low, high)
        return list(clipped(merged(sorted(found)), low, high))

    def _noted(self, robot: Robot) -> List[Placed]:
        """Return what the index says of a robot's poses, as far as it still holds."""
        tables = [table.name for table in robot.topic.tables]
        every = [
            each
            for each in self._index.placed(tables)
            if each.node == robot.node and each.robot in robot.keys
        ]
        fixed = robot.fixed() if every else {}
        return [each for each in every if holds(each, robot, fixed)]

    def _visits(self, robot: Robot, cells: Sequence[Cell], low: int, high: int) -> Iterable[Span]:
        squares = [Square(robot.frame, key, *cell) for key in robot.keys for cell in cells]
        return self._index.visits(squares, robot.node, max(0, low) - _FIRST, high)


def holds(noted: Placed, robot: Robot, fixed: Mapping[str, str]) -> bool:
    """Say whether a robot's places are those that were noted.

    Args:
        fixed: How frames are fixed to others now.
    """
    if not robot.name:
        return robot.frame in noted.above
    if any(fixed.get(frame, "") != how for frame, how in noted.above.items()):
        return False
    # Nothing was noted in a frame that was nowhere; unless it is fixed to another one by now.
    absent = robot.frame not in noted.frames and robot.frame not in fixed
    absent = absent and len(noted.frames) < MOST_FRAMES
    return robot.frame in noted.above or (absent and not _carries(robot.frame, fixed))


def _carries(frame: str, fixed: Mapping[str, str]) -> bool:
    return any(how.startswith(f"{frame} [") for how in fixed.values())


def uncovered(extents: Sequence[Extent], noted: Sequence[Placed]) -> Iterator[Span]:
    """Yield the times of which the index does not say everything, in no order.

    These are the times of poses of which it says nothing, those around where its word ends and the
    next begins, and those at which several runs recorded: then each message goes by its own run.
    """
    known: Dict[Tuple[str, int], List[Span]] = {}
    for each in noted:
        known.setdefault((each.table, each.writer), []).append((each.low, each.high))
    for extent in extents:
        said = list(merged(sorted(known.get(extent[:2], ()))))
        for low, high in without([extent[2:]], said):
            yield low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
    for one, other in overlaps(extents):
        yield other.low - LONGEST_GAP_NS, min(one.high, other.high) + LONGEST_GAP_NS
    # From the last pose of one run a way may lead to the first of the next.
    there = {extent[:2] for extent in extents}
    last: Optional[int] = None
    for low, high in sorted((n.low, n.high) for n in noted if (n.table, n.writer) in there):
        if last is not None and last < low <= last + LONGEST_GAP_NS:
            yield last, low
        last = high if last is None else max(last, high)
