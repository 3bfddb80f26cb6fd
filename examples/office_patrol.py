#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write a bag of a simulated robot that patrols an office for an hour: office_patrol.py OUT.bag.

It drives through five rooms, scans, looks, and sometimes bumps into something. After each tour it
charges, with scanner and camera off. The same bag comes out each time.
"""

from __future__ import annotations

import argparse
import io
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import genpy
import numpy as np
import rosbag
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from PIL import Image
from sensor_msgs.msg import BatteryState, CompressedImage, Imu, LaserScan
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

SECOND = 10**9
START = 1_778_058_000 * SECOND
"""2026-05-06T09:00:00Z"""
TOURS = ((30, 1_000), (1_240, 1_140), (2_600, 970))
"""Start and length of each tour, s after START."""
LENGTH_SEC = 3_600
SPEED = 0.5
"""Metres per second."""
BUMPS_SEC = (412.0, 1_507.0, 1_893.0, 3_034.0)
"""Seconds after START."""
BUMP_SEC = 0.4

WALLS = (
    ((0, 0), (14, 0)),
    ((14, 0), (14, 9)),
    ((14, 9), (0, 9)),
    ((0, 9), (0, 0)),
    # The corridor, with five doors.
    ((0, 4), (2, 4)),
    ((3, 4), (6.5, 4)),
    ((7.5, 4), (11, 4)),
    ((12, 4), (14, 4)),
    ((0, 5.5), (3, 5.5)),
    ((4, 5.5), (10, 5.5)),
    ((11, 5.5), (14, 5.5)),
    # Between the rooms.
    ((4.5, 0), (4.5, 4)),
    ((9, 0), (9, 4)),
    ((6, 5.5), (6, 9)),
)
DESKS = ((0.3, 2.6, 1.5, 3.7), (5, 2.4, 6, 3.7), (9.6, 2.4, 10.6, 3.7), (12.8, 6, 13.7, 7.4))
"""Least x and y, largest x and y of each, m."""
WAYPOINTS = (
    *((1, 4.4), (2.5, 4.6), (2.5, 2), (1.2, 1.2), (3.5, 1), (2.5, 2.2), (2.5, 4.75)),
    *((7, 4.75), (7, 2), (5.5, 1), (8, 1), (7, 2.2), (7, 4.75), (11.5, 4.75), (11.5, 2)),
    *((10, 1), (13, 1.2), (11.5, 2.2), (11.5, 4.75), (10.5, 4.75), (10.5, 7), (12.2, 8)),
    *((8, 8), (7.5, 6.5), (10.3, 6.6), (10.5, 4.75), (3.5, 4.75), (3.5, 7), (1.5, 8)),
    *((5, 8), (4.7, 6.6), (3.5, 6.5), (3.5, 4.9)),
    *((2.2, 5.1), (0.9, 5.1), (0.6, 4.75)),
)
"""One round, m; from the last point the robot drives to the first again."""
ROUNDINGS = 3
"""How often the corners of the way are cut."""

LASER_X, CAMERA_X = 0.2, 0.25
BEAMS = 180
PICTURE = (320, 240)
VIEW_RAD = math.radians(75)
PAINT = np.array(
    [(196, 178, 152), (120, 150, 170), (168, 120, 104), (132, 160, 118), (150, 128, 168)], float
)
"""Colours of the walls, which take turns."""
DESK_PAINT = np.array((112, 84, 58), float)
CELL_M = 0.05
EDGE_M = 0.5
"""Unknown ground around the office on its map."""


def _segments() -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of all walls and sides of desks, n x 2 x 2, and the colour of each."""
    sides = [
        side
        for x0, y0, x1, y1 in DESKS
        for side in (
            ((x0, y0), (x1, y0)),
            ((x1, y0), (x1, y1)),
            ((x1, y1), (x0, y1)),
            ((x0, y1), (x0, y0)),
        )
    ]
    paint = [PAINT[number % len(PAINT)] for number in range(len(WALLS))]
    return np.array([*WALLS, *sides], float), np.array([*paint, *[DESK_PAINT] * len(sides)])


SEGMENTS, COLOURS = _segments()


def _way() -> tuple[np.ndarray, np.ndarray]:
    """Return the points of one round, and the way to each of them, m."""
    points = np.array(WAYPOINTS)
    for _ in range(ROUNDINGS):
        following = np.roll(points, -1, axis=0)
        cut = (0.75 * points + 0.25 * following, 0.25 * points + 0.75 * following)
        points = np.stack(cut, axis=1).reshape(-1, 2)
    points = np.concatenate([points, points[:1]])
    return points, np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


POINTS, WAY = _way()


def tour_of(seconds: float) -> float | None:
    """Return for how long the tour has lasted at a time, s; None = the robot charges."""
    for start, length in TOURS:
        if start <= seconds < start + length:
            return seconds - start
    return None


