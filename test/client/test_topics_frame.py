# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""RosCassandra.toDataFrame: several topics at the same times give what a plain loop gives."""

from __future__ import annotations

import random
import struct
from datetime import timedelta

import genpy
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from std_msgs.msg import String
from suites import examples

from cassandra_ros.client import topics_frame
from cassandra_ros.errors import InvalidKey, InvalidName, InvalidOption, InvalidQuery, TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.tables.registry import Run

pandas = pytest.importorskip("pandas")

T0 = 1_600_000_000 * SECOND_NS
STEP_NS = 10_000_001
"""Times are multiples of it, so that equal times and equal distances are frequent."""
MS = 1_000_000
FORMATS = {"/one": "packed", "/two": "ros", "/three": "json"}
TYPE = "float32 v\nuint64 big\nstring s\nfloat64[2] pair\nint16[] some\ntime t\nduration d"


def times_of(seed):
    """Return times, ns, some of them equal, with long pauses."""
    rng, n, times = random.Random(seed), 0, []
    for _ in range(60):
        n += rng.choice([0, 1, 1, 2, 3, 5, 300])
        times.append(T0 + n * STEP_NS)
    return times


TIMES = {topic: times_of(seed) for seed, topic in enumerate(FORMATS)}


def value_of(n, field):
    """Return the value of the n-th message of a topic."""
    return {
        "v": n / 2,
        "big": 2**64 - 1 - n,
        "s": f"message {n}",
        "pair": [n / 3, -1.0],
        "some": list(range(n % 3)),
        "t": np.datetime64(T0 + n, "ns"),
        "d": np.timedelta64(n - 5, "ns"),
    }[field]


def wire_of(n):
    text, some = value_of(n, "s").encode(), value_of(n, "some")
    wire = struct.pack("<fQI", n / 2, 2**64 - 1 - n, len(text)) + text
    wire += struct.pack("<ddI", *value_of(n, "pair"), len(some)) + struct.pack(
        f"<{len(some)}h", *some
    )
    duration = genpy.Duration(0, n - 5)
    return wire + struct.pack("<IIii", 1_600_000_000, n, duration.secs, duration.nsecs)


@pytest.fixture(scope="module")
def stored(fresh):
    definition = parse_definition("t/Values", TYPE, None)
    with fresh() as store:
        for number, (topic, fmt) in enumerate(FORMATS.items(), 1):
            run = Run("r1", number, "recording", name="drive")
            options = {"nodeID": "r1", "format": fmt, "writer_id": number, "run": run}
            with store.messageWriter(**options) as writer:
                handle = writer.connect(api_connection(topic, definition, "/x"))
                for n, ns in enumerate(TIMES[topic]):
                    writer.write(handle, ns, n, wire_of(n))
        with store.messageWriter(nodeID="r2", format="packed") as writer:
            handle = writer.connect(api_connection("/other", definition, "/x"))
            writer.write(handle, T0, 0, wire_of(0))
        store.addTopic("/named", key_format="manual", nodeID="r1").addData(String("x"), key="a")
        store.addTopic("/empty", nodeID="r1")
        yield store


def latest(topic, ns, within):
    """Return the number of the last message at or before a time; None = none is near enough."""
    before = [n for n, other in enumerate(TIMES[topic]) if ns - within <= other <= ns]
    return before[-1] if before else None


def nearest(topic, ns, within):
    near = [
        (abs(other - ns), n) for n, other in enumerate(TIMES[topic]) if abs(other - ns) <= within
    ]
    return min(near)[1] if near else None


