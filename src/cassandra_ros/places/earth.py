# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Positions on the Earth: latitude and longitude as a plane, distances, disks.

So that paths, cells and regions are those of the ground, longitude and latitude are x and y of a
plane, in units of 1/131072 of a degree: about 0.85 m to the north, and less to the east. The unit
is a power of two, so degrees are converted without rounding, and cells of each size cover the
Earth without a rest. Between two positions both coordinates change evenly, the longitude by the
shorter way.

Distances are those on a sphere with the mean radius of the Earth, by the haversine formula. They
differ from distances on the ellipsoid of WGS84 by at most 0.57 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator

import numpy as np

from cassandra_ros.errors import InvalidOption
from cassandra_ros.places.pose_samples import Times
from cassandra_ros.places.regions import SLACK, Box, LinePart, Lines
from cassandra_ros.places.rigid import Floats

RADIUS_M = 6_371_008.8
"""Mean radius of the Earth, metres."""
UNITS_PER_DEGREE = 131_072.0
"""Units of x and y in a degree."""
METRES_PER_UNIT = math.radians(RADIUS_M) / UNITS_PER_DEGREE
"""Length of a unit of latitude, metres; a unit of longitude is at most as long."""
TURN = 360 * UNITS_PER_DEGREE
"""Units of x once around the Earth."""
_POLE = 90 * UNITS_PER_DEGREE
_ROUNDED_M = 1e-6
"""Possible error of a computed distance, metres."""
_FINE_M = 0.01
"""Length of the pieces of a line at the rim of a disk that are not cut further, metres."""


