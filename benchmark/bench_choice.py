# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare packed with ros on topics as robots have them: what 'import' should choose for each.

Each topic is a bag, which is imported in both formats, in turn; and its messages are written in
blocks of half a second, as a recorder packs them. Bytes on disk are the data files of the tables
after Cassandra was stopped, which writes everything to them. Times are those of the processor, of
this process and of the server together, so that other work on the machine hardly counts. Values
change as those of sensors do: slowly, with noise, in steps of the sensor. Real bags are
imported in the formats that are chosen, and written by rosbag with bz2. Prints the two tables of
doc/formats.md.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable

import numpy as np
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import (
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    NavSatFix,
    PointCloud2,
)
from std_msgs.msg import String
from suite.experiments.bags import BAGS, bytes_of, find_bag, messages_of, write_bag
from suite.messages import START_NS, serialized
from suite.server import Server
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.format_choice import choose_format
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.size_estimate import sample_file
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.recording.option_values import BLOCK_SEC
from cassandra_ros.store.blocks.block_builder import BlockLimits
from cassandra_ros.store.tables.lengths import MAX_BLOCK_BYTES, MAX_BLOCK_MESSAGES
from cassandra_ros.topics.message_writer import MessageWriter

TOPIC_BYTES = 16 << 20
MAX_SEC = 120
FORMATS = ("ros", "packed")
_noise = np.random.default_rng(1)


def moved(msg: Any, t: float, frame: str) -> Any:
    """Return a message with its header filled."""
    msg.header.seq = round(t * 1000)
    msg.header.stamp.secs, msg.header.stamp.nsecs = divmod(START_NS + round(t * 1e9), 10**9)
    msg.header.frame_id = frame
    return msg


def set_all(target: Any, **values: float) -> None:
    """Set the fields of a point, a vector or a quaternion."""
    for name, value in values.items():
        setattr(target, name, value)


def steps(value: Any, noise: float, step: float) -> Any:
    """Return a value with noise, in the steps of a sensor."""
    return np.round((value + _noise.normal(0, noise, np.shape(value))) / step) * step


def turn(t: float) -> dict[str, float]:
    return {"z": math.sin(0.05 * t), "w": math.cos(0.05 * t)}


def imu(t: float) -> Imu:
    msg = moved(Imu(), t, "imu_link")
    set_all(msg.orientation, **turn(t))
    set_all(
        msg.linear_acceleration, **dict(zip("xyz", steps(np.array([0, 0, 9.81]), 0.05, 0.0024)))
    )
    set_all(msg.angular_velocity, **dict(zip("xyz", steps(np.array([0, 0, 0.1]), 0.01, 0.0011))))
    return msg


def odometry(t: float) -> Odometry:
    msg = moved(Odometry(child_frame_id="base_link"), t, "odom")
    set_all(msg.pose.pose.position, x=5 * math.cos(0.1 * t), y=5 * math.sin(0.1 * t))
    set_all(msg.pose.pose.orientation, **turn(t))
    msg.twist.twist.linear.x = float(steps(0.5, 0.01, 0.001))
    msg.pose.covariance = [0.001 * (i % 7 == 0) for i in range(36)]
    return msg


def transforms(t: float) -> TFMessage:
    msg = TFMessage()
    for frame, child in (("odom", "base_link"), ("base_link", "wheel_l"), ("base_link", "wheel_r")):
        one = moved(TransformStamped(child_frame_id=child), t, frame)
        set_all(one.transform.translation, x=5 * math.cos(0.1 * t), y=5 * math.sin(0.1 * t))
        set_all(one.transform.rotation, **turn(t))
        msg.transforms.append(one)
    return msg


def joints(t: float) -> JointState:
    msg = moved(JointState(name=[f"joint_{n}" for n in range(6)]), t, "")
    msg.position = steps(np.sin(0.3 * t + np.arange(6)), 0.0005, 0.0003).tolist()
    msg.velocity = steps(0.3 * np.cos(0.3 * t + np.arange(6)), 0.005, 0.001).tolist()
    return msg


def scan(t: float) -> LaserScan:
    msg = moved(LaserScan(range_max=30.0), t, "laser")
    walls = 3 + np.abs(np.sin(np.arange(720) / 90 + 0.05 * t)) * 4
    msg.ranges = steps(walls, 0.01, 0.001).astype(np.float32).tolist()
    return msg


