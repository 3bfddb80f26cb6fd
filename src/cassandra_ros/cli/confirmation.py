# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask the user before data are deleted, on the terminal; --yes answers in advance."""

from __future__ import annotations

import argparse
import os
import sys

from cassandra_ros.errors import NotConfirmed


def add_yes_option(parser: argparse._ActionsContainer) -> None:
    """Add -y and --yes."""
    text = "do not ask before deleting; needed without a terminal, as in a script (default: ask)"
    parser.add_argument("-y", "--yes", action="store_true", help=text)


def add_dry_run_option(parser: argparse._ActionsContainer) -> None:
    """Add --dry-run."""
    text = "only print what would be deleted; ask and change nothing"
    parser.add_argument("--dry-run", action="store_true", help=text)


def confirm(question: str, details: str = "") -> None:
    """Ask the user whether to delete something; return if the answer is yes.

    Args:
        question: A sentence with a question mark.
        details: Lines that are printed before the question.

    Raises:
        NotConfirmed: The answer is not yes, or standard input is not a terminal.
    """
    if not sys.stdin.isatty():
        raise NotConfirmed(f"{question} There is no terminal to ask on; confirm it with --yes")
    # Standard output may be read by another program.
    if details:
        print(details, file=sys.stderr)
    if not says_yes(question):
        raise NotConfirmed("nothing was deleted")


def person_reads() -> bool:
    """Return whether the user can answer a question of this process on the terminal.

    It is not enough that there is a terminal: nodes of roslaunch and background jobs of a shell
    have one, but do not receive what is typed.
    """
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # the terminal belongs to another session
        return False


def says_yes(question: str) -> bool:
    """Ask the user on the terminal; return the answer. All but y and yes means no."""
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
