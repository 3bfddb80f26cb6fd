# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS time in nanoseconds, wall or simulated.

rospy subscribes to /clock itself with a queue of one message, which a second subscription in the
process then shares: a recorder of /clock would lose most of it. So the node is started with
``disable_rostime=True``, and /clock is followed here.
"""

from __future__ import annotations

import struct
import time
from typing import Any, Mapping

import rospy

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.nodes.subscription import subscribe

_CLOCK = "/clock"
_STAMP = struct.Struct("<II")


def followClock() -> None:
    """Let rospy's time be the simulated one where /use_sim_time says so."""
    if rospy.get_param("/use_sim_time", False):
        rospy.rostime._set_rostime(rospy.Time(0, 0))
        subscribe(_CLOCK, _take)


def nowNs() -> int:
    """Tell the time; exactly, while rospy's wall clock goes through a float.

    Raises:
        ClockNotSet: Simulated time is in use and no /clock message has come.
    """
    if rospy.rostime.is_wallclock():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet("simulated time is in use and no /clock message had come")
    return now


def _take(topic: str, header: Mapping[str, Any], wire: bytes) -> None:
    if len(wire) == _STAMP.size:
        rospy.rostime._set_rostime(rospy.Time(*_STAMP.unpack(wire)))
