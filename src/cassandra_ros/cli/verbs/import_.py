# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store the messages of bags, or of MCAP files with messages of ROS 1.

Every message keeps its topic, type, time, bytes and connection. Importing the same bag again, or
first a part of it and then all, or once more after an interruption, ends in the same messages. A
topic whose definition is empty or broken is kept as binary, with a warning. One whose name cannot
be kept (it holds a NUL) is left out: a warning says how many messages that are, and the exit status
is 1. So are the messages of an MCAP that are none of ROS 1, as JSON or protobuf.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from types import FrameType
from typing import TYPE_CHECKING

from cassandra_ros.cli.options import add_format_option, add_store_options, open_store
from cassandra_ros.cli.text import MessageBar, format_bytes, format_table, shown

if TYPE_CHECKING:
    from cassandra_ros.bag.importer import ImportReport
    from cassandra_ros.bag.message_file import Progress
    from cassandra_ros.topics.ros_cassandra import RosCassandra


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add bags, format, selection and the store."""
    add = parser.add_argument
    add("bags", nargs="+", metavar="FILE", help="bags of format 2.0, or MCAP files of ROS 1")
    add_format_option(parser)
    add("--topics", nargs="+", metavar="TOPIC", help="only these topics (after the FILEs)")
    add(
        "--node-id",
        default="",
        metavar="N",
        help="the robot or entity that produced the messages (default: nobody says)",
    )
    add(
        "--jobs",
        metavar="N",
        type=int,
        default=1,
        help="so many processes store the messages of each bag (default: 1): faster where cores "
        "are free beside those that Cassandra keeps busy",
    )
    add("-q", "--quiet", action="store_true", help="print errors and warnings only")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Import one bag after the other; the first that fails ends it."""
    status = 0
    with open_store(options, make=True) as ros_cas:
        for path in options.bags:
            try:
                if _import(ros_cas, path, options).lost:
                    status = 1
            except (KeyboardInterrupt, SystemExit):
                hint = "cassandra_bag: interrupted; the same command again completes the import"
                print(hint, file=sys.stderr)
                raise
    return status


def _import(ros_cas: RosCassandra, path: str, options: argparse.Namespace) -> ImportReport:
    from cassandra_ros.bag.importer import import_bag
    from cassandra_ros.bag.message_file import chosen_connections
    from cassandra_ros.bag.opening import open_file

    with open_file(path) as reader:
        chosen = chosen_connections(reader, options.topics)
        count = sum(reader.counts[number] for number in chosen)
        total = reader.message_count
    begun, name = time.monotonic(), os.path.basename(path)
    first, second = MessageBar(f"reading {name}", total), MessageBar(f"importing {name}", count)
    with first, second, SafeInterrupt() as stop:

        def shown_by(bar: MessageBar) -> Progress:
            def add(messages: int, size: int) -> None:
                bar.add(messages)
                stop.check()

            return add

        report = import_bag(
            ros_cas,
            path,
            format=options.format,
            topics=options.topics,
            nodeID=options.node_id,
            progress=shown_by(second),
            reading=shown_by(first),
            jobs=options.jobs,
        )
    if not options.quiet:
        _print_report(report, options.keyspace, time.monotonic() - begun)
    return report


def _print_report(report: ImportReport, keyspace: str, seconds: float) -> None:
    rows = [
        (shown(name), str(topic.messages), format_bytes(topic.bytes), topic.format)
        for name, topic in sorted(report.topics.items())
    ]
    if rows:
        header = ("topic", "messages", "size", "format")
        print(format_table(header, rows, right=("messages", "size")))
    print(
        f"{report.path}: {report.messages} messages of {len(rows)} topics are in keyspace "
        f"{keyspace} ({seconds:.1f} s)"
    )


class SafeInterrupt:
    """Ctrl-C and SIGTERM at a moment of our choice: between two messages, not amid a write.

    While it is entered, the first signal waits for check(); a second one acts at once.
    """

    def __init__(self) -> None:
        self._came: int | None = None
        self._handlers: dict[int, signal._HANDLER] = {}

    def check(self) -> None:
        """Raise KeyboardInterrupt after a Ctrl-C, SystemExit with a shell's status on SIGTERM."""
        if self._came == signal.SIGINT:
            raise KeyboardInterrupt
        if self._came is not None:
            raise SystemExit(128 + self._came)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._came = number
        self._restore()

    def _restore(self) -> None:
        while self._handlers:
            signal.signal(*self._handlers.popitem())

    def __enter__(self) -> SafeInterrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._handlers[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._restore()
        if kind is None:
            self.check()
