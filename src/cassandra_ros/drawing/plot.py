# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers over time as a picture: a panel for each unit, one axis of time for all."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any, NamedTuple, Sequence, Tuple

import numpy as np

from cassandra_ros.arrays.array_types import AnyArray
from cassandra_ros.arrays.envelope import breaks
from cassandra_ros.errors import InvalidOption
from cassandra_ros.installation import optional_module
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.topics.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENDINGS = ("png", "svg", "pdf")
PURPOSE = "cassandra_bag plot"
_DAY_NS = 86_400 * SECOND_NS
_DPI = 100
FEW_POINTS = 60
"""Up to here each point is marked."""
_GRID, _TEXT = "#d8dde4", "#1a1f26"
_COLOURS = ("#2f6fde", "#d9622b", "#0e7c66", "#a23ea8", "#b28a00", "#c4302b", "#4f6b8f", "#5d8f2a")


class Line(NamedTuple):
    """What is drawn of one column."""

    label: str
    unit: str
    times: AnyArray
    """Of its points, ns."""
    numbers: AnyArray
    """NaN where the line is broken."""
    dotted: bool
    """So few points that each is marked."""


def lines_of(series: Sequence[Series]) -> Sequence[Line]:
    """Return the lines of some statements; those of several topics are labelled with them."""
    topics = {each.topic for each in series}
    found = []
    for each in series:
        few = len(each.points.times) <= FEW_POINTS
        for n, column in enumerate(each.columns):
            times, numbers = _line(each, n)
            label = column.name if len(topics) == 1 else f"{each.topic} {column.name}"
            found.append(Line(label, column.unit, times, numbers, few))
    return found


def _line(series: Series, column: int) -> Tuple[AnyArray, AnyArray]:
    """Return a line through the least and the greatest number of each pixel.

    Of pixels with one message that is the line through the messages; of others it fills what lies
    between, as a line through all of them would.
    """
    times, low, high = series.points.times, series.points.low[column], series.points.high[column]
    ups = np.stack([low, high])
    # Every other pixel downwards: so it is one stroke, without edges of its own.
    ups[:, 1::2] = ups[::-1, 1::2]
    xs, ys = np.repeat(times, 2), ups.T.ravel()
    behind = 2 * (breaks(times) + 1)
    return np.insert(xs, behind, xs[behind - 1]), np.insert(ys, behind, np.nan)


def draw_plot(
    stream: IO[bytes],
    ending: str,
    series: Sequence[Series],
    size: Tuple[int, int],
    title: str = "",
) -> None:
    """Draw statements into one picture.

    Args:
        stream: Where the picture is written.
        ending: One of ENDINGS.
        series: What was read of each; together they have a column.
        size: Width and height, in pixels (of svg and pdf in 1/100 inch).
        title: Above all; '' = none.

    Raises:
        InvalidOption: There is nothing to draw.
        MissingDependency: matplotlib is not installed.
    """
    lines = lines_of(series)
    if not lines:
        reasons = [f"{u.name} is {u.reason}" for each in series for u in each.left_out]
        raise InvalidOption(f"no column can be drawn: {'; '.join(reasons) or 'there is none'}")
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
        mark: dict[str, Any] = {"marker": ".", "markersize": 5} if line.dotted else {}
        panel.plot(
            line.times / _DAY_NS,
            line.numbers,
            color=colours[id(line)],
            label=_plain(line.label),
            linewidth=1,
            **mark,
        )
    panel.grid(color=_GRID, linewidth=0.6)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    names = _plain(lines[0].label) if len(lines) == 1 else ""
    panel.set_ylabel(" ".join(filter(None, [names, f"[{unit}]" if unit else ""])))
    if len(lines) > 1:
        panel.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize="small")


def _draw_times(panel: Axes, series: Sequence[Series]) -> None:
    """Draw the axis of time from the first to the last pixel of all, in UTC."""
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
    """Return a text of which nothing is taken for a formula, nor for a line that has no name."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
