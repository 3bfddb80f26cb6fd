# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times at which robots were in a region, for NEAR and for the lasso on the map.

The index of cells (see run_index.py) gives candidate times as far as it covers the recording; all
other times are candidates too. For the candidates the recorded poses are read and decide.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import Callable, Iterable, Iterator, Mapping, Sequence

from cassandra_ros.keys import MAX_NS
from cassandra_ros.places.array_source import Extent, StoredTopics, find_stored
from cassandra_ros.places.earth import EarthDisk
from cassandra_ros.places.ground_cells import JOIN_NS, LONGEST_NS, GroundCell, cells_of
from cassandra_ros.places.paths import (
    LONGEST_GAP_NS,
    clip_ranges,
    subtract_ranges,
    window_numbers,
)
from cassandra_ros.places.pose_topic import tells_fixes
from cassandra_ros.places.regions import DiskRegion, Region
from cassandra_ros.places.robots import MAX_FRAMES, Robot, RobotFinder, is_fixed_to
from cassandra_ros.places.track_windows import (
    TRACK_WINDOW_NS,
    PathWindow,
    Windows,
    overlapping_pairs,
)
from cassandra_ros.query.plan.bounds import NsRange, has_overlap, merge_ranges
from cassandra_ros.query.protocols import WGS84, Disk
from cassandra_ros.read import Writers
from cassandra_ros.store.tables.place_index import IndexedPoses, PlaceIndex, Square

_EARLIER_NS = LONGEST_NS + JOIN_NS
"""How long before a time a visit that lasts until then may have begun, ns."""


class RegionStays:
    """Times at which the robots of some nodes were in a region; see query.protocols.Stays.

    Thread-safe.

    Args:
        region: The region.
        windows: Paths of the robots, by nodeID.
        coverage: Finds the candidate times.
    """

    def __init__(self, region: Region, windows: Mapping[str, Windows], coverage: Coverage) -> None:
        self._region, self._windows, self._coverage = region, windows, coverage
        self._latest: dict[str, tuple[int, PathWindow]] = {}
        """nodeID → number of the window in which a message was tested last, and the window."""
        self._mutex = threading.Lock()

    @property
    def nodes(self) -> list[str]:
        """Robots with poses: their nodeIDs, sorted."""
        return sorted(self._windows)

    def holds(self, node: str, run: str, t: int) -> bool | None:
        """Return whether the robot of a message was in the region; None if unknown."""
        number = t // TRACK_WINDOW_NS
        latest = self._latest.get(node)
        if latest is None or latest[0] != number or not latest[1].complete:
            windows = self._windows.get(node)
            if windows is None:
                return None
            latest = self._latest[node] = number, self._window(windows, t)
        place = latest[1].at(run, t)
        return None if place is None else self._region.holds(*place)

    def _window(self, windows: Windows, t: int) -> PathWindow:
        """Return the window that contains a time; one thread reads windows at a time."""
        with self._mutex:
            return windows.of(t)

    def spans(
        self,
        low: int,
        high: int,
        reverse: bool = False,
        node: str | None = None,
        watch: Callable[[], None] = lambda: None,
    ) -> Iterator[NsRange]:
        """Yield time ranges in [low, high], ns, that contain all stays; see query.protocols.Stays.

        Args:
            node: nodeID of the only robot to check; None = all robots together.
            watch: Called repeatedly while poses are read, even if there are no stays; may raise.
        """
        windows = [w for name, w in self._windows.items() if node in (None, name)]
        low, high = max(0, low), min(high, MAX_NS)
        if any(list(w.still.stays(self._region)) for w in windows if w.still is not None):
            return iter([(low, high)])
        moving = [w for w in windows if w.still is None]
        return merge_ranges(self._find_stays(moving, low, high, reverse, watch))

    def _find_stays(
        self,
        moving: Sequence[Windows],
        low: int,
        high: int,
        reverse: bool,
        watch: Callable[[], None],
    ) -> Iterator[NsRange]:
        """Yield the stays of robots that move, window by window, for ``spans``."""
        candidates = [self._coverage.candidates(w.robot, self._region, low, high) for w in moving]
        ranges = merge_ranges(sorted(span for spans in candidates for span in spans))
        for number in window_numbers(list(ranges), TRACK_WINDOW_NS, reverse):
            watch()
            start, end = number * TRACK_WINDOW_NS, (number + 1) * TRACK_WINDOW_NS - 1
            stays: list[NsRange] = []
            for windows, spans in zip(moving, candidates):
                if has_overlap(spans, start, end):
                    for path in self._window(windows, start).paths:
                        stays += path.stays(self._region)
            inside = list(clip_ranges(merge_ranges(sorted(stays)), max(low, start), min(high, end)))
            yield from reversed(inside) if reverse else inside


