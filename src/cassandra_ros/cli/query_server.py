# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Provide services that read recorded topics.

The services are ~getData, ~range, ~executeCQL, ~explainCQL, ~sql, ~info and ~lookupTransform, and
with --allow-writes also ~addData, ~removeData and ~mark. The node is called cassandra_ros. Its
parameters ~host, ~port, ~keyspace, ~cqlshrc, ~credentials and ~allow_writes set the options of the
same names that are missing on the command line.
"""

from __future__ import annotations

import argparse
import sys
from typing import Callable, Sequence

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.options import add_store_options, open_store, read_port, strip_remappings
from cassandra_ros.cli.parsers import program_parser
from cassandra_ros.cli.readers import truth
from cassandra_ros.printable import shown_lines

PROGRAM = "query_server"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    add_store_options(parser)
    parser.add_argument(
        "--allow-writes",
        action="store_true",
        help="allow DELETE, TRUNCATE, CREATE INDEX and DROP INDEX in executeCQL, and the services "
        "addData, removeData and mark (default: refuse what changes stored data)",
    )
    return parser


_READERS: dict[str, Callable[[str], object]] = {"port": read_port, "allow_writes": truth}
"""Name of a parameter that is not a text -> function that parses it."""


def read_options(
    parser: argparse.ArgumentParser, words: Sequence[str], given: dict[str, str]
) -> argparse.Namespace:
    """Parse the command line; ROS parameters set the options that it does not give."""
    # A launch file may set a parameter to the empty text: that counts as missing.
    given = {name: text for name, text in given.items() if text}
    options = parser.parse_args(words, argparse.Namespace(**dict.fromkeys(given)))
    for name, text in given.items():
        try:
            if getattr(options, name) is None:
                setattr(options, name, _READERS.get(name, str)(text))
        except argparse.ArgumentTypeError as exc:
            parser.error(f"parameter ~{name}: {exc}")
    return options


def main() -> int:
    """Run the query server until the node is shut down; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    words = strip_remappings(None)
    parser.parse_args(words)  # wrong usage and --help need no master
    from cassandra_ros.nodes.query_node import serve, start_node

    options = read_options(parser, words, start_node(sys.argv))
    with open_store(options, make=True) as ros_cas:
        serve(ros_cas, lambda text: print(shown_lines(text), flush=True), options.allow_writes)
    return 0
