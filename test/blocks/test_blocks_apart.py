# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Blocks that are damaged, expired, overlapping or deleted by two at once."""

from __future__ import annotations

import zlib

import pytest
from blocks.stored_blocks import MS, SEC, T0, list_blocks, make_table, put_block
from nodes.children import await_true
from sensor_msgs.msg import Imu
from std_msgs.msg import String, UInt8MultiArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.keys import Position
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.blocks import block_row
from cassandra_ros.store.blocks.block_deletion import BlockDeletion
from cassandra_ros.store.tables.row_table import (
    LARGE_MESSAGE_CHUNK_BYTES,
    BlockKey,
    encode_int,
    encode_long,
)

NODE = ""
BUCKETS_AT_ENDS = 2


def texts(first, count, step=MS, writer=5):
    """Messages of one writer: (t, seq, wire)."""
    numbers = range(first, first + count)
    return [(T0 + n * step, writer << 32 | n, serialize(String(data=str(n)))) for n in numbers]


@pytest.fixture
def three(rosCas):
    """Three blocks of ten messages, a ms from one to the next: topic, table and the blocks."""
    table, conn = make_table(rosCas)
    blocks = [texts(10 * n, 10) for n in range(3)]
    list_blocks(rosCas, table, NODE, blocks)

    def put(n, **changed):
        put_block(rosCas, table, NODE, conn, blocks[n], **changed)

    for n in range(3):
        put(n)
    return rosCas.getTopic("/p"), table, blocks, put


