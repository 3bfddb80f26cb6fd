# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Blocks through the writer: counts, losses, large messages, tables that go, requests that fail."""

from __future__ import annotations

import os
import struct
import time
from functools import partial

import pytest
from nodes.children import await_true
from proxy import BATCH
from std_msgs.msg import Header, String, UInt8MultiArray
from store.text_messages import (
    T0,
    connect,
    directory_of,
    told,
    wire_of,
    write,
    write_in_two_parts,
)
from threads import together

from cassandra_ros import Stamp
from cassandra_ros.errors import WriteFailed
from cassandra_ros.messages.classes import serialize
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES


def packed(store, **options):
    options.setdefault("block_sec", None)
    return store.messageWriter(format="packed", **options)


def wires(rosCas):
    return [row.wire for row in rosCas.getTopic("/a").rows()]


def block_of(number):
    """Say whether a request brings the block that begins with a message."""
    key = struct.pack(">q", T0 + number)
    return lambda f: f.opcode == BATCH and key in f.body


def blocks(cql, rosCas):
    (table,) = rosCas.getTopic("/a").tables
    return sorted(n for (n,) in cql.execute(f'SELECT "_n" FROM {table.qualified}'))


def test_nothing_waits_behind_flush(rosCas, cql):
    writer = packed(rosCas, linger_sec=3600)
    write(writer, range(10))
    assert writer.pending_bytes == sum(len(wire_of(n)) for n in range(10))
    writer.flush()
    assert writer.pending_bytes == 0
    assert told(rosCas) == (10, 10, 10)
    assert writer.stats()["/a"].stored == 10
    assert writer.stats()["/a"].bytes == sum(len(wire_of(n)) for n in range(10))
    write(writer, range(10, 12))
    writer.close()
    assert told(rosCas) == (12, 12, 12)
    row = directory_of(rosCas)[writer.writer_id]
    assert (row.closed, row.rows, row.t_min, row.t_max) == (True, 12, T0, T0 + 11)
    assert blocks(cql, rosCas) == [2, 10]
    assert wires(rosCas) == [wire_of(n) for n in range(12)]


def test_a_block_goes_when_it_is_old(rosCas, cql):
    writer = packed(rosCas, block_sec=3600, linger_sec=3600)
    for numbers in (range(3), range(3, 5)):
        writer._rows._block_sec = 3600
        write(writer, numbers)
        writer._rows._block_sec = 0.0  # as if so long had gone by
        await_true(lambda last=numbers[-1]: writer.stats()["/a"].stored == last + 1)
    writer.close()
    assert blocks(cql, rosCas) == [2, 3]


def test_added_messages_are_blocks_of_one(rosCas, cql):
    topic = rosCas.addTopic("/a", "packed")
    keys = [topic.addData(String(data=f"text {n}"), key=T0 + n) for n in range(3)]
    assert [topic.getData(key).data for key in keys] == ["text 0", "text 1", "text 2"]
    assert blocks(cql, rosCas) == [1, 1, 1]
    assert [key.to_nsec() for key in keys] == [T0, T0 + 1, T0 + 2]
    assert len({key.seq for key in keys}) == 3


@pytest.mark.parametrize("size", [65_000, 70_000, 524_288, 700_000, 3_000_000])
def test_large_messages(rosCas, size):
    sent = [serialize(UInt8MultiArray(data=os.urandom(n))) for n in (10, size, 10, size)]
    with packed(rosCas) as writer:
        handle = connect(writer, cls=UInt8MultiArray)
        for number, wire in enumerate(sent):
            writer.write(handle, T0 + number, number, wire)
    assert wires(rosCas) == sent
    assert told(rosCas) == (4, 4, 4)


def test_the_last_message_of_a_block_outlives_the_others(rosCas, cql):
    with packed(rosCas) as writer:
        write(writer, range(10))
    topic, condition = rosCas.getTopic("/a"), "KEY != ?"
    assert blocks(cql, rosCas) == [10]
    assert topic.removeData(where=(condition, [Stamp.from_ns(T0 + 4)])) == 9
    assert wires(rosCas) == [wire_of(4)]
    assert told(rosCas) == (1, 1, 1)
    assert topic.removeData(where=("KEY = ?", [Stamp.from_ns(T0 + 4)])) == 1
    assert blocks(cql, rosCas) == []


def test_the_chunks_of_a_large_message_are_deleted_with_it(rosCas, cql):
    with packed(rosCas) as writer:
        handle = connect(writer, cls=UInt8MultiArray)
        for number in range(3):
            wire = serialize(UInt8MultiArray(data=os.urandom(2 * LARGE_MESSAGE_CHUNK_BYTES)))
            writer.write(handle, T0 + number, number, wire)
    (table,) = rosCas.getTopic("/a").tables
    times = f'SELECT "_t" FROM {rosCas.keyspace}."{table.name}_c"'
    assert {t for (t,) in cql.execute(times)} == {T0, T0 + 1, T0 + 2}
    assert rosCas.getTopic("/a").removeData(Stamp.from_ns(T0 + 1), Stamp.from_ns(T0 + 2)) == 2
    assert {t for (t,) in cql.execute(times)} == {T0}


