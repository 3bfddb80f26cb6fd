# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot, or a sensor on it, was at many times: poses as numpy arrays.

``poses_in_frame`` takes them from recorded tf, ``poses_of_topic`` from a topic that tells poses.
Each gives a ``Poses``, of one robot:

    poses = poses_in_frame(store.getTopic, "base_link", "map", node="husky")
    found, known = poses.at(times)          # ns; x, y, yaw: found.x[known], found.y[known], …
    for track in poses.tracks(start, end):  # every recorded pose: track.times, track.poses.x, …
        …

Memory is bounded: what was recorded is read by stretches of MAX_SPAN_NS, and what two calls have in
common is read once when the times of the calls ascend.
"""

from __future__ import annotations

from typing import Iterator, Optional, Protocol, Tuple

import numpy as np

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.places.frame_poses import TF, TF_STATIC, Chain, Frames
from cassandra_ros.places.pose_samples import NO_FRAME, Codes, Flags, Placed, Samples, Times, Track
from cassandra_ros.places.pose_topic import PoseTopic
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.places.sources import Find
from cassandra_ros.query.source import Writers

LONGEST_GAP_SEC = 10.0
"""Between two recorded poses that are further apart nobody knows where the robot was."""
REACH_NS = 10 * SECOND_NS
"""At least so far around a row key poses are read, on both sides."""
MAX_SPAN_NS = 120 * SECOND_NS
"""Of row keys whose poses are read together."""


class Recording(Protocol):
    """What tells poses: a chain of frames, or a topic."""

    frame: str
    """The frame in which they are; '' where it is not told."""

    def read(self, low: int, high: int) -> Samples:
        """Read what was recorded in [low, high], row keys, ns."""

    def placed(self, samples: Samples, times: Times, stamped: bool, longest_gap_ns: int) -> Placed:
        """Return the poses at some times, ns, out of samples around them."""

    def on_way(self, samples: Samples) -> Flags:
        """Say which samples have a say in the poses."""

    def next_key(self, time: int) -> Optional[int]:
        """Return the first row key behind a time, ns; None where there is none."""

    def explain(self, time: int) -> str:
        """Say why there is no pose at a time; '' where that cannot be told."""


class Poses:
    """Where something was at any time. For one thread.

    Args:
        recording: Tells poses.
        longest_gap_sec: Between two recorded poses that are further apart nothing is known.

    Attributes:
        frame: The frame in which the poses are, without a slash in front; '' where a topic does
            not tell it.

    Raises:
        InvalidOption: The gap is no positive number of seconds.
    """

    def __init__(self, recording: Recording, longest_gap_sec: float = LONGEST_GAP_SEC) -> None:
        if not 0 < longest_gap_sec < float(MAX_NS // SECOND_NS):
            raise InvalidOption(
                f"longest_gap={longest_gap_sec!r} is no length of time: give seconds above 0"
            )
        self._recording = recording
        self._gap = round(longest_gap_sec * SECOND_NS)
        self._reach = max(REACH_NS, self._gap)
        self._held: Tuple[int, int, Samples] = (0, -1, Samples.none())
        """Ends of the row keys that were read last, both included, and what lay there."""
        self.frame = recording.frame

    def at(self, keys: Times, stamps: Optional[Times] = None) -> Placed:
        """Return the poses at the times at which messages were received, or at their stamps.

        Args:
            keys: Row keys of messages, or any times, ns; in any order.
            stamps: Of their headers, ns: the poses are then those at the stamps, by the stamps of
                what was recorded around the keys. None = at the keys, by when it was received.

        Returns:
            A pose for each, and whether it is known: it is interpolated between the pose before
            and that behind, both included, and never extrapolated.
        """
        keys = np.asarray(keys, np.int64)
        times = keys if stamps is None else np.asarray(stamps, np.int64)
        poses, known = Rigid.none(len(keys)), np.zeros(len(keys), bool)
        order = np.argsort(keys, kind="stable")
        for rows in self._together(keys, order):
            low, high = int(keys[rows[0]]), int(keys[rows[-1]])
            samples = self._samples(low - self._reach, high + self._reach)
            placed = self._recording.placed(samples, times[rows], stamps is not None, self._gap)
            poses.put(rows, placed.poses)
            known[rows] = placed.known
        return Placed(poses, known)

    def tracks(self, low: int, high: int, stamped: bool = False) -> Iterator[Track]:
        """Walk through all recorded poses that were received in [low, high], ns, by time.

        A pose comes for each time at which one of the frames on the way was recorded, or the
        topic told one, where the others are known. Each track is a stretch of at most MAX_SPAN_NS.

        Args:
            stamped: The times are the stamps of headers instead of those of reception.
        """
        start, high = max(0, low), min(high, MAX_NS)
        while start <= high:
            end = min(high, start + MAX_SPAN_NS - 1)
            around = self._samples(start - self._reach, end + self._reach)
            mine = (around.keys >= start) & (around.keys <= end) & self._recording.on_way(around)
            if mine.any():
                times = np.unique(around.times(stamped)[mine])
                poses, known = self._recording.placed(around, times, stamped, self._gap)
                parents: Codes = np.full(int(known.sum()), NO_FRAME)
                if known.any():
                    yield Track(times[known], parents, poses.take(known))
            later = around.keys[around.keys > end]
            if len(later):
                start = max(end + 1, int(later.min()))
            else:
                start = self._next_key(end + self._reach)

    def _next_key(self, time: int) -> int:
        """Return a row key behind a time before which nothing was recorded."""
        found = self._recording.next_key(time)
        return MAX_NS + 1 if found is None else found

    def explain(self, time: int) -> str:
        """Say why the pose at a time is not known."""
        return self._recording.explain(time) or (
            f"the recorded poses around that time are more than {self._gap / SECOND_NS:g} s apart"
        )

    def _together(self, keys: Times, order: Codes) -> Iterator[Codes]:
        """Cut sorted keys where too long a stretch would be read for them."""
        ordered = keys[order]
        gaps = np.flatnonzero(np.diff(ordered) > 2 * self._reach) + 1
        start = 0
        while start < len(order):
            behind = int(np.searchsorted(ordered, ordered[start] + MAX_SPAN_NS, side="right"))
            gap = int(np.searchsorted(gaps, start, side="right"))
            end = min(behind, int(gaps[gap]) if gap < len(gaps) else len(order))
            yield order[start:end]
            start = end

    def _samples(self, low: int, high: int) -> Samples:
        """Return what was recorded in a stretch of row keys; what is held is not read again."""
        low, high = max(0, low), min(high, MAX_NS)
        first, last, held = self._held
        if first <= low <= last + 1 and low <= high:
            if high > last:
                held = held.within(low, last).followed(self._recording.read(last + 1, high))
                self._held = (low, high, held)
        else:
            self._held = (low, high, self._recording.read(low, high))
        return self._held[2].within(low, high)


def poses_in_frame(
    find: Find,
    of: str,
    frame: str,
    *,
    node: Optional[str] = None,
    writers: Writers = None,
    tf: str = TF,
    tf_static: str = TF_STATIC,
    longest_gap_sec: float = LONGEST_GAP_SEC,
) -> Poses:
    """Return where a frame was in another, from recorded tf.

    Args:
        find: Returns a topic by its name, as RosCassandra.getTopic does.
        of: The frame that moves, as 'base_link' or 'laser'; a slash in front does not count.
        frame: The frame in which its poses are, as 'map' or 'odom'.
        node: nodeID of the robot; None = of all.
        writers: Only what these recorded, as Runs.writers finds them; None = all.
        tf, tf_static: Names of the topics; one of them may be missing.
        longest_gap_sec: Between two transforms that are further apart nothing is known.

    Raises:
        TopicNotFound: Neither topic is stored.
        TypeMismatch: One of them holds no transforms.
        InvalidName, InvalidOption.
    """
    return Poses(Chain(Frames(find, node, writers, tf, tf_static), of, frame), longest_gap_sec)


def poses_of_topic(
    find: Find,
    topic: str,
    *,
    offset: Optional[Rigid] = None,
    node: Optional[str] = None,
    writers: Writers = None,
    longest_gap_sec: float = LONGEST_GAP_SEC,
) -> Poses:
    """Return where a robot was, from a topic of Odometry, PoseStamped or the like.

    Args:
        find: Returns a topic by its name, as RosCassandra.getTopic does.
        topic: Its name. Types are known by their fields: pose.pose, pose, position and
            orientation, transform; x, y and theta.
        offset: A pose on the robot whose own poses are asked for, as that of a sensor.
        node, writers, longest_gap_sec: As poses_in_frame takes them.

    Raises:
        TopicNotFound, TypeMismatch: It is not stored; it tells no poses.
        InvalidName, InvalidOption.
    """
    return Poses(PoseTopic(find, topic, node, writers, offset), longest_gap_sec)
