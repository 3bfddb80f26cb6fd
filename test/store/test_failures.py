# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests that come late, fail, or fail and are done: no torn message, no false count."""

from __future__ import annotations

import os
import struct
import zlib

import pytest
from nodes.children import await_true
from proxy import BATCH, EXECUTE, Proxy
from std_msgs.msg import String, UInt8MultiArray

from cassandra_ros import RosCassandra
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection import apiConnection
from cassandra_ros.messages.definition import definitionOf

SEC = 10**9
T0 = 1_500_000_000 * SEC


@pytest.fixture
def proxy(cassandra):
    with Proxy(cassandra.host, cassandra.port) as running:
        yield running


@pytest.fixture
def far(proxy, keyspace):
    """A RosCassandra behind the proxy, on the keyspace of the test."""
    with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
        yield store


def connect(writer, topic, cls, **options):
    return writer.connect(apiConnection(topic, definitionOf(cls), "/x"), **options)


# ------------------------------------------------------------------ chunks and their row


def write_small(writer, number):
    """Write a message and wait until it is stored: the ticker has come by meanwhile."""
    handle = connect(writer, "/small", String)
    writer.write(handle, T0 + number, number, serialize(String()))
    await_true(lambda: "/small" in writer.stats() and writer.stats()["/small"].stored == number + 1)


@pytest.mark.parametrize("missing", [0, 1, 2])
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


# ------------------------------------------------------------------ batches


def write(writer, numbers, **options):
    handle = connect(writer, "/a", String, **options)
    for number in numbers:
        writer.write(handle, T0 + number, number, serialize(String(data=f"text {number}")))
    return handle


def directory_of(rosCas, node=""):
    """What each writer says of the one bucket of /a: writer → its row."""
    (table,) = rosCas.getTopic("/a").tables
    rows = rosCas.parts.directory.find(table.name, node, table.bucketOf(T0))
    return {row.writer: row for row in rows}


def told(rosCas):
    """How many messages /a has: by the rows themselves, and by the directory."""
    topic = rosCas.getTopic("/a")
    return len(list(topic.rows())), topic.countTopicData(), rosCas.info(["/a"])[0].count


def text(number):
    return lambda f: f.opcode == BATCH and f"text {number}".encode() in f.body


def test_what_was_given_up_but_is_stored_is_counted(far, proxy, rosCas):
    proxy.catch(text(7), stored=True)
    writer = far.messageWriter(writer_id=9, give_up_after_sec=0, on_loss=lambda *loss: None)
    write(writer, range(5))
    writer.flush()
    write(writer, range(5, 10))
    writer.close()
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (5, 5)
    assert told(rosCas) == (10, 10, 10)
    assert directory_of(rosCas)[9].closed


def test_what_was_given_up_and_is_not_stored_is_not_counted(far, proxy, rosCas):
    proxy.catch(text(7))
    writer = far.messageWriter(writer_id=9, give_up_after_sec=0, on_loss=lambda *loss: None)
    write(writer, range(5))
    writer.flush()
    write(writer, range(5, 10))
    writer.close()
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (5, 5)
    assert told(rosCas) == (5, 5, 5)


@pytest.mark.parametrize("stored", [True, False])
def test_what_fails_once_is_sent_again(far, proxy, rosCas, stored):
    failed = proxy.catch(text(7), stored=stored, most=2)
    with far.messageWriter(writer_id=9) as writer:
        write(writer, range(10))
    assert len(failed.frames) == 2
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (10, 0)
    assert told(rosCas) == (10, 10, 10)
