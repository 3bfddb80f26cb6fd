# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a sensor at the times of its measurements, from recorded tf or a topic of poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from cassandra_ros.errors import InvalidOption, TopicNotFound, TransformException
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.array_source import key_after
from cassandra_ros.places.frame_poses import TF, TF_STATIC, FrameChain, TfRecording
from cassandra_ros.places.pose_samples import Flags, KnownPoses, Samples, Times
from cassandra_ros.places.pose_topic import PoseTopic, tells_robot
from cassandra_ros.places.poses import LONGEST_GAP_SEC, Poses
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.places.transforms.lookup import lookup_transform
from cassandra_ros.viewing.mapping.pose_offers import Measurements, PoseOffer

FRAMES = ("map", "odom", "odom_combined", "world")
"""Names of frames for maps, in order of preference; without them the topmost frame is used."""
_TYPES = (
    "nav_msgs/Odometry",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/PoseStamped",
)
"""Types of the topics that may be chosen automatically. Of topics that cover the same messages one
of the first type is chosen."""


@dataclass(frozen=True)
class PoseChoice:
    """The source of poses."""

    frame: str | None = None
    """Frame of the map; None = the best of the robot's frames."""
    odom: str | None = None
    """Topic of poses; None = tf if it knows the sensor, else the topic whose poses cover most
    messages."""
    sensor_offset: Rigid | None = None
    """Pose of the sensor on the robot, for a topic of poses; None = from tf if known, else no
    offset."""
    tf: str = TF
    tf_static: str = TF_STATIC
    longest_gap_sec: float = LONGEST_GAP_SEC


