# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copy topics into another store all the time, as a robot's into that at home.

  rosrun cassandra_ros replicator --to home --rules ~/replicator.yaml

What is recorded is copied within 10 s. While the other store is away, messages wait in the store of
the robot; afterwards the copy goes on where it was, small topics first, or in the order of the
rules. 'cassandra_bag copy --help' says what is copied, and 'cassandra_bag copy --status' shows what
the other store has. The node is called replicator, with services ~status, ~pause and ~resume if
--no-services does not close them, and says how it is on /diagnostics. Its parameters ~to, ~rules,
~rate, ~max_size, ~to_cqlshrc, ~to_credentials, ~no_services, ~host, ~port, ~keyspace, ~cqlshrc and
~credentials set the options of the same names that are missing on the command line.
"""

from __future__ import annotations

import argparse
import sys
from typing import Mapping

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.fleet_options import add_target_options, open_target
from cassandra_ros.cli.options import add_store_options, open_store, strip_remappings
from cassandra_ros.cli.parsers import program_parser
from cassandra_ros.cli.quota_options import add_quota_options, check_quota_options
from cassandra_ros.cli.readers import byte_size, truth
from cassandra_ros.printable import shown_lines

PROGRAM = "replicator"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("--rules", metavar="FILE", help="rules by topic, as config/replicator.yaml (default: all)")
    text = "maximum number of bytes sent in a second: 2M, 500k (default: that of the rules)"
    add("--rate", metavar="SIZE", type=byte_size, help=text)
    add(
        "--with-deletions",
        action="store_true",
        help="delete there what is deleted here after it was copied",
    )
    add_quota_options(add)
    add("--no-diagnostics", dest="diagnostics", action="store_false", help="not on /diagnostics")
    text = "offer no services, so that no other program of the ROS network pauses the copying"
    add("--no-services", action="store_true", help=text)
    add_target_options(parser, "--to", "the store to which topics are copied")
    add_store_options(parser)
    return parser


def words_of(parser: argparse.ArgumentParser, parameters: Mapping[str, object]) -> list[str]:
    """Return the parameters of the node as command line arguments."""
    words = []
    for name, value in parameters.items():
        option = f"--{name.replace('_', '-')}"
        if name == "no_services":
            try:
                words += [option] * truth(str(value))
            except argparse.ArgumentTypeError as exc:
                parser.error(f"parameter ~{name}: {exc}")
        elif str(value) != "":
            words.append(f"{option}={value}")
    return words


def main() -> int:
    """Run the replicator until the node is shut down; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    words = strip_remappings(None)
    parser.parse_args(words)  # wrong usage and --help need no master
    from cassandra_ros.nodes.replicator_node import follow, start_node
    from cassandra_ros.stores.copying.follower import Follower
    from cassandra_ros.stores.copying.quota import Quota
    from cassandra_ros.stores.copying.replicator import Replicator
    from cassandra_ros.stores.copying.rules import read_rules_file

    # Parameters set the options that the command line does not give.
    given = words_of(parser, start_node(sys.argv))
    options = parser.parse_args(words, parser.parse_args(given))
    if options.target is None:
        parser.error("say where to copy: --to HOST[:PORT][/KEYSPACE], or the parameter ~to")
    check_quota_options(options, parser)
    rules = read_rules_file(options.rules)
    quota = Quota(options.max_size, uncopied=options.drop_uncopied) if options.max_size else None

    def say(text: str) -> None:
        print(shown_lines(text), flush=True)

    follower = Follower(
        lambda: open_store(options, make=True),
        lambda: open_target(options, make=True),
        lambda source, target: Replicator(
            source,
            target,
            with_deletions=options.with_deletions,
            rules=rules,
            rate=options.rate or None,
        ),
        quota=quota,
    )
    problem = follow(
        follower, say, diagnostics=options.diagnostics, no_services=options.no_services
    )
    if problem:
        print(f"{PROGRAM}: {shown_lines(problem)}", file=sys.stderr)
    return 1 if problem else 0
