# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Provide services that read recorded topics.

The services are ~getData, ~range, ~executeCQL, ~explainCQL, ~sql, ~info and ~lookupTransform, and
with --allow-writes also ~addData, ~removeData and ~mark. The node is called cassandra_ros. Every
option can also be set as a private parameter of the node: its long name with _ for -, as
~allow_writes.
"""

from __future__ import annotations

import sys

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.options import add_store_options, open_store, strip_remappings
from cassandra_ros.cli.parameters import parameter_words
from cassandra_ros.cli.parsers import Parser, program_parser
from cassandra_ros.printable import shown_lines

PROGRAM = "query_server"


def make_parser() -> Parser:
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


def main() -> int:
    """Run the query server until the node is shut down; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    words = strip_remappings(None)
    parser.parse_args(words)  # wrong usage and --help need no master
    from cassandra_ros.nodes.query_node import serve, start_node

    options = parser.parse_args([*parameter_words(parser, start_node(sys.argv)), *words])
    with open_store(options, make=True) as ros_cas:
        serve(ros_cas, lambda text: print(shown_lines(text), flush=True), options.allow_writes)
    return 0
