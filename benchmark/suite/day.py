# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording of a day: ten million messages of an IMU, and beside them tf, scans and a camera.

A robot drives in circles. Its messages are made of templates by numpy, as quickly as they are
written: stamps and some numbers change, which are smooth and noisy as those of sensors are.
"""

from __future__ import annotations

import io
import math
import struct
from dataclasses import dataclass, field
from typing import Any, Callable, Iterator

import numpy as np
from geometry_msgs.msg import TransformStamped
from PIL import Image
from sensor_msgs.msg import CompressedImage, Imu, LaserScan
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.store.tables.lengths import bucket_for, span_for
from suite.messages import START_NS, serialized

DAY_NS = 86_400 * 10**9
CHUNK_BYTES = 64_000_000
RADIUS_M, LAP_SEC = 10.0, 60.0
_MARK = 0.123456789
"""Stands in a template where numbers are put in."""

Signal = Callable[[np.ndarray], np.ndarray]
"""Seconds -> values."""


@dataclass
class Topic:
    """A topic of the day."""

    name: str
    msg: Any
    hz: float
    signals: list[Signal] = field(default_factory=list)
    """A signal for each marked number of the message, in their order."""
    latched: bool = False

    @property
    def count(self) -> int:
        """Messages of the day."""
        return 1 if self.latched else max(1, round(self.hz * 86_400))

    @property
    def connection(self) -> Connection:
        """What its publisher says."""
        found = {
            "callerid": "/robot",
            "latching": str(int(self.latched)),
            "topic": self.name,
            "type": self.msg._type,
            "md5sum": self.msg._md5sum,
            "message_definition": self.msg._full_text,
        }
        fields = [f"{name}={value}".encode() for name, value in found.items()]
        return Connection(self.name, b"".join(struct.pack("<I", len(f)) + f for f in fields))

    def chunks(self) -> Iterator[tuple[np.ndarray, np.ndarray, list[bytes]]]:
        """Yield times (ns), counters and wire bytes of some messages after the other."""
        wire = serialized(self.msg)
        stamp_at = 4 if self.msg._type == TFMessage._type else 0
        places = _places(wire, len(self.signals))
        most = max(1, CHUNK_BYTES // len(wire))
        for first in range(0, self.count, most):
            numbers = np.arange(first, min(first + most, self.count), dtype=np.int64)
            times = START_NS + numbers * (DAY_NS // self.count)
            rows = np.tile(np.frombuffer(wire, np.uint8), (len(numbers), 1))
            stamps = np.stack([numbers, times // 10**9, times % 10**9], axis=1).astype("<u4")
            rows[:, stamp_at : stamp_at + 12] = stamps.view(np.uint8)
            for at, signal in zip(places, self.signals):
                values = signal((times - START_NS) / 1e9).astype("<f8")
                rows[:, at : at + 8] = values.view(np.uint8).reshape(-1, 8)
            data, size = rows.tobytes(), len(wire)
            yield times, numbers, [data[at : at + size] for at in range(0, len(data), size)]


def _places(wire: bytes, count: int) -> list[int]:
    """Return the offsets of the marked numbers of a template."""
    found, mark = [], struct.pack("<d", _MARK)
    at = wire.find(mark)
    while at >= 0:
        found.append(at)
        at = wire.find(mark, at + 8)
    assert len(found) == count, found
    return found


def _noisy(amplitude: float, lap_sec: float, noise: float, seed: int) -> Signal:
    rand = np.random.default_rng(seed)

    def signal(seconds: np.ndarray) -> np.ndarray:
        wave = amplitude * np.sin(seconds * (2 * math.pi / lap_sec))
        # Some digits, as a sensor has.
        return np.round(wave + noise * rand.standard_normal(len(seconds)), 4)

    return signal


def _turn(function: Callable[..., Any], factor: float, part: float) -> Signal:
    return lambda seconds: factor * function(seconds * (2 * math.pi / LAP_SEC) * part)


def topics(imu_count: int) -> list[Topic]:
    """Return the topics of a day with so many messages of the IMU."""
    imu, scan = Imu(), LaserScan()
    imu.header.frame_id, scan.header.frame_id = "imu_link", "laser"
    imu.angular_velocity.z = imu.linear_acceleration.x = imu.linear_acceleration.z = _MARK
    scan.angle_min, scan.angle_max, scan.angle_increment = -1.57, 1.57, 3.14 / 180
    scan.range_max, scan.ranges = 30.0, [2.0 + math.sin(n / 9) for n in range(181)]
    moving, fixed = TransformStamped(), TransformStamped()
    moving.header.frame_id, moving.child_frame_id = "odom", "base_link"
    fixed.header.frame_id, fixed.child_frame_id = "base_link", "laser"
    fixed.transform.rotation.w = 1.0
    moving.transform.translation.x = moving.transform.translation.y = _MARK
    moving.transform.rotation.z = moving.transform.rotation.w = _MARK
    picture = io.BytesIO()
    Image.effect_noise((320, 240), 40).save(picture, "JPEG", quality=60)
    camera = CompressedImage(format="jpeg", data=picture.getvalue())
    camera.header.frame_id = "camera"
    path = [
        _turn(np.cos, RADIUS_M, 1.0),
        _turn(np.sin, RADIUS_M, 1.0),
        _turn(np.sin, 1.0, 0.5),
        _turn(np.cos, 1.0, 0.5),
    ]
    waves = [_noisy(0.1, 60, 0.01, 1), _noisy(1.0, 7200, 0.2, 2), _noisy(9.81, 1e9, 0.1, 3)]
    return [
        Topic("/imu", imu, imu_count / 86_400, waves),
        Topic("/tf", TFMessage([moving]), imu_count / 86_400 / 10, path),
        Topic("/scan", scan, imu_count / 86_400 / 50),
        Topic("/camera/image/compressed", camera, imu_count / 86_400 / 1000),
        Topic("/tf_static", TFMessage([fixed]), 0.0, latched=True),
    ]


def store_day(store: RosCassandra, imu_count: int, node: str = "robot") -> dict[str, int]:
    """Store a day, packed; return how many messages each topic has."""
    counts: dict[str, int] = {}
    with store.messageWriter(nodeID=node, format="packed") as writer:
        for topic in topics(imu_count):
            size = len(serialized(topic.msg))
            rate = topic.hz, topic.hz * size
            handle = writer.connect(topic.connection, bucket_for(*rate), span_ns=span_for(*rate))
            for times, numbers, wires in topic.chunks():
                writer.write_run(handle, times, numbers, wires)
            counts[topic.name] = topic.count
    return counts
