# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""DuckDB 1, which Pythons before 3.11 have, made to read and answer as DuckDB 2 does.

It reads an object with Arrow's C stream interface only once, so it gets a dataset of pyarrow that
reads it anew for each table in the plan. It would push conditions into that, where pyarrow compares
NaN unlike DuckDB, and a LIMIT above keeps them out. It runs a statement with parameters at once,
before anybody asks for a row, and in memory that it does not count: here a statement is described
first, and runs when its rows are asked for.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Sequence

from cassandra_ros.installation import optional_module
from cassandra_ros.query.arrays.arrow_types import load_arrow

if TYPE_CHECKING:
    import pyarrow

SETTINGS = ("SET disabled_optimizers = 'join_filter_pushdown, build_side_probe_side'",)
"""The first pushes the range of a join's keys into what it scans, through the LIMIT. The second
exchanges the sides of a join by their numbers of rows, which are unknown; a SEMI JOIN by = and <
then has other rows."""
_ADVICE = {
    r"avg\(INTERVAL\)": "it has no mean of intervals; take that of epoch_us(…), in microseconds",
    "Circular reference to CTE": "WITH hides no topic that it reads: give the table another name",
    "Function with name try ": "there a division by zero is NULL without TRY",
    r"syntax error.*\n.*\blambda\b": "write lambda r: r + 1 as r -> r + 1",
}
"""What to do about errors, by what is found in the error and the statement."""
_ALL_ROWS = 2**63 - 1
_LINE = re.compile(r"^LINE (\d+)(?=: )", re.MULTILINE)


def advice(reason: str, statement: str) -> str:
    """Return what to do about an error that DuckDB 2 would not have; '' = DuckDB 2 has it, too."""
    both = f"{reason}\n{statement}"
    texts = (text for pattern, text in _ADVICE.items() if re.search(pattern, both, re.DOTALL))
    return next((f" (this Python has DuckDB 1: {text})" for text in texts), "")


def add_table(connection: Any, name: str, source: Any) -> None:
    """Give DuckDB a source as a table.

    Args:
        connection: DuckDB's connection.
        name: Name of the table.
        source: An object with Arrow's C stream interface, which is read for each scan.
    """
    connection.from_arrow(_dataset(source)).limit(_ALL_ROWS).create_view(name)


def _dataset(source: Any) -> Any:
    arrow = load_arrow("sql")

    class Dataset(optional_module("pyarrow.dataset", "sql").Dataset):  # type: ignore[misc]
        """What DuckDB takes for a dataset of pyarrow; it calls nothing else of it."""

        schema = arrow.schema(source)

        def __init__(self) -> None:
            """Without that of the class above, which no class may call."""

        def scanner(self, columns: Sequence[str] | None = None) -> _Scanner:
            return _Scanner(arrow, source, columns)

    return Dataset()


class _Scanner:
    """A scan of some columns of a source; None = of all."""

    def __init__(self, arrow: Any, source: Any, columns: Sequence[str] | None) -> None:
        self._arrow = arrow
        self._source = source
        self._columns = columns

    def to_reader(self) -> pyarrow.RecordBatchReader:
        reader = self._arrow.RecordBatchReader.from_stream(self._source)
        columns = reader.schema.names if self._columns is None else self._columns
        schema = self._arrow.schema([reader.schema.field(name) for name in columns])
        batches = (batch.select(columns) for batch in reader)
        return self._arrow.RecordBatchReader.from_batches(schema, batches)


class Select:
    """A statement, with those methods of DuckDB's relations that are used.

    Args:
        connection: DuckDB's connection.
        text: The statement.
        params: Values of its parameters.

    Attributes:
        columns: Names of the columns.
    """

    def __init__(self, connection: Any, text: str, params: Any) -> None:
        self._connection = connection
        self._text = text
        self._params = params or None
        self.columns = [row[0] for row in self._rows_of("DESCRIBE")]

    def _rows_of(self, word: str) -> Any:
        """Return what DuckDB says after a word, which stands on a line before the statement."""
        try:
            return self._connection.execute(f"{word}\n{self._text}", self._params).fetchall()
        except optional_module("duckdb", "sql").Error as exc:
            # Without the line of the word, so that the error points into the statement.
            text = _LINE.sub(lambda line: f"LINE {int(line[1]) - 1}", str(exc))
            raise type(exc)(text) from exc

    def _execute(self) -> Any:
        return self._connection.execute(self._text, self._params)

    def explain(self) -> Any:
        """Return the plan, as DuckDB draws it."""
        return self._rows_of("EXPLAIN")[-1][1]

    def to_arrow_reader(self, rows: int) -> Any:
        """Run the statement; return a pyarrow.RecordBatchReader, each batch with so many rows."""
        return self._execute().fetch_record_batch(rows)

    def to_arrow_table(self) -> Any:
        """Run the statement; return its rows as a pyarrow.Table."""
        return self._execute().fetch_arrow_table()

    def df(self) -> Any:
        """Run the statement; return its rows as a pandas.DataFrame."""
        return self._execute().df()
