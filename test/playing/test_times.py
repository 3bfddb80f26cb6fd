# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From when to when is played: seconds from the first message, or times of the calendar."""

from __future__ import annotations

import genpy
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import When, iso_time
from cassandra_ros.playing.play_times import check_length, read_when, resolve_times
from cassandra_ros.read import TimeRange

SEC = 10**9


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None),
        ("12.5", When(12_500_000_000, True)),
        (12.5, When(12_500_000_000, True)),
        (0, When(0, True)),
        ("999999999", When(999_999_999 * SEC, True)),
        ("1000000000", When(10**9 * SEC, False)),
        (1368021980.25, When(1_368_021_980_250_000_000, False)),
        ("1368021980.123456789", When(1_368_021_980_123_456_789, False)),
        (1_368_021_980_123_456_789, When(1_368_021_980_123_456_789, False)),
        ("1368021980123456789", When(1_368_021_980_123_456_789, False)),
        ("2013-05-08T14:06:20Z", When(1_368_021_980 * SEC, False)),
        ("2013-05-08", When(1_367_971_200 * SEC, False)),
        # Simulated time: a genpy.Time is a time, also if it is small.
        (genpy.Time(5, 1), When(5 * SEC + 1, False)),
        (genpy.Duration(5, 1), When(5 * SEC + 1, True)),
    ],
)
def test_a_time_is_read(value, expected):
    assert read_when("start", value) == expected


@pytest.mark.parametrize(
    "value",
    ["", "soon", "-1", -1, -0.5, "1e3", float("nan"), float("inf"), "9" * 41, "9" * 30]
    + [10**30, True, [], b"5", "2013-13-01", genpy.Duration(-1)],
)
def test_what_is_no_time_is_refused(value):
    with pytest.raises(InvalidOption, match="^start .* is not a time to play: write seconds"):
        read_when("start", value)


@pytest.mark.parametrize("value", [-1, "x", float("nan"), []])
def test_what_is_no_length_is_refused(value):
    with pytest.raises(InvalidOption, match="^duration .* is not a number of seconds"):
        check_length("duration", value)


@given(st.integers(0, 10**18 - 1))
def test_seconds_are_exact_as_text(ns):
    assert read_when("end", f"{ns // SEC}.{ns % SEC:09d}") == When(ns, True)
    later = ns + 10**18
    for text in (str(later), f"{later // SEC}.{later % SEC:09d}", iso_time(later)):
        assert read_when("end", text) == When(later, False)


NS = st.integers(0, 100)
WHENS = st.none() | st.builds(When, NS, st.booleans())


@given(NS, NS, WHENS, WHENS, st.none() | NS)
def test_times_resolve_to_a_part_of_what_is_there_or_are_refused(one, two, start, end, length):
    known = TimeRange(min(one, two), max(one, two))

    def place(when, default):
        return default if when is None else when.ns + known.low * when.relative

    low, high = place(start, known.low), place(end, known.high)
    right = known.low <= low <= known.high and low <= high
    if not right:
        with pytest.raises(InvalidOption, match="lies (before|after)"):
            resolve_times(known, start, end, length)
        return
    found = resolve_times(known, start, end, length)
    assert found.low == low
    assert found.high == min(high, known.high, low + length if length is not None else high)
