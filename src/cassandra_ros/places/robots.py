# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The choice of the frame, or of the topic, that gives the poses of a node's robot.

tf is used if it has the requested frame; else a topic of poses in that frame. On the Earth, in
frame WGS84, a topic of latitude and longitude is used. If several frames or
topics could be meant, an error names them: silently using another robot's poses would be worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import (
    Iterable,
    Mapping,
    NamedTuple,
    Sequence,
)

from cassandra_ros.errors import InvalidOption, TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.places.array_source import (
    ArraySource,
    StoredTopics,
    TopicFinder,
    find_stored,
    key_after,
    last_key,
)
from cassandra_ros.places.frame_poses import TF, TF_STATIC, FrameChain, TfRecording
from cassandra_ros.places.pose_samples import NO_FRAME, Samples
from cassandra_ros.places.pose_topic import PoseTopic, tells_fixes, tells_poses, tells_robot
from cassandra_ros.places.poses import Poses, PoseSource
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.query.protocols import WGS84
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.read import Writers

BASES = ("base_link", "base_footprint", "base", "base_stabilized", "body", "chassis")
"""Usual names of the frame of a robot's body, with or without a prefix, in order of preference."""
USUAL_FRAMES = ("map", "odom", "world")
MAX_FRAMES = 1000
"""Maximum number of frame names remembered for one robot."""
MAX_ROBOTS = 8
"""Maximum number of moving frames treated as robots when no frame has a robot's usual name."""
_SAMPLES = 5
"""Number of samples, evenly spaced over the recording, that are searched for frame names."""
_SAMPLE_NS = 1 * SECOND_NS
POSE_TYPES = (
    "nav_msgs/Odometry",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/TransformStamped",
)
"""Types of topics of poses that are used without being named, in order of preference."""
FIX_TYPES = (
    "sensor_msgs/NavSatFix",
    "geographic_msgs/GeoPoseStamped",
    "geographic_msgs/GeoPointStamped",
    "geographic_msgs/GeoPose",
    "geographic_msgs/GeoPoint",
)
"""The same of topics of latitude and longitude."""
_NO_FRAME_NAME = "no frame"
_NO_FIX = "no fix"
"""Frame of a topic of latitude and longitude that tells no position."""


class TfFrames(NamedTuple):
    """The frames that tf has for a node."""

    frames: frozenset[str]
    robots: tuple[str, ...]
    """Frames that may be the bodies of robots."""
    tops: tuple[str, ...] = ()
    """Frames without a parent."""


@dataclass(frozen=True)
class Robot:
    """The source of a robot's poses in one frame."""

    node: str
    topic: ArraySource
    """Topic that moves the robot: /tf, or its topic of poses."""
    frame: str
    """Frame in which its places are given, without a slash in front."""
    name: str
    """Frame of the robot; '' if a topic gives its poses."""
    find: TopicFinder
    writers: Writers = None
    """Writer ids of the runs whose poses are used; None = all runs."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Names under which the index holds its places."""
        return (self.name,) if self.name else tuple(table.name for table in self.topic.tables)

    def source(self, writers: Writers = None) -> PoseSource:
        """Return the poses of some runs as recorded; None = the runs of ``self.writers``."""
        writers = self.writers if writers is None else writers
        if self.name:
            return FrameChain(TfRecording(self.find, self.node, writers), self.name, self.frame)
        return PoseTopic(self.find, self.topic.name, self.node, writers, frame=self.frame)

    def poses(self, writers: Writers = None) -> Poses:
        """Return the poses of some runs; None = the runs of ``self.writers``."""
        return Poses(self.source(writers))

    def fixed(self) -> Mapping[str, str]:
        """Return parent and pose of each fixed frame, as a text, by frame."""
        return fixed_frames(TfRecording(self.find, self.node, self.writers)) if self.name else {}


def fixed_frames(frames: TfRecording) -> dict[str, str]:
    """Return parent and pose of each fixed frame, as ``fixed_text`` writes them, by frame."""
    return {
        frames.names[child]: fixed_text(frames.names[parent], pose)
        for child, (parent, pose) in frames.fixed.items()
        if parent != NO_FRAME
    }


def fixed_text(parent: str, pose: Rigid) -> str:
    """Return the parent of a fixed frame and its pose there as a text.

    The index of places stores it (``IndexedPoses.above``), and a record is valid only while the
    text is still the same: another text for the same pose would make every stored record invalid.
    """
    return f"{parent} {pose.moved.tolist()} {pose.turned.tolist()}"


