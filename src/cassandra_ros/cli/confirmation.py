# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A person agrees to what cannot be undone, on the terminal or beforehand with --yes."""

from __future__ import annotations

import argparse
import os
import sys

from cassandra_ros.errors import NotConfirmed


def add_yes_option(parser: argparse._ActionsContainer) -> None:
    """Add -y and --yes."""
    text = "do it without asking; needed where nobody can be asked, as in a script (default: ask)"
    parser.add_argument("-y", "--yes", action="store_true", help=text)


def add_dry_run_option(parser: argparse._ActionsContainer) -> None:
    """Add --dry-run."""
    text = "only say what would be deleted; nothing is asked or changed"
    parser.add_argument("--dry-run", action="store_true", help=text)


def confirm(question: str, details: str = "") -> None:
    """Ask a person; the answer is no unless it says yes.

    Args:
        details: Lines that are shown above the question.

    Raises:
        NotConfirmed: It is no, or standard input is no terminal.
    """
    if not sys.stdin.isatty():
        raise NotConfirmed(f"{question} Nobody can be asked here; say so with --yes")
    # Standard output may be an answer for another program.
    if details:
        print(details, file=sys.stderr)
    if not says_yes(question):
        raise NotConfirmed("nothing was deleted")


def person_reads() -> bool:
    """Say whether this process has a terminal of its own, at which a person may answer.

    roslaunch hands its terminal on to all of its nodes, and a shell to what runs in the background.
    """
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # it is not the terminal of our session
        return False


def says_yes(question: str) -> bool:
    """Ask a person on the terminal; the answer is no unless it says yes."""
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
