# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node cassandra_ros: the store, asked over ROS services."""

from __future__ import annotations

import logging
from typing import Callable, Sequence

import rospy

from cassandra_ros.errors import InvalidName
from cassandra_ros.nodes.node import forward_logging, is_taken, resolved_name, wanted_name
from cassandra_ros.nodes.services import Services
from cassandra_ros.srv import ExecuteCQL, GetData, LookupTransform, Range
from cassandra_ros.topics.ros_cassandra import RosCassandra

NAME = "cassandra_ros"
PARAMETERS = ("host", "port", "keyspace", "allow_writes")

_log = logging.getLogger(__name__)

Say = Callable[[str], None]


def start_node(argv: Sequence[str]) -> dict[str, str]:
    """Become the node; return its private parameters, as texts.

    Args:
        argv: Command line with the program's name and ROS remappings.

    Raises:
        InvalidName: A node of this name lives; its services would be taken away.
        KeyboardInterrupt: The process was told to end before a master answered.
    """
    name = wanted_name(NAME, argv)
    full = resolved_name(name)
    if is_taken(full):
        raise InvalidName(
            f"a node {full} runs already: stop it with rosnode kill {full}, "
            "or give this one another name with __name:=other"
        )
    try:
        rospy.init_node(name, argv=list(argv))
    except rospy.ROSInitException as exc:
        if not rospy.is_shutdown():
            raise
        # rospy took the signal while it waited for a master.
        raise KeyboardInterrupt from exc
    forward_logging()
    given = {name: rospy.get_param(f"~{name}", None) for name in PARAMETERS}
    return {name: str(value) for name, value in given.items() if value is not None}


def serve(ros_cas: RosCassandra, say: Say, allow_writes: bool = False) -> None:
    """Answer requests until the node is shut down.

    Args:
        ros_cas: A RosCassandra connected to a keyspace.
        say: Prints a line.
        allow_writes: Let ~executeCQL change what is stored.
    """
    services = Services(ros_cas, allow_writes)
    rospy.Service("~getData", GetData, services.get_data)
    rospy.Service("~range", Range, services.range)
    rospy.Service("~executeCQL", ExecuteCQL, services.execute_cql)
    rospy.Service("~lookupTransform", LookupTransform, services.lookup_transform)
    absence = ros_cas.parts.side_tables.absence()
    if absence:
        _log.warning("%s; until then no topic is found", absence)
    say(f"services under {rospy.get_name()}")
    how = "writes are allowed" if allow_writes else "read-only"
    say(f"serving keyspace {ros_cas.keyspace}, {how}")
    rospy.spin()
