# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List the stored topics: name, type and format."""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import add_store_options, foreign_keyspace, open_store
from cassandra_ros.cli.terminal_text import format_table
from cassandra_ros.printable import shown

_HEADER = ("topic", "type", "format")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the pattern and the store."""
    parser.add_argument(
        "patterns",
        nargs="*",
        metavar="REGEX",
        help="only topics whose whole name matches one of these (default: all)",
    )
    parser.add_argument(
        "-e",
        "--regex",
        metavar="REGEX",
        action="append",
        default=[],
        help="the same, as an option; may be repeated (default: all)",
    )
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each topic, type and format."""
    patterns = [*options.patterns, *options.regex] or [None]
    with open_store(options) as ros_cas:
        topics = {t.name: t for pattern in patterns for t in ros_cas.getAllTopics(pattern)}
        rows = [
            (topic.name, table.metadata.msg_type, table.metadata.format)
            for _, topic in sorted(topics.items())
            for table in topic.tables
        ]
        hint = "" if rows or options.json else foreign_keyspace(ros_cas, "; ")
    whole = "; a pattern matches whole names, as /camera/.*" if patterns != [None] else ""
    text = f"keyspace {options.keyspace} holds no such topic{whole}{hint}"
    if rows:
        text = format_table(_HEADER, [tuple(map(shown, row)) for row in rows])
    tell(options, [dict(zip(_HEADER, row)) for row in rows], text)
    return 0
