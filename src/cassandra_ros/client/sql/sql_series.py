# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of an SQL statement over time for a plot: the minimum and the maximum in each pixel.

All rows are read once, batch by batch, and only the pixels are kept. They become longer when a row
lies outside of them.
"""

from __future__ import annotations

from typing import Any, Iterable, Iterator, NamedTuple

import numpy as np

from cassandra_ros.keys import MAX_NS
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.arrays.envelope import Envelope, Grid, Points

MAX_COLUMNS = 24
"""Maximum number of lines drawn for one statement."""


class SqlSeries(NamedTuple):
    """The numbers of a statement over time."""

    columns: tuple[str, ...]
    """Columns that are drawn; a field in a message by its dotted name."""
    left_out: tuple[tuple[str, str], ...]
    """Columns that are not drawn, each with the reason."""
    grid: Grid
    points: Points


class _NumberColumn(NamedTuple):
    """A column of numbers, or a field of numbers in a column."""

    name: str
    """Its dotted name."""
    steps: tuple[int, ...]
    """Index of the column, and of a field in each struct on the way."""


def time_column(schema: Any) -> int | None:
    """Return the index of the first column that is a time in ns; None = there is no such column."""
    kinds = [field.type for field in schema]
    return next((n for n, kind in enumerate(kinds) if is_time_type(kind)), None)


def is_time_type(kind: Any) -> bool:
    """Return whether an Arrow type is that of times in ROS messages."""
    return str(kind) == "timestamp[ns]"


def times_of(column: Any) -> AnyArray:
    """Return the times of a column, ns; -1 for a missing time and for one that ROS cannot hold."""
    arrow = load_arrow("sql")
    times: AnyArray = column.cast(arrow.int64()).fill_null(-1).to_numpy(zero_copy_only=False)
    return np.where((times >= 0) & (times <= MAX_NS), times, -1)


def read_sql_series(
    batches: Iterable[Any], low: int | None, high: int | None, pixels: int
) -> SqlSeries:
    """Read the numbers of a statement over the first column of times.

    Args:
        batches: Its rows as record batches, at least one.
        low, high: First and last time to draw, both included, ns; None = those of the rows.
        pixels: Maximum number of pixels.
    """
    reader: _SeriesReader | None = None
    for batch in batches:
        reader = reader or _SeriesReader(batch.schema, low, high, pixels)
        reader.add(batch)
    if reader is None:
        raise AssertionError("a statement gives at least one batch")
    return reader.series()


class _SeriesReader:
    """Adds up batches of one schema; the arguments are those of read_sql_series."""

    def __init__(self, schema: Any, low: int | None, high: int | None, pixels: int) -> None:
        self._arrow = load_arrow("sql")
        self._low = 0 if low is None else low
        self._high = MAX_NS if high is None else high
        self._pixels = pixels
        self._time = time_column(schema)
        self._left_out: list[tuple[str, str]] = []
        self._columns = list(self._numbers(schema))
        self._grid = Grid(0, 0, 1)
        self._ends: tuple[int, int] | None = None
        """First and last time of the rows so far, ns."""
        self._envelope = Envelope(self._grid, len(self._columns))
        if low is not None and high is not None:
            self._widen(low, high)

    def _numbers(self, schema: Any) -> Iterator[_NumberColumn]:
        """Yield the columns that are drawn, and note the others."""
        count = 0
        for name, steps, kind in _leaves(schema, "", ()):
            reason = self._reason(kind)
            if steps == (self._time,):
                continue
            if self._time is None:
                reason = "in rows without a time in ns to draw it over: select KEY, too"
            elif not reason and count == MAX_COLUMNS:
                reason = f"more than {MAX_COLUMNS} columns are too many"
            if reason:
                self._left_out.append((name, reason))
            else:
                count += 1
                yield _NumberColumn(name, steps)

    def _reason(self, kind: Any) -> str:
        """Return the reason for which a column cannot be drawn; '' = it can."""
        types = self._arrow.types
        tests = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal)
        if any(test(kind) for test in tests):
            return ""
        if types.is_list(kind) or types.is_fixed_size_list(kind):
            return "an array: select one of its elements"
        return "a time: select epoch_ns of a difference" if types.is_temporal(kind) else "no number"

    def add(self, batch: Any) -> None:
        """Add the rows of a batch."""
        if self._time is None or not self._columns:
            return
        times = times_of(batch.column(self._time))
        chosen = np.flatnonzero((times >= self._low) & (times <= self._high) & (times >= 0))
        if not len(chosen):
            return
        times = times[chosen]
        self._widen(int(times.min()), int(times.max()))
        values = [self._floats(batch, column.steps)[chosen] for column in self._columns]
        self._envelope.add(times, np.array(values))

    def _widen(self, low: int, high: int) -> None:
        """Extend the pixels so that they also cover a time range, ns."""
        if self._ends is not None:
            low, high = min(low, self._ends[0]), max(high, self._ends[1])
        if self._ends == (low, high):
            return
        self._ends = low, high
        grid = Grid.between(low, high, self._pixels)
        self._grid, self._envelope = grid, self._envelope.widened(grid)

    def _floats(self, batch: Any, steps: tuple[int, ...]) -> AnyArray:
        column = batch.column(steps[0])
        for step in steps[1:]:
            column = column.flatten()[step]
        floats: AnyArray = column.cast(self._arrow.float64(), safe=False).to_numpy(
            zero_copy_only=False
        )
        return floats

    def series(self) -> SqlSeries:
        """Return the numbers of the rows that were added."""
        names = tuple(column.name for column in self._columns)
        return SqlSeries(names, tuple(self._left_out), self._grid, self._envelope.points())


def _leaves(
    fields: Any, prefix: str, steps: tuple[int, ...]
) -> Iterator[tuple[str, tuple[int, ...], Any]]:
    """Yield dotted name, steps and type of each column that is no struct, and of fields in structs.

    Args:
        fields: The columns, or the fields of a struct.
        prefix: What their names begin with.
        steps: Indexes that lead to them, see _NumberColumn.
    """
    for n, field in enumerate(fields):
        name, field_steps = prefix + field.name, (*steps, n)
        if str(field.type).startswith("struct<"):
            yield from _leaves(list(field.type), name + ".", field_steps)
        else:
            yield name, field_steps, field.type
