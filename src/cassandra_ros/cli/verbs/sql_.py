# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask SQL over any topics: join them by time, group them, and print the rows.

  cassandra_bag sql 'SELECT NODE, avg(voltage) FROM battery GROUP BY NODE'
  cassandra_bag sql 'SELECT i.KEY, b.voltage FROM "/imu/data" i
      ASOF JOIN battery b ON i.NODE = b.NODE AND i.KEY >= b.KEY
      WHERE i.linear_acceleration.z > ?' 15 -O bumps.parquet
  cassandra_bag sql 'SELECT * FROM runs' --explain

The SQL is DuckDB's (requirements/tables.txt; Python 3.11 or later). A topic is a table, with the
columns KEY, NODE, RUN, EVENT and the fields of its messages. Further tables are topics, runs,
losses, events, constants and tf('map', 'base_link'). Put names with slashes in double quotes, and
the statement in single ones. Values for ? and the outputs are as in 'cassandra_bag query'; there
messages in a cell are JSON objects, in Parquet structs.

The statement only reads; to delete messages or to make an index, use 'cassandra_bag query'.
"""

from __future__ import annotations

import argparse
from itertools import islice
from typing import TYPE_CHECKING, Iterator

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.verbs.query import add_statement_arguments, check_outputs, read_parameter
from cassandra_ros.printable import shown_lines

if TYPE_CHECKING:
    import pyarrow

    from cassandra_ros.client.sql.sql_result import SqlResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the statement, its values, the form of the output and the store."""
    text = "run the statement, and print what was read and DuckDB's plan instead of its rows"
    add_statement_arguments(parser, text)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run the statement, and write its rows."""
    from cassandra_ros.cli.results import write, write_batches
    from cassandra_ros.client.sql.python_values import printable_value
    from cassandra_ros.query.arrays.array_types import ArrayType

    check_outputs(options)
    params = [read_parameter(text) for text in options.params]
    with open_store(options) as ros_cas:
        selection = {"nodeID": options.node_id, "run": options.run}
        result = ros_cas.sql(options.statement, params, **selection)
        if options.explain:
            print(shown_lines(str(result.explain())))
            return 0
        target = (options.output_file, options.force)
        if options.output == "parquet":
            write_batches(_limit_batches(result, options.limit), *target)
            return 0
        columns = [(name, ArrayType("mixed")) for name in result.columns]
        rows = (tuple(map(printable_value, row)) for row in islice(result, options.limit))
        write(columns, rows, options.output, *target)
    return 0


def _limit_batches(result: SqlResult, limit: int | None) -> Iterator[pyarrow.RecordBatch]:
    """Yield the batches of a result, at least one, with at most ``limit`` rows; None = all."""
    remaining = limit
    for batch in result.batches():
        yield batch if remaining is None else batch.slice(0, remaining)
        if remaining is not None:
            remaining -= batch.num_rows
            if remaining <= 0:
                return
