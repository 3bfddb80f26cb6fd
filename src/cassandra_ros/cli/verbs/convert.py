# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Change the storage format of topics. Other programs can read them meanwhile.

  cassandra_bag convert /scan --format packed
  cassandra_bag convert /tf /odom --format ros

Readers always see all messages of the topic, each once; keys and cursors stay valid. The messages
are copied, and the copy is compared message by message before it replaces the old tables, so the
disk must have room for both. A topic that is being recorded is refused. If the command is
interrupted or killed, the topic keeps its old tables, but new recordings go into a further table,
and messages cannot be deleted. Then repeat the command: it deletes the incomplete copy and starts
again; with the format that the topic has, it only deletes the copy. Messages that expire keep
about their remaining time.
"""

from __future__ import annotations

import argparse
import time

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import MessageBar, counted
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.printable import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, format and the store."""
    add = parser.add_argument
    add_topics(parser, "stored topics", "+")
    add("--format", required=True, choices=FORMAT_NAMES, help="the format to keep them in")
    add("-q", "--quiet", action="store_true", help="print errors and warnings only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Convert the topics one after the other, up to the first failure."""
    with open_store(options) as ros_cas:
        reports = []
        for topic in stored_topics(ros_cas.catalog, options) or ():
            begun = time.monotonic()
            with MessageBar(f"converting {shown(topic)}") as bar, SafeInterrupt(
                ros_cas.cassandra.outage
            ) as stop:
                report = ros_cas.convertTopic(topic, options.format, stop.after(bar.reach))
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
