# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List the stored topics: name, type and format."""

from __future__ import annotations

import argparse

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.text import format_table, shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the pattern and the store."""
    parser.add_argument(
        "pattern", nargs="?", metavar="REGEX", help="only topics whose whole name matches"
    )
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each topic, type and format."""
    with open_store(options) as ros_cas:
        rows = [
            (shown(topic.name), table.metadata.msg_type, table.metadata.format)
            for topic in ros_cas.getAllTopics(options.pattern)
            for table in topic.tables
        ]
    if rows:
        print(format_table(("topic", "type", "format"), rows))
    else:
        print(f"keyspace {options.keyspace} holds no such topic")
    return 0
