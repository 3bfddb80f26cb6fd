# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events: stored, found by name, robot, run and time, ended and removed; and their time ranges."""

from __future__ import annotations

import threading
from datetime import datetime, timezone
from itertools import islice

import genpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from std_msgs.msg import String

from cassandra_ros.errors import (
    EventNotFound,
    InvalidKey,
    InvalidName,
    InvalidOption,
    RunNotFound,
)
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.read import ALWAYS, Read, TimeRange, Whose
from cassandra_ros.store.tables.event_table import SLOT_NS, Event, Names
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics import event_finder
from cassandra_ros.topics.event_times import EventTimes

SEC = 10**9
T0 = 1_500_000_000 * SEC
NAMES = [
    "bump",
    "Bump",
    'bump\'s "end"; DROP TABLE cr_event; --',
    "%_like\\",
    "two\nlines\t\0nul",
    "ünïcode ☃ \U0001f916",
    "\U0010ffff",
    "  ",
    "x" * 256,
]


def times(events):
    return [(event.name, event.start_ns, event.end_ns) for event in events]


def test_an_event_comes_back_as_it_was_added(rosCas):
    values = {"force": 12.5, "axis": "x", "hits": [1, 2], "hard": True, "none": None}
    added = rosCas.addEvent(
        "bump", T0, T0 + SEC, nodeID="husky", labels={"site": "lab"}, values=values
    )
    assert list(rosCas.events()) == [added]
    assert (added.node, added.labels, added.values) == ("husky", {"site": "lab"}, values)
    assert list(rosCas.events("bump")) == [added]
    assert added.key.startswith(f"{T0}-")


def test_a_keyspace_without_the_tables_reads_as_before(connect, new_keyspace, cql):
    def tables():
        rows = cql.execute(
            "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s", (new_keyspace,)
        )
        return {name for (name,) in rows}

    with connect(keyspace=new_keyspace) as store:
        store.addTopic("/a").addData(String("1"), key=T0)
        before = tables()
        assert list(store.events()) == list(store.events("bump", like=None)) == []
        with pytest.raises(EventNotFound, match="it holds none of a similar name"):
            list(store.readMessages(event="bump"))
        assert tables() == before
        event = store.addEvent("bump", T0)
        assert tables() == before | {"cr_event", "cr_event_slot"}
        # Events belong to a robot and a time, not to a topic.
        store.renameTopic("/a", "/b")
        store.removeTopic("/b")
        assert list(store.events()) == [event]


def test_names_with_every_character_are_told_apart(rosCas):
    added = {name: rosCas.addEvent(name, T0) for name in NAMES}
    for name, event in added.items():
        assert list(rosCas.events(name)) == [event]
    assert {event.name for event in rosCas.events()} == set(NAMES)
    assert [event.name for event in rosCas.events(like="bump%")] == ["bump", NAMES[2]]
    assert [event.name for event in rosCas.events(like="%☃%")] == [NAMES[5]]
    assert [event.name for event in rosCas.events(like="\U0010ffff%")] == ["\U0010ffff"]
    assert {event.name for event in rosCas.events(like="_ump")} == {"bump", "Bump"}
    for wrong in ("", "x" * 257, "\ud800", 5, None):
        with pytest.raises(InvalidName):
            rosCas.addEvent(wrong, T0)
    with pytest.raises(InvalidName, match="give one"):
        rosCas.events("bump", like="b%")


