# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stop the local Cassandra: it finishes what it was given, writes it to disk and ends."""

from __future__ import annotations

import argparse
import time

from cassandra_ros.cli.local_verbs import (
    add_directory,
    clear_progress,
    open_cluster,
    say,
    where,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the directory."""
    add_directory(parser)


def run(options: argparse.Namespace) -> int:
    """Stop the nodes that run; none is fine."""
    cluster = open_cluster(options)
    begun = time.monotonic()
    try:
        stopped = cluster.stop()
    finally:
        clear_progress()
    if stopped:
        say(f"Cassandra at {where(cluster)} stopped after {time.monotonic() - begun:.0f} s")
    else:
        say(f"no Cassandra of {cluster.directory} was running")
    return 0
