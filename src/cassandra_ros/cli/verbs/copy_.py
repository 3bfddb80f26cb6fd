# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copy topics into another store, as a robot's into that at home; exit status 0 if all is there.

  cassandra_bag copy --to home
  cassandra_bag copy /scan /tf --to home:9042/fleet --node-id husky --format packed
  cassandra_bag copy --to home --rate 2M --to-cqlshrc ~/.cassandra/home
  cassandra_bag copy --status

Messages keep their place: robot, run, times, order, connection and key. So a copy that was
interrupted or killed, repeated, or made twice at once ends in the same messages, and the copy of a
copy is the original. Rows and blocks go as they are stored, without being decoded. With them go
connections, definitions, runs with labels, parameters and graph, losses, metadata, and all versions
of messages with names. Messages that expire keep their remaining time.

The store that is copied keeps books of what the other one has acknowledged; the next copy sends
only what is new or changed since. So its user must be able to write here too. A topic that has
another type or key there is not copied; the others are. In a time range whole blocks are copied.
What was deleted here stays there, unless --with-deletions is given.

--status copies nothing: it shows, by the books, what other stores have of each topic, and does not
ask them. Messages count as copied when the other store has acknowledged them. The exit status is 0
if they have all, 1 if messages wait, if a topic was refused, or if nothing was ever copied.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING

from cassandra_ros.cli.fleet_options import add_target_options, open_target
from cassandra_ros.cli.json_answer import add_json_option, print_json, tell
from cassandra_ros.cli.options import (
    add_origin_options,
    add_store_options,
    add_time_options,
    open_store,
    read_times,
)
from cassandra_ros.cli.parsers import error_line
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.printable import shown
from cassandra_ros.quantities import byte_size

if TYPE_CHECKING:
    from cassandra_ros.stores.copying.copy_status import TopicStatus

_HOW = ["start", "end", "node_id", "run", "format", "rules", "with_deletions", "rate", "target"]
_HOW += ["to_cqlshrc", "to_credentials"]
"""Options of what and how to copy, by their ``dest``."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, selection, the target and the store."""
    add = parser.add_argument
    add_topics(parser)
    add_time_options(parser)
    add_origin_options(parser)
    add(
        "--format",
        choices=FORMAT_NAMES,
        help="format there (default: the one that a topic has there, for new topics that of here)",
    )
    add("--rules", metavar="FILE", help="rules by topic, as config/replicator.yaml (default: none)")
    add(
        "--with-deletions",
        action="store_true",
        help="delete there what was deleted here after it was copied",
    )
    add(
        "--rate",
        metavar="SIZE",
        type=byte_size,
        help="maximum number of bytes sent in a second: 2M, 500k (default: no limit)",
    )
    add("--status", action="store_true", help="show what other stores have; copy nothing")
    add("-q", "--quiet", action="store_true", help="print errors and warnings only")
    add_json_option(parser)
    add_target_options(parser, "--to", "the store to which topics are copied")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Copy, and print what was copied of each topic."""
    if options.status:
        return _tell_status(options)
    if options.target is None:
        options.parser.error("say where to copy: --to HOST[:PORT][/KEYSPACE]")
    from cassandra_ros.stores.copying.replicator import Replicator
    from cassandra_ros.stores.copying.rules import read_rules_file

    begun = time.monotonic()
    start, end = read_times(options)
    with open_store(options) as ros_cas, open_target(options, make=True) as target:
        replicator = Replicator(
            ros_cas,
            target,
            stored_topics(ros_cas.catalog, options),
            start,
            end,
            nodeID=options.node_id,
            run=options.run,
            format=options.format,
            with_deletions=options.with_deletions,
            rules=read_rules_file(options.rules),
            rate=options.rate or None,
        )
        with MessageBar(f"copying to {shown(replicator.place)}") as bar, SafeInterrupt(
            target.cassandra.outage
        ) as stop:
            report = replicator.copy(stop.after(bar.reach))
    topics = [report.topics[name] for name in sorted(report.topics)]
    if options.json:
        print_json({"to": report.place, "complete": report.complete, "topics": topics})
    elif not options.quiet:
        numbers = ("messages", "sent", "deleted")
        rows = [
            (
                shown(topic.topic),
                str(topic.messages),
                format_bytes(topic.bytes),
                str(topic.deleted),
                topic.format or "-",
                "refused" if topic.refused else "copied",
            )
            for topic in topics
            if topic.messages or topic.deleted or topic.refused
        ]
        if rows:
            print(format_table(("topic", *numbers, "format", "state"), rows, right=numbers))
    for pattern in report.unused:
        print(error_line("cassandra_bag", f"no topic matches {pattern!r}"), file=sys.stderr)
    for topic in topics:
        if topic.refused and not options.json:
            print(f"refused: {shown(' '.join(topic.refused.split()), None)}")
    if not (options.quiet or options.json):
        what = f"{counted(report.messages, 'message')} copied to {shown(report.place)}"
        print(f"{what} ({time.monotonic() - begun:.1f} s)")
    return 0 if report.complete else 1


def _tell_status(options: argparse.Namespace) -> int:
    """Print a table by target and topic of what is copied; return the exit status.

    It is 1 if messages wait, a topic was refused, or nothing was ever copied.
    """
    from cassandra_ros.stores.copying.copy_status import copy_status

    options.parser.refuse_options(options, _HOW, "{} says how to copy, and --status copies nothing")
    with open_store(options) as ros_cas:
        statuses = copy_status(ros_cas.catalog, stored_topics(ros_cas.catalog, options))
    tell(options, statuses, _status_text(statuses))
    whole = statuses and not any(status.waiting or status.refused for status in statuses)
    return 0 if whole else 1


def _status_text(statuses: list[TopicStatus]) -> str:
    """Return a table by target and topic, and why topics were refused."""
    if not statuses:
        return "nothing was copied to another store; see 'cassandra_bag copy --help'"
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
    refused = [" ".join(status.refused.split()) for status in statuses if status.refused]
    lines = [f"refused: {shown(reason, None)}" for reason in refused]
    return "\n".join([format_table(("to", "topic", *numbers), rows, right=numbers), *lines])
