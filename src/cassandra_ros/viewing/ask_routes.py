# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes for statements: rows, explanation, completion and plots."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Iterable, Sequence

from cassandra_ros.client.sql.sql_completion import complete_sql
from cassandra_ros.errors import AnswerTooLarge, InvalidOption, TopicNotFound
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.arrays.array_types import column_types
from cassandra_ros.query.arrays.envelope import Grid, Points
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.result_groups import analyse_select
from cassandra_ros.query.tree.parse import parse_select
from cassandra_ros.query.tree.statement_completion import MAX_OFFERS, NameSource, complete
from cassandra_ros.query.tree.syntax import (
    All,
    Compare,
    Expression,
    KeyOperand,
    Literal,
    NodeOperand,
    OneOf,
    Select,
    TimeNs,
)
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.envelopes import EnvelopeCache
from cassandra_ros.topics.overview.plot_series import MOST_PIXELS, PIXELS, PlotWindow, Series
from cassandra_ros.topics.query_result import QueryResult
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import NODES, RUNS, WHOLE_RANGE, ApiCall, whose_of
from cassandra_ros.viewing.catalog_routes import limit_parameter, listed_at_most
from cassandra_ros.viewing.lossless_json import JsonConverter
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.sql_answers import sql_plan, sql_plot, sql_rows
from cassandra_ros.viewing.viewer_settings import ViewerSettings

ANSWER_PAGE_ROWS = 200
"""Default number of rows of a page."""
MAX_ANSWER_PAGE_ROWS = 10_000
"""Maximum number of rows of a page."""
ANSWER_PAGE_BYTES = 8 * 1024 * 1024
"""Approximate size of the values of a page at which it ends, bytes."""
BUDGET_SEC = 0.6
"""Default time after which an incomplete plot is answered, s."""
LANGUAGES = ("cql", "sql")
"""Languages of statements: our query language, and DuckDB's SQL over all topics."""


def is_sql(call: ApiCall) -> bool:
    """Return whether a statement is in SQL; raises InvalidOption for another language."""
    language = call.text("language")
    if language not in LANGUAGES:
        raise InvalidOption(f"language {language!r}: give one of {', '.join(LANGUAGES)}")
    return language == "sql"


def one_node(call: ApiCall) -> str | None:
    """Return the robot of the parameter nodes; None if none or several are given."""
    given = call.texts("nodes") or ()
    return given[0] if len(given) == 1 else None


def statement_of(call: ApiCall) -> Select:
    """Return the statement, restricted to the robots if several are given."""
    select, given = parse_select(call.text("q") or ""), call.texts("nodes") or ()
    if len(given) < 2:
        return select
    return _narrow(select, [OneOf(NodeOperand(0), tuple(Literal(text, 0) for text in given))])


def _narrow(select: Select, terms: Sequence[Expression]) -> Select:
    conditions = (*terms, *(() if select.condition is None else (select.condition,)))
    return replace(select, condition=All(conditions)) if terms else select


def _query(call: ApiCall) -> Json:
    """Answer with a page of a statement's rows."""
    limit = min(call.count("limit") or ANSWER_PAGE_ROWS, MAX_ANSWER_PAGE_ROWS)
    if is_sql(call):
        return sql_rows(call, limit, ANSWER_PAGE_BYTES)
    select = statement_of(call)
    tables = call.store.statements.topic_of(select).tables
    result = call.store.statements.select(
        windowed(call, select, tables),
        node=one_node(call),
        run=whose_of(call).writers,
        after=call.text("after"),
        watch=call.watch,
    )
    with result:
        return page_of(call, result, tables, limit)


def windowed(call: ApiCall, select: Select, tables: Sequence[Table]) -> Select:
    """Return a statement restricted to start and end; groups are not restricted."""
    low, high = call.time_ns("start"), call.time_ns("end")
    if analyse_select(select, tables).gathers or any(table.named for table in tables):
        return select
    ends = {">=": low, "<=": high}
    terms: list[Expression] = [
        Compare(KeyOperand(0), operator, Literal(TimeNs(ns), 0))
        for operator, ns in ends.items()
        if ns is not None
    ]
    return _narrow(select, terms)


