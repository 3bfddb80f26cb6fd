# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of series, without a database: what is drawn, and that it is there to be seen."""

from __future__ import annotations

import io
import math
import re

import matplotlib
import numpy as np
import pytest
from PIL import Image

from cassandra_ros.errors import InvalidOption
from cassandra_ros.query.arrays.envelope import Envelope, Grid
from cassandra_ros.query.tree.syntax import KeyOperand
from cassandra_ros.topics.overview.plot_columns import Column, OmittedColumn
from cassandra_ros.topics.overview.plot_series import Series
from cassandra_ros.viewing.drawing.time_plot import curves_of, draw_plot, draw_xy, lines_of

SEC = 10**9
T0 = 1_500_000_000 * SEC


def series(values, names=("x",), units=("m",), topic="/t", pixels=100, times=None):
    """A series of columns; values[n] is what column n has."""
    numbers = np.array(values, float)
    if times is None:
        times = T0 + np.arange(numbers.shape[1]) * SEC
    grid = Grid.between(int(times[0]), int(times[-1]), pixels)
    envelope = Envelope(grid, len(numbers))
    envelope.add(np.asarray(times, np.int64), numbers)
    columns = tuple(Column(name, unit, KeyOperand(0)) for name, unit in zip(names, units))
    return Series(topic, columns, (), grid, envelope.points())


def drawn(*every, ending="png", size=(400, 300), **options):
    stream = io.BytesIO()
    draw_plot(stream, ending, every, size, **options)
    return stream.getvalue()


def test_a_line_goes_from_the_least_to_the_greatest():
    (line,) = lines_of([series([[1, 2, 3, 4, 5, 6, 7, 8]], pixels=1)])
    assert (line.low.tolist(), line.high.tolist(), line.is_band) == ([1], [8], True)
    (line,) = lines_of([series([[1.5, math.nan, 3]])])
    assert str(line.low.tolist()) == str(line.high.tolist()) == str([1.5, math.nan, 3.0])
    assert line.times.tolist() == [T0, T0 + SEC, T0 + 2 * SEC] and not line.is_band


def test_a_line_is_broken_where_nothing_came():
    times = [T0 + n * SEC for n in (0, 1, 2, 3, 60, 61)]
    (line,) = lines_of([series([[1, 2, 3, 4, 5, 6]], times=times)])
    assert str(line.low.tolist()) == str([1.0, 2.0, 3.0, 4.0, math.nan, 5.0, 6.0])


def test_lines_of_several_topics_say_whose_they_are():
    labels = [line.label for line in lines_of([series([[1, 2]]), series([[1, 2]], topic="/u")])]
    assert labels == ["/t x", "/u x"]


def test_a_picture_has_the_size_and_shows_each_line():
    data = drawn(series([[0, 5, 0], [9, 9, 9]], ("x", "y"), ("m", "s")), size=(500, 260))
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    assert picture.size == (500, 260)
    colours = {colour for _, colour in picture.getcolors(1 << 20)}
    assert {(0x2F, 0x6F, 0xDE), (0xD9, 0x62, 0x2B)} <= colours


def test_between_the_least_and_the_greatest_all_is_filled():
    picture = Image.open(io.BytesIO(drawn(series([[0, 9] * 200], pixels=4)))).convert("RGB")
    data = np.asarray(picture).astype(int)
    blue = (data[:, :, 2] > data[:, :, 0] + 40).mean()
    assert blue > 0.3


def test_every_ending_and_all_texts():
    both = series([[0, 5], [1, 2]], ("x", "cost $a_b$"), ("m", "m"))
    svg = drawn(both, ending="svg", title="A <drive>").decode("utf-8")
    assert svg.startswith("<?xml") and "<svg" in svg
    # Texts are outlines; what they say stands beside them.
    for text in ("A &lt;drive&gt;", "x", "cost $a_b$", "[m]", "UTC"):
        assert f"<!-- {text} -->" in svg, text
    assert drawn(both, ending="pdf").startswith(b"%PDF-")


def test_nothing_and_next_to_nothing():
    assert drawn(series([[7.0]]))
    assert drawn(series([[math.nan, math.nan]]))
    assert drawn(series([[math.inf, 1.0, -math.inf]]))
    left = Series("/t", (), (OmittedColumn("s", "text"),), Grid(0, 0, 1), series([[1.0]]).points)
    with pytest.raises(InvalidOption, match="s is text"):
        drawn(left)
    empty = series([[1.0]])
    nothing = Series("/t", empty.columns, (), empty.grid, Envelope(Grid(0, 0, 1), 1).points())
    assert drawn(nothing)


