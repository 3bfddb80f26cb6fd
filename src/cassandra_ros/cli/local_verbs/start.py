# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Start the local Cassandra and return when it answers.

It goes on running when this command and the terminal are gone. Options are remembered: the next
start needs none. Starting what runs already does nothing.
"""

from __future__ import annotations

import argparse
import time

from cassandra_ros.cli.local_verbs import (
    add_server_options,
    clear_progress,
    open_cluster,
    say,
    where,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the server."""
    add_server_options(parser)


def run(options: argparse.Namespace) -> int:
    """Start the nodes that do not run."""
    cluster = open_cluster(options)
    begun = time.monotonic()
    try:
        started = cluster.start()
    finally:
        clear_progress()
    if started:
        say(f"Cassandra answers at {where(cluster)} after {time.monotonic() - begun:.0f} s")
        say(f"data and logs: {cluster.directory}")
    else:
        say(f"Cassandra runs already at {where(cluster)}")
    return 0
