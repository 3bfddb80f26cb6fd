# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print stored messages as rostopic echo does; messages of several topics in the order of time.

  cassandra_bag cat /fix -n 1
  cassandra_bag cat /scan --start 2013-05-08T14:06:20Z --end 2013-05-08T14:06:21Z --noarr
  cassandra_bag cat /cmd_vel --where '/cmd_vel: linear.x > 0.5' --json

The output is YAML. A comment before each message gives its topic, time (UTC and nanoseconds), type
and robot. With --json the output is one list with an object per line; as in rosbridge, times in
messages are secs and nsecs, uint8[] is base64 and NaN is null. A message that cannot be read is
reported on standard error, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import islice
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, plain
from cassandra_ros.cli.options import (
    add_message_options,
    add_store_options,
    open_store,
    read_event,
    read_times,
    read_where,
)
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.printable import shown, shown_lines
from cassandra_ros.quantities import whole_number

if TYPE_CHECKING:
    from cassandra_ros.topics.stored_row import StoredRow


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, selection, form and the store."""
    add_topics(parser)
    add_message_options(parser)
    add = parser.add_argument
    text = "maximum number of messages to print (default: all)"
    add("-n", "--limit", metavar="COUNT", type=whole_number, help=text)
    add("--noarr", action="store_true", help="print only type and length of arrays")
    add("--nostr", action="store_true", help="print only the length of strings")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the messages one by one while they are read."""
    where, (start, end) = read_where(options), read_times(options)
    event = read_event(options)
    with open_store(options) as ros_cas:
        rows = ros_cas.readMessages(
            stored_topics(ros_cas.catalog, options),
            start,
            end,
            nodeID=options.node_id,
            where=where or None,
            run=options.run,
            event=event,
        )
        printer = _Printer(options)
        damaged, opening = 0, "[\n"
        for row in islice(rows, options.limit):
            try:
                text = printer.text(row)
            except CorruptMessage as exc:
                print(f"cassandra_bag: {' '.join(str(exc).split())}", file=sys.stderr)
                damaged += 1
                continue
            sys.stdout.write(opening + text if options.json else text)
            opening = ",\n"
        if options.json:
            sys.stdout.write("[]\n" if opening == "[\n" else "\n]\n")
    return 1 if damaged else 0


class _Printer:
    """Formats messages with their topic, times, robot, run and type."""

    def __init__(self, options: argparse.Namespace) -> None:
        from cassandra_ros.topics.message_text import MessageText

        # As in rostopic echo: --noarr leaves an empty array as it is, --nostr no string at all.
        elements = 0 if options.noarr else None
        characters = -1 if options.nostr else None
        self._json = options.json
        self._message = MessageText(options.json, elements, characters)

    def text(self, row: StoredRow) -> str:
        """Return a message as text: YAML with a comment, or a JSON object."""
        message = self._message.of(row)
        if not self._json:
            head = " ".join(
                filter(None, (shown(row.topic), _time(row.t), shown(row.type), shown(row.node)))
            )
            return f"# {head}\n{shown_lines(message)}\n---\n"
        facts = {
            "topic": row.topic,
            "time_ns": row.t,
            "received_ns": row.received,
            "node": row.node,
            "run": row.run,
            "type": row.type,
            "md5sum": row.md5sum,
        }
        if row.name:
            facts["name"] = row.name
        head = json.dumps(plain(facts), ensure_ascii=False)
        return f'{head[:-1]}, "message": {message}}}'


def _time(ns: int) -> str:
    from cassandra_ros.messages.stamps import iso_time

    return f"{iso_time(ns)} {ns}"
