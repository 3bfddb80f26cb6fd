# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded transforms, read without message objects; only those next to a time are kept.

tf2 interpolates between two transforms of each frame, the nearest before and after a time. Only
these two are kept, so a topic of any length is read in constant memory.

Lookups use the stamps in the headers, reads the row keys. The two differ by milliseconds, or by
years if a bag was replayed or a clock was wrong.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, Iterator, NamedTuple, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage, TypeMismatch
from cassandra_ros.keys import MAX_NS, SECOND_NS, Position
from cassandra_ros.metadata import message_kind
from cassandra_ros.query.protocols import Row, Source, Table
from cassandra_ros.query.rows.projection import Extractor
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.read import Read, TimeRange, Whose, Writers

_log = logging.getLogger(__name__)

TRANSFORM_KIND = message_kind("94810edda583a504dfda3829e70d7eec", "", ("transforms[]",))
"""Kind of tf2_msgs/TFMessage, and of tf/tfMessage, its name before tf2."""
_HEAD = ("header.stamp", "header.frame_id", "child_frame_id")
_MOVED = tuple(f"transform.translation.{c}" for c in "xyz")
_TURNED = tuple(f"transform.rotation.{c}" for c in "xyzw")
_TOLERANCE = 10e-3
"""Maximum deviation of the squared norm of a rotation from 1 that tf2 accepts."""

FIRST_REACH_NS = 2 * SECOND_NS
"""Distance from a row key, on both sides, of the rows that are read first, ns."""

Order = Tuple[Position, int]
"""Position of the message, and number of the transform in it."""


class Sample(NamedTuple):
    """One recorded transform."""

    stamp: int
    """Stamp of its header, ns since 1970."""
    parent: str
    child: str
    numbers: tuple[float, ...]
    """Translation x, y, z in metres, and rotation x, y, z, w."""
    key: int
    """Receive time, ns since 1970."""
    order: Order
    """Place in the order of arrival."""


class NearestTransforms:
    """For each child frame the nearest transforms before and after a time, ns.

    Without a time (None) it is the newest one, which counts as before.
    """

    def __init__(self, time: int | None = None) -> None:
        self.time = time
        self.before: dict[str, Sample] = {}
        """Last transform at or before the time, by child frame."""
        self.after: dict[str, Sample] = {}
        """First transform after the time, by child frame."""
        self.parents: set[str] = set()
        """Parent frames of all transforms that were read."""
        self.ignored: dict[str, str] = {}
        """Child frames with transforms that were left out, and the reason."""

    def wants(self, child: str, stamp: int, order: Order) -> bool:
        """Return whether a transform is nearer than that so far; of equal stamps the first is."""
        if self.time is None or stamp <= self.time:
            sample = self.before.get(child)
            return sample is None or (stamp, sample.order) > (sample.stamp, order)
        sample = self.after.get(child)
        return sample is None or (stamp, order) < (sample.stamp, sample.order)

    def add(self, sample: Sample) -> bool:
        """Add a wanted transform, unless tf2 would reject it; return whether it was added."""
        problem = _problem(sample)
        if problem:
            self.ignored.setdefault(sample.child, problem)
            return False
        if self.time is None or sample.stamp <= self.time:
            self.before[sample.child] = sample
        else:
            self.after[sample.child] = sample
        return True

    def at(self, child: str) -> Sample | None:
        """Return the transform that gives the frame's parent at the time.

        None if tf2 extrapolates.
        """
        before = self.before.get(child)
        if before is None or self.time in (None, before.stamp) or child in self.after:
            return before
        return None

    def all(self) -> list[Sample]:
        """Return all kept transforms."""
        return [*self.before.values(), *self.after.values()]


class FixedTransforms(NearestTransforms):
    """For each child frame the transform that was recorded last, whatever its stamp."""

    def wants(self, child: str, stamp: int, order: Order) -> bool:
        """Return whether a transform arrived later than the known one."""
        sample = self.before.get(child)
        return sample is None or order > sample.order


@dataclass(frozen=True)
class FrameTree:
    """The frames at a time. A frame that has a fixed transform counts as fixed."""

    nearest: NearestTransforms
    fixed: FixedTransforms

    def frames(self) -> set[str]:
        """Return all frames that were found, also those of other times."""
        moving, fixed = self.nearest, self.fixed
        return {*moving.before, *moving.after, *moving.parents, *fixed.before, *fixed.parents}

    def climb(self, frame: str) -> list[str]:
        """Return a frame and its ancestors, as far as transforms are known at the time."""
        way, sample = [frame], self._above(frame)
        while sample is not None and sample.parent not in way:
            way.append(sample.parent)
            sample = self._above(sample.parent)
        return way

    def _above(self, frame: str) -> Sample | None:
        return self.fixed.at(frame) or self.nearest.at(frame)

    def path(self, target: str, source: str) -> list[str] | None:
        """Return the child frames on the path between two frames.

        None if they are not connected.
        """
        down, up = self.climb(target), self.climb(source)
        meeting = next((frame for frame in up if frame in down), None)
        if meeting is None:
            return None
        return up[: up.index(meeting)] + down[: down.index(meeting)]

    def moving(self, frames: list[str]) -> list[Sample]:
        """Return the transforms before the time of those given frames that are not fixed."""
        before, fixed = self.nearest.before, self.fixed.before
        return [before[frame] for frame in frames if frame in before and frame not in fixed]

    def loop(self, frame: str) -> list[str] | None:
        """Return the loop among the ancestors of a frame, or None."""
        way = self.climb(frame)
        sample = self._above(way[-1])
        return None if sample is None else [*way[way.index(sample.parent) :], sample.parent]


