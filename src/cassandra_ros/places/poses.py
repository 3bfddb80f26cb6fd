# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a robot, or of a sensor on it, at many times, as numpy arrays.

A ``Poses`` object has those of one source: frames of recorded tf (``FrameChain``), or a topic of
poses (``PoseTopic``):

    poses = Poses(FrameChain(TfRecording(find, "husky"), "base_link", "map"))
    rigid, known = poses.at(times)          # ns; x, y, yaw: rigid.x[known], rigid.y[known], …
    for track in poses.tracks(start, end):  # every recorded pose: track.times, track.poses.x, …
        …

Memory is bounded: recorded poses are read in time ranges of MAX_SPAN_NS. If the times of two calls
ascend, the data that both need is read once.
"""

from __future__ import annotations

from typing import Iterator, Protocol

import numpy as np

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.places.pose_samples import (
    NO_FRAME,
    Codes,
    Flags,
    KnownPoses,
    Samples,
    Times,
    Track,
)
from cassandra_ros.places.rigid import Rigid

LONGEST_GAP_SEC = 10.0
"""Maximum time between two recorded poses with known poses in between, s."""
POSE_REACH_NS = 10 * SECOND_NS
"""Minimum distance from a row key, on both sides, in which poses are read, ns."""
MAX_SPAN_NS = 120 * SECOND_NS
"""Maximum length of the range of row keys whose poses are read together, ns."""


class PoseSource(Protocol):
    """A source of poses: a chain of frames, or a topic."""

    frame: str
    """Frame in which the poses are; '' if unknown."""

    def read(self, low: int, high: int) -> Samples:
        """Return the samples with a row key in [low, high], ns."""

    def placed(
        self, samples: Samples, times: Times, stamped: bool, longest_gap_ns: int
    ) -> KnownPoses:
        """Return the poses at some times, ns, computed from the samples around them."""

    def on_way(self, samples: Samples) -> Flags:
        """Return which samples affect the poses."""

    def next_key(self, time: int) -> int | None:
        """Return the first row key after a time, ns; None if there are no later rows."""

    def explain(self, time: int) -> str:
        """Return why there is no pose at a time, as a text; '' if the reason is unknown."""


class Poses:
    """Poses of one frame at any time. For use by one thread.

    Args:
        source: Source of the poses.
        longest_gap_sec: Maximum time between two recorded poses with known poses in between, s.

    Attributes:
        frame: Frame in which the poses are, without a slash in front; '' if a topic does not give
            it.

    Raises:
        InvalidOption: The gap is not a positive number of seconds.
    """

    def __init__(self, source: PoseSource, longest_gap_sec: float = LONGEST_GAP_SEC) -> None:
        if not 0 < longest_gap_sec < float(MAX_NS // SECOND_NS):
            raise InvalidOption(
                f"longest_gap={longest_gap_sec!r} is not a length of time: give seconds above 0"
            )
        self._source = source
        self._gap = round(longest_gap_sec * SECOND_NS)
        self._reach = max(POSE_REACH_NS, self._gap)
        self._held: tuple[int, int, Samples] = (0, -1, Samples.none())
        """First and last row key of the range that was read last, both included, and its
        samples."""
        self.frame = source.frame

    def at(self, keys: Times, stamps: Times | None = None) -> KnownPoses:
        """Return the poses at the receive times of messages, or at their stamps.

        Args:
            keys: Row keys of messages, or any times, ns; in any order.
            stamps: Header stamps, ns. If given, the poses at the stamps are returned, by the stamps
                of the samples recorded around the keys. None = at the keys, by the samples' receive
                times.

        Returns:
            A pose for each time, and whether it is known: it is interpolated between the recorded
            poses before and after it, both included, and never extrapolated.
        """
        keys = np.asarray(keys, np.int64)
        times = keys if stamps is None else np.asarray(stamps, np.int64)
        poses, valid = Rigid.none(len(keys)), np.zeros(len(keys), bool)
        order = np.argsort(keys, kind="stable")
        for rows in self._together(keys, order):
            low, high = int(keys[rows[0]]), int(keys[rows[-1]])
            samples = self._samples(low - self._reach, high + self._reach)
            known_poses = self._source.placed(samples, times[rows], stamps is not None, self._gap)
            poses.put(rows, known_poses.poses)
            valid[rows] = known_poses.known
        return KnownPoses(poses, valid)

    def tracks(self, low: int, high: int) -> Iterator[Track]:
        """Yield all recorded poses that were received in [low, high], ns, in time order.

        There is one pose for each receive time at which a frame on the path (or the topic) was
        recorded and the other frames are known. Each track covers at most MAX_SPAN_NS.
        """
        start, high = max(0, low), min(high, MAX_NS)
        while start <= high:
            end = min(high, start + MAX_SPAN_NS - 1)
            around = self._samples(start - self._reach, end + self._reach)
            mine = (around.keys >= start) & (around.keys <= end) & self._source.on_way(around)
            if mine.any():
                times = np.unique(around.keys[mine])
                poses, valid = self._source.placed(around, times, False, self._gap)
                parents: Codes = np.full(int(valid.sum()), NO_FRAME)
                if valid.any():
                    yield Track(times[valid], parents, poses.take(valid))
            later = around.keys[around.keys > end]
            if len(later):
                start = max(end + 1, int(later.min()))
            else:
                start = self._next_key(end + self._reach)

    def _next_key(self, time: int) -> int:
        """Return a row key after a time such that nothing was recorded in between."""
        key = self._source.next_key(time)
        return MAX_NS + 1 if key is None else key

    def explain(self, time: int) -> str:
        """Return why the pose at a time is unknown, as a text."""
        return self._source.explain(time) or (
            f"the recorded poses around that time are more than {self._gap / SECOND_NS:g} s apart"
        )

    def _together(self, keys: Times, order: Codes) -> Iterator[Codes]:
        """Cut sorted keys into groups, so that none needs too long a range of samples."""
        times = keys[order]
        gaps = np.flatnonzero(np.diff(times) > 2 * self._reach) + 1
        start = 0
        while start < len(order):
            span_end = int(np.searchsorted(times, times[start] + MAX_SPAN_NS, side="right"))
            gap = int(np.searchsorted(gaps, start, side="right"))
            end = min(span_end, int(gaps[gap]) if gap < len(gaps) else len(order))
            yield order[start:end]
            start = end

    def forget(self) -> None:
        """Read all samples anew, because there may be later ones."""
        self._held = (0, -1, Samples.none())

    def _samples(self, low: int, high: int) -> Samples:
        """Return the samples of a range of row keys; those that are held are not read again."""
        low, high = max(0, low), min(high, MAX_NS)
        first, last, samples = self._held
        if first <= low <= last + 1 and low <= high:
            if high > last:
                samples = samples.within(low, last).followed(self._source.read(last + 1, high))
                self._held = (low, high, samples)
        else:
            self._held = (low, high, self._source.read(low, high))
        return self._held[2].within(low, high)
