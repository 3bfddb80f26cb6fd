# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses from a topic of poses, as Odometry, or of positions on the Earth, as NavSatFix."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import TypeMismatch
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.places.array_source import (
    ArraySource,
    TopicFinder,
    arrays_between,
    key_after,
    last_key,
)
from cassandra_ros.places.earth import plane_of
from cassandra_ros.places.frame_poses import filled
from cassandra_ros.places.pose_samples import Flags, KnownPoses, Samples, Times
from cassandra_ros.places.rigid import Floats, Rigid
from cassandra_ros.query.protocols import WGS84
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.read import Writers

_MOVED, _TURNED = ("x", "y", "z"), ("x", "y", "z", "w")
_SOLID = (
    ("pose.pose.position", "pose.pose.orientation"),  # Odometry, PoseWithCovarianceStamped
    ("pose.position", "pose.orientation"),  # PoseStamped
    ("position", "orientation"),  # Pose
    ("transform.translation", "transform.rotation"),  # TransformStamped
)
_PLANAR = ("x", "y", "theta")  # Pose2D, turtlesim/Pose
_FIXES = ("", "position.", "pose.position.", "pose.pose.position.")  # NavSatFix, GeoPose …
_STATUS = "status.status"  # NavSatFix: below 0, there is no fix
_STAMP, _FRAME = "header.stamp", "header.frame_id"
_WISHES = ("goal", "initialpose", "initial_pose", "clicked")
"""Words in topic names whose poses are goals or guesses, not where a robot was."""
_LONGEST_REACH_NS = 120 * SECOND_NS
"""Maximum length of the range of row keys in which a pose is looked for at once, ns."""


def pose_fields(definition: Definition | None) -> Sequence[str]:
    """Return the fields of a type that make a pose: seven, three in the plane, or an empty list."""
    names = set() if definition is None else {ref.name for ref in all_fields(definition)}
    for moved, turned in _SOLID:
        fields = [f"{moved}.{c}" for c in _MOVED] + [f"{turned}.{c}" for c in _TURNED]
        if names.issuperset(fields):
            return fields
    return _PLANAR if names.issuperset(_PLANAR) else ()


def fix_fields(definition: Definition | None) -> Sequence[str]:
    """Return the fields of a type that make a position on the Earth: latitude, longitude, status.

    Not all types have a status. Empty if it is another type.
    """
    refs = () if definition is None else all_fields(definition)
    kinds = {ref.name: ref.type for ref in refs if not ref.is_array}
    for prefix in _FIXES:
        fields = [f"{prefix}latitude", f"{prefix}longitude"]
        if all(kinds.get(name) in ("float32", "float64") for name in fields):
            return fields + [_STATUS] * (kinds.get(_STATUS) in ("int8", "int16"))
    return ()


def tells_poses(topic: ArraySource) -> bool:
    """Return whether the messages of a topic are poses."""
    return any(pose_fields(table.definition) for table in topic.tables)


def tells_fixes(topic: ArraySource) -> bool:
    """Return whether the messages of a topic are positions on the Earth."""
    return any(fix_fields(table.definition) for table in topic.tables)


def tells_robot(topic: ArraySource, frame: str = "") -> bool:
    """Return whether a topic's messages are positions in a frame, and not goals by its name.

    Args:
        frame: WGS84: positions on the Earth; others: poses in any frame.
    """
    name, tells = topic.name.rpartition("/")[2], tells_fixes if frame == WGS84 else tells_poses
    return not any(word in name for word in _WISHES) and tells(topic)


