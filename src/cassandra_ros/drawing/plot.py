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
MAX_ABREAST = 4
"""Names beside each other, above a panel."""
_GRID = "#d8dde4"
_COLOURS = ("#2f6fde", "#d9622b", "#0e7c66", "#a23ea8", "#b28a00", "#c4302b", "#4f6b8f", "#5d8f2a")


class Line(NamedTuple):
    """What is drawn of one column: what lies between its least and its greatest numbers."""

    label: str
    unit: str
    times: AnyArray
    """Of its points, ns."""
    low: AnyArray
    """NaN where the line is broken."""
    high: AnyArray

    @property
    def is_band(self) -> bool:
        """Whether some points have more than one number."""
        return bool((self.low < self.high).any())


def lines_of(series: Sequence[Series]) -> Sequence[Line]:
    """Return the lines of some statements; those of several topics are labelled with them."""
    topics = {each.topic for each in series}
    found = []
    for each in series:
        times = each.points.times
        behind = breaks(times) + 1
        broken = np.insert(times, behind, times[behind - 1])
        for n, column in enumerate(each.columns):
            ends = (each.points.low[n], each.points.high[n])
            low, high = (np.insert(end, behind, np.nan) for end in ends)
            label = column.name if len(topics) == 1 else f"{each.topic} {column.name}"
            found.append(Line(label, column.unit, broken, low, high))
    return found


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
        _draw_line(panel, line, colours[id(line)])
    panel.grid(color=_GRID, linewidth=0.6)
    panel.set_axisbelow(True)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.set_ylabel(f"[{unit}]" if unit else "")
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
