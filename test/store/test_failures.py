# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests that come late, fail, or fail and are done: no torn message, no false count."""

from __future__ import annotations

import os
import struct
import threading
import time
import zlib

import numpy as np
import pytest
from nodes.children import await_true
from proxy import BATCH, EXECUTE, QUERY, READ_TIMED_OUT, TIMED_OUT, asks_on
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Header, String, UInt8MultiArray
from store.text_messages import (
    SEC,
    T0,
    connect,
    directory_of,
    told,
    write,
    write_in_two_parts,
)
from suites import sparing

from cassandra_ros.messages.classes import serialize
from cassandra_ros.store.connection import requests as in_flight
from cassandra_ros.store.rows import backfill, fetch, layouts, reader
from cassandra_ros.store.rows import writer as writing
from cassandra_ros.store.tables.directory import slot_of
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.store.tables.row_table import bind

pytestmark = pytest.mark.suite("all", "requests fail in it")


def write_small(writer, number):
    """Write a message and wait until it is stored: the ticker has come by meanwhile."""
    handle = connect(writer, "/small", String)
    writer.write(handle, T0 + number, number, serialize(String()))
    await_true(lambda: "/small" in writer.stats() and writer.stats()["/small"].stored == number + 1)


@pytest.mark.parametrize("missing", sparing([0, 1, 2], kept=[1]))
@pytest.mark.parametrize("failed", [True, False])
def test_a_row_waits_for_each_of_its_chunks(far, proxy, rosCas, missing, failed):
    """One chunk comes late, or never: the row is sent when all are acknowledged, or never."""
    wire = serialize(UInt8MultiArray(data=os.urandom(1_200_000)))
    part = wire[missing * 524_288 + 1000 :][:100]
    held = proxy.catch(lambda f: f.opcode == EXECUTE and part in f.body, failed=failed).hold()
    checksum = struct.pack(">q", zlib.crc32(wire))
    rows = proxy.catch(lambda f: f.opcode == BATCH and checksum in f.body, failed=False)
    losses = []
    writer = far.messageWriter(
        format="binary", give_up_after_sec=0, on_loss=lambda *loss: losses.append(loss[:2])
    )
    writer.write(connect(writer, "/big", UInt8MultiArray), T0, 0, wire)
    held.wait()
    # The acknowledgements come in the order of one connection: when these are here, so are those
    # of the other chunks, and the ticker has looked for rows to be sent since.
    for number in range(2):
        write_small(writer, number)
    topic = rosCas.getTopic("/big")
    assert rows.frames == []
    assert list(topic.rows()) == []
    held.release()
    writer.close()
    stats = writer.stats()["/big"]
    found = [row.wire for row in topic.rows()]
    if failed:
        assert (stats.stored, stats.lost, losses, found) == (0, 1, [("/big", 1)], [])
    else:
        assert (stats.stored, stats.lost, losses, found) == (1, 0, [], [wire])
    assert len(rows.frames) == len(found)
    assert topic.countTopicData() == rosCas.info(["/big"])[0].count == len(found)


def text(number):
    return lambda f: f.opcode == BATCH and f"text {number}".encode() in f.body


def test_what_was_given_up_but_is_stored_is_counted(far, proxy, rosCas):
    proxy.catch(text(7), stored=True)
    # What is written at once is one request, however long it takes.
    options = {"linger_sec": 3600, "give_up_after_sec": 0}
    writer = far.messageWriter(writer_id=9, on_loss=lambda *loss: None, **options)
    write_in_two_parts(writer)
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (5, 5)
    assert told(rosCas) == (10, 10, 10)
    assert directory_of(rosCas)[9].closed


def test_what_was_given_up_and_is_not_stored_is_not_counted(far, proxy, rosCas):
    proxy.catch(text(7))
    run, losses = Run("", 9, "recording", "monday"), []
    options = {"linger_sec": 3600, "give_up_after_sec": 0, "run": run}
    writer = far.messageWriter(writer_id=9, on_loss=lambda *loss: losses.append(loss), **options)
    write_in_two_parts(writer)
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (5, 5)
    assert told(rosCas) == (5, 5, 5)
    (ended,) = rosCas.catalog.keyspace.registry.runs()
    assert (ended.stored, ended.lost) == ({"/a": 5}, {"/a": 5})
    # When they came, not when that was found.
    ((topic, count, error),) = losses
    assert (topic, count, error.first_ns, error.last_ns) == ("/a", 5, T0 + 5, T0 + 9)


@pytest.mark.parametrize("stored", [True, False])
def test_what_fails_once_is_sent_again(far, proxy, rosCas, stored):
    failed = proxy.catch(text(7), stored=stored, most=2)
    with far.messageWriter(writer_id=9) as writer:
        write(writer, range(10))
    assert len(failed.frames) == 2
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (10, 0)
    assert told(rosCas) == (10, 10, 10)


