# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages that are measured: serialised, the same in every run.

Values are random, as in the paper ("pessimistic": nothing compresses, nothing indexes well), but
what a sensor does not change stays as it is: names of frames, fields of a cloud.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from typing import Any, Callable, Iterator, List, Tuple

import numpy as np
from genpy.dynamic import generate_dynamic
from sensor_msgs.msg import Image, Imu, JointState, LaserScan, PointCloud2, PointField
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.connection_header import Connection

START_NS = 1_600_000_000 * 10**9
PAPER_TYPE = "cassandra_ros_benchmark/Paper"
PAPER = "int8 a\nint16 b\nint32 c\nint64 d\nuint8[] e\n"
"""The paper's message (4.2): 8, 16, 32 and 64 bit, and 1 to 200 bytes."""

Layout = List[Tuple[Any, ...]]


@dataclass(frozen=True)
class Batch:
    """Messages of one topic, serialised, each with its receive time."""

    kind: str
    topic: str
    cls: Any
    """Class of the message objects."""
    times: list[int]
    """ns since 1970, ascending, each once."""
    wires: list[bytes]
    hz: float

    def __len__(self) -> int:
        return len(self.times)

    @property
    def total_bytes(self) -> int:
        """Serialised bytes of all."""
        return sum(map(len, self.wires))

    @property
    def rate(self) -> tuple[float, float]:
        """Messages and bytes a second of the time in which they were received."""
        return self.hz, self.hz * self.total_bytes / max(1, len(self))

    @property
    def header(self) -> dict[str, str]:
        """What the publisher says when it connects."""
        return {
            "callerid": "/benchmark",
            "topic": self.topic,
            "type": self.cls._type,
            "md5sum": self.cls._md5sum,
            "message_definition": self.cls._full_text,
        }

    @property
    def connection(self) -> Connection:
        """The same as the store takes it."""
        fields = [f"{name}={value}".encode() for name, value in self.header.items()]
        return Connection(self.topic, b"".join(struct.pack("<I", len(f)) + f for f in fields))

    def objects(self) -> Iterator[Any]:
        """Make a message object of each."""
        for wire in self.wires:
            yield self.cls().deserialize(wire)

    def first(self, count: int, topic: str = "") -> Batch:
        """Return the first ones, under another topic."""
        times, wires = self.times[:count], self.wires[:count]
        return replace(self, times=times, wires=wires, topic=topic or self.topic)


def serialized(msg: Any) -> bytes:
    """Return the wire bytes of a message object."""
    buffer = BytesIO()
    msg.serialize(buffer)
    return buffer.getvalue()


def _times(count: int, hz: float) -> np.ndarray:
    return START_NS + (np.arange(count, dtype=np.int64) * int(1e9 / hz))


def _text(name: str, text: str) -> Layout:
    return [(f"{name}_length", "<u4"), (name, f"S{len(text)}")]


_HEADER: Layout = [("seq", "<u4"), ("secs", "<u4"), ("nsecs", "<u4")]


def _fill_header(rows: Any, times: np.ndarray) -> None:
    rows["seq"] = np.arange(len(rows))
    rows["secs"], rows["nsecs"] = times // 10**9, times % 10**9


def _fill_text(rows: Any, name: str, text: str) -> None:
    rows[f"{name}_length"], rows[name] = len(text), text.encode()


def _split(rows: Any) -> list[bytes]:
    size, data = rows.dtype.itemsize, rows.tobytes()
    return [data[at : at + size] for at in range(0, len(data), size)]


def paper(count: int, hz: float = 100.0) -> Batch:
    """Make the paper's message, all of it random."""
    rand = np.random.default_rng(1)
    head = np.zeros(
        count, dtype=[("a", "i1"), ("b", "<i2"), ("c", "<i4"), ("d", "<i8"), ("n", "<u4")]
    )
    for name in "abcd":
        limits = np.iinfo(head.dtype[name])
        head[name] = rand.integers(limits.min, limits.max, count, head.dtype[name], True)
    head["n"] = rand.integers(1, 201, count)
    noise = rand.bytes(int(head["n"].sum()))
    ends = np.cumsum(head["n"]).tolist()
    starts = [0, *ends[:-1]]
    wires = [h + noise[a:b] for h, a, b in zip(_split(head), starts, ends)]
    return Batch("paper", "/paper", paper_class(), _times(count, hz).tolist(), wires, hz)


@lru_cache(maxsize=None)
def paper_class() -> Any:
    """Return the class of the paper's message."""
    return generate_dynamic(PAPER_TYPE, PAPER)[PAPER_TYPE]


IMU_PARTS = (
    ("orientation", 4),
    ("orientation_covariance", 9),
    ("angular_velocity", 3),
    ("angular_velocity_covariance", 9),
    ("linear_acceleration", 3),
    ("linear_acceleration_covariance", 9),
)


def imu_rows(count: int, hz: float = 100.0) -> tuple[np.ndarray, Any]:
    """Return receive times and the fields of Imu messages, each a row of wire bytes (320)."""
    rand = np.random.default_rng(2)
    parts: Layout = [(name, "<f8", (n,)) for name, n in IMU_PARTS]
    rows = np.zeros(count, dtype=[*_HEADER, *_text("frame", "imu_link"), *parts])
    times = _times(count, hz)
    _fill_header(rows, times)
    _fill_text(rows, "frame", "imu_link")
    for name, n in IMU_PARTS:
        rows[name] = rand.standard_normal((count, n))
    return times, rows


def imu(count: int, hz: float = 100.0) -> Batch:
    """Make Imu messages."""
    times, rows = imu_rows(count, hz)
    return imu_batch(times, rows, hz)


