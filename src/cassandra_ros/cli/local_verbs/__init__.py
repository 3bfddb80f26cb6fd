# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The verbs of `local_cassandra`, one a file; here the options and the cluster that they share."""

from __future__ import annotations

import argparse
import sys

from cassandra_ros.local_server import LocalCluster


def add_directory(parser: argparse.ArgumentParser) -> None:
    """Add the option that says which local Cassandra is meant."""
    parser.add_argument(
        "--dir",
        metavar="DIR",
        help="where its data lie (default: $ROS_HOME/cassandra_ros, else ~/.ros/cassandra_ros)",
    )


def add_server_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how the server is to run."""
    add_directory(parser)
    parser.add_argument(
        "--nodes",
        type=_number_or_nothing,
        metavar="N",
        help="number of nodes, 1 to 3, on following addresses; fixed once there are data "
        "(default: 1)",
    )
    parser.add_argument(
        "--heap",
        metavar="SIZE",
        help="Java heap of each node, such as 512M or 2G; kept for later starts (default: 0, all "
        "nodes share a quarter of the memory, at most 4G, and each has 512M or more)",
    )
    parser.add_argument(
        "--port", type=int, help="port for CQL; kept for later starts (default: 9042)"
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="loopback address of the first node; kept for later starts (default: 127.0.0.1)",
    )


def _number_or_nothing(text: str) -> int | None:
    # A launch file cannot leave an option out, but it can give an empty one.
    return int(text) if text else None


def open_cluster(options: argparse.Namespace) -> LocalCluster:
    """Return the cluster that the options describe; it tells its steps on the terminal."""
    return LocalCluster(
        options.dir,
        nodes=getattr(options, "nodes", None),
        host=getattr(options, "host", None),
        port=getattr(options, "port", None),
        heap=getattr(options, "heap", None) or None,
        say=say,
        progress=show_progress,
    )


def say(text: str) -> None:
    """Print one line at once, in place of the progress line where there is one."""
    clear_progress()
    print(text, flush=True)


def show_progress(text: str, seconds: float) -> None:
    """Redraw the line that says what is being waited for; only on a terminal."""
    if sys.stderr.isatty():
        print(f"\r{text} … {seconds:.0f} s\033[K", end="", file=sys.stderr, flush=True)


def clear_progress() -> None:
    """Wipe the progress line."""
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def where(cluster: LocalCluster) -> str:
    """Return the addresses of a cluster as a person writes them: 127.0.0.1:9042."""
    return ", ".join(f"{node.address}:{cluster.settings.port}" for node in cluster.nodes)
