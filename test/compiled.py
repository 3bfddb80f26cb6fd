# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parts of ROS that are compiled for one Python, the distribution's: roslz4, tf2_py."""

from __future__ import annotations

import importlib.util
import os

import pytest

OTHER = "CASSANDRA_ROS_OTHER_PYTHON"
"""Environment variable that other_python.py sets: ROS is of another Python than the tests."""


def compiled(name):
    """Return a compiled module of ROS; skip the test, or the file, that cannot have it."""
    try:
        return importlib.import_module(name)
    except ImportError:
        if OTHER not in os.environ:
            raise
        reason = f"{name} of ROS is compiled for the distribution's Python only"
        return pytest.skip(reason, allow_module_level=True)


def packed_by_rosbag():
    """Return the compressions that rosbag, in this Python, reads and writes."""
    alone = OTHER in os.environ and importlib.util.find_spec("roslz4") is None
    return ("none", "bz2") if alone else ("none", "bz2", "lz4")
