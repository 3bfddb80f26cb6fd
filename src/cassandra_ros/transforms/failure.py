# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What to say when there is no transform: which frame lacks what, and what there is instead."""

from __future__ import annotations

import difflib
from typing import Any, Optional, Sequence

from cassandra_ros.errors import LookupException, TransformException
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import isoTime
from cassandra_ros.transforms.paths import Tree

_SECONDS_BELOW = 10**12
_SHOWN_FRAMES = 20


class Failure:
    """The texts of the errors of one question.

    Args:
        frames: Target and source.
        topics: What to call those of the moving and of the fixed transforms.
        nodeID: The node that was asked for, or None.
        asked: The time as the user gave it.
    """

    def __init__(
        self, frames: tuple[str, str], topics: Sequence[str], nodeID: Optional[str], asked: Any
    ) -> None:
        self.frames = frames
        self._topics = topics
        self._whose = "" if nodeID is None else f" of node {nodeID}"
        self._asked = asked

    def text(self, kind: type[TransformException], tree: Tree) -> str:
        """Say what is wrong.

        Args:
            kind: What tf2 said.
            tree: All that was found in the topics.
        """
        frames, time = tree.frames(), tree.nearest.time
        absent = [frame for frame in self.frames if frame not in frames]
        if absent:
            return self._absent(absent[0], sorted(frames), tree)
        target, source = self.frames
        at = "" if time is None else f" at {_shown(time)}"
        text = f"there is no transform from {source} to {target}{at}: "
        loop = tree.loop(source) or tree.loop(target)
        if kind is LookupException and loop:
            return text + f"the frames {' -> '.join(loop)} form a loop in {self._where()}"
        text += self._gap(tree) or self._apart(tree)
        if type(self._asked) is int and 0 < self._asked < _SECONDS_BELOW:
            text += "; integers are nanoseconds; did you mean seconds (a float)?"
        return text

    def _absent(self, frame: str, frames: list[str], tree: Tree) -> str:
        near = difflib.get_close_matches(frame, frames, n=3, cutoff=0.5)
        if near:
            hint = f"did you mean {' or '.join(near)}?"
        elif frames:
            more = ", …" if len(frames) > _SHOWN_FRAMES else ""
            hint = f"the frames are {', '.join(frames[:_SHOWN_FRAMES])}{more}"
        else:
            hint = "there is no transform at all"
        return f"frame {frame!r} is not in {self._where()}{_ignored(frame, tree)}; {hint}"

    def _gap(self, tree: Tree) -> str:
        """Say for which frame the time lies outside; '' where it does for none."""
        nearest = tree.nearest
        if nearest.time is None:
            return ""
        for frame in dict.fromkeys(tree.climb(frame)[-1] for frame in self.frames):
            before, after = nearest.before.get(frame), nearest.after.get(frame)
            sample = before or after
            if sample is None or nearest.at(frame):
                continue
            away = abs(sample.stamp - nearest.time) / SECOND_NS
            which = "last" if before else "first"
            return (
                f"the {which} transform of frame {frame} on {self._topics[0]}{self._whose} "
                f"is at {_shown(sample.stamp)}, {away:.9g} s {'before' if before else 'after'}"
                f"{_ignored(frame, tree)}; ask for a time within what was recorded, or for the "
                "time 0, which means the newest"
            )
        return ""

    def _apart(self, tree: Tree) -> str:
        target, source = (tree.climb(frame) for frame in self.frames)
        tops = [f"{way[0]} hangs on {way[-1]}" for way in (source, target) if len(way) > 1]
        how = f": {', '.join(tops)}" if tops else ""
        left_out = "".join(_ignored(way[-1], tree) for way in (source, target))
        return f"nothing in {self._where()} connects them{how}{left_out}"

    def _where(self) -> str:
        return f"{' and '.join(self._topics)}{self._whose}"


def _shown(ns: int) -> str:
    return f"{isoTime(ns)} ({ns} ns)"


def _ignored(frame: str, tree: Tree) -> str:
    reason = tree.nearest.ignored.get(frame) or tree.fixed.ignored.get(frame)
    return f" (some of frame {frame} are left out, as tf2 does: {reason})" if reason else ""
