# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Delete all data of the local Cassandra: every keyspace, every recorded topic.

It must be stopped. The jars stay.
"""

from __future__ import annotations

import argparse
import sys

from cassandra_ros.cli.local_verbs import add_directory, open_cluster, say
from cassandra_ros.cli.local_verbs.status import disk_bytes
from cassandra_ros.errors import ServerError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the directory and the consent."""
    add_directory(parser)
    parser.add_argument("--yes", action="store_true", help="delete without asking")


def run(options: argparse.Namespace) -> int:
    """Ask, then delete."""
    cluster = open_cluster(options)
    if not cluster.exists:
        say(f"there is nothing to clear in {cluster.directory}")
        return 0
    if not options.yes:
        size = sum(disk_bytes(node.directory) for node in cluster.nodes) / 1e6
        _ask(f"Delete all data in {cluster.directory} ({size:.0f} MB)?")
    cluster.clear()
    say(f"cleared {cluster.directory}")
    return 0


def _ask(question: str) -> None:
    if not sys.stdin.isatty():
        raise ServerError(f"{question} Nobody can be asked here; say so with --yes")
    if input(f"{question} [y/N] ").strip().lower() not in ("y", "yes"):
        raise ServerError("nothing was deleted")
