# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Delete all messages of topics; the topics keep their format, metadata, indexes and ttl.

  cassandra_bag truncate /camera/image_raw
  cassandra_bag truncate -e '/camera/.*' --dry-run

It works while nodes of the cluster are down, and frees the disk space at once. To delete some
messages, or the topic itself, use delete.
"""

from __future__ import annotations

import argparse
from typing import Mapping, Sequence

from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.printable import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, confirmation, the form of the answer, and the store."""
    add_topics(parser, "stored topics", nargs="+")
    add_dry_run_option(parser)
    add_yes_option(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print what will be deleted, ask, and delete it."""

    def table(counts: Mapping[str, Sequence[int]]) -> str:
        filled = {name: numbers for name, numbers in counts.items() if any(numbers)}
        rows = [(shown(name), str(n), format_bytes(size)) for name, (n, size) in filled.items()]
        text = format_table(("topic", "messages", "size"), rows, right=("messages", "size"))
        return f"{text}\n" if rows else ""

    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas.catalog, options) or []
        counts = {name: [0, 0] for name in topics}
        for info in ros_cas.info(topics):
            counts[info.topic][0] += info.count
            counts[info.topic][1] += info.bytes
        total = sum(count for count, _ in counts.values())
        what = f"{counted(total, 'message')} of {counted(len(topics), 'topic')}"
        what += f" in keyspace {options.keyspace}"
        if not (options.dry_run or options.yes):
            confirm(f"Remove all {what}?", table(counts).rstrip())
        for name in [] if options.dry_run else topics:
            counts[name][0] = ros_cas.truncateTopic(name) or counts[name][0]
        total = sum(count for count, _ in counts.values())
        what = f"{total} messages of {len(topics)} topics in keyspace {options.keyspace}"
    if options.json:
        print_json({"removed": dict(zip(counts, (n for n, _ in counts.values())))})
    elif not options.quiet:
        print(f"{table(counts)}{what} {'would be' if options.dry_run else 'are'} removed")
    return 0
