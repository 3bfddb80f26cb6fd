# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Make an occupancy grid of the scans or clouds of a stored topic (paper figure 4)."""

from __future__ import annotations

import heapq
import logging
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

import numpy as np

from cassandra_ros.arguments import check_node
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import (
    CorruptMessage,
    InvalidOption,
    MessageNotFound,
    TransformException,
    TypeMismatch,
)
from cassandra_ros.mapping.beams import SENSORS, Sensor
from cassandra_ros.mapping.grid import LogOddsGrid
from cassandra_ros.mapping.occupancy import OCCUPANCY_GRID, OccupancyMap
from cassandra_ros.mapping.pose_offers import Measurements, PoseOffer, united_offers
from cassandra_ros.mapping.sensor_poses import PoseChoice, SensorPoses
from cassandra_ros.messages.stamps import Stamp, Time, to_ns
from cassandra_ros.places.poses import Poses
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_finder import RunName, Writers
from cassandra_ros.topics.stored_row import StoredRow

_log = logging.getLogger(__name__)

DEFAULT_RESOLUTION = 0.05
"""Metres."""
_BATCH_ROWS = 256
_BATCH_BYTES = 16 << 20
"""Of messages whose poses are found together."""

Progress = Callable[[int, int], None]
"""Is told how many messages are done, of how many; what it raises ends the work."""


@dataclass(frozen=True)
class MapOptions:
    """What of the beams comes into a map."""

    resolution: float = DEFAULT_RESOLUTION
    """Length of a cell, metres."""
    max_range: Optional[float] = None
    """Metres; what a sensor saw further away is not taken. None = of scans their own range_max, of
    clouds 30."""
    min_height: Optional[float] = None
    """Metres in the map's frame: what is below is floor, over which one can go. None = of scans
    everything is an obstacle, of clouds from 0.1."""
    max_height: Optional[float] = None
    """Metres; what is above is left out. None = of scans nothing, of clouds from 2."""
    hit: float = 0.7
    """Probability of something where a beam ended."""
    miss: float = 0.4
    """Probability of something where a beam went through."""
    most: Optional[int] = None
    """So many messages at most, evenly spread over all; None = each."""

    def __post_init__(self) -> None:
        if self.max_range is not None and not self.max_range > 0:
            raise InvalidOption(f"max_range={self.max_range!r}: give metres above 0")
        low, high = self.min_height, self.max_height
        if low is not None and high is not None and not low < high:
            raise InvalidOption(f"min_height={low!r} does not lie below max_height={high!r}")
        if self.most is not None and self.most < 1:
            raise InvalidOption(f"most={self.most!r}: give at least one message")

    def heights(self, sensor: Sensor) -> Tuple[float, float]:
        """Return between which heights something is an obstacle."""
        low, high = sensor.heights
        return (
            low if self.min_height is None else self.min_height,
            high if self.max_height is None else self.max_height,
        )


@dataclass
class MadeMap:
    """A map, and what it was made of."""

    map: OccupancyMap
    used: int
    """Messages that are in it."""
    without_pose: int
    """Messages of which nobody knows where the sensor was."""
    unreadable: int
    received: int
    """Messages whose pose is that at their reception, for none was recorded at their stamps."""
    sources: Sequence[str] = ()
    """From what poses were taken, for people."""
    offers: Sequence[PoseOffer] = ()
    """The topics that tell the robots' poses, the best one first: ``PoseChoice(odom=…)`` takes
    another one. Empty where tf told the poses."""


_ALL = MapOptions()
_BEST = PoseChoice()


