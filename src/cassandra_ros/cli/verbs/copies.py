# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Show what other stores have of each topic, by the books; exit status 0 if they have all.

Messages count as copied when the other store has acknowledged them ('cassandra_bag copy',
replicator). The status is 1 if messages wait, if a topic was refused, or if nothing was ever
copied. The other stores are not asked.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.stores.copying.copy_status import TopicStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics and the store."""
    add_topics(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="only set the exit status")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a table by target and topic."""
    from cassandra_ros.stores.copying.copy_status import copy_status

    with open_store(options) as ros_cas:
        found = copy_status(ros_cas.catalog, stored_topics(ros_cas.catalog, options))
    if options.json:
        print_json(found)
    elif not options.quiet:
        _print(found)
    return 0 if found and not any(each.waiting or each.refused for each in found) else 1


def _print(found: list[TopicStatus]) -> None:
    if not found:
        print("nothing was copied to another store; see 'cassandra_bag copy --help'")
        return
    numbers = ("copied", "left out", "waiting", "size", "seconds")
    rows = [
        (
            shown(each.target),
            shown(each.topic),
            str(each.copied),
            str(each.left_out),
            str(each.waiting),
            format_bytes(each.waiting_bytes),
            f"{each.waiting_sec:.1f}",
        )
        for each in found
    ]
    print(format_table(("to", "topic", *numbers), rows, right=numbers))
    for each in found:
        if each.refused:
            print(f"refused: {shown(' '.join(each.refused.split()), None)}")