def command(t: float) -> Twist:
    msg = Twist()
    msg.linear.x, msg.angular.z = 0.5, float(steps(0.1 * math.sin(t), 0.01, 0.01))
    return msg


def fix(t: float) -> NavSatFix:
    msg = moved(NavSatFix(), t, "gps")
    msg.latitude, msg.longitude, msg.altitude = steps(np.array([43.4, -80.4, 273.2]), 1e-6, 1e-7)
    return msg


def picture(size: int) -> Callable[[float], CompressedImage]:
    return lambda t: moved(CompressedImage(format="jpeg", data=_noise.bytes(size)), t, "camera")


def image(t: float) -> Image:
    shades = 120 + 60 * np.sin(np.arange(640) / 80 + t) + np.arange(480)[:, None] / 8
    pixels = np.clip(steps(shades, 1.5, 1), 0, 255).astype(np.uint8)
    return moved(
        Image(height=480, width=640, step=640, encoding="mono8", data=pixels.tobytes()), t, "camera"
    )


def cloud(t: float) -> PointCloud2:
    angles = np.linspace(0, 2 * math.pi, 20_000)
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles]) * steps(5 + t / 60, 0.02, 0.002)
    data = (points.T + _noise.normal(0, 0.01, (20_000, 3))).astype("<f4").tobytes()
    return moved(PointCloud2(height=1, width=20_000, point_step=12, data=data), t, "lidar")


def grid(t: float) -> OccupancyGrid:
    cells = np.where(_noise.random((200, 200)) < 0.02, 100, 0).astype(np.int8)
    return OccupancyGrid(data=cells.ravel().tolist())


@dataclass(frozen=True)
class Kind:
    """A topic of a robot."""

    name: str
    make: Callable[[float], Any]
    """Returns the message of a time, s."""
    hz: float

    @property
    def keyspace(self) -> str:
        """Beginning of the names of its keyspaces."""
        return "".join(c if c.isalnum() else "_" for c in self.name.lower())


KINDS = (
    Kind("Imu", imu, 200),
    Kind("tf, 3 transforms", transforms, 100),
    Kind("JointState", joints, 50),
    Kind("Odometry", odometry, 50),
    Kind("LaserScan 40", scan, 40),
    Kind("Twist", command, 20),
    Kind("LaserScan 10", scan, 10),
    Kind("Odometry 10", odometry, 10),
    Kind("NavSatFix", fix, 5),
    Kind("String, status", lambda t: String(f"state {int(t) % 5}: ok"), 1),
    Kind("OccupancyGrid, latched", grid, 1 / MAX_SEC),
    Kind("CompressedImage small", picture(40_000), 15),
    Kind("CompressedImage large", picture(150_000), 15),
    Kind("Image, mono", image, 15),
    Kind("PointCloud2", cloud, 10),
)


@dataclass
class Measured:
    """A kind as a bag, and what is measured of it."""

    kind: Kind
    path: Path
    times: list[int]
    wires: list[bytes]
    seconds: dict[str, list[float]]

    @property
    def size(self) -> float:
        """Mean size of a message, bytes."""
        return sum(map(len, self.wires)) / len(self.wires)

    def keyspace(self, way: str) -> str:
        """Return the name of the keyspace of the last round: what was dropped may be on disk."""
        return f"{self.kind.keyspace}_{way}_{len(self.seconds.get(way, ()))}"


