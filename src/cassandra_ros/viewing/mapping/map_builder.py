# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Making of an occupancy grid from the scans or clouds of a stored topic (paper figure 4)."""

from __future__ import annotations

import heapq
import logging
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from typing import Any, Callable, Iterator, NamedTuple, Sequence

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
from cassandra_ros.messages.stamps import Stamp, Time, to_ns
from cassandra_ros.places.poses import Poses
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.read import Read, Whose, Writers
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.viewing.mapping.beams import SENSORS, Sensor
from cassandra_ros.viewing.mapping.grid import LogOddsGrid
from cassandra_ros.viewing.mapping.occupancy import OCCUPANCY_GRID, OccupancyMap
from cassandra_ros.viewing.mapping.pose_offers import Measurements, PoseOffer, merge_offers
from cassandra_ros.viewing.mapping.sensor_poses import PoseChoice, SensorPoses

_log = logging.getLogger(__name__)

DEFAULT_RESOLUTION = 0.05
"""Default length of a cell, metres."""
_BATCH_ROWS = 256
_BATCH_BYTES = 16 << 20
"""Maximum size of the messages whose poses are computed together, bytes."""

Progress = Callable[[int, int], None]
"""Function called with the number of processed messages and of all. An exception stops the work."""


@dataclass(frozen=True)
class MapOptions:
    """Options of a map: its cells, and which hits of the beams are used."""

    resolution: float = DEFAULT_RESOLUTION
    """Length of a cell, metres."""
    max_range: float | None = None
    """Maximum range, metres; farther hits are ignored. None = scans: their range_max, clouds:
    30."""
    min_height: float | None = None
    """Minimum height of an obstacle, metres in the map's frame; lower hits are floor. None = scans:
    no minimum, clouds: 0.1."""
    max_height: float | None = None
    """Maximum height, metres; higher hits are ignored. None = scans: no maximum, clouds: 2."""
    hit: float = 0.7
    """Probability that a cell in which a beam ended is occupied."""
    miss: float = 0.4
    """Probability that a cell which a beam crossed is occupied."""
    most: int | None = None
    """Maximum number of messages, evenly spaced; None = all messages."""

    def __post_init__(self) -> None:
        if self.max_range is not None and not self.max_range > 0:
            raise InvalidOption(f"max_range={self.max_range!r}: give metres above 0")
        low, high = self.min_height, self.max_height
        if low is not None and high is not None and not low < high:
            raise InvalidOption(f"min_height={low!r} does not lie below max_height={high!r}")
        if self.most is not None and self.most < 1:
            raise InvalidOption(f"most={self.most!r}: give at least one message")

    def heights(self, sensor: Sensor) -> tuple[float, float]:
        """Return the minimum and maximum height of obstacles, metres."""
        low, high = sensor.heights
        return (
            low if self.min_height is None else self.min_height,
            high if self.max_height is None else self.max_height,
        )


@dataclass
class MadeMap:
    """A map, and the data it was made from."""

    map: OccupancyMap
    used: int
    """Number of messages used."""
    without_pose: int
    """Number of messages without a known pose of the sensor."""
    unreadable: int
    received: int
    """Number of messages placed by the pose at their receive time, because none is known at their
    stamp."""
    sources: Sequence[str] = ()
    """Sources of the poses, as texts for people."""
    offers: Sequence[PoseOffer] = ()
    """Topics with poses of the robots, best first: ``PoseChoice(odom=…)`` selects another one.
    Empty if the poses are from tf."""


_ALL = MapOptions()
_BEST = PoseChoice()


