# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run an Apache Cassandra on this machine, for this machine: the default store of cassandra_ros."""

from __future__ import annotations

import argparse
import inspect
import sys
from typing import Sequence

from cassandra_ros.cli.local_verbs import clear, install, run, start, status, stop
from cassandra_ros.cli.options import strip_remappings

VERBS = {
    "install": install,
    "start": start,
    "stop": stop,
    "status": status,
    "run": run,
    "clear": clear,
}


def make_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""
    parser = argparse.ArgumentParser(prog="local_cassandra", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name, module in VERBS.items():
        text = inspect.getdoc(module) or ""
        verb = verbs.add_parser(
            name,
            help=text.splitlines()[0],
            description=text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(verb)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb that the arguments name; return the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    options = make_parser().parse_args(strip_remappings(arguments))
    return int(VERBS[options.verb].run(options))
