# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stream that is played: order, names, times, what is latched before the start."""

from __future__ import annotations

from dataclasses import replace

import pytest
from bag.truth import string_connection, string_wire
from playing.robots import SEC, T0, Robot, played, texts
from std_msgs.msg import Header, Int64, String

from cassandra_ros import RosCassandra
from cassandra_ros.errors import (
    DefinitionError,
    InvalidName,
    InvalidOption,
    MessageNotFound,
    TopicNotFound,
)
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.playing.play_selection import PlaySelection, PublishedNames
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.topics.overview.latched_messages import latched_before


def before(store, *args, **options):
    return latched_before(store.catalog, *args, **options)


@pytest.fixture(scope="module")
def filled(fresh):
    """Two runs: one of robot r1 with latched topics, one of robot r2 a day later."""
    with fresh() as rosCas:
        fill(rosCas)
        yield rosCas


def fill(rosCas):
    with Robot(rosCas, 1, "r1") as r1:
        r1.send("/static", 0, "s1", "/a", latched=True)
        r1.send("/static", 0.5, "s2", "/b", latched=True)
        r1.send("/static", 1, "s3", "/a", latched=True)
        for n in range(10):
            r1.send("/tick", n, f"t{n}")
            r1.send("/tock", n, f"o{n}")
    with Robot(rosCas, 2, "r2") as r2:
        r2.send("/static", 86_400, "z1", "/a", latched=True)
        r2.send("/tick", 86_401, "d1")
        r2.send("/tick", 86_402, "d2")


def test_all_topics_in_one_order(filled):
    stream = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(end=f"{T0 + 2 * SEC}"))
    assert played(stream) == [
        ("/static", 0, "s1"),
        ("/tick", 0, "t0"),
        ("/tock", 0, "o0"),
        ("/static", 0.5, "s2"),
        ("/static", 1, "s3"),
        ("/tick", 1, "t1"),
        ("/tock", 1, "o1"),
        ("/tick", 2, "t2"),
        ("/tock", 2, "o2"),
    ]
    assert (stream.start_ns, stream.end_ns) == (T0, T0 + 2 * SEC)
    assert stream.windows == [(T0, T0 + 2 * SEC)]
    assert played(stream, T0 + 2 * SEC) == [("/tick", 2, "t2"), ("/tock", 2, "o2")]
    assert played(stream, T0 + 2 * SEC + 1) == []


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        (PlaySelection(["tick"], start=8, nodeID="r1"), ["t8", "t9"]),
        (PlaySelection(["/t.ck"], regex=True, start="8.5", end="9"), ["t9", "o9"]),
        (PlaySelection(exclude="/t.*", nodeID="r1"), ["s1", "s2", "s3"]),
        (PlaySelection(exclude=["/tick", "", "/s.*"], start=8, end=9), ["o8", "o9"]),
        (PlaySelection(["/tick"], run=2), ["d1", "d2"]),
        (PlaySelection(["/tick"], run="run 2"), ["d1", "d2"]),
        (PlaySelection(["/tick"], start=1, duration=1, nodeID="r1"), ["t1", "t2"]),
        (PlaySelection(["/tick"], start=T0 + 9 * SEC, nodeID="r1"), ["t9"]),
        (PlaySelection(["/tick"], start=86_401, end="2017-07-15T02:40:01Z"), ["d1"]),
        # Seconds count from the first message that satisfies the conditions.
        (
            PlaySelection(["/tick"], where={"/tick": "data > 't5'"}, start=1, duration=1),
            ["t7", "t8"],
        ),
    ],
)
def test_what_is_chosen(filled, selection, expected):
    assert (
        texts(p.row for p in PlayStream(PlayedKeyspace(filled.catalog), selection).messages())
        == expected
    )


@pytest.mark.parametrize(
    ("end", "told"), [("4000000000", True), ("2018-07-13", False), (10**8, False)]
)
def test_an_end_far_behind_the_messages_is_told(filled, caplog, end, told):
    PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(["/tick"], end=end))
    assert ("after the last selected message" in caplog.text) == told


