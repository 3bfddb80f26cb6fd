# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Record topics into Cassandra. Every message is kept as it was sent, found by its time.

Ctrl-C, SIGTERM and the shutdown of the node end the recording; what has arrived is stored first.
The exit status is 1 when messages were lost, or nobody published a topic that was named.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from typing import TYPE_CHECKING, Sequence

from cassandra_ros.arguments import check_ros_name
from cassandra_ros.cli.options import (
    add_format_option,
    add_store_options,
    open_store,
    program_parser,
    strip_remappings,
)
from cassandra_ros.cli.readers import duration, megabytes, regular_expression, whole_number
from cassandra_ros.cli.text import format_bytes, format_table, shown
from cassandra_ros.errors import InvalidName, UnknownFormat
from cassandra_ros.formats.table import format_class

if TYPE_CHECKING:
    from cassandra_ros.recording.counts import TopicReport
    from cassandra_ros.recording.options import RecorderOptions

PROGRAM = "recorder"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; its names are those of RecorderOptions."""
    parser = program_parser(PROGRAM, __doc__)
    add = parser.add_argument
    add("topics", metavar="TOPIC", nargs="*", help="record these topics")
    add("-a", "--all", action="store_true", help="record all topics")
    add("-e", "--regex", action="store_true", help="match topics using regular expressions")
    text = "exclude topics matching the follow regular expression"
    add("-x", "--exclude", metavar="EXCLUDE_REGEX", type=regular_expression, default="", help=text)
    add_format_option(parser)
    text = "name of the robot or entity that is recorded (default: none)"
    add("--node-id", metavar="N", default="", help=text)
    add("-q", "--quiet", action="store_true", help="suppress console output")
    text = "record for this long, in seconds, unless 'm', or 'h' is appended."
    add("--duration", type=duration, default=0.0, help=text)
    text = "only record NUM messages on each topic"
    add("-l", "--limit", metavar="NUM", type=whole_number, default=0, help=text)
    text = "use an internal buffer of SIZE MB (Default: 256, 0 = infinite)"
    add("-b", "--buffsize", metavar="SIZE", type=megabytes, default="256", help=text)
    text = "let messages of new topics expire after this many seconds (default: never)"
    add("--ttl", metavar="SEC", type=whole_number, default=0, help=text)
    text = "Use the TCP_NODELAY transport hint when subscribing to topics."
    add("--tcpnodelay", action="store_true", help=text)
    add_store_options(parser)
    return parser


def read_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> RecorderOptions:
    """Return what is to be recorded; ends the program where that makes no sense."""
    from cassandra_ros.recording.options import RecorderOptions

    if bool(options.topics) == options.all:
        parser.error("give topics to record, or -a for all" + (", not both" * options.all))
    try:
        if options.format:
            format_class(options.format)
        for text in options.topics:
            (regular_expression if options.regex else check_ros_name)(text)
    except (InvalidName, UnknownFormat, argparse.ArgumentTypeError) as exc:
        parser.error(str(exc))
    given = vars(options)
    return RecorderOptions(
        **{f.name: given[f.name] for f in fields(RecorderOptions) if f.name in given}
    )


def main() -> int:
    """Record; return the exit status."""
    parser = make_parser()
    options = parser.parse_args(strip_remappings(None))
    chosen = read_options(parser, options)
    from cassandra_ros.nodes.recorder_node import record

    def say(text: str) -> None:
        if not options.quiet:
            print(text, flush=True)

    with open_store(options, make=True) as ros_cas:
        reports = record(ros_cas, chosen, sys.argv, say)
    say(closing_table(reports))
    failures = _failures(reports)
    for text in failures:
        print(f"{PROGRAM}: {text}", file=sys.stderr)
    return 1 if failures else 0


def _failures(reports: Sequence[TopicReport]) -> list[str]:
    """Say what was not recorded that should have been."""
    lost = sum(report.lost for report in reports)
    found = [f"{lost} messages were lost"] if lost else []
    for report in reports:
        if report.unheard_sec:
            found.append(
                f"for {report.unheard_sec:.0f} s new publishers of {shown(report.topic)} were not "
                "heard, for the ROS master was started anew"
            )
        if not report.published:
            found.append(f"nothing came on {shown(report.topic)}: nobody published it")
    if not reports:
        found.append("nothing was recorded: no topic that was published was to be")
    return found


def closing_table(reports: Sequence[TopicReport]) -> str:
    """Write what became of the messages of each topic.

    What is missing in the publishers' own numbers is no loss of ours: "seq gaps".
    """
    names = ("topic", "type", "received", "stored", "lost", "seq gaps", "bytes", "rate")
    rows: list[Sequence[str]] = [
        (
            shown(r.topic),
            shown(", ".join(r.types)),
            *map(str, (r.received, r.stored, r.lost)),
            "-" if r.gaps is None else str(r.gaps),
            format_bytes(r.bytes),
            f"{r.rate_hz:.1f} Hz",
        )
        for r in reports
    ]
    counts = [(r.received, r.stored, r.lost, r.gaps or 0) for r in reports]
    totals = [str(sum(column)) for column in zip((0, 0, 0, 0), *counts)]
    rows.append(("total", "", *totals, format_bytes(sum(r.bytes for r in reports)), ""))
    lines = [format_table(names, rows, right=names[2:])]
    for report in reports:
        for reason, count in report.reasons.items():
            lines.append(f"{shown(report.topic)}: {count} lost: {shown(reason)}")
    return "\n".join(lines)
