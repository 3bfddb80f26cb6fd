# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import copy
import pickle
from datetime import date, datetime, timedelta, timezone
from decimal import Decimal

import genpy
import numpy
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import (
    Stamp,
    duration_ns,
    iso_time,
    seconds_to_ns,
    time_or_length,
    to_ns,
)

NS = st.integers(0, MAX_NS)
DAY = 86_400 * 10**9


@given(NS)
def test_stamp_is_exactly_its_nanoseconds(ns):
    stamp = Stamp.from_ns(ns)
    assert stamp.ns == stamp.to_nsec() == int(str(stamp)) == to_ns(stamp) == to_ns(str(stamp)) == ns
    assert stamp == genpy.Time(0, ns)
    assert genpy.Time(0, ns) == stamp
    assert hash(stamp) == hash(genpy.Time(0, ns))


@given(NS)
def test_iso_text_is_exact(ns):
    assert to_ns(iso_time(ns)) == ns


@given(NS, NS)
def test_order_is_that_of_nanoseconds_from_both_sides(a, b):
    for other in (Stamp.from_ns(b), genpy.Time(0, b), b):
        assert (Stamp.from_ns(a) < other) == (a < b)
        assert (Stamp.from_ns(a) <= other) == (a <= b)
        assert (Stamp.from_ns(a) > other) == (a > b)
        assert (Stamp.from_ns(a) >= other) == (a >= b)
        assert (other < Stamp.from_ns(a)) == (b < a)
        assert (other >= Stamp.from_ns(a)) == (b >= a)


def test_order_against_floats_means_seconds():
    stamp = Stamp(1, 500_000_000)
    assert 1.4 < stamp < 1.6
    assert stamp <= 1.5 <= stamp
    assert float("-inf") < stamp < float("inf")
    assert not stamp < float("nan")
    assert not stamp >= float("nan")
    with pytest.raises(TypeError):
        assert stamp < "2"


def test_equality_is_genpys():
    assert Stamp(1, 5) != 1_000_000_005
    assert Stamp.from_ns(5, node="a", seq=1, table="x") == Stamp.from_ns(5, node="b")


@given(NS, st.floats(0, 1e6))
def test_adding_seconds_rounds_their_shortest_text(ns, seconds):
    exact = ns + int((Decimal(repr(seconds)) * 10**9).to_integral_value())
    if exact > MAX_NS:
        with pytest.raises(InvalidKey):
            Stamp.from_ns(ns) + seconds
    else:
        assert (Stamp.from_ns(ns) + seconds).ns == exact
        assert (seconds + Stamp.from_ns(ns)).ns == exact


def test_arithmetic():
    stamp = Stamp(10, 5)
    assert (stamp + 0.1).ns == 10_100_000_005
    assert (stamp + 5).ns == 15_000_000_005
    assert (stamp - 5).ns == 5_000_000_005
    assert (stamp - 11).ns == 0
    assert (stamp + -11).ns == 0
    assert (stamp + genpy.Duration(1, 1)).ns == 11_000_000_006
    assert (genpy.Duration(1, 1) + stamp).ns == 11_000_000_006
    assert (stamp - genpy.Duration(20)).ns == 0
    assert (stamp + numpy.float64(0.5)).ns == 10_500_000_005
    assert (stamp + numpy.int64(2)).ns == 12_000_000_005
    assert (stamp + Decimal("0.000000001")).ns == 10_000_000_006
    assert stamp - genpy.Time(4, 0) == genpy.Duration(6, 5)
    assert genpy.Time(4, 0) - stamp == genpy.Duration(-6, -5)
    assert type(stamp + 1) is Stamp
    for wrong in ("1", None, True, [1]):
        with pytest.raises(TypeError):
            stamp + wrong
    with pytest.raises(TypeError):
        5 - stamp


def test_seconds_of_any_kind():
    assert Stamp(1.1).ns == 1_100_000_000
    assert Stamp.from_sec(1.1).ns == 1_100_000_000
    assert Stamp(1, 2_000_000_000).ns == 3_000_000_000


def test_lengths_of_hundreds_of_digits_are_exact():
    ns = 10**309 + 743_976_961
    assert seconds_to_ns(Decimal(f"{ns // 10**9}.{ns % 10**9:09}")) == ns


@pytest.mark.parametrize("ns", [-1, MAX_NS + 1])
def test_limits(ns):
    assert Stamp.from_ns(MAX_NS).secs == 2**32 - 1
    with pytest.raises(InvalidKey, match="2106"):
        Stamp.from_ns(ns)
    with pytest.raises(InvalidKey, match="2106"):
        to_ns(ns)


def test_row_is_kept_by_copies_but_not_by_arithmetic():
    stamp = Stamp.from_ns(7, node="r1", seq=3, table="t_1")
    for twin in (copy.copy(stamp), copy.deepcopy(stamp), pickle.loads(pickle.dumps(stamp))):  # noqa: S301
        assert (twin.ns, twin.node, twin.seq, twin.table) == (7, "r1", 3, "t_1")
    later = stamp + 1
    assert (later.node, later.seq, later.table) == (None, None, None)