def makeMap(
    rosCas: RosCassandra,
    topic: str,
    key: Time | None = None,
    to_key: Time | None = None,
    *,
    nodeID: None | str | Sequence[str] = None,
    run: RunName = None,
    name: str | None = None,
    options: MapOptions = _ALL,
    poses: PoseChoice = _BEST,
    progress: Progress | None = None,
    event: EventRule = None,
) -> MadeMap:
    """Make an occupancy grid from stored sensor_msgs/LaserScan or PointCloud2.

    Poses are taken from recorded tf, for each robot its own (by nodeID), or from a topic of
    Odometry, PoseStamped or PoseWithCovarianceStamped: of several topics the one whose poses cover
    most messages. They are interpolated at the header stamps, or at the receive times if no poses
    with such stamps were recorded. For a topic of nav_msgs/OccupancyGrid the newest map is returned
    as it was stored.

    Args:
        rosCas: Store, connected to the keyspace.
        topic: Name of the topic.
        key, to_key: First and last time, both included; None = open.
        nodeID: Robot, or list of robots, whose messages are used, each by its own poses; None =
            all.
        run: Run whose messages and poses are used; None = all runs.
        name: Name of the map, for a topic whose maps are kept under names; None = any.
        options: Cells and beams.
        poses: Source of the poses.
        progress: Called with the number of processed messages.
        event: Only messages of a robot during its events, as in readMessages.

    Raises:
        EventNotFound: There is no such event of that time, robot and run.
        TopicNotFound, RunNotFound: The topic, the source of the poses, or the run is not stored.
        TypeMismatch: The topic has no scans, clouds or maps, or the topic ``odom`` has no poses.
        MessageNotFound: The topic has no message in the time range.
        TransformException: No message has a known pose of the sensor; the text gives the reason.
        InvalidOption: An option is out of range, the map would be too large, or nothing was seen
            within the range and the heights.
        InvalidKey: A time is invalid.
    """
    stored = rosCas.getTopic(topic)
    node_ids = [nodeID] if nodeID is None or isinstance(nodeID, str) else nodeID
    nodes = [None if node is None else check_node(node) for node in node_ids]
    writers = rosCas.catalog.keyspace.runs.writers(run)
    rows = _SelectedRows(stored, key, to_key, nodes, writers)
    if event is not None:
        whose = Whose(tuple(node for node in nodes if node is not None) or None, writers)
        reads = rosCas.catalog.reads_of([stored.name], key, to_key, whose, event)
        rows = replace(rows, parts=reads.parts)
    types = {table.msg_type for table in stored.tables}
    if types == {OCCUPANCY_GRID}:
        return _stored_map(rows, name)
    if name is not None:
        raise InvalidOption(f"name={name!r} is that of a stored map; {stored.name} has none")
    if len(types) != 1 or not types <= set(SENSORS):
        raise TypeMismatch(
            f"topic {stored.name} holds {', '.join(sorted(types)) or 'nothing'}: a map is made of "
            f"{' or '.join(SENSORS)}, or is a {OCCUPANCY_GRID}"
        )
    total = rows.count()
    work = _MapBuilder(rosCas.catalog, SENSORS[types.pop()], options, poses, rows)
    step = 1 if options.most is None else max(1, -(-total // options.most))
    for done, batch in _batches(rows.read(), step):
        if progress is not None:
            progress(done, total)
        work.add(batch)
    if not work.seen:
        raise MessageNotFound(f"topic {stored.name} has no message there")
    return work.finished(stored.name)


@dataclass(frozen=True)
class _SelectedRows:
    """The selected messages."""

    topic: CassandraTopic
    key: Time | None
    to_key: Time | None
    nodes: Sequence[str | None]
    """nodeIDs of the robots; None = all robots."""
    writers: Writers
    parts: Sequence[Read] | None = None
    """Reads of the messages during events; None = all messages from key to to_key."""

    def count(self) -> int:
        if self.parts is not None:
            return sum(map(self.topic.count, self.parts))
        count = partial(self.topic.countTopicData, self.key, self.to_key, run=self.writers)
        return sum(count(node) for node in self.nodes)

    def read(self, reverse: bool = False, limit: int | None = None) -> Iterator[StoredRow]:
        if self.parts is not None:
            parts = reversed(self.parts) if reverse else self.parts
            directed = (replace(event_read, reverse=reverse, wanted=limit) for event_read in parts)
            return islice(chain.from_iterable(map(self.topic.read, directed)), limit)
        read = partial(self.topic.rows, self.key, self.to_key, run=self.writers, limit=limit)
        streams = [read(nodeID=node, reverse=reverse) for node in self.nodes]
        rows = heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)
        return islice(rows, limit)

    def measured(self, catalog: Catalog, node: str) -> Measurements:
        """Return the selected messages of one robot."""
        ends = [None if end is None else to_ns(end) for end in (self.key, self.to_key)]
        return Measurements(catalog, self.topic.name, ends[0], ends[1], node, self.writers)

    def some_times(self, node: str) -> list[int]:
        """Return the row keys of the first, a middle and the last message of a robot, ns."""
        parts = self.parts and [event_read for event_read in self.parts if _is_of(event_read, node)]
        mine = replace(self, nodes=[node], parts=parts)
        first, last = (next((row.t for row in mine.read(way, 1)), 0) for way in (False, True))
        later = replace(mine, key=Stamp.from_ns((first + last) // 2), to_key=None)
        if parts:
            later = replace(mine, parts=parts[len(parts) // 2 :])
        return [first, next((row.t for row in later.read(limit=1)), last), last]


def _is_of(read: Read, node: str) -> bool:
    return read.whose.nodes is None or node in read.whose.nodes


def _stored_map(wanted: _SelectedRows, name: str | None) -> MadeMap:
    """Return the newest stored map, or the newest with a name, unchanged."""
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


def _batches(rows: Iterator[StoredRow], step: int) -> Iterator[tuple[int, list[StoredRow]]]:
    """Yield every step-th row in batches, and the number of rows read before each batch."""
    batch: list[StoredRow] = []
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


class _Measurement(NamedTuple):
    """A message, and its receive time, ns."""

    key: int
    message: Any

    @property
    def stamp(self) -> int:
        return int(self.message.header.stamp.to_nsec())


class _MapBuilder:
    """A map that is being made."""

    def __init__(
        self,
        catalog: Catalog,
        sensor: Sensor,
        options: MapOptions,
        choice: PoseChoice,
        wanted: _SelectedRows,
    ) -> None:
        self._catalog = catalog
        self._sensor = sensor
        self._options = options
        self._choice, self._wanted = choice, wanted
        self._low, self._high = options.heights(sensor)
        self._grid = LogOddsGrid(options.resolution, options.hit, options.miss)
        self._robots: dict[str, SensorPoses] = {}
        self._frames: dict[str, str] = {}
        """Frame of the map, by robot and sensor."""
        self._lost: tuple[Poses, _Measurement] | None = None
        """The first message without a known pose."""
        self.seen = self._used = self._without_pose = self._unreadable = 0
        self._stamp = 0

    def add(self, rows: Sequence[StoredRow]) -> None:
        """Add some messages to the map."""
        measured: dict[tuple[str, str], list[_Measurement]] = defaultdict(list)
        for row in rows:
            self.seen += 1
            try:
                message = row.message()
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s is left out: %s", row.key, row.topic, exc)
                self._unreadable += 1
                continue
            measured[row.node, message.header.frame_id].append(_Measurement(row.t, message))
        for (node, frame), those in measured.items():
            self._place(node, frame, those)

    def _place(self, node: str, sensor: str, measured: Sequence[_Measurement]) -> None:
        """Add the messages of one sensor to the map."""
        if node not in self._robots:
            mine, times = self._wanted.measured(self._catalog, node), self._wanted.some_times(node)
            self._robots[node] = SensorPoses(self._choice, mine, times)
        robot = self._robots[node]
        keys = np.array([measurement.key for measurement in measured], np.int64)
        stamps = np.array([measurement.stamp for measurement in measured], np.int64)
        placed = robot.at(sensor, keys, stamps)
        self._frames[f"{sensor} of {node}" if node else sensor] = robot.of(sensor).frame
        self._check_frames()
        for number, (measurement, has_pose) in enumerate(zip(measured, placed.known)):
            if has_pose:
                self._draw(placed.poses.take(slice(number, number + 1)), measurement)
            else:
                self._without_pose += 1
                self._lost = self._lost or (robot.of(sensor), measurement)

    def _check_frames(self) -> None:
        if len(set(self._frames.values())) > 1:
            frames = ", ".join(f"{who} in {frame}" for who, frame in self._frames.items())
            raise InvalidOption(
                f"the poses lie in several frames ({frames}): give the frame that all have, or "
                "a node"
            )

    def _draw(self, pose: Rigid, measured: _Measurement) -> None:
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
        """Return the map; raises if no message had a pose, or if nothing was seen."""
        if self._lost is not None and not self._used:
            poses, first = self._lost
            why = poses.explain(first.stamp or first.key)
            raise TransformException(
                f"the pose of the sensor is known for none of {self.seen} messages of topic "
                f"{topic}: {why}"
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
            merge_offers(robot.offers for robot in robots),
        )
