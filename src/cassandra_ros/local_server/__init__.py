# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Apache Cassandra: download, configure for loopback, start and stop.

``cluster`` has LocalCluster, one server or several of them. ``jars`` fetches Cassandra and checks
its sums, ``server_security`` has it ask for a login, ``processes`` knows which server is ours.
Beside the modules lie the files that they hand to Maven, Java and Cassandra: ``pom.xml`` and
``jars.txt`` say which Cassandra is fetched, ``cassandra.yaml`` and ``logback.xml`` how it is set.

In: a folder, a port. Out: a Cassandra that answers there.
This room imports no other, and uses neither ROS nor the driver of Cassandra.
"""

from __future__ import annotations

from cassandra_ros.local_server.cluster import LocalCluster
from cassandra_ros.local_server.jars import install_jars
from cassandra_ros.local_server.nodes import NodeStatus
from cassandra_ros.local_server.ports import free_port

__all__ = ["LocalCluster", "NodeStatus", "free_port", "install_jars"]
