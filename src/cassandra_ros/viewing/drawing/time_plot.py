# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plots of numbers: over time with a panel for each unit, or one column over another."""

from __future__ import annotations

import math
from typing import IO, TYPE_CHECKING, Any, NamedTuple, Sequence

import numpy as np

from cassandra_ros.errors import InvalidOption
from cassandra_ros.installation import optional_module
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.topics.overview.plot_columns import Column
from cassandra_ros.topics.overview.plot_series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENDINGS = ("png", "svg", "pdf")
PURPOSE = "cassandra_bag plot"
_DAY_NS = 86_400 * SECOND_NS
_DPI = 100
FEW_POINTS = 60
"""Maximum number of points of a line whose points are marked."""
MAX_ABREAST = 4
"""Maximum number of names in a row of the legend above a panel."""
_TICK = "{x:.15g}"
"""Format of the numbers at an axis. matplotlib's own one takes an offset or a power of ten out of
them, and writes it where the legend is."""
_GRID = "#d8dde4"
_COLOURS = ("#2f6fde", "#d9622b", "#0e7c66", "#a23ea8", "#b28a00", "#c4302b", "#4f6b8f", "#5d8f2a")


class Line(NamedTuple):
    """The line of one column: a band from minimum to maximum at each time."""

    label: str
    unit: str
    times: AnyArray
    """Times of the points, ns since 1970."""
    low: AnyArray
    """Minimum at each point; NaN where the line is broken."""
    high: AnyArray

    @property
    def is_band(self) -> bool:
        """Whether some points have more than one number."""
        return bool((self.low < self.high).any())


def lines_of(series: Sequence[Series]) -> Sequence[Line]:
    """Return the lines of some statements; of several topics, labelled with the topic."""
    topics = {topic_series.topic for topic_series in series}
    lines = []
    for topic_series in series:
        times = topic_series.points.times
        after_gap = topic_series.breaks + 1
        broken = np.insert(times, after_gap, times[after_gap - 1])
        for n, column in enumerate(topic_series.columns):
            ends = (topic_series.points.low[n], topic_series.points.high[n])
            low, high = (np.insert(end, after_gap, np.nan) for end in ends)
            label = column.name if len(topics) == 1 else f"{topic_series.topic} {column.name}"
            lines.append(Line(label, column.unit, broken, low, high))
    return lines


class Curve(NamedTuple):
    """One column over another: for each pixel of time the rectangle that contains its messages."""

    label: str
    columns: tuple[Column, Column]
    """Columns along x and along y."""
    low: AnyArray
    """Smallest x and y of each rectangle, (2, points); NaN where the curve is broken."""
    high: AnyArray

    @property
    def middle(self) -> AnyArray:
        """Centre of each rectangle, (2, points); exact for a single message."""
        return np.asarray(self.low + (self.high - self.low) / 2)


def curves_of(series: Sequence[Series], names: tuple[str, str]) -> Sequence[Curve]:
    """Return the curves of some statements: for each the second column over the first.

    Args:
        series: Results of the statements.
        names: Names of the two columns, as in the statements.

    Raises:
        InvalidOption: A statement has no numeric column with such a name.
    """
    curves = []
    for topic_series in series:
        column_names = [column.name for column in topic_series.columns]
        for name in names:
            if name not in column_names:
                choices = ", ".join(column_names) or "no column that is a number"
                raise InvalidOption(
                    f"--xy {name}: the statement on {topic_series.topic} has {choices}"
                )
        places = [column_names.index(name) for name in names]
        after_gap = topic_series.breaks + 1
        low, high = (
            np.insert(ends[places], after_gap, np.nan, axis=1)
            for ends in (topic_series.points.low, topic_series.points.high)
        )
        columns = topic_series.columns[places[0]], topic_series.columns[places[1]]
        curves.append(Curve(topic_series.topic, columns, low, high))
    return curves


def draw_xy(
    stream: IO[bytes], ending: str, curves: Sequence[Curve], size: tuple[int, int], title: str = ""
) -> None:
    """Draw one column of statements over another into one picture.

    Both axes have the same scale if both columns are in metres, or are longitude and latitude.

    Args:
        stream, ending, size, title: As in draw_plot.
        curves: The curves, at least one.

    Raises:
        MissingDependency: matplotlib is not installed.
    """
    figures = optional_module("matplotlib.figure", PURPOSE)
    figure: Figure = figures.Figure([side / _DPI for side in size], _DPI, layout="constrained")
    panel = figure.subplots()
    for n, curve in enumerate(curves):
        _draw_curve(panel, curve, _COLOURS[n % len(_COLOURS)])
    x, y = curves[0].columns
    panel.set_xlabel(_column_label(x))
    panel.set_ylabel(_column_label(y))
    panel.xaxis.set_major_formatter(_TICK)
    panel.yaxis.set_major_formatter(_TICK)
    panel.grid(color=_GRID, linewidth=0.6)
    panel.set_axisbelow(True)
    aspect = _aspect(curves[0])
    if aspect is not None:
        panel.set_aspect(aspect, adjustable="datalim")
    if len(curves) > 1:
        panel.legend(frameon=False, fontsize="small")
    if title:
        figure.suptitle(_plain(title))
    figure.savefig(stream, format=ending)


