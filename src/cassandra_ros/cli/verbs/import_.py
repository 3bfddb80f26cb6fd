# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store the messages of bags, or of MCAP files with ROS 1 messages.

Every message keeps its topic, type, time, bytes and connection. You may import a bag again, import
a part of it first and then all, or repeat an interrupted import: the stored messages are the same.
A topic whose definition is empty or broken is stored as binary, with a warning. Messages that
cannot be stored are left out: a warning gives their topic, number and the reason, and the exit
status is 1. These are messages of a topic whose name contains NUL, of a connection whose header
states no type or no md5sum, of an MCAP those that are not ROS 1 messages (JSON, protobuf), and
those of a time after the year 2106.

  cassandra_bag import *.bag
  cassandra_bag import /data/monday /data/tuesday --recursive
  cassandra_bag import crashed.bag.active --salvage

Without --format a new topic is stored as packed if the file has at least 100 messages of it, 9 a
second or more, of at most 64 KiB each, and if packed saves at least a quarter of the disk; else as
ros. The table that is printed says why. A topic that is stored keeps its format.

If FILE is a folder, all its bags and MCAP files are imported, sorted by name: *.bag and *.mcap,
with --salvage also *.bag.active and *.mcap.active.

If there are several FILEs, those that cannot be read are skipped. A table at the end gives the
state of each: stored, salvaged (every message of the damaged file is stored), incomplete, failed,
or not tried (after the store failed). The exit status is 0 if all are stored or salvaged.

A run is known by its content and its robot; its name, which is that of the file, is a label. A copy
of a file under another name is stored once, and its run keeps its name. The same file with another
--node-id is stored once for each robot. Two files with one name are two runs of one name: --run
with the number that 'runs' lists, or with the path of the file, means one of them. The output says
which of these cases came about.

An import that ended at damage is continued with --salvage: the messages before the damage, and of
all chunks after it, are one run. A salvaged bag counts as another bag than the complete one: to
import that later, delete the salvaged run first.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_large_chunks_option,
    add_store_options,
    foreign_keyspace,
    open_store,
)
from cassandra_ros.cli.parsers import add_option, error_line
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics_option, topics_among
from cassandra_ros.errors import (
    BagError,
    CassandraRosError,
    CorruptMessage,
    DefinitionError,
    InvalidName,
    MissingDependency,
    TopicExists,
    TopicNotFound,
)
from cassandra_ros.printable import shown
from cassandra_ros.shared_options import IMPORT_FORMAT

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.files.bag.importer import ImportReport


_OF_ONE_FILE = (
    BagError,
    CorruptMessage,
    DefinitionError,
    InvalidName,
    MissingDependency,
    TopicExists,
    TopicNotFound,
)
"""Errors that concern one file only, so that the next files are still imported."""


@dataclass
class _Outcome:
    """The result of the import of one file."""

    path: str
    state: str = "not tried"
    """'not tried', 'stored', 'salvaged', 'incomplete' or 'failed'."""
    report: ImportReport | None = None
    error: str = ""

    def succeed(self, report: ImportReport) -> None:
        """Note that the messages of the file are stored, as far as the report says."""
        self.report = report
        if report.lost or report.salvaged.lost_bytes:
            self.state = "incomplete"
        else:
            self.state = "salvaged" if report.salvaged.why else "stored"

    def fail(self, error: str = "") -> None:
        """Note that the file could not be stored whole; '' = the reason is not known yet."""
        self.state = "failed"
        self.error = error


_WHOLE = ("stored", "salvaged")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add bags, format, selection and the store."""
    add = parser.add_argument
    text = "bags of format 2.0, MCAP files of ROS 1, or folders of such (*.bag, *.mcap)"
    add("bags", nargs="+", metavar="FILE", help=text)
    text = "also import the files in subfolders of a folder (default: only those in the folder)"
    add("-r", "--recursive", action="store_true", help=text)
    add_option(parser, "format", IMPORT_FORMAT, None)
    add_topics_option(parser, "the FILEs")
    add(
        "--node-id",
        default="",
        metavar="N",
        help="robot that produced the messages (default: no name)",
    )
    add(
        "--salvage",
        action="store_true",
        help="if a bag or an MCAP is cut short, damaged or was never closed (.bag.active), store "
        "the messages before and after the damage, and describe it (default: refuse the file)",
    )
    add_large_chunks_option(parser)
    add("-q", "--quiet", action="store_true", help="print errors and warnings only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Import the bags one after the other; print the state of each at the end."""
    outcomes = [outcome for given in options.bags for outcome in _outcomes(given, options)]
    if all(outcome.state == "failed" for outcome in outcomes):
        _print_outcomes(outcomes, options)
        return 1
    with open_store(options, make=True) as ros_cas:
        foreign = foreign_keyspace(ros_cas)
        if foreign:
            hint = f"{foreign}; the topics are stored beside them"
            print(error_line("cassandra_bag", hint), file=sys.stderr)
        try:
            for outcome in outcomes:
                if outcome.state != "failed":
                    _try(ros_cas, outcome, options)
        except (KeyboardInterrupt, SystemExit):
            hint = "interrupted; the same command again completes the import"
            print(error_line("cassandra_bag", hint), file=sys.stderr)
            raise
        finally:
            _print_outcomes(outcomes, options)
    return 0 if all(outcome.state in _WHOLE for outcome in outcomes) else 1