def is_fixed_to(text: str, parent: str) -> bool:
    """Return whether a text of ``fixed_text`` has this parent."""
    return text.startswith(f"{parent} [")


def frames_above(frames: TfRecording, samples: Samples, name: str) -> list[str]:
    """Return the names of a frame and its ancestors by samples and fixed transforms, sorted."""
    above = frames.ancestors(samples, {frames.code(name)})
    return sorted(frames.names[code] for code in above if code != NO_FRAME)


def frames_in(frames: TfRecording, several: Iterable[Samples]) -> TfFrames:
    """Return the frames in samples and among the fixed transforms.

    Robots are the frames with the name of a body; without any, the moving frames that carry no
    moving frame.
    """
    moving: set[int] = set()
    carrying: set[int] = set()
    for samples in several:
        moving |= set(samples.children.tolist())
        carrying |= set(samples.parents.tolist())
    fixed = {code for child, (parent, _) in frames.fixed.items() for code in (child, parent)}
    names = {frames.names[code] for code in moving | carrying | fixed if code != NO_FRAME}
    robots = _bodies(names) or sorted(frames.names[code] for code in moving - carrying)
    tops = sorted(
        frames.names[code] for code in (moving | carrying | fixed) - moving if code != NO_FRAME
    )
    tops = [name for name in tops if frames.code(name) not in frames.fixed]
    return TfFrames(frozenset(sorted(names)[:MAX_FRAMES]), tuple(robots[:MAX_ROBOTS]), tuple(tops))


def _bodies(frames: Iterable[str]) -> list[str]:
    """Return for each prefix the frame that has a usual name of a robot's body."""
    bodies: dict[str, list[str]] = {}
    for frame in frames:
        prefix, _, last = frame.rpartition("/")
        if last in BASES:
            bodies.setdefault(prefix, []).append(frame)
    return sorted(min(n, key=lambda f: BASES.index(f.rpartition("/")[2])) for n in bodies.values())


def find_frames(find: TopicFinder, node: str, writers: Writers = None) -> TfFrames | None:
    """Return the frames that tf has for a node and some runs, at some times; None without tf."""
    try:
        frames = TfRecording(find, node, writers)
    except TopicNotFound:
        return None
    samples = []
    if frames.moving is not None:
        first = key_after(frames.moving, -1, node, writers)
        last = last_key(frames.moving, node, writers)
        if first is not None and last is not None:
            for number in range(_SAMPLES):
                near = first + (last - _SAMPLE_NS - first) * number // (_SAMPLES - 1)
                at = key_after(frames.moving, max(first, near) - 1, node, writers)
                start = first if at is None else at
                samples.append(frames.read(start, start + _SAMPLE_NS))
    tf = frames_in(frames, samples)
    return tf if tf.frames else None


