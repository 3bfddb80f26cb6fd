# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The path of a robot: a straight line from each recorded pose to the next.

Times are receive times of poses, like the keys of the messages that a query selects. So the two
match even if a bag was replayed, whose stamps are from another day.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import Iterable, Iterator, Sequence

import numpy as np

from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.places.earth import cut_at_180
from cassandra_ros.places.pose_samples import Times, Track
from cassandra_ros.places.poses import LONGEST_GAP_SEC
from cassandra_ros.places.regions import Lines, Region
from cassandra_ros.places.rigid import Floats
from cassandra_ros.query.plan.bounds import NsRange, merge_ranges
from cassandra_ros.query.protocols import WGS84
from cassandra_ros.read import TimeRange

LONGEST_GAP_NS = round(LONGEST_GAP_SEC * SECOND_NS)
LONGEST_WAY_M = 40_000.0
"""Maximum distance between two connected poses, metres in x or y (on the Earth: units, 0.3
degrees). A robot cannot move farther."""
STAY_MARGIN_NS = 1_000_000
"""Margin added to both ends of a computed stay, ns, because times are rounded."""


@dataclass(frozen=True)
class RobotPath:
    """The positions of a robot over time."""

    times: Times
    """Times, ns since 1970, ascending and unique."""
    x: Floats
    y: Floats
    """Coordinates, metres; on the Earth, in the plane of ``earth``."""
    gap: int = LONGEST_GAP_NS
    """Maximum time between two connected poses, ns. The position between others is unknown."""

    @classmethod
    def of(cls, tracks: Iterable[Track], frame: str) -> RobotPath:
        """Return the path of consecutive tracks, whose poses are in a frame."""
        all_tracks = list(tracks)
        empty = np.zeros(0)
        times = [np.zeros(0, np.int64), *(track.times for track in all_tracks)]
        x, y = (
            [empty, *(getattr(track.poses, name) for track in all_tracks)] for name in ("x", "y")
        )
        unique_times, first = np.unique(np.concatenate(times), return_index=True)
        columns = unique_times, np.concatenate(x)[first], np.concatenate(y)[first]
        if frame == WGS84:
            columns = cut_at_180(*columns, LONGEST_GAP_NS, LONGEST_WAY_M)
        return cls(*columns)

    @classmethod
    def still(cls, x: float, y: float) -> RobotPath:
        """Return the path of an object that never moves."""
        ends = np.array([0, MAX_NS], np.int64)
        return cls(ends, np.array([x, x]), np.array([y, y]), MAX_NS)

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def _lists(self) -> tuple[list[int], list[float], list[float]]:
        # A single time is found faster in lists than in arrays.
        return self.times.tolist(), self.x.tolist(), self.y.tolist()

    def at(self, t: int) -> tuple[float, float] | None:
        """Return the position at a time, ns; None if it is unknown."""
        times, x, y = self._lists
        n = bisect_right(times, t) - 1
        if n < 0:
            return None
        before = times[n]
        if before == t:
            return x[n], y[n]
        if n + 1 == len(times) or times[n + 1] - before > self.gap:
            return None
        share = (t - before) / (times[n + 1] - before)
        dx, dy = x[n + 1] - x[n], y[n + 1] - y[n]
        if max(abs(dx), abs(dy)) > LONGEST_WAY_M:
            return None
        return x[n] + share * dx, y[n] + share * dy

    @cached_property
    def _line_starts(self) -> Times:
        """Indices of the poses that are connected to the next one."""
        far = np.maximum(np.abs(np.diff(self.x)), np.abs(np.diff(self.y)))
        indices: Times = np.flatnonzero((np.diff(self.times) <= self.gap) & (far <= LONGEST_WAY_M))
        return indices

    @property
    def lines(self) -> tuple[Times, Times, Lines]:
        """The lines between connected poses: start times, end times, coordinates."""
        n = self._line_starts
        x, y = self.x[n], self.y[n]
        lines = Lines(x, y, self.x[n + 1] - x, self.y[n + 1] - y)
        return self.times[n], self.times[n + 1], lines

    def stays(self, region: Region) -> Iterator[NsRange]:
        """Yield the time ranges of stays in a region, in order, up to STAY_MARGIN_NS too long."""
        starts, ends, lines = self.lines
        start_ns, end_ns = starts.tolist(), ends.tolist()
        ranges: list[NsRange] = []
        for n, first, last in region.shares(lines):
            length = end_ns[n] - start_ns[n]
            low, high = start_ns[n] + int(first * length), start_ns[n] + int(last * length)
            ranges.append((low - STAY_MARGIN_NS, high + STAY_MARGIN_NS))
        for n in self.alone.tolist():
            if region.holds(float(self.x[n]), float(self.y[n])):
                ranges.append((int(self.times[n]), int(self.times[n])))
        return merge_ranges(sorted(ranges))

    @property
    def alone(self) -> Times:
        """Indices of the poses that are connected to neither neighbour."""
        alone = np.ones(len(self.times), bool)
        alone[self._line_starts] = alone[self._line_starts + 1] = False
        numbers: Times = np.flatnonzero(alone)
        return numbers


def clip_ranges(spans: Iterable[NsRange], low: int, high: int) -> Iterator[NsRange]:
    """Yield the parts of time ranges within [low, high]."""
    for start, end in spans:
        if start <= high and end >= low:
            yield max(start, low), min(end, high)


def window_numbers(
    spans: Sequence[NsRange], length_ns: int, reverse: bool = False
) -> Iterator[int]:
    """Yield the numbers of the windows of a length that some time ranges touch, each once.

    The time ranges are sorted and disjoint; their windows come in this or the opposite order.
    """
    last: int | None = None
    for low, high in reversed(spans) if reverse else spans:
        numbers = range(low // length_ns, high // length_ns + 1)
        for number in reversed(numbers) if reverse else numbers:
            if number != last:
                yield number
            last = number


def subtract_ranges(spans: Sequence[NsRange], holes: Sequence[NsRange]) -> Iterator[TimeRange]:
    """Yield the parts of disjoint time ranges that are not in ``holes``; both are sorted."""
    first_hole = 0
    for low, high in spans:
        while first_hole < len(holes) and holes[first_hole][1] < low:
            first_hole += 1
        n = first_hole
        while n < len(holes) and holes[n][0] <= high:
            if holes[n][0] > low:
                yield TimeRange(low, holes[n][0] - 1)
            low = max(low, holes[n][1] + 1)
            n += 1
        if low <= high:
            yield TimeRange(low, high)
