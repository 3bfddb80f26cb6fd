# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Envelopes beside the plainest loop over all numbers, without a database."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.query.arrays.envelope import Envelope, Grid

TIMES = st.integers(0, 5000)
NUMBERS = st.one_of(st.floats(), st.sampled_from([-0.0, 1.0, math.nan]))
ROWS = st.lists(st.tuples(TIMES, NUMBERS, NUMBERS), max_size=40)


def plain(grid, rows):
    """Pixel -> time, count and (least, greatest) of both columns, one row after the other."""
    found = {}
    for t, *numbers in rows:
        if grid.low <= t <= grid.high:
            found.setdefault((t - grid.low) // grid.width, []).append((t, *numbers))
    shown = {}
    for pixel, inside in found.items():
        times = [t for t, *_ in inside]
        ends = []
        for column in (1, 2):
            known = [row[column] for row in inside if math.isfinite(row[column])]
            ends.append((min(known), max(known)) if known else None)
        shown[pixel] = (min(times) + max(times)) // 2, len(inside), ends
    return shown


def shown(envelope):
    grid, points = envelope.grid, envelope.points()
    assert (np.diff(points.times) > 0).all()
    found = {}
    for n, t in enumerate(points.times.tolist()):
        ends = [
            None if math.isnan(low) else (low, high)
            for low, high in zip(points.low[:, n].tolist(), points.high[:, n].tolist())
        ]
        found[(t - grid.low) // grid.width] = t, points.rows[n], ends
    return found


def arrays(rows):
    times = np.array([t for t, *_ in rows], np.int64)
    return times, np.array([row[1:] for row in rows], float).reshape(len(rows), 2).T


@given(ROWS, st.integers(0, 6000), st.integers(0, 6000), st.integers(1, 40), st.integers(0, 40))
def test_each_pixel_has_its_least_and_its_greatest_number(rows, one, other, most, cut):
    grid = Grid.between(min(one, other), max(one, other), most)
    assert grid.low <= min(one, other) <= max(one, other) <= grid.high
    assert grid.pixels <= most and grid.low % grid.width == 0
    envelope, part = (Envelope(grid, 2) for _ in range(2))
    envelope.add(*arrays(rows[:cut]))
    # A part that has pixels of its own, some of them elsewhere.
    part = Envelope(Grid.over(1000, 4000, grid.shift), 2)
    inside = [row for row in rows[cut:] if part.grid.low <= row[0] <= part.grid.high]
    part.add(*arrays(rows[cut:]))
    envelope.merge(part)
    assert shown(envelope) == plain(grid, rows[:cut] + inside)


def test_a_grid_has_as_many_pixels_as_it_may():
    assert Grid.between(7, 7, 1) == Grid(0, 7, 1)
    assert Grid.between(0, 999, 1000).pixels == 1000
    assert Grid.between(0, 1000, 1000).pixels == 501
    # Across a high power of two nothing short of all bits is one pixel.
    assert Grid.between(2**40 - 1, 2**40, 1).pixels == 1
    day = Grid.between(1_400_000_000 * 10**9, 1_400_086_400 * 10**9, 1000)
    assert 500 <= day.pixels <= 1000


def test_a_span_that_is_wider_than_a_pixel_may_lie_in_each():
    envelope = Envelope(Grid(3, 0, 4), 1)  # 0..7, 8..15, 16..23, 24..31
    firsts, lasts = np.array([-5, 9, 30]), np.array([8, 11, 99])
    envelope.add_wide(firsts, lasts, np.array([[1.0, -2, 5]]), np.array([[2.0, 3, 6]]))
    points = envelope.points()
    assert points.times.tolist() == [3, 9, 30]
    assert points.low.tolist() == [[1, -2, 5]] and points.high.tolist() == [[2, 3, 6]]
    assert points.rows.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("times", "broken"),
    [
        ([], []),
        ([1], []),
        ([1, 1000], []),
        ([0, 10, 20, 30, 80, 90], []),
        ([0, 10, 20, 30, 81, 90], [3]),
        ([0, 1000, 1010, 1020, 1030, 9000], [0, 4]),
    ],
)
def test_a_line_is_broken_where_nothing_came_for_long(times, broken):
    envelope = Envelope(Grid(0, 0, 10_000), 1)
    envelope.add(np.array(times, np.int64), np.zeros((1, len(times))))
    assert envelope.points().breaks.tolist() == broken


def test_a_pause_that_is_short_beside_a_pixel_is_seen():
    """At 10 Hz nothing for 60 s, which are 600 usual intervals, and less than 2 pixels."""
    second = 10**9
    times = np.arange(0, 2000 * second, second // 10)
    times = times[(times < 800 * second) | (times >= 860 * second)]
    grid = Grid.between(0, 2000 * second, 100)
    assert 30 * second < grid.width < 40 * second
    envelope = Envelope(grid, 1)
    envelope.add(times, np.zeros((1, len(times))))
    points = envelope.points()
    (place,) = points.breaks.tolist()
    assert points.times[place] < 800 * second < 860 * second <= points.times[place + 1]
    # A pixel with messages is not a gap, however long the pause inside it.
    envelope = Envelope(Grid.between(0, 2000 * second, 10), 1)
    envelope.add(times, np.zeros((1, len(times))))
    assert envelope.points().breaks.tolist() == []


def test_bounds_of_blocks_are_no_pauses():
    """Wide groups only tell that messages lie in them, not how far apart these are."""
    envelope = Envelope(Grid(0, 0, 100), 1)
    firsts, lasts = np.array([0, 30, 60]), np.array([25, 55, 85])
    envelope.add_wide(firsts, lasts, np.zeros((1, 3)), np.ones((1, 3)))
    assert envelope.points().breaks.tolist() == []
    envelope.add(np.array([99]), np.zeros((1, 1)))
    assert envelope.points().breaks.tolist() == [len(envelope.points().times) - 2]
