# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Answers to statements in SQL: rows, explanation and plots.

The routes of ask_routes.py give them for ``language=sql``. Each statement runs in a process of its
own, few at the same time.
"""

from __future__ import annotations

from typing import Any, ContextManager, Iterator, Sequence

import numpy as np

from cassandra_ros.client.sql.python_values import printable_value, python_rows
from cassandra_ros.client.sql.sql_series import (
    SqlSeries,
    is_time_type,
    read_sql_series,
    time_column,
    times_of,
)
from cassandra_ros.client.sql.statement_processes import SqlAnswer, Statement
from cassandra_ros.errors import AnswerTooLarge, InvalidOption
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.tree.json_values import to_json
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import ApiCall, whose_of
from cassandra_ros.viewing.lossless_json import JsonConverter


def _open_answer(call: ApiCall, plan: bool = False) -> ContextManager[SqlAnswer]:
    """Return the answer to the statement of a call; on entering it waits for its turn."""
    keyspace = call.catalog.keyspace.name
    statement = Statement(keyspace, call.text("q") or "", whose_of(call), plan=plan)
    return call.statements.answer(statement, call.watch)


def sql_rows(call: ApiCall, limit: int, page_bytes: int) -> Json:
    """Answer with the first rows of a statement; of those with a time, the rows from start to end.

    ``more`` says whether there are further rows. There is no cursor: rows have no order but that of
    the statement, which would run anew.
    """
    if call.text("after"):
        raise InvalidOption("after: the rows of a statement in SQL come as one page; see limit")
    cells = JsonConverter(call.count("cut"))
    rows: list[Json] = []
    times: list[Json] = []
    kinds: list[Json] = []
    more = False
    with _open_answer(call) as answer:
        for batch, at in _batches_within(answer, call.time_ns("start"), call.time_ns("end")):
            kinds = [_kind(field.type) for field in batch.schema]
            more = _add_rows(cells, rows, zip(_rows_of(batch), at), times, (limit, page_bytes))
            if more:
                break
        columns: list[Json] = list(answer.columns)
    page: dict[str, Json] = {"topic": "", "columns": columns, "kinds": kinds, "rows": rows}
    return {**page, "times": times, "after": "", "more": more, "hints": list(answer.hints)}


def _add_rows(
    cells: JsonConverter,
    rows: list[Json],
    rows_and_times: Iterator[tuple[Sequence[object], Json]],
    times: list[Json],
    most: tuple[int, int],
) -> bool:
    """Add rows up to a number and a size in bytes; return whether rows were left out."""
    for row, time in rows_and_times:
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


def _batches_within(
    answer: SqlAnswer, low: int | None, high: int | None
) -> Iterator[tuple[Any, list[Json]]]:
    """Yield batches of the rows in a time range, and the time of each row, ns."""
    for batch in answer.batches():
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
    """Return a value for a JsonConverter: a message is JSON text, a time outside of ROS ns."""
    if isinstance(value, dict):
        return to_json(printable_value(value))
    if isinstance(value, list):
        return [_plain(element) for element in value]
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


def sql_plan(call: ApiCall) -> Json:
    """Answer with what a statement read, and DuckDB's plan; it is run to its end."""
    with _open_answer(call, plan=True) as answer:
        return {"text": answer.explanation()}


def sql_plot(call: ApiCall, window: tuple[int | None, int | None], pixels: int) -> SqlSeries:
    """Return the numbers of a statement over time."""
    with _open_answer(call) as answer:
        return read_sql_series(answer.batches(), *window, pixels)
