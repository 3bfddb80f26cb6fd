# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows through the writer: order, duplicates, counts, chunks, failures."""

from __future__ import annotations

import os
import threading

import pytest
from nodes.children import await_true
from proxy import BATCH, Proxy
from sensor_msgs.msg import Imu
from std_msgs.msg import String, UInt8MultiArray
from suites import sparing
from threads import together

from cassandra_ros import RosCassandra
from cassandra_ros.errors import CorruptMessage, WriteFailed
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables.directory import BucketTotals
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES

SEC = 10**9
T0 = 1_500_000_000 * SEC


def connection(topic, cls):
    return api_connection(topic, definition_of(cls), "/test")


def wireOf(number, size=20):
    return serialize(String(data=f"{number:06d}".ljust(size, "x")))


def counted(cql, rosCas, topic):
    """Count the rows of a topic as the bare driver sees them."""
    total = 0
    for table in rosCas.getTopic(topic).tables:
        rows = cql.execute(f'SELECT count(*) FROM {rosCas.keyspace}."{table.name}"')
        total += rows.one()[0]
    return total


@pytest.mark.parametrize("format_name", ["binary", "ros"])
def test_equal_stamps_are_two_messages(rosCas, format_name):
    with rosCas.messageWriter(format=format_name) as writer:
        handle = writer.connect(connection("/a", String))
        for number in range(500):
            writer.write(handle, T0, number, wireOf(number))
    rows = list(rosCas.getTopic("/a").rows())
    assert [row.wire for row in rows] == [wireOf(number) for number in range(500)]
    assert [split_seq(row.seq)[1] for row in rows] == list(range(500))


def test_counts_come_from_the_directory(rosCas, cql):
    with rosCas.messageWriter() as writer:
        handle = writer.connect(connection("/a", Imu), bucket_ns=SEC)
        for number in range(1000):
            writer.write(handle, T0 + number * 10_000_000, number, serialize(Imu()))
    topic = rosCas.getTopic("/a")
    info = rosCas.info(["/a"])[0]
    assert info.count == topic.countTopicData() == counted(cql, rosCas, "/a") == 1000
    assert (info.first_ns, info.last_ns) == (T0, T0 + 9_990_000_000)
    assert info.buckets == 10
    assert info.bytes == 1000 * len(serialize(Imu()))
    # Ends are included, and lie inside of buckets.
    assert topic.countTopicData(T0 + 505_000_000, T0 + 2_000_000_000) == 150


def test_open_buckets_are_counted_live(rosCas):
    writer = rosCas.messageWriter()
    handle = writer.connect(connection("/a", String))
    for number in range(300):
        writer.write(handle, T0 + number, number, wireOf(number))
    writer.flush()
    assert rosCas.getTopic("/a").countTopicData() == 300
    writer.close()
    assert rosCas.getTopic("/a").countTopicData() == 300


def test_repeating_a_run_ends_in_the_same_rows(rosCas, cql):
    for part in (range(0, 700, 7), range(700), range(350)):
        with rosCas.messageWriter(writer_id=4711, format="binary") as writer:
            handle = writer.connect(connection("/a", String), bucket_ns=SEC)
            for number in part:
                writer.write(handle, T0 + number * 10_000_000, number, wireOf(number))
    assert rosCas.info(["/a"])[0].count == counted(cql, rosCas, "/a") == 700
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [wireOf(n) for n in range(700)]


def test_a_writer_that_died_leaves_true_counts(rosCas, cql, monkeypatch):
    # A dead one tells nothing more.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    writer = rosCas.messageWriter(writer_id=99)
    handle = writer.connect(connection("/a", String))
    for number in range(100):
        writer.write(handle, T0 + number, number, wireOf(number))
    writer.flush()  # and never closed, as after kill -9
    assert rosCas.info(["/a"])[0].count == 100
    with rosCas.messageWriter(writer_id=99) as again:
        handle = again.connect(connection("/a", String))
        for number in range(150):
            again.write(handle, T0 + number, number, wireOf(number))
    writer._rows._buckets.clear()  # the dead one closes nothing
    writer.close()
    assert rosCas.info(["/a"])[0].count == counted(cql, rosCas, "/a") == 150