def test_the_time_of_a_request_begins_when_its_turn_comes(far, proxy, monkeypatch):
    """What waited for others to be answered is tried as long as they are."""
    late, asking, outcomes = [0.0], set(), []

    class Clock:
        sleep = staticmethod(time.sleep)

        @staticmethod
        def monotonic():
            asking.add(threading.current_thread())
            return time.monotonic() + late[0]

    def marked(word):
        return lambda f: f.opcode == EXECUTE and word in f.body

    monkeypatch.setattr(in_flight, "time", Clock)
    monkeypatch.setattr(in_flight, "MAX_REQUESTS", 1)
    statement = far.cassandra.prepare(
        f"INSERT INTO {far.keyspace}.cr_definition (md5sum, hash, text) VALUES (?, ?, ?)"
    )
    first = proxy.catch(marked(b"the first"), failed=False).hold()
    second = proxy.catch(marked(b"the second"), most=1)
    requests = in_flight.Flight(far.cassandra.send_raw)
    requests.submit(bind(statement, (b"a", b"a", b"the first")), 10, outcomes.append)
    first.wait()
    sending = threading.Thread(
        target=requests.submit,
        args=(bind(statement, (b"b", b"b", b"the second")), 10, outcomes.append),
    )
    sending.start()
    await_true(lambda: sending in asking)  # it waits for its turn
    late[0] = 1000.0
    first.release()
    sending.join()
    requests.wait()
    assert len(second.frames) == 1
    assert outcomes == [None, None]


def test_bytes_on_their_way_are_bounded(far, proxy):
    """A request that would exceed the maximum waits until others are answered."""
    cql = f"INSERT INTO {far.keyspace}.cr_definition (md5sum, hash, text) VALUES (?, ?, ?)"
    statement, size = far.cassandra.prepare(cql), in_flight.MAX_SENT_BYTES // 2 + 1
    first = proxy.catch(lambda f: f.opcode == EXECUTE and b"the first" in f.body, failed=False)
    first.hold()
    requests, outcomes = in_flight.Flight(far.cassandra.send_raw), []
    requests.submit(bind(statement, (b"a", b"a", b"the first")), size, outcomes.append)
    first.wait()
    second = bind(statement, (b"b", b"b", b"the second"))
    sending = threading.Thread(target=requests.submit, args=(second, size, outcomes.append))
    sending.start()
    sending.join(0.3)
    assert sending.is_alive() and requests.nbytes == size
    first.release()
    sending.join()
    requests.wait()
    assert (outcomes, requests.nbytes) == ([None, None], 0)


def test_a_bucket_whose_chunks_are_on_their_way_is_not_closed(far, proxy, rosCas, monkeypatch):
    monkeypatch.setattr(writing, "HEARTBEAT_SEC", -1.0)
    monkeypatch.setattr(writing, "IDLE_SEC", -1.0)
    held = proxy.catch(lambda f: f.opcode == EXECUTE and len(f.body) > 10_000, failed=False).hold()
    writer = far.messageWriter(writer_id=9)
    write(writer, [0])
    handle = connect(writer, "/a", String)
    writer.flush()
    await_true(lambda: directory_of(rosCas)[9].closed)
    writer.write(handle, T0 + 1, 1, serialize(String(data="x" * 600_000)))
    held.wait()
    for number in range(2):
        write_small(writer, number)
    assert not directory_of(rosCas)[9].closed
    held.release()
    writer.close()
    assert told(rosCas) == (2, 2, 2)


FORMATS = pytest.mark.parametrize("format", ["binary", "packed"])


def seal(writer):
    """Close the blocks that a writer in format packed is filling; of other formats nothing."""
    writer._rows._builders.seal()


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@FORMATS
@pytest.mark.parametrize("how", ["truncateTopic", "removeTopic"])
@pytest.mark.parametrize("size", ["small", "chunks", "row"])
def test_what_is_on_its_way_goes_on_in_the_topics_next_table(far, proxy, rosCas, format, how, size):
    """Requests that reach a table which was dropped meanwhile: each message lies in the next one.

    What is held is a batch, the pieces of a large message, or the row that follows them.
    """
    losses, big = [], "x" * (600_000 if size != "small" else 10)
    writer = far.messageWriter(
        writer_id=9, format=format, on_loss=lambda *loss: losses.append(loss)
    )
    write(writer, range(5))
    writer.flush()
    if size == "chunks":
        held = proxy.catch(lambda f: f.opcode == EXECUTE and big[:10_000].encode() in f.body)
    else:
        held = proxy.catch(lambda f: f.opcode == BATCH)
    held.failed = False
    held.hold()
    wires = [serialize(String(data=f"{big} {number}")) for number in range(5, 8)]
    handle = connect(writer, "/a", String)
    for number, wire in enumerate(wires, 5):
        writer.write(handle, T0 + number, number, wire)
    seal(writer)
    held.wait()
    getattr(rosCas, how)("/a")
    held.release()
    writer.flush()
    writer.write(handle, T0 + 8, 8, serialize(String(data="behind it")))
    writer.close()
    assert losses == []
    found = [row.wire for row in rosCas.getTopic("/a").rows()]
    assert found == [*wires, serialize(String(data="behind it"))]
    assert told(rosCas) == (4, 4, 4)
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (9, 0)


