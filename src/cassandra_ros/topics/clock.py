# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The clock that stamps messages which come without a time."""

from __future__ import annotations

import sys
import time
from typing import Any, Callable, Optional

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.messages.stamps import toNs

Clock = Callable[[], Any]


def nowNs(clock: Optional[Clock]) -> int:
    """Tell the time: the given clock's, else rospy's where a node runs here, else wall time.

    Args:
        clock: Returns a time of any kind that toNs takes, or None.

    Returns:
        Nanoseconds since 1970.

    Raises:
        ClockNotSet: The node uses simulated time and no /clock message has come.
    """
    if clock is not None:
        return toNs(clock())
    # Not imported: a program without a node must not need rospy.
    rospy = sys.modules.get("rospy")
    if rospy is None or not rospy.core.is_initialized():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet(
            "simulated time is in use (/use_sim_time) and no /clock message has come yet: start "
            "the simulator or player, or give a key"
        )
    return now
