# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copy topics into another store all the time, as a robot's into that at home.

  rosrun cassandra_ros replicator --to home --rules ~/replicator.yaml

What is recorded is copied within 10 s. While the other store is away, messages wait in the store of
the robot; afterwards the copy goes on where it was, small topics first, or in the order of the
rules. 'cassandra_bag copy --help' says what is copied, and 'cassandra_bag copy --status' shows what
the other store has. The node is called replicator, with services ~status, ~pause and ~resume if
--no-services does not close them, and says how it is on /diagnostics. Every option can also be set
as a private parameter of the node: its long name with _ for -, as ~to_cqlshrc.
"""

from __future__ import annotations

import sys

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.fleet_options import add_target_options, open_target
from cassandra_ros.cli.options import add_store_options, open_store, strip_remappings
from cassandra_ros.cli.parameters import parameter_words
from cassandra_ros.cli.parsers import Parser, add_option, program_parser
from cassandra_ros.printable import shown_lines
from cassandra_ros.quantities import byte_size
from cassandra_ros.shared_options import DROP_UNCOPIED, MAX_SIZE

PROGRAM = "replicator"


def make_parser() -> Parser:
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
    add_option(parser, "max_size", MAX_SIZE, 0)
    add_option(parser, "drop_uncopied", DROP_UNCOPIED, False)
    add("--no-diagnostics", dest="diagnostics", action="store_false", help="not on /diagnostics")
    text = "offer no services, so that no other program of the ROS network pauses the copying"
    add("--no-services", action="store_true", help=text)
    add_target_options(parser, "--to", "the store to which topics are copied")
    add_store_options(parser)
    return parser


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

    options = parser.parse_args([*parameter_words(parser, start_node(sys.argv)), *words])
    if options.target is None:
        parser.error("say where to copy: --to HOST[:PORT][/KEYSPACE], or the parameter ~to")
    if options.drop_uncopied and not options.max_size:
        parser.error("--drop-uncopied needs --max-size")
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
