# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded transforms: read without message objects, and of each frame only those next to a time.

tf2 interpolates between two transforms of a frame, the nearest before and after a time. To keep
these two is all that any time needs, so a topic of any length is read in the same memory.

What is asked goes by the stamps in the headers, what is read by the row keys. The two lie
milliseconds apart, or years: in a bag that was replayed, or where a clock was wrong.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Iterator, NamedTuple, Optional, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage, TypeMismatch
from cassandra_ros.keys import MAX_NS, SECOND_NS, Position
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.rows.extract import Extractor
from cassandra_ros.query.source import Source, Writers
from cassandra_ros.query.tree.field_names import all_fields

_log = logging.getLogger(__name__)

TRANSFORMS_MD5 = "94810edda583a504dfda3829e70d7eec"
"""Of tf2_msgs/TFMessage, and of tf/tfMessage, its name before tf2."""
_HEAD = ("header.stamp", "header.frame_id", "child_frame_id")
_MOVED = tuple(f"transform.translation.{c}" for c in "xyz")
_TURNED = tuple(f"transform.rotation.{c}" for c in "xyzw")
_TOLERANCE = 10e-3
"""How far tf2 lets the square of a rotation's length be from 1."""

FIRST_REACH_NS = 2 * SECOND_NS
"""How far from a row key, on both sides, is read at first."""

Order = Tuple[Position, int]
"""Of the message, and the number of the transform in it."""


class Sample(NamedTuple):
    """One recorded transform."""

    stamp: int
    """Of its header, ns."""
    parent: str
    child: str
    numbers: tuple[float, ...]
    """Translation x, y, z, metres, and rotation x, y, z, w."""
    key: int
    """When it was received, ns."""
    order: Order
    """Its place in the order of arrival."""


class Nearest:
    """For each child frame the transforms next to a time, ns; None = the end of all times."""

    def __init__(self, time: Optional[int] = None) -> None:
        self.time = time
        self.before: dict[str, Sample] = {}
        """The last one at the time or before."""
        self.after: dict[str, Sample] = {}
        """The first one behind it."""
        self.parents: set[str] = set()
        """Also those of other times."""
        self.ignored: dict[str, str] = {}
        """Child frames of which some were left out, and why."""

    def wants(self, child: str, stamp: int, order: Order) -> bool:
        """Say whether a transform is nearer than those known; of equal stamps the first counts."""
        if self.time is None or stamp <= self.time:
            known = self.before.get(child)
            return known is None or (stamp, known.order) > (known.stamp, order)
        known = self.after.get(child)
        return known is None or (stamp, order) < (known.stamp, known.order)

    def add(self, sample: Sample) -> bool:
        """Take a wanted transform, or leave it out as tf2 would; say which."""
        problem = _problem(sample)
        if problem:
            self.ignored.setdefault(sample.child, problem)
            return False
        if self.time is None or sample.stamp <= self.time:
            self.before[sample.child] = sample
        else:
            self.after[sample.child] = sample
        return True

    def at(self, child: str) -> Optional[Sample]:
        """Return what says the frame's parent at the time; None where tf2 would extrapolate."""
        before = self.before.get(child)
        if before is None or self.time in (None, before.stamp) or child in self.after:
            return before
        return None

    def all(self) -> list[Sample]:
        """List all that are kept."""
        return [*self.before.values(), *self.after.values()]


class Fixed(Nearest):
    """For each child frame the transform that was recorded last, whatever its stamp."""

    def wants(self, child: str, stamp: int, order: Order) -> bool:
        """Say whether a transform arrived later than that which is known."""
        known = self.before.get(child)
        return known is None or order > known.order


@dataclass(frozen=True)
class FrameTree:
    """The frames at a time; one that is among the fixed transforms counts as fixed."""

    nearest: Nearest
    fixed: Fixed

    def frames(self) -> set[str]:
        """List all frames that were found, also at other times."""
        moving, fixed = self.nearest, self.fixed
        return {*moving.before, *moving.after, *moving.parents, *fixed.before, *fixed.parents}

    def climb(self, frame: str) -> list[str]:
        """Return the frames from one upwards, as far as the time has transforms."""
        way, sample = [frame], self._above(frame)
        while sample is not None and sample.parent not in way:
            way.append(sample.parent)
            sample = self._above(sample.parent)
        return way

    def _above(self, frame: str) -> Optional[Sample]:
        return self.fixed.at(frame) or self.nearest.at(frame)

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
        sample = self._above(way[-1])
        return None if sample is None else [*way[way.index(sample.parent) :], sample.parent]


