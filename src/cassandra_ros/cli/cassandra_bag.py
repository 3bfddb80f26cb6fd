# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored topics: list, describe, ask, index, convert; runs; bags: import, export, verify.

'cassandra_bag VERB --help' explains a verb. The Tab key completes verbs, options, topics and fields
after this line, which may stand in ~/.bashrc (for zsh: completion zsh):
  eval "$(rosrun cassandra_ros cassandra_bag completion bash)"
"""

from __future__ import annotations

import argparse
import logging
import sys
from typing import Sequence

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.cli.parsers import error_line, verbs_parser
from cassandra_ros.cli.verbs import VERBS
from cassandra_ros.errors import CassandraRosError, InvalidQuery

PROGRAM = "cassandra_bag"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""

    def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
        VERBS[name].add_arguments(parser)

    return verbs_parser(PROGRAM, __doc__, VERBS, add_arguments)


class _ErrorLines(logging.Formatter):
    """Writes a record as errors are written."""

    def format(self, record: logging.LogRecord) -> str:
        return error_line(PROGRAM, super().format(record))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb that the arguments name.

    Args:
        argv: Arguments without the program's name; None = those of the process.

    Returns:
        Exit status: 0 when all went well, 1 when it failed or verify found a difference. Wrong
        usage ends the program with 2.
    """
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(strip_remappings(argv))
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_ErrorLines())
    logger = logging.getLogger("cassandra_ros")
    logger.addHandler(handler)
    # The driver's own warnings speak of things that its caller chose.
    logging.getLogger("cassandra").setLevel(logging.ERROR)
    try:
        return int(VERBS[options.verb].run(options))
    except CassandraRosError as exc:
        # One line; a question that is none with a caret under the spot.
        text = str(exc) if isinstance(exc, InvalidQuery) else " ".join(str(exc).split())
        print(error_line(PROGRAM, text), file=sys.stderr)
        return 1
    finally:
        logger.removeHandler(handler)
