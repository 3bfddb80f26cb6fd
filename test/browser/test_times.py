# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times in the pages: read and written as everywhere else, and where an axis has its ticks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import MAX_NS, SECOND_NS
from cassandra_ros.messages.stamps import iso_time, written_time_ns

CALL = """
const [names, calls] = arguments;
return import("/modules/times.js").then((times) => calls.map(([name, ...given]) => {
  const values = given.map((text) => (names.includes(name) ? text : BigInt(text)));
  try {
    return String(times[name](...values));
  } catch (error) {
    return error.name;
  }
}));
"""
TICKS = """
const [start, end, most] = arguments;
return import("/modules/times.js").then((times) => {
  const found = times.ticks(BigInt(start), BigInt(end), most);
  return found.ticks.map((tick) => [String(tick.ns), tick.text, tick.major]);
});
"""
stamps = st.integers(0, MAX_NS) | st.integers(0, 10**13)
texts = (
    stamps.map(iso_time)
    | stamps.map(lambda ns: iso_time(ns)[:19] + "+05:30")
    | stamps.map(str)
    | stamps.map(lambda ns: f"{ns // SECOND_NS}.{ns % SECOND_NS:09d}")
    | st.sampled_from(
        ["", "now", "2013-02-30", "2013-05-08T25:00", "2013-05-08 14:06", "1.5", ".", "9" * 40]
    )
)


@pytest.fixture(scope="module")
def times(window, viewer):
    window.driver.get(viewer.at("/index.html"))
    return lambda *calls: window.run(CALL, ["parse"], [[str(v) for v in call] for call in calls])


def by_python(text):
    try:
        return str(written_time_ns(text))
    except InvalidKey:
        return "RangeError"


@given(st.lists(texts, min_size=20, max_size=40), st.lists(stamps, min_size=20, max_size=40))
@examples(max_examples=10)
def test_times_are_read_and_written_as_by_the_command_line(times, some, known):
    assert times(*(("parse", text) for text in some)) == list(map(by_python, some))
    assert times(*(("iso", ns) for ns in known)) == list(map(iso_time, known))
    written = times(*(("written", ns) for ns in known))
    assert [by_python(text) for text in written] == list(map(str, known))
    assert times(*(("parse", text) for text in written)) == list(map(str, known))


def test_times_are_short_for_people(times):
    ns = written_time_ns("2013-05-08T14:06:20.123456789Z")
    steps = {86_400: "2013-05-08", 60: "2013-05-08 14:06", 1: "2013-05-08 14:06:20"}
    calls = [("shown", ns, step * SECOND_NS) for step in steps]
    calls += [("shown", ns, 10**6), ("shown", ns, 1)]
    day = "2013-05-08 14:06:20"
    assert times(*calls) == [*steps.values(), f"{day}.123", f"{day}.123456789"]
    lengths = {
        12: "12 ns",
        1_500: "1.5 µs",
        2_000_000: "2 ms",
        1_250_000_000: "1.25 s",
        150 * SECOND_NS: "2 min 30 s",
        4 * 3600 * SECOND_NS: "4 h",
        90 * 3600 * SECOND_NS: "3 d 18 h",
    }
    assert times(*(("length", ns) for ns in lengths)) == list(lengths.values())


@pytest.mark.parametrize(
    ("length", "texts"),
    [
        ("2013-05-08T14:06:20.002Z", ["20.0005", "20.001"]),
        ("2013-05-08T14:06:30Z", ["14:06:22", "14:06:24"]),
        ("2013-05-09T14:06:20Z", ["18:00", "9 May"]),
        ("2013-06-20T00:00:00Z", ["13 May", "20 May"]),
        ("2015-05-08T00:00:00Z", ["Jul", "Oct", "2014"]),
        ("2099-05-08T00:00:00Z", ["2020", "2030"]),
    ],
)
def test_an_axis_has_whole_units_from_a_century_to_a_millisecond(window, times, length, texts):
    start, end = written_time_ns("2013-05-08T14:06:20Z"), written_time_ns(length)
    found = window.run(TICKS, str(start), str(end), 10)
    assert 2 <= len(found) <= 11
    assert all(start <= int(ns) <= end for ns, _, _ in found)
    shown = [text.lstrip("0") for _, text, _ in found]
    wanted = [
        text for text in texts if text in shown or any(each.startswith(text) for each in shown)
    ]
    assert wanted == texts, shown