def check_rows(frame, times, chosen):
    """Check all columns, given the number of the message of each topic for each row."""
    assert frame.index.name == "KEY"
    assert frame.index.to_numpy().view(np.int64).tolist() == times
    for topic, numbers in chosen.items():
        keys = frame[f"{topic}.KEY"].to_numpy().view("M8[ns]")
        for row, n in enumerate(numbers):
            wanted = "NaT" if n is None else TIMES[topic][n]
            assert np.array_equal(keys[row], np.datetime64(wanted, "ns"), equal_nan=True)
    for name in frame.columns:
        topic, _, field = name.partition(".")
        for row, n in enumerate(chosen[topic]):
            found = frame[name].iloc[row]
            if field == "KEY":
                continue
            if n is None:
                assert found is None or pandas.isna(found), name
            elif field in ("pair", "some"):
                assert list(found) == value_of(n, field), name
            else:
                assert found == value_of(n, field), name


ENDS = st.one_of(st.none(), st.integers(-20, 2000))
ALL = {"topics": list(FORMATS), "low": None, "high": None, "fields": None}
SEARCH = settings(
    max_examples=examples(200),
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)
FIELDS = st.sampled_from([None, {"/one": ["v", "pair"], "two": "s", "/three": ["big", "some"]}])


def bounds(low, high):
    key, to_key = (None if n is None else Stamp.from_ns(T0 + n * STEP_NS) for n in (low, high))
    return {"key": key, "to_key": to_key, "nodeID": "r1"}


def within(ns, low, high):
    first = 0 if low is None else T0 + low * STEP_NS
    return first <= ns and (high is None or ns <= T0 + high * STEP_NS)


@pytest.mark.search
@SEARCH
@given(
    base=st.sampled_from(sorted(FORMATS)),
    topics=st.lists(st.sampled_from(sorted(FORMATS)), min_size=1, unique=True),
    near=st.sampled_from([0, 1, 9, 10, 11, 20, 3000]),
    low=ENDS,
    high=ENDS,
    fields=FIELDS,
)
@example(base="/one", near=20, **ALL)
@example(base="/two", near=3000, **{**ALL, "low": 100, "high": 500})
def test_the_nearest_messages_are_those_of_a_loop(stored, base, topics, near, low, high, fields):
    fields = fields and {
        name: each for name, each in fields.items() if "/" + name.strip("/") in topics
    }
    frame = stored.toDataFrame(
        topics, nearest=base, within=f"{near}ms", fields=fields, **bounds(low, high)
    )
    numbers = [n for n, ns in enumerate(TIMES[base]) if within(ns, low, high)]
    times = [TIMES[base][n] for n in numbers]
    chosen = {
        topic: numbers if topic == base else [nearest(topic, ns, near * MS) for ns in times]
        for topic in topics
    }
    check_rows(frame, times, chosen)


@pytest.mark.search
@SEARCH
@given(
    step=st.sampled_from([100_000_010, 333_333_333, 1_000_000_001]),
    topics=st.lists(st.sampled_from(sorted(FORMATS)), min_size=1, unique=True),
    near=st.sampled_from([0, 10, 20, 150, 3000]),
    low=ENDS,
    high=ENDS,
    fields=FIELDS,
)
@example(step=333_333_333, near=150, **ALL)
@example(step=100_000_010, near=3000, **{**ALL, "low": 100, "high": 500})
@example(step=100_000_010, near=0, **{**ALL, "high": -1})
def test_the_last_messages_before_regular_times_are_those_of_a_loop(
    stored, step, topics, near, low, high, fields
):
    fields = fields and {
        name: each for name, each in fields.items() if "/" + name.strip("/") in topics
    }
    every = timedelta(seconds=1) if step == SECOND_NS else genpy.Duration(0, step)
    frame = stored.toDataFrame(
        topics, every=every, within=f"{near}ms", fields=fields, **bounds(low, high)
    )
    last = T0 + high * STEP_NS if high is not None else max(TIMES[t][-1] for t in topics)
    first = T0 if low is None else T0 + low * STEP_NS
    readable = [
        ns
        for topic in topics
        for ns in TIMES[topic]
        if ns <= last and (low is None or ns >= first - near * MS)
    ]
    if low is None:
        first = min(readable, default=last + 1)
    if high is None:
        last = max(readable, default=-1)
    times = list(range(first, last + 1, step))
    chosen = {topic: [latest(topic, ns, near * MS) for ns in times] for topic in topics}
    check_rows(frame, times, chosen)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_near_message_may_be_outside_of_the_time_range(stored, sign):
    """One before the first row, and one after the last."""
    ns, partner = next(
        (ns, partner)
        for ns in TIMES["/one"]
        for partner in [nearest("/two", ns, SECOND_NS)]
        if partner is not None and (TIMES["/two"][partner] - ns) * sign > 0
    )
    time = Stamp.from_ns(ns)
    frame = stored.toDataFrame("/two", nearest="/one", key=time, to_key=time, nodeID="r1")
    assert frame["/two.s"].iloc[0] == value_of(partner, "s")


