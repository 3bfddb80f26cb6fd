# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index of places: the coarse cells that robots visited, written run by run.

A recorder writes it while it records, from the poses that it stores; for other runs it is made
later, from the stored poses. Both use the same code: along each robot's path, in each frame above
the robot, every touched cell is recorded with its time. Poses of several runs at the same time are
not combined here; the query does that.
"""

from __future__ import annotations

from collections import OrderedDict
from functools import partial
from typing import Callable, Iterator, NamedTuple, Sequence

from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.places.array_source import (
    ArraySource,
    Extent,
    StoredTopics,
    TopicFinder,
    find_stored,
)
from cassandra_ros.places.frame_poses import TF, FrameChain, TfRecording
from cassandra_ros.places.ground_cells import OpenVisits
from cassandra_ros.places.paths import LONGEST_GAP_NS, RobotPath, window_numbers
from cassandra_ros.places.pose_samples import Samples
from cassandra_ros.places.pose_topic import PoseTopic, tells_fixes, tells_poses
from cassandra_ros.places.poses import MAX_SPAN_NS, Poses
from cassandra_ros.places.robots import MAX_FRAMES, fixed_frames, frames_above, frames_in
from cassandra_ros.query.plan.bounds import merge_ranges
from cassandra_ros.query.protocols import WGS84
from cassandra_ros.store.tables.place_index import IndexedPoses, PlaceIndex, Square, VisitRow

MAX_FRAMES_ABOVE = 16
"""Maximum number of frames above a robot in which its places are indexed."""
_WINDOW_SEC = MAX_SPAN_NS // SECOND_NS
_MAX_CACHED = 4
"""Maximum number of cached time ranges of transforms, shared by all robots and frames."""


class RobotRun(NamedTuple):
    """The run whose poses are indexed."""

    node: str
    writer: int


class _CachedRecording(TfRecording):
    """Transforms with a cache, because several chains read the same time ranges."""

    def __init__(self, find: TopicFinder, node: str) -> None:
        super().__init__(find, node)
        self._read: OrderedDict[tuple[int, int], Samples] = OrderedDict()

    def read(self, low: int, high: int) -> Samples:
        """Return the moving transforms with a row key in [low, high], ns."""
        if (low, high) not in self._read:
            self._read[low, high] = super().read(low, high)
            if len(self._read) > _MAX_CACHED:
                self._read.popitem(last=False)
        return self._read[low, high]


class _RobotVisits:
    """The visits of one robot in one frame, computed part by part."""

    def __init__(self, poses: Poses, frame: str, robot: str) -> None:
        self._poses = poses
        self._frame, self._robot = frame, robot
        self._open = OpenVisits()

    def visits(self, whose: RobotRun, low: int, high: int) -> Iterator[VisitRow]:
        """Yield the visits of the time range [low, high], ns, and of the path into it."""
        path = RobotPath.of(self._poses.tracks(low - LONGEST_GAP_NS, high), self._frame)
        for visit in self._open.visits(path):
            square = Square(self._frame, self._robot, *visit.cell)
            yield VisitRow(square, whose.node, visit.low, whose.writer, visit.high)


class TfVisits:
    """Index of the robots in tf, for one run.

    Args:
        find: Returns a topic by its name; TopicNotFound if neither tf topic is stored.
        whose: The run.
    """

    def __init__(self, find: TopicFinder, whose: RobotRun) -> None:
        self._whose = whose
        self._frames = _CachedRecording(find, whose.node)
        self._robot_visits: dict[tuple[str, str], _RobotVisits] = {}
        """Frames of a robot and of its places → its visits."""
        self._since: dict[str, int] = {}
        """Row key from which a robot is indexed, ns, by frame."""
        self._seen: set[str] = set()
        """Names of the frames that were met, at most MAX_FRAMES."""
        self._has_begun = False

    def visits(self, low: int, high: int) -> Iterator[VisitRow]:
        """Yield the visits of row keys [low, high], ns, which must follow the previous range."""
        samples = self._frames.read(low, high)
        tf = frames_in(self._frames, [samples])
        self._seen.update(sorted(tf.frames)[: max(0, MAX_FRAMES - len(self._seen))])
        for robot in tf.robots:
            self._since.setdefault(robot, low if self._has_begun else 0)
        self._has_begun = True
        for robot in sorted(self._since):
            for frame in frames_above(self._frames, samples, robot)[:MAX_FRAMES_ABOVE]:
                if frame != robot:
                    if (robot, frame) not in self._robot_visits:
                        poses = Poses(FrameChain(self._frames, robot, frame))
                        self._robot_visits[robot, frame] = _RobotVisits(poses, frame, robot)
                    yield from self._robot_visits[robot, frame].visits(self._whose, low, high)

    def placed(self, table: str, low: int, high: int) -> list[IndexedPoses]:
        """Return the index records of the row keys [low, high], ns, in a table, one of each robot.

        The visits of these keys must have been yielded.
        """
        fixed = fixed_frames(self._frames)
        return [
            IndexedPoses(
                table,
                *self._whose,
                robot,
                max(low, since),
                high,
                frozenset(self._seen),
                {name: fixed.get(name, "") for name in self._above(robot)},
            )
            for robot, since in sorted(self._since.items())
        ]

    def _above(self, robot: str) -> list[str]:
        """Return the frame of a robot, and the frames in which its places are indexed."""
        return [robot, *(frame for name, frame in self._robot_visits if name == robot)]


class TopicVisits:
    """Index of the robot of a topic of poses, or of positions on the Earth, for one run.

    Args:
        find: Returns a topic by its name.
        topic: Name of the topic; TopicNotFound if it is not stored, TypeMismatch if it tells none.
        whose: The run.
    """

    def __init__(self, find: TopicFinder, topic: str, whose: RobotRun) -> None:
        self._whose = whose
        frame = WGS84 if tells_fixes(find(topic)) else None
        source = PoseTopic(find, topic, whose.node, frame=frame)
        self._frame = source.frame
        self._poses = Poses(source)
        self._robot_visits: dict[str, _RobotVisits] = {}
        """Table of the poses, by which the index names the robot → its visits."""

    def visits(self, table: str, low: int, high: int) -> Iterator[VisitRow]:
        """Yield the visits of row keys [low, high], ns, which must follow the previous range."""
        if table not in self._robot_visits:
            self._robot_visits[table] = _RobotVisits(self._poses, self._frame, table)
        yield from self._robot_visits[table].visits(self._whose, low, high)

    def placed(self, table: str, low: int, high: int) -> list[IndexedPoses]:
        """Return the index records of the row keys [low, high], ns, in a table."""
        frames = frozenset([self._frame])
        return [IndexedPoses(table, *self._whose, table, low, high, frames, {self._frame: ""})]


class IndexResult(NamedTuple):
    """The result of indexing a run."""

    poses_from: int
    poses_to: int
    """First and last row key of its poses, ns."""
    visits: int
    """Number of visits of cells."""


class RunIndex:
    """Makes the index of one ended run from the stored poses.

    Args:
        stored: The keyspace.
        index: The index table.
        whose: The run.
        ttl: Time to live of the index rows, s; 0 = without limit.
    """

    def __init__(
        self, stored: StoredTopics, index: PlaceIndex, whose: RobotRun, ttl: int = 0
    ) -> None:
        self._stored, self._index, self._whose, self._ttl = stored, index, whose, ttl

    def make(self, progress: Callable[[int, int], None] | None = None) -> IndexResult | None:
        """Index all poses of the run; return None if it has no poses. Can be repeated.

        The records, which say that visits are complete, are withdrawn first, and written again
        after the visits.

        Args:
            progress: Called with the seconds that are done, and the seconds in all.
        """
        all_poses = [poses for poses in self._poses_of_topics() if poses.extents]
        if not all_poses:
            return None
        extents = [extent for poses in all_poses for extent in poses.extents]
        total = sum(len(list(_windows(poses.extents))) for poses in all_poses)
        windows = visits = 0
        for table in {extent.table for extent in extents}:
            self._index.withdraw(table, run=self._whose)
        for poses in all_poses:
            for low, high in _windows(poses.extents):
                visits_of_window = list(poses.visits(low, high))
                self._index.put(visits_of_window, [], self._ttl)
                windows, visits = windows + 1, visits + len(visits_of_window)
                if progress is not None:
                    progress(windows * _WINDOW_SEC, total * _WINDOW_SEC)
            self._index.put([], poses.placed(), self._ttl)
        return IndexResult(min(e.low for e in extents), max(e.high for e in extents), visits)

    def _poses_of_topics(self) -> Iterator[_TopicPoses]:
        """Yield the run's poses of tf, and of each table of each topic of poses."""
        whose = self._whose
        tf = find_stored(self._stored.find, TF)
        if tf is not None:
            tf_visits = TfVisits(self._stored.find, whose)
            yield _TopicPoses(self._extents(tf), tf_visits.visits, tf_visits.placed)
        for topic in self._stored.topics():
            if tells_poses(topic) or tells_fixes(topic):
                extents = self._extents(topic)
                if extents:
                    visits = TopicVisits(self._stored.find, topic.name, whose)
                    for table in sorted({extent.table for extent in extents}):
                        table_extents = [extent for extent in extents if extent.table == table]
                        yield _TopicPoses(
                            table_extents, partial(visits.visits, table), visits.placed
                        )

    def _extents(self, topic: ArraySource) -> list[Extent]:
        """Return the time ranges of the run's messages of a topic."""
        node, writer = self._whose
        extents = self._stored.extents(topic, node, 0, MAX_NS)
        return [extent for extent in extents if extent.writer == writer]


class _TopicPoses(NamedTuple):
    """The poses of one topic, or of one of its tables."""

    extents: Sequence[Extent]
    visits: Callable[[int, int], Iterator[VisitRow]]
    """Yields the visits of a range of row keys."""
    records_of: Callable[[str, int, int], list[IndexedPoses]]
    """Returns the index records of a range of row keys in a table."""

    def placed(self) -> Iterator[IndexedPoses]:
        """Yield the index records of the poses, by table."""
        for table in sorted({extent.table for extent in self.extents}):
            extents = [extent for extent in self.extents if extent.table == table]
            low, high = min(e.low for e in extents), max(e.high for e in extents)
            yield from self.records_of(table, low, high)


def _windows(extents: Sequence[Extent]) -> Iterator[tuple[int, int]]:
    """Yield the windows of MAX_SPAN_NS that the ranges touch, each once."""
    ranges = list(merge_ranges(sorted((extent.low, extent.high) for extent in extents)))
    for number in window_numbers(ranges, MAX_SPAN_NS):
        start = number * MAX_SPAN_NS
        yield start, start + MAX_SPAN_NS - 1
