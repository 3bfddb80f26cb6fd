# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How the package is installed: its files, and what to do where Python lacks what it needs."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

from cassandra_ros.errors import MissingDependency

# What a Python without our venv lacks, by import name: the packages of requirements.txt, and those
# of ROS, which another Python than the system's does not see.
NEEDED = {
    "cassandra",
    "lark",
    "numpy",
    "psutil",
    "tqdm",
    "genmsg",
    "genpy",
    "roslib",
    "rospy",
    "yaml",
}

# What only some need, by import name: the file that pins it.
OPTIONAL = {
    "pandas": "requirements-tables.txt",
    "pyarrow": "requirements-tables.txt",
    "aiohttp": "requirements-viewer.txt",
    "matplotlib": "requirements-viewer.txt",
    "packageurl": "requirements-viewer.txt",
    "PIL": "requirements-viewer.txt",
}


def is_needed(error: ImportError) -> bool:
    """Say whether what is missing is such a package."""
    return (error.name or "").split(".")[0] in NEEDED


def explain_missing(error: ImportError) -> str:
    """Return what to do when a Python package that we need is not there."""
    return (
        f"{error}; this Python ({sys.executable}) lacks what cassandra_ros needs.\n"
        "In a checkout of cassandra_ros: make setup, then its .venv/bin/python\n"
        "In a catkin workspace of your own (the scripts then run with the Python of the venv):\n"
        "  /usr/bin/python3 -m venv --system-site-packages ~/cassandra_ros_venv\n"
        f"  ~/cassandra_ros_venv/bin/pip install -r {shipped_file('requirements.txt')}\n"
        "  catkin_make -DPYTHON_EXECUTABLE=$HOME/cassandra_ros_venv/bin/python"
    )


def shipped_file(name: str) -> Path:
    """Return where a file of the package's folder lies: in a checkout, or where it is installed."""
    for parent in Path(__file__).parents:
        for place in (parent, parent / "share" / "cassandra_ros"):
            if (place / name).is_file():
                return place / name
    return Path(name)


def home_folder() -> Path:
    """Return where a user's files of this package lie: in the ROS home, $ROS_HOME, else ~/.ros.

    So roslaunch resolves it.
    """
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "cassandra_ros"


def optional_module(name: str, purpose: str) -> Any:
    """Import a module of an optional package, as 'pyarrow.parquet', for a purpose.

    Raises:
        MissingDependency: The package is not installed, or does not run here; the text says how to
            get it.
    """
    package = name.split(".")[0]
    try:
        return importlib.import_module(name)
    except ImportError as exc:
        why = "is not installed" if exc.name == package else f"cannot be loaded ({exc})"
        raise MissingDependency(
            f"{purpose} needs the Python package {package}, which {why}: "
            f"{sys.executable} -m pip install -r {shipped_file(OPTIONAL[package])}"
        ) from exc