class Whereabouts:
    """The poses of the robots of one keyspace; see query.protocols.Places. Thread-safe."""

    def __init__(self, stored: StoredTopics, index: PlaceIndex) -> None:
        self._stored = stored
        self._coverage = Coverage(stored, index)
        self._local = threading.local()
        """Its ``answers`` are those of ``stays``; a thread has them only inside ``shared``."""

    @contextmanager
    def shared(self) -> Iterator[None]:
        """Cache the answers of ``stays`` for this thread, so that poses are read once.

        Inside another ``shared`` of the thread it uses the cache of that one.
        """
        if hasattr(self._local, "answers"):
            yield
            return
        self._local.answers = {}
        try:
            yield
        finally:
            del self._local.answers

    def stays(self, disk: Disk, node: str | None = None, writers: Writers = None) -> RegionStays:
        """Return when robots were on a disk; of one node, by the poses of some runs; None = all.

        Raises:
            InvalidOption: There are no poses in the frame, or several robots may be meant.
        """
        answers: dict[tuple[Disk, str | None, Writers], RegionStays]
        answers = getattr(self._local, "answers", {})
        key = disk, node, writers
        if key not in answers:
            region = region_of(disk)
            nodes = None if node is None else [node]
            answers[key] = self.within(region, disk.frame, disk.robot, nodes, writers)
        return answers[key]

    def within(
        self,
        region: Region,
        frame: str,
        robot: str = "",
        nodes: Sequence[str] | None = None,
        writers: Writers = None,
    ) -> RegionStays:
        """Return when robots were in a region; frame, robot and errors as in ``stays``.

        Args:
            region: The region.
            frame, robot: As in a Disk.
            nodes: nodeIDs; None = all nodes.
            writers: Writer ids of the runs. If they recorded poses of a node, only these are used;
                None = all runs.
        """
        robots = self.robots(frame, robot, nodes, writers)
        windows = {source.node: Windows(source, self._stored) for source in robots}
        return RegionStays(region, windows, self._coverage)

    def robots(
        self,
        frame: str,
        robot: str = "",
        nodes: Sequence[str] | None = None,
        writers: Writers = None,
    ) -> list[Robot]:
        """Return the sources of robots' poses; arguments and errors as in ``within``."""
        return RobotFinder(self._stored, frame, robot, writers).robots(nodes)

    def usual_frame(self, robot: str = "") -> str:
        """Return the most usual frame for places: map or odom, else one that exists.

        Of a robot's topic of latitude and longitude it is WGS84.
        """
        topic = find_stored(self._stored.find, robot) if robot else None
        if topic is not None and tells_fixes(topic):
            return WGS84
        return RobotFinder(self._stored, "").usual_frame()

    def extents(self, robot: Robot, low: int, high: int) -> Sequence[Extent]:
        """Return the time ranges of a robot's recorded poses, by run, that touch [low, high]."""
        extents = self._stored.extents(robot.topic, robot.node, low, high)
        return [e for e in extents if robot.writers is None or e.writer in robot.writers]


def region_of(disk: Disk) -> Region:
    """Return the region of a disk: on the Earth, or on the ground."""
    if disk.frame == WGS84:
        return EarthDisk(disk.x, disk.y, disk.radius)
    return DiskRegion(disk.x, disk.y, disk.radius)


