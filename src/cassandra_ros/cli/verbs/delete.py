# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Delete topics, all their messages, or messages by time, robot, run or condition.

  cassandra_bag delete /camera/image_raw                      the topic with all its messages
  cassandra_bag delete /camera/image_raw --messages           its messages; the topic stays
  cassandra_bag delete --run test_drive                       all that a recording stored
  cassandra_bag delete -e '/camera/.*' --end 2013-05-08T14:06:30Z
  cassandra_bag delete --where '/cmd_vel: linear.x = 0' --start 1368021980

Without --messages, --start, --end, --event, --node-id, --run and --where the topics themselves are
deleted, including their metadata; with any of these options only messages. --messages deletes all
messages of the topics, which keep their format, metadata, indexes and ttl; it works while nodes of
the cluster are down, and frees the disk at once. With --where only messages of topics that have a
condition are deleted. Events stay. A run without messages is not listed any more.

The command prints how much it will delete, and asks first; --dry-run only prints it. You cannot
undo it, but importing the same bag stores its messages again.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import (
    add_message_options,
    add_store_options,
    open_store,
    read_event,
    read_times,
    read_where,
)
from cassandra_ros.cli.parsers import error_line
from cassandra_ros.cli.terminal_text import counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.errors import DefinitionError
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra


@dataclass
class _Amount:
    """What is deleted of a topic."""

    messages: int = 0
    bytes: int | None = None
    """Size of all its messages, bytes; None = unknown, because a part of them is deleted, or the
    topic cannot be read."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, which of their messages, whether it is asked, and the store."""
    add_topics(parser, "the topics, or the topics of the messages (default: all topics)")
    text = "delete all messages of the topics, and keep the topics themselves"
    parser.add_argument("--messages", action="store_true", help=text)
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
    of_whole_topics = not any(value is not None for value in selected.values())
    with_topics = of_whole_topics and not options.messages
    if of_whole_topics and not options.topics:
        options.parser.error("name topics, times, an event, a node, a run or a condition")
    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas.catalog, options)

        def delete(dry_run: bool) -> dict[str, _Amount]:
            if of_whole_topics:
                return _delete_all(ros_cas, topics or [], with_topics, dry_run)
            counts = ros_cas.upkeep.delete(topics, **selected, dry_run=dry_run)
            return {name: _Amount(count) for name, count in counts.items()}

        amounts = delete(dry_run=True) if options.dry_run or not options.yes else {}
        if not options.dry_run:
            if not options.yes and (of_whole_topics or _count(amounts)):
                question = f"Delete {_sum(amounts, with_topics)}"
                if of_whole_topics and not with_topics:
                    question += f" in keyspace {options.keyspace}, and keep the topics"
                confirm(f"{question}?", _table(amounts))
            amounts = delete(dry_run=False)
    counts = {name: amount.messages for name, amount in amounts.items()}
    answer = {"deleted": counts, "with_topics": with_topics, "dry_run": options.dry_run}
    done = f"{_sum(amounts, with_topics)} {'would be' if options.dry_run else 'are'} deleted"
    tell(options, answer, "\n".join(filter(None, (_table(amounts), done))))
    return 0


def _delete_all(
    ros_cas: RosCassandra, topics: list[str], with_topics: bool, dry_run: bool
) -> dict[str, _Amount]:
    """Delete all messages of topics, and perhaps the topics; return how much that is, by topic.

    A topic that is being recorded would be created again at once, so only its messages are deleted.

    Args:
        ros_cas: The store.
        topics: Their names.
        with_topics: Whether the topics are deleted, too.
        dry_run: Only count.
    """
    amounts = {}
    unreadable = set()
    for name in topics:
        try:
            infos = ros_cas.info([name])
            size = sum(info.bytes for info in infos)
            amounts[name] = _Amount(sum(info.count for info in infos), size)
        except DefinitionError:  # it can still be removed
            unreadable.add(name)
            amounts[name] = _Amount()
    for name in [] if dry_run else topics:
        stays = not with_topics
        if with_topics and name not in unreadable and ros_cas.upkeep.isWritten(name):
            stays = True
            text = f"topic {shown(name)} is being recorded: it stays, with what comes from now on"
            print(error_line("cassandra_bag", text), file=sys.stderr)
        remove = ros_cas.truncateTopic if stays else ros_cas.removeTopic
        # Where nothing was counted while it was deleted the earlier count is told.
        amounts[name].messages = remove(name) or amounts[name].messages
    return amounts


def _sum(amounts: dict[str, _Amount], with_topics: bool) -> str:
    """Return in words how much is deleted, of topics with messages unless the topics go, too."""
    messages = counted(_count(amounts), "message")
    if with_topics:
        return f"{counted(len(amounts), 'topic')} with their {messages}"
    topics = sum(1 for amount in amounts.values() if amount.messages)
    return f"{messages} of {counted(topics, 'topic')}"


def _count(amounts: dict[str, _Amount]) -> int:
    return sum(amount.messages for amount in amounts.values())


def _table(amounts: dict[str, _Amount]) -> str:
    """Return a table of the topics that lose messages; '' = none does."""
    filled = {name: amount for name, amount in sorted(amounts.items()) if amount.messages}
    header = ["topic", "messages"]
    rows = [[shown(name), str(amount.messages)] for name, amount in filled.items()]
    if any(amount.bytes is not None for amount in filled.values()):
        header.append("size")
        for row, amount in zip(rows, filled.values()):
            row.append("-" if amount.bytes is None else format_bytes(amount.bytes))
    return format_table(header, rows, right=("messages", "size")) if rows else ""
