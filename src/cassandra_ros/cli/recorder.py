# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Record topics into Cassandra. Every message is kept as it was sent, found by its time.

Ctrl-C, SIGTERM and the shutdown of the node end the recording; what has arrived is stored first.
The exit status is 1 when messages were lost.
"""

from __future__ import annotations

import argparse
import re
import sys
from typing import TYPE_CHECKING, Sequence

from cassandra_ros.cli.options import (
    add_format_option,
    add_store_options,
    open_store,
    program_parser,
    strip_remappings,
)
from cassandra_ros.cli.text import format_bytes, format_table, shown
from cassandra_ros.errors import UnknownFormat
from cassandra_ros.formats.table import format_class

if TYPE_CHECKING:
    from cassandra_ros.nodes.recorder_node import RecorderOptions
    from cassandra_ros.recording.counts import TopicReport

PROGRAM = "recorder"
MEGABYTE = 1024 * 1024

_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600}


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    _add_choice(parser)
    _add_limits(parser)
    add_store_options(parser)
    return parser


def _add_choice(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topics", metavar="TOPIC", nargs="*", help="record these topics")
    parser.add_argument("-a", "--all", action="store_true", help="record all topics")
    parser.add_argument(
        "-e", "--regex", action="store_true", help="match topics using regular expressions"
    )
    parser.add_argument(
        "-x",
        "--exclude",
        metavar="EXCLUDE_REGEX",
        type=regular_expression,
        default="",
        help="exclude topics matching the follow regular expression",
    )
    add_format_option(parser)
    parser.add_argument(
        "--node-id",
        metavar="N",
        default="",
        help="name of the robot or entity that is recorded (default: none)",
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="suppress console output")


def _add_limits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--duration",
        type=duration,
        default=0.0,
        help="record for this long, in seconds, unless 'm', or 'h' is appended.",
    )
    parser.add_argument(
        "-l",
        "--limit",
        metavar="NUM",
        type=whole_number,
        default=0,
        help="only record NUM messages on each topic",
    )
    parser.add_argument(
        "-b",
        "--buffsize",
        metavar="SIZE",
        type=whole_number,
        default=256,
        help="use an internal buffer of SIZE MB (Default: 256, 0 = infinite)",
    )
    parser.add_argument(
        "--ttl",
        metavar="SEC",
        type=whole_number,
        default=0,
        help="let messages of new topics expire after this many seconds (default: never)",
    )
    parser.add_argument(
        "--tcpnodelay",
        action="store_true",
        help="Use the TCP_NODELAY transport hint when subscribing to topics.",
    )


def regular_expression(text: str) -> str:
    """Check a regular expression, for argparse."""
    try:
        re.compile(text)
    except re.error as exc:
        raise argparse.ArgumentTypeError(f"{text!r} is not a regular expression: {exc}") from exc
    return text


def duration(text: str) -> float:
    """Read a duration as rosbag does, in seconds: 30, 90s, 1.5m, 2h."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)([smh]?)", text)
    if match is None or not float(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration, like 30, 5m or 2h")
    return float(match[1]) * _UNITS[match[2]]


def whole_number(text: str) -> int:
    """Read a number of 0 or more, for argparse."""
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 0 or more")
    return int(text)


def read_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> RecorderOptions:
    """Return what is to be recorded; ends the program where that makes no sense."""
    from cassandra_ros.nodes.recorder_node import RecorderOptions

    if bool(options.topics) == options.all:
        parser.error("give topics to record, or -a for all" + (", not both" * options.all))
    if options.format:
        try:
            format_class(options.format)
        except UnknownFormat as exc:
            parser.error(str(exc))
    if options.regex:
        for text in options.topics:
            try:
                regular_expression(text)
            except argparse.ArgumentTypeError as exc:
                parser.error(str(exc))
    return RecorderOptions(
        topics=tuple(options.topics),
        all=options.all,
        regex=options.regex,
        exclude=options.exclude,
        format=options.format,
        node_id=options.node_id,
        duration_sec=options.duration,
        limit=options.limit,
        buffer_bytes=options.buffsize * MEGABYTE,
        ttl_sec=options.ttl,
        tcp_nodelay=options.tcpnodelay,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Record; return the exit status.

    Args:
        argv: Arguments without the program's name; None = those of the process.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = make_parser()
    options = parser.parse_args(strip_remappings(arguments))
    chosen = read_options(parser, options)
    from cassandra_ros.nodes.recorder_node import record

    def say(line: str) -> None:
        if not options.quiet:
            print(line, flush=True)

    with open_store(options, make=True) as ros_cas:
        reports = record(ros_cas, chosen, [PROGRAM, *arguments], say)
    if not options.quiet:
        print(closing_table(reports), flush=True)
    lost = sum(report.lost for report in reports)
    if lost:
        print(f"{PROGRAM}: {lost} messages were lost", file=sys.stderr)
    return 1 if lost else 0


def closing_table(reports: Sequence[TopicReport]) -> str:
    """Write what became of the messages of each topic."""
    names = ("topic", "type", "received", "stored", "lost", "gaps before us", "bytes", "rate")
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
