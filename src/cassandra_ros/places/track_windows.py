# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The paths of one robot in time windows, read when they are needed; a few windows are cached.

If several runs of a node recorded poses at the same time (two robots without a nodeID, or two
recorders for one robot), the messages of a run are judged by the poses of that run. The messages of
a run without poses are judged by the poses of all runs.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Iterator, Mapping, Sequence

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.array_source import Extent, StoredTopics
from cassandra_ros.places.paths import LONGEST_GAP_NS, RobotPath
from cassandra_ros.places.pose_samples import Samples
from cassandra_ros.places.poses import Poses
from cassandra_ros.places.robots import Robot
from cassandra_ros.read import Writers

TRACK_WINDOW_NS = 30 * SECOND_NS
MAX_CACHED_WINDOWS = 8
"""Maximum number of cached windows."""
OPEN_WINDOW_CACHE_SEC = 2.0
"""How long a window that may still get poses is cached, s."""


@dataclass(frozen=True)
class PathWindow:
    """The path of a robot in one time window, by all runs and by each run."""

    of_all: RobotPath
    """Path by the poses of all runs."""
    by_run: Mapping[str, RobotPath] = field(default_factory=dict)
    """Paths by the poses of one run, by the value of RUN, if several runs overlap."""
    complete: bool = False
    """Whether no more poses are expected: there is one after the end of the window."""

    def at(self, run: str, t: int) -> tuple[float, float] | None:
        """Return the position of the robot of a run's message at a time, ns; None if unknown."""
        run_path = self.by_run.get(run)
        place = None if run_path is None else run_path.at(t)
        return self.of_all.at(t) if place is None else place

    @property
    def paths(self) -> list[RobotPath]:
        """All paths."""
        return [self.of_all, *self.by_run.values()]


class Windows:
    """The time windows of one robot. For use by one thread at a time."""

    def __init__(self, robot: Robot, stored: StoredTopics) -> None:
        self.robot = robot
        self._stored = stored
        self._poses: dict[Writers, Poses] = {}
        self._cache: OrderedDict[int, tuple[float, PathWindow]] = OrderedDict()
        """Number of a window → monotonic time until which it is used, s, and the window; the one
        that was used last is at the end."""
        self.still = self._still()
        """Path of a robot that never moves; None if it moves."""

    def _still(self) -> RobotPath | None:
        """Return the value of ``still``."""
        # A pose that is known without any moving transform is fixed.
        nothing, once = Samples.none(), np.zeros(1, np.int64)
        poses, valid = self.robot.source().placed(nothing, once, False, 0)
        return RobotPath.still(float(poses.x[0]), float(poses.y[0])) if valid[0] else None

    def _poses_of(self, writers: Writers) -> Poses:
        if writers not in self._poses:
            self._poses[writers] = self.robot.poses(writers)
        return self._poses[writers]

    def _path(self, writers: Writers, low: int, high: int) -> RobotPath:
        return RobotPath.of(self._poses_of(writers).tracks(low, high), self.robot.frame)

    def of(self, t: int) -> PathWindow:
        """Return the window that contains a time, ns."""
        if self.still is not None:
            return PathWindow(self.still, complete=True)
        number = t // TRACK_WINDOW_NS
        entry = self._cache.get(number)
        if entry is not None:
            until, window = entry
            if until > time.monotonic():
                self._cache.move_to_end(number)
                return window
            for poses in self._poses.values():  # poses may have come since it was read
                poses.forget()
        window = self._read(number)
        until = math.inf if window.complete else time.monotonic() + OPEN_WINDOW_CACHE_SEC
        self._cache[number] = (until, window)
        self._cache.move_to_end(number)
        while len(self._cache) > MAX_CACHED_WINDOWS:
            self._cache.popitem(last=False)
        return window

    def _read(self, number: int) -> PathWindow:
        """Read the window with a number, and poses around it that connect to those inside."""
        low = number * TRACK_WINDOW_NS - LONGEST_GAP_NS
        high = (number + 1) * TRACK_WINDOW_NS - 1 + LONGEST_GAP_NS
        path = self._path(None, low, high)
        if not len(path):
            return PathWindow(path)
        robot = self.robot
        extents = self._stored.extents(robot.topic, robot.node, low, high)
        # Several runs may have the same value of RUN: then their poses are used together.
        by_text: dict[str, set[int]] = {}
        for writer in {extent.writer for pair in overlapping_pairs(extents) for extent in pair}:
            by_text.setdefault(self._stored.run_text(writer), set()).add(writer)
        by_run = {
            text: self._path(frozenset(writers), low, high) for text, writers in by_text.items()
        }
        return PathWindow(path, by_run, int(path.times[-1]) > high - LONGEST_GAP_NS)


def overlapping_pairs(extents: Sequence[Extent]) -> Iterator[tuple[Extent, Extent]]:
    """Yield pairs of time ranges of two runs that overlap, sorted by their start.

    Not all pairs: each time range with the one before it that reaches farthest.
    """
    longest: Extent | None = None
    for extent in sorted(extents, key=lambda e: (e.low, e.high)):
        if longest is not None and extent.low <= longest.high and extent.writer != longest.writer:
            yield longest, extent
        if longest is None or extent.high > longest.high:
            longest = extent
