# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Units of fields, and of what is made of them."""

from __future__ import annotations

import pytest

from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.query.tree.parse import parse_select
from cassandra_ros.query.tree.units import _UNITS, unit_of


@pytest.mark.parametrize(
    ("kind", "term", "unit"),
    [
        ("geometry_msgs/Twist", "linear.x", "m/s"),
        ("geometry_msgs/TwistStamped", "twist.angular.z", "rad/s"),
        ("nav_msgs/Odometry", "pose.pose.position.x", "m"),
        ("nav_msgs/Odometry", "pose.pose.orientation.x", ""),
        ("nav_msgs/Odometry", "twist.twist.linear.x", "m/s"),
        ("sensor_msgs/Imu", "angular_velocity.z", "rad/s"),
        ("sensor_msgs/Imu", "linear_acceleration.x - linear_acceleration.y", "m/s²"),
        ("sensor_msgs/Imu", "linear_acceleration.x + angular_velocity.x", ""),
        ("sensor_msgs/Imu", "linear_acceleration.x * linear_acceleration.x", ""),
        ("sensor_msgs/LaserScan", "min(ranges)", "m"),
        ("sensor_msgs/LaserScan", "len(ranges)", ""),
        ("sensor_msgs/NavSatFix", "abs(latitude)", "°N"),
        ("sensor_msgs/NavSatFix", "longitude", "°E"),
        ("sensor_msgs/NavSatFix", "max(altitude)", "m"),
        ("sensor_msgs/NavSatFix", "count(altitude)", ""),
        ("sensor_msgs/NavSatFix", "header.seq", ""),
        ("tf2_msgs/TFMessage", "transforms.transform.translation.z", "m"),
        ("std_msgs/Float64", "data", ""),
    ],
)
def test_units_are_those_of_ros(kind, term, unit):
    (column,) = parse_select(f"select {term} from t").columns
    assert unit_of(column.what, installed_definition(kind)) == unit


def test_every_field_of_the_table_is_one():
    for kind, fields in _UNITS.items():
        definition = installed_definition(kind)
        known = {field.name for field in definition.specs[kind].fields}
        assert set(fields) <= known, kind