class Recorded:
    """The transforms of one topic, of one nodeID and some writers or of all.

    Raises:
        TypeMismatch: The topic holds other messages.
    """

    def __init__(self, topic: Source[Row], node: Optional[str], run: Writers = None) -> None:
        self._topic = topic
        self._node, self._run = node, run
        self._extractors: dict[str, tuple[Extractor, Extractor]] = {}
        for table in topic.tables:
            self._extractor(table)

    @cached_property
    def ends(self) -> tuple[int, int]:
        """The first and the last row key, ns; (MAX_NS, 0) where the topic is empty."""
        read, node, run = self._topic.rows, self._node, self._run
        both = [read(nodeID=node, limit=1, reverse=r, run=run) for r in (False, True)]
        keys = [row.t for rows in both for row in rows]
        return (keys[0], keys[-1]) if keys else (MAX_NS, 0)

    def read(self, nearest: Nearest, low: int, high: int, reverse: bool = False) -> None:
        """Add the transforms of a stretch of row keys, ns, both ends included."""
        if low > high:
            return
        node, run = self._node, self._run
        for row in self._topic.rows(low, high, nodeID=node, reverse=reverse, run=run):
            try:
                self._add(nearest, row)
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)

    def _add(self, nearest: Nearest, row: Row) -> None:
        heads, rests = self._extractor(row.table)
        rest: Sequence[Tuple[float, ...]] = ()
        for number, (stamp, *names) in enumerate(_elements(heads, row)):
            # As tf2 knows them: tf wrote them with a slash in front.
            parent, child = (name.lstrip("/") for name in names)
            order = (row.position, number)
            if nearest.wants(child, stamp, order):
                rest = rest or list(_elements(rests, row))
                if not nearest.add(Sample(stamp, parent, child, rest[number], row.t, order)):
                    continue
            nearest.parents.add(parent)

    def _extractor(self, table: Table) -> tuple[Extractor, Extractor]:
        if table.name not in self._extractors:
            definition = table.definition
            if definition is None or definition.md5sum != TRANSFORMS_MD5:
                raise TypeMismatch(
                    f"topic {self._topic.name} holds {table.msg_type}, no transforms: name the "
                    "topics of tf2_msgs/TFMessage with tf= and tf_static="
                )
            refs = {ref.name: ref for ref in all_fields(definition)}
            head, rest = (
                Extractor(definition, [refs[f"transforms.{name}"] for name in names], ())
                for names in (_HEAD, _MOVED + _TURNED)
            )
            self._extractors[table.name] = head, rest
        return self._extractors[table.name]


def _elements(extractor: Extractor, row: Row) -> Iterator[tuple[Any, ...]]:
    (lists,) = extractor.values(row)
    return zip(*lists)


def fill(
    tree: FrameTree, recorded: Optional[Recorded], frames: tuple[str, str], centre: int
) -> Optional[list[str]]:
    """Add moving transforms to a tree until more cannot change its path between two frames.

    It reads around a row key, ns, then ever wider; None where all of them connect nothing.
    """
    reach, window = FIRST_REACH_NS, (0, 0)
    while recorded is not None and not _is_final(tree, frames, window):
        low, high = max(0, centre - reach), min(MAX_NS, centre + reach)
        if reach == FIRST_REACH_NS:
            recorded.read(tree.nearest, low, high)
        else:
            (start, end), (first, last) = window, recorded.ends
            if start <= first and last <= end:
                break
            recorded.read(tree.nearest, max(low, first), start - 1)
            recorded.read(tree.nearest, end + 1, min(high, last))
        window = (low, high)
        reach *= 2
    return tree.path(*frames)


def _is_final(tree: FrameTree, frames: tuple[str, str], window: tuple[int, int]) -> bool:
    """Say whether there is a path that transforms outside of a stretch of row keys cannot change.

    A nearer transform would come between the two that are known, and its delay between theirs.
    """
    path, time = tree.path(*frames), tree.nearest.time
    if path is None:
        return False
    if not path and time is None:
        return window[1] > 0  # a frame to itself: its newest time
    for before in tree.moving(path):
        if time not in (None, before.stamp):
            after = tree.nearest.after[before.child]
            delays = [sample.key - sample.stamp for sample in (before, after)]
            low, high = before.stamp + min(delays), after.stamp + max(delays)
            if not (window[0] <= low and high <= window[1]):
                return False
    return True


def named(frame: str) -> Sample:
    """Return a transform by which tf2 gets to know a frame, and nothing else."""
    return Sample(
        0, frame, f"{frame} of another time", (0, 0, 0, 0, 0, 0, 1), 0, (Position(0, "", 0, ""), 0)
    )


def _problem(sample: Sample) -> str:
    """Why tf2 would leave a transform out; '' where it takes it."""
    if not sample.child or not sample.parent or "\0" in sample.child + sample.parent:
        return "a frame has no name"
    if sample.child == sample.parent:
        return "the frame is its own parent"
    if any(number != number for number in sample.numbers):
        return "there is NaN in them"
    if not abs(sum(number * number for number in sample.numbers[3:]) - 1) < _TOLERANCE:
        return "their rotation is no unit quaternion"
    return ""
