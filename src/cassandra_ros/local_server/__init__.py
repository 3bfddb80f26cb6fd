# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Apache Cassandra: fetched with Maven, configured for loopback, started and stopped.

Nothing here knows ROS or the database driver; `cluster` joins the parts:

* `paths`      where jars and data lie
* `settings`   what a cluster is: nodes, address, ports, heap; kept in its directory
* `nodes`      the files of one node: configuration, logging, command line
* `java`, `jars`  what must be there before a start
* `cql`        whether a server answers, and which nodes it knows
* `chroots`    what Java needs where the root is no mount point
* `ports`, `processes`  what the machine knows: who listens, who runs
* `preflight`  what is checked before a start
* `diagnosis`  why a start failed, read from the server's log
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