DAMAGE = {
    "a bit": {"_crc": encode_long(1)},
    "no bytes": {"_data": None},
    "a wrong count": {"_n": encode_int(9)},
    "a wrong size": {"_size": encode_int(7)},
    "another version": {
        "_data": b"\x09\x00",
        "_crc": encode_long(zlib.crc32(b"\x09\x00")),
    },
    "another end": {"_last": encode_long(T0 + 30 * MS)},
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_block_hides_no_other(three, damage):
    topic, _, blocks, put = three
    put(1, **DAMAGE[damage])
    rows = list(topic.rows())
    assert [r.t for r in rows] == [t for t, _, _ in [*blocks[0], blocks[1][0], *blocks[2]]]
    assert [r.t for r in topic.rows(reverse=True)] == [r.t for r in rows][::-1]
    with pytest.raises(CorruptMessage, match=rf"topic /p.* {T0 + 10 * MS} .*import or record"):
        rows[10].message()
    with pytest.raises(CorruptMessage, match=r"removeData\("):
        topic.getData(T0 + 12 * MS)
    # It reaches into what is asked for, and none of the rows there would tell.
    for reverse in (False, True):
        with pytest.raises(CorruptMessage, match="import or record"):
            list(topic.rows(T0 + 15 * MS, T0 + 25 * MS, reverse=reverse))
    assert topic.getData(T0 + 5 * MS).data == "5"
    assert topic.getData(T0 + 25 * MS, nearest="before").data == "25"
    # As the text says.
    last = 30 if damage == "another end" else 19
    topic.removeData(T0 + 10 * MS, T0 + last * MS)
    left = 10 if damage == "another end" else 20
    assert len(list(topic.items())) == left == topic.countTopicData()


def test_what_is_deleted_twice_is_deleted_once(rosCas, three):
    """Two clients read the same messages, and both delete them, and others, at the same time."""
    topic, table, blocks, _ = three
    some = [list(topic.rows(T0 + 3 * MS, T0 + 12 * MS)) for _ in range(2)]
    for rows in some:
        for row in rows:
            key, place = row.block
            cutter(rosCas, table).cut({key: {place}})
    assert [r.t for r in topic.rows()] == [
        t for block in blocks for t, _, _ in block if not T0 + 3 * MS <= t <= T0 + 12 * MS
    ]


def cutter(rosCas, table):
    return BlockDeletion(rosCas.cassandra, table, NODE, table.bucket_of(T0))


def test_a_mark_in_a_block_that_is_gone_leaves_nothing(rosCas, three, cql):
    topic, table, blocks, put = three
    first = BlockKey(*blocks[0][0][:2], 10)
    cutter(rosCas, table).cut({first: set(range(10))})
    cutter(rosCas, table).cut({first: {1, 2}})
    assert len(cql.execute(f'SELECT "_t" FROM {table.qualified}').all()) == 2
    # Also where the mark has come behind the check.
    cql.execute(
        f'UPDATE {table.qualified} SET "_gone" = "_gone" + {{3}} WHERE "_node" = \'\' AND '
        f'"_bucket" = {table.bucket_of(T0)} AND "_t" = {first.t} AND "_seq" = {first.seq}'
    )
    assert len(list(topic.rows())) == 20
    assert topic.getRow(T0 + 3 * MS) is None
    assert topic.countTopicData(T0, T0 + 15 * MS) == 6
    put(0)  # imported again: all of it is there
    assert len(list(topic.rows())) == 30


def test_what_was_cut_out_is_found_by_no_key(three):
    topic, _, _, _ = three
    key = topic.getRow(T0 + 14 * MS).key
    topic.removeData(key)
    assert topic.getRow(key) is None
    assert topic.getRow(T0 + 14 * MS) is None
    assert topic.getRow(T0 + 14 * MS, nearest="before").t == T0 + 13 * MS
    assert topic.getRow(T0 + 14 * MS, nearest="after").t == T0 + 15 * MS
    assert topic.countTopicData() == 29
    assert topic.removeData(where="data = '13' or data = '29'") == 2
    assert topic.last().ns == T0 + 28 * MS
    assert topic.countTopicData() == 27


def test_a_block_as_long_as_its_span_is_found_by_its_last_message(rosCas):
    """It begins exactly as long before what is asked for as a block may last, and so does the one
    before it, which ends a nanosecond too early."""
    span = 20 * MS
    table, conn = make_table(rosCas, span_ns=span)
    wire = serialize(String(data="x"))
    longest = [(T0, 5 << 32 | 1, wire), (T0 + 7, 5 << 32 | 2, wire), (T0 + span, 5 << 32 | 3, wire)]
    shorter = [(T0, 6 << 32 | 1, wire), (T0 + span - 1, 6 << 32 | 2, wire)]
    for block in (longest, shorter):
        put_block(rosCas, table, NODE, conn, block)
    list_blocks(rosCas, table, NODE, [longest, shorter])
    topic, last = rosCas.getTopic("/p"), T0 + span
    for high in (last, last + 1, last + 10 * SEC):
        assert topic.countTopicData(last, high) == 1
        assert [row.t for row in topic.rows(last, high)] == [last]
        assert [row.t for row in topic.rows(last, high, reverse=True)] == [last]
    assert topic.countTopicData(last - 1, last) == 2
    assert topic.countTopicData(last + 1, last + 10 * SEC) == 0
    assert topic.getRow(last).key.seq == 5 << 32 | 3
    assert topic.getRow(last, nearest="after").t == last
    assert topic.getRow(last + 5, nearest="before").t == last
    assert topic.removeData(last, last + SEC) == 1
    assert topic.countTopicData() == 4


@pytest.mark.parametrize(
    ("low", "high"),
    [(3, 3), (3, 6), (0, 0), (9, 9), (0, 8), (1, 9), (0, 9), (9, 10), (8, 12), (10, 18), (5, 24)],
)
def test_a_deletion_takes_what_lies_on_its_ends_and_nothing_beside(three, low, high):
    """Messages lie exactly on both ends, and a nanosecond before and after them, in the same
    block and in the next one."""
    topic, _, blocks, _ = three
    times = [t for block in blocks for t, _, _ in block]
    first, last = T0 + low * MS, T0 + high * MS
    assert {first, last} <= set(times)
    assert topic.removeData(first + 1, first + MS - 1) == 0  # between two messages
    deleted = [t for t in times if first <= t <= last]
    assert topic.removeData(first, last) == len(deleted) == high - low + 1
    left = [t for t in times if t not in deleted]
    assert [row.t for row in topic.rows()] == left
    assert topic.countTopicData() == len(left)
    for t in (first, last):
        assert topic.getRow(t) is None
    for t in (first - MS, last + MS):
        assert (topic.getRow(t) is None) == (t not in times)


def test_a_deletion_of_messages_of_equal_times_takes_those_that_are_meant(rosCas):
    """One by its key, among others of the same time in the same block and in another one."""
    table, conn = make_table(rosCas)
    wires = [serialize(String(data=str(n))) for n in range(6)]
    t = T0 + 50 * MS  # amid a bucket
    one = [(t - (n == 0), 5 << 32 | n, wires[n]) for n in range(3)]
    other = [(t + (n == 5), 6 << 32 | n, wires[n]) for n in range(3, 6)]
    for block in (one, other):
        put_block(rosCas, table, NODE, conn, block)
    list_blocks(rosCas, table, NODE, [one, other])
    topic = rosCas.getTopic("/p")
    keys = {row.wire: row.key for row in topic.rows()}
    for n in (2, 3):
        topic.removeData(keys[wires[n]])
    assert [row.wire for row in topic.rows()] == [wires[n] for n in (0, 1, 4, 5)]
    assert topic.removeData(t, t) == 2
    assert [row.wire for row in topic.rows()] == [wires[0], wires[5]]


def test_large_messages_lie_in_chunks(rosCas):
    definition = definition_of(UInt8MultiArray)
    sizes = [10, LARGE_MESSAGE_CHUNK_BYTES + 5, 20, 2 * LARGE_MESSAGE_CHUNK_BYTES]
    wires = [serialize(UInt8MultiArray(data=bytes([n]) * size)) for n, size in enumerate(sizes)]
    with rosCas.messageWriter(format="packed") as writer:
        handle = writer.connect(api_connection("/large", definition, "/x"))
        for n, wire in enumerate(wires):
            writer.write(handle, T0 + n * MS, n, wire)
    topic = rosCas.getTopic("/large")
    assert [row.wire for row in topic.rows()] == wires
    assert [row.wire for row in topic.rows(reverse=True)] == wires[::-1]
    assert topic.getRow(T0 + 3 * MS).wire == wires[3]
    assert topic.removeData(T0 + MS, T0 + 2 * MS) == 2
    assert [row.wire for row in topic.rows()] == [wires[0], wires[3]]
    topic.removeData(topic.getRow(T0 + 3 * MS).key)
    chunks = f'"{rosCas.catalog.keyspace.name}"."{topic.tables[0].name}_c"'
    assert not rosCas.cassandra.execute(f"SELECT * FROM {chunks}", what="looking")
    assert topic.countTopicData() == 1


class Counted:
    """Counts the requests that read, and the blocks that are unpacked."""

    def __init__(self, rosCas, patch):
        self.requests = self.blocks = 0
        send, unpack = rosCas.cassandra.ask_raw, block_row.unpack_block

        def sent(*args):
            self.requests += 1
            return send(*args)

        def unpacked(*args):
            self.blocks += 1
            return unpack(*args)

        patch.setattr(rosCas.cassandra, "ask_raw", sent)
        patch.setattr(block_row, "unpack_block", unpacked)

    def of(self, call):
        before = self.requests, self.blocks
        call()
        return self.requests - before[0], self.blocks - before[1]


@pytest.mark.parametrize(
    "count", [20_000, pytest.param(10**6, marks=pytest.mark.suite("all", "a million messages"))]
)
def test_a_lookup_reads_few_of_overlapping_blocks(rosCas, monkeypatch, count):
    """Two writers, whose blocks overlap all the time."""
    step, wire = MS, serialize(String(data="x" * 50))
    writers = [rosCas.messageWriter(writer_id=n, format="packed") for n in (1, 2)]
    definition = definition_of(String)
    handles = [
        writer.connect(api_connection("/p", definition, f"/x{n}"), bucket_ns=60 * SEC)
        for n, writer in enumerate(writers)
    ]
    for n in range(count):
        writers[n % 2].write(handles[n % 2], T0 + n * step, n, wire)
    for writer in writers:
        writer.close()
    topic, seen = rosCas.getTopic("/p"), Counted(rosCas, monkeypatch)
    middle = T0 + count // 2 * step
    keys = [topic.getRow(middle + n * 777 * step).key for n in range(4)]
    reads = {
        "exact": (lambda: topic.getData(keys[1]), 1, 1),
        "by time": (lambda: topic.getData(middle), 1, 2),
        "absent": (lambda: topic.getRow(middle + 1), 1, 2),
        "before": (lambda: topic.getData(middle + 1, nearest="before"), 2, 2),
        "after": (lambda: topic.getData(middle + 1, nearest="after"), 2, 2),
        "first": (topic.first, 3, 2),
        "last": (topic.last, 3, 2),
        "ten": (lambda: list(topic.items(middle, T0 + 10**18, limit=10)), 3, 3),
        "ten back": (lambda: list(topic.items(limit=10, reverse=True)), 3, 3),
        "newest": (lambda: rosCas.executeCQL("select KEY from p order by KEY desc limit 1"), 3, 2),
        "count": (lambda: topic.countTopicData(T0 + 1, middle), 2 * BUCKETS_AT_ENDS, 8),
    }
    for name, (call, requests, blocks) in reads.items():
        call()
        asked, opened = seen.of(call)
        assert asked <= requests, (name, asked)
        assert opened <= blocks, (name, opened)


def test_messages_of_packed_and_other_tables_come_in_one_order(rosCas):
    definition = definition_of(String)
    for number, format_name in enumerate(["packed", "binary", "packed"]):
        node = f"n{number}"
        with rosCas.messageWriter(format=format_name, nodeID=node, writer_id=3 - number) as writer:
            handle = writer.connect(api_connection("/p", definition, "/x"), bucket_ns=SEC)
            for n in range(30):
                writer.write(handle, T0 + n // 3 * 300 * MS, n, serialize(String(data=str(n))))
    topic = rosCas.getTopic("/p")
    assert len(topic.tables) == 2
    positions = [row.position for row in topic.rows()]
    assert len(positions) == 90
    assert positions == sorted(positions)
    assert [row.position for row in topic.rows(reverse=True)] == positions[::-1]
    for after in positions[::13]:
        rest = [p for p in positions if p > after]
        assert [row.position for row in topic.rows(after=after)] == rest
    at = [p for p in positions if p.t == T0 + 300 * MS]
    assert topic.getRow(T0 + 300 * MS).position == min(at)
    assert isinstance(at[0], Position)


@pytest.mark.suite("all", "it waits for seconds")
def test_expired_blocks_are_gone(rosCas):
    table, conn = make_table(rosCas, ttl=1)
    put_block(rosCas, table, NODE, conn, texts(0, 10))
    topic = rosCas.getTopic("/p")
    list_blocks(rosCas, table, NODE, [texts(0, 10)])
    cutter(rosCas, table).cut({BlockKey(T0, 5 << 32, 10): {2}})
    await_true(lambda: list(topic.rows()) == [])
    assert topic.countTopicData() == 0


def test_blocks_lie_by_a_time_in_the_message(rosCas, tmp_path):
    """Keys are the stamps, which jump; exported, and read, in the order of reception."""
    definition = definition_of(Imu)
    key = {"key_format": "msg_part", "key_part": "header.stamp"}
    rosCas.addTopic("/imu", msg_type="sensor_msgs/Imu", format="packed", **key)
    stamps = [T0 + n * 37 % 200 * MS for n in range(300)]
    wires = []
    for n, stamp in enumerate(stamps):
        message = Imu()
        message.header.seq, message.header.stamp = n, Stamp.from_ns(stamp)
        wires.append(serialize(message))
    with rosCas.messageWriter(writer_id=3) as writer:
        handle = writer.connect(api_connection("/imu", definition, "/x"), bucket_ns=SEC)
        for n, wire in enumerate(wires):
            writer.write(handle, T0 + 10 * SEC + n, n, wire)
    topic = rosCas.getTopic("/imu")
    assert topic.tables[0].packed
    order = sorted(range(300), key=lambda n: (stamps[n], n))
    assert [row.wire for row in topic.rows()] == [wires[n] for n in order]
    assert [row.received for row in topic.rows()] == [T0 + 10 * SEC + n for n in order]
    arrived = rosCas.readMessages(received=True)
    assert [row.wire for row in arrived] == wires
    window = rosCas.readMessages(key=T0 + 10 * SEC + 5, to_key=T0 + 10 * SEC + 9, received=True)
    assert [row.wire for row in window] == wires[5:10]
    assert topic.getRow(stamps[7]).wire == wires[min(n for n in order if stamps[n] == stamps[7])]
    export_bag(rosCas, tmp_path / "out.bag")
    assert verify_bag(rosCas, tmp_path / "out.bag").equal_messages == 300
    topic.removeData(where="header.seq = 12")
    report = verify_bag(rosCas, tmp_path / "out.bag")
    assert (report.missing, report.differences) == (1, 1)
