# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The clock of a replay, by a clock that the test turns."""

from __future__ import annotations

import math

import pytest

from cassandra_ros.errors import InvalidOption
from cassandra_ros.playing.pace import Pace
from cassandra_ros.playing.play_options import PlayerOptions

SEC = 10**9


class Hands:
    def __init__(self):
        self.ns = 5 * SEC

    def __call__(self):
        return self.ns


@pytest.fixture
def hands():
    return Hands()


@pytest.fixture
def pace(hands):
    pace = Pace(100 * SEC, 2.0, hands)
    hands.ns += SEC
    return pace


def test_it_stands_until_it_is_released(pace, hands):
    assert (pace.now(), pace.due_in(101 * SEC)) == (100 * SEC, None)
    pace.release(Pace.BEGIN)
    hands.ns += SEC
    assert (pace.now(), pace.due_in(103 * SEC)) == (102 * SEC, 0.5)
    assert pace.due_in(101 * SEC) == -0.5


def test_reasons_to_stand_are_kept_apart(pace, hands):
    pace.hold("paused")
    pace.release(Pace.BEGIN)
    pace.hold("delayed")
    pace.release("paused")
    pace.release("paused")
    hands.ns += SEC
    assert pace.now() == 100 * SEC
    assert pace.holds("delayed")
    pace.release("delayed")
    hands.ns += SEC
    assert pace.now() == 102 * SEC


def test_a_jump_and_another_rate_go_on_from_now(pace, hands):
    pace.release(Pace.BEGIN)
    pace.jump(500 * SEC)
    hands.ns += SEC
    pace.set_rate(0.5)
    assert pace.rate == 0.5
    hands.ns += SEC
    assert pace.now() == 502 * SEC + SEC // 2
    pace.hold("paused")
    pace.jump(7)
    hands.ns += SEC
    assert pace.now() == 7


@pytest.mark.parametrize("rate", [0, -1, math.nan, math.inf, 1e7, True, "2"])
def test_rates_that_are_none(pace, rate):
    with pytest.raises(InvalidOption, match="more than 0"):
        pace.set_rate(rate)
    with pytest.raises(InvalidOption):
        PlayerOptions(rate=rate)
    assert pace.rate == 2.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"queue": -1},
        {"delay": -0.1},
        {"skip_empty": math.nan},
        {"clock_hz": 1e9},
        {"read_ahead": 0},
    ],
)
def test_numbers_outside_of_their_range(wrong):
    with pytest.raises(InvalidOption, match=next(iter(wrong))):
        PlayerOptions(**wrong)
