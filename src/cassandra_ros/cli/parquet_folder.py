# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A folder of Parquet files: export writes it, and verify compares it with the store."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import print_json
from cassandra_ros.cli.options import open_store
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.cli.topic_options import stored_topics
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.client.sql.lake import LakeReport

_REFUSED = ["start", "end", "event", "before", "after", "node_id", "run", "where", "stores"]
_REFUSED += ["latched", "compression", "force", "content", "map", "salvage", "allow_large_chunks"]
_REFUSED += ["repair", "target"]
"""Options of the verbs, by their ``dest``, that files of whole topics cannot follow."""


def write_folder(options: argparse.Namespace, folder: str) -> int:
    """Write the files of the topics that the options select; return the exit status."""
    return _write_or_compare(options, folder, compares=False)


def compare_folder(options: argparse.Namespace, folder: str) -> int:
    """Compare the files with the store; return the exit status: 1 = a file differs."""
    return _write_or_compare(options, folder, compares=True)


def _write_or_compare(options: argparse.Namespace, folder: str, compares: bool) -> int:
    from cassandra_ros.client.sql.lake import Lake

    options.parser.refuse_options(
        options, _REFUSED, "--parquet takes whole topics: it goes without {}"
    )
    quiet = options.quiet or options.json

    def progress(path: str, count: int) -> None:
        if not quiet:
            print(f"{shown(path, None)}: {counted(count, 'message')}")

    with open_store(options) as ros_cas:
        lake = Lake(ros_cas.catalog, folder, stored_topics(ros_cas.catalog, options))
        report = lake.verify(progress) if compares else lake.write(progress)
    if options.json:
        print_json(report)
    else:
        _print(report, compares, quiet)
    return 1 if report.differences else 0


def _print(report: LakeReport, compares: bool, quiet: bool) -> None:
    for difference in report.differences:
        print(shown(difference, None))
    if not quiet:
        done = "compared" if compares else f"written, {report.unchanged} unchanged"
        print(f"{counted(report.files, 'file')} {done}")
