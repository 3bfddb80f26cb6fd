# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare files or another store with the store, by message; exit status 0 only if equal.

  cassandra_bag verify corridor.bag
  cassandra_bag verify ~/lake --parquet
  cassandra_bag verify --with home

Topic, time, type, md5sum, bytes, connection header and order are compared, as rosbag reads them. If
the store holds an import of this bag, only the messages of that import are compared, so other bags
and recordings of the same topics do not matter. Otherwise all stored messages of the bag's topics
are compared, under the names that the topics have now. A file that was exported of several robots
names the robot of each message, so they are told apart; of other files the messages of all robots
are compared together, and a line says so.

With --start and --end only messages of that time range are compared: so a time range that was
exported is equal to its file. A range without any message in both is an error. Times are seconds
(1368021980.25), ISO 8601 or nanoseconds (13 digits or more). The same options as those of export
are for a file of its --event or --around.

With --content only type, md5sum, bytes and order of each topic's messages are compared. Use it for
a recording of a bag that was played: its times and connections differ from the bag. --start and
--end are times in the store then, and all messages of the bag are compared. Messages of one topic
and time by several publishers have no order of their own: stored in another one, they differ.

With --with HOST[:PORT][/KEYSPACE] in place of a file, all messages of the store are compared with
those that another store has of the same robots and runs, bucket by bucket, and the buckets that
differ are named. Both stores are read from here; of blocks that are stored alike only the headers,
which have checksums. --repair copies the topics again, whatever the books say. What is only in the
other store stays there.

With --parquet FILE is a folder of Parquet files of export: numbers of messages, and a digest of all
values, are compared (needs DuckDB). A file whose messages were deleted from the store differs.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING, Callable

from cassandra_ros.cli.fleet_options import add_target_options, open_target
from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_around_option,
    add_event_options,
    add_large_chunks_option,
    add_origin_options,
    add_store_options,
    add_time_options,
    open_store,
    read_around,
    read_event,
    read_pair,
    read_pairs,
    read_times,
)
from cassandra_ros.cli.parquet_folder import compare_folder
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_time
from cassandra_ros.cli.topic_options import add_topics_option, topics_among
from cassandra_ros.keys import MAX_NS
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.files.bag.comparison import VerifyReport


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, what is compared, and the store."""
    add = parser.add_argument
    add(
        "bag",
        metavar="FILE.bag",
        nargs="?",
        help="a bag of format 2.0, or an MCAP of ROS 1 (default: the store of --with)",
    )
    add_topics_option(parser, "FILE.bag")
    text = "FILE is a folder of Parquet files of export"
    add("--parquet", action="store_true", help=text)
    add_origin_options(parser)
    add("--content", action="store_true", help="compare only the content, see above")
    add(
        "--salvage",
        action="store_true",
        help=Rare(
            "compare the part of a damaged bag that import --salvage stores (default: refuse it)"
        ),
    )
    add_large_chunks_option(parser)
    add(
        "--map",
        metavar="FROM:=TO",
        action="append",
        type=lambda text: read_pair(text, ":=", "FROM:=TO"),
        default=[],
        help=Rare("with --content: topic FROM of the bag was recorded as TO; may be repeated"),
    )
    add_time_options(parser)
    add_event_options(parser)
    add_around_option(parser, "compare what export --around wrote (default: all)")
    add("--repair", action="store_true", help="with --with: copy what differs again")
    add("-q", "--quiet", action="store_true", help="print differences only")
    add_json_option(parser)
    add_target_options(parser, "--with", "compare with this store")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Compare, and print the first differences."""
    if (options.bag is None) == (options.target is None):
        options.parser.error("give FILE.bag, or --with another store")
    if options.parquet:
        return compare_folder(options, options.bag)
    if options.target is not None:
        return _compare_stores(options)
    if options.repair:
        options.parser.error("--repair goes with --with")
    if options.map and not options.content:
        options.parser.error("--map goes with --content")
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
    """Compare a bag or an MCAP; verify_bag reads it twice, so there are two progress bars."""
    from cassandra_ros.files.bag.comparison import verify_bag, verify_content
    from cassandra_ros.files.bag.file_formats import open_file
    from cassandra_ros.files.bag.message_file import topics_of

    (start, end), event = read_times(options), read_event(options)
    around = read_around(options)
    mapping = read_pairs(options, "--map", options.map)
    with open_file(options.bag, options.salvage, options.allow_large_chunks) as reader:
        count = reader.message_count
        topics = topics_among(options, topics_of(reader, None), reader.path)
    first = MessageBar(f"reading {options.bag}", count)
    bar = MessageBar(f"verifying {options.bag}", count)
    with open_store(options) as ros_cas, first, bar:
        compare: Callable[..., VerifyReport] = partial(verify_bag, reading=first.add)
        if options.content:
            compare = partial(verify_content, mapping=mapping)
        return compare(
            ros_cas,
            options.bag,
            topics=topics,
            nodeID=options.node_id,
            start=start,
            end=end,
            progress=bar.add,
            run=options.run,
            salvage=options.salvage,
            large_chunks=options.allow_large_chunks,
            event=event,
            around=around,
        )


