# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Coarse cells, squares of the ground, and the times at which a path visits them.

Cells have three sizes, so that some hundred of them cover a room as well as a town. The visits are
a superset: in a visit the robot may have been in the cell. Queries check the exact poses
afterwards.
"""

from __future__ import annotations

import math
from typing import Iterator, NamedTuple, Sequence

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.paths import RobotPath
from cassandra_ros.places.pose_samples import Times
from cassandra_ros.places.regions import Box
from cassandra_ros.places.rigid import Floats

SIZES_M = (4, 64, 1024)
"""Side lengths of the cells, metres, ascending; on the Earth, units of ``earth``."""
MAX_REGION_CELLS = 150
"""Maximum number of cells of one size for a region. Beyond it the next larger size is used."""
JOIN_NS = 5 * SECOND_NS
"""Maximum pause between two visits of a cell that are recorded as one, ns."""
LONGEST_NS = 3600 * SECOND_NS
"""Maximum length of a visit, ns. A longer visit is split, so that a query need not search the index
farther back."""
_FAR = 2**31 - 1
"""Maximum cell number, because numbers have 32 bits. Places beyond belong to the last cell."""
_ROUNDED_M = 1e-6
"""Distance from a side, metres, within which a point belongs to both cells, because of rounding."""


class GroundCell(NamedTuple):
    """A square with sides of ``size`` metres; cell (0, 0) begins at the origin."""

    size: int
    x: int
    y: int


class CellVisit(NamedTuple):
    """A time range in which a robot may have been in a cell, ns, both ends included."""

    cell: GroundCell
    low: int
    high: int


def cells_of(boxes: Sequence[Box]) -> list[GroundCell] | None:
    """Return the cells that cover rectangles.

    None if there are too many even of the largest size.
    """
    for size in SIZES_M:
        numbers = [[_number(side, size) for side in box] for box in boxes]
        counts = ((right - left + 1) * (top - bottom + 1) for left, bottom, right, top in numbers)
        if sum(counts) <= MAX_REGION_CELLS:
            return [
                GroundCell(size, x, y)
                for left, bottom, right, top in numbers
                for x in range(left, right + 1)
                for y in range(bottom, top + 1)
            ]
    return None


def _number(metres: float, size: int) -> int:
    return max(-_FAR, min(_FAR, math.floor(metres / size)))


def visits_of(path: RobotPath) -> Iterator[CellVisit]:
    """Yield the visits of a path, by size and cell, for each cell in time order.

    At each time of the path, a visit exists for the cell of each size that contains its point.
    """
    for size in SIZES_M:
        yield from _join_visits(
            np.concatenate([_of_poses(path, size), _of_lines(path, size)]), size
        )


def _of_poses(path: RobotPath, size: int) -> Times:
    """Return the cells of isolated poses: (n, 4) numbers: x, y, low, high, see _join_visits."""
    n = path.alone
    x, y, times = _numbers(path.x[n], size), _numbers(path.y[n], size), path.times[n]
    return np.stack([x, y, times, times], 1)


def _of_lines(path: RobotPath, size: int) -> Times:
    """Return the cells of the lines between poses, as _of_poses.

    The lines are cut into pieces of at most half a cell.
    """
    starts, ends, lines = path.lines
    longest = np.maximum(np.abs(lines.dx), np.abs(lines.dy))
    pieces = np.maximum(np.ceil(2 * longest / size), 1).astype(np.int64)
    line = np.repeat(np.arange(len(pieces)), pieces)
    number = np.arange(len(line)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    shares = [number / pieces[line], (number + 1) / pieces[line]]
    x0, x1 = (lines.x[line] + share * lines.dx[line] for share in shares)
    y0, y1 = (lines.y[line] + share * lines.dy[line] for share in shares)
    length = (ends - starts)[line]
    # Rounded outwards, so that adjacent pieces leave no time between them.
    low = starts[line] + np.floor(shares[0] * length).astype(np.int64) - 1
    high = starts[line] + np.ceil(shares[1] * length).astype(np.int64) + 1
    # A piece touches at most two columns and two rows. The margin covers rounding errors.
    left, right = np.minimum(x0, x1) - _ROUNDED_M, np.maximum(x0, x1) + _ROUNDED_M
    bottom, top = np.minimum(y0, y1) - _ROUNDED_M, np.maximum(y0, y1) + _ROUNDED_M
    columns = (_numbers(left, size), _numbers(right, size))
    rows = (_numbers(bottom, size), _numbers(top, size))
    # Most pieces lie in one cell, which is listed once.
    wide, tall = columns[0] != columns[1], rows[0] != rows[1]
    all_rows = np.ones(len(low), bool)
    corners = [(0, 0, all_rows), (1, 0, wide), (0, 1, tall), (1, 1, wide & tall)]
    parts = [np.stack([columns[m], rows[n], low, high], 1)[which] for m, n, which in corners]
    return np.concatenate(parts)


def _numbers(metres: Floats, size: int) -> Times:
    numbers: Times = np.clip(np.floor(metres / size), -_FAR, _FAR).astype(np.int64)
    return numbers


def _join_visits(visits: Times, size: int) -> Iterator[CellVisit]:
    """Join visits of a cell with short pauses between them; (n, 4) numbers: x, y, low, high."""
    if not len(visits):
        return
    x, y, low, high = visits[np.lexsort((visits[:, 2], visits[:, 1], visits[:, 0]))].T
    other = (np.diff(x) != 0) | (np.diff(y) != 0) | (low[1:] > high[:-1] + JOIN_NS)
    first = np.concatenate([[0], np.flatnonzero(other) + 1])
    ends = np.maximum.reduceat(high, first)
    columns = (x[first], y[first], low[first], ends)
    for cell_x, cell_y, start, end in zip(*(column.tolist() for column in columns)):
        for begin in range(start, end + 1, LONGEST_NS):
            yield CellVisit(
                GroundCell(size, cell_x, cell_y), begin, min(end, begin + LONGEST_NS - 1)
            )


def joins(visit: CellVisit, low: int, high: int) -> bool:
    """Return whether a time range in the same cell, no earlier, extends a visit; else it is new."""
    return low <= visit.high + JOIN_NS and high - visit.low <= LONGEST_NS


class OpenVisits:
    """Extends visits while the path continues."""

    def __init__(self) -> None:
        self._open: dict[GroundCell, CellVisit] = {}
        """Latest visits of cells, which the next part of the path may extend."""

    def visits(self, path: RobotPath) -> list[CellVisit]:
        """Return the visits of the next part of a path; an extended visit from its beginning."""
        visits = []
        for visit in visits_of(path):
            earlier = self._open.get(visit.cell)
            if (
                earlier is not None
                and earlier.low <= visit.low
                and joins(earlier, visit.low, visit.high)
            ):
                visit = CellVisit(visit.cell, earlier.low, max(earlier.high, visit.high))
            self._open[visit.cell] = visit
            visits.append(visit)
        last = int(path.times[-1]) if len(path) else 0
        self._open = {c: v for c, v in self._open.items() if v.high + JOIN_NS >= last}
        return visits
