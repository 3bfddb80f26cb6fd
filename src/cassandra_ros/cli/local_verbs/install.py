# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fetch Apache Cassandra's jars with Maven, once for all local clusters.

They go to $ROS_HOME/cassandra_ros/jars ($CASSANDRA_ROS_JARS names another place). `start` does this
by itself when they are missing.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.local_verbs import say
from cassandra_ros.local_server import install_jars
from cassandra_ros.local_server.paths import cassandra_version, jars_directory


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: what is fetched stands in server/pom.xml."""


def run(options: argparse.Namespace) -> int:
    """Fetch what is missing and say where it is."""
    fetched = install_jars(say)
    say(
        f"Apache Cassandra {cassandra_version()} "
        f"{'is now' if fetched else 'was already'} in {jars_directory()}"
    )
    return 0