@pytest.mark.fault
@FORMATS
@pytest.mark.parametrize("way", ["one by one", "together", "large"])
def test_a_message_that_is_written_again_keeps_its_seq(far, proxy, rosCas, format, way):
    """The seq orders messages of equal times, and a repeated import must meet the same rows."""
    writer = far.messageWriter(writer_id=9, format=format)
    handle = connect(writer, "/a", String)
    writer.write(handle, T0, 0, serialize(String(data="before")))
    writer.flush()
    held = proxy.catch(lambda f: f.opcode == BATCH, failed=False).hold()
    counters = np.array([7, 3, 2**32 - 1, 5], np.int64)
    big = "x" * (70_000 if way == "large" else 10)
    wires = [serialize(String(data=f"{counter} {big}")) for counter in counters.tolist()]
    if way == "together":
        writer.write_run(handle, np.full(4, T0, np.int64), counters, wires)
    else:
        for counter, wire in zip(counters.tolist(), wires):
            writer.write(handle, T0, counter, wire)
    seal(writer)
    held.wait()
    rosCas.removeTopic("/a")
    held.release()
    writer.close()
    found = [(row.key.seq, row.wire) for row in rosCas.getTopic("/a").rows()]
    assert found == sorted((9 << 32 | c, wire) for c, wire in zip(counters.tolist(), wires))


@pytest.mark.fault
def test_one_that_is_added_while_its_topic_goes_lies_in_the_next_table(far, proxy, rosCas):
    far.addTopic("/a", msg_type="std_msgs/String")
    topic = far.getTopic("/a")
    topic.addData(String(data="text 0"), key=T0)
    held = proxy.catch(text(1), failed=False).hold()
    keys = []
    adding = threading.Thread(
        target=lambda: keys.append(topic.addData(String(data="text 1"), key=T0 + 1))
    )
    adding.start()
    held.wait()
    rosCas.truncateTopic("/a")
    held.release()
    adding.join()
    assert [m.data for _, m in rosCas.getTopic("/a").items()] == ["text 1"]
    assert rosCas.getTopic("/a").getData(keys[0]).data == "text 1"
    (table,) = rosCas.getTopic("/a").tables
    assert keys[0].table == table.name


COUNT = 40


@pytest.fixture
def small_pages(monkeypatch):
    """Pages of seven rows, which end between messages of equal stamps."""
    monkeypatch.setattr(reader, "MAX_PAGE_ROWS", 7)
    monkeypatch.setattr(layouts, "COUNT_PAGE_ROWS", 7)
    monkeypatch.setattr(fetch, "KEY_PAGE_ROWS", 7)
    monkeypatch.setattr(fetch, "VERSION_PAGE_ROWS", 7)