def makeMap(
    rosCas: RosCassandra,
    topic: str,
    key: Optional[Time] = None,
    to_key: Optional[Time] = None,
    *,
    nodeID: Union[None, str, Sequence[str]] = None,
    run: RunName = None,
    name: Optional[str] = None,
    options: MapOptions = _ALL,
    poses: PoseChoice = _BEST,
    progress: Optional[Progress] = None,
) -> MadeMap:
    """Make an occupancy grid of stored sensor_msgs/LaserScan or PointCloud2.

    Poses are those of recorded tf, each robot's own (by nodeID), or of a topic of Odometry,
    PoseStamped or PoseWithCovarianceStamped: of several topics the one whose poses cover most of
    the messages. They are interpolated at the stamps of the headers,
    and where nothing was recorded that has such stamps, at the times of reception. Of a topic of
    nav_msgs/OccupancyGrid the newest map is returned as it was stored.

    Args:
        rosCas: Connected to the keyspace.
        topic: Its name.
        key, to_key: Ends, both included; None = open.
        nodeID: Only messages of this robot, or of several; None = of all. Each by its own poses.
        run: Only what this run recorded, of poses too.
        name: Of a topic of maps that are kept under names the one that is meant; None = any.
        options, poses: What comes in, and where the sensor was.
        progress: Is told how far it is.

    Raises:
        TopicNotFound, RunNotFound: The topic, or what is to tell poses, is not stored; no such run.
        TypeMismatch: It is no topic of scans, clouds or maps; odom tells no poses.
        MessageNotFound: It has no message there.
        TransformException: Of none of them is known where the sensor was; the text says why.
        InvalidOption: An option is not in its range, the map would be too large, or nothing was
            seen within the range and the heights.
        InvalidKey: A time is none.
    """
    stored = rosCas.getTopic(topic)
    each = [nodeID] if nodeID is None or isinstance(nodeID, str) else nodeID
    nodes = [None if node is None else check_node(node) for node in each]
    wanted = _Rows(stored, key, to_key, nodes, rosCas.catalog.keyspace.runs.writers(run))
    types = {table.msg_type for table in stored.tables}
    if types == {OCCUPANCY_GRID}:
        return _stored_map(wanted, name)
    if name is not None:
        raise InvalidOption(f"name={name!r} is that of a stored map; {stored.name} has none")
    if len(types) != 1 or not types <= set(SENSORS):
        raise TypeMismatch(
            f"topic {stored.name} holds {', '.join(sorted(types)) or 'nothing'}: a map is made of "
            f"{' or '.join(SENSORS)}, or is a {OCCUPANCY_GRID}"
        )
    total = wanted.count()
    work = _Work(rosCas.catalog, SENSORS[types.pop()], options, poses, wanted)
    step = 1 if options.most is None else max(1, -(-total // options.most))
    for done, batch in _batches(wanted.read(), step):
        if progress is not None:
            progress(done, total)
        work.add(batch)
    if not work.seen:
        raise MessageNotFound(f"topic {stored.name} has no message there")
    return work.finished(stored.name)


@dataclass(frozen=True)
class _Rows:
    """The messages that are asked for."""

    topic: CassandraTopic
    key: Optional[Time]
    to_key: Optional[Time]
    nodes: Sequence[Optional[str]]
    """Robots; one of them None = all."""
    writers: Writers

    def count(self) -> int:
        count = partial(self.topic.countTopicData, self.key, self.to_key, run=self.writers)
        return sum(count(node) for node in self.nodes)

    def read(self, reverse: bool = False, limit: Optional[int] = None) -> Iterator[StoredRow]:
        read = partial(self.topic.rows, self.key, self.to_key, run=self.writers, limit=limit)
        streams = [read(nodeID=node, reverse=reverse) for node in self.nodes]
        rows = heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)
        return islice(rows, limit)

    def measured(self, catalog: Catalog, node: str) -> Measurements:
        """Return what of this is one robot's."""
        ends = [None if end is None else to_ns(end) for end in (self.key, self.to_key)]
        return Measurements(catalog, self.topic.name, ends[0], ends[1], node, self.writers)

    def some_times(self, node: str) -> List[int]:
        """Return the keys of the first, a middle and the last message of a robot, ns."""
        mine = replace(self, nodes=[node])
        first, last = (next((row.t for row in mine.read(way, 1)), 0) for way in (False, True))
        later = replace(mine, key=Stamp.from_ns((first + last) // 2), to_key=None)
        return [first, next((row.t for row in later.read(limit=1)), last), last]


def _stored_map(wanted: _Rows, name: Optional[str]) -> MadeMap:
    """Return the newest of stored maps, or of those under a name, as it is."""
    topic = wanted.topic
    if name is None:
        rows = wanted.read(reverse=True, limit=1)
    else:
        rows = heapq.merge(
            *(
                topic.versions(name, nodeID=n, reverse=True, run=wanted.writers)
                for n in wanted.nodes
            ),
            key=lambda row: row.position,
            reverse=True,
        )
    row = next(rows, None)
    if row is None:
        raise MessageNotFound(
            f"topic {topic.name} has no map there" + (f": {name}" if name else "")
        )
    return MadeMap(OccupancyMap.of_message(row.message()), 1, 0, 0, 0, [f"stored on {topic.name}"])


def _batches(rows: Iterator[StoredRow], step: int) -> Iterator[Tuple[int, List[StoredRow]]]:
    """Yield every so manieth row, some together, and how many were read before."""
    batch: List[StoredRow] = []
    size = begun = number = 0
    for number, row in enumerate(rows):
        if number % step:
            continue
        batch.append(row)
        size += row.size
        if len(batch) >= _BATCH_ROWS or size >= _BATCH_BYTES:
            yield begun, batch
            batch, size, begun = [], 0, number + 1
    if batch:
        yield begun, batch


class _Measured(NamedTuple):
    """A message, and when it was received, ns."""

    key: int
    message: Any

    @property
    def stamp(self) -> int:
        return int(self.message.header.stamp.to_nsec())


class _Work:
    """A map in the making."""

    def __init__(
        self,
        catalog: Catalog,
        sensor: Sensor,
        options: MapOptions,
        choice: PoseChoice,
        wanted: _Rows,
    ) -> None:
        self._catalog = catalog
        self._sensor = sensor
        self._options = options
        self._choice, self._wanted = choice, wanted
        self._low, self._high = options.heights(sensor)
        self._grid = LogOddsGrid(options.resolution, options.hit, options.miss)
        self._robots: Dict[str, SensorPoses] = {}
        self._frames: Dict[str, str] = {}
        """The frame of the map, by robot and sensor."""
        self._lost: Optional[Tuple[Poses, _Measured]] = None
        """The first message of which no pose is known."""
        self.seen = self._used = self._without_pose = self._unreadable = 0
        self._stamp = 0

    def add(self, rows: Sequence[StoredRow]) -> None:
        """Take in some messages."""
        measured: Dict[Tuple[str, str], List[_Measured]] = defaultdict(list)
        for row in rows:
            self.seen += 1
            try:
                message = row.message()
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s is left out: %s", row.key, row.topic, exc)
                self._unreadable += 1
                continue
            measured[row.node, message.header.frame_id].append(_Measured(row.t, message))
        for (node, frame), those in measured.items():
            self._place(node, frame, those)

    def _place(self, node: str, sensor: str, measured: Sequence[_Measured]) -> None:
        """Take in the messages of one sensor."""
        if node not in self._robots:
            mine, times = self._wanted.measured(self._catalog, node), self._wanted.some_times(node)
            self._robots[node] = SensorPoses(self._choice, mine, times)
        robot = self._robots[node]
        keys = np.array([each.key for each in measured], np.int64)
        stamps = np.array([each.stamp for each in measured], np.int64)
        placed = robot.at(sensor, keys, stamps)
        self._frames[f"{sensor} of {node}" if node else sensor] = robot.of(sensor).frame
        self._check_frames()
        for number, (each, known) in enumerate(zip(measured, placed.known)):
            if known:
                self._draw(placed.poses.take(slice(number, number + 1)), each)
            else:
                self._without_pose += 1
                self._lost = self._lost or (robot.of(sensor), each)

    def _check_frames(self) -> None:
        if len(set(self._frames.values())) > 1:
            told = ", ".join(f"{who} in {frame}" for who, frame in self._frames.items())
            raise InvalidOption(
                f"the poses lie in several frames ({told}): give the frame that all have, or a node"
            )

    def _draw(self, pose: Rigid, measured: _Measured) -> None:
        try:
            beams = self._sensor.beams(measured.message, self._options.max_range)
        except CorruptMessage as exc:
            _log.warning("the message received at %s is left out: %s", measured.key, exc)
            self._unreadable += 1
            return
        ends, hit = pose.apply(beams.ends), beams.hit
        low = ends[:, 2] <= self._high
        hit = hit & (ends[:, 2] >= self._low)
        self._grid.add(pose.moved[0, :2], ends[low, :2], hit[low])
        self._used += 1
        self._stamp = max(self._stamp, measured.stamp or measured.key)

    def finished(self, topic: str) -> MadeMap:
        """Return the map; raises where no message had a pose, and where nothing was seen."""
        if self._lost is not None and not self._used:
            poses, first = self._lost
            why = poses.explain(first.stamp or first.key)
            raise TransformException(
                f"of none of {self.seen} messages of topic {topic} is known where the sensor was: "
                f"{why}"
            )
        frame = next(iter(self._frames.values()), "")
        made = OccupancyMap.of_grid(self._grid, frame, self._stamp)
        if not made.cells.size:
            raise InvalidOption(
                f"nothing was seen in {self._used} messages of topic {topic}: give a larger "
                "max_range, or other heights"
            )
        robots = list(self._robots.values())
        return MadeMap(
            made,
            self._used,
            self._without_pose,
            self._unreadable,
            sum(robot.received for robot in robots),
            [source for robot in robots for source in robot.sources],
            united_offers(robot.offers for robot in robots),
        )
