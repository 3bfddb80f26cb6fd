# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Aggregates beside plain Python over the same values."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.rows.result_groups import Aggregation
from cassandra_ros.query.tree.parse import parse_select

NAMES = ("count", "min", "max", "sum", "avg")
ODD = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0])


def totals(values, names=NAMES):
    """Each aggregate of the values, in two goes; as arrays, too, where these can hold them."""
    totals_of_lists = two_goes(values, names)
    for dtype in array_types(values):
        assert repr(two_goes(np.array(values, dtype), names)) == repr(totals_of_lists)
    return totals_of_lists


def two_goes(values, names):
    found = Aggregation(parse_select(f"select {', '.join(f'{n}(x)' for n in names)} from t"))
    found.add([values[: len(values) // 2]] * len(names))
    found.add([values[len(values) // 2 :]] * len(names))
    return found.values()


def array_types(values):
    """numpy's types that hold all of the values exactly."""
    kinds = set(map(type, values))
    if kinds == {float}:
        return [np.float64]
    if kinds == {bool}:
        return [bool]
    if kinds == {int}:
        ends = (np.iinfo(name) for name in ("i1", "i4", "u4", "i8", "u8"))
        return [e.dtype for e in ends if e.min <= min(values) and max(values) <= e.max]
    return []


@search(200)
@given(st.lists(st.none() | st.integers(-(2**63), 2**64 - 1)))
def test_integers(values):
    known = [value for value in values if value is not None]
    count, least, most, total, mean = totals(values)
    assert count == len(known)
    assert (least, most) == (min(known, default=None), max(known, default=None))
    assert total == (sum(known) if known else None)
    assert type(total) is (int if known else type(None))
    assert mean == (sum(known) / len(known) if known else None)
    assert type(mean) is (float if known else type(None))


def rounded(exact):
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


@search(300)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
def test_floats(values):
    count, least, most, total, mean = totals(values)
    assert (count, least, most) == (len(values), min(values), max(values))
    exact = sum(map(Fraction, values))
    assert total == rounded(exact)
    assert mean == rounded(exact / len(values))
    try:
        assert total == math.fsum(values)
    except OverflowError:
        pass  # somewhere on the way, which is not a reason not to answer


@search(300)
@given(st.lists(st.floats() | ODD, min_size=1))
def test_nan_and_infinities(values):
    count, least, most, total, mean = totals(values)
    numbers = [value for value in values if not math.isnan(value)]
    assert count == len(values)
    assert (least, most) == (min(numbers, default=None), max(numbers, default=None))
    special = [value for value in values if not math.isfinite(value)]
    if special:
        for found in (total, mean):
            assert found == sum(special) or (math.isnan(found) and math.isnan(sum(special)))
    else:
        assert math.isfinite(mean)


def test_no_values():
    assert totals([]) == totals([None, None]) == (0, None, None, None, None)


def test_bools_count_as_numbers_in_sums():
    assert totals([True, False, True]) == (3, False, True, 2, 2 / 3)
    assert type(totals([True])[3]) is int


@pytest.mark.parametrize("values", [[0.0, -0.0], [-0.0, 0.0], [1, 1.0], [1.0, 1], [True, 1]])
def test_the_first_of_equals_is_kept(values):
    for found in totals(values, ["min", "max"]):
        assert (repr(found), type(found)) == (repr(values[0]), type(values[0]))


def test_integers_beside_floats():
    assert totals([2**53 + 1, 0.5, 0.5], ["sum", "max"]) == (2**53 + 2, 2**53 + 1)


@given(st.lists(st.text(), min_size=1))
def test_text_by_code_point(values):
    assert totals(values, ["count", "min", "max"]) == (len(values), min(values), max(values))


def test_kinds_without_an_order():
    with pytest.raises(InvalidQuery, match="different kinds") as caught:
        totals([1, "x"], ["count", "max"])
    assert caught.value.position == len("select count(x), ")
