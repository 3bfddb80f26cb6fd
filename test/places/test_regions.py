# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ways, regions and coarse cells beside what is counted point by point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.errors import InvalidOption
from cassandra_ros.places.ground_cells import (
    LONGEST_NS,
    MAX_REGION_CELLS,
    SIZES_M,
    OpenVisits,
    cells_of,
    visits_of,
)
from cassandra_ros.places.paths import (
    LONGEST_GAP_NS,
    RobotPath,
    clip_ranges,
    subtract_ranges,
)
from cassandra_ros.places.regions import Box, DiskRegion, Polygon
from cassandra_ros.query.plan.bounds import merge_ranges

SEC = 10**9
METRES = st.one_of(
    st.floats(-30, 30), st.integers(-8, 8).map(float), st.sampled_from([4.0, -4.0, 64.0, 1e5, 5e6])
)
STEPS = st.sampled_from([1, 10**6, SEC // 10, SEC, LONGEST_GAP_NS, LONGEST_GAP_NS + 1, 20 * SEC])
POSES = st.lists(st.tuples(STEPS, METRES, METRES), max_size=12)


def path_of(poses, start=0):
    """A way through poses, each so long after the one before."""
    times = start + np.cumsum([step for step, _, _ in poses], dtype=np.int64)
    x, y = (np.array([pose[n] for pose in poses]) for n in (1, 2))
    return RobotPath(times, x, y)


def polygons():
    corners = st.lists(st.tuples(METRES, METRES), min_size=3, max_size=6)
    return corners.map(Polygon)


def disks():
    return st.builds(DiskRegion, METRES, METRES, st.one_of(st.floats(0, 50), st.just(5.0)))


def moments(path):
    """Times at which a way is looked at: its poses, between them, and beyond both ends."""
    times = path.times.tolist()
    for first, last in zip(times, times[1:]):
        for share in (0, 0.001, 0.25, 0.5, 0.9, 1):
            yield first + int(share * (last - first))
    yield from times
    yield from (0, times[0] - 1, times[-1] + 1) if times else (5,)


def contains(spans, t):
    return any(low <= t <= high for low, high in spans)


@given(POSES, st.one_of(disks(), polygons()))
@search(200)
def test_a_stay_holds_each_moment_in_a_region(poses, region):
    path = path_of(poses)
    stays = list(path.stays(region))
    assert stays == sorted(stays)
    assert all(one[1] + 1 < other[0] for one, other in zip(stays, stays[1:]))
    for t in moments(path):
        place = path.at(t)
        if place is not None and region.holds(*place):
            assert contains(stays, t), (t, place)


@given(POSES, disks())
@search(200)
def test_every_moment_lies_in_a_cell_that_is_visited(poses, region):
    path = path_of(poses)
    visits = list(visits_of(path))
    assert all(v.high - v.low < LONGEST_NS for v in visits)
    cells = cells_of(region.boxes)
    for t in moments(path):
        place = path.at(t)
        if place is None:
            continue
        for size in SIZES_M:
            cell = (size, *(math.floor(metres / size) for metres in place))
            assert any(v.cell == cell and v.low <= t <= v.high for v in visits), (t, cell)
        if cells is not None and region.holds(*place):
            assert any(v.cell in cells and v.low <= t <= v.high for v in visits)


@given(POSES, st.integers(1, 10))
@search(60)
def test_parts_of_a_way_have_the_visits_of_the_whole(poses, cut):
    path, open_visits, found = path_of(poses), OpenVisits(), {}
    for part in (slice(0, cut + 1), slice(cut, None)):
        for visit in open_visits.visits(RobotPath(path.times[part], path.x[part], path.y[part])):
            found[visit.cell, visit.low] = visit.high  # as a row that is written again
    for t in moments(path):
        place = path.at(t)
        if place is not None:
            cell = (4, *(math.floor(metres / 4) for metres in place))
            assert any(c == cell and low <= t <= high for (c, low), high in found.items())


def test_a_stay_is_not_longer_than_it_is():
    path = path_of([(0, 0.0, 0.0), (10 * SEC, 10.0, 0.0)])
    ends = [4 * SEC, 6 * SEC]
    for region in (DiskRegion(5, 0, 1), Polygon([(4, -1), (6, -1), (6, 1), (4, 1)])):
        assert np.ravel(list(path.stays(region))) == pytest.approx(ends, abs=2_000_000, rel=0)
    assert not list(path.stays(DiskRegion(5, 1.001, 1)))


def test_what_is_known_of_a_way():
    path = path_of([(5, 0.0, 0.0), (10, 1.0, 2.0), (LONGEST_GAP_NS + 1, 5.0, 5.0), (1, 1e6, 0.0)])
    assert [path.at(t) for t in (4, 5, 10, 15)] == [None, (0, 0), (0.5, 1.0), (1, 2)]
    assert path.at(16) is None  # unknown for so long
    last = 15 + LONGEST_GAP_NS + 1
    assert path.at(last) == (5, 5)
    assert path.at(last + 1) == (1e6, 0)
    # Two poses that no robot can have had one after the other.
    assert not list(
        RobotPath(np.array([0, 2]), np.array([0.0, 1e6]), np.zeros(2)).stays(DiskRegion(9, 0, 1))
    )
    still = RobotPath.still(1.0, 2.0)
    assert still.at(10**18) == (1, 2)


def test_regions():
    disk = DiskRegion(1.0, 1.0, 5.0)
    assert disk.holds(4.0, 5.0)  # on the rim
    assert not disk.holds(4.0, 5.000001)
    square = Polygon([(0, 0), (2, 0), (2, 2), (0, 2)])
    assert square.holds(1, 1)
    assert not square.holds(3, 1)
    crossed = Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])
    assert crossed.holds(1.8, 1)
    assert not crossed.holds(1, 1.8)
    for corners in ([(0, 0), (1, 1)], [(0, 0), (1, 1), (math.nan, 0)], [(0, 0)] * 1001):
        with pytest.raises(InvalidOption):
            Polygon(corners)


def test_cells_cover_what_is_asked_for():
    assert cells_of([Box(-0.5, -0.5, 0.5, 0.5)]) == [
        (4, -1, -1),
        (4, -1, 0),
        (4, 0, -1),
        (4, 0, 0),
    ]
    assert {cell.size for cell in cells_of(DiskRegion(0, 0, 30).boxes)} == {64}
    assert len(cells_of(DiskRegion(0, 0, 5000).boxes)) <= MAX_REGION_CELLS
    assert cells_of(DiskRegion(0, 0, 1e6).boxes) is None


def test_spans():
    assert list(merge_ranges([(0, 3), (4, 5), (7, 9), (8, 8)])) == [(0, 5), (7, 9)]
    assert list(merge_ranges([(7, 9), (8, 8), (4, 5), (0, 3)])) == [(7, 9), (0, 5)]
    assert list(clip_ranges([(0, 3), (5, 9)], 2, 6)) == [(2, 3), (5, 6)]
    assert list(subtract_ranges([(0, 9), (20, 29)], [(2, 3), (5, 5), (9, 21)])) == [
        (0, 1),
        (4, 4),
        (6, 8),
        (22, 29),
    ]
    assert list(subtract_ranges([(0, 9)], [])) == [(0, 9)]