def _outcomes(given: str, options: argparse.Namespace) -> list[_Outcome]:
    """Return the files of a FILE, or of a folder; print and note what cannot be read."""
    from cassandra_ros.files.bag.file_formats import files_of

    outcomes: list[_Outcome] = []

    def fail(path: str, why: str) -> None:
        outcomes.append(_Outcome(path))
        outcomes[-1].fail(why)
        print(error_line("cassandra_bag", why), file=sys.stderr)

    def unreadable(exc: OSError) -> None:
        fail(exc.filename, f"folder {exc.filename} cannot be read: {exc.strerror}")

    try:
        files = files_of(given, options.recursive, options.salvage, unreadable)
    except BagError as exc:
        fail(given, str(exc))
        return outcomes
    return outcomes + [_Outcome(path) for path in files]


def _try(ros_cas: RosCassandra, outcome: _Outcome, options: argparse.Namespace) -> None:
    """Import a bag; print and note an error that concerns this file only."""
    outcome.fail()
    try:
        outcome.succeed(_import(ros_cas, outcome.path, options))
    except CassandraRosError as exc:
        outcome.fail(str(exc))
        if not isinstance(exc, _OF_ONE_FILE):
            raise
        print(error_line("cassandra_bag", " ".join(outcome.error.split())), file=sys.stderr)


def _import(ros_cas: RosCassandra, path: str, options: argparse.Namespace) -> ImportReport:
    from cassandra_ros.files.bag.file_formats import open_file
    from cassandra_ros.files.bag.importer import import_bag
    from cassandra_ros.files.bag.message_file import connections_of_topics, topics_of

    with open_file(path, options.salvage, options.allow_large_chunks) as reader:
        topics = topics_among(options, topics_of(reader, None), path)
        chosen = connections_of_topics(reader, topics)
        count = sum(reader.counts[number] for number in chosen)
        total = reader.message_count
    begun = time.monotonic()
    name = os.path.basename(path)
    first, second = MessageBar(f"reading {name}", total), MessageBar(f"importing {name}", count)
    with first, second, SafeInterrupt(ros_cas.cassandra.outage) as stop:
        report = import_bag(
            ros_cas,
            path,
            format=options.format,
            topics=topics,
            nodeID=options.node_id,
            progress=stop.after(second.add),
            reading=stop.after(first.add),
            salvage=options.salvage,
            large_chunks=options.allow_large_chunks,
        )
    if not (options.quiet or options.json):
        _print_report(report, options.keyspace, time.monotonic() - begun)
    return report


def _print_report(report: ImportReport, keyspace: str, seconds: float) -> None:
    topics = sorted(report.topics.items())
    has_why = any(topic.why for _, topic in topics)  # not with --format
    rows = [
        (shown(name), str(topic.messages), format_bytes(topic.bytes), topic.format)
        + (topic.why,) * has_why
        for name, topic in topics
    ]
    if rows:
        header = ("topic", "messages", "size", "format") + ("why",) * has_why
        print(format_table(header, rows, right=("messages", "size")))
    what = f"{counted(report.messages, 'message')} of {counted(len(rows), 'topic')}"
    print(
        f"{shown(report.path)}: {what} {'is' if report.messages == 1 else 'are'} in keyspace "
        f"{keyspace} ({seconds:.1f} s)"
        + (f", with {counted(report.events, 'event')}" if report.events else "")
    )
    for note in report.notes:
        print(f"  {shown(note, None)}")


def _print_outcomes(outcomes: list[_Outcome], options: argparse.Namespace) -> None:
    """Print the outcome for each bag: as JSON, or as a table if there are several bags."""
    if options.json:
        print_json(
            {"keyspace": options.keyspace, "files": [_answer(outcome) for outcome in outcomes]}
        )
    elif len(outcomes) > 1 and not options.quiet:
        rows = [
            (
                shown(outcome.path),
                str(outcome.report.messages) if outcome.report else "-",
                _loss_text(outcome.report) if outcome.report else "-",
                outcome.state,
            )
            for outcome in outcomes
        ]
        header = ("file", "messages", "lost", "state")
        if not options.node_id:
            print(
                "\nno robot was named: 'cassandra_bag runs set FILE.bag|FOLDER --node-id NAME' "
                "names that of these messages, 'import --node-id NAME' that of the next ones"
            )
        print("\n" + format_table(header, rows, right=("messages", "lost")))


def _loss_text(report: ImportReport) -> str:
    size = report.salvaged.lost_bytes
    return format_bytes(size) if size else str(sum(report.lost.values()))


def _answer(outcome: _Outcome) -> dict[str, object]:
    answer: dict[str, object] = {"path": outcome.path, "state": outcome.state}
    report = outcome.report
    if report is not None:
        answer.update(
            run=report.writer_id,
            messages=report.messages,
            events=report.events,
            topics=report.topics,
            lost=report.lost,
            lost_bytes=report.salvaged.lost_bytes,
            warnings=report.warnings,
            notes=report.notes,
        )
    return {**answer, "error": outcome.error or None}
