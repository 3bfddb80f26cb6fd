# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reads as much of the recorded transforms as a time needs.

What is asked goes by the stamps in the headers, what is read by the row keys. The two lie
milliseconds apart, or years: in a bag that was replayed, or where a clock was wrong.
"""

from __future__ import annotations

from typing import Optional, Sequence

from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.transforms.paths import Tree
from cassandra_ros.transforms.samples import Recorded, Sample

FIRST_REACH_NS = 2 * SECOND_NS
"""How far from a row key, on both sides, is read at first."""
_MAX_JUMPS = 8


class Search:
    """Fills a tree with transforms until it has a path between two frames that more cannot change.

    Args:
        recorded: The moving transforms; None = there are none.
        tree: Of the time that is asked.
        frames: Target and source.
    """

    def __init__(self, recorded: Optional[Recorded], tree: Tree, frames: Sequence[str]) -> None:
        self.tree = tree
        self._recorded = recorded
        self._target, self._source = frames
        self._windows: list[tuple[int, int]] = []
        """Stretches of row keys that were read; the last one is still being widened."""
        self._ends: Optional[tuple[int, int]] = None

    @property
    def last(self) -> int:
        """The last row key, ns; 0 where there is none."""
        return self._first_last()[1]

    def run(self, centre: int) -> Optional[list[str]]:
        """Read around a row key, ns, then wider, and return the path's child frames.

        Returns:
            None where nothing connects the frames at the time, and everything was read.
        """
        reach = FIRST_REACH_NS
        path = self._path()
        while path is None and not self._isWhole():
            jump = self._elsewhere(centre) if self._windows else None
            if jump is not None:
                centre, reach = jump, FIRST_REACH_NS
            elif self._windows:
                reach *= 2
            self._read(centre, reach)
            path = self._path()
        return path if path is not None else self.tree.path(self._target, self._source)

    def _path(self) -> Optional[list[str]]:
        """Return the path if more transforms cannot change it."""
        path = self.tree.path(self._target, self._source)
        if path is None:
            return None
        if not path and self.tree.nearest.time is None:
            return path if self._windows else None  # a frame to itself: its newest time
        return path if all(self._isNearest(s) for s in self.tree.moving(path)) else None

    def _isNearest(self, before: Sample) -> bool:
        """Say whether a nearer transform would have been read.

        It would have come between the two that are known, had its delay been between theirs.
        """
        nearest = self.tree.nearest
        if nearest.time in (None, before.stamp):
            return True
        after = nearest.after[before.child]
        delays = before.delay, after.delay
        low, high = before.stamp + min(delays), after.stamp + max(delays)
        return any(start <= low and high <= end for start, end in self._windows)

    def _isWhole(self) -> bool:
        if self._recorded is None:
            return True
        if not self._windows:
            return False
        first, last = self._first_last()
        start, end = self._windows[-1]
        return start <= first and last <= end

    def _first_last(self) -> tuple[int, int]:
        if self._ends is None:
            self._ends = (self._recorded and self._recorded.ends()) or (0, 0)
        return self._ends

    def _read(self, centre: int, reach: int) -> None:
        low, high = max(0, centre - reach), min(MAX_NS, centre + reach)
        if reach == FIRST_REACH_NS:
            self._windows.append((low, high))
            self._take(low, high)
            return
        start, end = self._windows[-1]
        self._windows[-1] = (low, high)
        first, last = self._first_last()
        self._take(max(low, first), start - 1)
        self._take(end + 1, min(high, last))

    def _take(self, low: int, high: int, **options: object) -> None:
        if low <= high and self._recorded is not None:
            self._recorded.read(self.tree.nearest, low, high, **options)

    def _elsewhere(self, centre: int) -> Optional[int]:
        """Return a row key around which the missing transforms may lie, not yet read.

        They are as much delayed, perhaps, as the nearest ones that are known.
        """
        nearest = self.tree.nearest
        if nearest.time is None or len(self._windows) > _MAX_JUMPS:
            return None
        if not nearest.all():
            self._take(0, centre, limit=1, reverse=True)
            self._take(centre, MAX_NS, limit=1)
        ends = {self.tree.climb(frame)[-1] for frame in (self._target, self._source)}
        known = [s for s in nearest.all() if s.child in ends] or nearest.all()
        for sample in sorted(known, key=lambda s: abs(s.stamp - (nearest.time or 0)))[:4]:
            guess = nearest.time + sample.delay
            if 0 <= guess <= MAX_NS and not self._isRead(guess):
                return guess
        return None

    def _isRead(self, key: int) -> bool:
        return any(start <= key <= end for start, end in self._windows)
