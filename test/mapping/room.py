# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A robot in a room whose walls are known: what its sensors, tf and odometry say."""

from __future__ import annotations

import math

import genpy
import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection

SEC = 10**9
T0 = 1_700_000_000 * SEC
WIDTH, HEIGHT = 8.0, 6.0
"""Metres; the room's middle is the origin of frame odom, and of odometry."""
OFFSET = (0.3, 0.1, math.pi / 2)
"""Pose of the laser on the robot."""
SHIFT = (2.0, -1.0, 0.25)
"""Pose of odom in map."""
PERIOD_NS = SEC // 10


def driven(t):
    """Where the robot is at a time, seconds: on an ellipse, its front ahead. x, y, yaw."""
    return 1.5 * math.cos(t), math.sin(t), math.atan2(math.cos(t), -1.5 * math.sin(t))


def joined(outer, inner):
    """The pose in the plane that comes of one pose in another."""
    x, y, yaw = outer
    u, v, turn = inner
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * u - s * v, y + s * u + c * v, yaw + turn


def to_wall(x, y, angles):
    """How far the walls are from a place, for some directions."""
    with np.errstate(divide="ignore"):
        across = (np.copysign(WIDTH / 2, np.cos(angles)) - x) / np.cos(angles)
        up = (np.copysign(HEIGHT / 2, np.sin(angles)) - y) / np.sin(angles)
    return np.minimum(across, up)


def stamped(message, ns, frame):
    message.header.stamp = genpy.Time(0, ns)
    message.header.frame_id = frame
    return message


def transform(parent, child, ns, pose):
    made = stamped(TransformStamped(child_frame_id=child), ns, parent)
    made.transform.translation.x, made.transform.translation.y, yaw = pose
    made.transform.rotation.z, made.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return made


def scan_at(t, ns, frame, beams=180):
    x, y, yaw = joined(driven(t), OFFSET)
    made = stamped(LaserScan(range_min=0.05, range_max=30.0), ns, frame)
    made.angle_min, made.angle_increment = -math.pi, 2 * math.pi / beams
    angles = made.angle_min + made.angle_increment * np.arange(beams)
    made.ranges = to_wall(x, y, yaw + angles).tolist()
    return made


def cloud_at(t, ns, frame, beams=180):
    """The walls at three heights over the sensor: the floor, one that counts, and the ceiling."""
    x, y, yaw = joined(driven(t), OFFSET)
    angles = 2 * math.pi / beams * np.arange(beams)
    lengths = to_wall(x, y, yaw + angles)
    points = np.concatenate(
        [
            np.stack(
                [s * lengths * np.cos(angles), s * lengths * np.sin(angles), 0 * angles + z], 1
            )
            for s, z in ((0.5, -0.3), (1, 0.7), (0.8, 4))
        ]
    ).astype("<f4")
    made = stamped(PointCloud2(height=1, width=len(points)), ns, frame)
    made.fields = [PointField(c, 4 * n, PointField.FLOAT32, 1) for n, c in enumerate("xyz")]
    made.point_step, made.row_step, made.data = 12, 12 * len(points), points.tobytes()
    return made


def odometry_at(t, ns):
    made = stamped(Odometry(child_frame_id="base"), ns, "odom")
    at = made.pose.pose
    at.position.x, at.position.y, yaw = driven(t)
    at.orientation.z, at.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return made


class Drive:
    """What a robot recorded on a round of 6.3 s, as (topic, message, key).

    Args:
        slash: Text before the names of frames.
        ahead_ns: Difference of the stamps of headers from the times of reception, ns.
        late_sec: Time until the first message on /tf, s.
    """

    def __init__(self, slash="", ahead_ns=0, late_sec=0.0):
        self.messages = []
        for n in range(64):
            t, key = n / 10, T0 + n * PERIOD_NS
            ns = key + ahead_ns
            # Scans lie between two transforms.
            middle, t2 = PERIOD_NS // 2, t + 0.05
            base = transform(f"{slash}odom", f"{slash}base", ns, driven(t))
            corrected = transform(f"{slash}map", f"{slash}odom", ns, SHIFT)
            if t >= late_sec:
                self.messages.append(("/tf", TFMessage([base, corrected]), key))
            self.messages.append(("/odom", odometry_at(t, ns), key))
            scan = scan_at(t2, ns + middle, f"{slash}laser")
            self.messages.append(("/scan", scan, key + middle))
            if n % 4 == 0:
                cloud = cloud_at(t2, ns + middle, f"{slash}laser")
                self.messages.append(("/points", cloud, key + middle))
        laser = TFMessage([transform(f"{slash}base", f"{slash}laser", T0, OFFSET)])
        self.messages.append(("/tf_static", laser, T0))

    def store(self, store, topics, node="", rename=None):
        """Store some topics of it, under other names where they are to have some."""
        writer = store.messageWriter(format="packed", nodeID=node)
        handles = {}
        found = sorted((each for each in self.messages if each[0] in topics), key=lambda e: e[2])
        for number, (topic, message, key) in enumerate(found):
            name = (rename or {}).get(topic, topic)
            if name not in handles:
                header = {
                    "topic": name,
                    "type": message._type,
                    "md5sum": message._md5sum,
                    "message_definition": message._full_text,
                }
                handles[name] = writer.connect(live_connection(name, header))
            writer.write(handles[name], key, number, serialize(message))
        writer.close()


def assert_room(made, shift=(0, 0, 0), walls=0.95):
    """Check that a map shows the room: walls are occupied, inside is free, outside is unknown."""
    rows, columns = np.nonzero(made.cells >= 65)
    assert len(rows) > 100
    x = made.x + (columns + 0.5) * made.resolution
    y = made.y + (rows + 0.5) * made.resolution
    # Back into the room's own frame.
    u, v = x - shift[0], y - shift[1]
    c, s = math.cos(shift[2]), math.sin(shift[2])
    x, y = c * u + s * v, -s * u + c * v
    off = np.maximum(np.abs(x) - WIDTH / 2, np.abs(y) - HEIGHT / 2)
    assert np.abs(off).max() < 2 * made.resolution
    # Cells of a wall are hit all along it.
    angles = np.arctan2(y, x)
    seen = np.unique(np.floor(angles / (2 * math.pi) * 90))
    assert len(seen) >= walls * 90
    free = (made.cells >= 0) & (made.cells < 50)
    assert 40 <= free.sum() * made.resolution**2 <= WIDTH * HEIGHT + 1
