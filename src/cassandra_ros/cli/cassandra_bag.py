# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Look at, query, import, export, check, change and remove what is stored in Cassandra.

'cassandra_bag VERB --help' explains a verb. After this line, for example in ~/.bashrc, the Tab key
completes verbs, options, topics and fields (for zsh: --completion zsh, after compinit):
  eval "$(cassandra_bag --completion bash)"
"""

from __future__ import annotations

import argparse
import logging
import sys
from typing import Sequence

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.completion import add_completion_option
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.cli.parsers import error_line, verbs_parser
from cassandra_ros.cli.verbs import GROUPS, VERBS
from cassandra_ros.errors import CassandraRosError, InvalidQuery

PROGRAM = "cassandra_bag"
_STORE_MISSING = (
    "  3    a store of --store did not answer; what the others have was printed or written"
)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""

    def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
        VERBS[name].add_arguments(parser)

    parser = verbs_parser(PROGRAM, __doc__, GROUPS, add_arguments, _STORE_MISSING)
    add_completion_option(parser)
    return parser


class _ErrorLines(logging.Formatter):
    """Formats log records like the error lines of the program."""

    def format(self, record: logging.LogRecord) -> str:
        return error_line(PROGRAM, super().format(record))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb that the arguments name.

    Args:
        argv: Arguments without the program's name; None = the arguments of the process.

    Returns:
        Exit status: 0 = success, 1 = the verb failed, or verify found a difference, 3 = one of
        several stores did not answer. Wrong usage ends the program with status 2.
    """
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(strip_remappings(argv))
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_ErrorLines())
    logger = logging.getLogger("cassandra_ros")
    logger.addHandler(handler)
    # The driver warns about settings that we chose on purpose.
    logging.getLogger("cassandra").setLevel(logging.ERROR)
    try:
        return int(VERBS[options.verb].run(options))
    except CassandraRosError as exc:
        # Errors are one line. Only InvalidQuery keeps its lines: a caret marks the position.
        text = str(exc) if isinstance(exc, InvalidQuery) else " ".join(str(exc).split())
        print(error_line(PROGRAM, text), file=sys.stderr)
        return 1
    finally:
        logger.removeHandler(handler)
