# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Merged reads: the total order, cursors, both directions, any page size."""

from __future__ import annotations

import random

import pytest
from std_msgs.msg import String, UInt32
from suites import sparing

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, decode_cursor, encode_cursor, is_after
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.rows import reader

SEC = 10**9
T0 = 1_500_000_000 * SEC


@pytest.fixture
def filled(rosCas):
    """Three topics of two nodes, some 1,000 rows with many equal stamps over several buckets."""
    rand = random.Random(5)
    wanted = []
    for node, writer_id in (("", 5), ("r1", 3)):
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node) as writer:
            handles = [
                writer.connect(api_connection(f"/t{n}", definition_of(String), "/x"), bucket_ns=SEC)
                for n in range(2)
            ]
            handles.append(writer.connect(api_connection("/t0", definition_of(UInt32), "/x")))
            for counter in range(500):
                handle = rand.choice(handles)
                t = T0 + rand.randrange(8) * SEC // 2
                text = f"{node}{counter}"
                is_text = handle.connection.type == "std_msgs/String"
                wire = serialize(String(data=text) if is_text else UInt32(data=counter))
                seq = writer.write(handle, t, counter, wire).seq
                wanted.append((Position(t, node, seq, handle.table.name), handle.topic, wire))
    return rosCas, sorted(wanted)


def found(rows):
    return [(row.position, row.topic, row.wire) for row in rows]


@pytest.mark.parametrize("page_bytes", sparing([1, 500, 10**6], kept=[500]))
def test_merged_order(filled, monkeypatch, page_bytes):
    rosCas, wanted = filled
    monkeypatch.setattr(reader, "PAGE_BYTES", page_bytes)
    assert found(rosCas.readMessages()) == wanted
    for topic in ("/t0", "/t1"):
        mine = [entry for entry in wanted if entry[1] == topic]
        assert found(rosCas.getTopic(topic).rows()) == mine
        assert found(rosCas.getTopic(topic).rows(reverse=True)) == mine[::-1]
        assert rosCas.getTopic(topic).countTopicData() == len(mine)


def test_ranges_and_nodes(filled):
    rosCas, wanted = filled
    low, high = T0 + SEC, T0 + 2 * SEC
    inside = [entry for entry in wanted if low <= entry[0].t <= high]
    assert found(rosCas.readMessages(key=low, to_key=high)) == inside
    mine = [entry for entry in inside if entry[0].node == "r1"]
    assert found(rosCas.readMessages(key=low, to_key=high, nodeID="r1")) == mine
    assert found(rosCas.readMessages(key=high, to_key=low)) == []
    assert found(rosCas.readMessages(key=0, to_key=T0 - 1)) == []


def test_cursors_go_on_anywhere(filled):
    rosCas, wanted = filled
    mine = [entry for entry in wanted if entry[1] == "/t0"]
    topic = rosCas.getTopic("/t0")
    for number in range(0, len(mine), 23):
        after = decode_cursor(encode_cursor(mine[number][0]))
        rest = found(topic.rows(after=after, limit=40))
        assert rest == mine[number + 1 : number + 41]
        assert found(topic.rows(after=after, reverse=True)) == mine[:number][::-1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "e30=",
        encode_cursor(Position(10**40, "", 1, "t")),
        encode_cursor(Position(1, "", 2**70, "t")),
        encode_cursor(Position(-1, "", 0, "t")),
    ],
)
def test_what_is_no_cursor_is_refused(text):
    with pytest.raises(InvalidKey):
        decode_cursor(text)


@pytest.mark.suite("all", "requests fail in it")
def test_reading_outlasts_a_server_that_stumbles(filled, monkeypatch):
    from cassandra import OperationTimedOut

    rosCas, wanted = filled
    send, calls = rosCas.cassandra.ask_raw, []

    def stumbling(statement, *rest):
        future = send(statement, *rest)
        calls.append(future)
        if len(calls) % 3 == 1:
            future.result = lambda: (_ for _ in ()).throw(OperationTimedOut())
        return future

    monkeypatch.setattr(rosCas.cassandra, "ask_raw", stumbling)
    monkeypatch.setattr("cassandra_ros.store.connection.requests.FIRST_PAUSE_SEC", 0.001)
    assert found(rosCas.readMessages()) == wanted
    assert sum(i.count for i in rosCas.info()) == len(wanted)
    assert rosCas.getTopic("/t0").getRow(wanted[0][0].t) is not None


def test_two_definitions_of_a_topic(filled):
    rosCas, _ = filled
    topic = rosCas.getTopic("/t0")
    assert len(topic.tables) == 2
    kinds = {type(message) for _, message in topic.items()}
    assert kinds == {String, UInt32}
    assert {i.type for i in rosCas.info(["/t0"])} == {"std_msgs/String", "std_msgs/UInt32"}


def test_times_at_the_ends_of_the_world(rosCas):
    from cassandra_ros.keys import MAX_NS

    topic = rosCas.addTopic("/a")
    for t in (0, 1, 2**31 * SEC, MAX_NS):
        topic.addData(String(data=str(t)), key=t)
    assert [int(m.data) for _, m in topic.items()] == [0, 1, 2**31 * SEC, MAX_NS]
    assert int(topic.getData(MAX_NS).data) == MAX_NS
    assert topic.first().ns == 0
    assert topic.last().ns == MAX_NS
    assert topic.countTopicData(0, MAX_NS) == 4


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("table", ["t_a", "t_z"])
def test_a_cursor_holds_where_another_table_has_replaced_that_of_its_row(table, reverse):
    """The row is not read again and no other row is left out, whatever the new table is called."""
    read = Position(T0, "r1", 7, "t_m")
    cursor = decode_cursor(encode_cursor(read)).among([table], reverse)
    before = (
        Position(T0 - 1, "z", 9, table),
        Position(T0, "", 9, table),
        Position(T0, "r1", 6, table),
    )
    after = (
        Position(T0, "r1", 8, table),
        Position(T0, "r2", 1, table),
        Position(T0 + 1, "", 1, table),
    )
    assert not is_after(read._replace(table=table), cursor, reverse)
    assert {is_after(each, cursor, reverse) for each in after} == {not reverse}
    assert {is_after(each, cursor, reverse) for each in before} == {reverse}
    # While the table is there, its name counts: a row of another table may have the same place.
    assert read.among(["t_a", "t_m"], reverse) == read
