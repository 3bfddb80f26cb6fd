# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Publishes simulated time on /clock, 50 times a second: FILE holds an offset to wall time, s."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import genpy
import rospy
from rosgraph_msgs.msg import Clock


def main() -> None:
    """Publish until the end of the node."""
    offset = Path(sys.argv[1])
    rospy.init_node("clock", disable_rostime=True)
    outlet = rospy.Publisher("/clock", Clock, queue_size=10, latch=True)
    while not rospy.is_shutdown():
        outlet.publish(Clock(genpy.Time.from_sec(time.time() + float(offset.read_text() or 0))))
        time.sleep(0.02)


if __name__ == "__main__":
    main()