def _compare_stores(options: argparse.Namespace) -> int:
    """Compare with the store of --with, and print the buckets that differ; return the status."""
    from cassandra_ros.stores.copying.replicator import Replicator

    of_files = ("content", "map", "start", "end", "event", "around")
    given = [name for name in of_files if getattr(options, name)]
    if given:
        options.parser.error(f"--{given[0]} goes with FILE.bag")
    with open_store(options) as ros_cas, open_target(options, make=False) as other:
        names = {topic.name for topic in ros_cas.catalog.all(None)}
        topics = topics_among(options, names, f"keyspace {options.keyspace}")
        replicator = Replicator(ros_cas, other, topics, nodeID=options.node_id, run=options.run)
        with MessageBar(f"comparing with {shown(replicator.place)}", unit=" buckets") as bar:
            result = replicator.compare(bar.reach, repair=options.repair)
    if options.json:
        print_json({"equal": result.equal, **vars(result)})
        return 0 if result.equal else 1
    for topic, reason in sorted(result.refused.items()):
        print(f"refused: {shown(topic)}: {shown(' '.join(reason.split()), None)}")
    for difference in result.differences:
        whose = f" of {shown(difference.node)}" if difference.node else ""
        when = "under names"
        if difference.last_ns <= MAX_NS:
            when = f"{format_time(difference.first_ns)} to {format_time(difference.last_ns)}"
        numbers = f"{difference.here.messages} messages here, {difference.there.messages} there"
        print(f"different: {shown(difference.topic)}{whose} {when}: {numbers}")
    if result.equal and not options.quiet:
        what = f"{counted(result.messages, 'message')} in {counted(result.buckets, 'bucket')}"
        print(f"equal: keyspace {options.keyspace} and {shown(result.place)}, {what}")
    return 0 if result.equal else 1


def _print_left_out(report: VerifyReport) -> None:
    """Print what the comparison left out; this does not count as a difference."""
    if report.left_out:
        what = f"{counted(report.left_out, 'message')} that the export took from before its window"
        print(f"not compared: {what}, as latched")
    if report.mixed_robots:
        robots = ", ".join(shown(robot) or "no name" for robot in report.mixed_robots)
        print(
            f"not compared: which message is of which robot ({robots}), for the file does not "
            "tell it; --node-id compares those of one"
        )
    for kind, count in report.extras.items():
        what = f"{shown(kind, None)} of the file, {count}"
        print(f"not stored: {what}; the store holds messages only")


def _print_differences(report: VerifyReport) -> None:
    print(
        f"different: {shown(report.path)}: {report.differences} messages differ from the store, "
        f"{report.equal_messages} are equal (compared: {report.scope})"
    )
    for text in report.first:
        print(f"  {shown(text, None)}")
    if report.differences > len(report.first):
        print("  …")
    if not report.missing:
        print(
            "the file has nothing that is not stored; of an exported part compare that part: "
            "--start T --end T, --event NAME, --around 'TOPIC: CONDITION', --run NAME, --node-id N"
        )