@pytest.mark.parametrize(
    "start",
    [
        T0,
        T0 / SEC,
        genpy.Time(T0 // SEC, 0),
        "2017-07-14T02:40:00Z",
        "1500000000.0",
        str(T0),
        datetime(2017, 7, 14, 2, 40, tzinfo=timezone.utc),
    ],
)
def test_times_have_every_form(rosCas, start):
    assert rosCas.addEvent("e", start, start).time_range == TimeRange(T0, T0)


def test_what_no_event_can_be_is_refused(rosCas):
    with pytest.raises(InvalidKey, match="its end, .*, is before its start"):
        rosCas.addEvent("bump", T0, T0 - 1)
    with pytest.raises(InvalidKey, match=r"seconds are written 1500000000\.0"):
        rosCas.addEvent("bump", 1_500_000_000)
    with pytest.raises(InvalidKey):
        rosCas.addEvent("bump", "yesterday")
    with pytest.raises(InvalidName):
        rosCas.addEvent("bump", T0, nodeID=5)
    with pytest.raises(InvalidName):
        rosCas.addEvent("bump", T0, labels={"a": 1})
    with pytest.raises(InvalidName, match="a label without a name cannot be used: give labels"):
        rosCas.addEvent("bump", T0, labels={"": "a"})
    for values in ({"a": float("nan")}, {"a": {1}}, {"": 1}, [1], {"a": "x" * 70_000}):
        with pytest.raises(InvalidName):
            rosCas.addEvent("bump", T0, values=values)
    with pytest.raises(RunNotFound):
        rosCas.addEvent("bump", T0, run="nowhere")
    assert list(rosCas.events()) == []


def test_an_event_is_ended_and_removed_by_itself_or_its_key(rosCas):
    first, second = rosCas.addEvent("door", T0, values={"a": 1}), rosCas.addEvent("door", T0)
    assert [event.end_ns for event in rosCas.events("door")] == [None, None]
    assert list(rosCas.events("door", "2100-01-01T00:00:00Z")) == list(rosCas.events("door"))
    ended = rosCas.endEvent(first, T0 + 5 * SEC)
    assert (ended.end_ns, ended.values, ended.key) == (T0 + 5 * SEC, {"a": 1}, first.key)
    assert times(rosCas.events(key=T0 + 6 * SEC)) == [("door", T0, None)]
    now = rosCas.endEvent(second.key)
    assert now.end_ns > T0 and now.end_ns % SEC
    with pytest.raises(InvalidKey, match="before its start"):
        rosCas.endEvent(second, T0 - 1)
    rosCas.removeEvent(first)
    rosCas.removeEvent(second.key)
    assert list(rosCas.events()) == []
    for gone in (first, second.key, "bump", "", "1-", f"{T0}-x", "9" * 5000 + "-1"):
        with pytest.raises(EventNotFound):
            rosCas.removeEvent(gone)
        with pytest.raises(EventNotFound):
            rosCas.endEvent(gone, T0)
    with pytest.raises(InvalidOption):
        rosCas.removeEvent(7)


def test_events_are_of_robots_and_runs(rosCas):
    rosCas.messageWriter(writer_id=7, nodeID="husky", run=Run("husky", 7, "api", name="x")).close()
    of_all = rosCas.addEvent("e", T0)
    husky = rosCas.addEvent("e", T0 + 1, nodeID="husky")
    jackal = rosCas.addEvent("e", T0 + 2, nodeID="jackal")
    of_run = rosCas.addEvent("e", T0 + 3, nodeID="husky", run="x")
    other_run = rosCas.addEvent("e", T0 + 4, nodeID="husky", run="x")
    rosCas.catalog.keyspace.events.put(Event("e", T0 + 5, writer=9))
    assert of_run.writer == other_run.writer == 7
    assert list(rosCas.events("e", nodeID="husky"))[:4] == [of_all, husky, of_run, other_run]
    assert list(rosCas.events("e", run="x")) == [of_all, husky, jackal, of_run, other_run]
    assert list(rosCas.events("e", to_key=T0 + 2)) == [of_all, husky, jackal]


def test_two_programs_add_events_at_once(connect, keyspace):
    with connect(keyspace=keyspace) as one, connect(keyspace=keyspace) as two:
        work = [
            threading.Thread(target=lambda s=store: [s.addEvent("e", T0) for _ in range(50)])
            for store in (one, two)
        ]
        for each in work:
            each.start()
        for each in work:
            each.join()
        assert len({event.key for event in one.events("e")}) == 100


def test_events_of_many_slots_are_found_by_time(rosCas):
    table = rosCas.catalog.keyspace.events
    starts = [n * SLOT_NS // 3 for n in range(1, 60)]
    for n, start in enumerate(starts):
        table.put(Event(f"n{n % 3}", start, start + SEC))
    table.put(Event("long", starts[2], starts[50]))
    every = [event.start_ns for event in rosCas.events()]
    assert every == sorted([*starts, starts[2]])
    at = starts[40]
    assert times(rosCas.events(key=at, to_key=at)) == [
        ("long", starts[2], starts[50]),
        ("n1", at, at + SEC),
    ]
    assert times(rosCas.events("n1", key=at, to_key=at)) == [("n1", at, at + SEC)]
    assert list(rosCas.events("n0", key=starts[40] + 1, to_key=starts[41])) == []


def test_a_lookup_by_name_reads_the_slots_of_the_name_only(rosCas):
    table = rosCas.catalog.keyspace.events._table
    for n in range(1, 40):
        table.put(Event("often", n * SLOT_NS))
    table.put(Event("rare", 20 * SLOT_NS + 5))
    assert table._slots(Names("rare", exact=True), ALWAYS) == [20]
    assert len(table._slots(Names("often", exact=True), TimeRange(0, 5 * SLOT_NS))) == 5


def test_events_are_read_a_few_slots_at_once(rosCas, monkeypatch):
    table = rosCas.catalog.keyspace.events._table
    for n in range(1, 30):
        table.put(Event("e", n * SLOT_NS))
    asked = []
    select_many = table._tables.select_many

    def counting(name, names, where, params, what):
        asked.append(len(params))
        return select_many(name, names, where, params, what)

    monkeypatch.setattr(table._tables, "select_many", counting)
    assert len(list(islice(rosCas.events("e"), 3))) == 3
    assert asked == [4]


def test_too_many_events_are_refused_where_all_are_needed(rosCas, monkeypatch):
    monkeypatch.setattr(event_finder, "MOST_EVENTS", 3)
    topic = rosCas.addTopic("/a")
    for n in range(4):
        topic.addData(String(str(n)), key=T0 + n)
        rosCas.addEvent("e", T0 + n, T0 + n)
    with pytest.raises(InvalidOption, match="more than 3 events"):
        rosCas.readMessages(event="e")
    assert len(list(rosCas.readMessages(event="e", to_key=T0 + 2))) == 3


RANGES = st.lists(
    st.tuples(st.sampled_from(["", "h", "j"]), st.integers(0, 60), st.integers(0, 20)), max_size=12
)


@settings(deadline=None)
@given(RANGES, st.integers(0, 5), st.integers(0, 5), st.integers(0, 40), st.integers(0, 40))
def test_parts_hold_exactly_the_messages_of_the_events(ranges, before, after, low, length):
    events = sorted((Event("e", t, t + n, node) for node, t, n in ranges), key=lambda e: e.start_ns)
    found = EventTimes(events, before, after)
    whole = Read(TimeRange(low, low + length), Whose(("h", "j", "k")))
    parts = found.reads(whole)
    assert [p.time_range.low for p in parts] == sorted(p.time_range.low for p in parts)
    for one, two in zip(parts, parts[1:]):
        assert one.time_range.high < two.time_range.low
    for t in range(low, low + length + 1):
        for node in ("h", "j", "k"):
            expected = any(
                e.node in ("", node) and e.start_ns - before <= t <= e.end_ns + after
                for e in events
            )
            inside = [
                part
                for part in parts
                if part.time_range.low <= t <= part.time_range.high and node in part.whose.nodes
            ]
            assert len(inside) == expected
            assert found.holds(node, "", t) == expected
            in_span = any(a <= t <= b for a, b in found.spans(low, low + length))
            assert in_span >= expected


def test_the_time_before_and_after_an_event_counts_where_the_event_is_not_read(rosCas):
    """An event ends before the time that is read, or begins after it; its margins reach into it."""
    topic = rosCas.addTopic("/a")
    for n in range(40):
        topic.addData(String(str(n)), key=T0 + n * SEC)
    rosCas.addEvent("early", T0 + 5 * SEC, T0 + 10 * SEC)
    rosCas.addEvent("late", T0 + 30 * SEC, T0 + 35 * SEC)

    def read(*event):
        rows = rosCas.readMessages("/a", T0 + 12 * SEC, T0 + 28 * SEC, event=event)
        return [int(row.message().data) for row in rows]

    assert read("early", 0, 4) == [12, 13, 14]
    assert read("late", 3, 0) == [27, 28]
    for event in (("early", 4, 1), ("late", 1, 3)):
        with pytest.raises(EventNotFound):
            read(*event)


@pytest.mark.parametrize("order", ["", " ORDER BY KEY DESC"])
def test_pages_inside_events_leave_no_message_out(rosCas, order):
    """Messages of several robots at one time are on different pages."""
    for node in ("", "husky", "jackal"):
        with rosCas.messageWriter(nodeID=node) as writer:
            handle = writer.connect(api_connection("/a", definition_of(String), "/x"))
            for n in range(8):
                writer.write(handle, T0 + n * SEC, n, serialize(String(str(n))))
    rosCas.addEvent("bump", T0 + SEC, T0 + 2 * SEC)
    rosCas.addEvent("bump", T0 + 5 * SEC, T0 + 6 * SEC)
    asked = f"SELECT KEY, NODE FROM /a WHERE EVENT 'bump'{order}"
    whole = list(rosCas.executeCQL(asked))
    assert len(whole) == 4 * 3
    for size in (1, 2, 5):
        found, cursor, page = [], "", whole
        while page:
            with rosCas.statements.select(asked, limit=size, after=cursor) as result:
                page = list(result)
                cursor = result.cursor
            found += page
        assert found == whole
