# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where live messages begin among stored ones, for publishers of any habit."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.playing.history.alignment import MessageFingerprint, digest_of, first_live

MS = 1_000_000
CONSTANT, SWITCH, NUMBERED = 1, 2, 10**6


@st.composite
def heard(draw):
    """What a publisher sent, and from where to where a recorder and a subscriber heard it."""
    count = draw(st.integers(1, 80))
    kinds = draw(st.sampled_from([CONSTANT, SWITCH, 3, NUMBERED]))
    values = (
        list(range(count))
        if kinds == NUMBERED
        else draw(st.lists(st.integers(0, kinds - 1), min_size=count, max_size=count))
    )
    period = draw(st.sampled_from([2, 20, 100, 1000])) * MS
    times = [10**18 + n * period for n in range(count)]
    late = st.lists(st.integers(0, period // 4), min_size=count, max_size=count)
    sent = [str(value).encode() for value in values]
    stored = [MessageFingerprint(t + d, b) for t, d, b in zip(times, draw(late), sent)]
    live = [MessageFingerprint(t + d, b) for t, d, b in zip(times, draw(late), sent)]
    begin = draw(st.integers(0, count - 1))
    first = draw(st.integers(0, count - 1))
    end = draw(st.integers(first, count))
    return stored[first:end], live[begin:], first, begin, end


@search(100)
@given(heard())
def test_the_stored_ones_before_it_and_the_live_ones_are_each_once(case):
    stored, live, first, begin, end = case
    assume(len(stored) + len(live) > 2)  # with fewer the period is unknown
    found = first_live(stored, live)
    if end <= begin:  # nothing of the live ones is stored
        assert found is None
    elif first < end:
        assert found == max(0, begin - first)


@given(heard(), st.integers(-(10**13), 10**13))
def test_clocks_that_differ_do_not_matter_where_bytes_tell(case, skew):
    stored, live, first, begin, end = case
    moved = [MessageFingerprint(t + skew, b"stamped %d %s" % (t // (2 * MS), b)) for t, b in stored]
    there = [MessageFingerprint(t, b"stamped %d %s" % (t // (2 * MS), b)) for t, b in stored]
    rest = [MessageFingerprint(t, b"after %d" % t) for t, _ in live]
    at = max(0, begin - first)
    found = first_live(moved, [*there[at:], *rest], sure=True)
    assert found == (at if at < len(stored) else None)


@given(heard(), st.data())
def test_a_recorder_that_lost_or_left_out_some(case, data):
    stored, live, first, begin, end = case
    whole = [MessageFingerprint(t, b"%d %s" % (n + first, b)) for n, (t, b) in enumerate(stored)]
    ours = [MessageFingerprint(t, b"%d %s" % (n + begin, b)) for n, (t, b) in enumerate(live)]
    kept = data.draw(st.lists(st.booleans(), min_size=len(whole), max_size=len(whole)))
    left = [mark for mark, keep in zip(whole, kept) if keep]
    digests = {mark.digest for mark in ours}
    expected = next((n for n, mark in enumerate(left) if mark.digest in digests), None)
    assert first_live(left, ours, sure=True) == expected
    assert first_live(left, ours) == expected or len(left) < 8


def test_equal_messages_of_long_ago_are_others():
    """A door that reports 'open' once in ten seconds."""
    stored = [MessageFingerprint(n * 10_000 * MS, b"open") for n in range(5)]
    live = [MessageFingerprint(n * 10_000 * MS, b"open") for n in range(5, 8)]
    assert first_live(stored, live) is None
    assert first_live(stored, live[:1]) is None


@pytest.mark.parametrize(
    ("period_ms", "apart_ms", "found"),
    [(100, 40, 2), (100, 60, None), (10_000, 400, 2), (10_000, 600, None)],
)
def test_few_equal_messages_agree_within_half_a_period_and_half_a_second(
    period_ms, apart_ms, found
):
    stored = [MessageFingerprint(n * period_ms * MS, b"open") for n in range(3)]
    live = [MessageFingerprint((n * period_ms + apart_ms) * MS, b"open") for n in range(2, 5)]
    assert first_live(stored, live) == found


def test_many_equal_messages_take_no_long_time():
    stored = [MessageFingerprint(n * MS, b"") for n in range(30_000)]
    live = [MessageFingerprint(n * MS + MS // 4, b"") for n in range(20_000, 50_000)]
    assert first_live(stored, live) == 20_000


def test_a_subscriber_that_lags_at_first():
    """While it reads the past it takes the messages late, and many at once."""
    stored = [MessageFingerprint(n * 10 * MS, b"") for n in range(400)]
    live = [MessageFingerprint(max(n, 280) * 10 * MS, b"") for n in range(200, 420)]
    assert first_live(stored, live) == 200


@pytest.mark.parametrize(
    ("period_ms", "late_ms", "skew_ms", "kinds"),
    [(10, 5, 0, CONSTANT), (20, 20, 0, SWITCH), (20, 10, 15, SWITCH), (20, 5, 30, 3)],
)
def test_receive_times_that_scatter_by_half_a_period_and_more(period_ms, late_ms, skew_ms, kinds):
    """The last stored message alone would choose a wrong place in one of ten to nine of ten."""
    random = Random(3)
    for _ in range(30):
        begin, end = random.randint(100, 250), random.randint(260, 390)
        sent = [b"%d" % random.randrange(kinds) for _ in range(400)]
        stored, live = (
            sorted(
                int((n * period_ms + late + random.expovariate(1 / late_ms)) * MS)
                for n in range(len(sent))
            )
            for late in (0, skew_ms)
        )
        marks = [
            [MessageFingerprint(t, value) for t, value in zip(times, sent)]
            for times in (stored, live)
        ]
        assert first_live(marks[0][:end], marks[1][begin:]) == begin


def test_large_messages_are_compared_by_a_digest():
    a, b = digest_of(b"x" * 10**6), digest_of(b"x" * 10**6 + b"y")
    assert a != b
    assert len(a) < 64
    assert digest_of(b"short") == b"short"
    assert len({digest_of(bytes(n)) for n in range(100)}) == 100
