# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of a statement over time for a plot: the minimum and the maximum in each pixel.

The messages of a plain statement are read bucket by bucket (see envelopes.py), as many as there is
time for. For statements with groups, DISTINCT or LIMIT all result rows are made first.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import islice
from typing import Iterator, NamedTuple, Sequence

import numpy as np

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.arrays.array_types import AnyArray, column_types
from cassandra_ros.query.arrays.envelope import Envelope, Grid, Points
from cassandra_ros.query.plan.bounds import Bounds, bounds_time, plan_of, spans_of
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.query.protocols import Row, Source
from cassandra_ros.query.rows.projection import ResultRow
from cassandra_ros.query.rows.result_groups import analyse_select
from cassandra_ros.query.tree.syntax import KeyOperand, Select, Selected, conjuncts
from cassandra_ros.read import ALWAYS, EVERYBODY, Read, Whose
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.overview.bucket_envelope import EnvelopeRequest
from cassandra_ros.topics.overview.envelopes import EnvelopeCache, EnvelopeReader, Envelopes
from cassandra_ros.topics.overview.plot_columns import (
    Column,
    OmittedColumn,
    PlotColumns,
    as_float,
    drawn_columns,
)
from cassandra_ros.topics.query_result import QueryResult, StatementSource
from cassandra_ros.topics.row_reader import followed
from cassandra_ros.topics.topic_table import TopicTable

PIXELS = 1000
"""Number of pixels of a plot if none is requested."""
MOST_PIXELS = 20_000
MAX_PLOT_ROWS = 2_000_000
"""Maximum number of result rows for a plot that needs all of them."""
NEAR_KEPT_SEC = 60
"""How long cached conditions on places stay valid, s. Later poses may change them."""
_CHUNK_ROWS = 4096
"""Number of result rows that are made into arrays together."""
_NO_TIME = "of messages that lie under names, not at a time"
"""Reason for which columns of a topic whose messages have names are not drawn."""


class PlotWindow(NamedTuple):
    """Time range that is drawn, and its resolution."""

    low: int | None = None
    """First time, ns; None = that of the first message."""
    high: int | None = None
    """Last time, included, ns; None = that of the last message."""
    pixels: int = PIXELS
    """Maximum number of pixels, 1 to MOST_PIXELS."""
    seconds: float | None = None
    """Time limit after which the result so far is returned, s; None = no limit."""


WHOLE_WINDOW = PlotWindow()


@dataclass(frozen=True)
class SeriesRequest:
    """Restrictions of a request for a series, and its cache.

    Attributes:
        whose: Nodes and writers whose messages are read.
        cache: Cache of what was read, with whole pixels also at the ends of the window; None = no
            cache, and no message outside of the window is read.
        watch: See Watch.
    """

    whose: Whose = EVERYBODY
    cache: EnvelopeCache | None = None
    watch: Watch = unwatched


@dataclass(frozen=True)
class Series:
    """The numbers of a statement over time."""

    topic: str
    columns: tuple[Column, ...]
    left_out: tuple[OmittedColumn, ...]
    """Columns that cannot be drawn."""
    grid: Grid
    """Pixels of the plot: whole ones, so they cover slightly more than the window."""
    points: Points
    share: float = 1.0
    """Share of the messages that was read, 0 to 1. Below 1.0 points are missing, or lack some of
    their values."""
    edges: int = 0
    """Number of blocks in two or more pixels of which only the zones were read. Each of these
    pixels shows the values of the whole block."""

    @property
    def complete(self) -> bool:
        """Whether each number is exact."""
        return self.share == 1.0 and not self.edges

    @property
    def breaks(self) -> AnyArray:
        """Indexes of the points after which lines are interrupted.

        Empty while not all messages were read: a gap between the others is not a pause.
        """
        return self.points.breaks if self.share == 1.0 else np.zeros(0, np.int64)


def read_series(
    keyspace: Keyspace,
    topic: CassandraTopic,
    select: Select,
    window: PlotWindow,
    asker: SeriesRequest,
) -> Series:
    """Read the numbers that a statement gives over time.

    If the rows have no time over which to draw them, all columns are in ``left_out``.

    Args:
        asker: Restrictions and cache.

    Raises:
        InvalidQuery: The statement names a field that the topic does not have.
    """
    tables = topic.tables
    plain = analyse_select(select, tables)
    plan, bounds = plan_of(plain, tables, Read(whose=asker.whose))
    plot = drawn_columns(plan, tables)
    if any(table.named for table in tables):
        return _nothing(topic, _without(plot, _NO_TIME))
    if plan.gathers or plan.limit is not None:
        return _of_rows(topic, select, plot, window, asker)
    if asker.cache is None:
        bounds = bounds.within(window.low, window.high)
    ends = _extent(topic, bounds, window) if plot.columns else None
    if ends is None:
        return _nothing(topic, plot)
    grid = Grid.between(*ends, window.pixels)
    key = _key(plain, bounds, plot, near=plan is not plain)
    bounds = replace(bounds, spans=spans_of(plan.condition))
    request = EnvelopeRequest(plan, bounds, plot.columns, key)

    def read(now: Sequence[TopicTable]) -> Envelopes:
        reader = EnvelopeReader(keyspace, now, request, asker.cache, asker.watch)
        return reader.read(grid, window.seconds)

    envelopes = followed(tables, read)
    points = envelopes.envelope.points()
    return Series(topic.name, *plot, grid, points, envelopes.share, envelopes.edges)


