# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Answer questions about recorded topics over services.

They are ~getData, ~range, ~executeCQL and ~lookupTransform. The node is called cassandra_ros;
its parameters ~host, ~port, ~keyspace and ~allow_writes count where the options of the same names
are not given.
"""

from __future__ import annotations

import argparse
import sys
from typing import Callable, Sequence

from cassandra_ros.cli.options import (
    add_store_options,
    open_store,
    program_parser,
    read_port,
    strip_remappings,
)

PROGRAM = "query_server"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    add_store_options(parser)
    parser.add_argument(
        "--allow-writes",
        action="store_true",
        help="let executeCQL run DELETE, TRUNCATE, CREATE INDEX and DROP INDEX (default: only "
        "SELECT)",
    )
    return parser


def truth(text: str) -> bool:
    """Read true or false, for argparse, as ROS parameters have them."""
    known = {"true": True, "1": True, "false": False, "0": False}
    if text.lower() not in known:
        raise argparse.ArgumentTypeError(f"{text!r} is neither true nor false")
    return known[text.lower()]


_READERS: dict[str, Callable[[str], object]] = {"port": read_port, "allow_writes": truth}
"""How the text of a parameter is read that is not meant as text."""


def apply_parameters(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    arguments: Sequence[str],
    given: dict[str, str],
) -> None:
    """Let ROS parameters take the place of options that were not given."""
    absent = argparse.Namespace(**dict.fromkeys(given))
    typed = parser.parse_args(arguments, absent)
    for name, text in given.items():
        if getattr(typed, name) is not None:
            continue
        try:
            setattr(options, name, _READERS.get(name, str)(text))
        except argparse.ArgumentTypeError as exc:
            parser.error(f"parameter ~{name}: {exc}")


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until the node is shut down; return the exit status.

    Args:
        argv: Arguments without the program's name; None = those of the process.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = make_parser()
    words = strip_remappings(arguments)
    options = parser.parse_args(words)
    from cassandra_ros.nodes.query_node import serve, start_node

    apply_parameters(parser, options, words, start_node([PROGRAM, *arguments]))
    with open_store(options, make=True) as ros_cas:
        serve(ros_cas, lambda line: print(line, flush=True), options.allow_writes)
    return 0