@pytest.mark.parametrize(
    ("selection", "error", "text"),
    [
        (PlaySelection(["/tic"]), TopicNotFound, "did you mean /tick"),
        (PlaySelection(["/x.*"], regex=True), TopicNotFound, "must match the whole name"),
        (PlaySelection(["("], regex=True), InvalidOption, "not a regular expression"),
        (PlaySelection(exclude="("), InvalidOption, "not a regular expression"),
        (PlaySelection(exclude=".*"), TopicNotFound, "leaves none"),
        (PlaySelection(exclude=["/s.*", "/t.*"]), TopicNotFound, "'/s.*, /t.*' leaves none"),
        (PlaySelection(exclude=5), InvalidName, "exclude=5"),
        (PlaySelection(nodeID="r3"), MessageNotFound, "of node 'r3'"),
        (PlaySelection(start="soon"), InvalidOption, "start 'soon' is not a time to play"),
        (PlaySelection(start=-1), InvalidOption, "start -1 is not a time to play"),
        (PlaySelection(start=90_000), InvalidOption, "90000 s, lies after all"),
        (PlaySelection(start=T0 - 1), InvalidOption, "lies before all"),
        (PlaySelection(end=T0 - 1), InvalidOption, "lies before all"),
        (PlaySelection(start=T0 // 10**6), InvalidOption, "milliseconds are written in seconds"),
        (PlaySelection(start=5, end=4), InvalidOption, "before the start"),
        (PlaySelection(end=5, duration=4), InvalidOption, "give one of them"),
        (PlaySelection(remap={"/tick": "/a b"}), InvalidName, "'/a b'"),
        (PlaySelection(prefix="a b"), InvalidName, "the prefix"),
        (PlaySelection(where={"/tick": "data > 'z'"}, topics=["/tick"]), MessageNotFound, "satisf"),
    ],
)
def test_bad_input_is_named(filled, selection, error, text):
    with pytest.raises(error, match=text):
        PlayStream(PlayedKeyspace(filled.catalog), selection)


def test_a_topic_that_cannot_be_read_here_is_left_out(cassandra, keyspace, rosCas, caplog):
    for n, name in enumerate(("/good", "/bad")):
        topic = rosCas.addTopic(name, format="ros", msg_type="std_msgs/String")
        topic.addData(String(name), T0 + n)
    (table,) = rosCas.getTopic("/bad").tables
    comment = table.metadata.with_(definition="garbage {").to_comment().replace("'", "''")
    name = f'"{keyspace}"."{table.name}"'
    rosCas.cassandra.schema_change(f"ALTER TABLE {name} WITH comment = '{comment}'", what="test")
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as other:
        assert [
            p.topic for p in PlayStream(PlayedKeyspace(other.catalog), PlaySelection()).messages()
        ] == ["/good"]
        with pytest.raises(DefinitionError):
            PlayStream(PlayedKeyspace(other.catalog), PlaySelection(["/good", "/bad"]))
    assert "topic /bad is left out, it cannot be read here" in caplog.text


def test_names():
    names = PublishedNames("/p", {"/a": "/b", "p/c": "d"})
    assert [names.of(topic) for topic in ("/a", "c", "/e")] == ["/b", "/d", "/p/e"]
    assert names.of("/a", "r1") == "/r1/b"
    assert names.of("/e", "r1") == "/p/r1/e"
    assert [PublishedNames(prefix).of("/x") for prefix in ("p_", "/p/", "/")] == [
        "/p_/x",
        "/p/x",
        "/x",
    ]


def test_channels_come_from_the_connections(filled):
    channels = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(prefix="/again")).channels()
    assert [(c.topic, c.type, c.latched) for c in channels] == [
        ("/again/static", "std_msgs/String", True),
        ("/again/tick", "std_msgs/String", False),
        ("/again/tock", "std_msgs/String", False),
    ]
    assert {c.definition for c in channels} == {"string data\n"}


def test_what_was_latched_before_the_start(filled):
    stream = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(nodeID="r1", start=2))
    assert texts(p.row for p in stream.latched(stream.start_ns)) == ["s2", "s3"]
    # Before its start nothing is played.
    assert texts(p.row for p in stream.latched(T0 + SEC)) == ["s2", "s3"]
    stream = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(nodeID="r1"))
    assert texts(p.row for p in stream.latched(T0 + SEC)) == ["s1", "s2"]
    assert texts(p.row for p in stream.latched(T0)) == []
    # A run that has nothing in the window gives nothing.
    stream = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(start=86_402))
    assert texts(p.row for p in stream.latched(stream.start_ns)) == ["z1"]
    # The topic alone was sent once, long before.
    assert texts(before(filled, T0 + 9 * SEC, ["/static"], run="run 1")) == [
        "s2",
        "s3",
    ]


