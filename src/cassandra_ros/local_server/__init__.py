# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Apache Cassandra: fetched with Maven, configured for loopback, started and stopped.

Nothing here knows ROS or the database driver; `cluster` joins the parts:

* `paths`      where jars and data lie
* `settings`   what a cluster is: nodes, address, ports, heap; kept in its directory
* `nodes`      the files and the command line of one node, also inside of a chroot
* `jars`       Java and Cassandra's jars: found, or fetched with Maven
* `cql`        whether a server answers, and which nodes it knows
* `ports`, `processes`  what the machine knows: who listens, who runs; locks
* `preflight`  what is checked before a start, and why a start failed
* `cluster`    start, stop, status, clear
"""

from __future__ import annotations

from cassandra_ros.local_server.cluster import LocalCluster
from cassandra_ros.local_server.jars import install_jars, jars_installed
from cassandra_ros.local_server.nodes import NodeStatus
from cassandra_ros.local_server.ports import free_port
from cassandra_ros.local_server.settings import Settings

__all__ = [
    "LocalCluster",
    "NodeStatus",
    "Settings",
    "free_port",
    "install_jars",
    "jars_installed",
]
