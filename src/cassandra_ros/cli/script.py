# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run a program of the package: what every file in scripts/ does.

What a program does not report itself becomes a line of text and an exit status here: an error, a
missing Python package, Ctrl-C, a reader of the output that is gone.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from pathlib import Path

from cassandra_ros.errors import CassandraRosError

# What a Python without our venv lacks, by import name: the packages of requirements.txt, and those
# of ROS, which another Python than the system's does not see.
_NEEDED = {
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

EXIT_INTERRUPTED = 128 + signal.SIGINT


def run_script(module: str) -> None:
    """Import a module, call its `main() -> int` and end the process with what that returns."""
    try:
        status = importlib.import_module(module).main()
        sys.stdout.flush()
    except CassandraRosError as exc:
        status = f"{module.rsplit('.', 1)[-1]}: {exc}"
    except ModuleNotFoundError as exc:
        if (exc.name or "").split(".")[0] not in _NEEDED:
            raise
        status = f"{module.rsplit('.', 1)[-1]}: {explain_missing(exc)}"
    except KeyboardInterrupt:
        status = EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has had enough (| head); let nothing more be flushed to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 128 + signal.SIGPIPE
    sys.exit(status)


def explain_missing(error: ImportError) -> str:
    """Return what to do when a Python package that we need is not there."""
    return (
        f"{error}; this Python ({sys.executable}) lacks what cassandra_ros needs.\n"
        "In a checkout of cassandra_ros: make setup\n"
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
