# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tree of frames at one time, as far as it is known: ways up, and the path between two."""

from __future__ import annotations

from typing import Optional

from cassandra_ros.transforms.samples import Fixed, Nearest, Sample


class Tree:
    """The frames at a time.

    Args:
        nearest: The moving transforms next to the time.
        fixed: Those that hold at every time; a frame among them counts as fixed.
    """

    def __init__(self, nearest: Nearest, fixed: Fixed) -> None:
        self.nearest = nearest
        self.fixed = fixed

    def frames(self) -> set[str]:
        """List all frames that were found, also at other times."""
        moving, fixed = self.nearest, self.fixed
        return {*moving.before, *moving.after, *moving.parents, *fixed.before, *fixed.parents}

    def climb(self, frame: str) -> list[str]:
        """Return the frames from one upwards, as far as the time has transforms."""
        way = [frame]
        while True:
            sample = self.fixed.at(way[-1]) or self.nearest.at(way[-1])
            if sample is None or sample.parent in way:
                return way
            way.append(sample.parent)

    def path(self, target: str, source: str) -> Optional[list[str]]:
        """Return the child frames between two frames; None where nothing connects them yet."""
        down, up = self.climb(target), self.climb(source)
        meeting = next((frame for frame in up if frame in down), None)
        if meeting is None:
            return None
        return up[: up.index(meeting)] + down[: down.index(meeting)]

    def moving(self, frames: list[str]) -> list[Sample]:
        """Return the transforms before the time of those frames that move."""
        before, fixed = self.nearest.before, self.fixed.before
        return [before[frame] for frame in frames if frame in before and frame not in fixed]

    def loop(self, frame: str) -> Optional[list[str]]:
        """Return the loop into which the way up from a frame leads, or None."""
        way = self.climb(frame)
        sample = self.fixed.at(way[-1]) or self.nearest.at(way[-1])
        return None if sample is None else [*way[way.index(sample.parent) :], sample.parent]