class TransformTopic:
    """The transforms of one topic, of all or of one nodeID and some writers.

    Raises:
        TypeMismatch: The topic holds other messages.
    """

    def __init__(self, topic: Source[Row], node: str | None, run: Writers = None) -> None:
        self._topic = topic
        self._whose = Whose.of(node, run)
        self._extractors: dict[str, tuple[Extractor, Extractor]] = {}
        for table in topic.tables:
            self._extractor(table)

    @cached_property
    def ends(self) -> tuple[int, int]:
        """First and last row key, ns; (MAX_NS, 0) if the topic is empty."""
        ends = [Read(whose=self._whose, reverse=reverse, wanted=1) for reverse in (False, True)]
        keys = [row.t for end in ends for row in islice(self._topic.read(end), 1)]
        return (keys[0], keys[-1]) if keys else (MAX_NS, 0)

    def read(self, nearest: NearestTransforms, low: int, high: int, reverse: bool = False) -> None:
        """Add the transforms of a range of row keys, ns, both ends included."""
        if low > high:
            return
        for row in self._topic.read(Read(TimeRange(low, high), self._whose, reverse=reverse)):
            try:
                self._add(nearest, row)
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)

    def _add(self, nearest: NearestTransforms, row: Row) -> None:
        """Add the transforms of a message; raises CorruptMessage."""
        heads, rests = self._extractor(row.table)
        rest: Sequence[tuple[float, ...]] = ()
        for number, (stamp, *names) in enumerate(_elements(heads, row)):
            # tf2 uses names without the slash that tf wrote in front.
            parent, child = (name.lstrip("/") for name in names)
            order = (row.position, number)
            if nearest.wants(child, stamp, order):
                # The numbers of a message are read only if one of its transforms is wanted.
                rest = rest or list(_elements(rests, row))
                if not nearest.add(Sample(stamp, parent, child, rest[number], row.t, order)):
                    continue
            nearest.parents.add(parent)

    def _extractor(self, table: Table) -> tuple[Extractor, Extractor]:
        """Return what reads stamps and names, and numbers; raises TypeMismatch."""
        if table.name not in self._extractors:
            definition = table.definition
            if definition is None or definition.kind != TRANSFORM_KIND:
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
    """Yield the fields of each transform in a message."""
    (lists,) = extractor.values(row)
    return zip(*lists)


def read_transforms(
    tree: FrameTree, topic: TransformTopic | None, frames: tuple[str, str], centre: int
) -> list[str] | None:
    """Add moving transforms to a tree until more cannot change its path between two frames.

    Reads a growing range of row keys around ``centre``, ns. Returns the path, or None if the
    transforms do not connect the frames.
    """
    reach, window = FIRST_REACH_NS, (0, 0)
    while topic is not None and not _is_final(tree, frames, window):
        low, high = max(0, centre - reach), min(MAX_NS, centre + reach)
        if reach == FIRST_REACH_NS:
            topic.read(tree.nearest, low, high)
        else:
            (start, end), (first, last) = window, topic.ends
            if start <= first and last <= end:
                break
            topic.read(tree.nearest, max(low, first), start - 1)
            topic.read(tree.nearest, end + 1, min(high, last))
        window = (low, high)
        reach *= 2
    return tree.path(*frames)


def _is_final(tree: FrameTree, frames: tuple[str, str], window: tuple[int, int]) -> bool:
    """Return whether transforms outside a range of row keys cannot change the path.

    A nearer transform would have a stamp between those of the two known ones, and a delay between
    theirs.
    """
    path, time = tree.path(*frames), tree.nearest.time
    if path is None:
        return False
    if not path and time is None:
        return window[1] > 0  # both frames are the same: only its newest time is needed
    for before in tree.moving(path):
        if time not in (None, before.stamp):
            after = tree.nearest.after[before.child]
            delays = [sample.key - sample.stamp for sample in (before, after)]
            low, high = before.stamp + min(delays), after.stamp + max(delays)
            if not (window[0] <= low and high <= window[1]):
                return False
    return True


def name_only(frame: str) -> Sample:
    """Return a transform that only makes tf2 know a frame."""
    return Sample(
        0, frame, f"{frame} of another time", (0, 0, 0, 0, 0, 0, 1), 0, (Position(0, "", 0, ""), 0)
    )


def _problem(sample: Sample) -> str:
    """Return why tf2 would reject a transform; '' if it accepts it."""
    if not sample.child or not sample.parent or "\0" in sample.child + sample.parent:
        return "a frame has no name"
    if sample.child == sample.parent:
        return "the frame is its own parent"
    if any(number != number for number in sample.numbers):
        return "there is NaN in them"
    if not abs(sum(number * number for number in sample.numbers[3:]) - 1) < _TOLERANCE:
        return "their rotation is not a unit quaternion"
    return ""
