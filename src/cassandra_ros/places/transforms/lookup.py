# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lookup of the transform between two frames at any past time, in the recorded transforms."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Callable, Sequence

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import InvalidName, LookupException, TopicNotFound, TransformException
from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.messages.stamps import SECONDS_BELOW, Stamp, iso_time, to_ns
from cassandra_ros.places.transforms.transform_samples import (
    FixedTransforms,
    FrameTree,
    NearestTransforms,
    TransformTopic,
    name_only,
    read_transforms,
)
from cassandra_ros.query.protocols import Row, Source, Table
from cassandra_ros.read import Writers

if TYPE_CHECKING:
    from geometry_msgs.msg import TransformStamped

_SHOWN_FRAMES = 20


def lookup_transform(
    find: Callable[[str], Source[Row]],
    node: str | None,
    run: Writers,
    target: str,
    source: str,
    time: object,
    tf: str,
    tf_static: str,
) -> TransformStamped:
    """Return the transform that converts points of one frame to another, see RosCassandra.

    ``find`` returns a topic by its name, or raises TopicNotFound.
    """
    frames = (_frame(target), _frame(source))
    check_nodes(node)
    ns = to_ns(time)
    stored: list[TransformTopic | None] = []
    tables: list[Table] = []
    for name in (tf, tf_static):
        try:
            tf_topic = find(name)
        except TopicNotFound:
            stored.append(None)
            continue
        stored.append(TransformTopic(tf_topic, node, run))
        tables += tf_topic.tables
    if stored == [None, None]:
        find(tf)  # raises TopicNotFound with similar names
    topics = [
        f"topic {name}{'' if topic else ' (which is not stored)'}"
        for name, topic in zip((tf, tf_static), stored)
    ]
    moving_topic, fixed_topic = stored
    fixed = FixedTransforms()
    if fixed_topic is not None:
        # Newest first, so that older transforms of the same frames are skipped without reading
        # them.
        fixed_topic.read(fixed, 0, MAX_NS, reverse=True)
    lookup = _Lookup(moving_topic, fixed, LookupErrors(frames, topics, node, time, tables))
    return lookup.at(ns) if ns else lookup.newest()


def _frame(name: object) -> str:
    """Return a frame name as tf2 expects it."""
    frame = name.lstrip("/") if isinstance(name, str) else ""
    try:
        if frame and "\0" not in frame and frame.encode("utf-8"):
            return frame
    except UnicodeEncodeError:
        pass
    raise InvalidName(f"{name!r:.80} is not a name of a frame: give a text like 'base_link'")


@dataclass(frozen=True)
class _Lookup:
    """One lookup."""

    moving: TransformTopic | None
    fixed: FixedTransforms
    failure: LookupErrors

    def at(self, time: int, centre: int | None = None) -> TransformStamped:
        """Return the transform at a time, ns.

        ``centre`` is a row key near the transforms' rows, ns.
        """
        tree = FrameTree(NearestTransforms(time), self.fixed)
        path = read_transforms(
            tree, self.moving, self.failure.frames, time if centre is None else centre
        )
        return self._compute(tree, path, time)

    def newest(self) -> TransformStamped:
        """Return the transform at the newest time that all frames on the path have, as tf2 does."""
        tree, frames = FrameTree(NearestTransforms(None), self.fixed), self.failure.frames
        last = 0 if self.moving is None else self.moving.ends[1]
        path = read_transforms(tree, self.moving, frames, last)
        moving = tree.moving(path or [])
        if not moving and path == []:
            moving = tree.moving([frames[0]])
        if not moving:
            return self._compute(tree, path, None)
        oldest = min(moving)  # by stamp
        return self.at(oldest.stamp, oldest.key)

    def _compute(
        self, tree: FrameTree, path: Sequence[str] | None, time: int | None
    ) -> TransformStamped:
        """Return the transform by tf2, at a time in ns, or (None) by fixed transforms alone.

        Args:
            path: Child frames on the path; [] if both frames are the same, None if they are not
                connected. Then tf2 raises an error.
        """
        fixed = tree.fixed.all()
        moving = [s for s in tree.nearest.all() if s.child not in tree.fixed.before]
        if path:
            # With the other frames, tf2 would go up to the root and back, which adds rounding
            # errors.
            moving, fixed = ([s for s in samples if s.child in path] for samples in (moving, fixed))
        else:
            # tf2's errors depend on which frames it knows.
            frames = tree.frames().intersection(self.failure.frames)
            fixed.extend(name_only(frame) for frame in frames)
        # Imported here because tf2 is needed only for lookups; programs that record may lack it.
        from cassandra_ros.places.transforms.tf_buffer import look_up

        failure = self.failure
        answer = look_up(
            *failure.frames, time, moving, fixed, lambda kind: failure.text(kind, tree)
        )
        answer.header.stamp = Stamp.from_ns(time or 0)
        return answer