def write(kind: Kind, folder: Path) -> Measured:
    """Write the bag of a kind."""
    first = serialized(kind.make(0.0))
    count = max(1, min(round(kind.hz * MAX_SEC), TOPIC_BYTES // len(first)))
    stamps = [n / kind.hz for n in range(count)]
    wires = [first, *(serialized(kind.make(t)) for t in stamps[1:])]
    times = [START_NS + round(t * 1e9) for t in stamps]
    path = folder / f"{kind.keyspace}.bag"
    with BagWriter(path) as writer:
        number = writer.connection(connection_of(kind))
        for t_ns, wire in zip(times, wires):
            writer.write(number, t_ns, wire)
    return Measured(kind, path, times, wires, {name: [] for name in FORMATS})


def connection_of(kind: Kind) -> Any:
    return api_connection("/t", definition_of(type(kind.make(0.0))), "/bench")


def store_imported(server: Server, one: Measured, form: str) -> None:
    """Import a bag into a new keyspace, and note the processor time, s."""
    server.drop(one.keyspace(form))
    one.seconds[form].append(0.0)
    name = one.keyspace(form)
    with RosCassandra(server.host, server.port, keyspace=name) as store:
        store.connectToKeyspace(name)
        store.catalog.keyspace.side_tables.make()
        begin = time.process_time() + (server.cpu() or 0)
        import_bag(store, one.path, format=form)
        one.seconds[form][-1] = time.process_time() + (server.cpu() or 0) - begin


def store_recorded(server: Server, one: Measured) -> None:
    """Write the messages in blocks of half a second."""
    name, most = one.keyspace("recorded"), max(1, round(one.kind.hz * BLOCK_SEC))
    with RosCassandra(server.host, server.port, keyspace=name) as store:
        store.connectToKeyspace(name)
        limits = BlockLimits(min(most, MAX_BLOCK_MESSAGES), MAX_BLOCK_BYTES)
        with MessageWriter(store.catalog.keyspace, 7, format="packed", limits=limits) as writer:
            handle = writer.connect(connection_of(one.kind), span_ns=10**11)
            for number, (t_ns, wire) in enumerate(zip(one.times, one.wires)):
                writer.write(handle, t_ns, number, wire)


def print_table(server: Server, measured: list[Measured]) -> None:
    """Print bytes and times of a message, as parts of those of ros."""
    head = "topic", "rate", "message", "`ros`", "`packed`, recorded", "`packed`, imported"
    print("|", " | ".join((*head, "processor time", "chosen")), "|")
    print("| --- |", " ---: |" * 6, " --- |", sep="")
    for one in measured:
        ways = ("ros", "recorded", "packed")
        disk = [server.keyspace_bytes(one.keyspace(way), "*-Data.db") for way in ways]
        times = [statistics.median(one.seconds[form][1:]) for form in FORMATS]
        with open_file(str(one.path)) as reader:
            (sample,) = sample_file(reader, None, 1000)
        row = (
            one.kind.name,
            f"{one.kind.hz:.3g}/s",
            f"{one.size:,.0f} B",
            f"{disk[0] / len(one.wires):,.0f} B",
            *(f"{bytes_ / disk[0]:.2f}" for bytes_ in disk[1:]),
            f"{times[1] / times[0]:.2f}",
            f"`{choose_format(sample).format}`",
        )
        print("|", " | ".join(row), "|")


@dataclass(frozen=True)
class RealBag:
    """A bag that was imported in the formats that are chosen."""

    name: str
    keyspace: str
    wire_bytes: int
    """Serialised bytes of its messages together."""
    bz2_bytes: int
    """Size of the bag that rosbag writes of them, compressed with bz2."""


def store_real(server: Server, path: Path, folder: Path) -> RealBag:
    """Import a bag as it is, without naming a format; and write it with bz2."""
    messages = messages_of(path)
    small = folder / "bz2.bag"
    write_bag(messages, small, "bz2")
    keyspace = "chosen_" + path.stem
    with RosCassandra(server.host, server.port, keyspace=keyspace) as store:
        import_bag(store, path)
    return RealBag(path.name, keyspace, bytes_of(messages), small.stat().st_size)


def print_bags(server: Server, bags: list[RealBag]) -> None:
    """Print the bytes of each bag, as parts of those of its messages."""
    print("\n| bag | all files of the tables | data alone | bag with bz2 |")
    print("| --- |", " ---: |" * 3, sep="")
    for bag in bags:
        files, data = (server.keyspace_bytes(bag.keyspace, names) for names in ("*", "*-Data.db"))
        parts = (f"{nbytes / bag.wire_bytes:.3f}" for nbytes in (files, data, bag.bz2_bytes))
        print("|", " | ".join((bag.name, *parts)), "|")


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="of timing (%(default)s)")
    args = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory(prefix="cassandra_ros_choice_") as folder:
            measured = [write(kind, Path(folder)) for kind in KINDS]
            server = Server(Path(folder) / "server")
            server.start()
            try:
                for number in range(args.rounds + 1):
                    for one in measured:
                        print(f"round {number}: {one.kind.name}", file=sys.stderr, flush=True)
                        for form in FORMATS[:: 1 if number % 2 else -1]:
                            store_imported(server, one, form)
                for one in measured:
                    store_recorded(server, one)
                paths = filter(None, map(find_bag, BAGS))
                real = [store_real(server, path, Path(folder)) for path in paths]
                server.stop()
                print_table(server, measured)
                print_bags(server, real)
            finally:
                server.stop()
    except CassandraRosError as exc:
        print(f"choice: {exc}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