def test_the_last_one_that_satisfies_a_condition_is_latched(filled):
    rows = latched_before(
        filled.catalog, T0 + 5 * SEC, where={"/static": "data <> 's3'"}, nodeID="r1"
    )
    assert texts(rows) == ["s1", "s2"]


def test_topics_that_nobody_latches_are_not_read(filled, monkeypatch):
    asked = []
    read = filled.catalog.keyspace.rows.read
    monkeypatch.setattr(
        type(filled.catalog.keyspace.rows),
        "read",
        lambda self, *a, **k: asked.append(a) or read(*a, **k),
    )
    assert before(filled, T0 + 5 * SEC, ["/tick", "/tock"]) == []
    assert asked == []
    assert texts(before(filled, T0 + 5 * SEC, nodeID="r1")) == ["s2", "s3"]
    assert len(asked) == 1


def test_looking_back_ends_with_the_last_publisher(rosCas, monkeypatch):
    with Robot(rosCas, 1) as robot:
        for n in range(300):
            robot.send("/log", n / 100, f"l{n}", "ab"[n % 2], latched=True)
        robot.send("/tick", 3, "t")
    seen, read = [], rosCas.catalog.keyspace.rows.read

    def counted(self, *args, **options):
        for row in read(*args, **options):
            seen.append(row)
            yield row

    monkeypatch.setattr(type(rosCas.catalog.keyspace.rows), "read", counted)
    assert texts(before(rosCas, T0 + 2 * SEC)) == ["l198", "l199"]
    assert len(seen) == 2
    assert not any(row.columns for row in seen)  # keys alone; the messages were fetched later


def test_a_run_that_was_killed_before_the_window_gives_nothing(rosCas, monkeypatch):
    monkeypatch.setattr(
        "cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9
    )  # nor closes what is idle
    with Robot(rosCas, 1, bucket_ns=600 * SEC) as killed:
        killed.send("/map", 1, "old", latched=True)
        killed.flush()  # its bucket, which reaches into the window, stays open
        with Robot(rosCas, 2, bucket_ns=600 * SEC) as robot:
            robot.send("/map", 30, "new", latched=True)
            robot.send("/tick", 40, "t")
        assert texts(before(rosCas, T0 + 35 * SEC)) == [
            "old",
            "new",
        ]  # it may go on
        monkeypatch.setattr("cassandra_ros.topics.overview.latched_messages.STALE_SEC", -60)
        assert texts(before(rosCas, T0 + 35 * SEC)) == ["new"]


def test_a_run_that_only_goes_on_after_the_range_gives_nothing(rosCas):
    """Its bucket reaches into the range, its messages do not."""
    with Robot(rosCas, 1, bucket_ns=600 * SEC) as robot:
        robot.send("/map", 1, "old", latched=True)
        robot.send("/tick", 50, "t")
    assert texts(before(rosCas, T0 + 10 * SEC, to=T0 + 50 * SEC - 1)) == []
    assert texts(before(rosCas, T0 + 10 * SEC, to=T0 + 50 * SEC)) == ["old"]


