# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A bag of a robot that we know all about: it drives a circle in a room, scans and looks.

The circle is 2 m around the origin of ``odom``, once in 20 s, counterclockwise from (2, 0). The
room's walls are at x = -4 and 4 m, y = -3 and 3 m. A picture has a quarter of one colour each; the
upper left one changes after half of the time.
"""

from __future__ import annotations

import io
import math

import genpy
import numpy as np
import rosbag
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import CompressedImage, LaserScan
from tf2_msgs.msg import TFMessage

SECOND = 10**9
START = 1368025200 * SECOND
"""2013-05-08T15:00:00Z"""
LENGTH_SEC = 20
END = START + LENGTH_SEC * SECOND
CAMERA, SCAN, ODOM, MAP = "/camera/image/compressed", "/scan", "/odom", "/map"
RADIUS = 2.0
HALF = (4.0, 3.0)
"""From the middle of the room to its walls, m: x, y."""
BEAMS = 180
LASER_X = 0.2
SIZE = (320, 240)
COLOURS = {"early": (220, 30, 30), "late": (230, 200, 20)}
"""Colour of the upper left quarter of a picture, by the time in the round."""
OTHERS = ((30, 160, 40), (30, 60, 220), (240, 240, 240))
"""Colours of the upper right, lower left and lower right quarters."""


def pose(seconds):
    """Where the robot is: x, y, yaw."""
    angle = 2 * math.pi * seconds / LENGTH_SEC
    return RADIUS * math.cos(angle), RADIUS * math.sin(angle), angle + math.pi / 2


def write(path):
    """Write the bag."""
    with rosbag.Bag(str(path), "w") as bag:
        for k in range(LENGTH_SEC * 20):
            _put(bag, "/tf", TFMessage([_transform(k / 20)]), k / 20)
        for k in range(LENGTH_SEC * 10):
            _put(bag, ODOM, _odometry(k / 10), k / 10)
        for k in range(LENGTH_SEC * 5):
            _put(bag, SCAN, _scan(k / 5), k / 5)
        for k in range(LENGTH_SEC * 2):
            _put(bag, CAMERA, _picture(k / 2), k / 2)
        _put(bag, "/tf_static", TFMessage([_mount()]), 0, latching=True)
        _put(bag, MAP, _map(), 0, latching=True)


def _put(bag, topic, msg, seconds, latching=False):
    header = {
        "topic": topic,
        "type": msg._type,
        "md5sum": msg._md5sum,
        "message_definition": msg._full_text,
        "callerid": "/patrol",
        "latching": "01"[latching],
    }
    bag.write(topic, msg, _stamp(seconds), connection_header=header)


def _stamp(seconds):
    ns = START + round(seconds * SECOND)
    return genpy.Time(ns // SECOND, ns % SECOND)


def _headed(msg, frame, seconds):
    msg.header.stamp = _stamp(seconds)
    msg.header.frame_id = frame
    return msg


def _turned(rotation, yaw):
    rotation.z, rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)


def _transform(seconds):
    x, y, yaw = pose(seconds)
    msg = _headed(TransformStamped(), "odom", seconds)
    msg.child_frame_id = "base_link"
    msg.transform.translation.x, msg.transform.translation.y = x, y
    _turned(msg.transform.rotation, yaw)
    return msg


def _mount():
    msg = _headed(TransformStamped(), "base_link", 0)
    msg.child_frame_id = "laser"
    msg.transform.translation.x = LASER_X
    msg.transform.rotation.w = 1.0
    return msg


def _odometry(seconds):
    x, y, yaw = pose(seconds)
    msg = _headed(Odometry(), "odom", seconds)
    msg.child_frame_id = "base_link"
    msg.pose.pose.position.x, msg.pose.pose.position.y = x, y
    _turned(msg.pose.pose.orientation, yaw)
    msg.twist.twist.linear.x = 2 * math.pi * RADIUS / LENGTH_SEC
    return msg


def _scan(seconds):
    x, y, yaw = pose(seconds)
    x, y = x + LASER_X * math.cos(yaw), y + LASER_X * math.sin(yaw)
    msg = _headed(LaserScan(), "laser", seconds)
    msg.angle_min, msg.angle_increment = -math.pi, 2 * math.pi / BEAMS
    msg.angle_max = msg.angle_min + (BEAMS - 1) * msg.angle_increment
    msg.range_min, msg.range_max, msg.scan_time = 0.1, 30.0, 0.2
    angles = yaw + msg.angle_min + msg.angle_increment * np.arange(BEAMS)
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        to_x = (np.copysign(HALF[0], cos) - x) / cos
        to_y = (np.copysign(HALF[1], sin) - y) / sin
    msg.ranges = np.minimum(to_x, to_y).astype(np.float32).tolist()
    return msg


def _map():
    msg = _headed(OccupancyGrid(), "odom", 0)
    msg.info.resolution = 0.1
    msg.info.width, msg.info.height = 84, 64
    msg.info.origin.position.x, msg.info.origin.position.y = -4.2, -3.2
    msg.info.origin.orientation.w = 1.0
    cells = np.full((64, 84), -1, np.int8)
    cells[1:-1, 1:-1] = 100
    cells[2:-2, 2:-2] = 0
    msg.data = cells.ravel().tolist()
    return msg


def _picture(seconds):
    from PIL import Image

    width, height = SIZE
    early = "early" if seconds < LENGTH_SEC / 2 else "late"
    image = Image.new("RGB", SIZE, OTHERS[2])
    image.paste(COLOURS[early], (0, 0, width // 2, height // 2))
    image.paste(OTHERS[0], (width // 2, 0, width, height // 2))
    image.paste(OTHERS[1], (0, height // 2, width // 2, height))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=90)
    msg = _headed(CompressedImage(), "camera", seconds)
    msg.format, msg.data = "jpeg", file.getvalue()
    return msg
