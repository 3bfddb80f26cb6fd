# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the local Cassandra lies on disk."""

from __future__ import annotations

import os
import re
from pathlib import Path

from cassandra_ros.errors import ServerError


def ros_home() -> Path:
    """Return the ROS home: $ROS_HOME, else ~/.ros, as roslaunch resolves it."""
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")


def default_directory() -> Path:
    """Return the directory of the local Cassandra that is used when none is named."""
    return ros_home() / "cassandra_ros"


def jars_directory() -> Path:
    """Return where the server's jars lie; every local cluster of a user shares them.

    $CASSANDRA_ROS_JARS names another place, for example one that several users share.
    """
    named = os.environ.get("CASSANDRA_ROS_JARS")
    return Path(named) if named else default_directory() / "jars" / cassandra_version()


def pom_file() -> Path:
    """Return server/pom.xml, from the source tree, the devel space or the install space.

    Raises:
        ServerError: The file was not installed with the code.
    """
    here = Path(__file__)
    for parent in here.parents:
        for place in (parent / "server", parent / "share" / "cassandra_ros" / "server"):
            if (place / "pom.xml").is_file():
                return place / "pom.xml"
    raise ServerError(
        f"server/pom.xml, which says what Cassandra to fetch, is in no folder above {here}; "
        "the package is not completely installed: build it again with catkin_make"
    )


def cassandra_version() -> str:
    """Return the version of Cassandra that server/pom.xml names."""
    pom = pom_file()
    found = re.search(r"<cassandra\.version>([\w.-]+)</", pom.read_text(encoding="utf-8"))
    if not found:
        raise ServerError(f"{pom} names no cassandra.version; restore the file")
    return found.group(1)