@pytest.mark.parametrize("key_format", ["manual", "hash", "msg_part"])
def test_latched_topics_with_keys_of_their_own(rosCas, key_format):

    kind = "std_msgs/Header" if key_format == "msg_part" else "std_msgs/String"
    part = "stamp" if key_format == "msg_part" else ""
    rosCas.addTopic("/map", msg_type=kind, key_format=key_format, key_part=part)
    with Robot(rosCas, 5) as robot:
        if kind == "std_msgs/String":
            for t, text in ((1, "m1"), (2, "m2"), (4, "m4")):
                robot.send("/map", t, text, latched=True)
        robot.send("/tick", 3, "t3")
    if kind == "std_msgs/String":
        assert texts(before(rosCas, T0 + 3 * SEC))[-1:] == ["m2"]
        return
    from cassandra_ros.messages.classes import serialize
    from cassandra_ros.messages.connection_header import api_connection, live_connection
    from cassandra_ros.messages.definition import definition_of

    fields = api_connection("/map", definition_of(Header), "/x").fields
    connection = live_connection("/map", {**fields, "latching": "1"})
    with rosCas.messageWriter(writer_id=6) as writer:
        handle = writer.connect(replace(connection, number=-1), bucket_ns=SEC)
        for n, (t, stamp) in enumerate(((1, 50), (2, 20), (4, 30))):
            message = Header(frame_id=f"m{t}")
            message.stamp.secs = stamp
            writer.write(handle, T0 + t * SEC, n, serialize(message))
        other = writer.connect(string_connection("/tick"))
        writer.write(other, T0 + 3 * SEC, 9, string_wire("t"))
    rows = before(rosCas, T0 + 3 * SEC)
    assert [row.message().frame_id for row in rows] == ["m2"]


def test_topics_without_messages_in_the_time_that_is_played_have_no_channel(filled):
    """But a latched one, which is published before the start."""
    for options, topics in (
        ({"start": 2, "end": 3}, ["/static", "/tick", "/tock"]),
        ({"start": 86_000}, ["/static", "/tick"]),
        ({"start": 86_402}, ["/static", "/tick"]),
        ({"end": 8, "nodeID": "r1", "start": 7}, ["/static", "/tick", "/tock"]),
    ):
        stream = PlayStream(PlayedKeyspace(filled.catalog), PlaySelection(**options))
        assert [channel.topic for channel in stream.channels()] == topics, options


def test_the_type_that_is_played_is_that_of_the_time_that_is_played(rosCas):
    for day, kind in enumerate((String, Int64)):
        with rosCas.messageWriter(writer_id=day + 1) as writer:
            connection = api_connection("/status", definition_of(kind), "/x")
            handle = writer.connect(connection)
            writer.write(handle, T0 + day * 86_400 * SEC, 0, serialize(kind()))
    for options, kind in (({"end": 1}, String), ({"start": 86_399}, Int64)):
        stream = PlayStream(PlayedKeyspace(rosCas.catalog), PlaySelection(**options))
        assert [channel.type for channel in stream.channels()] == [kind._type]


def test_a_type_is_played_only_if_a_message_of_it_is(rosCas):
    with rosCas.messageWriter() as writer:
        for kind in (String, Header):
            handle = writer.connect(api_connection("/status", definition_of(kind), "/x"))
            writer.write(handle, T0, 0, serialize(kind()))
    selection = PlaySelection(where={"/status": "frame_id = ''"})
    channels = PlayStream(PlayedKeyspace(rosCas.catalog), selection).channels()
    assert [channel.type for channel in channels] == [Header._type]


def test_the_first_type_of_a_topic_is_that_of_its_first_message(rosCas):
    for number, (kind, times) in enumerate(((String, (2, 9)), (Int64, (0, 3, 4)), (Header, (1,)))):
        with rosCas.messageWriter(writer_id=number + 1) as writer:
            handle = writer.connect(api_connection("/status", definition_of(kind), "/x"))
            for t in times:
                writer.write(handle, T0 + t * SEC, t, serialize(kind()))
    for options, kinds in (
        ({}, (Int64, Header, String)),
        ({"start": 0.5}, (Header, String, Int64)),
        ({"start": 2.5}, (Int64, String)),
        ({"start": 5}, (String,)),
    ):
        stream = PlayStream(PlayedKeyspace(rosCas.catalog), PlaySelection(**options))
        channels = [channel.type for channel in stream.channels()]
        assert channels == [kind._type for kind in kinds], options
