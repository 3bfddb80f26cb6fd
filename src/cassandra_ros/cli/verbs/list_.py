# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List the stored topics: name, type and format."""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, foreign_keyspace, open_store
from cassandra_ros.cli.terminal_text import format_table
from cassandra_ros.printable import shown

_HEADER = ("topic", "type", "format")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the pattern and the store."""
    parser.add_argument(
        "pattern",
        nargs="?",
        metavar="REGEX",
        help="only topics whose whole name matches (default: all)",
    )
    parser.add_argument(
        "-e", "--regex", metavar="REGEX", help="the same, as an option (default: all)"
    )
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each topic, type and format."""
    if options.pattern is not None and options.regex is not None:
        options.parser.error("one REGEX is taken, with or without -e")
    pattern = options.regex if options.pattern is None else options.pattern
    with open_store(options) as ros_cas:
        rows = [
            (topic.name, table.metadata.msg_type, table.metadata.format)
            for topic in ros_cas.getAllTopics(pattern)
            for table in topic.tables
        ]
        told = "" if rows or options.json else foreign_keyspace(ros_cas, "; ")
    if options.json:
        print_json([dict(zip(_HEADER, row)) for row in rows])
    elif rows:
        print(format_table(_HEADER, [tuple(map(shown, row)) for row in rows]))
    else:
        print(f"keyspace {options.keyspace} holds no such topic{told}")
    return 0