class PoseTopic:
    """Recorded poses of a topic, of one robot or of all.

    In frame WGS84 they are positions on the Earth without orientations, in the plane of ``earth``.

    Args:
        find: Returns a topic by its name.
        topic: Name of the topic.
        node: nodeID of the robot; None = all robots.
        writers: Writer ids of the runs; None = all runs.
        offset: Pose on the robot (one transform) whose poses are computed, as a sensor's; None =
            the robot's own.
        frame: Frame of the poses, where it is known; None = the frame of the first pose.

    Raises:
        TopicNotFound: The topic is not stored.
        TypeMismatch: Its messages are not poses.
    """

    def __init__(
        self,
        find: TopicFinder,
        topic: str,
        node: str | None = None,
        writers: Writers = None,
        offset: Rigid | None = None,
        frame: str | None = None,
    ) -> None:
        check_nodes(node)
        self._topic, self._node, self._writers = find(topic), node, writers
        self._offset = Rigid.none(1) if offset is None else offset
        self._on_earth = frame == WGS84
        fields_of = fix_fields if self._on_earth else pose_fields
        tables = [t for t in self._topic.tables if fields_of(t.definition)]
        if not tables:
            types = ", ".join(sorted({t.msg_type for t in self._topic.tables})) or "no type yet"
            raise TypeMismatch(
                f"topic {self._topic.name} ({types}) tells no poses: give one of "
                "nav_msgs/Odometry, geometry_msgs/PoseStamped or PoseWithCovarianceStamped"
            )
        definition = tables[0].definition
        self._fields = list(fields_of(definition))
        names = {ref.name for ref in all_fields(definition)} if definition else ()
        self._stamped = _STAMP in names
        self._framed = _FRAME in names and not self._on_earth
        if frame is None:
            frame = self._first_frame() if self._framed else ""
        self.frame = frame
        """Frame of the poses, without a slash in front; '' if the type has no frame."""

    def _first_frame(self) -> str:
        """Return the frame of the first message; '' without messages."""
        first = key_after(self._topic, -1, self._node, self._writers)
        if first is None:
            return ""
        whose = (self._node, self._writers)
        arrays = arrays_between(self._topic, [_FRAME], first, first, *whose)
        return str(next(iter(arrays[_FRAME]), None) or "").lstrip("/")

    def read(self, low: int, high: int) -> Samples:
        """Return the poses with a row key in [low, high], ns; none of them in another frame."""
        if low > high:
            return Samples.none()
        has_frame = self._framed and self.frame != ""
        head = [_STAMP] * self._stamped + [_FRAME] * has_frame
        fields = ["KEY", *head, *self._fields]
        arrays = arrays_between(self._topic, fields, low, high, self._node, self._writers)
        if has_frame:
            texts = (str(text or "").lstrip("/") for text in arrays[_FRAME])
            ours = np.fromiter((text in (self.frame, "") for text in texts), bool)
            if not ours.all():
                arrays = {name: values[ours] for name, values in arrays.items()}
        keys = arrays["KEY"]
        stamps = filled(arrays[_STAMP], 0) if self._stamped else keys
        columns = [filled(arrays[name].astype(np.float64), np.nan) for name in self._fields]
        # Two frames: 0 is that of the poses, 1 the robot.
        parents, robot = np.zeros(len(keys), np.int64), np.ones(len(keys), np.int64)
        numbers = _fix_numbers(*columns) if self._on_earth else _numbers(columns)
        return Samples.checked(keys, stamps, parents, robot, numbers)

    def holds_any(self) -> bool:
        """Return whether any message has a pose: it may have none, as long as there is no fix."""
        key, reach = self.next_key(-1), SECOND_NS
        while key is not None:
            if len(self.read(key, key + reach)):
                return True
            key, reach = self.next_key(key + reach), min(2 * reach, _LONGEST_REACH_NS)
        return False

    def explain(self, time: int) -> str:
        """Return why there is no pose at a time, as a text."""
        whose = f" of node {self._node}" if self._node else ""
        first = key_after(self._topic, -1, self._node, self._writers)
        last = last_key(self._topic, self._node, self._writers)
        if first is None or last is None:
            return f"topic {self._topic.name} has no message{whose}"
        return (
            f"topic {self._topic.name} tells no pose{whose} at {iso_time(time)}: what it has was "
            f"received from {iso_time(first)} to {iso_time(last)}"
        )

    def next_key(self, time: int) -> int | None:
        """Return the first row key after a time, ns; None if there are no later rows."""
        return key_after(self._topic, time, self._node, self._writers)

    def on_way(self, samples: Samples) -> Flags:
        """Return which samples affect the poses: all of them."""
        return np.ones(len(samples), bool)

    def placed(
        self, samples: Samples, times: Times, stamped: bool, longest_gap_ns: int
    ) -> KnownPoses:
        """Return the poses at some times, ns, computed from the samples around them."""
        robot = samples.track(1, stamped)
        (poses, valid), _ = robot.at(times, longest_gap_ns)
        return KnownPoses(poses @ self._offset, valid)


def _fix_numbers(latitude: Floats, longitude: Floats, status: Floats | None = None) -> Floats:
    """Return the (n, 7) numbers of positions on the Earth; NaN where there is no fix."""
    x, y = plane_of(latitude, longitude)
    if status is not None:
        x = np.where(status < 0, np.nan, x)
    flat = Rigid.planar(x, y, np.zeros(len(x)))
    return np.concatenate([flat.moved, flat.turned], 1)


def _numbers(columns: Sequence[Floats]) -> Floats:
    """Return the (n, 7) numbers of poses from the columns of their fields."""
    if len(columns) == len(_PLANAR):
        flat = Rigid.planar(*columns[:3])
        return np.concatenate([flat.moved, flat.turned], 1)
    return np.stack(columns, 1)
