# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Make, remove or list indexes: conditions on an indexed field read only the rows they find.

  cassandra_bag index /cmd_vel linear.x
  cassandra_bag index /tf transforms.child_frame_id
  cassandra_bag index --list

What is stored already is taken in, with a bar that shows how far it is; topics may be recorded
meanwhile: what a recorder is just writing is found without the index, and taken in when the same
command is given again. That also goes on where one was interrupted. FIELD may be of any format; of
an array, it finds the messages that contain a value.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.text import MessageBar, format_table, shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topic, field, what is to be done, and the store."""
    add = parser.add_argument
    add("topic", metavar="TOPIC", nargs="?", help="a stored topic")
    add("field", metavar="FIELD", nargs="?", help="dotted name of a field of its messages")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--remove", action="store_true", help="remove the index on FIELD")
    what.add_argument(
        "--list", action="store_true", help="list the indexes of TOPIC (default: of all topics)"
    )
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Do it, and say what was done."""
    if options.list:
        if options.field is not None:
            options.parser.error("--list goes without FIELD")
        return _list(options)
    if options.field is None:
        options.parser.error("TOPIC and FIELD are needed, or --list")
    with open_store(options) as ros_cas:
        topic = ros_cas.getTopic(options.topic)
        where = f"index on {shown(options.field)} of topic {shown(topic.name)}"
        if options.remove:
            topic.removeIndex(options.field)
            text = f"{where} removed"
        else:
            with MessageBar(f"indexing {options.field}") as bar:
                count = topic.createIndex(options.field, progress=bar.reach)
            text = f"{where}: {count} stored messages were taken in"
    if not options.quiet:
        print(text)
    return 0


def _list(options: argparse.Namespace) -> int:
    with open_store(options) as ros_cas:
        topics = (
            ros_cas.getAllTopics() if options.topic is None else [ros_cas.getTopic(options.topic)]
        )
        rows = sorted(
            {
                (shown(topic.name), shown(field))
                for topic in topics
                for table in topic.tables
                for field in table.metadata.indexes
            }
        )
    if rows:
        print(format_table(("topic", "field"), rows))
    else:
        print("there is no index")
    return 0
