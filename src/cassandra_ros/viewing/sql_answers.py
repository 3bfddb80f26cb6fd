# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Answers to statements in SQL: rows, explanation and plots.

The routes of ask_routes.py give them for ``language=sql``. DuckDB has memory of its own for each
statement, so few run at the same time; the others wait.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import Any, Callable, Iterator, Sequence

import numpy as np

from cassandra_ros.arrays.arrow_types import load_arrow
from cassandra_ros.errors import AnswerTooLarge, InvalidOption
from cassandra_ros.query.tree.json_values import to_json
from cassandra_ros.sql.python_values import printable_value, python_rows
from cassandra_ros.sql.sql_result import SqlResult
from cassandra_ros.sql.sql_series import (
    SqlSeries,
    is_time_type,
    read_sql_series,
    time_column,
    times_of,
)
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.lossless_json import Cells
from cassandra_ros.viewing.selection_parameters import whose_of
from cassandra_ros.viewing.viewer_settings import ViewerSettings

AT_ONCE = 2
"""Maximum number of SQL statements that run at the same time."""
_TURN_SEC = 0.1
"""Interval at which a waiting statement looks whether its client is still connected, s."""


def _turns(settings: ViewerSettings) -> threading.BoundedSemaphore:
    return threading.BoundedSemaphore(AT_ONCE)


@contextmanager
def _prepared(call: ApiCall, watch: Callable[[], None]) -> Iterator[SqlResult]:
    """Yield the statement of a call when it is its turn."""
    turns = call.cached_by_viewer(_turns)
    while not turns.acquire(timeout=_TURN_SEC):
        watch()
    try:
        yield SqlResult(call.catalog, call.text("q") or "", (), whose_of(call), watch=watch)
    finally:
        turns.release()


def sql_rows(call: ApiCall, limit: int, page_bytes: int, watch: Callable[[], None]) -> Json:
    """Answer with the first rows of a statement; of those with a time, the rows from start to end.

    ``more`` says whether there are further rows. There is no cursor: rows have no order but that of
    the statement, which would run anew.
    """
    if call.text("after"):
        raise InvalidOption("after: the rows of a statement in SQL come as one page; see limit")
    cells = Cells(call.count("cut"))
    rows: list[Json] = []
    times: list[Json] = []
    kinds: list[Json] = []
    more = False
    with _prepared(call, watch) as result:
        for batch, at in _windowed(result, call.time_ns("start"), call.time_ns("end")):
            kinds = [_kind(field.type) for field in batch.schema]
            more = _add_rows(cells, rows, zip(_rows_of(batch), at), times, (limit, page_bytes))
            if more:
                break
        columns: list[Json] = list(result.columns)
    page: dict[str, Json] = {"topic": "", "columns": columns, "kinds": kinds, "rows": rows}
    return {**page, "times": times, "after": "", "more": more, "hints": list(result.hints)}


def _add_rows(
    cells: Cells,
    rows: list[Json],
    found: Iterator[tuple[Sequence[object], Json]],
    times: list[Json],
    most: tuple[int, int],
) -> bool:
    """Add rows up to a number and a size in bytes; return whether rows were left out."""
    for row, time in found:
        if len(rows) >= most[0] or (rows and cells.size >= most[1]):
            return True
        try:
            rows.append([cells.shown(value) for value in row])
        except AnswerTooLarge:
            if rows:
                return True
            raise
        times.append(time)
    return False


def _windowed(
    result: SqlResult, low: int | None, high: int | None
) -> Iterator[tuple[Any, list[Json]]]:
    """Yield batches of the rows in a time range, and the time of each row, ns."""
    for batch in result.batches():
        place = time_column(batch.schema)
        if place is None:
            yield batch, [None] * batch.num_rows
            continue
        times = times_of(batch.column(place))
        if low is not None or high is not None:
            inside = (times >= (low or 0)) & (times <= (2**63 - 1 if high is None else high))
            chosen = np.flatnonzero(inside)
            batch, times = batch.take(chosen), times[chosen]
        yield batch, [None if t < 0 else str(t) for t in times.tolist()]


def _rows_of(batch: Any) -> Iterator[Sequence[object]]:
    for row in python_rows(load_arrow("sql"), batch):
        yield [_plain(value) for value in row]


def _plain(value: Any) -> object:
    """Return a value as Cells takes it: a message is JSON text, a time outside of ROS ns."""
    if isinstance(value, dict):
        return to_json(printable_value(value))
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, np.datetime64):
        return str(int(value.astype("M8[ns]").astype(np.int64)))
    return printable_value(value)


def _kind(kind: Any) -> str:
    """Return the type of a column as ROS calls it, where it has such a type."""
    text = str(kind)
    if text.startswith("list<"):
        return _kind(kind.value_type) + "[]"
    if is_time_type(kind):
        return "time"
    if text == "month_day_nano_interval":
        return "duration"
    if text.startswith("decimal"):
        return "int" if kind.scale == 0 else "float64"
    return {"float": "float32", "double": "float64"}.get(text, text.partition("<")[0])


def sql_plan(call: ApiCall, watch: Callable[[], None]) -> Json:
    """Answer with what a statement read, and DuckDB's plan; it is run to its end."""
    with _prepared(call, watch) as result:
        return {"text": str(result.explain())}


def sql_plot(
    call: ApiCall, window: tuple[int | None, int | None], pixels: int, watch: Callable[[], None]
) -> SqlSeries:
    """Return the numbers of a statement over time."""
    with _prepared(call, watch) as result:
        return read_sql_series(result, *window, pixels)
