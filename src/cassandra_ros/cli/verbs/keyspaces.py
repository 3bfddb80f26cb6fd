# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List the keyspaces of the cluster that hold topics, with their numbers of topics and copies.

Copies are the numbers of Cassandra nodes, by data centre, that keep each row: with one copy, data
are lost when a node is lost. A star marks the keyspace that --keyspace selects.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import format_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the form of the answer and the store."""
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each keyspace."""
    with open_store(options, make=True) as ros_cas:
        keyspaces = ros_cas.getKeyspaces()
    if options.json:
        print_json(keyspaces)
    elif keyspaces:
        header = ("", "keyspace", "topics", "tables", "copies")
        rows = [
            (
                "*" if keyspace.name == options.keyspace else "",
                keyspace.name,
                str(keyspace.topics),
                str(keyspace.tables),
                ", ".join(f"{where} {count}" for where, count in keyspace.copies.items()),
            )
            for keyspace in keyspaces
        ]
        print(format_table(header, rows, right=("topics", "tables")))
    else:
        print("no keyspace of the cluster holds topics; a recording or an import makes one")
    return 0
