# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What there is: keyspace, topics, runs and marks, as JSON."""

from __future__ import annotations

import pytest
from std_msgs.msg import Int64, String
from viewers import running_viewer

from cassandra_ros import Stamp
from cassandra_ros.errors import AccessDenied
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.stamps import to_ns
from cassandra_ros.store.rows import row_counts as counting
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.viewing import viewer_context

NS = 1368021980238582676
SECOND = 10**9


def write(store, writer_id, run, topic, message, count):
    kind = type(message)
    header = {"type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
    connection = live_connection(topic, header)
    with store.messageWriter(nodeID=run.node, writer_id=writer_id, run=run) as writer:
        handle = writer.connect(connection)
        for number in range(count):
            writer.write(handle, NS + number * SECOND, number, serialize(message))


@pytest.fixture(scope="module")
def stored(fresh):
    """Two robots, one of which lost something; a topic in two formats; one without messages."""
    with fresh() as store:
        red = Run("red", 7, "recording", name="walk", labels={"site": "lab", "night": ""})
        write(store, 7, red, "/a", String("x"), 3)
        imported = Run("blue", 8, "import", source="a.bag", labels={"content": "abc", "who": "me"})
        write(store, 8, imported, "/a", String("y"), 2)
        topic = store.addTopic("/b", "json", msg_type="std_msgs/Int64", comment="counts")
        topic.addData(Int64(1), key=Stamp.from_ns(NS))
        topic.setMeta(unit="m")
        store.addTopic("/b", "binary", msg_type="std_msgs/Int64").addData(Int64(2), key=NS + SECOND)
        store.addTopic("/none", msg_type="std_msgs/Int64", ttl=3600)
        put = store.catalog.keyspace.registry.put_loss
        put(Loss("/a", "red", 7, LossKind.BUFFER_FULL, NS + 5, NS + 9, 4))
        put(Loss("/gone", "blue", 9, LossKind.UNHEARD, NS - 20, NS - 10, 0))
        yield store


@pytest.fixture(scope="module")
def viewer(stored):
    with running_viewer(stored) as running:
        yield running


def test_the_keyspace_says_which_there_are(viewer, stored):
    found = viewer.get("/api/keyspace")
    assert (found["keyspace"], found["exists"], found["text"]) == (stored.keyspace, True, "")
    (mine,) = [each for each in found["keyspaces"] if each["keyspace"] == stored.keyspace]
    assert (mine["topics"], mine["tables"]) == (3, 4)
    assert mine["copies"]


def test_what_of_an_address_is_not_stored_is_noted(viewer):
    def notes(**address):
        return viewer.get("/api/notes", **address)["notes"]

    day = 86_400 * SECOND
    assert notes() == notes(nodes="red,blue", start=NS - day, end=NS + day, time=NS) == []
    (note,) = notes(nodes="red,bleu")
    assert "'bleu'" in note and "did you mean blue" in note
    (note,) = notes(start=NS + 400 * day)
    assert note.startswith(f"start={NS + 400 * day} lies 1.1 years")
    assert "before the first stored message" in notes(end=NS - 2 * day)[0]
    (note,) = notes(end=NS // 10**6)  # milliseconds
    assert "milliseconds are written in seconds" in note


def test_offers_that_are_left_out_are_counted(fresh):
    with fresh() as store:
        for n in range(262):
            store.addTopic(f"/t{n}")  # made by the first message
        with running_viewer(store) as viewer:
            offered = viewer.get("/api/complete", q="SELECT * FROM ")
            assert (len(offered["offers"]), offered["more"]) == (200, 62)
            assert viewer.get("/api/complete", q="SELECT * FROM /t26")["more"] == 0
            for language in ("cql", "sql"):
                asked = {"q": "SELECT * FROM ", "language": language, "limit": 10_000}
                offers = viewer.get("/api/complete", **asked)["offers"]
                assert sum(offer["kind"] == "topic" for offer in offers) == 262
            assert viewer.fail("/api/complete", q="SELECT ", limit=10_001)[0] == 400


def test_another_keyspace_is_read_by_its_name(viewer, stored, fresh):
    with fresh() as other:
        other.addTopic("/there", msg_type="std_msgs/String").addData(String("x"), NS)
        asked = {"keyspace": other.keyspace}
        for _ in range(2):
            found = viewer.get("/api/topics", **asked)["topics"]
            assert [each["topic"] for each in found] == ["/there"]
            assert viewer.get("/api/keyspace", **asked)["keyspace"] == other.keyspace
            lanes = viewer.get("/api/timeline", **asked)["lanes"]
            assert [lane["topic"] for lane in lanes] == ["/there"]
            rows = viewer.get("/api/query", q="select data from there", **asked)["rows"]
            assert rows == [["x"]]
            assert len(viewer.get("/api/timeline")["lanes"]) > 1
            assert viewer.get("/api/keyspace", keyspace="")["keyspace"] == stored.keyspace
            # Each keyspace's file is its own, though one folder holds both.
            ours, theirs = (viewer.ask("/window.bag", each) for each in ({}, asked))
            assert (ours.status, theirs.status) == (200, 200)
            assert b"/there" in theirs.data and b"/there" not in ours.data
    status, told = viewer.fail("/api/topics", keyspace="nowhere_at_all")
    assert (status, told["error"]) == (404, "KeyspaceNotFound")
    assert viewer.fail("/api/topics", keyspace="no name")[1]["error"] == "InvalidName"


@pytest.mark.suite("all", "make test asks others of its kind")
def test_only_some_keyspaces_keep_what_they_have_read(stored, monkeypatch, fresh):
    monkeypatch.setattr(viewer_context, "_KEPT_KEYSPACES", 1)
    with fresh() as one, fresh() as other, running_viewer(stored) as viewer:
        for name in (one.keyspace, other.keyspace, one.keyspace, other.keyspace):
            assert viewer.get("/api/keyspace", keyspace=name)["keyspace"] == name


def test_topics_are_told_as_info_tells_them(viewer, stored):
    topics = {each["topic"]: each for each in viewer.get("/api/topics")["topics"]}
    assert list(topics) == ["/a", "/b", "/none"]
    a, b, none = topics.values()
    assert (a["types"], a["nodes"], a["key"]) == (["std_msgs/String"], ["blue", "red"], ["time"])
    assert (a["messages"], a["bytes"], a["lost"]) == (5, 5 * len(serialize(String("x"))), 4)
    assert (a["start"], a["end"]) == (str(NS), str(NS + 2 * SECOND))
    assert a["rate_hz"] == pytest.approx(1)
    assert b["formats"] == ["json", "binary"] or b["formats"] == ["binary", "json"]
    assert (b["comment"], b["meta"], b["messages"]) == ("counts", {"unit": "m"}, 2)
    assert (none["messages"], none["start"], none["end"], none["ttl_sec"]) == (0, None, None, 3600)
    infos = stored.info()
    tables = [table for each in topics.values() for table in each["tables"]]
    assert [(t["table"], t["node"], t["messages"], t["bytes"]) for t in tables] == [
        (info.table, info.node, info.count, info.bytes) for info in infos
    ]
    for table, info in zip(tables, infos):
        assert table["start"] == (None if info.first_ns is None else str(info.first_ns))
        assert table["bucket_ns"] == str(info.bucket_ns)


def test_some_topics_and_nothing_counted(viewer):
    (only,) = viewer.get("/api/topics", topics="b", counts="false")["topics"]
    assert only["topic"] == "/b"
    assert "messages" not in only
    status, told = viewer.fail("/api/topics", topics="/a,/bb")
    assert (status, told["error"]) == (404, "TopicNotFound")
    assert "/b" in told["text"]


def test_runs_are_told_with_what_people_said_of_them(viewer, stored):
    answer = viewer.get("/api/runs", by_topic="true")
    runs = {run["id"]: run for run in answer["runs"]}
    walk, imported = runs[7], runs[8]
    assert answer["left_off"] == 0
    assert (walk["run"], walk["node"], walk["kind"], walk["state"]) == (
        *("walk", "red", "recording"),
        "ended",
    )
    assert (walk["messages"], walk["stored_of"]) == (3, {"/a": 3})
    assert walk["labels"] == {"site": "lab", "night": ""}
    assert (imported["run"], imported["labels"]) == ("8", {"who": "me"})
    known = {run.writer: run for run in stored.runs()}
    for each in answer["runs"]:
        assert each["started"] == str(to_ns(known[each["id"]].started))
        assert int(each["started"]) <= int(each["ended"])
    assert [run["id"] for run in viewer.get("/api/runs", runs="walk")["runs"]] == [7]
    assert "stored_of" not in viewer.get("/api/runs", runs="8")["runs"][0]
    first = viewer.get("/api/runs", limit=1)
    assert (len(first["runs"]), first["left_off"]) == (1, len(runs) - 1)
    assert viewer.fail("/api/runs", limit=10_001)[0] == 400


def marks(viewer, **parameters):
    found = viewer.get("/api/marks", **parameters)["marks"]
    return [(mark["kind"], mark["topic"], mark["count"]) for mark in found]


LOST, UNKNOWN = ("loss", "/a", 4), ("loss", "/gone", None)
BEGIN, END = ("begin", "", None), ("end", "", None)


def test_marks_are_losses_and_ends_of_recordings(viewer, stored):
    every = viewer.get("/api/marks")["marks"]
    assert [(mark["kind"], mark["run"]) for mark in every] == [
        ("loss", "9"),
        ("loss", "walk"),
        ("begin", "walk"),
        ("end", "walk"),
    ]
    assert every[1]["start"] == str(NS + 5)
    assert every[1]["end"] == str(NS + 9)
    assert every[1]["text"] == "buffer full"
    assert every[2]["text"] == "night, site=lab"
    assert every[2]["start"] == viewer.get("/api/runs", runs="walk")["runs"][0]["started"]


def test_marks_of_a_window_a_robot_a_run_a_topic(viewer):
    assert marks(viewer, start=NS + 9, end=NS + 10) == [LOST]
    assert marks(viewer, start=NS + 10, end=NS + 11) == []
    assert marks(viewer, end=NS - 20) == [UNKNOWN]
    assert marks(viewer, end=NS - 21) == []
    assert marks(viewer, nodes="blue") == [UNKNOWN]
    assert marks(viewer, runs="walk") == marks(viewer, runs="7") == [LOST, BEGIN, END]
    assert marks(viewer, topics="/gone") == [UNKNOWN, BEGIN, END]
    assert viewer.fail("/api/marks", runs="wak")[1]["error"] == "RunNotFound"
    assert viewer.get("/api/marks", limit=3)["left_off"] == 1


def test_an_empty_keyspace_and_one_that_is_not_there(connect, keyspace, new_keyspace):
    for name in (keyspace, new_keyspace):
        with connect(keyspace=name) as store, running_viewer(store) as viewer:
            found = viewer.get("/api/keyspace")
            assert found["exists"] == (name == keyspace)
            assert (found["text"] == "") == found["exists"]
            assert viewer.get("/api/topics") == {"topics": []}
            assert viewer.get("/api/runs") == {"runs": [], "left_off": 0}
            assert viewer.get("/api/marks") == {"marks": [], "left_off": 0}
            assert viewer.fail("/api/topics", topics="/a")[1]["error"] == "TopicNotFound"


def test_nothing_that_is_asked_writes(viewer, stored, cql):
    def state():
        tables = cql.execute(
            "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s",
            [stored.keyspace],
        )
        return sorted(tables), stored.info(), stored.runs()

    before = state()
    for path in ("/api/keyspace", "/api/topics", "/api/runs", "/api/marks"):
        viewer.get(path)
    assert str(state()) == str(before)


def test_who_may_only_read_counts_what_a_killed_recording_left(rosCas, monkeypatch):
    # It stays open, however long the answers take: a writer closes idle buckets by itself.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    rosCas.addTopic("/open").addData(String("x"), key=NS)
    refused = []

    def refuse(*place):
        refused.append(place)
        raise AccessDenied("no right to MODIFY")

    monkeypatch.setattr(counting, "STALE_SEC", -1.0)  # as if the writer had ended long ago
    monkeypatch.setattr(Directory, "put_recount", refuse)
    with running_viewer(rosCas) as viewer:
        (topic,) = viewer.get("/api/topics")["topics"]
    assert topic["messages"] == 1
    assert refused
