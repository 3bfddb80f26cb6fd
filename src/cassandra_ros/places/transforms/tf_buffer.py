# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One lookup by tf2's own buffer, which does the computation.

tf2_py crashes at stamps over 2**31 s, and converts times to doubles. Therefore the buffer gets
times shifted to a small base: near it a double is exact to the nanosecond.
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Callable, Iterable, Sequence

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
from cassandra_ros.places.transforms.transform_samples import Sample

try:
    import tf2_py
except ImportError as exc:
    raise MissingDependency(
        "transforms are looked up with tf2's own buffer, and there is no tf2_py for Python "
        f"{sys.version_info[0]}.{sys.version_info[1]}: it is compiled for the Python of your ROS; "
        "use that Python, and install ros-noetic-tf2-py, or python3-tf2 on Debian"
    ) from exc

BUFFER_REACH_NS = 100_000 * SECOND_NS
"""Maximum distance from the base of a time that tf2 gets, ns (about a day)."""
_BASE_NS = 2 * BUFFER_REACH_NS
_AUTHORITY = "cassandra_ros"
_ERRORS = {
    tf2_py.LookupException: LookupException,
    tf2_py.ConnectivityException: ConnectivityException,
    tf2_py.ExtrapolationException: ExtrapolationException,
}


def look_up(
    target: str,
    source: str,
    time: int | None,
    moving: Sequence[Sample],
    fixed: Iterable[Sample],
    explain: Callable[[type[TransformException]], str],
) -> TransformStamped:
    """Return the transform that converts points of source to target. Its stamp has no meaning.

    Args:
        time: Time in ns; None = all transforms are taken to be valid at the lookup's time.
        moving: The nearest transforms before and after the time, for each frame.
        fixed: Transforms that are valid at all times.
        explain: Returns the text of an error; tf2's own text would name the shifted times.
    """
    core = tf2_py.BufferCore(Stamp.from_ns(2 * BUFFER_REACH_NS + SECOND_NS) - Stamp.from_ns(0))
    distances = [0 if time is None else sample.stamp - time for sample in moving]
    longest: Counter[str] = Counter()
    for sample, distance in zip(moving, distances):
        longest[sample.child] = max(longest[sample.child], abs(distance))
    for sample, distance in zip(moving, distances):
        near = _BASE_NS + _shorten(distance, longest[sample.child])
        core.set_transform(_message(sample, near), _AUTHORITY)
    for sample in fixed:
        core.set_transform_static(_message(sample, _BASE_NS), _AUTHORITY)
    try:
        return core.lookup_transform_core(target, source, Stamp.from_ns(_BASE_NS))
    except tf2_py.TransformException as exc:
        kind = _ERRORS.get(type(exc), TransformException)
        raise kind(explain(kind)) from exc


def _shorten(distance: int, longest: int) -> int:
    """Scale a distance so that the longest one of its frame is within BUFFER_REACH_NS."""
    if longest <= BUFFER_REACH_NS or not distance:
        return distance
    # Interpolation uses only the ratio of the distances of a frame's two transforms.
    near = max(1, round(abs(distance) * (BUFFER_REACH_NS / longest)))
    return near if distance > 0 else -near


def _message(sample: Sample, ns: int) -> TransformStamped:
    """Return a transform as a message with another stamp, ns."""
    message = TransformStamped()
    message.header.stamp = Stamp.from_ns(ns)
    message.header.frame_id = sample.parent
    message.child_frame_id = sample.child
    moved, turned = message.transform.translation, message.transform.rotation
    moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w = sample.numbers
    return message
