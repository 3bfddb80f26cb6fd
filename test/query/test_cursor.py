# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cursors: text that anybody may send back changed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, encode_cursor
from cassandra_ros.topics.query_result import START, ResultPlace, read_cursor

POSITION = Position(5, "röbot", 1 << 40, "t_0")


def test_round_trip():
    for place in (START, ResultPlace(7, 0, POSITION), ResultPlace(10**15, 3, POSITION)):
        assert read_cursor(place.text) == place
    assert read_cursor(POSITION) == ResultPlace(0, 0, POSITION)
    assert read_cursor(None) == read_cursor("") == START


@pytest.mark.parametrize(
    "text",
    ["x", "1.2", "1.2.", "-1.0." + encode_cursor(POSITION), "1.x." + encode_cursor(POSITION),
     "9" * 30 + ".0." + encode_cursor(POSITION), encode_cursor(POSITION), "1.0.!!!!"],
)  # fmt: skip
def test_other_text(text):
    with pytest.raises(InvalidKey):
        read_cursor(text)


@given(st.text())
def test_any_text(text):
    try:
        read_cursor(text)
    except InvalidKey as exc:
        assert str(exc)
