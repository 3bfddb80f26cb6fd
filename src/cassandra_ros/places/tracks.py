# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where robots were, for pictures: of each a line of so many points.

Of a short time all poses are read, and points left out that lie close to the line. Of a long time
poses are read around moments that are spread over it; between two of them nobody looked.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.paths import LONGEST_GAP_NS, LONGEST_WAY_M, Path, merged
from cassandra_ros.places.pose_samples import Times
from cassandra_ros.places.robots import Robot
from cassandra_ros.places.whereabouts import Whereabouts
from cassandra_ros.query.source import Writers

WHOLE_NS = 7200 * SECOND_NS
"""Up to so much time with poses is read whole."""
_LOOKS = 400
"""So many moments are looked at of more."""
_LOOK_NS = SECOND_NS

Points = Union[List[str], List[float], List[bool], str]


@dataclass(frozen=True)
class RobotTrack:
    """Where one robot was."""

    node: str
    frame: str
    path: Path
    joined: Sequence[bool]
    """For each point whether the way from the one before is known."""

    def told(self) -> Dict[str, Points]:
        """Return it as JSON has it: times are ns, as texts."""
        path = self.path
        return {
            "node": self.node,
            "frame": self.frame,
            "times": [str(t) for t in path.times.tolist()],
            "x": path.x.tolist(),
            "y": path.y.tolist(),
            "joined": list(self.joined),
        }


def find_tracks(
    places: Whereabouts,
    asked: Tuple[str, str],
    nodes: Optional[Sequence[str]],
    writers: Writers,
    window: Tuple[int, int, int],
    watch: Callable[[], None],
) -> List[RobotTrack]:
    """Return the tracks of the robots that have one.

    Args:
        asked: Frame and robot, as a Disk has them.
        nodes: Of which nodes; None = all.
        writers: Of a node of which these runs recorded poses only these count; None = all.
        window: First and last time, ns, and most points of a track.
        watch: Called now and then; may raise.
    """
    low, high, most = window
    found = []
    for robot in places.robots(*asked, nodes, writers):
        extents = places.extents(robot, low, high)
        spans = list(merged(sorted((max(low, e[2]), min(high, e[3])) for e in extents)))
        path = _path(robot, spans, watch)
        if len(path):
            found.append(RobotTrack(robot.node, robot.frame, *thinned(path, most)))
    return found


def _path(robot: Robot, spans: Sequence[Tuple[int, int]], watch: Callable[[], None]) -> Path:
    poses, tracks = robot.poses(), []
    total = sum(end - start + 1 for start, end in spans)
    for start, end in spans if total <= WHOLE_NS else _looks(spans, total):
        for track in poses.tracks(start, end):
            watch()
            tracks.append(track)
            if total > WHOLE_NS:
                break
    path = Path.of(tracks)
    if total <= WHOLE_NS or not len(path):
        return path
    # Between two looks the robot went somehow: the line is drawn, where no run ended between.
    step = total // _LOOKS
    return Path(path.times, path.x, path.y, max(2 * step, LONGEST_GAP_NS))


def _looks(spans: Sequence[Tuple[int, int]], total: int) -> Iterator[Tuple[int, int]]:
    """Yield stretches of a second, evenly spread over others."""
    step = max(1, total // _LOOKS)
    for start, end in spans:
        for at in itertools.chain(range(start, end, step), [max(start, end - _LOOK_NS)]):
            yield at, min(end, at + _LOOK_NS)


def thinned(path: Path, most: int) -> Tuple[Path, List[bool]]:
    """Leave out points of a path until it has at most so many: those that change it least.

    Ends of known ways stay, where there are not too many of them.

    Returns:
        The path, and for each point whether the way from the one before is known.
    """
    count = len(path)
    far = np.maximum(np.abs(np.diff(path.x)), np.abs(np.diff(path.y))) > LONGEST_WAY_M
    breaks = (np.diff(path.times) > path.gap) | far
    before = np.concatenate([[0], np.cumsum(breaks)])
    chosen = np.arange(count) if count <= most else _chosen(path, most, np.flatnonzero(breaks))
    kept = Path(path.times[chosen], path.x[chosen], path.y[chosen], path.gap)
    return kept, [False, *(np.diff(before[chosen]) == 0).tolist()][: len(kept)]


def _chosen(path: Path, most: int, broken: Times) -> Times:
    """Return the numbers of the points that stay."""
    count = len(path)
    ends = np.unique(np.concatenate([[0, count - 1], broken, broken + 1]))
    if len(ends) > most:
        few: Times = ends[np.linspace(0, len(ends) - 1, most).astype(np.int64)]
        return few
    # By the way that was gone: while a robot stands there is nothing to be seen.
    gone = np.concatenate([[0], np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y)))])
    gone = gone + np.linspace(0, 1e-6, count)
    wanted = np.linspace(0, gone[-1], max(0, most - len(ends)))
    chosen: Times = np.unique(np.concatenate([ends, np.searchsorted(gone, wanted)]))
    return chosen[chosen < count]