class SensorPoses:
    """The poses of the sensors of one robot.

    Args:
        choice: Source of the poses.
        measured: Messages whose poses will be requested, all of one robot.
        times: Row keys of some of them, ns.

    Attributes:
        offers: Topics with poses of this robot, best first. Empty if the poses are from tf.
        received: Number of poses taken at receive times, because none was known at the stamps.
    """

    def __init__(self, choice: PoseChoice, measured: Measurements, times: Sequence[int]) -> None:
        self._catalog = measured.catalog
        self._choice = choice
        self._measured = measured
        self._times = times
        self._node, self._writers = measured.node, measured.writers
        by_topic = choice.odom or choice.sensor_offset is not None
        self._frames = None if by_topic else self._recorded_tf()
        self._known: dict[str, Poses] = {}
        self._sources: dict[str, str] = {}
        self.offers: list[PoseOffer] = []
        self.received = 0

    def _recorded_tf(self) -> TfRecording | None:
        choice = self._choice
        try:
            return TfRecording(
                self._catalog.get, self._node, self._writers, choice.tf, choice.tf_static
            )
        except TopicNotFound:
            return None

    def at(self, sensor: str, keys: Times, stamps: Times) -> KnownPoses:
        """Return the poses of a sensor's frame at the times of measurements.

        Args:
            sensor: Frame in the messages' headers.
            keys: Row keys of the messages, ns.
            stamps: Header stamps, ns. For messages with stamp 0, and for all messages if no poses
                with such stamps were recorded, the poses at the row keys are returned.

        Raises:
            TopicNotFound, TransformException: There is no source of poses, or tf does not know the
                sensor.
        """
        poses, stamped = self.of(sensor), stamps > 0
        placed = poses.at(keys, stamps)
        if not placed.known[stamped].any():
            stamped[:] = False
        others = np.flatnonzero(~stamped)
        if len(others):
            interpolated = poses.at(keys[others])
            placed.poses.put(others, interpolated.poses)
            placed.known[others] = interpolated.known
            self.received += int(interpolated.known.sum())
        return placed

    def of(self, sensor: str) -> Poses:
        """Return the poses of a sensor; raises as ``at``."""
        if sensor not in self._known:
            self._known[sensor] = self._find(sensor)
        return self._known[sensor]

    @property
    def sources(self) -> Sequence[str]:
        """Sources of the poses, as texts for people."""
        return list(dict.fromkeys(self._sources.values()))

    def _find(self, sensor: str) -> Poses:
        choice = self._choice
        if self._stands(sensor):
            self._sources[sensor] = f"none: {sensor.lstrip('/')} itself is the frame of the map"
            return Poses(_OriginPoses(sensor.lstrip("/")))
        if self._frames is not None:
            above = self._frames.above(sensor, self._times) if sensor.strip("/") else []
            frame = choice.frame or self._best(sensor, above)
            if frame is not None and above:
                self._sources[sensor] = f"tf ({frame.lstrip('/')} to {sensor.lstrip('/')})"
                return Poses(FrameChain(self._frames, sensor, frame), choice.longest_gap_sec)
        self.offers = self.offers or self._pose_offers()
        topic = self._catalog.get(choice.odom or self._best_topic(sensor)).name
        self.offers = [offer._replace(taken=offer.topic == topic) for offer in self.offers]
        odometry = PoseTopic(self._catalog.get, topic, self._node, self._writers)
        offset, how = self._offset(topic, sensor)
        if choice.frame and odometry.frame and choice.frame.strip("/") != odometry.frame:
            raise InvalidOption(
                f"topic {topic} tells poses in frame {odometry.frame}, not in {choice.frame}: "
                "leave the frame out, or leave it to tf"
            )
        self._sources[sensor] = f"{topic}, {how}"
        frame = (choice.frame or "").strip("/") or odometry.frame or FRAMES[1]
        placed = PoseTopic(self._catalog.get, topic, self._node, self._writers, offset, frame)
        return Poses(placed, choice.longest_gap_sec)

    def _stands(self, sensor: str) -> bool:
        """Return whether the map is in the sensor's own frame, in which it never moves."""
        choice = self._choice
        is_own_frame = choice.frame is not None and choice.frame.strip("/") == sensor.strip("/")
        return is_own_frame and not choice.odom and choice.sensor_offset is None

    def _best(self, sensor: str, above: Sequence[str]) -> str | None:
        """Return the best ancestor frame of a sensor for the map; None if a topic is better."""
        for wanted in FRAMES:
            for name in above:
                if name.split("/")[-1] == wanted:
                    return name
        frames = self._frames
        way = [sensor, *above[:-1]]
        if above and frames is not None and any(frames.code(n) not in frames.fixed for n in way):
            return above[-1]
        return None  # tf has only the sensor's fixed place on the robot

    def _best_topic(self, sensor: str) -> str:
        """Return the topic to take poses from when tf has none.

        Raises if there is no such topic.
        """
        if self.offers:
            return self.offers[0].topic
        tf, tf_static = self._choice.tf, self._choice.tf_static
        if self._choice.sensor_offset is not None:
            what = "a sensor offset needs a topic with poses of the robot"
        elif self._frames is None:
            what = f"neither {tf} nor {tf_static} is stored"
        else:
            what = f"frame {sensor!r} does not move in {tf} and {tf_static}"
        raise TransformException(
            f"the pose of the sensor is unknown: {what}, and there is no topic of Odometry, "
            "PoseStamped or PoseWithCovarianceStamped; name a topic with poses by odom="
        )

    def _pose_offers(self) -> list[PoseOffer]:
        """Return the topics with poses of this robot, best first."""
        kinds = {
            topic.name: min(_TYPES.index(t.msg_type) for t in topic.tables if t.msg_type in _TYPES)
            for topic in self._catalog.all(None)
            if any(t.msg_type in _TYPES for t in topic.tables) and tells_robot(topic)
            if key_after(topic, -1, self._node, self._writers) is not None
        }
        gap_ns = round(self._choice.longest_gap_sec * SECOND_NS)
        return self._measured.offers(kinds, gap_ns)

    def _offset(self, topic: str, sensor: str) -> tuple[Rigid, str]:
        """Return the pose of the sensor on the robot, and the source of that pose as a text."""
        given = self._choice.sensor_offset
        if given is not None:
            return given, "sensor offset as given"
        row = next(self._catalog.get(topic).rows(nodeID=self._node, limit=1), None)
        robot = "" if row is None else getattr(row.message(), "child_frame_id", "").lstrip("/")
        if robot and sensor.strip("/"):
            tf, tf_static = self._choice.tf, self._choice.tf_static
            try:
                transform = lookup_transform(
                    self._catalog.get, self._node, self._writers, robot, sensor, 0, tf, tf_static
                )
            except (TransformException, TopicNotFound):
                pass
            else:
                moved, turned = transform.transform.translation, transform.transform.rotation
                numbers = [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w]
                return Rigid.of_numbers(np.array([numbers])), f"sensor on {robot} as tf has it"
        return Rigid.none(1), "no sensor offset"


class _OriginPoses:
    """The poses of a sensor in its own frame: always the origin."""

    def __init__(self, frame: str) -> None:
        self.frame = frame

    def read(self, low: int, high: int) -> Samples:
        return Samples.none()

    def placed(
        self, samples: Samples, times: Times, stamped: bool, longest_gap_ns: int
    ) -> KnownPoses:
        return KnownPoses(Rigid.none(len(times)), np.ones(len(times), bool))

    def on_way(self, samples: Samples) -> Flags:
        return np.zeros(len(samples), bool)

    def next_key(self, time: int) -> int | None:
        return None

    def explain(self, time: int) -> str:
        return ""
