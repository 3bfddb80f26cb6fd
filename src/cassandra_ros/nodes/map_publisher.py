# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node map_publisher: it publishes one map, latched, until it is ended."""

from __future__ import annotations

import logging
from typing import Any, Callable, Sequence

import rospy

from cassandra_ros.nodes.ros_node import REMAP, bound_master_calls, forward_logging, own_name

_log = logging.getLogger(__name__)
_NAME = "map_publisher"


def publish_map(message: Any, topic: str, argv: Sequence[str], say: Callable[[str], None]) -> None:
    """Publish a message latched; return at a signal, or when the master ends the node.

    Args:
        message: A nav_msgs/OccupancyGrid.
        topic: Name of the topic.
        argv: The command line, with remappings.
        say: Prints a line for the user.
    """
    with own_name(_NAME, argv) as (name, full_name, taken):
        # With a name on the command line rospy would not choose an anonymous one.
        words = [word for word in argv if not (taken and word.startswith(REMAP))]
        rospy.init_node(name, argv=words, anonymous=taken, disable_rostime=True)
    forward_logging()
    bound_master_calls()
    if taken:
        _log.warning("a node %s runs already; this one is %s", full_name, rospy.get_name())
    publisher = rospy.Publisher(topic, type(message), latch=True, queue_size=1)
    publisher.publish(message)
    say(f"the map is latched on {publisher.resolved_name} until Ctrl-C")
    rospy.spin()
