# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare a bag or an MCAP with the store, message by message; exit status 0 only if equal.

Topic, time, type, md5sum, bytes, connection header and order are compared, as rosbag reads them. If
the store holds an import of this bag, only the messages of that import are compared, so other bags
and recordings of the same topics do not matter. Otherwise all stored messages of the bag's topics
are compared.

With --content only type, md5sum, bytes and order of each topic's messages are compared. Use it for
a recording of a bag that was played: its times and connections differ from the bag. --start and
--end are times in the store: seconds (1368021980.25), ISO 8601 or nanoseconds (13 digits or more).
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_event_options,
    add_large_chunks_option,
    add_origin_options,
    add_store_options,
    add_time_options,
    open_store,
    read_event,
    read_pair,
    read_times,
)
from cassandra_ros.cli.terminal_text import MessageBar, counted
from cassandra_ros.cli.topic_options import add_topics_option, topics_among
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.bag.comparison import VerifyReport


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, what is compared, and the store."""
    add = parser.add_argument
    add("bag", metavar="FILE.bag", help="a bag of format 2.0, or an MCAP of ROS 1")
    add_topics_option(parser, "FILE.bag")
    add_origin_options(parser)
    add("--content", action="store_true", help="compare only the content, see above")
    add(
        "--salvage",
        action="store_true",
        help="compare the part of a damaged bag that import --salvage stores (default: refuse it)",
    )
    add_large_chunks_option(parser)
    add(
        "--map",
        metavar="FROM:=TO",
        action="append",
        type=lambda text: read_pair(text, ":=", "FROM:=TO"),
        default=[],
        help="with --content: topic FROM of the bag was recorded as TO; may be repeated",
    )
    add_time_options(parser, "with --content: ")
    add_event_options(parser, "with --content: ")
    add("-q", "--quiet", action="store_true", help="print differences only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Compare, and print the first differences."""
    if not options.content and (options.map or options.start or options.end or options.event):
        options.parser.error("--map, --start, --end and --event go with --content")
    report = _compare(options)
    if options.json:
        print_json({"keyspace": options.keyspace, "equal": report.equal, **vars(report)})
        return 0 if report.equal else 1
    if not report.equal:
        _print_differences(report)
        _print_left_out(report)
        return 1
    if not options.quiet:
        what = "type, md5sum, bytes, order in each topic"
        if not options.content:
            what = "topic, time, type, md5sum, bytes, connection, order"
        print(
            f"equal: {report.path} and keyspace {options.keyspace}, "
            f"{counted(report.equal_messages, 'message')} ({what})"
        )
        _print_left_out(report)
    return 0


def _compare(options: argparse.Namespace) -> VerifyReport:
    from cassandra_ros.bag.comparison import verify_bag, verify_content
    from cassandra_ros.bag.file_formats import open_file

    (start, end), event = read_times(options), read_event(options)
    with open_file(options.bag, options.salvage, options.allow_large_chunks) as reader:
        count = reader.message_count
        names = {connection.topic for connection in reader.connections.values()}
        topics = topics_among(options, names, reader.path)
    first = MessageBar(f"reading {options.bag}", count)
    bar = MessageBar(f"verifying {options.bag}", count)
    with open_store(options) as ros_cas, first, bar:
        if not options.content:
            return verify_bag(
                ros_cas,
                options.bag,
                topics,
                options.node_id,
                bar.add,
                first.add,
                options.run,
                options.salvage,
                options.allow_large_chunks,
            )
        return verify_content(
            ros_cas,
            options.bag,
            topics=topics,
            nodeID=options.node_id,
            mapping=dict(options.map),
            start=start,
            end=end,
            progress=bar.add,
            run=options.run,
            salvage=options.salvage,
            large_chunks=options.allow_large_chunks,
            event=event,
        )


def _print_left_out(report: VerifyReport) -> None:
    if report.left_out:
        what = f"{counted(report.left_out, 'message')} that the export took from before its window"
        print(f"not compared: {what}, as latched")


def _print_differences(report: VerifyReport) -> None:
    print(
        f"different: {shown(report.path)}: {report.differences} messages differ from the store, "
        f"{report.equal_messages} are equal (compared: {report.scope})"
    )
    for text in report.first:
        print(f"  {shown(text, None)}")
    if report.differences > len(report.first):
        print("  …")
