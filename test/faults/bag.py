# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Writes a bag of numbered messages by rosbag: BAG LOG MESSAGES TOPICS START_NS HZ."""

from __future__ import annotations

import sys

import genpy
import rosbag
from std_msgs.msg import String

from faults.numbered import LOG_LINE, text_of


def main() -> None:
    """Write the bag, and what is in it into the log."""
    path, log_path, *numbers = sys.argv[1:]
    messages, topics, start_ns, hz = map(int, numbers)
    with rosbag.Bag(path, "w") as bag, open(log_path, "w", encoding="ascii") as log:
        for number in range(messages):
            time_ns = start_ns + number * 10**9 // hz
            stamp = genpy.Time(*divmod(time_ns, 10**9))
            bag.write(f"/numbered_{number % topics}", String(text_of(number)), stamp)
            log.write(LOG_LINE.format(number=number, time_ns=time_ns, connections=1))


if __name__ == "__main__":
    main()
