# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Delete topics, or messages by time, robot, run or condition.

  cassandra_bag delete /camera/image_raw                      the topic with all its messages
  cassandra_bag delete --run test_drive                       all that a recording stored
  cassandra_bag delete -e '/camera/.*' --end 2013-05-08T14:06:30Z
  cassandra_bag delete --where '/cmd_vel: linear.x = 0' --start 1368021980

Without --start, --end, --event, --node-id, --run and --where the topics themselves are deleted,
including their metadata; with any of these options only messages. Events stay. With --where only
messages of topics that have a condition are deleted. A run without messages is not listed any more.
The command prints how much it will delete, and asks first; --dry-run only prints it. You cannot
undo it, but importing the same bag stores its messages again.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_message_options,
    add_store_options,
    open_store,
    read_event,
    read_times,
    read_where,
)
from cassandra_ros.cli.parsers import error_line
from cassandra_ros.cli.terminal_text import counted, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.errors import DefinitionError
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, which of their messages, whether it is asked, and the store."""
    add_topics(parser, "the topics, or the topics of the messages (default: all topics)")
    add_message_options(parser)
    add_dry_run_option(parser)
    add_yes_option(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print what will be deleted, ask, and delete it."""
    start, end = read_times(options)
    selected = {
        "key": start,
        "to_key": end,
        "nodeID": options.node_id,
        "run": options.run,
        "where": read_where(options) or None,
        "event": read_event(options),
    }
    whole = not any(value is not None for value in selected.values())
    if whole and not options.topics:
        options.parser.error("name topics, times, an event, a node, a run or a condition")
    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas.catalog, options)

        def delete(dry_run: bool) -> dict[str, int]:
            if whole:
                return _remove(ros_cas, topics or [], dry_run)
            return ros_cas.upkeep.delete(topics, **selected, dry_run=dry_run)

        counts = delete(dry_run=True) if options.dry_run or not options.yes else {}
        if not options.dry_run:
            if not options.yes and (whole or any(counts.values())):
                confirm(f"Delete {_sum(counts, whole)}?", _table(counts))
            counts = delete(dry_run=False)
    if options.json:
        print_json({"deleted": counts, "with_topics": whole, "dry_run": options.dry_run})
    elif not options.quiet:
        if any(counts.values()):
            print(_table(counts))
        print(f"{_sum(counts, whole)} {'would be' if options.dry_run else 'are'} deleted")
    return 0


def _remove(ros_cas: RosCassandra, topics: list[str], dry_run: bool) -> dict[str, int]:
    """Remove topics with all their messages; return the number of messages by topic.

    A topic that is being recorded would be created again at once, so only its messages are deleted.
    """
    counts = dict.fromkeys(topics, 0)
    unreadable = set()
    for name in topics:
        try:
            counts[name] = sum(info.count for info in ros_cas.info([name]))
        except DefinitionError:  # it can still be removed
            unreadable.add(name)
    for name in [] if dry_run else topics:
        if name not in unreadable and ros_cas.upkeep.isWritten(name):
            counts[name] = ros_cas.truncateTopic(name)
            text = f"topic {shown(name)} is being recorded: it stays, with what comes from now on"
            print(error_line("cassandra_bag", text), file=sys.stderr)
        else:
            counts[name] = ros_cas.removeTopic(name) or counts[name]
    return counts


def _sum(counts: dict[str, int], whole: bool) -> str:
    count = sum(counts.values())
    if whole:
        return f"{counted(len(counts), 'topic')} with their {counted(count, 'message')}"
    topics = sum(1 for messages in counts.values() if messages)
    return f"{counted(count, 'message')} of {counted(topics, 'topic')}"


def _table(counts: dict[str, int]) -> str:
    rows = [(shown(topic), str(count)) for topic, count in sorted(counts.items()) if count]
    return format_table(("topic", "messages"), rows, right=("messages",)) if rows else ""
