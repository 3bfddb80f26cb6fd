# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read all stored messages, and list what is damaged; exit status 0 only if nothing is (left).

Each message is read and its checksums (of blocks and of large messages), connection and definition
are checked. Numbers, sizes and times of messages are compared with the directory, from which info
and all reads take them, except where a recorder or an import is writing. If the whole keyspace is
checked, rests of removed topics are searched, too. --start and --end select whole buckets, whose
length info prints. The kinds of damage:

  message     it cannot be read: repair the cluster, or import or record it again
  connection, definition   missing or changed: the messages cannot be decoded or exported
  count       number, size or time of messages differ from those in the directory
  bounds      minimum or maximum of a field in a block is wrong, so that conditions miss messages
  not listed  messages that are not in the directory, so that no read finds them
  orphan      pieces of a large message whose writer died
  leftover    metadata of a topic that was removed

Messages of up to 512 KiB in rows of their own (all formats but packed) have no checksum. They are
decoded, and a line gives their number.

--repair repairs count, not listed, orphan and leftover, and closes the buckets of recorders that
died. It deletes no message. To compare with a bag use verify.
"""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, add_time_options, open_store, read_times
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_bytes, format_time
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.topics.upkeep.store_check import CheckReport


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, the time, what is to be done, and the store."""
    add_topics(parser)
    add_time_options(parser)
    parser.add_argument("--repair", action="store_true", help="repair what is possible (see above)")
    parser.add_argument("-q", "--quiet", action="store_true", help="print damages only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Check the store, and print the damages."""
    (start, end), begun = read_times(options), time.monotonic()
    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas.catalog, options)
        with MessageBar("checking") as bar, SafeInterrupt(ros_cas.cassandra.outage) as stop:
            progress = stop.after(bar.reach)
            report = ros_cas.upkeep.check(
                topics, start, end, repair=options.repair, progress=progress
            )
    if options.json:
        print_json({**vars(report), "left": report.left})
    else:
        _print(report, options, time.monotonic() - begun)
    return 1 if report.left else 0


def _print(report: CheckReport, options: argparse.Namespace, seconds: float) -> None:
    for damage in report.damages:
        parts = [damage.kind.value, shown(damage.topic) or damage.table, shown(damage.node)]
        if damage.first_ns is not None:
            parts.append(f"{format_time(damage.first_ns)} to {format_time(damage.last_ns)}")
        state = "mended" if damage.mended else "damaged"
        print(f"{state}: {', '.join(filter(None, parts))}: {shown(damage.text, None)}")
    if report.found > len(report.damages):
        print(f"… and {report.found - len(report.damages)} more")
    if report.found or not options.quiet:
        print(
            f"keyspace {options.keyspace}: {counted(report.messages, 'message')}, "
            f"{format_bytes(report.bytes)} in {counted(report.buckets, 'bucket')} read "
            f"({seconds:.1f} s); {counted(report.found, 'damage')}, {report.mended} mended"
        )
    if report.unsummed and not options.quiet:
        print(
            f"{report.unsummed} messages lie in rows without a checksum (all formats but packed): "
            "a changed byte of theirs is found only where it cannot be decoded"
        )
    if report.writing and not options.quiet:
        print(
            f"the counts of {report.writing} buckets could not be compared: they are being "
            "written, or were written or deleted within the last minute"
        )
