# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorded transforms: read without message objects, and of each frame only those next to a time.

tf2 interpolates between two transforms of a frame, the nearest before and after a time. To keep
these two is all that any time needs, so a topic of any length is read in the same memory.
"""

from __future__ import annotations

import logging
from typing import Any, Iterator, NamedTuple, Optional, Tuple

from cassandra_ros.errors import CorruptMessage, TypeMismatch
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.extract import Extractor
from cassandra_ros.query.names import FieldRef, allFields
from cassandra_ros.query.protocols import Row, Source, Table

_log = logging.getLogger(__name__)

TRANSFORMS_MD5 = "94810edda583a504dfda3829e70d7eec"
"""Of tf2_msgs/TFMessage, and of tf/tfMessage, its name before tf2."""
_HEAD = tuple(
    f"transforms.{name}" for name in ("header.stamp", "header.frame_id", "child_frame_id")
)
_REST = tuple(
    f"transforms.transform.{name}"
    for name in (*(f"translation.{c}" for c in "xyz"), *(f"rotation.{c}" for c in "xyzw"))
)
_TOLERANCE = 10e-3
"""How far tf2 lets the square of a rotation's length be from 1."""

Order = Tuple[Any, ...]


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

    @property
    def delay(self) -> int:
        """From its stamp to its row key, ns."""
        return self.key - self.stamp


class Nearest:
    """For each child frame the transforms next to a time.

    Args:
        time: ns; None = the end of all times.
    """

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


class Recorded:
    """The transforms of one topic.

    Args:
        topic: Whose messages.
        nodeID: Only transforms of this node; None = of all.

    Raises:
        TypeMismatch: The topic holds other messages.
    """

    def __init__(self, topic: Source[Row], nodeID: Optional[str]) -> None:
        self.name: str = topic.name
        self._topic = topic
        self._node = nodeID
        self._extractors: dict[str, tuple[Extractor, Extractor]] = {}
        for table in topic.tables:
            self._extractor(table)

    def ends(self) -> Optional[tuple[int, int]]:
        """Return the first and the last row key, ns; None where the topic is empty."""
        both = [self._topic.rows(nodeID=self._node, limit=1, reverse=r) for r in (False, True)]
        keys = [row.t for rows in both for row in rows]
        return (keys[0], keys[-1]) if keys else None

    def read(self, nearest: Nearest, low: int, high: int, **options: Any) -> None:
        """Add the transforms of a stretch of row keys, ns, both ends included."""
        for row in self._topic.rows(low, high, nodeID=self._node, **options):
            try:
                self._add(nearest, row)
            except CorruptMessage as exc:
                _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)

    def _add(self, nearest: Nearest, row: Row) -> None:
        heads, rests = self._extractor(row.table)
        rest: list[Any] = []
        for number, (stamp, *names) in enumerate(_elements(heads, row)):
            parent, child = map(stripped, names)
            order = (*row.position, number)
            if nearest.wants(child, stamp, order):
                rest = rest or list(_elements(rests, row))
                if not nearest.add(Sample(stamp, parent, child, rest[number], row.t, order)):
                    continue
            nearest.parents.add(parent)

    def _extractor(self, table: Table) -> tuple[Extractor, Extractor]:
        if table.name not in self._extractors:
            definition: Optional[Definition] = table.definition
            if definition is None or definition.md5sum != TRANSFORMS_MD5:
                raise TypeMismatch(
                    f"topic {self.name} holds {table.msg_type}, no transforms: name the "
                    "topics of tf2_msgs/TFMessage with tf= and tf_static="
                )
            refs = {ref.name: ref for ref in allFields(definition)}
            self._extractors[table.name] = tuple(  # type: ignore[assignment]
                _extractor(definition, refs, names) for names in (_HEAD, _REST)
            )
        return self._extractors[table.name]


def _extractor(
    definition: Definition, refs: dict[str, FieldRef], names: tuple[str, ...]
) -> Extractor:
    return Extractor(definition, [refs[name] for name in names], ())


def _elements(extractor: Extractor, row: Row) -> Iterator[tuple[Any, ...]]:
    (lists,) = extractor.values(row)
    return zip(*lists)


def stripped(frame: str) -> str:
    """Return a frame's name as tf2 knows it: tf wrote it with a slash in front."""
    return frame.lstrip("/")


def named(frame: str) -> Sample:
    """Return a transform by which tf2 gets to know a frame, and nothing else."""
    return Sample(0, frame, f"{frame} of another time", (0, 0, 0, 0, 0, 0, 1), 0, ())


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