class Coverage:
    """Finds the times at which robots of a keyspace may have been in a region."""

    def __init__(self, stored: StoredTopics, index: PlaceIndex) -> None:
        self._stored = stored
        self._index = index

    def candidates(self, robot: Robot, region: Region, low: int, high: int) -> list[NsRange]:
        """Return the time ranges in [low, high], ns, with possible stays, sorted and disjoint."""
        extents = self._stored.extents(
            robot.topic, robot.node, low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
        )
        if not extents:
            return []
        cells = cells_of(region.boxes)
        records = [] if cells is None else self._valid_records(robot)
        ranges = list(uncovered_ranges(extents, records))
        if cells is not None and any(robot.frame in record.above for record in records):
            ranges += self._visits(robot, cells, low, high)
        return list(clip_ranges(merge_ranges(sorted(ranges)), low, high))

    def _valid_records(self, robot: Robot) -> list[IndexedPoses]:
        """Return the index records of a robot that are still valid."""
        tables = [table.name for table in robot.topic.tables]
        records = [
            record
            for record in self._index.placed(tables)
            if record.node == robot.node and record.robot in robot.keys
        ]
        fixed = robot.fixed() if records else {}
        return [record for record in records if is_valid(record, robot, fixed)]

    def _visits(
        self, robot: Robot, cells: Sequence[GroundCell], low: int, high: int
    ) -> Iterable[NsRange]:
        """Return the visits of a robot to some cells that may reach into [low, high], ns."""
        squares = [Square(robot.frame, key, *cell) for key in robot.keys for cell in cells]
        return self._index.visits(squares, robot.node, max(0, low) - _EARLIER_NS, high)


def is_valid(record: IndexedPoses, robot: Robot, fixed: Mapping[str, str]) -> bool:
    """Return whether an index record is still valid for a robot.

    It is if the visits in the robot's frame are in the index, or if it has none because the
    frame did not exist; and if the frames above the robot are fixed as when it was made.

    Args:
        fixed: Parent and pose of each fixed frame now, see ``fixed_text``. The record has these
            texts as they were stored, so they are compared as texts.
    """
    if not robot.name:
        return robot.frame in record.above
    if any(fixed.get(frame, "") != text for frame, text in record.above.items()):
        return False
    # A frame that did not exist has no visits, unless it was fixed to another frame since.
    absent = robot.frame not in record.frames and robot.frame not in fixed
    absent = absent and len(record.frames) < MAX_FRAMES
    return robot.frame in record.above or (
        absent and not any(is_fixed_to(text, robot.frame) for text in fixed.values())
    )


def uncovered_ranges(extents: Sequence[Extent], index: Sequence[IndexedPoses]) -> Iterator[NsRange]:
    """Yield the time ranges that the index does not fully cover, in no order.

    These are the times of poses without an index record, those around the ends of records, and
    those at which several runs recorded: then each message is judged by the poses of its own run.
    """
    indexed: dict[tuple[str, int], list[NsRange]] = {}
    for record in index:
        indexed.setdefault((record.table, record.writer), []).append((record.low, record.high))
    for extent in extents:
        ranges = list(merge_ranges(sorted(indexed.get((extent.table, extent.writer), ()))))
        for low, high in subtract_ranges([(extent.low, extent.high)], ranges):
            yield low - LONGEST_GAP_NS, high + LONGEST_GAP_NS
    for one, other in overlapping_pairs(extents):
        yield other.low - LONGEST_GAP_NS, min(one.high, other.high) + LONGEST_GAP_NS
    # The robot may have moved between the last pose of one run and the first pose of the next.
    runs = {(extent.table, extent.writer) for extent in extents}
    last: int | None = None
    for low, high in sorted((r.low, r.high) for r in index if (r.table, r.writer) in runs):
        if last is not None and last < low <= last + LONGEST_GAP_NS:
            yield last, low
        last = high if last is None else max(last, high)
