# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write topics as Parquet files, for DuckDB, Spark, pandas and polars.

  cassandra_bag lake ~/lake
  cassandra_bag lake ~/lake --topics /imu/data /fix
  cassandra_bag lake ~/lake --verify

There is one file for each topic, day (UTC) and robot: lake/imu%2Fdata/day=2020-09-13/robot=r1/
messages.parquet. Its columns are those of SQL (doc/sql.md): KEY, NODE, RUN and the fields, messages
as structs. A second run writes only the files whose messages have changed; each takes the place of
the old one when it is complete. Files of messages that the store deleted are kept.

--verify compares the files with the store instead: numbers of messages, and a digest of all values
(needs DuckDB). A file whose messages were deleted differs. The exit status is 1 if any file does.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.cli.topic_options import add_topics_option, stored_topics
from cassandra_ros.printable import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder, the topics, and the store."""
    add = parser.add_argument
    add("folder", metavar="DIR", help="the folder to write; it is made if it is missing")
    add_topics_option(parser, "DIR")
    add("--verify", action="store_true", help="compare the files with the store")
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Write or compare the files, and print what was done."""
    from cassandra_ros.client.sql.lake import Lake

    quiet = options.quiet or options.json

    def progress(path: str, count: int) -> None:
        if not quiet:
            print(f"{shown(path, None)}: {counted(count, 'message')}")

    with open_store(options) as ros_cas:
        lake = Lake(ros_cas.catalog, options.folder, stored_topics(ros_cas.catalog, options))
        report = lake.verify(progress) if options.verify else lake.write(progress)
    if options.json:
        print_json(report)
        return 1 if report.differences else 0
    for difference in report.differences:
        print(shown(difference, None))
    if not quiet:
        done = "compared" if options.verify else "written"
        rest = "" if options.verify else f", {report.unchanged} unchanged"
        print(f"{counted(report.files, 'file')} {done}{rest}")
    return 1 if report.differences else 0