@dataclass(frozen=True)
class LookupErrors:
    """Writes the error texts of one lookup."""

    frames: tuple[str, str]
    """Target and source frame."""
    topics: Sequence[str]
    """Names of the topics of moving and fixed transforms, as error texts show them."""
    node: str | None
    user_time: object
    """Time as the user gave it."""
    tables: Sequence[Table]
    """Tables of the topics."""

    def text(self, kind: type[TransformException], tree: FrameTree) -> str:
        """Return the text of an error, from tf2's exception type and the transforms found."""
        frames, time = tree.frames(), tree.nearest.time
        absent = [frame for frame in self.frames if frame not in frames]
        if absent:
            return self._absent(absent[0], sorted(frames), tree)
        target, source = self.frames
        at = "" if time is None else f" at {_time_text(time)}"
        text = f"there is no transform from {source} to {target}{at}: "
        loop = tree.loop(source) or tree.loop(target)
        if kind is LookupException and loop:
            return text + f"the frames {' -> '.join(loop)} form a loop in {self._where()}"
        text += self._gap(tree) or self._apart(tree)
        if type(self.user_time) is int and 0 < self.user_time < SECONDS_BELOW:
            text += "; integers are nanoseconds; did you mean seconds (a float)?"
        return text

    def _absent(self, frame: str, frames: list[str], tree: FrameTree) -> str:
        """Say that a frame is in no transform, with the similar ones of ``frames``, or all."""
        near = difflib.get_close_matches(frame, frames, n=3, cutoff=0.5)
        if near:
            hint = f"did you mean {' or '.join(near)}?"
        elif frames:
            more = ", …" if len(frames) > _SHOWN_FRAMES else ""
            hint = f"the frames are {', '.join(frames[:_SHOWN_FRAMES])}{more}"
        else:
            table = next(iter(self.tables), None)  # a topic without a type has none
            unknown = table is not None and self.node and table.runs.unknown_robot(self.node)
            hint = unknown or "there is no transform at all"
        return f"frame {frame!r} is not in {self._where()}{_skip_hint(frame, tree)}; {hint}"

    def _gap(self, tree: FrameTree) -> str:
        """Return which frame has no transforms around the time; '' if all have."""
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
                f"the {which} transform of frame {frame} on {self.topics[0]}{self._whose()} "
                f"is at {_time_text(sample.stamp)}, {away:.9g} s {'before' if before else 'after'}"
                f"{_skip_hint(frame, tree)}; ask for a time within what was recorded, or for the "
                "time 0, which means the newest"
            )
        return ""

    def _apart(self, tree: FrameTree) -> str:
        """Say that no transforms connect the frames, and up to which frame each one leads."""
        target, source = (tree.climb(frame) for frame in self.frames)
        tops = [f"{way[0]} hangs on {way[-1]}" for way in (source, target) if len(way) > 1]
        how = f": {', '.join(tops)}" if tops else ""
        left_out = "".join(_skip_hint(way[-1], tree) for way in (source, target))
        return f"nothing in {self._where()} connects them{how}{left_out}"

    def _where(self) -> str:
        return f"{' and '.join(self.topics)}{self._whose()}"

    def _whose(self) -> str:
        return f" of node {self.node}" if self.node else ""


def _time_text(ns: int) -> str:
    return f"{iso_time(ns)} ({ns} ns)"


def _skip_hint(frame: str, tree: FrameTree) -> str:
    reason = tree.nearest.ignored.get(frame) or tree.fixed.ignored.get(frame)
    return f" (some of frame {frame} are left out, as tf2 does: {reason})" if reason else ""
