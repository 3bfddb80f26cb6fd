# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keep stored topics in another format, while others read them.

  cassandra_bag convert /scan --format packed
  cassandra_bag convert /tf /odom --format ros

Who reads a topic meanwhile sees all of its messages, each once; keys and cursors stay good. A copy
is made and compared message by message before it takes the place of the old tables, so for that
time the topic needs both on the disk. A topic that is being recorded is refused. When it is
interrupted or killed, the topic is as it was, but what is recorded then goes into a table beside,
and nothing can be deleted: the same command again removes what was left and begins anew; with the
format that the topic has it only removes that. What expires keeps about the time that it has left.
"""

from __future__ import annotations

import argparse
import time

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import MessageBar, counted
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.cli.verbs.import_ import SafeInterrupt
from cassandra_ros.formats.table import FORMATS
from cassandra_ros.printable import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, format and the store."""
    add = parser.add_argument
    add_topics(parser, "stored topics", "+")
    add("--format", required=True, choices=list(FORMATS), help="the format to keep them in")
    add("-q", "--quiet", action="store_true", help="print errors and warnings only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Convert one topic after the other; the first that fails ends it."""
    with open_store(options) as ros_cas:
        reports = []
        for topic in stored_topics(ros_cas, options) or ():
            begun = time.monotonic()
            with MessageBar(f"converting {shown(topic)}") as bar, SafeInterrupt(
                ros_cas.cassandra.outage
            ) as stop:

                def progress(done: int, total: int, bar: MessageBar = bar) -> None:
                    bar.reach(done, total)
                    stop.check()  # noqa: B023 - it is called within this turn only

                report = ros_cas.convertTopic(topic, options.format, progress)
            reports.append(report)
            if options.quiet or options.json:
                continue
            if report.tables:
                what = f"{counted(report.messages, 'message')} converted to format {report.format}"
                print(f"topic {shown(topic)}: {what} ({time.monotonic() - begun:.1f} s)")
            else:
                print(f"topic {shown(topic)}: is kept in format {report.format} already")
    if options.json:
        print_json(reports)
    return 0