def fill(rosCas, **options):
    """Store messages of two nodes, three at each time."""
    rosCas.addTopic("/h", msg_type="std_msgs/Header", **options)
    for writer_id, node in ((2, ""), (1, "r1")):
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node) as writer:
            handle = connect(writer, "/h", Header)
            for n in range(COUNT):
                given = {"name": "same"} if options else {}
                wire = serialize(Header(seq=n, frame_id="same"))
                writer.write(handle, T0 + n // 3 * SEC, n, wire, **given)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("where", [None, "seq >= 0 AND seq < 100"])
def test_a_read_goes_on_where_a_page_failed(far, proxy, rosCas, small_pages, reverse, where):
    fill(rosCas)
    wanted = [(row.t, row.node, row.seq) for row in rosCas.getTopic("/h").rows()]
    assert len(wanted) == 2 * COUNT
    failed = proxy.catch(asks_on)
    items = far.getTopic("/h").items(reverse=reverse, where=where)
    found = [(key.ns, key.node, key.seq) for key, _ in items]
    assert found == (wanted[::-1] if reverse else wanted)
    assert len(failed.frames) >= 4


@pytest.mark.parametrize("reverse", [False, True])
def test_a_filter_that_takes_too_long_later_is_left_out(
    far, proxy, rosCas, small_pages, monkeypatch, reverse
):
    fill(rosCas)
    wanted = [(row.t, row.node, row.seq) for row in rosCas.getTopic("/h").rows()]
    monkeypatch.setitem(TIMED_OUT, EXECUTE, READ_TIMED_OUT)
    failed = proxy.catch(asks_on, most=1)
    items = far.getTopic("/h").items(reverse=reverse, where="seq >= 0 AND seq < 100")
    found = [(key.ns, key.node, key.seq) for key, _ in items]
    assert found == (wanted[::-1] if reverse else wanted)
    assert len(failed.frames) == 1


def test_a_count_goes_on_where_a_page_failed(far, proxy, rosCas, small_pages):
    fill(rosCas)
    failed = proxy.catch(asks_on)
    last = (COUNT - 1) // 3
    inner = sum(0 < n // 3 < last for n in range(COUNT))
    assert far.getTopic("/h").countTopicData(T0 + 1, T0 + last * SEC - 1) == 2 * inner
    assert len(failed.frames) >= 4


@pytest.mark.parametrize("reverse", [False, True])
def test_versions_go_on_where_a_page_failed(far, proxy, rosCas, small_pages, reverse):
    fill(rosCas, key_format="manual")
    wanted = [row.position for row in rosCas.getTopic("/h").rows()]
    failed = proxy.catch(asks_on)
    rows = far.getTopic("/h").versions("same", reverse=reverse)
    assert [row.position for row in rows] == (wanted[::-1] if reverse else wanted)
    assert len(failed.frames) >= 4


@pytest.mark.parametrize("nodeID", [None, "r1"])
def test_a_directory_that_fails_once_hides_no_bucket(far, proxy, rosCas, nodeID):
    """The list of buckets is read by time or, of one robot, by robot."""
    with rosCas.messageWriter(nodeID="r1") as writer:
        write(writer, range(10))
    (table,) = rosCas.getTopic("/a").tables
    slot = struct.pack(">iq", 8, slot_of(table.bucket_of(T0)))
    # Both lists are asked by the table's name and what follows it, and no other request is.
    after = slot if nodeID is None else b"\0\0\0\2r1" + slot
    words = table.name.encode() + after
    failed = proxy.catch(lambda f: f.opcode == EXECUTE and words in f.body, most=1)
    assert len(list(far.getTopic("/a").rows(nodeID=nodeID))) == 10
    assert len(failed.frames) == 1


def test_the_replication_of_a_keyspace_is_read_again(far, proxy, rosCas):
    """The driver asks for it with its own connection, whose error is of no kind."""
    fill(rosCas)
    words = b"FROM system_schema.keyspaces WHERE keyspace_name"
    failed = proxy.catch(lambda f: f.opcode == QUERY and words in f.body, most=1)
    assert far.getTopic("/h").countTopicData() == 2 * COUNT
    assert len(failed.frames) == 1


def test_a_list_of_names_begins_again_where_a_page_failed(far, proxy, rosCas, small_pages):
    fill(rosCas, key_format="manual")
    failed = proxy.catch(asks_on, most=3)
    assert far.getTopic("/h").countTopicData() == rosCas.info(["/h"])[0].count * 2 == 2 * COUNT
    assert len(failed.frames) == 3


def test_an_index_is_filled_across_pages(rosCas, monkeypatch):
    fill(rosCas)
    monkeypatch.setattr(backfill, "PAGE_ROWS", 7)
    topic = rosCas.getTopic("/h")
    topic.createIndex("frame_id")
    statement = "select seq from /h where frame_id = 'same'"
    result = rosCas.statements.select(statement, plan="index")
    assert len(list(result)) == 2 * COUNT
    assert result.pushdown.indexed


@pytest.mark.parametrize("dropped", [False, True])
def test_an_index_that_a_server_fails_to_drop_is_dropped(far, proxy, rosCas, dropped):
    """The server fails once, and has dropped it all the same, or has not."""
    rosCas.addTopic("/fix", format="ros").addData(NavSatFix(), key=T0)
    far.getTopic("/fix").createIndex("latitude")
    asked = proxy.catch(
        lambda f: f.opcode == QUERY and b"DROP INDEX" in f.body, stored=dropped, most=1
    )
    far.getTopic("/fix").removeIndex("latitude")
    assert len(asked.frames) == 1
    assert rosCas.getTopic("/fix").getMeta["indexes"] == []
    tables = [table.name for table in rosCas.getTopic("/fix").tables]
    left = rosCas.cassandra.system_schema("indexes", "index_name", rosCas.keyspace, tables[0])
    assert list(left) == []