def way(times=None, **options):
    """A robot that drives a circle of 2 m, twice."""
    angles = np.linspace(0, 4 * math.pi, 201)
    both = [2 * np.cos(angles), 2 * np.sin(angles)]
    return series(both, ("x", "y"), ("m", "m"), times=times, **options)


def drawn_xy(*every, names=("x", "y"), size=(400, 300)):
    stream = io.BytesIO()
    draw_xy(stream, "png", curves_of(every, names), size)
    return np.asarray(Image.open(stream).convert("RGB")).astype(int)


def blue(picture):
    return np.argwhere(picture[:, :, 2] > picture[:, :, 0] + 60)


@pytest.mark.parametrize(
    ("values", "label"),
    [
        ([1e6, 3e6], "2000000"),
        ([1e-7, 3e-7], "2e-07"),
        ([42.360001, 42.360003], "42.360002"),
        ([0, 1e300], "1e+300"),
    ],
)
def test_numbers_at_an_axis_are_whole(values, label, monkeypatch):
    """matplotlib would write +4.236e1 or 1e6 above the axis, where the legend is."""
    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")
    both = io.BytesIO()
    draw_xy(both, "svg", curves_of([series([values] * 2, "xy", "mm")], ("x", "y")), (400, 300))
    for picture in (drawn(series([values]), ending="svg"), both.getvalue()):
        svg = picture.decode().replace("\N{MINUS SIGN}", "-")
        texts = re.findall(r">([^<>]+)</text>", svg)
        assert label in texts
        assert not [text for text in texts if re.match(r"1e-?[1-9][0-9]*$|[+]", text)]


def test_a_way_is_drawn_as_it_was_gone_and_a_metre_is_a_metre():
    (curve,) = curves_of([way(pixels=1000)], ("x", "y"))
    assert np.hypot(*curve.middle) == pytest.approx(np.full(201, 2.0))
    assert np.array_equal(curve.low, curve.high)
    rows, columns = blue(drawn_xy(way(pixels=1000))).T
    high, wide = np.ptp(rows), np.ptp(columns)
    assert high > 100
    assert wide == pytest.approx(high, abs=4)
    # The other way round.
    (other,) = curves_of([way(pixels=1000)], ("y", "x"))
    assert np.array_equal(other.middle, curve.middle[::-1])


def test_a_way_is_broken_where_nothing_came():
    times = T0 + np.arange(201) * SEC
    times[100:] += 3600 * SEC
    (curve,) = curves_of([way(times=times, pixels=20_000)], ("x", "y"))
    assert np.flatnonzero(np.isnan(curve.middle).any(axis=0)).tolist() == [100]


def test_several_messages_of_a_pixel_lie_in_a_rectangle():
    (curve,) = curves_of(
        [series([[1, 3, 2], [9, 5, 7]], ("x", "y"), ("m", "s"), pixels=1)], ("x", "y")
    )
    assert (curve.low.tolist(), curve.high.tolist()) == ([[1], [5]], [[3], [9]])
    assert curve.middle.tolist() == [[2], [7]]
    wide = blue(drawn_xy(series([[1, 3] * 99, [9, 5] * 99], ("x", "y"), ("m", "s"), pixels=2)))
    assert len(wide) > 1000


def test_a_degree_east_is_as_long_as_it_is_there():
    angles = np.linspace(0, 2 * math.pi, 101)
    ring = [60 + np.sin(angles) / 2, 20 + np.cos(angles)]  # round at 60 degrees north
    made = series(ring, ("latitude", "longitude"), ("°N", "°E"), pixels=1000)
    for names in (("longitude", "latitude"), ("latitude", "longitude")):
        rows, columns = blue(drawn_xy(made, names=names)).T
        assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=4)


def test_latitude_and_longitude_have_a_panel_each():
    made = series([[60, 61], [20, 21]], ("latitude", "longitude"), ("°N", "°E"))
    svg = drawn(made, ending="svg").decode("utf-8")
    assert "<!-- [°N] -->" in svg and "<!-- [°E] -->" in svg


def test_a_column_that_is_not_there_is_told():
    with pytest.raises(InvalidOption, match="--xy z: the statement on /t has x, y"):
        curves_of([way()], ("x", "z"))
