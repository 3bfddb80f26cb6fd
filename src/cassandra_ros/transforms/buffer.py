# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""tf2's own buffer, for the maths of one lookup.

Stamps over 2**31 s end the process in tf2_py, and times go through a double on their way, so the
buffer gets times around a small base: near it a double is exact to the nanosecond.
"""

from __future__ import annotations

from typing import Callable, Iterable, Optional, Type

from geometry_msgs.msg import TransformStamped

from cassandra_ros.errors import (
    ConnectivityException,
    ExtrapolationException,
    LookupException,
    MissingDependency,
    TransformException,
)
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.transforms.samples import Sample

try:
    import tf2_py
except ImportError as exc:
    raise MissingDependency(
        "transforms are looked up with tf2's own buffer, and tf2_py is not installed: install "
        "ros-noetic-tf2-py, or python3-tf2 on Debian"
    ) from exc

REACH_NS = 100_000 * SECOND_NS
"""No transform is given to tf2 further from the base than this, a day."""
_BASE_NS = 2 * REACH_NS
_AUTHORITY = "cassandra_ros"
_ERRORS = {
    tf2_py.LookupException: LookupException,
    tf2_py.ConnectivityException: ConnectivityException,
    tf2_py.ExtrapolationException: ExtrapolationException,
}

Explain = Callable[[Type[TransformException]], str]


class Buffer:
    """A tf2 buffer that knows the transforms next to one time.

    Args:
        time: The time, ns; None = all transforms hold at the time that is looked up.
        moving: The nearest before and after the time of each frame.
        fixed: Transforms that hold at every time.
    """

    def __init__(
        self, time: Optional[int], moving: Iterable[Sample], fixed: Iterable[Sample]
    ) -> None:
        self._time = time
        moving = list(moving)
        self._scales = _scales(moving, time)
        whole = Stamp.from_ns(2 * REACH_NS + SECOND_NS) - Stamp.from_ns(0)
        self._core = tf2_py.BufferCore(whole)
        for sample in moving:
            self._core.set_transform(_message(sample, self._place(sample)), _AUTHORITY)
        for sample in fixed:
            self._core.set_transform_static(_message(sample, _BASE_NS), _AUTHORITY)

    def lookup(self, target: str, source: str, explain: Explain) -> TransformStamped:
        """Return the transform that takes points of source to target. Its stamp means nothing.

        Args:
            target, source: Frames.
            explain: Gives the text of an error, for tf2's has other times.

        Raises:
            TransformException: tf2 raises one.
        """
        try:
            return self._core.lookup_transform_core(target, source, Stamp.from_ns(_BASE_NS))
        except tf2_py.TransformException as exc:
            kind = _ERRORS.get(type(exc), TransformException)
            raise kind(explain(kind)) from exc

    def _place(self, sample: Sample) -> int:
        if self._time is None:
            return _BASE_NS
        distance, scale = sample.stamp - self._time, self._scales[sample.child]
        if scale is None or not distance:
            return _BASE_NS + distance
        # Interpolation asks only how the distances of the two transforms of a frame compare.
        near = max(1, round(abs(distance) * scale))
        return _BASE_NS + (near if distance > 0 else -near)


def _scales(samples: Iterable[Sample], time: Optional[int]) -> dict[str, Optional[float]]:
    """By what to multiply the distances from the time, by child frame; None = they fit."""
    longest: dict[str, int] = {}
    for sample in samples:
        distance = abs(sample.stamp - (time or 0))
        longest[sample.child] = max(longest.get(sample.child, 0), distance)
    return {c: REACH_NS / most if most > REACH_NS else None for c, most in longest.items()}


def _message(sample: Sample, ns: int) -> TransformStamped:
    message = TransformStamped()
    message.header.stamp = Stamp.from_ns(ns)
    message.header.frame_id = sample.parent
    message.child_frame_id = sample.child
    moved, turned = message.transform.translation, message.transform.rotation
    moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w = sample.numbers
    return message