def _key(select: Select, bounds: Bounds, plot: PlotColumns, near: bool) -> str:
    """Return a text that identifies a request among all requests for the same messages."""
    # The trees, because the values of bound parameters are not in the text.
    condition: object = select.condition
    if not near:
        # The parts that are read know their times: a range that moves with now() shares them.
        parts = () if bounds.whole else conjuncts(select.condition)
        condition = [conjunct for conjunct in parts if not bounds_time(conjunct)]
        bounds = replace(bounds, read=replace(bounds.read, time_range=ALWAYS))
    key = repr(([column.what for column in plot.columns], condition, bounds))
    # Poses may be stored later than the messages recorded there.
    return f"{key} {time.time() // NEAR_KEPT_SEC}" if near else key


def _nothing(topic: Source[Row], plot: PlotColumns) -> Series:
    """Return the series of a plot without points."""
    grid = Grid(0, 0, 1)
    return Series(topic.name, *plot, grid, Envelope(grid, len(plot.columns)).points())


def _without(plot: PlotColumns, reason: str) -> PlotColumns:
    """Move every column to those left out, with one reason."""
    left_out = (OmittedColumn(column.name, reason) for column in plot.columns)
    return PlotColumns((), (*left_out, *plot.left_out))


def _extent(topic: CassandraTopic, bounds: Bounds, window: PlotWindow) -> tuple[int, int] | None:
    """Return the first and the last time to be drawn; None if there is no message."""
    low, high = window.low, window.high
    if not topic.tables or bounds.empty:
        return None
    if low is None:
        low = _end(topic, bounds, reverse=False)
    if high is None:
        high = _end(topic, bounds, reverse=True)
    if low is None or high is None or low > high:
        return None
    return low, high


def _end(topic: CassandraTopic, bounds: Bounds, *, reverse: bool) -> int | None:
    """Return the time of the first (reverse: last) message within bounds, ns; None without one."""
    read = replace(bounds.read, reverse=reverse, columns=lambda table: (), wanted=1)
    return next((row.t for row in topic.read(read)), None)


def read_rows_series(
    topic: StatementSource[Row], select: Select, window: PlotWindow, asker: SeriesRequest
) -> Series:
    """Read the numbers that a statement gives over time, from all its rows, as of several stores.

    Raises:
        InvalidQuery: As read_series; or there are more than MAX_PLOT_ROWS rows.
    """
    tables = topic.tables
    plot = drawn_columns(analyse_select(select, tables), tables)
    if any(table.named for table in tables):
        return _nothing(topic, _without(plot, _NO_TIME))
    return _of_rows(topic, select, plot, window, asker)


def _of_rows(
    topic: StatementSource[Row],
    select: Select,
    plot: PlotColumns,
    window: PlotWindow,
    asker: SeriesRequest,
) -> Series:
    """Return the series of a statement of which all result rows are made.

    They are drawn over the first column that is a time: KEY, which is added if rows are messages,
    or a selected one.
    """
    if select.columns is not None and not (select.aggregates or select.group or select.distinct):
        select = replace(select, columns=(Selected(KeyOperand(0)), *select.columns))
    kinds = column_types(select, topic.tables)
    time_column = next(
        (n for n, (_, k) in enumerate(kinds) if k.kind == "time" and not k.depth), None
    )
    if time_column is None:
        reason = "in rows without a time to draw it over: group by time(1m), and select that, too"
        return _nothing(topic, _without(plot, reason))
    name = kinds[time_column][0]
    plot = plot._replace(left_out=tuple(c for c in plot.left_out if c.name != name))
    places = [[name for name, _ in kinds].index(column.name) for column in plot.columns]
    query = QueryResult(select, topic, asker.whose, watch=asker.watch)
    with query as result:
        times, numbers = _arrays(select, result, time_column, places)
    low = times.min(initial=2**63 - 1) if window.low is None else window.low
    high = times.max(initial=-1) if window.high is None else window.high
    if low > high:
        return _nothing(topic, plot)
    grid = Grid.between(int(low), int(high), window.pixels)
    envelope = Envelope(grid, len(places))
    envelope.add(times, numbers)
    return Series(topic.name, *plot, grid, envelope.points())


def _arrays(
    select: Select, rows: Iterator[ResultRow], time_column: int, places: Sequence[int]
) -> tuple[AnyArray, AnyArray]:
    """Return times, ns, and numbers (columns, rows) of rows; rows without a time are left out.

    Args:
        time_column: Index of the column with the time.
        places: Indexes of the columns with the numbers.

    Raises:
        InvalidQuery: There are more than MAX_PLOT_ROWS rows.
    """
    times: list[AnyArray] = [np.zeros(0, np.int64)]
    numbers: list[AnyArray] = [np.zeros((len(places), 0))]
    count = 0
    while chunk := list(islice(rows, _CHUNK_ROWS)):
        count += len(chunk)
        if count > MAX_PLOT_ROWS:
            reason = f"more than {MAX_PLOT_ROWS} rows are too many to draw; group by a longer time"
            raise InvalidQuery(select.text, 0, reason)
        timed = [row for row in chunk if hasattr(row[time_column], "to_nsec")]
        times.append(np.array([row[time_column].to_nsec() for row in timed], np.int64))
        values = [[as_float(row[place]) for row in timed] for place in places]
        numbers.append(np.array(values, np.float64).reshape(len(places), len(timed)))
    return np.concatenate(times), np.concatenate(numbers, axis=1)