def test_a_stale_open_bucket_is_recounted_and_closed(rosCas, monkeypatch):
    from cassandra_ros.store.rows import row_counts as counting

    monkeypatch.setattr(
        "cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9
    )  # nor closes it by itself
    writer = rosCas.messageWriter(writer_id=99)
    handle = writer.connect(connection("/a", String))
    for number in range(10):
        writer.write(handle, T0 + number, number, wireOf(number))
    writer.flush()
    directory, name = rosCas.catalog.keyspace.directory, handle.table.name
    bucket = handle.table.bucket_of(T0)
    assert rosCas.info(["/a"])[0].count == 10
    assert not directory.find(name, "", bucket)[0].closed
    monkeypatch.setattr(counting, "STALE_SEC", -1.0)
    assert rosCas.info(["/a"])[0].count == 10
    row = directory.find(name, "", bucket)[0]
    assert row.closed and row.rows == 10
    # A writer that came back meanwhile is not overridden.
    directory.mark((name, "", bucket, 99), 0)
    directory.put_recount(name, row._replace(closed=False), BucketTotals(), 0)
    assert not directory.find(name, "", bucket)[0].closed
    writer.close()


SIZES = [
    LARGE_MESSAGE_CHUNK_BYTES - 100,
    LARGE_MESSAGE_CHUNK_BYTES + 1,
    3 * LARGE_MESSAGE_CHUNK_BYTES,
    5_000_001,
]


@pytest.mark.parametrize("format_name", ["binary", "ros"])
@pytest.mark.parametrize("size", sparing(SIZES, kept=SIZES[:2]))
def test_large_messages(rosCas, format_name, size):
    topic = rosCas.addTopic("/big", format_name)
    msg = UInt8MultiArray(data=os.urandom(size))
    msg.layout.data_offset = 7
    key = topic.addData(msg)
    assert topic.getData(key) == msg
    assert topic.getData(int(str(key))) == msg
    assert topic.countTopicData() == 1
    if format_name == "ros":
        assert rosCas.executeCQL("select layout.data_offset from /big") == [(7,)]


def test_no_torn_message_is_ever_read(rosCas, cql):
    topic = rosCas.addTopic("/big", "binary")
    key = topic.addData(UInt8MultiArray(data=os.urandom(2_000_000)))
    table = topic.tables[0]
    cql.execute(
        f'DELETE FROM {rosCas.keyspace}."{table.name}_c" WHERE "_node" = %s AND "_bucket" = %s '
        'AND "_t" = %s AND "_seq" = %s AND "_chunk" = 2',
        ("", table.bucket_of(key.ns), key.ns, key.seq),
    )
    with pytest.raises(CorruptMessage, match=r"2 of 4 chunks"):
        topic.getData(key)


def test_chunks_without_their_row_are_no_message(rosCas):
    """What a writer leaves that dies between the chunks and the row."""
    topic = rosCas.addTopic("/big", "binary")
    topic.addData(UInt8MultiArray(data=os.urandom(600_000)), key=T0)
    writer = rosCas.messageWriter()
    handle = writer.connect(connection("/big", UInt8MultiArray))
    writer._rows._commit = lambda: None
    writer.write(handle, T0 + 1, 0, serialize(UInt8MultiArray(data=bytes(2_000_000))))
    writer._rows._flight.wait()
    assert topic.countTopicData() == len(list(topic.rows())) == 1
    del writer._rows._commit
    writer.close()
    assert topic.countTopicData() == len(list(topic.rows())) == 2


def test_rows_hold_no_tombstones(rosCas, cql):
    """Unset columns are not nulls: a null is a tombstone, and those make buckets unreadable."""
    with rosCas.messageWriter() as writer:
        handle = writer.connect(connection("/a", String))
        writer.write(handle, T0, 0, serialize(String(data="plain")))
        writer.write(handle, T0, 1, b"\1\0\0\0\xff")  # odd: no UTF-8
    table = handle.table.name
    for column in ("_nchunks", "_crc", "_odd", "_raw", "data"):
        rows = cql.execute(
            f'SELECT "{column}", writetime("{column}") FROM {rosCas.keyspace}.{table}'
        )
        for value, written in rows:
            assert (value is None) == (written is None)