def imu_batch(times: np.ndarray, rows: Any, hz: float = 100.0) -> Batch:
    """Serialise rows of imu_rows."""
    return Batch("imu", "/imu", Imu, times.tolist(), _split(rows), hz)


TF_CHILDREN = ("base_link", "laser", "camera", "wheel_left", "wheel_right")


def tf(count: int, hz: float = 50.0) -> Batch:
    """Make tf messages with 5 transforms."""
    rand = np.random.default_rng(3)
    layout: Layout = [("count", "<u4")]
    for i, child in enumerate(TF_CHILDREN):
        part = [*_HEADER, *_text("frame", "odom"), *_text("child", child), ("pose", "<f8", (7,))]
        layout.append((f"t{i}", part))
    rows = np.zeros(count, dtype=layout)
    rows["count"], times = len(TF_CHILDREN), _times(count, hz)
    for i, child in enumerate(TF_CHILDREN):
        part = rows[f"t{i}"]
        _fill_header(part, times)
        _fill_text(part, "frame", "odom")
        _fill_text(part, "child", child)
        part["pose"] = rand.standard_normal((count, 7))
    return Batch("tf", "/tf", TFMessage, times.tolist(), _split(rows), hz)


def scan(count: int, hz: float = 20.0) -> Batch:
    """Make LaserScans of 720 beams with intensities, 5.8 KB."""
    rand, beams = np.random.default_rng(4), 720
    layout: Layout = [*_HEADER, *_text("frame", "laser"), ("setup", "<f4", (7,))]
    for name in ("ranges", "intensities"):
        layout += [(f"{name}_length", "<u4"), (name, "<f4", (beams,))]
    rows, times = np.zeros(count, dtype=layout), _times(count, hz)
    _fill_header(rows, times)
    _fill_text(rows, "frame", "laser")
    rows["setup"] = (-1.57, 1.57, 0.00436, 0.0, 0.05, 0.1, 30.0)
    for name in ("ranges", "intensities"):
        rows[f"{name}_length"] = beams
        rows[name] = rand.random((count, beams), dtype=np.float32) * 30
    return Batch("scan", "/scan", LaserScan, times.tolist(), _split(rows), hz)


JOINTS = tuple(f"joint_{i}" for i in range(6))


def joints(count: int, hz: float = 100.0) -> Batch:
    """Make JointStates of six joints."""
    rand = np.random.default_rng(5)
    layout: Layout = [*_HEADER, *_text("frame", "base"), ("names", "<u4")]
    for joint in JOINTS:
        layout += _text(joint, joint)
    for name in ("position", "velocity", "effort"):
        layout += [(f"{name}_length", "<u4"), (name, "<f8", (len(JOINTS),))]
    rows, times = np.zeros(count, dtype=layout), _times(count, hz)
    _fill_header(rows, times)
    _fill_text(rows, "frame", "base")
    rows["names"] = len(JOINTS)
    for joint in JOINTS:
        _fill_text(rows, joint, joint)
    for name in ("position", "velocity", "effort"):
        rows[f"{name}_length"] = len(JOINTS)
        rows[name] = rand.standard_normal((count, len(JOINTS)))
    return Batch("joints", "/joint_states", JointState, times.tolist(), _split(rows), hz)


def _large(kind: str, msg: Any, size: int, count: int, hz: float) -> Batch:
    """Make messages whose uint8[] of so many bytes is random; it is the last but is_dense."""
    rand = np.random.default_rng(6)
    msg.data = bytes(size)
    wire = serialized(msg)
    at = wire.rindex(struct.pack("<I", size), 0, len(wire) - size) + 4
    wires = []
    for seq in range(count):
        stamp = struct.pack("<III", seq, *divmod(START_NS + int(seq * 1e9 / hz), 10**9))
        wires.append(stamp + wire[12:at] + rand.bytes(size) + wire[at + size :])
    return Batch(kind, f"/{kind}", type(msg), _times(count, hz).tolist(), wires, hz)


def image(count: int, hz: float = 30.0) -> Batch:
    """Make images of 640 x 480 pixels, rgb8: 0.9 MB."""
    msg = Image(height=480, width=640, encoding="rgb8", step=1920)
    msg.header.frame_id = "camera"
    return _large("image", msg, 640 * 480 * 3, count, hz)


def blob(count: int, size: int, hz: float) -> Batch:
    """Make images of so many bytes."""
    msg = Image(height=1, width=size, encoding="mono8", step=size)
    return _large("blob", msg, size, count, hz)


def cloud(count: int, hz: float = 10.0) -> Batch:
    """Make clouds of 65,536 points: 1 MB."""
    points = 65_536
    fields = [
        PointField(n, 4 * i, PointField.FLOAT32, 1) for i, n in enumerate(("x", "y", "z", "i"))
    ]
    msg = PointCloud2(height=1, width=points, fields=fields, point_step=16, row_step=16 * points)
    msg.header.frame_id, msg.is_dense = "lidar", True
    return _large("cloud", msg, 16 * points, count, hz)


KINDS: dict[str, Callable[..., Batch]] = {
    "paper": paper,
    "imu": imu,
    "tf": tf,
    "joints": joints,
    "scan": scan,
    "image": image,
    "cloud": cloud,
}
NAMES = {
    "paper": "the paper's message, 120 B",
    "imu": "Imu, 320 B",
    "tf": "tf of 5 transforms, 0.5 KB",
    "joints": "JointState of 6, 0.3 KB",
    "scan": "LaserScan, 5.8 KB",
    "image": "Image 640x480, 0.9 MB",
    "cloud": "PointCloud2, 1 MB",
}
SMALL = ("paper", "imu", "tf", "joints")
LARGE = ("image", "cloud")
