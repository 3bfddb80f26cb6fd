# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parsers with the same form of help texts, exit statuses and error lines for all programs."""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from typing import Callable, Mapping, NoReturn

from cassandra_ros.installation import shipped_file
from cassandra_ros.metadata import SCHEMA_VERSION
from cassandra_ros.printable import shown_lines

_STATUSES = """\
exit status:
  0    success
  1    failure, also of a part: each line '%(prog)s: …' on standard error gives a reason
  2    wrong usage; nothing was done"""
_ENDED = "  130  ended by Ctrl-C, 143 by SIGTERM, 141 by the reader of its output (| head)"
_RAW = argparse.RawDescriptionHelpFormatter


def error_line(program: str, text: object) -> str:
    """Return the line that a program prints on standard error about a failure: PROGRAM: reason."""
    return f"{program}: {shown_lines(str(text))}"


def _closing(program: str, more: str) -> str:
    # The parser of a verb is named 'PROGRAM VERB', but error lines begin with PROGRAM only.
    return "\n".join(filter(None, (_STATUSES.replace("%(prog)s", program), more, _ENDED)))


class Parser(argparse.ArgumentParser):
    """A parser that reports wrong usage in the form of all other errors."""

    def error(self, message: str) -> NoReturn:
        """Print the usage and the error, and end the program with status 2."""
        self.print_usage(sys.stderr)
        program = self.prog.split()[0]
        self.exit(2, error_line(program, f"{message} (see {self.prog} --help)") + "\n")


class _Version(argparse.Action):
    """Print the version of the package and of the schema; the file is read only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"{parser.prog} {version()} (reads and writes keyspaces of schema {SCHEMA_VERSION})")
        parser.exit()


def program_parser(program: str, text: str | None, more: str = "") -> Parser:
    """Return a parser whose description is a docstring.

    Args:
        text: The docstring; its lines are kept.
        more: Lines about further exit statuses.
    """
    description, closing = inspect.cleandoc(text or ""), _closing(program, more)
    parser = Parser(prog=program, description=description, epilog=closing, formatter_class=_RAW)
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show the version and the schema, and exit"
    )
    return parser


def verbs_parser(
    program: str,
    text: str | None,
    verbs: Mapping[str, object],
    add_arguments: Callable[[str, argparse.ArgumentParser], None],
    more: str = "",
) -> Parser:
    """Return the parser of a program with verbs; their docstrings are their help texts."""
    parser = program_parser(program, text, more)
    verb_parsers = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name, verb in verbs.items():
        doc = inspect.getdoc(verb) or ""
        found = verb_parsers.add_parser(
            name,
            help=doc.splitlines()[0],
            description=doc,
            epilog=_closing(program, more),
            formatter_class=_RAW,
        )
        found.set_defaults(parser=found)
        add_arguments(name, found)
    return parser


def version() -> str:
    """Return the version that package.xml states."""
    file = shipped_file("package.xml")
    text = file.read_text("utf-8") if file.is_file() else ""
    found = re.search(r"<version>([^<]+)</version>", text)
    return found[1] if found else "unknown"
