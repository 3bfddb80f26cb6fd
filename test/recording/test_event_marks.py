# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events that begin and end by conditions and calls, and their way to the store."""

from __future__ import annotations

from concurrent.futures import Future

import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from nodes.children import await_true
from nodes.raw_publisher import header_of, message
from std_msgs.msg import Int32

from cassandra_ros.errors import InvalidKey, InvalidName, InvalidOption, StoreUnavailable
from cassandra_ros.recording import event_marks
from cassandra_ros.recording.event_marks import EventMarks, EventWatch, EventWriter, WatchedEvent
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.topic_settings import read_settings, recording_settings

SEC = 10**9
TEXT = """
topics: [{pattern: /n, rate_limit: 1}]
events:
- {name: bump, topic: /n, where: data > 5, hold: 2s, labels: {site: lab}}
"""


def states(put):
    """The last state of each event: (start, end)."""
    return sorted({event.key: (event.start_ns, event.end_ns) for event in put}.values())


@given(st.lists(st.booleans(), max_size=40), st.integers(0, 4))
def test_an_event_lasts_while_the_condition_holds(true, hold):
    put = []
    rule = WatchedEvent("e", "/n", "", hold)
    watch = EventWatch(rule, lambda header, t, wire: true[t], "husky", put.append, lambda: 7)
    for t in range(len(true)):
        watch.see({}, t, b"")
    watch.end()
    # Times at which it holds are joined while fewer than ``hold`` pass from the last one.
    expected = []
    for t in (t for t, holds in enumerate(true) if holds):
        last = expected[-1][1] if expected else t
        if expected and not any(u >= last + hold for u in range(last + 1, t)):
            expected[-1] = expected[-1][0], t
        else:
            expected.append((t, t))
    assert states(put) == expected
    assert {(event.name, event.node, event.writer) for event in put} <= {("e", "husky", 7)}


@pytest.mark.parametrize("holds", [True, False])
def test_an_event_ends_when_the_clock_is_set_back(holds):
    """As when a simulation begins anew."""
    put = []
    rule = WatchedEvent("e", "/n", "", SEC)
    watch = EventWatch(rule, lambda header, t, wire: wire == b"1", "", put.append, lambda: 7)
    watch.see({}, 100 * SEC, b"1")
    watch.see({}, 5 * SEC, b"1" if holds else b"0")
    watch.see({}, 9 * SEC, b"1")
    watch.see({}, 10 * SEC, b"0")
    begun = 5 if holds else 9
    assert states(put) == [(begun * SEC, 9 * SEC), (100 * SEC, 100 * SEC)]


def test_the_settings_name_events_that_see_each_message_before_its_filter():
    options = RecorderOptions(config=read_settings(TEXT), node_id="h")
    put = []
    filters, header = (
        Filters(recording_settings(options), "h", put.append, lambda: 3),
        header_of(Int32),
    )
    came = [(0, 1), (100, 6), (200, 7), (1900, 1), (2300, 9), (5000, 0), (5100, 8)]
    kept = [n for ms, n in came if filters.passes("/n", header, ms * 10**6, message(Int32(n)))]
    assert len(kept) < len(came)
    filters.end_events()
    ms = [(start // 10**6, end // 10**6) for start, end in states(put)]
    assert ms == [(100, 2300), (5100, 5100)]
    assert put[0].labels == {"site": "lab"} and put[0].end_ns is None
    # A topic without an event, or a filter, costs nothing.
    assert filters.of("/else") is None
    assert Filters(recording_settings(options), "h").passes("/n", header, 0, message(Int32(9)))


def test_the_example_names_events():
    text = (ROOT / "config/recorder.yaml").read_text(encoding="utf-8")
    assert [event.name for event in read_settings(text).events] == ["bump", "battery low"]
    assert read_settings("").events == []
    assert read_settings("topics: []").events == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("events: {a: b}", "must be a list"),
        ("events: [{name: e}]", "not a mapping with name, topic and where"),
        ("events: [{name: '', topic: /a, where: a = 1}]", "name=''"),
        ("events: [{name: e, topic: 'a b', where: a = 1}]", "not a name of a ROS topic"),
        ("events: [{name: e, topic: /a, where: 'a ='}]", "event 'e'"),
        ("events: [{name: e, topic: /a, where: \"EVENT 'x'\"}]", "stored messages only"),
        ("events: [{name: e, topic: /a, where: a = 1, hold: soon}]", "not a duration"),
        ("events: [{name: e, topic: /a, where: a = 1, hodl: 1}]", "did you mean hold?"),
        ("events: [{name: e, topic: /a, where: a = 1, labels: 5}]", "not a mapping"),
        ("evnets: []", "topics and events"),
    ],
)
def test_what_is_wrong_with_an_event_is_named(text, said):
    with pytest.raises(InvalidOption, match="my.yaml cannot be used") as caught:
        read_settings(text, "my.yaml")
    assert said in str(caught.value)