def test_a_time_of_the_message_as_the_key(rosCas):
    rosCas.addTopic(
        "/a", "packed", msg_type="std_msgs/Header", key_format="msg_part", key_part="stamp"
    )
    sent = []
    with packed(rosCas) as writer:
        handle = connect(writer, cls=Header)
        for n in range(100):
            msg = Header(seq=n, frame_id="x" * (600_000 if n == 50 else 1))
            msg.stamp.secs = 1000 + (n * 37) % 100
            sent.append((msg.stamp.to_nsec(), T0 + n, serialize(msg)))
            writer.write(handle, T0 + n, n, sent[-1][2])
    found = [(row.t, row.received, row.wire) for row in rosCas.getTopic("/a").rows()]
    assert found == sorted(sent)


def test_two_writers_at_once(rosCas):
    with packed(rosCas, writer_id=1) as one, packed(rosCas, writer_id=2, block_sec=0.01) as two:
        handles = connect(one), connect(two, caller="/y")

        def work(writer, handle, first):
            for number in range(first, 4000, 2):
                writer.write(handle, T0 + number * 100_000, number, wire_of(number))

        together(partial(work, one, handles[0], 0), partial(work, two, handles[1], 1))
    assert wires(rosCas) == [wire_of(n) for n in range(4000)]
    assert told(rosCas) == (4000, 4000, 4000)


def test_many_threads_share_a_writer(rosCas):
    with packed(rosCas, block_sec=0.01) as writer:
        handle = connect(writer)

        def work(first):
            for number in range(first, 4000, 4):
                writer.write(handle, T0, number, wire_of(number))
                if number % 500 == 0:
                    writer.flush()

        together(*(partial(work, first) for first in range(4)))
    assert wires(rosCas) == [wire_of(n) for n in range(4000)]
    assert told(rosCas) == (4000, 4000, 4000)


def test_expired_blocks_are_not_counted(rosCas):
    with packed(rosCas, ttl=2) as writer:
        write(writer, range(5))
    (table,) = rosCas.getTopic("/a").tables
    assert table.metadata.ttl == 2
    await_true(lambda: wires(rosCas) == [])
    assert rosCas.getTopic("/a").countTopicData() == 0


def test_losses_are_counted_by_message(far, proxy, rosCas):
    proxy.catch(block_of(7))
    losses = []
    writer = packed(far, give_up_after_sec=0, on_loss=lambda *loss: losses.append(loss))
    write(writer, range(7))
    writer.flush()
    write(writer, range(7, 20))
    writer.flush()
    ((topic, lost, error),) = losses
    assert (topic, lost) == ("/a", 13)
    assert (error.first_ns, error.last_ns) == (T0 + 7, T0 + 19)
    writer.close()
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (7, 13)
    assert told(rosCas) == (7, 7, 7)


def test_losses_are_raised_without_a_callback(far, proxy):
    proxy.catch(block_of(1))
    writer = packed(far, give_up_after_sec=0)
    write(writer, range(1, 4))
    with pytest.raises(WriteFailed, match="3 messages of topic /a could not be stored"):
        writer.flush()
    write(writer, range(5, 8))
    writer.close()
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (3, 3)


def test_what_was_given_up_but_is_stored_is_counted(far, proxy, rosCas):
    proxy.catch(block_of(5), stored=True)
    writer = packed(far, writer_id=9, give_up_after_sec=0, on_loss=lambda *loss: None)
    write_in_two_parts(writer)
    assert (writer.stats()["/a"].stored, writer.stats()["/a"].lost) == (5, 5)
    assert told(rosCas) == (10, 10, 10)
    assert directory_of(rosCas)[9].closed


@pytest.mark.parametrize("stored", [True, False])
def test_what_fails_once_is_sent_again(far, proxy, rosCas, stored):
    failed = proxy.catch(block_of(5), stored=stored, most=2)
    writer = packed(far)
    write_in_two_parts(writer)
    assert len(failed.frames) == 2
    assert wires(rosCas) == [wire_of(n) for n in range(10)]
    assert told(rosCas) == (10, 10, 10)


@pytest.mark.fault
@pytest.mark.parametrize("how", ["truncateTopic", "removeTopic"])
def test_what_waits_while_its_topic_goes_lies_in_the_next_table(rosCas, how):
    losses = []
    writer = packed(rosCas, block_sec=0.01, on_loss=lambda *loss: losses.append(loss))
    handle, number = connect(writer), 0
    for _ in range(3):
        last = number
        for _ in range(300):
            writer.write(handle, T0 + number, number, wire_of(number))
            number += 1
        await_true(lambda last=last: writer.stats()["/a"].stored > last)
        getattr(rosCas, how)("/a")
        time.sleep(0.02)
    before = number
    for number in range(before, before + 300):
        writer.write(handle, T0 + number, number, wire_of(number))
    writer.close()
    assert losses == [] and writer.stats()["/a"].lost == 0
    found = wires(rosCas)
    every = [wire_of(n) for n in range(before + 300)]
    assert len(set(found)) == len(found) >= 300
    assert found == every[-len(found) :]
    assert told(rosCas) == (len(found),) * 3
