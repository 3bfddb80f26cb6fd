# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Apache Cassandra: download, configure for loopback, start and stop.

This room uses neither ROS nor the database driver. Its main module is `cluster`.
"""

from __future__ import annotations

from cassandra_ros.local_server.cluster import LocalCluster
from cassandra_ros.local_server.jars import install_jars
from cassandra_ros.local_server.nodes import NodeStatus
from cassandra_ros.local_server.ports import free_port

__all__ = ["LocalCluster", "NodeStatus", "free_port", "install_jars"]
