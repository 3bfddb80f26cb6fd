# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run an Apache Cassandra on this machine, for this machine: the default store of cassandra_ros."""

from __future__ import annotations

import argparse
import sys
from typing import Sequence

from cassandra_ros.cli.local_verbs import clear, install, run, start, status, stop
from cassandra_ros.cli.options import strip_remappings, verbs_parser

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
    return verbs_parser("local_cassandra", __doc__, VERBS)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb that the arguments name; return the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    options = make_parser().parse_args(strip_remappings(arguments))
    return int(VERBS[options.verb].run(options))
