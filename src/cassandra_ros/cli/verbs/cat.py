# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print stored messages as rostopic echo does, those of several topics in the order of time.

  cassandra_bag cat /fix -n 1
  cassandra_bag cat /scan --start 2013-05-08T14:06:20Z --end 2013-05-08T14:06:21Z --noarr
  cassandra_bag cat /cmd_vel --where '/cmd_vel: linear.x > 0.5' --json

Above each message stand its topic, time (UTC and in nanoseconds), type and robot, as a comment, so
that all together is YAML. With --json it is one list, an object a line, in which times of messages
are secs and nsecs, uint8[] base64 and NaN null, as in rosbridge. A message that cannot be read is
told on standard error, and the exit status is 1 then.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import islice
from typing import TYPE_CHECKING, Callable

from cassandra_ros.cli.answers import add_json_option, plain
from cassandra_ros.cli.options import (
    add_origin_options,
    add_store_options,
    add_time_options,
    add_where_option,
    open_store,
    read_times,
    read_where,
)
from cassandra_ros.cli.readers import whole_number
from cassandra_ros.cli.text import shown
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.errors import CorruptMessage

if TYPE_CHECKING:
    from cassandra_ros.topics.stored_row import StoredRow
    from cassandra_ros.topics.topic_table import TopicTable

_NO_LIMIT = 2**62
_Print = Callable[[bytes], str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, selection, form and the store."""
    add_topics(parser)
    add_time_options(parser)
    add_origin_options(parser)
    add_where_option(parser)
    add = parser.add_argument
    text = "print so many messages at the most (default: all)"
    add("-n", "--limit", metavar="COUNT", type=whole_number, help=text)
    add("--noarr", action="store_true", help="say of arrays only their type and length")
    add("--nostr", action="store_true", help="say of strings only their length")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print message after message, while they are read."""
    where, (start, end) = read_where(options), read_times(options)
    with open_store(options) as ros_cas:
        rows = ros_cas.readMessages(
            stored_topics(ros_cas, options),
            start,
            end,
            nodeID=options.node_id,
            where=where or None,
            run=options.run,
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
    """Writes messages, in a form that is compiled once for each table."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._json = options.json
        self._limits = (0 if options.noarr else _NO_LIMIT, -1 if options.nostr else _NO_LIMIT)
        self._prints: dict[str, _Print] = {}

    def text(self, row: StoredRow) -> str:
        """Return the text of a message with what is known of it."""
        printed = self._prints.get(row.table.name)
        if printed is None:
            printed = self._prints[row.table.name] = self._print_of(row.table)
        message = printed(row.wire)
        if not self._json:
            head = " ".join(
                filter(None, (shown(row.topic), _time(row.t), row.type, shown(row.node)))
            )
            return f"# {head}\n{message}\n---\n"
        known = {
            "topic": row.topic,
            "time_ns": row.t,
            "received_ns": row.received,
            "node": row.node,
            "run": row.run,
            "type": row.type,
            "md5sum": row.md5sum,
        }
        if row.name:
            known["name"] = row.name
        head = json.dumps(plain(known), ensure_ascii=False)
        return f'{head[:-1]}, "message": {message}}}'

    def _print_of(self, table: TopicTable) -> _Print:
        from cassandra_ros.formats.json import CassandraTopic_json
        from cassandra_ros.messages.tree.echo import echo_printer
        from cassandra_ros.messages.tree.read import Budget, tree_reader

        metadata, definition, as_json = table.metadata, table.definition, self._json
        if definition is None:
            return lambda wire: _bytes_alone(metadata.msg_type, wire, as_json)
        reader, show = tree_reader(definition), echo_printer(definition)
        if as_json:
            show = CassandraTopic_json(metadata.msg_type, metadata.md5sum, definition).print_tree

        def print_wire(wire: bytes) -> str:
            elements, characters = self._limits
            tree = reader.read(wire, Budget(_NO_LIMIT, 1, elements, characters))
            if tree is None:
                raise CorruptMessage(f"{len(wire)} bytes of {metadata.msg_type} have no text")
            return show(tree)

        return print_wire


def _time(ns: int) -> str:
    from cassandra_ros.messages.stamps import iso_time

    return f"{iso_time(ns)} {ns}"


def _bytes_alone(msg_type: str, wire: bytes, as_json: bool) -> str:
    if as_json:
        return json.dumps({"bytes": plain(wire)})
    return f"# {len(wire)} bytes of {shown(msg_type)}, of which no usable definition is stored"
