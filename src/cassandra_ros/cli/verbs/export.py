# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write stored messages into a bag of format 2.0, an MCAP, or a folder of Parquet files.

  cassandra_bag export corridor.bag --run corridor
  cassandra_bag export scans.mcap --topics /scan /tf --start 2013-05-08T14:06:20Z
  cassandra_bag export low.bag --around '/battery: voltage < 11' --before 1m
  cassandra_bag export ~/lake --parquet

It is an MCAP if OUT ends with .mcap. Messages are written in the order of their times. Connections
keep topic, header and number, so the messages of an imported bag keep their order. Times are
seconds (1368021980.25), ISO 8601 (UTC unless a zone is given), or nanoseconds (13 digits or more).
If there are no messages, no bag is written, and an existing one is kept.

With --start, and in each time range of --event or --around, the bag begins with the messages that
were latched before (/tf_static, say): the last one of each latching publisher in the exported
recordings, as far as it has changed since. Their time in the bag is the start; the field
latched_from of their connection's header holds their receive time in nanoseconds.

An MCAP has the profile ros1, so Foxglove and the mcap tools can read it. It also holds connection
headers and events; cassandra_bag import restores all of it.

With --parquet OUT is a folder of Parquet files, for DuckDB, Spark, pandas and polars (doc/sql.md).
A second run writes only those whose messages have changed, keeping those of deleted messages.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import TYPE_CHECKING

from cassandra_ros.cli.fleet_options import (
    add_fleet_options,
    open_fleet,
    refuse_single_store_options,
    tell_missing,
)
from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import (
    add_around_option,
    add_message_options,
    add_store_options,
    open_store,
    read_around,
    read_event,
    read_times,
    read_where,
)
from cassandra_ros.cli.parquet_folder import write_folder
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics_option, stored_topics, topics_among
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.files.bag.exporter import ExportReport


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bag, selection, compression and the store."""
    add = parser.add_argument
    add(
        "bag",
        nargs="?",
        metavar="OUT.bag",
        help="the bag to write; OUT.mcap writes an MCAP, --parquet a folder (default: that of -o)",
    )
    text = "the bag to write, as an option, which may stand anywhere (default: OUT.bag)"
    add("-o", "--output", metavar="OUT.bag", help=Rare(text))
    add_topics_option(parser, "OUT.bag, or with -o anywhere")
    text = "write whole topics as Parquet files, in the folder OUT"
    add("--parquet", action="store_true", help=text)
    add_message_options(parser)
    text = (
        "only messages from 5 s before to 10 s after those of TOPIC that satisfy CONDITION, or "
        "from --before to --after (default: of all time)"
    )
    add_around_option(parser, text)
    add(
        "--no-latched",
        dest="latched",
        action="store_false",
        help=Rare(
            "leave out messages that were latched before; needed with --store and --start or "
            "--event"
        ),
    )
    packing = parser.add_mutually_exclusive_group()
    packing.add_argument(
        "-j", "--bz2", dest="compression", action="store_const", const="bz2", help=Rare("use BZ2")
    )
    packing.add_argument(
        "--lz4", dest="compression", action="store_const", const="lz4", help=Rare("use LZ4")
    )
    packing.add_argument(
        "--compression",
        choices=("none", "bz2", "lz4", "zstd"),
        metavar="NAME",
        help=Rare(
            "none or lz4, for a bag also bz2, for an MCAP also zstd (default: none for a bag, "
            "zstd for an MCAP)"
        ),
    )
    add("-f", "--force", action="store_true", help="replace OUT.bag if it exists")
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)
    add_fleet_options(parser)


def run(options: argparse.Namespace) -> int:
    """Export, and print what was written."""
    from cassandra_ros.files.bag.exporter import export_bag

    where, (start, end) = read_where(options), read_times(options)
    event, around = read_event(options), read_around(options)
    if around is not None and (options.parquet or options.stores):
        options.parser.error("--around is for a bag or an MCAP of one store")
    path, begun = _path(options), time.monotonic()
    if options.parquet:
        return write_folder(options, path)
    if os.path.isdir(path):
        options.parser.error(f"{path} is a folder: give OUT.bag, or --parquet")
    if options.stores:
        return _export_fleet(options, path, begun)
    with open_store(options) as ros_cas, MessageBar(f"exporting {path}") as bar:
        report = export_bag(
            ros_cas,
            path,
            topics=stored_topics(ros_cas.catalog, options),
            start=start,
            end=end,
            nodeID=options.node_id,
            compression=options.compression,
            force=options.force,
            progress=bar.add,
            where=where,
            latched=options.latched,
            run=options.run,
            event=event,
            around=around,
        )
    _tell(options, report, begun)
    return 0


def _tell(options: argparse.Namespace, report: ExportReport, begun: float) -> None:
    """Print what was written; ``begun`` is when, by the monotonic clock, s."""
    since = None if options.event or options.around else options.start
    tell(options, report, _text(report, since, time.monotonic() - begun))


def _export_fleet(options: argparse.Namespace, path: str, begun: float) -> int:
    from cassandra_ros.files.bag.fleet_export import export_fleet

    if options.latched:
        values = {"--start": options.start, "--event": options.event}
        refuse_single_store_options(
            options, {f"{name} without --no-latched": value for name, value in values.items()}
        )
    where, (start, end), event = read_where(options), read_times(options), read_event(options)
    with open_fleet(options) as fleet, MessageBar(f"exporting {path}") as bar:
        present = fleet.topics()
        report = export_fleet(
            fleet,
            path,
            topics=topics_among(options, set(present), "the fleet"),
            start=start,
            end=end,
            nodeID=options.node_id,
            compression=options.compression,
            force=options.force,
            progress=bar.add,
            where=where,
            run=options.run,
            event=event,
        )
    report.missing = {**present.missing, **report.missing}
    _tell(options, report, begun)
    return tell_missing(report.missing)


def _path(options: argparse.Namespace) -> str:
    """Return the name of the bag; end the program if no name or two names are given."""
    paths = [path for path in (options.bag, options.output) if path is not None]
    if len(paths) == 2:
        options.parser.error(f"one bag is made: {paths[0]} or -o {paths[1]}")
    if not paths:
        swallowed = "; --topics takes all words after it" if options.topics else ""
        options.parser.error(f"the bag to make is missing: give OUT.bag or -o OUT.bag{swallowed}")
    return str(paths[0])


def _text(report: ExportReport, start: str | None, seconds: float) -> str:
    """Return the report; ``start`` is --start as typed, None = the bag has several time ranges."""
    lines = []
    rows = [(shown(topic), str(count)) for topic, count in sorted(report.messages.items())]
    if rows:
        lines.append(format_table(("topic", "messages"), rows, right=("messages",)))
    early = sum(report.latched.values())
    if early:
        begin = start or "the time ranges"
        time_in_file = start or "the start of a time range"
        lines.append(
            f"{early} of these were latched before {begin}; their time in the file is "
            f"{time_in_file}"
        )
    lines.append(
        f"{report.path}: {counted(sum(report.messages.values()), 'message')} of "
        f"{counted(len(rows), 'topic')}, "
        f"{format_bytes(report.bytes)} ({seconds:.1f} s)"
        + (f", {counted(report.events, 'event')}" if report.events else "")
    )
    return "\n".join(lines)