class RobotFinder:
    """Finds the sources of the poses of the robots of a keyspace.

    Args:
        stored: The keyspace.
        frame: Frame in which places are requested; a slash in front is ignored.
        robot: Frame of the robot, or topic of its poses; '' = find it.
        writers: Writer ids of the runs whose messages are queried. If they recorded poses of a
            node, only these are used, else the poses of all runs. None = all runs.

    Raises:
        InvalidOption: There are no poses in the frame, or several robots may be meant.
    """

    def __init__(
        self, stored: StoredTopics, frame: str, robot: str = "", writers: Writers = None
    ) -> None:
        self._stored = stored
        self._frame, self._robot, self._writers = frame.lstrip("/"), robot, writers
        self._on_earth = self._frame == WGS84
        self._types = FIX_TYPES if self._on_earth else POSE_TYPES
        self._told: dict[str, list[str]] = {}
        """Frames in which topics give poses, by topic, for the text of an error."""
        self._find_frames = lru_cache(None)(partial(find_frames, stored.find))
        """The frames that tf has for a node and some runs, see find_frames."""

    def robots(self, nodes: Sequence[str] | None = None) -> list[Robot]:
        """Return the robots of some nodes, one for each node that has poses; None = all nodes."""
        named = self._named_topic()
        topics = [named] if named is not None else [*self._tf(), *self._candidates]
        all_nodes = {node for topic in topics for node in self._stored.nodes(topic)}
        writing = None if self._writers is None else self._stored.run_nodes(self._writers)
        node_ids = sorted(
            node
            for node in all_nodes
            if (nodes is None or node in nodes) and (writing is None or node in writing)
        )
        sources = [self._of_runs(node, named) for node in node_ids]
        robots = [robot for robot in sources if robot is not None]
        if not robots and all_nodes:
            raise InvalidOption(self._unknown_robots(nodes, all_nodes) or self._no_pose(node_ids))
        if not robots:
            raise InvalidOption(self._no_topic())
        return robots

    def _no_topic(self) -> str:
        """Say that no topic tells poses, or positions on the Earth."""
        if self._on_earth and self._robot:
            similar = nearest(self._robot, self._fix_topics())
            return f"{self._robot!r} is no stored topic of latitude and longitude{similar}"
        if self._on_earth:
            return (
                f"no latitude and longitude is stored: no topic of {' or '.join(FIX_TYPES[:3])}; "
                f"record one, or ask in a frame of the ground, as {self._example('map')}"
            )
        return (
            "where robots were is not stored: neither tf nor a topic of poses, as "
            f"nav_msgs/Odometry; record one, or import it{self._earth_hint()}"
        )

    def _earth_hint(self) -> str:
        """Say how to ask by latitude and longitude, if these are stored; else ''."""
        name = next(iter(self._fix_topics()), "")
        text = f"; {name} tells latitude and longitude: NEAR(latitude, longitude, 20m)"
        return text if name else ""

    def _fix_topics(self) -> list[str]:
        """Return the names of all topics of latitude and longitude."""
        return [topic.name for topic in self._stored.topics() if tells_fixes(topic)]

    def usual_frame(self) -> str:
        """Return the most usual frame for places: map or odom, else one that exists.

        Without poses, but with latitude and longitude, it is WGS84.
        """
        topics = [*self._tf(), *self._candidates]
        nodes = sorted({node for topic in topics for node in self._stored.nodes(topic)})
        tf_frames = [tf for tf in map(self._find_frames, nodes) if tf is not None]
        pose_frames = {self._frame_of(topic, node) for topic in self._candidates for node in nodes}
        all_frames = {frame for tf in tf_frames for frame in tf.frames} | pose_frames
        tops = [frame for tf in tf_frames for frame in tf.tops]
        usual = [frame for frame in USUAL_FRAMES if frame in all_frames]
        frames = [*usual, *sorted(filter(None, pose_frames)), *tops]
        if frames:
            return frames[0]
        return WGS84 if self._fix_topics() else USUAL_FRAMES[0]

    def _tf(self) -> list[ArraySource]:
        """Return the stored topics of tf, that of moving transforms first; none on the Earth."""
        if self._on_earth:
            return []
        topics = (find_stored(self._stored.find, name) for name in (TF, TF_STATIC))
        return [topic for topic in topics if topic is not None]

    def _named_topic(self) -> ArraySource | None:
        """Return the topic that was given as the robot; None if it is a frame."""
        if not self._robot:
            return None
        topic = find_stored(self._stored.find, self._robot)
        tells = tells_fixes if self._on_earth else tells_poses
        return topic if topic is not None and tells(topic) else None

    @cached_property
    def _candidates(self) -> list[ArraySource]:
        """Return the topics that may give a robot's poses without being named."""
        if self._robot:
            return []
        return [
            topic
            for topic in self._stored.topics()
            if any(table.msg_type in self._types for table in topic.tables)
            and tells_robot(topic, self._frame)
        ]

    def _of_runs(self, node: str, named: ArraySource | None) -> Robot | None:
        """Return the robot of a node by the poses of the runs, else by the poses of all runs."""
        robot = None if self._writers is None else self._of_node(node, named, self._writers)
        return robot or self._of_node(node, named, None)

    def _of_node(self, node: str, named: ArraySource | None, writers: Writers) -> Robot | None:
        """Return the robot of a node by the poses of some runs; None if these are in no such frame.

        Raises:
            InvalidOption: Several frames of tf, or several topics, may be meant.
        """

        def of_topic(topic: ArraySource) -> Robot:
            return Robot(node, topic, self._frame, "", self._stored.find, writers)

        if named is not None:
            if writers is not None and key_after(named, -1, node, writers) is None:
                return None
            frame = self._frame_of(named, node, writers)
            return of_topic(named) if frame in (self._frame, "") else None
        tf = None if self._on_earth else self._find_frames(node, writers)
        if tf is not None and self._frame in tf.frames:
            return self._in_tf(node, tf, writers)
        if self._robot:
            return None
        topics = [t for t in self._candidates if self._frame_of(t, node, writers) == self._frame]
        kind = next((kind for kind in self._types if any(_is_of(t, kind) for t in topics)), "")
        candidates = [topic for topic in topics if _is_of(topic, kind)]
        if len(candidates) > 1:
            names = " and ".join(topic.name for topic in candidates)
            raise InvalidOption(
                f"{names} tell poses in frame {self._frame!r}; say which is meant, as "
                f"{self._example(self._frame, candidates[0].name)}"
            )
        return of_topic(candidates[0]) if candidates else None

    def _in_tf(self, node: str, tf: TfFrames, writers: Writers) -> Robot | None:
        """Return the robot of a node by tf, which has the frame; errors as ``_of_node``."""
        name = self._robot.lstrip("/")
        if name and name not in tf.frames:
            return None
        if not name:
            others = [robot for robot in tf.robots if robot != self._frame]
            if len(others) != 1:
                what, example = " and ".join(others) or "no frame", (others or ["base_link"])[0]
                raise InvalidOption(
                    f"{what} may be the robot{f' of node {node}' if node else ''}; say which frame "
                    f"moves, as {self._example(self._frame, example)}"
                )
            name = others[0]
        moving = self._tf()[0]
        return Robot(node, moving, self._frame, name, self._stored.find, writers)

    def _frame_of(self, topic: ArraySource, node: str, writers: Writers = None) -> str:
        """Return the frame of a topic's poses, and note it for the text of an error.

        '' = its type has no frame; _NO_FIX = no message has a position on the Earth.
        """
        if self._on_earth:
            fixes = PoseTopic(self._stored.find, topic.name, node, writers, frame=WGS84)
            frame = WGS84 if fixes.holds_any() else _NO_FIX
        else:
            frame = PoseTopic(self._stored.find, topic.name, node, writers).frame
        self._told.setdefault(topic.name, []).append(frame or _NO_FRAME_NAME)
        return frame

    def _unknown_robots(self, nodes: Sequence[str] | None, stored: set[str]) -> str:
        """Say that none of the asked nodes has poses, with similar ones; '' = one has."""
        if nodes is None or stored.intersection(nodes):
            return ""
        similar = "".join(nearest(node, sorted(stored)) for node in nodes)
        return f"no pose of robot {' or '.join(map(repr, nodes))} is stored{similar}"

    def _example(self, frame: str, *robot: str) -> str:
        """Return an example of NEAR in a frame, for the text of an error."""
        place = "latitude, longitude" if frame == WGS84 else "x, y"
        return f"NEAR({place}, radius IN {', '.join(map(repr, (frame, *robot)))})"

    def _no_pose(self, nodes: Sequence[str]) -> str:
        """Say that no pose of some nodes is in the frame, and in which frames there are poses."""
        if self._on_earth:
            whose = " or ".join(sorted(self._told)) or "these runs"
            return f"no latitude and longitude is stored: no message of {whose} has a fix"
        all_frames: set[str] = set()
        for node in nodes:
            tf = self._find_frames(node)
            all_frames |= set() if tf is None else tf.frames
        of = f" of {self._robot}" if self._robot else ""
        text = f"no pose{of} in frame {self._frame!r} is stored"
        if self._robot and not self._told and self._robot.lstrip("/") not in all_frames:
            text = f"{self._robot!r} is not a frame of tf, and no topic of poses"
        if all_frames:
            text += f"; the frames of tf are {', '.join(sorted(all_frames)[:20])}"
        example = "odom"
        for topic, frames in self._told.items():
            text += f"; {topic} tells poses in {', '.join(sorted(set(frames)))}"
            example = next(iter(sorted(set(frames) - {_NO_FRAME_NAME})), example)
        names = all_frames.union(*self._told.values()) - {_NO_FRAME_NAME}
        for name in sorted({self._frame, self._robot} - names - {""}):
            text += nearest(name, sorted(names))
        return f"{text}: name another frame, as {self._example(example)}{self._earth_hint()}"


def _is_of(topic: ArraySource, kind: str) -> bool:
    return any(table.msg_type == kind for table in topic.tables)
