# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Regions of the ground: disks and polygons."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, NamedTuple, Protocol, Sequence, Tuple

import numpy as np

from cassandra_ros.errors import InvalidOption
from cassandra_ros.places.rigid import Floats

MAX_CORNERS = 1000
SLACK = 1e-9
"""Margin by which a region is enlarged where only what is certainly outside may be left out:
a share of its size, and metres."""


class Box(NamedTuple):
    """Rectangle, metres, all four sides included."""

    left: float
    bottom: float
    right: float
    top: float


class Lines(NamedTuple):
    """Many straight lines in a plane, metres."""

    x: Floats
    y: Floats
    """Coordinates of the start of each line."""
    dx: Floats
    dy: Floats
    """Difference from start to end of each line."""


LinePart = Tuple[int, float, float]
"""Index of a line and a part of it, from share to share: 0 is its start, 1 its end."""


class Region(Protocol):
    """A region of the ground."""

    @property
    def boxes(self) -> Sequence[Box]:
        """Rectangles that cover it."""

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point lies in the region, exactly."""

    def shares(self, lines: Lines) -> Iterator[LinePart]:
        """Yield the parts of lines that lie in the region, or slightly more; in no order."""


@dataclass(frozen=True)
class DiskRegion:
    """A disk, its rim included."""

    x: float
    y: float
    radius: float

    @property
    def boxes(self) -> list[Box]:
        """Its bounding square."""
        wide = self.radius * (1 + SLACK) + SLACK
        return [Box(self.x - wide, self.y - wide, self.x + wide, self.y + wide)]

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is within the radius of the centre."""
        return math.hypot(x - self.x, y - self.y) <= self.radius

    def shares(self, lines: Lines) -> Iterator[LinePart]:
        """Yield the part of each line that lies in the disk, if any."""
        wide = self.radius * (1 + SLACK) + SLACK
        away_x, away_y = lines.x - self.x, lines.y - self.y
        # A line meets the rim at the shares s with a s² + 2 b s + c = 0.
        a = lines.dx**2 + lines.dy**2
        b = away_x * lines.dx + away_y * lines.dy
        c = away_x**2 + away_y**2 - wide**2
        root = b**2 - a * c
        still = a <= 0
        with np.errstate(invalid="ignore", divide="ignore"):
            reach = np.sqrt(root)
            first = np.where(still, 0.0, np.maximum((-b - reach) / a, 0.0))
            last = np.where(still, 1.0, np.minimum((-b + reach) / a, 1.0))
        inside = np.where(still, c <= 0, (root >= 0) & (first <= last))
        indices = np.flatnonzero(inside)
        yield from zip(indices.tolist(), first[indices].tolist(), last[indices].tolist())


class Polygon:
    """The area inside a closed line; if the line crosses itself, by the even-odd rule.

    Args:
        corners: x and y of each corner, metres; the last is joined to the first.

    Raises:
        InvalidOption: There are fewer than 3 or more than 1000 corners, or a corner is invalid.
    """

    def __init__(self, corners: Sequence[tuple[float, float]]) -> None:
        if not 3 <= len(corners) <= MAX_CORNERS:
            raise InvalidOption(
                f"a polygon has 3 to {MAX_CORNERS} corners, not {len(corners)}: give x,y;x,y;x,y"
            )
        if not all(math.isfinite(number) for corner in corners for number in corner):
            raise InvalidOption("a corner of a polygon is infinite or NaN: give numbers of metres")
        self._corners = list(corners)
        self._sides = list(zip(self._corners, self._corners[1:] + self._corners[:1]))

    @property
    def boxes(self) -> list[Box]:
        """Its bounding rectangle."""
        xs, ys = zip(*self._corners)
        return [Box(min(xs) - SLACK, min(ys) - SLACK, max(xs) + SLACK, max(ys) + SLACK)]

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is inside: a ray to the right crosses an odd number of sides."""
        odd = False
        for (x0, y0), (x1, y1) in self._sides:
            if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
                odd = not odd
        return odd

    def shares(self, lines: Lines) -> Iterator[LinePart]:
        """Yield the parts of lines that lie in the polygon, cut where they cross its sides."""
        (box,) = self.boxes
        left, right = (
            np.minimum(lines.x, lines.x + lines.dx),
            np.maximum(lines.x, lines.x + lines.dx),
        )
        low, high = np.minimum(lines.y, lines.y + lines.dy), np.maximum(lines.y, lines.y + lines.dy)
        close = (left <= box.right) & (right >= box.left) & (low <= box.top) & (high >= box.bottom)
        for number in np.flatnonzero(close).tolist():
            x, y, dx, dy = (float(column[number]) for column in lines)
            inner = sorted(set(self._cuts(x, y, dx, dy)))
            cuts = [0.0, *inner, 1.0]
            for first, last in zip(cuts, cuts[1:]):
                middle = (first + last) / 2
                if self.holds(x + middle * dx, y + middle * dy):
                    yield number, first, last
            # The line may also touch the polygon in a single point.
            ends = (end for end in (0.0, 1.0) if self.holds(x + end * dx, y + end * dy))
            for share in (*inner, *ends):
                yield number, share, share

    def _cuts(self, x: float, y: float, dx: float, dy: float) -> Iterator[float]:
        """Yield the shares of a line at which it crosses a side, without its ends, in no order."""
        for (x0, y0), (x1, y1) in self._sides:
            side_x, side_y = x1 - x0, y1 - y0
            across = dx * side_y - dy * side_x
            if across:
                share = ((x0 - x) * side_y - (y0 - y) * side_x) / across
                along = ((x0 - x) * dy - (y0 - y) * dx) / across
                if 0 < share < 1 and -SLACK <= along <= 1 + SLACK:
                    yield share
