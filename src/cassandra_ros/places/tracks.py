# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tracks of robots for pictures: for each robot a line with a limited number of points.

For a short time range all poses are read, and points close to the line are left out. For a long
time range poses are read around moments that are evenly spaced over it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Callable, Iterator, List, Sequence, Union

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.earth import UNITS_PER_DEGREE
from cassandra_ros.places.paths import LONGEST_GAP_NS, LONGEST_WAY_M, RobotPath
from cassandra_ros.places.pose_samples import Times
from cassandra_ros.places.robots import Robot
from cassandra_ros.places.whereabouts import Whereabouts
from cassandra_ros.query.plan.bounds import merge_ranges
from cassandra_ros.query.protocols import WGS84
from cassandra_ros.read import Writers

WHOLE_NS = 7200 * SECOND_NS
"""Maximum length of a time range with poses that is read completely, ns."""
_SAMPLES = 400
"""Number of moments in a longer time range around which poses are read."""
_SAMPLE_NS = SECOND_NS

JsonValues = Union[List[str], List[float], List[bool], str]


@dataclass(frozen=True)
class RobotTrack:
    """The track of one robot."""

    node: str
    frame: str
    path: RobotPath
    joined: Sequence[bool]
    """For each point, whether the line from the previous point is known."""

    def told(self) -> dict[str, JsonValues]:
        """Return the track for JSON: times are ns, as texts; on the Earth x and y are degrees."""
        path, unit = self.path, UNITS_PER_DEGREE if self.frame == WGS84 else 1.0
        return {
            "node": self.node,
            "frame": self.frame,
            "times": [str(t) for t in path.times.tolist()],
            "x": (path.x / unit).tolist(),
            "y": (path.y / unit).tolist(),
            "joined": list(self.joined),
        }


def find_tracks(
    places: Whereabouts,
    frame_and_robot: tuple[str, str],
    nodes: Sequence[str] | None,
    writers: Writers,
    window: tuple[int, int, int],
    watch: Callable[[], None],
) -> list[RobotTrack]:
    """Return the tracks of all robots that have poses.

    Args:
        frame_and_robot: Frame and robot, as in a Disk.
        nodes: nodeIDs; None = all nodes.
        writers: Writer ids of the runs. If they recorded poses of a node, only these are used;
            None = all runs.
        window: First and last time, ns, and maximum number of points of a track.
        watch: Called repeatedly while poses are read; may raise.
    """
    low, high, most = window
    tracks = []
    for robot in places.robots(*frame_and_robot, nodes, writers):
        extents = places.extents(robot, low, high)
        spans = list(merge_ranges(sorted((max(low, e.low), min(high, e.high)) for e in extents)))
        path = _path(robot, spans, watch)
        if len(path):
            tracks.append(RobotTrack(robot.node, robot.frame, *reduce_points(path, most)))
    return tracks


def _path(robot: Robot, spans: Sequence[tuple[int, int]], watch: Callable[[], None]) -> RobotPath:
    """Return the path of a robot in some time ranges, ns: whole, or by samples if they are long."""
    poses, tracks = robot.poses(), []
    total = sum(end - start + 1 for start, end in spans)
    for start, end in spans if total <= WHOLE_NS else _sample_ranges(spans, total):
        for track in poses.tracks(start, end):
            watch()
            tracks.append(track)
            if total > WHOLE_NS:  # one track is enough for a moment
                break
    path = RobotPath.of(tracks, robot.frame)
    if total <= WHOLE_NS or not len(path):
        return path
    # The lines between two moments are drawn as known, unless a run ended in between.
    step = total // _SAMPLES
    return RobotPath(path.times, path.x, path.y, max(2 * step, LONGEST_GAP_NS))


def _sample_ranges(spans: Sequence[tuple[int, int]], total: int) -> Iterator[tuple[int, int]]:
    """Yield time ranges of one second, evenly spaced over the given ones."""
    step = max(1, total // _SAMPLES)
    for start, end in spans:
        for at in itertools.chain(range(start, end, step), [max(start, end - _SAMPLE_NS)]):
            yield at, min(end, at + _SAMPLE_NS)


def reduce_points(path: RobotPath, most: int) -> tuple[RobotPath, list[bool]]:
    """Reduce the points of a path to at most ``most``, leaving out those that change it least.

    The ends of known parts stay, unless there are too many of them.

    Returns:
        The path, and for each point whether the line from the previous point is known.
    """
    count = len(path)
    far = np.maximum(np.abs(np.diff(path.x)), np.abs(np.diff(path.y))) > LONGEST_WAY_M
    breaks = (np.diff(path.times) > path.gap) | far
    before = np.concatenate([[0], np.cumsum(breaks)])
    indices = (
        np.arange(count) if count <= most else _chosen_indices(path, most, np.flatnonzero(breaks))
    )
    points = RobotPath(path.times[indices], path.x[indices], path.y[indices], path.gap)
    return points, [False, *(np.diff(before[indices]) == 0).tolist()][: len(points)]


def _chosen_indices(path: RobotPath, most: int, broken: Times) -> Times:
    """Return the indices of the points that stay.

    Args:
        broken: Indices of the points from which the line to the next one is not known.
    """
    count = len(path)
    ends = np.unique(np.concatenate([[0, count - 1], broken, broken + 1]))
    if len(ends) > most:
        few: Times = ends[np.linspace(0, len(ends) - 1, most).astype(np.int64)]
        return few
    # Points are spaced by distance, because a standing robot adds nothing to the picture.
    distance = np.concatenate([[0], np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y)))])
    distance = distance + np.linspace(0, 1e-6, count)
    steps = np.linspace(0, distance[-1], max(0, most - len(ends)))
    indices: Times = np.unique(np.concatenate([ends, np.searchsorted(distance, steps)]))
    return indices[indices < count]
