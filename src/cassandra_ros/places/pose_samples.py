# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded transforms and poses of a time range as arrays, and the interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.places.rigid import Floats, Rigid, between

Times = NDArray[np.int64]
"""Times, ns since 1970."""
Codes = NDArray[np.int64]
"""Frame numbers."""
Flags = NDArray[np.bool_]

NO_FRAME = -1
_UNIT = 10e-3
"""Maximum deviation of the squared norm of a rotation from 1 that tf2 accepts."""


class KnownPoses(NamedTuple):
    """Poses at many times."""

    poses: Rigid
    """One pose for each time; the identity if it is unknown."""
    known: Flags
    """For each time, whether a pose was recorded at it, or one before and one after it."""


@dataclass(frozen=True)
class Track:
    """Poses of one frame over time; times are unique and ascending."""

    times: Times
    parents: Codes
    """Parent frame of each pose."""
    poses: Rigid

    def at(self, times: Times, longest_gap_ns: int) -> tuple[KnownPoses, Codes]:
        """Interpolate as tf2 does; return the poses and their parent frames.

        Between poses in two different frames the earlier one is used. Without a pose the parent is
        NO_FRAME. Between poses further apart than the gap nothing is known.
        """
        count = len(self.times)
        if not count:
            nowhere = np.full(len(times), NO_FRAME)
            return KnownPoses(Rigid.none(len(times)), np.zeros(len(times), bool)), nowhere
        before = np.searchsorted(self.times, times, side="right") - 1
        has_before = before >= 0
        before = np.maximum(before, 0)
        after = np.minimum(before + 1, count - 1)
        exact = has_before & (self.times[before] == times)
        gap = self.times[after] - self.times[before]
        valid = exact | (has_before & (after > before) & (gap <= longest_gap_ns))
        steady = exact | (self.parents[before] != self.parents[after]) | (gap <= 0) | ~valid
        share = np.where(steady, 0, (times - self.times[before]) / np.maximum(gap, 1))
        poses = between(self.poses.take(before), self.poses.take(after), share)
        poses.put(~valid, Rigid.none(int((~valid).sum())))
        return KnownPoses(poses, valid), np.where(valid, self.parents[before], NO_FRAME)


@dataclass(frozen=True)
class Samples:
    """Recorded transforms in the order of arrival."""

    keys: Times
    """Row keys (receive times), ns since 1970."""
    stamps: Times
    """Header stamps, ns since 1970."""
    parents: Codes
    children: Codes
    poses: Rigid
    """Poses of the child frames in their parent frames."""

    @classmethod
    def none(cls) -> Samples:
        """Return an empty object."""
        empty = np.zeros(0, np.int64)
        return cls(empty, empty, empty, empty, Rigid.none(0))

    @classmethod
    def checked(
        cls, keys: Times, stamps: Times, parents: Codes, children: Codes, numbers: Floats
    ) -> Samples:
        """Return the samples that tf2 accepts: (n, 7) finite numbers, with unit quaternions."""
        finite = np.isfinite(numbers).all(1)
        lengths = (numbers[:, 3:] ** 2).sum(1)
        good = finite & (np.abs(lengths - 1) < _UNIT)
        good &= (parents != children) & (parents != NO_FRAME) & (children != NO_FRAME)
        columns = (keys[good], stamps[good], parents[good], children[good])
        return cls(*columns, Rigid.of_numbers(numbers[good]))

    def __len__(self) -> int:
        return len(self.keys)

    def within(self, low: int, high: int) -> Samples:
        """Return the samples with a row key in [low, high], ns."""
        return self.take((self.keys >= low) & (self.keys <= high))

    def take(self, rows: Flags) -> Samples:
        """Return some of the samples."""
        return Samples(
            self.keys[rows],
            self.stamps[rows],
            self.parents[rows],
            self.children[rows],
            self.poses.take(rows),
        )

    def followed(self, others: Samples) -> Samples:
        """Return these samples and those that arrived after them."""
        return Samples(
            np.concatenate([self.keys, others.keys]),
            np.concatenate([self.stamps, others.stamps]),
            np.concatenate([self.parents, others.parents]),
            np.concatenate([self.children, others.children]),
            Rigid(
                np.concatenate([self.poses.moved, others.poses.moved]),
                np.concatenate([self.poses.turned, others.poses.turned]),
            ),
        )

    def track(self, child: int, stamped: bool) -> Track:
        """Return the track of one frame, by stamps if ``stamped``, else by receive times.

        Of samples with equal times the first is used.
        """
        of_child = np.flatnonzero(self.children == child)
        times = self.stamps if stamped else self.keys
        # np.unique returns the index of the first of equal values.
        unique_times, first = np.unique(times[of_child], return_index=True)
        rows = of_child[first]
        return Track(unique_times, self.parents[rows], self.poses.take(rows))
