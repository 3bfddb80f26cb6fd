# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tell whether the local Cassandra runs, where, and what it takes.

The exit status is 0 when every node answers, 3 otherwise.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from cassandra_ros.cli.local_verbs import add_directory, open_cluster, say
from cassandra_ros.local_server import LocalCluster, NodeStatus

EXIT_NOT_RUNNING = 3
_POLL_SEC = 0.3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the directory and the patience."""
    add_directory(parser)
    parser.add_argument(
        "--wait",
        metavar="SEC",
        type=float,
        default=0.0,
        help="wait until it answers, at most this many seconds (default: 0)",
    )


def run(options: argparse.Namespace) -> int:
    """Print a line for each node."""
    cluster = _await_answer(options)
    if not cluster.exists:
        say(f"no Cassandra was ever started in {cluster.directory}")
        return EXIT_NOT_RUNNING
    found = cluster.status()
    for status in found:
        say(describe(status))
    say(f"directory {cluster.directory}, heap {cluster.settings.java_heap_mb}M a node")
    return 0 if all(status.answers for status in found) else EXIT_NOT_RUNNING


def _await_answer(options: argparse.Namespace) -> LocalCluster:
    deadline = time.monotonic() + options.wait
    while True:
        cluster = open_cluster(options)  # anew: the first start only now makes its settings
        if cluster.exists and all(status.answers for status in cluster.status()):
            return cluster
        if time.monotonic() >= deadline:
            return cluster
        time.sleep(_POLL_SEC)


def describe(status: NodeStatus) -> str:
    """Return the line of one node."""
    node = status.node
    if status.answers:
        state = f"answers, pid {status.pid}"
    elif status.pid:
        state = f"runs and does not answer, pid {status.pid}, log {node.log}"
    else:
        state = "does not run"
    size = disk_bytes(node.directory) / 1e6
    return f"node {node.number} {node.address}:{node.settings.port} {state}, {size:.1f} MB on disk"


def disk_bytes(directory: Path) -> int:
    """Return the bytes of all files below a directory; files may vanish meanwhile."""
    total = 0
    for path in directory.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total
