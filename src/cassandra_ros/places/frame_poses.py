# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a frame in another frame, from recorded transforms, for all times of a range at once.

``places/transforms/`` looks up one time with tf2 itself. Here a topic of any length is read once
with numpy, by the same rules: leading slashes of names are ignored, a frame with a fixed transform
is fixed, of transforms with equal stamps the first is used, and transforms that tf2 would reject
are left out.
"""

from __future__ import annotations

from typing import Iterable, NamedTuple, Sequence

import numpy as np

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import TransformException
from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.places.array_source import (
    ArraySource,
    TopicFinder,
    arrays_between,
    find_stored,
    key_after,
)
from cassandra_ros.places.pose_samples import NO_FRAME, Codes, Flags, KnownPoses, Samples, Times
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.places.transforms.lookup import lookup_transform
from cassandra_ros.places.transforms.transform_samples import FixedTransforms, TransformTopic
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.read import Writers

TF, TF_STATIC = "/tf", "/tf_static"
FRAME_SEARCH_NS = 10 * SECOND_NS
"""Distance from a time, on both sides, of the transforms in which frames are searched, ns."""
_NUMBERS = [f"translation.{c}" for c in "xyz"] + [f"rotation.{c}" for c in "xyzw"]
_NAMES = ("transforms.header.frame_id", "transforms.child_frame_id")
_STAMP = "transforms.header.stamp"
_FIELDS = ["KEY", _STAMP, *_NAMES, *(f"transforms.transform.{number}" for number in _NUMBERS)]


class AncestorPath(NamedTuple):
    """The path from a frame up to the root, for all times at which it has the same frames."""

    rows: Codes
    """Indices of these times."""
    frames: tuple[int, ...]
    """Frames of the path, from the frame itself upwards."""
    poses: tuple[Rigid, ...]
    """Poses of the frame itself in each frame of the path."""


class TfRecording:
    """Recorded transforms, of one robot or of all.

    Args:
        find: Returns a topic by its name.
        node: nodeID of the robot; None = all robots.
        writers: Writer ids of the runs; None = all runs.
        tf, tf_static: Topics of the moving and of the fixed transforms; one may be missing.

    Raises:
        TopicNotFound: Neither topic is stored.
        TypeMismatch: A topic holds other messages.
    """

    def __init__(
        self,
        find: TopicFinder,
        node: str | None = None,
        writers: Writers = None,
        tf: str = TF,
        tf_static: str = TF_STATIC,
    ) -> None:
        check_nodes(node)
        self._find, self._node, self._writers = find, node, writers
        self._topics = (tf, tf_static)
        self._codes: dict[str, int] = {}
        self.names: list[str] = []
        """Names of the frames, by frame number."""
        self.recorded: set[str] = set()
        """Names of the frames of the transforms that were read."""
        self.moving = find_stored(find, tf)
        fixed = find_stored(find, tf_static)
        if self.moving is None and fixed is None:
            find(tf)  # raises TopicNotFound with similar names
        if self.moving is not None:
            TransformTopic(self.moving, node, writers)  # raises TypeMismatch for other messages
        self.fixed = self._read_fixed(fixed)
        """Parent and pose of each fixed frame, by frame number."""

    def _read_fixed(self, topic: ArraySource | None) -> dict[int, tuple[int, Rigid]]:
        """Read the value of ``fixed``: of each frame the transform that was recorded last."""
        if topic is None:
            return {}
        fixed = FixedTransforms()
        TransformTopic(topic, self._node, self._writers).read(fixed, 0, MAX_NS, reverse=True)
        samples = list(fixed.all())
        self.recorded.update(n.lstrip("/") for s in samples for n in (s.child, s.parent))
        return {
            self.code(sample.child): (
                self.code(sample.parent),
                Rigid.of_numbers(np.array([sample.numbers], np.float64)),
            )
            for sample in samples
        }

    def code(self, name: str | None) -> int:
        """Return the number of a frame, slash in front ignored; NO_FRAME for an empty name."""
        name = (name or "").lstrip("/")
        if not name:
            return NO_FRAME
        if name not in self._codes:
            self._codes[name] = len(self.names)
            self.names.append(name)
        return self._codes[name]

    def read(self, low: int, high: int) -> Samples:
        """Return the moving transforms with a row key in [low, high], ns."""
        if self.moving is None or low > high:
            return Samples.none()
        arrays = arrays_between(self.moving, _FIELDS, low, high, self._node, self._writers)
        numbers = np.stack([filled(arrays[name], np.nan) for name in _FIELDS[4:]], 1)
        parents, children = (self._codes_of(arrays[name]) for name in _NAMES)
        stamps = filled(arrays[_STAMP], 0)
        return Samples.checked(arrays["KEY"], stamps, parents, children, numbers)

    def _codes_of(self, names: Iterable[str | None]) -> Codes:
        """Return the numbers of the frames of transforms, and note the frames as recorded."""
        numbers: dict[str | None, int] = {}
        codes = []
        for name in names:
            if name not in numbers:
                numbers[name] = self.code(name)
                self.recorded.update(filter(None, [(name or "").lstrip("/")]))
            codes.append(numbers[name])
        return np.array(codes, np.int64)

    def next_key(self, time: int) -> int | None:
        """Return the first row key after a time, ns; None if there are no later rows."""
        if self.moving is None:
            return None
        return key_after(self.moving, time, self._node, self._writers)

    def ancestors(self, samples: Samples, frames: set[int]) -> set[int]:
        """Return some frames and their ancestors by samples and fixed transforms, all by number."""
        above = frames
        while True:
            on_way = np.isin(samples.children, list(above))
            wider = above | set(samples.parents[on_way].tolist())
            wider |= {self.fixed[code][0] for code in above if code in self.fixed}
            if wider == above:
                return above
            above = wider

    def above(self, name: str, times: Sequence[int]) -> list[str]:
        """Return the ancestors of a frame, nearest first, as recorded around some row keys, ns."""
        parents: dict[int, set[int]] = {child: {p} for child, (p, _) in self.fixed.items()}
        for time in dict.fromkeys(times):
            samples = self.read(max(0, time - FRAME_SEARCH_NS), time + FRAME_SEARCH_NS)
            pairs = np.unique(np.stack([samples.children, samples.parents], 1), axis=0)
            for child, parent in pairs.tolist():
                if child not in self.fixed:
                    parents.setdefault(child, set()).add(parent)
        codes = [self.code(name)]
        for code in codes:
            codes.extend(sorted(parents.get(code, set()).difference(codes)))
        return [self.names[code] for code in codes[1:]]

    def explain(self, frame: str, of: str, time: int) -> str:
        """Return why there is no pose at a time, as a text; '' if tf2 would return a pose."""
        when = Stamp.from_ns(max(1, time))
        try:
            lookup_transform(self._find, self._node, self._writers, frame, of, when, *self._topics)
        except TransformException as exc:
            return str(exc)
        return ""


def filled(values: AnyArray, missing: float) -> AnyArray:
    """Return values with ``missing`` in place of the missing ones."""
    array: AnyArray = np.ma.filled(values, missing)  # type: ignore[no-untyped-call]
    return array


class FrameChain:
    """Poses of one frame in another.

    Args:
        frames: Recorded transforms.
        of: Frame whose poses are computed, as 'base_link'.
        frame: Frame in which the poses are given, as 'map'.
    """

    def __init__(self, frames: TfRecording, of: str, frame: str) -> None:
        self._frames = frames
        self.of, self.frame = of.lstrip("/"), frame.lstrip("/")
        self._of, self._frame = frames.code(of), frames.code(frame)

    def read(self, low: int, high: int) -> Samples:
        """Return the transforms with a row key in [low, high], ns."""
        return self._frames.read(low, high)

    def explain(self, time: int) -> str:
        """Return why there is no pose at a time, as a text; '' if tf2 would return a pose."""
        return self._frames.explain(self.frame, self.of, time)

    def unknown_frame(self) -> str:
        """Say which frame is in no transform that was read, with similar ones; '' = both are."""
        names = sorted(self._frames.recorded)
        for name in (self.of, self.frame):
            if name not in self._frames.recorded:
                return f"frame {name!r:.80} is in no transform{nearest(name, names)}"
        return ""

    def next_key(self, time: int) -> int | None:
        """Return the first row key after a time, ns; None if there are no later rows."""
        return self._frames.next_key(time)

    def on_way(self, samples: Samples) -> Flags:
        """Return which samples are of the two frames or of their ancestors, and not fixed."""
        above = self._frames.ancestors(samples, {self._of, self._frame})
        moving = [code for code in above if code not in self._frames.fixed]
        on_way: Flags = np.isin(samples.children, moving)
        return on_way

    def placed(
        self, samples: Samples, times: Times, stamped: bool, longest_gap_ns: int
    ) -> KnownPoses:
        """Return the poses at some times, ns, computed from the samples around them."""
        search = _AncestorSearch(self._frames, samples, times, stamped, longest_gap_ns)
        poses, valid = Rigid.none(len(times)), np.zeros(len(times), bool)
        # Both frames have a pose in the first ancestor that they share.
        downs = search.paths(self._frame)
        for up in search.paths(self._of):
            for down in downs:
                meeting = next((code for code in up.frames if code in down.frames), None)
                if meeting is None:
                    continue
                rows, up_rows, down_rows = np.intersect1d(
                    up.rows, down.rows, assume_unique=True, return_indices=True
                )
                inner = up.poses[up.frames.index(meeting)].take(up_rows)
                outer = down.poses[down.frames.index(meeting)].take(down_rows)
                poses.put(rows, outer.inverse() @ inner)
                valid[rows] = True
        return KnownPoses(poses, valid)


class _AncestorSearch:
    """Follows frames to their ancestors at some times."""

    def __init__(
        self,
        frames: TfRecording,
        samples: Samples,
        times: Times,
        stamped: bool,
        longest_gap_ns: int,
    ) -> None:
        self._frames, self._samples, self._times = frames, samples, times
        self._stamped, self._gap = stamped, longest_gap_ns

    def paths(self, frame: int) -> Sequence[AncestorPath]:
        """Return the paths upwards from a frame; each time belongs to one path.

        A path ends where no parent is known, or before a frame that it has already.
        """
        count = len(self._times)
        paths: list[AncestorPath] = []
        stack = [AncestorPath(np.arange(count), (frame,), (Rigid.none(count),))]
        while stack:
            path = stack.pop()
            steps, parents = self._step(path.frames[-1], path.rows)
            for parent in np.unique(parents).tolist():
                at_times = _take_times(path, parents == parent)
                if parent == NO_FRAME or parent in path.frames:
                    paths.append(at_times)
                    continue
                higher = steps.take(parents == parent) @ at_times.poses[-1]
                frames, poses = (*path.frames, parent), (*at_times.poses, higher)
                stack.append(AncestorPath(at_times.rows, frames, poses))
        return paths

    def _step(self, frame: int, rows: Codes) -> tuple[Rigid, Codes]:
        """Return the poses of a frame in its parents at some times, and the parents.

        The parent is NO_FRAME where none is known.
        """
        fixed = self._frames.fixed.get(frame)
        if fixed is not None:
            parent, pose = fixed
            same = np.zeros(len(rows), np.int64)
            return pose.take(same), np.full(len(rows), parent)
        track = self._samples.track(frame, self._stamped)
        known_poses, parents = track.at(self._times[rows], self._gap)
        return known_poses.poses, parents


def _take_times(path: AncestorPath, which: Flags) -> AncestorPath:
    """Return a path for some of its times."""
    poses = tuple(pose.take(which) for pose in path.poses)
    return AncestorPath(path.rows[which], path.frames, poses)