def pose(seconds: float) -> tuple[float, float, float]:
    """Return where the robot is: x, y, m, and yaw, rad."""
    tour = tour_of(seconds)
    if tour is None:
        tour = 0.0  # in its charger
    at = (tour * SPEED) % WAY[-1]
    x, y = (float(np.interp(at, WAY, POINTS[:, axis])) for axis in (0, 1))
    ahead = [float(np.interp((at + 0.15) % WAY[-1], WAY, POINTS[:, axis])) for axis in (0, 1)]
    return x, y, math.atan2(ahead[1] - y, ahead[0] - x)


def _distances(x: float, y: float, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far a ray of each angle reaches, m, and the number of the segment it meets."""
    begin, along = SEGMENTS[:, 0] - (x, y), SEGMENTS[:, 1] - SEGMENTS[:, 0]
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = ray[..., 0] * along[:, 1] - ray[..., 1] * along[:, 0]
        far = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / across
        part = (begin[:, 0] * ray[..., 1] - begin[:, 1] * ray[..., 0]) / across
    hits = (far > 0) & (part >= 0) & (part <= 1)
    far = np.where(hits, far, np.inf)
    nearest = far.argmin(axis=1)
    return far[np.arange(len(angles)), nearest], nearest


def _stamp(seconds: float) -> genpy.Time:
    ns = START + round(seconds * SECOND)
    return genpy.Time(ns // SECOND, ns % SECOND)


class Office:
    """Makes the messages of the robot."""

    def __init__(self) -> None:
        self._random = np.random.RandomState(1)

    def _head(self, msg: genpy.Message, frame: str, seconds: float) -> genpy.Message:
        msg.header.stamp, msg.header.frame_id = _stamp(seconds), frame
        return msg

    def _frame(self, parent: str, child: str, place: tuple[float, ...], seconds: float) -> object:
        msg = self._head(TransformStamped(), parent, seconds)
        msg.child_frame_id = child
        x, y, yaw = place
        msg.transform.translation.x, msg.transform.translation.y = x, y
        msg.transform.rotation.z, msg.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        return msg

    def moving(self, seconds: float) -> TFMessage:
        return TFMessage([self._frame("odom", "base_link", pose(seconds), seconds)])

    def mounts(self) -> TFMessage:
        return TFMessage(
            [
                self._frame("map", "odom", (0, 0, 0), 0),
                self._frame("base_link", "laser", (LASER_X, 0, 0), 0),
                self._frame("base_link", "camera", (CAMERA_X, 0, 0), 0),
            ]
        )

    def odometry(self, seconds: float) -> Odometry:
        msg = self._head(Odometry(), "odom", seconds)
        msg.child_frame_id = "base_link"
        x, y, yaw = pose(seconds)
        msg.pose.pose.position.x, msg.pose.pose.position.y = x, y
        msg.pose.pose.orientation.z = math.sin(yaw / 2)
        msg.pose.pose.orientation.w = math.cos(yaw / 2)
        msg.twist.twist = self.command(seconds)
        msg.twist.twist.linear.x += self._random.normal(0, 0.004)
        return msg

    def command(self, seconds: float) -> Twist:
        msg = Twist()
        if tour_of(seconds) is not None:
            msg.linear.x = SPEED
            turned = pose(seconds + 0.1)[2] - pose(seconds)[2]
            msg.angular.z = math.remainder(turned, 2 * math.pi) / 0.1
        return msg

    def imu(self, seconds: float) -> Imu:
        msg = self._head(Imu(), "base_link", seconds)
        shaking = 0.02 if tour_of(seconds) is None else 0.25
        x, y, z = self._random.normal(0, shaking, 3)
        for bump in BUMPS_SEC:
            since = seconds - bump
            if 0 <= since < BUMP_SEC:
                x -= 9 * math.exp(-since / 0.1)
                z += 14 * math.exp(-since / 0.15) * math.cos(25 * since)
        msg.linear_acceleration.x, msg.linear_acceleration.y = x, y
        msg.linear_acceleration.z = 9.81 + z
        msg.angular_velocity.z = self.command(seconds).angular.z
        msg.orientation_covariance[0] = -1.0  # there is no estimate of the orientation
        return msg

    def scan(self, seconds: float) -> LaserScan:
        x, y, yaw = pose(seconds)
        msg = self._head(LaserScan(), "laser", seconds)
        msg.angle_min, msg.angle_increment = -math.pi, 2 * math.pi / BEAMS
        msg.angle_max = msg.angle_min + (BEAMS - 1) * msg.angle_increment
        msg.range_min, msg.range_max, msg.scan_time = 0.1, 30.0, 0.2
        angles = yaw + msg.angle_min + msg.angle_increment * np.arange(BEAMS)
        at = x + LASER_X * math.cos(yaw), y + LASER_X * math.sin(yaw)
        ranges = _distances(*at, angles)[0] + self._random.normal(0, 0.01, BEAMS)
        msg.ranges = ranges.astype(np.float32).tolist()
        return msg

    def picture(self, seconds: float) -> CompressedImage:
        """What the camera sees: each column shows the wall that its ray meets."""
        x, y, yaw = pose(seconds)
        width, height = PICTURE
        turns = VIEW_RAD * (0.5 - (np.arange(width) + 0.5) / width)
        at = x + CAMERA_X * math.cos(yaw), y + CAMERA_X * math.sin(yaw)
        far, met = _distances(*at, yaw + turns)
        far = far * np.cos(turns)
        desk = met >= len(WALLS)
        above, below = np.where(desk, 0.15, 1.7) / far, 0.7 / far  # m above and below the lens
        focal = width / 2 / math.tan(VIEW_RAD / 2)
        rows = (np.arange(height) + 0.5 - height / 2)[:, None] / focal
        shade = np.clip(1.15 - far / 12, 0.35, 1)[:, None]
        seen = np.where((rows < 0)[..., None], (232.0, 232.0, 228.0), (150.0, 144.0, 138.0))
        seen = seen * np.clip(0.55 + 1.2 * np.abs(rows), 0, 1)[..., None]
        seen = np.broadcast_to(seen, (height, width, 3))
        wall = (rows > -above) & (rows < below)
        seen = np.where(wall[..., None], COLOURS[met] * shade, seen)
        file = io.BytesIO()
        Image.fromarray(seen.astype(np.uint8)).save(file, "JPEG", quality=80)
        msg = self._head(CompressedImage(), "camera", seconds)
        msg.format, msg.data = "jpeg", file.getvalue()
        return msg

    def battery(self, seconds: float) -> BatteryState:
        driven = sum(min(max(seconds - start, 0), length) for start, length in TOURS)
        charged = seconds - driven
        msg = self._head(BatteryState(), "base_link", seconds)
        msg.percentage = min(max(0.97 - driven / 6_500 + charged / 2_600, 0), 1)
        msg.voltage = 22.4 + 3.4 * msg.percentage - 0.35 * (tour_of(seconds) is not None)
        msg.current = -3.2 if tour_of(seconds) is not None else 4.0
        msg.present = True
        return msg

    def map(self) -> OccupancyGrid:
        msg = self._head(OccupancyGrid(), "map", 0)
        width, height = (round((size + 2 * EDGE_M) / CELL_M) for size in (14, 9))
        cells = np.full((height, width), -1, np.int8)

        def fill(x0: float, y0: float, x1: float, y1: float, value: int) -> None:
            low_x, low_y, high_x, high_y = (round((v + EDGE_M) / CELL_M) for v in (x0, y0, x1, y1))
            cells[low_y : max(high_y, low_y) + 1, low_x : max(high_x, low_x) + 1] = value

        fill(0, 0, 14, 9, 0)
        for (x0, y0), (x1, y1) in WALLS:
            fill(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1), 100)
        for desk in DESKS:
            fill(*desk, 100)
        msg.info.resolution, msg.info.width, msg.info.height = CELL_M, width, height
        msg.info.origin.position.x = msg.info.origin.position.y = -EDGE_M
        msg.info.origin.orientation.w = 1.0
        msg.data = cells.ravel().tolist()
        return msg

    def messages(self) -> Iterator[tuple[float, str, genpy.Message]]:
        """Yield the second after START, the topic and the message of each, in the order of time."""
        yield 0, "/tf_static", self.mounts()
        yield 0, "/map", self.map()
        bumps = {round(bump * 20) for bump in BUMPS_SEC}
        ends = {round((bump + BUMP_SEC) * 20) for bump in BUMPS_SEC}
        for tick in range(LENGTH_SEC * 20):
            seconds = tick / 20
            driving = tour_of(seconds) is not None
            yield seconds, "/imu/data", self.imu(seconds)
            if tick in bumps or tick in ends:
                yield seconds, "/bumper", Bool(tick in bumps)
            if tick % 2 == 0:
                yield seconds, "/tf", self.moving(seconds)
                yield seconds, "/odom", self.odometry(seconds)
            if tick % 200 == 0:
                yield seconds, "/battery", self.battery(seconds)
            if driving and tick % 2 == 0:
                yield seconds, "/cmd_vel", self.command(seconds)
            if driving and tick % 4 == 0:
                yield seconds, "/scan", self.scan(seconds)
            if driving and tick % 20 == 0:
                yield seconds, "/camera/image/compressed", self.picture(seconds)


def write(path: Path) -> None:
    """Write the bag."""
    with rosbag.Bag(str(path), "w", compression=rosbag.Compression.LZ4) as bag:
        for seconds, topic, msg in Office().messages():
            header = {
                "topic": topic,
                "type": msg._type,
                "md5sum": msg._md5sum,
                "message_definition": msg._full_text,
                "callerid": "/patrol",
                "latching": "01"[topic in ("/map", "/tf_static")],
            }
            bag.write(topic, msg, _stamp(seconds), connection_header=header)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("bag", type=Path, help="file to write")
    write(parser.parse_args().bag)
    return 0


if __name__ == "__main__":
    sys.exit(main())
