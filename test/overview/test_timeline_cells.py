# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cells of a timeline beside what is counted one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidOption
from cassandra_ros.topics.overview.timeline.time_cells import (
    MAX_TIMELINE_CELLS,
    Scale,
    TimeCells,
    TimeRanges,
    gaps_between,
    gaps_in,
    runs_of_cells,
    time_ranges_of_cells,
)

T0 = 1_368_021_980_238_582_676
times = st.integers(0, 3000).map(lambda n: T0 + 7 * n)
scales = st.builds(
    lambda start, length, most: Scale.over(T0 + start, T0 + start + length, most),
    st.integers(-5000, 25_000),
    st.integers(0, 30_000),
    st.integers(1, 200),
)


def time_ranges(*rows):
    """Make stretches of (first, last, messages), of writer 1."""
    first, last, messages = np.array(rows, np.int64).reshape(-1, 3).T
    ones = np.ones(len(first), np.int64)
    return TimeRanges(first, last, messages, 10 * messages, ones, ones.astype(bool))


def cells_by_hand(scale, known):
    counts = [0] * scale.cells
    for time in known:
        if scale.start <= time < scale.start + scale.cells * scale.step:
            counts[(time - scale.start) // scale.step] += 1
    return counts


@given(scales)
def test_cells_cover_the_window_and_no_shorter_ones_would(scale):
    assert (scale.cells - 1) * scale.step <= scale.end - scale.start < scale.cells * scale.step


@given(scales, st.lists(times, max_size=50))
def test_single_messages_lie_in_their_cells(scale, known):
    cells = TimeCells(scale)
    cells.add_times(np.array(known, np.int64))
    assert cells.counts.tolist() == cells_by_hand(scale, known)
    assert not cells.even.any()
    alone = TimeCells(scale)
    alone.add(time_ranges(*((time, time, 1) for time in known)))
    # If the last cell reaches beyond the end, time ranges after the end are not counted.
    inside = [time for time in known if time <= scale.end]
    assert alone.counts.tolist() == cells_by_hand(scale, inside)


@given(scales, st.lists(st.tuples(times, times, st.integers(2, 400)), max_size=6))
def test_what_covers_several_cells_is_spread_over_them_and_told_to_be(scale, rows):
    rows = [(min(one, other), max(one, other), count) for one, other, count in rows]
    cells = TimeCells(scale)
    cells.add(time_ranges(*rows))
    counts, even = cells.counts, cells.even
    begins = scale.start + np.arange(scale.cells) * scale.step
    for cell, begin in enumerate(begins.tolist()):
        end = begin + scale.step - 1
        near = [
            r for r in rows if r[0] <= min(end, scale.end) and r[1] >= begin and r[1] >= scale.start
        ]
        if not near:
            assert counts[cell] == 0
        assert counts[cell] <= sum(count for _, _, count in near) + 1e-6
        whole = sum(count for first, last, count in near if begin <= first and last <= end)
        assert counts[cell] >= whole - 1e-6
        if counts[cell] > 0 and not even[cell]:  # each is where it is told to be
            ends = [time for first, last, count in near for time in (first, last)]
            assert whole or any(begin <= time <= end for time in ends)
            assert not any(
                last - first > 3 * scale.step and count > 2 for first, last, count in near
            )
    for first, last, count in rows:  # one within the time range is counted whole
        if scale.start <= first and last <= scale.end and len(rows) == 1:
            assert counts.sum() == pytest.approx(count)


def test_few_messages_stand_at_their_ends_and_between():
    scale = Scale(T0, T0 + 999, 10)
    cells = TimeCells(scale)
    cells.add(time_ranges((T0 + 5, T0 + 985, 3)))
    assert np.flatnonzero(cells.counts).tolist() == [0, 49, 98]
    zoomed = TimeCells(Scale(T0 + 400, T0 + 599, 2))
    zoomed.add(time_ranges((T0 - 10**15, T0 + 10**15, 100_000)))
    assert zoomed.counts.sum() <= 1  # 20 ms from one to the next


def test_what_nobody_counted_is_told():
    cells = TimeCells(Scale(T0, T0 + 99, 10))
    cells.add(time_ranges((T0 + 20, T0 + 49, 0)))
    assert not cells.counts.any()
    assert time_ranges_of_cells(cells.unknown) == [[2, 4]]


def test_a_pause_is_told_when_it_is_unusual_and_can_be_seen():
    scale = Scale(0, 99_999, 100)
    usual = [(n * 1000, n * 1000 + 900, 10) for n in range(10)]
    assert gaps_between(time_ranges(*usual), scale) == []
    paused = [*usual, (20_000, 20_900, 10)]
    assert gaps_between(time_ranges(*paused), scale) == [(9900, 20_000)]
    assert gaps_between(time_ranges(*paused), Scale(0, 10**7, 10_000)) == []
    two_runs = time_ranges(*paused)._replace(writer=np.array([1] * 10 + [2]))
    assert gaps_between(two_runs, scale) == []
    assert gaps_between(time_ranges((0, 0, 1), (90_000, 90_000, 1)), scale) == []
    known = np.array([*range(0, 3000, 100), *range(9000, 12_000, 100)])
    assert gaps_in(known, scale) == [(2900, 9000)]


def test_cells_are_written_as_runs():
    assert runs_of_cells(np.array([0, 0.2, 3.0, 0, 7.6, 0.0])) == [[1, 1, 3], [4, 8]]
    assert runs_of_cells(np.zeros(3)) == []
    assert time_ranges_of_cells(np.array([True, True, False, True])) == [[0, 1], [3, 3]]


@pytest.mark.parametrize(
    ("start", "end", "most"), [(0, 9, 0), (0, 9, MAX_TIMELINE_CELLS + 1), (9, 0, 5)]
)
def test_what_is_no_window_is_refused(start, end, most):
    with pytest.raises(InvalidOption):
        Scale.over(start, end, most)