@pytest.mark.parametrize(
    ("value", "ns"),
    [
        (genpy.Time(1, 2), 1_000_000_002),
        (17, 17),
        (numpy.int64(17), 17),
        (1.5, 1_500_000_000),
        (1368021980.1, 1368021980_100000000),
        (Decimal("0.1"), 100_000_000),
        ("17", 17),
        ("1.5", 1_500_000_000),
        ("1970-01-02", DAY),
        ("1970-01-02T00:00", DAY),
        (" 1970-01-02 00:00:01 ", DAY + 10**9),
        ("1970-01-02T00:00:00.5", DAY + 5 * 10**8),
        ("1970-01-02T00:00:00,000000001Z", DAY + 1),
        ("1970-01-02T01:30:00+01:30", DAY),
        ("1970-01-02T01:30:00+0130", DAY),
        ("1970-01-01T22:00:00.25-02", DAY + 25 * 10**7),
        (datetime(1970, 1, 2, 0, 0, 1, 5), DAY + 10**9 + 5000),  # without a zone: UTC
        (datetime(1970, 1, 2, 2, tzinfo=timezone(timedelta(hours=2))), DAY),
        (numpy.datetime64("1970-01-02"), DAY),
        (numpy.datetime64("1970-01-02T00:00:00.000000001"), DAY + 1),
        (pandas.Timestamp(1368021980123456789), 1368021980123456789),
        (pandas.Timestamp("1970-01-02T02:00:00.000000007", tz="Europe/Athens"), DAY + 7),
        (pandas.Timestamp("2100-01-01").as_unit("s"), 4102444800 * 10**9),
        (pandas.Series([DAY + 3]).astype("M8[ns]")[0], DAY + 3),
        (pandas.Series([DAY + 3]).astype("M8[ns]").values[0], DAY + 3),
    ],
)
def test_forms_of_a_time(value, ns):
    assert to_ns(value) == ns


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        b"17",
        genpy.Duration(1),
        timedelta(1),
        numpy.timedelta64(1, "s"),
        numpy.datetime64("NaT"),
        numpy.datetime64("2600-01-01"),
        numpy.datetime64(10**18, "Y"),
        pandas.NaT,
        datetime(1969, 12, 31),
        date(2013, 5, 8),
        float("nan"),
        float("inf"),
        -1,
        "",
        "yesterday",
        "-5",
        "1e3",
        "1970-13-01",
        "1970-02-30",
        "1970-01-01T24:00",
        "1970-01-01T00:00:60",
        "1970-01-01T00:00:00.0000000001",
        "1970-01-01T00:00+99:00",
        "1970-01-01T00:00+01:75",
        "1969-12-31",
        "2106-02-08",
        "٣",
        "9" * 5000,
    ],
)
def test_no_times(value):
    with pytest.raises(InvalidKey):
        to_ns(value)


ONE_SECOND = (1, 1.0, Decimal(1), numpy.int64(1), genpy.Duration(1), timedelta(seconds=1))
ONE_SECOND += (numpy.timedelta64(1, "s"), pandas.Timedelta(1, "s"))


@pytest.mark.parametrize("second", ONE_SECOND)
def test_forms_of_a_length_of_time(second):
    assert duration_ns(second) == 10**9
    assert Stamp(5) + second == second + Stamp(5) == Stamp(6)
    assert Stamp(5) - second == Stamp(4)
    assert time_or_length(second) == (10**9, True)


def test_lengths_keep_nanoseconds():
    assert duration_ns(pandas.Timedelta(10**18 + 7)) == 10**18 + 7
    for wrong in (pandas.NaT, numpy.timedelta64("NaT"), -timedelta(1), Stamp(1), datetime.max):
        with pytest.raises(InvalidKey, match="of time|not a time"):
            duration_ns(wrong)


def test_stamps_and_the_times_of_others():
    stamp = Stamp(10, 5)
    for other in (datetime(1970, 1, 1, 0, 0, 4), numpy.datetime64(4, "s"), pandas.Timestamp(4e9)):
        assert stamp - other == genpy.Duration(6, 5)
        assert stamp > other
        assert not stamp <= other
        assert other < stamp


def test_where_a_time_or_a_length_may_be_meant_a_number_means_what_it_does_elsewhere():
    now = 1_368_021_980
    assert time_or_length(600) == time_or_length(600.0) == (600 * 10**9, True)
    assert time_or_length(now + 0.5) == (now * 10**9 + 5 * 10**8, False)
    assert time_or_length(now * 10**9 + 1) == (now * 10**9 + 1, False)
    assert time_or_length(datetime(1970, 1, 2)) == (DAY, False)
    assert time_or_length(genpy.Time(5)) == (5 * 10**9, False)
    with pytest.raises(InvalidKey, match=rf"write seconds since 1970 as {now}\.0$"):
        time_or_length(now)
    for wrong in (-1, float("nan"), float("inf"), "600", None, True):
        with pytest.raises(InvalidKey):
            time_or_length(wrong)


def test_a_stamp_says_what_it_is():
    assert repr(Stamp(1, 5)) == "Stamp[1000000005: 1970-01-01T00:00:01.000000005Z]"
    assert repr(Stamp.from_ns(0, node="r1")) == "Stamp[0: 1970-01-01T00:00:00.000000000Z of r1]"


@given(st.text(max_size=40))
def test_any_text_is_a_time_or_an_error_of_ours(text):
    try:
        assert 0 <= to_ns(text) <= MAX_NS
    except InvalidKey:
        pass
