# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ten seconds of a small robot, for the forty questions of doc/sql.md: each value is known.

It drives at 1 m/s, brakes from 5 s to 5.5 s, and stands. At 2 s and 7 s it hits a bump.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import BatteryState, CompressedImage, Imu, JointState, LaserScan, NavSatFix
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import installed_definition, serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.tables.registry import Loss, LossKind, Run

T0 = 1_600_000_000 * SECOND_NS
BEGAN = datetime(2020, 9, 13, 12, 26, 40, tzinfo=timezone.utc)
WRITERS = {"r1": 1, "r2": 2}
STEPS = range(100)
"""Tenths of a second."""


def at(seconds):
    return Stamp.from_ns(T0 + round(seconds * SECOND_NS))


def speed(n):
    """Speed of r1 in a tenth of a second, m/s."""
    return max(0.0, min(1.0, 1.0 - 0.2 * (n - 49)))


def travelled(n):
    """x of r1, m."""
    return sum(speed(m) for m in range(n)) / 10


def odometry(n, fast):
    message = Odometry(header=Header(stamp=at(n / 10), seq=n + (n > 30)))
    message.pose.pose.position.x = travelled(n) if fast else 0.05 * n
    message.pose.pose.orientation.z = math.sin(n / 200)
    message.pose.pose.orientation.w = math.cos(n / 200)
    message.twist.twist.linear.x = speed(n) if fast else 0.5
    return message


def imu(n):
    message = Imu(header=Header(stamp=at(n / 10 + 0.001)))
    message.linear_acceleration.z = 20.0 if n in (20, 70) else 9.81
    return message


def transform(n):
    moved = TransformStamped(header=Header(frame_id="map", stamp=at(n / 10)))
    moved.child_frame_id = "base_link"
    moved.transform.translation.x = travelled(n)
    moved.transform.rotation.w = 1.0
    return TFMessage([moved])


def joints(n):
    short = [] if n == 99 else [0.1, -0.05]
    names, places = ["elbow", "wrist"], [0.01 * n, -0.005 * n]
    return JointState(name=names, position=places, velocity=short, effort=[5.0 - abs(n - 30), 1.0])


def command(n):
    message = Twist()
    message.linear.x = 1.0 if n < 49 else 0.0
    return message


def status(n):
    level = DiagnosticStatus.WARN if n == 6 else DiagnosticStatus.OK
    states = [DiagnosticStatus(level=level, name="motor"), DiagnosticStatus(name="laser")]
    return DiagnosticArray(status=states)


def scan(n):
    return LaserScan(ranges=[1.0 + n, math.inf, math.nan, 2.0])


def fix(n):
    height = math.nan if n == 3 else 300.0 + n
    return NavSatFix(latitude=43.0 + n / 1000, longitude=-80.0, altitude=height)


def battery(n):
    full = BatteryState.POWER_SUPPLY_STATUS_FULL
    draining = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return BatteryState(voltage=12.5 - n / 8, power_supply_status=draining if n > 1 else full)


def images():
    """Times of the images, s: five a second, with a pause around the second bump."""
    return [n / 5 + 0.03 for n in range(50) if n not in (34, 35, 36)]


def recorded():
    """Yield (seconds, topic, message) of r1."""
    for n in STEPS:
        yield n / 10, "/odom", odometry(n, fast=True)
        yield n / 10 + 0.003, "/imu", imu(n)
        yield n / 10, "/tf", transform(n)
        yield n / 10, "/joint_states", joints(n)
        yield n / 10, "/cmd_vel", command(n)
    for n in range(10):
        yield n, "/diagnostics", status(n)
        yield n, "/scan", scan(n)
        yield n, "/fix", fix(n)
        yield n, "/battery", battery(n)
    for number, seconds in enumerate(images()):
        yield seconds, "/camera/compressed", CompressedImage(data=bytes(100 + number))
    yield 5.04, "/rosout", Log(level=Log.ERROR, name="/motor", msg="wheel slips")
    yield 5.2, "/rosout", Log(level=Log.INFO, name="/motor", msg="stands")


def write(store, robot, messages):
    """Store messages as a run of a robot."""
    writer_id = WRITERS[robot]
    ended = BEGAN + timedelta(seconds=10 * writer_id)
    run = Run(robot, writer_id, "recording", f"patrol {robot}", started=BEGAN, ended=ended)
    with store.messageWriter(nodeID=robot, writer_id=writer_id, format="packed", run=run) as writer:
        handles = {}
        for counter, (seconds, topic, message) in enumerate(messages):
            if topic not in handles:
                definition = installed_definition(message._type)
                handles[topic] = writer.connect(api_connection(topic, definition, f"/{robot}"))
            writer.write(handles[topic], at(seconds).ns, counter, serialize(message))
    store.catalog.keyspace.registry.put_run(run)


def fill(store):
    """Store what the robot recorded, and its slower companion r2."""
    write(store, "r1", sorted(recorded(), key=lambda each: each[0]))
    write(store, "r2", [(n / 10, "/odom", odometry(n, fast=False)) for n in STEPS])
    loss = Loss("/scan", "r1", 1, LossKind.BUFFER_FULL, T0, T0 + SECOND_NS // 2, 3)
    store.catalog.keyspace.registry.put_loss(loss)
    store.addEvent("bump", at(2), at(2.2), nodeID="r1")
    store.addEvent("bump", at(7), at(7.2), nodeID="r1")
    store.addEvent("docking", at(5), at(9), nodeID="r1")