def plane_of(latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
    """Return x and y of positions in degrees; NaN where they are no position.

    A latitude is -90 to 90, a longitude -360 to 360; x is in [-180, 180] degrees.
    """
    with np.errstate(invalid="ignore"):
        valid = (np.abs(latitude) <= 90) & (np.abs(longitude) <= 360)
        longitude = np.where(longitude > 180, longitude - 360, longitude)
        longitude = np.where(longitude < -180, longitude + 360, longitude)
    x, y = (np.where(valid, degrees, np.nan) for degrees in (longitude, latitude))
    return x * UNITS_PER_DEGREE, y * UNITS_PER_DEGREE


def cut_at_180(
    times: Times, x: Floats, y: Floats, gap: int, way: float
) -> tuple[Times, Floats, Floats]:
    """Return the positions with two more on each way over longitude 180, one on each side.

    The two are 1 ns apart, so no time lies between them.

    Args:
        times: Times of the positions, ns, ascending.
        x, y: The positions.
        gap: Maximum time between two connected positions, ns.
        way: Maximum distance between two connected positions, in x or y.
    """
    across, up = TURN - np.abs(np.diff(x)), np.abs(np.diff(y))
    over = np.flatnonzero((across <= way) & (up <= way) & (np.diff(times) <= gap))
    if not len(over):
        return times, x, y
    side = np.sign(x[over])  # of the first of two positions; the other is on the other side
    dx, dy = x[over + 1] + side * TURN - x[over], y[over + 1] - y[over]
    share = np.divide(side * TURN / 2 - x[over], dx, out=np.zeros_like(dx), where=dx != 0)
    length = np.diff(times)[over]
    steps = np.clip(share * length, 0, length - 1).astype(np.int64)  # one of the two lies inside
    added = []
    for step, turned in ((steps, 0), (steps + 1, side * TURN)):
        inside = (step > 0) & (step < length)
        at = step / length
        columns = (times[over] + step, x[over] + at * dx - turned, y[over] + at * dy)
        added.append([column[inside] for column in columns])
    all_times, all_x, all_y = (np.concatenate(columns) for columns in zip((times, x, y), *added))
    order = np.argsort(all_times, kind="stable")
    return all_times[order], all_x[order], all_y[order]


@dataclass(frozen=True)
class EarthDisk:
    """All positions within a distance of a centre, the rim included; a region of the plane.

    Raises:
        InvalidOption: The centre is no latitude and longitude.
    """

    latitude: float
    longitude: float
    """The centre, degrees: -90 to 90, and -180 to 180."""
    radius: float
    """Metres."""

    def __post_init__(self) -> None:
        if abs(self.latitude) > 90 or abs(self.longitude) > 180:
            raise InvalidOption(
                f"latitude {self.latitude:g} and longitude {self.longitude:g} are no place on the "
                "Earth: give -90 to 90 degrees, then -180 to 180"
            )

    @property
    def boxes(self) -> list[Box]:
        """Rectangles of the plane that cover the disk: two where it lies across longitude 180."""
        angle = min(self._wide / RADIUS_M, math.pi)
        x, y = self.longitude * UNITS_PER_DEGREE, self.latitude * UNITS_PER_DEGREE
        high = math.degrees(angle) * UNITS_PER_DEGREE
        bottom, top = max(y - high, -_POLE), min(y + high, _POLE)
        if abs(y) + high >= _POLE:  # every longitude is within the distance, at a pole
            return [Box(-TURN / 2, bottom, TURN / 2, top)]
        sine = math.sin(angle) / math.cos(math.radians(self.latitude))
        across = math.degrees(math.asin(min(1.0, sine))) * UNITS_PER_DEGREE * (1 + SLACK) + SLACK
        box = Box(x - across, bottom, x + across, top)
        boxes = [box]
        if box.left < -TURN / 2:
            boxes.append(box._replace(left=box.left + TURN, right=box.right + TURN))
        if box.right > TURN / 2:
            boxes.append(box._replace(left=box.left - TURN, right=box.right - TURN))
        return boxes

    @property
    def _wide(self) -> float:
        """Radius with a margin for rounding, metres: what is farther is certainly outside."""
        return self.radius * (1 + SLACK) + _ROUNDED_M

    def holds(self, x: float, y: float) -> bool:
        """Return whether a position is within the radius of the centre."""
        at = (math.radians(y / UNITS_PER_DEGREE), math.radians(x / UNITS_PER_DEGREE))
        up, across = (math.sin((here - there) / 2) for here, there in zip(at, self._radians))
        square = up * up + math.cos(at[0]) * math.cos(self._radians[0]) * across * across
        return 2 * RADIUS_M * math.asin(math.sqrt(min(1.0, square))) <= self.radius

    @property
    def _radians(self) -> tuple[float, float]:
        """Latitude and longitude of the centre, radians."""
        return math.radians(self.latitude), math.radians(self.longitude)

    def shares(self, lines: Lines) -> Iterator[LinePart]:
        """Yield the parts of lines that lie in the disk: halves of halves, down to 1 cm at its rim.

        No point of a line is farther from its middle than half its length; so a piece is inside, or
        outside, if its middle is so by more than that.
        """
        half = np.hypot(lines.dx, lines.dy) * (METRES_PER_UNIT / 2)
        line, first = np.arange(len(half)), np.zeros(len(half))
        last = np.ones(len(half))
        while len(line):
            middle = (first + last) / 2
            away = self._distances(
                lines.x[line] + middle * lines.dx[line], lines.y[line] + middle * lines.dy[line]
            )
            reach = half[line] * (last - first)
            near = away - reach <= self._wide
            whole = near & ((away + reach <= self.radius) | (2 * reach <= _FINE_M))
            yield from zip(line[whole].tolist(), first[whole].tolist(), last[whole].tolist())
            cut = near & ~whole
            line = np.concatenate([line[cut], line[cut]])
            first, last = (
                np.concatenate([first[cut], middle[cut]]),
                np.concatenate([middle[cut], last[cut]]),
            )

    def _distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of positions of the plane from the centre, metres; as ``holds``."""
        latitude, longitude = (np.radians(n / UNITS_PER_DEGREE) for n in (y, x))
        up, across = (
            np.sin((latitude - self._radians[0]) / 2),
            np.sin((longitude - self._radians[1]) / 2),
        )
        square = up**2 + np.cos(latitude) * math.cos(self._radians[0]) * across**2
        distances: Floats = 2 * RADIUS_M * np.arcsin(np.sqrt(np.minimum(square, 1)))
        return distances
