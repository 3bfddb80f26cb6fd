# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The beams of one scan or cloud: their ends, and whether they hit something."""

from __future__ import annotations

import math
from typing import Any, Callable, Mapping, NamedTuple

import numpy as np

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.places.pose_samples import Flags
from cassandra_ros.places.rigid import Floats
from cassandra_ros.query.arrays.array_types import AnyArray

CLOUD_RANGE = 30.0
"""Maximum range in a cloud if the options give none, metres. Farther points are too sparse."""
CLOUD_HEIGHTS = (0.1, 2.0)
"""Minimum and maximum height of obstacles in a cloud, metres above the floor of the map's frame."""

_ANY_HEIGHT = (-math.inf, math.inf)
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy types by PointField's type numbers."""


class Beams(NamedTuple):
    """Straight beams from the sensor's origin."""

    ends: Floats
    """End points in the sensor's frame, (n, 3), metres."""
    hit: Flags
    """Whether the beam hit something at its end; else it is free up to there."""


def beams_of_scan(scan: Any, max_range: float | None) -> Beams:
    """Return the beams of a sensor_msgs/LaserScan, by the rules of REP 117.

    +Inf, or range_max itself as in older drivers, means that the beam is free up to range_max. NaN,
    -Inf, and values below range_min or above range_max are ignored.

    Args:
        scan: The message.
        max_range: Maximum range, metres; a farther hit counts as free. None = range_max.
    """
    return _beams(scan, np.asarray(scan.ranges, np.float64), max_range)


def beams_of_echoes(scan: Any, max_range: float | None) -> Beams:
    """Return the beams of a sensor_msgs/MultiEchoLaserScan to their first echoes.

    A beam without an echo is ignored; otherwise like beams_of_scan.
    """
    first = [beam.echoes[0] if len(beam.echoes) else math.nan for beam in scan.ranges]
    return _beams(scan, np.array(first, np.float64), max_range)


def _beams(scan: Any, ranges: Floats, max_range: float | None) -> Beams:
    """Return the beams of a scan or multi-echo scan with these ranges."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    most = scan.range_max if scan.range_max > 0 else math.inf  # some drivers leave range_max at 0
    limit = most if max_range is None else min(most, max_range)
    with np.errstate(invalid="ignore"):
        valid = (ranges > 0) & (ranges >= scan.range_min) & (ranges < most)
        nothing = (ranges == most) | np.isposinf(ranges) | (valid & (ranges > limit))
    hit = valid & ~nothing
    is_used = hit | nothing if math.isfinite(limit) else hit
    is_used &= np.isfinite(angles)
    lengths = np.where(hit, ranges, limit)[is_used]
    angles = angles[is_used]
    flat = np.zeros_like(lengths)
    ends = np.stack([lengths * np.cos(angles), lengths * np.sin(angles), flat], 1)
    return Beams(ends, hit[is_used])


def beams_of_cloud(cloud: Any, max_range: float | None) -> Beams:
    """Return the beams to the points of a sensor_msgs/PointCloud2, without points with NaN.

    Args:
        cloud: The message.
        max_range: Maximum range, metres; a beam to a farther point is free up to there. None =
            CLOUD_RANGE.

    Raises:
        CorruptMessage: The cloud has no fields x and y, or fewer bytes than its size needs.
    """
    points = _points(cloud)
    points = points[np.isfinite(points).all(1)]
    limit = CLOUD_RANGE if max_range is None else max_range
    lengths = np.linalg.norm(points, axis=1)
    points, lengths = points[lengths > 0], lengths[lengths > 0]
    far = lengths > limit
    points[far] *= (limit / lengths[far])[:, None]
    return Beams(points, ~far)


def _points(cloud: Any) -> Floats:
    """Return the (n, 3) coordinates of a cloud, organised or not."""
    order = ">" if cloud.is_bigendian else "<"
    places = {f.name: (order + _KINDS.get(f.datatype, ""), f.offset) for f in cloud.fields}
    names = [name for name in "xyz" if name in places]
    width, height, step = cloud.width, cloud.height, cloud.point_step
    if not width * height:
        return np.zeros((0, 3))
    row_step = cloud.row_step if height > 1 else width * step
    data = np.frombuffer(bytes(cloud.data), np.uint8)
    if "x" not in names or "y" not in names:
        raise CorruptMessage(f"a cloud has no x and y: its fields are {', '.join(places)}")
    if row_step < width * step or len(data) < row_step * (height - 1) + width * step:
        raise CorruptMessage(
            f"a cloud of {width} x {height} points of {step} bytes has {len(data)} bytes"
        )
    try:
        point = np.dtype(
            {
                "names": names,
                "formats": [places[name][0] for name in names],
                "offsets": [places[name][1] for name in names],
                "itemsize": step,
            }
        )
    except (TypeError, ValueError) as exc:
        raise CorruptMessage(f"a cloud's fields do not fit into its points: {exc}") from exc
    shape, strides = (height, width), (row_step, step)
    read: AnyArray = np.ndarray(shape, point, data.tobytes(), strides=strides).reshape(-1)
    points = np.zeros((len(read), 3))
    for name in names:
        points[:, "xyz".index(name)] = read[name]
    return points


class Sensor(NamedTuple):
    """Conversion of one message type to beams."""

    beams: Callable[[Any, float | None], Beams]
    """Function from a message and the maximum range to its beams."""
    heights: tuple[float, float]
    """Default minimum and maximum height of obstacles, metres above the floor."""


SENSORS: Mapping[str, Sensor] = {
    "sensor_msgs/LaserScan": Sensor(beams_of_scan, _ANY_HEIGHT),
    "sensor_msgs/MultiEchoLaserScan": Sensor(beams_of_echoes, _ANY_HEIGHT),
    "sensor_msgs/PointCloud2": Sensor(beams_of_cloud, CLOUD_HEIGHTS),
}
