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
        statuses = copy_status(ros_cas.catalog, stored_topics(ros_cas.catalog, options))
    if options.json:
        print_json(statuses)
    elif not options.quiet:
        _print(statuses)
    return 0 if statuses and not any(status.waiting or status.refused for status in statuses) else 1


def _print(statuses: list[TopicStatus]) -> None:
    if not statuses:
        print("nothing was copied to another store; see 'cassandra_bag copy --help'")
        return
    numbers = ("copied", "left out", "waiting", "size", "seconds")
    rows = [
        (
            shown(status.target),
            shown(status.topic),
            str(status.copied),
            str(status.left_out),
            str(status.waiting),
            format_bytes(status.waiting_bytes),
            f"{status.waiting_sec:.1f}",
        )
        for status in statuses
    ]
    print(format_table(("to", "topic", *numbers), rows, right=numbers))
    for status in statuses:
        if status.refused:
            print(f"refused: {shown(' '.join(status.refused.split()), None)}")
