# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events go out as metadata of an MCAP file, and come in again."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from std_msgs.msg import String
from topics.test_events import NAMES

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import BagError, StoreUnavailable
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_events import NAME, event_of, fields_of
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.topics.event_finder import Events

SEC = 10**9
T0 = 1_500_000_000 * SEC
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=5,
)


@given(
    st.text(min_size=1, max_size=50),
    st.integers(0, T0),
    st.none() | st.integers(0, T0),
    st.text(max_size=20),
    st.dictionaries(st.text(min_size=1, max_size=20), st.text(max_size=20), max_size=3),
    st.dictionaries(
        st.text(min_size=1, max_size=20), JSON.filter(lambda v: v != float("inf")), max_size=3
    ),
)
def test_the_fields_of_a_record_are_the_event(name, start, length, node, labels, values):
    try:
        json.dumps(values, allow_nan=False)
    except ValueError:
        return
    end = None if length is None else start + length
    event = Event(name, start, end, node, labels=labels, values=values)
    assert event_of(fields_of(event), "x.mcap") == event


@pytest.fixture
def store(rosCas):
    topic = rosCas.addTopic("/a", nodeID="husky")
    for n in range(20):
        topic.addData(String(str(n)), key=T0 + n * SEC, nodeID="husky")
    rosCas.addEvent("before", T0 - 9 * SEC, T0 - SEC, nodeID="husky")
    for n, name in enumerate(NAMES):
        values = {"n": n, "deep": {"a": [1.5, None]}}
        rosCas.addEvent(
            name, T0 + n * SEC, T0 + (n + 3) * SEC, nodeID="husky", labels={"é": "☃"}, values=values
        )
    rosCas.addEvent("of another", T0 + SEC, nodeID="jackal")
    rosCas.addEvent("lasts", T0 + 15 * SEC)
    return rosCas


def facts(event):
    return event.name, event.start_ns, event.end_ns, event.labels, event.values, event.id


def test_events_go_out_and_come_in_again(store, connect, new_keyspace, tmp_path):
    path = tmp_path / "a.mcap"
    report = export_bag(store, path, nodeID="husky")
    assert report.events == len(NAMES) + 1
    with open(path, "rb") as file:  # as another reader sees it
        found = [record for record in make_reader(file).iter_metadata() if record.name == NAME]
    assert {record.metadata["name"] for record in found} == {*NAMES, "lasts"}
    with connect(keyspace=new_keyspace) as other:
        for _ in range(2):
            done = import_bag(other, path, nodeID="husky")
            assert (done.events, done.warnings) == (len(NAMES) + 1, [])
        expected = [e for e in store.events(nodeID="husky") if e.name != "before"]
        events = list(other.events())
        assert {e.key for e in events} == {e.key for e in expected}
        assert [facts(e) for e in events] == [facts(e) for e in expected]
        assert {(e.node, e.writer) for e in events} == {("husky", done.writer_id)}
        # What was changed since stays.
        (lasting,) = other.events("lasts")
        other.endEvent(lasting, T0 + 16 * SEC)
        import_bag(other, path, nodeID="husky")
        assert [e.end_ns for e in other.events("lasts")] == [T0 + 16 * SEC]


def test_an_export_of_an_event_has_the_events_of_its_time(store, tmp_path):
    report = export_bag(store, tmp_path / "a.mcap", event="bump", nodeID="husky")
    assert (report.messages, report.events) == ({"/a": 4}, 4)
    report = export_bag(store, tmp_path / "a.bag", event="bump")
    assert report.events == 0  # bags have no metadata


def write(path, records):
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start("ros1", "test")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
        channel = writer.register_channel("/a", "ros1", schema)
        writer.add_message(channel, T0, b"\x01\0\0\0x", T0)
        for fields in records:
            writer.add_metadata(NAME, fields)
        writer.add_metadata("of another program", {"a": "b"})
        writer.finish()


def test_damaged_events_are_told_and_the_rest_is_stored(rosCas, tmp_path):
    good = fields_of(Event("good", T0, T0 + 1))
    bad = [
        {},
        {**good, "name": ""},
        {**good, "start_ns": "-1"},
        {**good, "start_ns": "9" * 30},
        {**good, "end_ns": str(T0 - 1)},
        {**good, "labels": "[1]"},
        {**good, "labels": "{"},
        {**good, "values": "[" * 5000},
        {**good, "values": '{"a": NaN}'},
        {**good, "id": "x" * 100},
        {**good, "node": "x" * 1000},
    ]
    write(tmp_path / "a.mcap", [*bad, good])
    report = import_bag(rosCas, tmp_path / "a.mcap")
    assert (report.messages, report.events) == (1, 1)
    assert sum("an event is not stored" in text for text in report.warnings) == len(bad)
    assert any("1 records of metadata are not stored" in text for text in report.warnings)
    assert [event.name for event in rosCas.events()] == ["good"]
    for fields in bad:
        with pytest.raises(BagError):
            event_of(fields, "x")


def test_a_store_that_goes_away_at_the_end_is_no_damaged_event(rosCas, tmp_path, monkeypatch):
    write(tmp_path / "a.mcap", [fields_of(Event("good", T0, T0 + 1))])

    def put(self, event):
        raise StoreUnavailable("the store does not answer")

    with monkeypatch.context() as away:
        away.setattr(Events, "put", put)
        with pytest.raises(StoreUnavailable):
            import_bag(rosCas, tmp_path / "a.mcap")
    assert import_bag(rosCas, tmp_path / "a.mcap").events == 1
    assert [event.name for event in rosCas.events()] == ["good"]


def test_the_verbs_tell_their_number(store, cassandra, capsys, tmp_path):
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", store.keyspace)
    path = str(tmp_path / "a.mcap")
    assert cassandra_bag.main(["export", path, "--event", "bump", *where]) == 0
    assert "5 events" in capsys.readouterr().out
    assert cassandra_bag.main(["import", path, "--node-id", "husky", *where]) == 0
    assert "with 5 events" in capsys.readouterr().out