def page_of(
    call: ApiCall, result: QueryResult, tables: Sequence[Table], limit: int
) -> dict[str, Json]:
    """Return the next rows of a statement as JSON, up to a number and ANSWER_PAGE_BYTES."""
    cells = JsonConverter(call.count("cut"))
    rows: list[Json] = []
    times: list[Json] = []
    cursor = ""
    for row in result:
        try:
            rows.append([cells.shown(value) for value in row])
        except AnswerTooLarge:
            if rows:
                break  # the next page begins with this row
            raise
        at = result.position
        times.append(cells.time_in(row) if at is None else str(at.t))
        cursor = result.cursor
        if len(rows) >= limit or cells.size >= ANSWER_PAGE_BYTES:
            break
    else:
        cursor = ""
    return {
        "topic": result.select.topic,
        "columns": list(result.columns),
        "kinds": _kinds(result, tables),
        "rows": rows,
        "times": times,
        "after": cursor,
        "more": bool(cursor),
        "read": result.read,
        "hints": list(result.hints),
    }


def _kinds(result: QueryResult, tables: Sequence[Table]) -> Json:
    """Return the type of each column: a type of ROS, with [] for each level of arrays."""
    kinds = column_types(result.select, tables)
    return ["int" if kind.kind == "sum" else kind.kind + "[]" * kind.depth for _, kind in kinds]


def _explain(call: ApiCall) -> Json:
    """Run a statement to its end and answer how it was run."""
    if is_sql(call):
        return sql_plan(call)
    plan = call.store.statements.explain(
        statement_of(call), node=one_node(call), run=whose_of(call).writers, watch=call.watch
    )
    return {"text": str(plan), **vars(plan)}


def _complete(call: ApiCall) -> Json:
    """Answer with the completions at a position of a statement."""
    store = call.store

    def definitions(topic: str) -> Sequence[Definition]:
        try:
            tables = store.getTopic(topic).tables
        except TopicNotFound:
            return ()
        return [table.definition for table in tables if table.definition is not None]

    def topics() -> Sequence[str]:
        return [topic.name for topic in store.getAllTopics()]

    names = NameSource(
        topics,
        definitions,
        lambda: sorted({info.node for info in store.info() if info.node and info.count}),
        lambda: list(dict.fromkeys(run.name for run in store.runs() if run.name)),
    )
    return completed(call, names)


def completed(call: ApiCall, names: NameSource) -> dict[str, Json]:
    """Return the completions as JSON, of names that a source has."""
    text, cursor = call.text("q") or "", call.count("at")
    at = len(text) if cursor is None else cursor
    most = listed_at_most(call)
    if is_sql(call):
        completion = complete_sql(text, at, names.topics(), names.definitions, most)
    else:
        completion = complete(text, at, names, most)
    offers: Json = [
        {"text": offer.text, "kind": offer.kind, "note": offer.note} for offer in completion.offers
    ]
    return {"start": completion.start, "offers": offers, "more": completion.more}


def _cache(catalog: Catalog, settings: ViewerSettings) -> EnvelopeCache:
    return EnvelopeCache()


def _plot(call: ApiCall) -> Json:
    """Answer with the minimum and the maximum of each pixel."""
    window = window_of(call)
    if is_sql(call):
        drawn = sql_plot(call, (window.low, window.high), window.pixels)
        lines = _lines([(name, "") for name in drawn.columns], drawn.points)
        return _picture("", lines, drawn.left_out, drawn.grid, drawn.points)
    series = call.store.statements.series(
        statement_of(call),
        window=window,
        node=one_node(call),
        run=whose_of(call).writers,
        cache=call.cached(_cache),
        watch=call.watch,
    )
    return shown_series(series)


def window_of(call: ApiCall) -> PlotWindow:
    """Return the time range, the pixels and the time limit of a plot."""
    pixels = call.count("pixels") or PIXELS
    if pixels > MOST_PIXELS:
        raise InvalidOption(f"pixels {pixels}: at most {MOST_PIXELS}")
    seconds = call.number("seconds")
    low, high = call.time_ns("start"), call.time_ns("end")
    if low is not None and high is not None and low > high:
        raise InvalidOption("start lies after end")
    return PlotWindow(low, high, pixels, BUDGET_SEC if seconds is None else max(0.0, seconds))


def shown_series(series: Series) -> dict[str, Json]:
    """Return a plot as JSON."""
    lines = _lines([(column.name, column.unit) for column in series.columns], series.points)
    picture = _picture(series.topic, lines, series.left_out, series.grid, series.points)
    progress: dict[str, Json] = {"breaks": series.breaks.tolist(), "complete": series.complete}
    return {
        **picture,
        **progress,
        "share": series.share,
        "edges": series.edges,
        "how": _how(series),
    }


def _picture(
    topic: str,
    lines: Sequence[Json],
    left_out: Iterable[tuple[str, str]],
    grid: Grid,
    points: Points,
) -> dict[str, Json]:
    """Return a plot that is complete."""
    omitted: list[Json] = [{"name": name, "reason": reason} for name, reason in left_out]
    return {
        "topic": topic,
        "times": [str(t) for t in points.times.tolist()],
        "rows": points.rows.tolist(),
        "columns": lines,
        "breaks": points.breaks.tolist(),
        "left_out": omitted,
        "start": str(grid.low),
        "end": str(grid.high),
        "pixel": str(grid.width),
        "complete": True,
        "share": 1.0,
        "edges": 0,
        "how": "",
    }