@pytest.fixture
def failing(cassandra, keyspace):
    """A RosCassandra of which every batch fails with the second message or a later one."""
    with Proxy(cassandra.host, cassandra.port) as proxy:
        proxy.catch(lambda f: f.opcode == BATCH and wireOf(0) not in f.body)
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            yield store


def test_losses_are_raised_with_the_topic(failing):
    writer = failing.messageWriter(give_up_after_sec=0.2, format="binary")
    handle = writer.connect(connection("/a", String))
    writer.write(handle, T0, 0, wireOf(0))
    writer.flush()
    with pytest.raises(WriteFailed, match=r"1 messages of topic /a could not be stored"):
        writer.write(handle, T0 + 1, 1, wireOf(1))
        writer.flush()
    writer.close()


def test_losses_are_counted_where_asked(failing):
    lost = []
    writer = failing.messageWriter(
        give_up_after_sec=0.2,
        format="binary",
        on_loss=lambda topic, count, error: lost.append((topic, count)),
    )
    handle = writer.connect(connection("/a", String))
    writer.write(handle, T0, 0, wireOf(0))
    writer.flush()
    for number in range(1, 6):
        writer.write(handle, T0 + number, number, wireOf(number))
    writer.close()
    assert sum(count for _, count in lost) == 5
    assert writer.stats()["/a"].stored == 1
    assert writer.stats()["/a"].lost == 5
    assert "could not be stored" in writer.stats()["/a"].reason


def test_many_threads_share_a_writer(rosCas):
    numbers = iter(range(4000))
    lock = threading.Lock()
    with rosCas.messageWriter() as writer:
        handle = writer.connect(connection("/a", String))

        def work():
            while True:
                with lock:
                    number = next(numbers, None)
                if number is None:
                    return
                writer.write(handle, T0 + number, number, wireOf(number))

        together(*[work] * 4)
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [wireOf(n) for n in range(4000)]


def test_a_large_message_of_a_dropped_topic_hangs_nobody(rosCas):
    lost = []
    writer = rosCas.messageWriter(on_loss=lambda topic, count, error: lost.append(str(error)))
    handle = writer.connect(connection("/big", UInt8MultiArray))
    wire = serialize(UInt8MultiArray(data=bytes(2_000_000)))
    writer.write(handle, T0, 0, wire)
    writer.flush()
    rosCas.removeTopic("/big")
    writer.write(handle, T0 + 1, 1, wire)
    writer.write(handle, T0 + 2, 2, wire)
    writer.close()
    # The topic goes on anew, with what was sent to the old table.
    assert (writer.stats()["/big"].stored, lost) == (3, [])
    assert [row.wire for row in rosCas.getTopic("/big").rows()] == [wire, wire]


def test_an_interrupt_while_chunks_are_sent_hangs_nobody(rosCas, monkeypatch):
    writer = rosCas.messageWriter()
    handle = writer.connect(connection("/big", UInt8MultiArray))
    wire = serialize(UInt8MultiArray(data=bytes(5_000_000)))
    send, calls = rosCas.cassandra.send_raw, []

    def interrupted(statement, *rest):
        calls.append(statement)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return send(statement, *rest)

    monkeypatch.setattr(writer._rows._flight, "_send", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.write(handle, T0, 0, wire)
    with pytest.raises(WriteFailed, match="/big"):
        writer.flush()
    writer.close()
    assert list(rosCas.getTopic("/big").rows()) == []


@pytest.mark.suite("all", "it waits for seconds")
def test_expired_messages_are_not_counted(rosCas):
    topic = rosCas.addTopic("/a", ttl=6)
    for number in range(3):
        topic.addData(String(), key=T0 + number)
    rosCas.catalog.adder.close()
    counted = topic.countTopicData()
    assert counted == 3 or len(list(topic.rows())) < 3  # a busy machine may be later than that
    await_true(lambda: not list(topic.rows()))
    assert topic.countTopicData() == rosCas.info()[0].count == 0


def test_another_ttl_than_the_topics_is_said(rosCas):
    rosCas.addTopic("/a", msg_type="std_msgs/String", ttl=3600)
    with rosCas.messageWriter() as writer:
        assert "3600 s" in writer.connect(connection("/a", String)).warning
