# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows around hits: how they merge, and what is played in them."""

from __future__ import annotations

import itertools
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from playing.robots import SEC, T0, Robot, played, texts

from cassandra_ros.errors import (
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.playing import read_ahead
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.playing.read_ahead import ReadAhead
from cassandra_ros.read import TimeRange
from cassandra_ros.store.tables.registry import Loss, LossKind
from cassandra_ros.topics.event_finder import merge_windows

TIMES = st.integers(0, 60)


@given(st.lists(TIMES), TIMES, TIMES, TIMES, TIMES)
def test_windows_cover_just_what_is_near_a_hit(hits, before, after, low, high):
    bounds = TimeRange(min(low, high), max(low, high))
    inside = sorted(hit for hit in hits if bounds.low <= hit <= bounds.high)
    windows = list(merge_windows(inside, before, after, bounds))
    covered = [t for window in windows for t in range(window.low, window.high + 1)]
    near = {t for hit in inside for t in range(hit - before, hit + after + 1)}
    assert covered == [t for t in range(bounds.low, bounds.high + 1) if t in near]
    assert all(one.high + 1 < two.low for one, two in zip(windows, windows[1:]))


@pytest.fixture(scope="module")
def filled(fresh):
    """A battery that falls at 20, 23 and 60 s, a tick each second, latched maps between."""
    with fresh() as rosCas:
        with Robot(rosCas, 1, "r1") as robot:
            for n in range(100):
                robot.send("/battery", n, "low" if n in (20, 23, 60) else "high")
                robot.send("/tick", n + 0.5, f"t{n}")
                if n in (0, 24, 40, 45, 80):
                    robot.send("/map", n + 0.25, f"m{n}", latched=True)
            robot.send("/once", 99, "o", latched=True)
        yield rosCas


AROUND = PlaySelection(around="/battery: data = 'low'", before=2, after=1.5)


def test_only_what_is_near_a_hit_is_played(filled):
    stream = PlayStream(PlayedKeyspace(filled.catalog), AROUND)
    wanted = [(T0 + 18 * SEC, T0 + 24 * SEC + SEC // 2), (T0 + 58 * SEC, T0 + 61 * SEC + SEC // 2)]
    assert stream.windows == wanted
    assert stream.start_ns == wanted[0][0]
    found = played(stream)
    ticks = [text for topic, _, text in found if topic == "/tick"]
    assert ticks == ["t18", "t19", "t20", "t21", "t22", "t23", "t24", "t58", "t59", "t60", "t61"]
    assert [t for topic, t, _ in found if topic == "/battery"][-5:] == [24, 58, 59, 60, 61]
    lows = [p.window.low for p in stream.messages()]
    assert sorted(set(lows)) == [low for low, _ in wanted] and lows == sorted(lows)


def test_a_window_begins_with_what_was_latched_in_the_gap(filled):
    stream = PlayStream(PlayedKeyspace(filled.catalog), AROUND)
    assert texts(p.row for p in stream.latched(stream.start_ns)) == ["m0"]
    maps = [(t, text) for topic, t, text in played(stream) if topic == "/map"]
    # m24 was played in the first window; of the gap's two the last, as the window begins.
    assert maps == [(24.25, "m24"), (58, "m45")]
    # Who jumps into the gap begins with the next window.
    gap = T0 + 30 * SEC
    assert texts(p.row for p in stream.latched(gap)) == ["m45"]
    assert played(stream, gap)[0] == ("/battery", 58, "high")
    assert stream.latched(T0 + 70 * SEC) == played(stream, T0 + 70 * SEC) == []


def test_nothing_is_latched_anew_where_nothing_changed(filled):
    again = PlaySelection(
        ["/map", "/tick"], around=("/tick", ("data IN (?, ?)", ["t24", "t30"])), before=1, after=0
    )
    assert played(PlayStream(PlayedKeyspace(filled.catalog), again)) == [
        ("/tick", 23.5, "t23"),
        ("/map", 24.25, "m24"),
        ("/tick", 24.5, "t24"),
        ("/tick", 29.5, "t29"),
        ("/tick", 30.5, "t30"),
    ]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_store_that_goes_away_between_what_was_latched_in_a_gap(rosCas, monkeypatch):
    monkeypatch.setattr(read_ahead, "RETRY_SEC", 0.001)
    with Robot(rosCas, 1, "r1") as robot:
        for hit in (0, 10, 20):
            for n, topic in enumerate(("/a", "/b", "/c")):
                robot.send(topic, hit - 5 + n, f"{topic}{hit}", latched=True)
            robot.send("/hit", hit, "now")
            robot.send("/tick", hit, "now")
    stream = PlayStream(
        PlayedKeyspace(rosCas.catalog),
        PlaySelection(around="/hit: data = 'now'", before=0, after=1),
    )
    every = [p.row.key for p in stream.messages()]
    assert len(every) == 12

    for failing in (2, 3, 4, 5):
        failures = iter([failing])

        def begin(t, failures=failures):
            count = next(failures, None)
            yield from itertools.islice(stream.messages(t), count)
            if count is not None:
                raise StoreUnavailable("away")

        assert [p.row.key for p in taken(begin, stream.start_ns)] == every, failing


def taken(begin, t):
    """Take all that a reader gives."""
    changed, found = threading.Condition(), []
    reader = ReadAhead(begin, t, 1 << 20, changed, lambda played, exc: None)
    with changed:
        while reader.await_next(180):
            found.append(reader.next_message())
            if found[-1] is None:
                return found[:-1]
    raise AssertionError("nothing came")


def test_start_and_end_bound_the_windows(filled):
    selection = PlaySelection(["/tick"], around=AROUND.around, before=2, after=2, start=21, end=60)
    # Seconds count from the first tick, at 0.5.
    stream = PlayStream(PlayedKeyspace(filled.catalog), selection)
    assert stream.windows == [
        (T0 + 21 * SEC + SEC // 2, T0 + 25 * SEC),
        (T0 + 58 * SEC, T0 + 60 * SEC + SEC // 2),
    ]


def test_windows_that_touch_are_one(filled):
    whole = PlayStream(
        PlayedKeyspace(filled.catalog),
        PlaySelection(around="/battery: data > 'a'", before=0.5, after=0.5),
    )
    assert played(whole) == played(PlayStream(PlayedKeyspace(filled.catalog), PlaySelection()))
    assert whole.windows == [(T0, whole.end_ns)]


def channels(store, **options):
    stream = PlayStream(PlayedKeyspace(store.catalog), PlaySelection(**options))
    return stream, [channel.topic for channel in stream.channels()]


def test_what_is_announced_is_what_is_played(filled):
    around = {"around": "/battery: data = 'low'", "before": 2, "after": 1.5}
    stream, topics = channels(filled, **around)
    assert (stream.start_ns, stream.end_ns) == (T0 + 18 * SEC, T0 + 61 * SEC + SEC // 2)
    times = [(t - T0) / SEC for t in (stream.end_ns, T0 + 19 * SEC, T0 + 40 * SEC)]
    assert times == [61.5, 19, 40]
    lengths = [stream.played_ns(t) / SEC for t in (stream.end_ns, T0 + 19 * SEC, T0 + 40 * SEC)]
    assert lengths == [6.5 + 3.5, 1, 6.5]
    # /once came later.
    assert topics == ["/battery", "/map", "/tick"]


@pytest.mark.parametrize(
    ("options", "topics"),
    [
        # Each topic has messages before and after, the one at 41.5 s alone in the time.
        ({"start": 41.2, "end": 41.8}, ["/map", "/tick"]),
        ({"start": 40.1, "end": 40.3}, ["/map"]),
        ({"start": 40.6, "end": 41, "exclude": "/map"}, ["/battery"]),
        ({"start": 19, "end": 24, "where": {"tick": "data = 't30'"}}, ["/battery", "/map"]),
        (
            {"start": 19, "end": 24, "where": {"tick": "data = 't20'"}},
            ["/battery", "/map", "/tick"],
        ),
    ],
)
def test_a_topic_without_a_message_in_the_time_is_not_announced(filled, options, topics):
    assert channels(filled, **options)[1] == topics


def test_what_is_announced_of_events(rosCas):
    with Robot(rosCas, 1, "r1") as one, Robot(rosCas, 2, "r2") as two:
        for n in range(100):
            one.send("/tick", n, "t")
            two.send("/other", n, "o")
        for t in (5, 80):
            one.send("/rare", t, "r")
    for begin in (20, 50):
        rosCas.addEvent("brake", T0 + begin * SEC, T0 + (begin + 2) * SEC, nodeID="r1")
    for topic, node, t in (("/tick", "r1", 21), ("/tick", "r1", 30), ("/other", "r2", 21)):
        loss = Loss(topic, node, 1, LossKind.BUFFER_FULL, T0 + t * SEC, T0 + t * SEC, 1)
        rosCas.catalog.keyspace.registry.put_loss(loss)
    stream, topics = channels(rosCas, event="brake")
    assert topics == ["/tick"]
    assert stream.played_ns(stream.end_ns) == 4 * SEC
    assert len(played(stream)) == 6
    assert [(loss.topic, loss.first_ns) for loss in stream.losses()] == [("/tick", T0 + 21 * SEC)]
    assert channels(rosCas, event=("brake", 0, 28))[1] == ["/rare", "/tick"]


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"around": "/battery"}, InvalidOption, "names no hits"),
        ({"around": ": x = 1"}, InvalidOption, "names no hits"),
        ({"around": "/batery: data = 'low'"}, TopicNotFound, "/battery"),
        ({"around": "/battery: data ="}, InvalidQuery, "data ="),
        ({"around": "/battery: voltage < 11"}, InvalidQuery, "voltage"),
        ({"around": "/battery: data = 'none'"}, MessageNotFound, "satisfies \"data = 'none'\""),
        ({"before": -1}, InvalidOption, "before -1"),
        ({"after": "soon"}, InvalidOption, "after 'soon'"),
    ],
)
def test_bad_input_is_named(filled, changes, error, text):
    selection = PlaySelection(**{"around": AROUND.around, **changes})
    with pytest.raises(error, match=text):
        PlayStream(PlayedKeyspace(filled.catalog), selection)


def test_what_one_latched_while_only_the_other_played(rosCas):
    with Robot(rosCas, 1, "r1") as one, Robot(rosCas, 2, "r2") as two:
        for t in (10, 30, 50):
            one.send("/hit", t, "h")
            if t != 30:
                two.send("/tick", t, "t")
        two.send("/map", 20, "m", latched=True)
    stream = PlayStream(
        PlayedKeyspace(rosCas.catalog), PlaySelection(around="/hit: data = 'h'", before=1, after=1)
    )
    assert [(t, text) for _, t, text in played(stream)] == [
        *((10, "h"), (10, "t"), (30, "h"), (49, "m"), (50, "h"), (50, "t")),
    ]
