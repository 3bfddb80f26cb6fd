# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plot numbers from SELECT statements over time, into a picture.

  cassandra_bag plot "SELECT linear.x, angular.z FROM /cmd_vel" -o speeds.png
  cassandra_bag plot "SELECT altitude FROM /fix" "SELECT range FROM /sonar" -o both.svg
  cassandra_bag plot "SELECT latitude, longitude FROM /fix" --xy longitude latitude -o way.png
  cassandra_bag plot "SELECT time(1m), max(range) FROM /sonar GROUP BY time(1m)" -o x.pdf

Each column of numbers becomes a line over KEY; with GROUP BY over the first time of each row.
Columns with the same unit share a panel (units are known for ROS's own messages); latitude and
longitude have a panel each. If there are many messages, the minimum and the maximum of each pixel
are drawn, so no peak is lost. A line is interrupted at NaN, and at pauses longer than five times
the usual interval.

With --xy one column is drawn over another one, in the order of time: a path, or one quantity over
another. The time is divided into 20,000 time ranges. If several messages are in one of them, the
rectangle around them is drawn, and the line goes through its middle.
"""

from __future__ import annotations

import argparse
import re
import sys
from typing import TYPE_CHECKING

from cassandra_ros.cli.options import (
    add_origin_options,
    add_store_options,
    add_time_options,
    open_store,
    read_times,
)
from cassandra_ros.cli.verbs.query import quoted
from cassandra_ros.errors import InvalidOption
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.topics.overview.plot_series import Series

_SIZES = range(100, 20_001)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the statements, the picture and the store."""
    add = parser.add_argument
    add("statements", metavar="STATEMENT", nargs="+", help="a SELECT, in quotes")
    add("-o", "--output", metavar="FILE", required=True, help="the picture: .png, .svg or .pdf")
    add("-f", "--force", action="store_true", help="replace FILE if it exists")
    add(
        "--size",
        metavar="WxH",
        type=_size,
        default=(1200, 600),
        help="width and height in pixels, in svg and pdf 1/100 inch (default: 1200x600)",
    )
    add("--title", metavar="TEXT", default="", help="title of the picture (default: no title)")
    add(
        "--xy",
        nargs=2,
        metavar=("X", "Y"),
        help="draw column Y over column X, by their names in the statements (default: over time)",
    )
    add_time_options(parser)
    add_origin_options(parser)
    add_store_options(parser)


def _size(text: str) -> tuple[int, int]:
    """Read width and height, pixels; raises InvalidOption."""
    match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if any(side not in _SIZES for side in size):
        limits = f"{_SIZES[0]} to {_SIZES[-1]} pixels a side"
        raise InvalidOption(f"{text!r} is not a size: write it as 1200x600, {limits}")
    return size


def run(options: argparse.Namespace) -> int:
    """Run the statements, and draw their numbers."""
    from cassandra_ros.cli.results import open_output
    from cassandra_ros.viewing.drawing.time_plot import ENDINGS, curves_of, draw_plot, draw_xy

    quoted(options, options.statements)
    ending = options.output.rpartition(".")[2].lower()
    if ending not in ENDINGS:
        endings = ", ".join(f".{suffix}" for suffix in ENDINGS)
        raise InvalidOption(f"{options.output}: the picture's name ends in one of {endings}")
    with open_store(options) as ros_cas, open_output(
        options.output, options.force, binary=True
    ) as stream:
        series = [_read(ros_cas, statement, options) for statement in options.statements]
        if options.xy is None:
            draw_plot(stream, ending, series, options.size, options.title)
        else:
            curves = curves_of(series, (options.xy[0], options.xy[1]))
            draw_xy(stream, ending, curves, options.size, options.title)
    for topic_series in series:
        for name, reason in topic_series.left_out:
            print(
                f"{shown(topic_series.topic)}: {shown(name)} is not drawn: {shown(reason, None)}",
                file=sys.stderr,
            )
        if not len(topic_series.points.times):
            print(
                f"{shown(topic_series.topic)}: there is nothing to draw in this time",
                file=sys.stderr,
            )
    return 0


def _read(ros_cas: RosCassandra, statement: str, options: argparse.Namespace) -> Series:
    """Read the numbers of a statement: for a line over time as many points as it has pixels."""
    from cassandra_ros.topics.overview.plot_series import MOST_PIXELS, PlotWindow

    start, end = read_times(options)
    pixels = options.size[0] if options.xy is None else MOST_PIXELS
    window = PlotWindow(
        None if start is None else start.ns, None if end is None else end.ns, pixels
    )
    return ros_cas.statements.series(
        statement, window=window, node=options.node_id, run=options.run
    )