def _lines(columns: Iterable[tuple[str, str]], points: Points) -> Sequence[Json]:
    """Return the minimum and the maximum of each pixel, by name and unit of the column."""
    lines: list[Json] = []
    for n, (name, unit) in enumerate(columns):
        low, high = points.low[n], points.high[n]
        line: dict[str, Json] = {"name": name, "unit": unit}
        line["low"] = [_finite(value) for value in low.tolist()]
        # Minimum and maximum are equal in all pixels: one of them is enough.
        one = bool(((low == high) | (low != low)).all())
        line["high"] = None if one else [_finite(value) for value in high.tolist()]
        lines.append(line)
    return lines


def _finite(value: float) -> Json:
    return value if math.isfinite(value) else None


def _how(series: Series) -> str:
    """Return why the plot is incomplete, for the user; '' = it is complete."""
    if series.share < 1.0:
        return (
            f"{series.share:.0%} of the stored messages were read, spread over the whole time "
            "range; ask again for more"
        )
    if series.edges:
        return (
            f"all messages were read; {series.edges} blocks lie across the edges of pixels, whose "
            "minimum and maximum may be too wide; ask again to have the blocks unpacked"
        )
    return ""


_STATEMENT = Parameter("q", "text", "The statement: a SELECT.", required=True)
_LANGUAGE = Parameter(
    "language",
    "text",
    "Language of the statement: cql, the query language over one topic, or sql, DuckDB's SQL over "
    "all of them.",
    default="cql",
)

ROUTES: tuple[Route, ...] = (
    Route(
        "/api/query",
        _query,
        "A page of the rows of a statement: columns, kinds (types of ROS), rows, times (of the "
        "message of each row), and after, the cursor of the next page ('' = the last page). Of SQL "
        "there is one page; more says whether it has further rows. hints say why nothing is found: "
        "names of robots, runs, events and frames that are not stored, with similar ones. "
        "Times and durations are texts of ns, and integers above 2^53 are texts, too; bytes are "
        "base64; NaN and the infinities are the texts 'nan', 'inf', '-inf'.",
        (
            _STATEMENT,
            Parameter(
                "limit",
                "count",
                f"Number of rows of the page, maximum {MAX_ANSWER_PAGE_ROWS}.",
                False,
                ANSWER_PAGE_ROWS,
            ),
            Parameter("after", "text", "Cursor: after of the page before."),
            Parameter("start", "time", "First time, included; not used for groups."),
            Parameter("end", "time", "Last time, included; not used for groups."),
            Parameter(
                "cut",
                "count",
                "Maximum number of elements of an array, text or bytes: "
                "longer ones become {first, of}.",
            ),
            NODES,
            RUNS,
            _LANGUAGE,
        ),
        takes_turns=is_sql,
    ),
    Route(
        "/api/explain",
        _explain,
        "How a statement is answered: it is run to its end, and the answer counts what the server "
        "checked and what was read; text is for people.",
        (_STATEMENT, NODES, RUNS, _LANGUAGE),
        takes_turns=is_sql,
    ),
    Route(
        "/api/complete",
        _complete,
        "Completions at a position of a statement: offers (text, kind, note), each of which "
        "replaces the text from start to the position; more is the number of further ones.",
        (
            Parameter("q", "text", "The statement, as far as it is typed.", default=""),
            Parameter("at", "count", "Position in characters; missing: the end."),
            limit_parameter("offers", MAX_OFFERS),
            _LANGUAGE,
        ),
    ),
    Route(
        "/api/plot",
        _plot,
        "The numbers of a statement over time: for each pixel that is not empty its time (ns), the "
        "number of rows (0 = unknown), and for each column low and high, its minimum and maximum "
        "(high null: all are the same as low). Answered within about a second: while complete is "
        "false, how says what is missing, and another request gives more. Rows of groups, of LIMIT "
        "and of SQL are always complete.",
        (
            _STATEMENT,
            *WHOLE_RANGE,
            Parameter(
                "pixels", "count", f"Maximum number of pixels, up to {MOST_PIXELS}.", False, PIXELS
            ),
            Parameter(
                "seconds",
                "number",
                "Time after which an incomplete plot is answered, s.",
                False,
                BUDGET_SEC,
            ),
            NODES,
            RUNS,
            _LANGUAGE,
        ),
        takes_turns=is_sql,
    ),
)