def test_integers_stay_integers_and_equal_times_keep_their_rows(stored):
    near = stored.toDataFrame(["/one", "two", "/two"], nearest="one", within=0, nodeID="r1")
    assert len(near) == len(TIMES["/one"]) > len(set(TIMES["/one"]))
    assert str(near["/one.big"].dtype) == "uint64" and str(near["/two.big"].dtype) == "UInt64"
    assert near["/one.big"].tolist() == [2**64 - 1 - n for n in range(len(near))]
    assert str(near["/two.t"].dtype) == "datetime64[ns]"
    assert str(near["/two.d"].dtype) == "timedelta64[ns]"
    assert str(near["/two.v"].dtype) == "float32"


def test_within_is_a_second_and_topics_may_be_empty(stored):
    frame = stored.toDataFrame(["/one", "/empty"], every="500ms", nodeID="r1")
    ages = (frame.index - frame["/one.KEY"]).dropna()
    assert ages.max() <= pandas.Timedelta("1s") and frame["/one.KEY"].isna().any()
    assert frame["/empty.KEY"].isna().all()
    assert len(stored.toDataFrame("/empty", every=1, nodeID="r1")) == 0
    assert len(stored.toDataFrame("/one", nearest="/empty", nodeID="r1")) == 0


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        ({}, InvalidOption, "give every='20ms'"),
        ({"topics": None}, InvalidName, "topics=None"),
        ({"topics": ["/one", 5]}, InvalidName, "5 is not a name of a topic"),
        ({"every": "1s", "nearest": "/one"}, InvalidOption, "give every='20ms'"),
        ({"every": 0}, InvalidOption, "above 0"),
        ({"every": "soon"}, InvalidOption, "'soon' is not"),
        ({"every": -1}, InvalidKey, "not a length of time"),
        ({"every": "1s", "within": None}, InvalidKey, "not a length of time"),
        ({"every": "1s", "fields": ["v"]}, InvalidOption, "mapping of topics"),
        ({"every": "1s", "fields": {"/two": "v"}}, InvalidOption, "has topic /two"),
        ({"every": "1s", "fields": {"/one": "w"}}, InvalidQuery, "w"),
        ({"nearest": "/nine"}, TopicNotFound, "/nine"),
        ({"nearest": "/other"}, InvalidOption, r"several robots \(r1, r2\)"),
        ({"nearest": "/named"}, InvalidOption, "keys of /named are names"),
    ],
)
def test_what_is_refused(stored, arguments, error, reason):
    with pytest.raises(error, match=reason):
        stored.toDataFrame(**{"topics": ["/one"], **arguments})


def test_robots_are_not_mixed_and_grids_are_bounded(stored, monkeypatch):
    both = ["/one", "/other"]
    with pytest.raises(InvalidOption, match="several robots"):
        stored.toDataFrame(both, every="1s")
    assert stored.toDataFrame(both, every="1s", nodeID="r2")["/one.KEY"].isna().all()
    assert stored.toDataFrame(both, every="1s", run="drive")["/other.KEY"].isna().all()
    monkeypatch.setattr(topics_frame, "MAX_GRID_ROWS", 10)
    with pytest.raises(InvalidOption, match="longer every="):
        stored.toDataFrame("/one", every="1s")
