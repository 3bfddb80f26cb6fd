# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node map_publisher: it publishes one map, latched, until it is ended."""

from __future__ import annotations

from typing import Any, Callable, Sequence

import rospy

from cassandra_ros.nodes.ros_node import start_named_node

_NAME = "map_publisher"


def publish_map(message: Any, topic: str, argv: Sequence[str], say: Callable[[str], None]) -> None:
    """Publish a message latched; return at a signal, or when the master ends the node.

    Args:
        message: A nav_msgs/OccupancyGrid.
        topic: Name of the topic.
        argv: The command line, with remappings.
        say: Prints a line for the user.
    """
    start_named_node(_NAME, argv, signals=True)
    publisher = rospy.Publisher(topic, type(message), latch=True, queue_size=1)
    publisher.publish(message)
    say(f"the map is latched on {publisher.resolved_name} until Ctrl-C")
    rospy.spin()
