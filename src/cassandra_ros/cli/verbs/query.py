# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Query stored topics: print the rows that a statement of the query language returns.

  cassandra_bag query "SELECT KEY, linear.x FROM /cmd_vel WHERE linear.x > ?" 0.5
  cassandra_bag query "SELECT count(*) FROM /tf WHERE transforms.child_frame_id = 'base_link'"
  cassandra_bag query "SELECT * FROM /imu" -O imu.parquet

Give the values for ? after the statement: a number, true, false, a list ([1, 2]), or a
text. Put a text that looks like a number in double quotes ('"42"'). Quote the statement, or the
shell replaces * and ? by file names.

Formats, all written while the rows are read; the name of the file of -O, as x.csv, chooses one:
  table    aligned, for people: times in UTC, long values cut
  csv      RFC 4180: times in integer ns, bytes in base64, arrays as JSON; a missing value is an
           empty field, an empty text is ""
  json     a list of objects; ndjson, .jsonl: one object per line. Times and bytes as in csv; NaN
           and infinities, which JSON lacks, are null
  parquet  to a file (-O): types are kept, times are timestamps in ns (needs pyarrow)

DELETE, TRUNCATE, CREATE INDEX and DROP INDEX need --allow-writes.

With --store, given once or several times, the statement is answered over all these stores as one.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, Sequence

from cassandra_ros.cli.fleet_options import (
    add_fleet_options,
    open_fleet,
    refuse_single_store_options,
    tell_missing,
)
from cassandra_ros.cli.json_answer import print_json
from cassandra_ros.cli.options import add_origin_options, add_store_options, open_store
from cassandra_ros.errors import InvalidExpression, InvalidOption
from cassandra_ros.printable import shown_lines

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra

_OUTPUTS = ("table", "csv", "json", "ndjson", "parquet")
_ENDINGS = {**{f".{name}": name for name in _OUTPUTS[1:]}, ".jsonl": "ndjson"}
"""Output format by the end of the file's name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the statement, its values, the form of the output and the store."""
    text = "print how the statement was executed instead: what the store checked, what was read"
    add_statement_arguments(parser, text)
    text = "allow statements that change stored data"
    parser.add_argument("--allow-writes", action="store_true", help=text)
    add_store_options(parser)
    add_fleet_options(parser)


def add_statement_arguments(parser: argparse.ArgumentParser, explain: str) -> None:
    """Add the statement, its values, the form of the output, and --explain with its help text."""
    add = parser.add_argument
    add("statement", metavar="STATEMENT", help="the statement, in quotes")
    add(
        "params",
        metavar="VALUE",
        nargs="*",
        help="a value for each ? of the statement (default: none)",
    )
    endings = ", ".join(_ENDINGS)
    text = f"output format (default: that of FILE's ending, {endings}, else table)"
    add("--output", choices=_OUTPUTS, help=text)
    add(
        "--json",
        dest="output",
        action="store_const",
        const="json",
        help="the same as --output json",
    )
    add("-O", "--output-file", metavar="FILE", help="write to FILE (default: standard output)")
    add("-f", "--force", action="store_true", help="replace FILE if it exists")
    add(
        "-l",
        "--limit",
        metavar="NUM",
        type=_count,
        help="maximum number of rows to print (default: all)",
    )
    add_origin_options(parser)
    add("--explain", action="store_true", help=explain)


def _count(text: str) -> int:
    """Read a number of rows, at least 1; raises InvalidOption."""
    if not (text.isascii() and text.isdigit() and int(text)):
        raise InvalidOption(f"{text!r} is not a number of rows: at least 1")
    return int(text)


def run(options: argparse.Namespace) -> int:
    """Run the statement, and write its rows."""
    check_outputs(options)
    params = [read_parameter(text) for text in options.params]
    if options.stores:
        return _answer_of_fleet(options, params)
    with open_store(options) as ros_cas:
        if options.explain:
            selection = {"nodeID": options.node_id, "run": options.run}
            explanation = ros_cas.explainCQL(options.statement, params, **selection)
            if options.output == "json":
                print_json(explanation)
            else:
                print(shown_lines(str(explanation)))
        else:
            _answer(ros_cas, options, params)
    return 0


