# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A grid of log-odds that grows as needed, and the rays that fill it."""

from __future__ import annotations

import math
from typing import Iterator

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import InvalidOption
from cassandra_ros.places.pose_samples import Flags
from cassandra_ros.places.rigid import Floats

MAX_GRID_CELLS = 50_000_000
"""Maximum number of cells (200 MB)."""
_FARTHEST = 2.0**40
"""Maximum distance from the frame's origin, cells. Sums of such numbers are exact."""
_MARGIN = 128
"""Number of additional cells on each side when the grid grows, so that it is rarely copied."""
_CERTAIN = np.float32(3.5)
"""Maximum absolute log-odds of a cell (97 %), so that later measurements can still change it."""
_BLOCK = 1 << 15
"""Number of cells of rays that are computed together; they fit into the processor's cache."""

Cells = NDArray[np.int64]
Odds = NDArray[np.float32]


class LogOddsGrid:
    """Probability, as log-odds, that each cell is occupied. Its size is limited only by memory.

    Cells are counted from the frame's origin: cell (0, 0) extends from 0 to the resolution.

    Args:
        resolution: Length of a cell, metres.
        hit: Probability that a cell in which a beam ended is occupied, 0.5 to 1.
        miss: Probability that a cell which a beam crossed is occupied, 0 to 0.5.

    Raises:
        InvalidOption: An argument is out of range.
    """

    def __init__(self, resolution: float, hit: float = 0.7, miss: float = 0.4) -> None:
        if not (0 < resolution < math.inf):
            raise InvalidOption(f"resolution={resolution!r}: give metres above 0, as 0.05")
        if not (0.5 < hit < 1 and 0 < miss < 0.5):
            raise InvalidOption(
                f"hit={hit!r}, miss={miss!r}: give 0.5 < hit < 1 and 0 < miss < 0.5"
            )
        self.resolution = resolution
        self._hit, self._miss = (np.float32(math.log(p / (1 - p))) for p in (hit, miss))
        self._low: Cells = np.zeros(2, np.int64)
        """Column and row of the first cell in memory."""
        self._odds: Odds = np.zeros((0, 0), np.float32)

    def add(self, origin: Floats, ends: Floats, hit: Flags) -> None:
        """Add the rays of one measurement. Each cell changes once; a hit has priority over a miss.

        Args:
            origin: Origin of the rays, (2,), metres.
            ends: Ends of the rays, (n, 2), metres.
            hit: Whether each ray hit something at its end.

        Raises:
            InvalidOption: The grid would be larger than MAX_GRID_CELLS.
        """
        if not len(ends):
            return
        start, cells = self._cells(origin), self._cells(ends)
        low = np.minimum(cells.min(0), start)
        high = np.maximum(cells.max(0), start)
        self._cover(low, high)
        width, height = (int(n) for n in high - low + 1)
        local, begin = cells - low, start - low
        flat = local[:, 1] * width + local[:, 0]
        struck = np.unique(flat[hit])
        passed = np.setdiff1d(flat[~hit], struck)
        change = np.zeros(height * width, np.float32)
        change[passed] = self._miss
        for crossed in _crossed_cells(begin, np.union1d(struck, passed), width):
            change[crossed] = self._miss
        change[struck] = self._hit
        (column, row) = (int(n) for n in low - self._low)
        window = self._odds[row : row + height, column : column + width]
        window += change.reshape(height, width)
        # Four times as fast as np.clip.
        np.maximum(window, -_CERTAIN, out=window)
        np.minimum(window, _CERTAIN, out=window)

    def _cells(self, points: Floats) -> Cells:
        cells = np.floor(points / self.resolution)
        if not (np.abs(cells) < _FARTHEST).all():  # also true for NaN
            raise InvalidOption(
                f"the map would reach {np.abs(points).max():g} m from the origin of its frame: "
                "give a shorter max_range"
            )
        indexes: Cells = cells.astype(np.int64)
        return indexes

    def _cover(self, low: Cells, high: Cells) -> None:
        """Grow the array so that it contains the cells from low to high."""
        size = np.array(self._odds.shape[::-1])
        first = low if not self._odds.size else np.minimum(low, self._low)
        stop = high + 1 if not self._odds.size else np.maximum(high + 1, self._low + size)
        if self._odds.size and (first >= self._low).all() and (stop <= self._low + size).all():
            return
        if math.prod(int(n) for n in stop - first) > MAX_GRID_CELLS:
            metres = " x ".join(f"{n * self.resolution:.0f}" for n in stop - first)
            raise InvalidOption(
                f"the map would be {metres} m large, more than {MAX_GRID_CELLS} cells of "
                f"{self.resolution:g} m: give a coarser resolution, or a shorter max_range"
            )
        first, stop = first - _MARGIN, stop + _MARGIN
        width, height = (int(n) for n in stop - first)
        odds = np.zeros((height, width), np.float32)
        column, row = (int(n) for n in self._low - first)
        odds[row : row + self._odds.shape[0], column : column + self._odds.shape[1]] = self._odds
        self._odds, self._low = odds, first

    def trimmed(self) -> tuple[Odds, tuple[float, float]]:
        """Return the log-odds of the seen area, by rows of y and columns of x, and its origin.

        The origin is the corner with the smallest x and y, metres. Log-odds of 0 mean unknown.
        """
        seen = self._odds != 0
        rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
        if not len(rows):
            return np.zeros((0, 0), np.float32), (0.0, 0.0)
        first = self._low + (columns[0], rows[0])
        # Rounded to 1 nm, because 127 cells of 0.1 m should be 12.7 m.
        x, y = (round(float(n) * self.resolution, 9) for n in first)
        return self._odds[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy(), (x, y)


def _crossed_cells(begin: Cells, ends: Cells, width: int) -> Iterator[NDArray[np.int32]]:
    """Yield the flat indices of the cells on the lines from one cell to others, without the others.

    As Bresenham's lines they have one cell in each column, or in each row if they are steep.
    """
    y, x = np.divmod(ends, width)
    dx, dy = x - begin[0], y - begin[1]
    steps = np.maximum(np.abs(dx), np.abs(dy))
    order = np.argsort(-steps)
    order = order[: np.count_nonzero(steps)]
    done = 0
    while done < len(order):
        longest = int(steps[order[done]])
        mine = order[done : done + max(1, _BLOCK // longest)]
        done += len(mine)
        count = steps[mine].astype(np.float32)[:, None]
        # Shorter lines repeat their last cell, which has no effect.
        step = np.minimum(np.arange(longest, dtype=np.float32)[None, :], count - 1)
        columns = _along(step, dx[mine, None] / count, begin[0])
        rows = _along(step, dy[mine, None] / count, begin[1])
        rows *= np.int32(width)
        rows += columns
        yield rows.ravel()


def _along(step: Odds, slope: Floats, begin: int) -> NDArray[np.int32]:
    """Return the columns, or rows, at some steps; none is negative."""
    return (step * slope.astype(np.float32) + np.float32(begin + 0.5)).astype(np.int32)