def test_a_condition_that_cannot_be_checked_begins_no_event(caplog):
    text = "events: [{name: e, topic: /n, where: nothing > 5}]"
    put = []
    filters = Filters(
        recording_settings(RecorderOptions(config=read_settings(text))), put=put.append
    )
    assert filters.passes("/n", header_of(Int32), 0, message(Int32(9)))
    assert put == []
    assert "event e does not begin by topic /n" in caplog.text


def test_one_call_begins_and_the_next_ends():
    put = []
    marks = EventMarks(put.append)
    first = marks.mark("door", 5, "h", {"a": "1"}, {"x": 1}, 7)
    other = marks.mark("door", 6, "j")
    assert (first.end_ns, first.writer, other.end_ns) == (None, 7, None)
    with pytest.raises(InvalidName):
        marks.mark("", 7)
    ended = marks.mark("door", 8, "h", {"b": "2"}, {"x": 2})
    assert (ended.key, ended.end_ns) == (first.key, 8)
    assert (ended.labels, ended.values) == ({"a": "1", "b": "2"}, {"x": 2})
    assert marks.mark("door", 9, "h").key != first.key
    marks.end_all(5)  # the clock went back
    assert {event.key: event.end_ns for event in put}[other.key] == 6
    assert all(end is not None for _, end in states(put))
    marks.end_all(20)
    assert len(put) == 6


def test_an_end_before_the_start_is_refused_where_events_are_stored_later():
    put = []
    marks = EventMarks(put.append)
    marks.mark("door", 5 * SEC)
    with pytest.raises(InvalidKey, match="the clock was set back"):
        marks.mark("door", 4 * SEC)
    assert len(put) == 1
    assert marks.mark("door", 6 * SEC).end_ns == 6 * SEC


def test_a_mark_that_cannot_be_stored_is_as_before(rosCas):
    marks = EventMarks(rosCas.catalog.keyspace.events.put)
    begun = marks.mark("door", 5 * SEC)
    with pytest.raises(InvalidKey):
        marks.mark("door", 4 * SEC)
    assert marks.mark("door", 6 * SEC).key == begun.key
    assert [event.end_ns for event in rosCas.events("door")] == [6 * SEC]


def test_events_wait_for_the_store(rosCas, monkeypatch):
    monkeypatch.setattr(event_marks, "RETRY_SEC", 0.01)
    store = Future()
    writer = EventWriter(store)
    marks = EventMarks(writer.put)
    marks.mark("a", SEC)
    marks.mark("a", 2 * SEC)
    marks.mark("b", 3 * SEC)
    store.set_result(rosCas.catalog)
    wanted = [("a", 2 * SEC), ("b", None)]
    await_true(lambda: [(e.name, e.end_ns) for e in rosCas.events()] == wanted)
    writer.close()  # waits for some seconds, no more


def test_events_that_are_lost_are_told(rosCas, monkeypatch, caplog):
    monkeypatch.setattr(event_marks, "RETRY_SEC", 0.01)
    monkeypatch.setattr(event_marks, "END_SEC", 0.1)
    monkeypatch.setattr(event_marks, "MAX_WAITING", 2)
    store = Future()
    store.set_exception(StoreUnavailable("away"))
    writer = EventWriter(store)
    marks = EventMarks(writer.put)
    for name in ("a", "b", "c"):
        marks.mark(name, SEC)
    writer.close()
    assert "3 events are not stored" in caplog.text and "a, b" in caplog.text