def _draw_curve(panel: Axes, curve: Curve, colour: str) -> None:
    (x, y), wide = curve.middle, (curve.high > curve.low).any(axis=0)
    mark: dict[str, Any] = {"color": colour, "linewidth": 1}
    if np.isfinite(x).sum() <= FEW_POINTS:
        mark.update(marker=".", markersize=5)
    panel.plot(x, y, label=_plain(curve.label), **mark)
    if wide.any():
        collections = optional_module("matplotlib.collections", PURPOSE)
        (left, low), (right, high) = curve.low[:, wide], curve.high[:, wide]
        corners = [[left, low], [right, low], [right, high], [left, high]]
        boxes = np.moveaxis(np.array(corners), 2, 0)
        panel.add_collection(collections.PolyCollection(boxes, color=colour, alpha=0.3))


def _column_label(column: Column) -> str:
    return _plain(column.name) + (f" [{column.unit}]" if column.unit else "")


def _aspect(curve: Curve) -> float | None:
    """Return the ratio of the y to the x unit length; None if the units cannot be compared."""
    units = tuple(column.unit for column in curve.columns)
    if units[0] == units[1] != "":
        return 1.0
    if set(units) != {"°E", "°N"}:
        return None
    latitude = curve.middle[units.index("°N")]
    if not np.isfinite(latitude).any():
        return None
    degree = max(0.01, math.cos(math.radians(float(np.nanmean(latitude)))))
    return 1 / degree if units == ("°E", "°N") else degree


def draw_plot(
    stream: IO[bytes], ending: str, series: Sequence[Series], size: tuple[int, int], title: str = ""
) -> None:
    """Draw statements into one picture over time.

    Args:
        stream: Stream that the picture is written to.
        ending: One of ENDINGS.
        series: Results of the statements; together they have at least one column.
        size: Width and height, pixels (1/100 inch for svg and pdf).
        title: Text above the picture; '' = no title.

    Raises:
        InvalidOption: There is nothing to draw.
        MissingDependency: matplotlib is not installed.
    """
    lines = lines_of(series)
    if not lines:
        reasons = [
            f"{u.name} is {u.reason}" for topic_series in series for u in topic_series.left_out
        ]
        raise InvalidOption(
            f"no column can be drawn: {'; '.join(reasons) or 'there are no columns'}"
        )
    figures = optional_module("matplotlib.figure", PURPOSE)
    figure: Figure = figures.Figure([side / _DPI for side in size], _DPI, layout="constrained")
    units = list(dict.fromkeys(line.unit for line in lines))
    panels = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
    colours = {id(line): _COLOURS[n % len(_COLOURS)] for n, line in enumerate(lines)}
    for panel, unit in zip(panels, units):
        _draw_panel(panel, [line for line in lines if line.unit == unit], unit, colours)
    _draw_times(panels[-1], series)
    if title:
        figure.suptitle(_plain(title))
    figure.savefig(stream, format=ending)


def _draw_panel(panel: Axes, lines: Sequence[Line], unit: str, colours: dict[int, str]) -> None:
    for line in lines:
        _draw_line(panel, line, colours[id(line)])
    panel.grid(color=_GRID, linewidth=0.6)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.set_ylabel(f"[{unit}]" if unit else "")
    panel.yaxis.set_major_formatter(_TICK)
    panel.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1),
        ncols=min(len(lines), MAX_ABREAST),
        frameon=False,
        fontsize="small",
        borderaxespad=0.2,
    )


def _draw_line(panel: Axes, line: Line, colour: str) -> None:
    days, label = line.times / _DAY_NS, _plain(line.label)
    mark: dict[str, Any] = {"color": colour, "linewidth": 1}
    if len(days) <= FEW_POINTS:
        mark.update(marker=".", markersize=5)
    panel.plot(days, line.high, label=label, **mark)
    if line.is_band:
        panel.plot(days, line.low, **mark)
        panel.fill_between(days, line.low, line.high, color=colour, alpha=0.5, linewidth=0)


def _draw_times(panel: Axes, series: Sequence[Series]) -> None:
    """Draw the time axis from the first to the last point of all series, in UTC."""
    dates = optional_module("matplotlib.dates", PURPOSE)
    locator = dates.AutoDateLocator(minticks=3, maxticks=9)
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    panel.set_xlabel("UTC")
    ends = [(e.points.times[0], e.points.times[-1]) for e in series if len(e.points.times)]
    if ends:
        low, high = min(first for first, _ in ends), max(last for _, last in ends)
        margin = max((high - low) // 100, 1000)
        panel.set_xlim((low - margin) / _DAY_NS, (high + margin) / _DAY_NS)


def _plain(text: str) -> str:
    """Escape a text, so that matplotlib neither reads a formula nor hides it from the legend."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