def quoted(options: argparse.Namespace, statements: Sequence[str], others: int = 0) -> None:
    """End the program if a statement is one word: the shell has taken it apart, without quotes.

    A single word with no others is left to the parser of the language, which tells what is missing.

    Args:
        options: The parsed options, with their parser.
        statements: The statements.
        others: Number of further words that are not options.
    """
    if len(statements) + others > 1 and not all(
        len(statement.split()) > 1 for statement in statements
    ):
        options.parser.error("put the statement in quotes: without them the shell takes it apart")


def check_outputs(options: argparse.Namespace) -> None:
    """Check the statement's quotes and the options of the output; set the format if it is missing.

    The program ends if they contradict. sql and query call it before they open the store.

    Raises:
        MissingDependency: The output is Parquet, and pyarrow is not installed.
    """
    from cassandra_ros.cli.results import load_parquet

    quoted(options, [options.statement], len(options.params))
    ending = os.path.splitext(options.output_file or "")[1].lower()
    options.output = options.output or _ENDINGS.get(ending, "table")
    if options.explain and (options.output_file or options.limit):
        options.parser.error("--explain goes without --limit and --output-file")
    if options.output == "parquet" and not (options.output_file or options.explain):
        options.parser.error("--output parquet needs a file: -O FILE")
    if options.output == "parquet":
        load_parquet()  # fail before the statement is run


def read_parameter(text: str) -> object:
    """Return the value of a parameter: what it means as JSON, else the text."""
    from cassandra_ros.query.tree.json_values import from_json

    try:
        return from_json(text)
    except InvalidExpression:
        return text


def _answer_of_fleet(options: argparse.Namespace, params: Sequence[object]) -> int:
    """Run a SELECT over several stores, and write its rows; return the exit status."""
    from cassandra_ros.cli.results import write
    from cassandra_ros.query.arrays.array_types import ArrayType

    single_store_options = {
        "--explain": options.explain,
        "--allow-writes": options.allow_writes,
        "--output parquet": options.output == "parquet",
    }
    refuse_single_store_options(options, single_store_options)
    selection = {"nodeID": options.node_id, "run": options.run, "limit": options.limit}
    with open_fleet(options) as fleet:
        result = fleet.iterCQL(options.statement, params, **selection)
        kinds = [(name, ArrayType("mixed")) for name in result.columns]
        write(kinds, result, options.output, options.output_file, options.force)
    return tell_missing(result.missing)


def _answer(ros_cas: RosCassandra, options: argparse.Namespace, params: Sequence[object]) -> None:
    """Run a statement of any kind, and write its rows, if its kind has any."""
    from cassandra_ros.cli.results import write
    from cassandra_ros.query.arrays.array_types import ArrayType, column_types
    from cassandra_ros.query.tree.parse import parse_statement
    from cassandra_ros.query.tree.syntax import Select

    statement = parse_statement(options.statement, params)
    node, run, limit = options.node_id, options.run, options.limit
    target = (options.output, options.output_file, options.force)
    if isinstance(statement, Select):
        with ros_cas.statements.select(statement, node=node, limit=limit, run=run) as result:
            kinds = [(name, ArrayType("mixed")) for name in result.columns]
            if options.output == "parquet":
                kinds = column_types(statement, ros_cas.getTopic(statement.topic).tables)
            write(kinds, result, *target)
        return
    if not options.allow_writes:
        raise InvalidOption("the statement changes what is stored; to run it, add --allow-writes")
    rows = ros_cas.statements.run(statement, node=node, limit=limit, run=run)
    if rows.columns:
        write([(name, ArrayType("int64")) for name in rows.columns], rows, *target)
