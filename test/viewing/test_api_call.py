# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of a question: read by their kinds, and nothing that is misspelt is ignored."""

from __future__ import annotations

import argparse

import pytest

from cassandra_ros.cli.options import read_times
from cassandra_ros.errors import InvalidKey, InvalidOption
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.route import KINDS, Parameter, Route
from cassandra_ros.viewing.routes import ROUTES

NS = 1368021980238582676


def call_of(kind, query, **options):
    route = Route("/x", lambda call: None, "X.", (Parameter("a", kind, "A.", **options),))
    return ApiCall(None, route, query, {})


READERS = {
    "text": ApiCall.text,
    "texts": ApiCall.texts,
    "lines": ApiCall.lines,
    "time": ApiCall.time_ns,
    "number": ApiCall.number,
    "count": ApiCall.count,
    "flag": ApiCall.flag,
}


def read(kind, *given, **options):
    return READERS[kind](call_of(kind, {"a": list(given)} if given else {}, **options), "a")


def test_every_kind_has_its_reader():
    assert set(READERS) == set(KINDS)
    for kind in KINDS:
        other = next(name for name in KINDS if name != kind)
        with pytest.raises(TypeError):
            READERS[other](call_of(kind, {}), "a")


@pytest.mark.parametrize(
    ("kind", "given", "value"),
    [
        ("text", ["a,b"], "a,b"),
        ("text", [""], None),
        ("texts", ["/a, /b", "/c,"], ("/a", "/b", "/c")),
        ("texts", [""], ()),
        ("lines", ["a,b", "", "c"], ("a,b", "c")),
        ("time", [str(NS)], NS),
        ("time", ["1368021980"], 1368021980 * 10**9),
        ("time", ["1368021980.238582676"], NS),
        ("time", ["2013-05-08T14:06:20.238582676Z"], NS),
        ("time", [""], None),
        ("number", ["-1.5e3"], -1500.0),
        ("count", ["10000000000000000"], 10**16),
        ("flag", [""], True),
        ("flag", ["TRUE"], True),
        ("flag", ["0"], False),
    ],
)
def test_a_value_is_read_by_its_kind(kind, given, value):
    assert read(kind, *given) == value


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        *(("time", text) for text in ("yesterday", "-1", "4294967296", "12345678901234567890")),
        *(("number", text) for text in ("x", "nan", "inf", "1e999")),
        *(("count", text) for text in ("-1", "1.0", "x", "1" * 19, "١")),
        ("flag", "perhaps"),
    ],
)
def test_what_is_of_another_kind_is_refused_with_what_is_meant(kind, text):
    with pytest.raises(InvalidOption, match=r"^a '") as raised:
        read(kind, text)
    assert text[:20] in str(raised.value)
    assert "1368021980.25" in str(raised.value) or KINDS[kind] in str(raised.value)


def test_what_is_missing_is_none_or_the_default():
    for kind in ("text", "texts", "time", "number", "count"):
        assert read(kind) is None
    assert read("flag") is False
    assert read("lines") == ()
    assert read("count", default=7) == 7
    assert read("count", "", default=7) == 7
    assert read("flag", default=True) is True
    assert read("flag", "false", default=True) is False


def test_what_stands_there_twice_or_is_unknown_or_missing_is_refused():
    with pytest.raises(InvalidOption, match="2 times"):
        read("count", "1", "2")
    with pytest.raises(InvalidOption, match="no parameter 'stat'; it has a"):
        call_of("time", {"stat": ["1"]})
    with pytest.raises(InvalidOption, match="needs the parameter a: A."):
        call_of("text", {"a": [""]}, required=True)
    call_of("time", {"token": ["secret"]})  # is read before


@pytest.mark.parametrize(
    "text", ["1368021980", "1368021980.25", "2013-05-08", "2013-05-08 14:06:20+02", str(NS), "999"]
)
def test_a_time_means_what_it_means_on_a_command_line(text):
    options = argparse.Namespace(start=text, end=None)
    assert read_times(options)[0].to_nsec() == read("time", text)


def test_every_parameter_of_every_route_says_what_it_is():
    for route in ROUTES:
        names = [parameter.name for parameter in route.parameters]
        assert len(set(names)) == len(names), route.path
        assert route.summary.endswith("."), route.path
        for parameter in route.parameters:
            assert parameter.kind in KINDS, (route.path, parameter.name)
            assert parameter.summary.endswith("."), (route.path, parameter.name)
            assert parameter.name != "token"


def test_the_error_of_a_time_names_the_parameter_once():
    with pytest.raises(InvalidOption) as raised:
        read("time", "tomorrow")
    assert isinstance(raised.value.__cause__, InvalidKey)
    assert str(raised.value).startswith("a 'tomorrow' is not a time of ROS: write seconds")
