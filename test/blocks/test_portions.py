# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages that come together, in the order of rows."""

from __future__ import annotations

import math
import random
from types import SimpleNamespace

import pytest
from blocks.stored_blocks import MS, T0, list_blocks, make_table, put_block
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import Float32, Float64, String

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import Position
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.query.arrays.batch import Window
from cassandra_ros.read import EVERYTHING, Read, TimeRange
from cassandra_ros.store.tables.held_portions import HeldPortions, rows_of
from cassandra_ros.store.tables.row_table import encode_long
from cassandra_ros.store.tables.table_layout import Portion

BUCKET = 100 * MS
FORMATS = ("packed", "binary", "ros")


def numbers_of(first, count, step, writer=5):
    """Messages of one writer: (t, seq, wire)."""
    numbers = range(first, first + count)
    return [(T0 + n * step, writer << 32 | n, serialize(Float64(n))) for n in numbers]


def positions(messages):
    """The position of each message, and how many came together each time."""
    found, sizes = [], []
    for message in messages:
        if isinstance(message, Window):
            found += [message.position_of(n) for n in range(len(message))]
            assert message.position == found[-1]
            sizes.append(len(message))
        else:
            found.append(message.position)
    return found, sizes


def check(topic, read=EVERYTHING):
    """Compare with rows, and return how many messages came together each time."""
    found, sizes = positions(topic.in_order(read, lambda table: 32))
    assert found == [row.position for row in topic.read(read)]
    assert found == sorted(found)
    return sizes


@pytest.fixture
def put(rosCas):
    """Puts blocks of some robots: {node: [block, ...]}; returns the topic."""

    def put_blocks(blocks):
        table, conn = make_table(rosCas, "/p", Float64, bucket_ns=BUCKET, span_ns=60 * MS)
        for node, of_node in blocks.items():
            list_blocks(rosCas, table, node, of_node)
            for block in of_node:
                put_block(rosCas, table, node, conn, block)
        return rosCas.getTopic("/p")

    return put_blocks


def test_blocks_that_overlap_no_other(put):
    half = MS // 2
    topic = put({"a": [numbers_of(40 * n, 40, half) for n in range(7)]})  # five in a bucket
    assert check(topic) == [40] * 7
    inside = Read(TimeRange(T0 + 8 * half, T0 + 236 * half))
    assert check(topic, inside) == [32, 40, 40, 40, 40, 37]
    at = Position(T0 + 43 * half, "a", 5 << 32 | 43, topic.tables[0].name)
    assert check(topic, Read(after=at)) == [36, 40, 40, 40, 40, 40]


def test_blocks_of_two_writers_that_overlap(put):
    first, second = numbers_of(0, 40, MS), numbers_of(20, 40, MS, writer=6)
    topic = put({"a": [first, second, numbers_of(60, 35, MS)]})
    assert check(topic) == [40 + 40, 35]


def test_two_robots_at_the_same_time_and_one_after_the_other(put):
    topic = put(
        {
            "a": [numbers_of(0, 40, MS), numbers_of(100, 40, MS)],
            "b": [numbers_of(10, 40, MS), numbers_of(150, 40, MS), numbers_of(200, 40, MS)],
        }
    )
    assert check(topic) == [40 + 40, 40, 40, 40]


def test_a_block_is_cut_about_once_of_however_many_robots(put):
    """Twelve robots, whose blocks begin one after the other."""
    count = 60
    blocks = {
        f"robot {n}": [numbers_of(5 * n + count * k, count, MS // 20) for k in range(20)]
        for n in range(12)
    }
    topic = put(blocks)
    windows = [m for m in topic.in_order(EVERYTHING, lambda table: 1) if isinstance(m, Window)]
    check(topic)
    batches = [batch for window in windows for batch in window.batches]
    assert sum(map(len, batches)) == 12 * 20 * count
    assert len(batches) <= 2.5 * 12 * 20
    assert max(map(len, windows)) <= 4 * 12 * count


def test_of_a_slow_topic_beside_a_fast_one_few_buckets_are_read_at_once(rosCas):
    """One page of the slow table takes as long as all buckets of the fast one."""
    for name, msg_class, count, step, bucket in (
        ("slow", String, 40, 250 * MS, 3600 * 1000 * MS),
        ("fast", Float64, 5000, 2 * MS, BUCKET),
    ):
        definition = definition_of(msg_class)
        with rosCas.messageWriter(format="packed", writer_id=7, nodeID=name) as writer:
            handle = writer.connect(api_connection("/p", definition, "/x"), bucket_ns=bucket)
            for n in range(count):
                message = msg_class(str(n) if msg_class is String else n)
                writer.write(handle, T0 + n * step, n, serialize(message))
    topic = rosCas.getTopic("/p")
    assert len(topic.tables) == 2
    met = []

    def skip(table, node, bucket):
        met.append(bucket)
        return False

    check(topic)
    messages = topic.in_order(Read(skip=skip), lambda table: 1)
    assert len(next(messages)) < 500
    assert len(met) < 20
    list(messages)
    assert len(met) == 101


@pytest.mark.parametrize("seed", range(3))
def test_equal_times_in_blocks_that_overlap(put, seed):
    """Two robots, of each two writers, whose blocks are cut among messages of one time."""
    chance, blocks = random.Random(seed), {"a": [], "b": []}
    for node, writer in (("a", 5), ("a", 6), ("b", 7), ("b", 5)):
        for k in range(6):
            times = sorted(chance.randint(k, k + 2) for _ in range(50))
            block = enumerate(times, 50 * k)
            blocks[node].append(
                [(T0 + t * MS, writer << 32 | n, serialize(Float64(n))) for n, t in block]
            )
    topic = put(blocks)
    check(topic)
    found, _ = positions(topic.in_order(EVERYTHING, lambda table: 1))
    every = [(t, node, seq) for node, made in blocks.items() for b in made for t, seq, _ in b]
    assert [position[:3] for position in found] == sorted(every)
    assert len(topic.tables) == 1 and len(found) == 1200


def test_a_damaged_block_among_others(put, rosCas, caplog):
    topic = put({"a": [numbers_of(0, 40, MS), numbers_of(40, 40, MS)]})
    table = topic.tables[0]
    (conn,) = {row.conn for row in topic.read(EVERYTHING)}
    overlapping = numbers_of(20, 40, MS, writer=6)
    put_block(rosCas, table, "a", conn, overlapping, _crc=encode_long(1))
    list_blocks(rosCas, table, "a", [overlapping])
    messages = list(topic.in_order(EVERYTHING, lambda table: 1))
    found, sizes = positions(messages)
    assert found == [row.position for row in topic.read(EVERYTHING)]
    assert len(found) == 81 and sizes == [40]  # beside the damaged block messages come as rows
    (damaged,) = (row for row in messages[:41] if row.seq == overlapping[0][1])
    with pytest.raises(CorruptMessage, match="wrong checksum"):
        _ = damaged.wire
    assert "wrong checksum" in caplog.text


class Numbers(Portion):
    """Messages that are numbers."""

    nbytes = 1

    def __init__(self, node, numbers):
        self.node, self.table, self.numbers = node, SimpleNamespace(name="t"), numbers
        self.ends, self.most = ((numbers[0], 0), (numbers[-1], 0)), len(numbers)

    def __len__(self):
        return self.most

    def _cut(self, last):
        head = [n for n in self.numbers if (n, 0) <= last]
        return Numbers(self.node, head), Numbers(self.node, self.numbers[len(head) :])

    def rows(self):
        return [(n, self.node, 0, "t") for n in self.numbers]

    def stacked(self):
        raise NotImplementedError


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sets(st.integers(0, 30), min_size=1))))
def test_held_portions_are_taken_in_order(portions):
    made = sorted([Numbers(node, sorted(set_)) for node, set_ in portions], key=lambda p: p.begin)
    every = sorted(row for portion in made for row in portion.rows())
    held, taken = HeldPortions(), []
    for portion in made:
        if held and held.are_enough(portion.begin):
            rows = list(rows_of(held.take(portion.begin)))
            assert all(row < portion.begin for row in rows)
            taken += rows
        held.add(portion)
    taken += rows_of(held.take(None))
    assert taken == every and not held


def test_few_messages_come_as_rows(put):
    assert check(put({"a": [numbers_of(0, 31, MS), numbers_of(31, 32, MS)]})) == [32]


def test_deleted_messages_are_left_out(put):
    topic = put({"a": [numbers_of(0, 40, MS), numbers_of(40, 40, MS)]})
    assert topic.removeData(T0 + 3 * MS, T0 + 5 * MS) == 3
    assert check(topic) == [37, 40]
    assert topic.removeData(T0 + 10 * MS, T0 + 39 * MS) == 30
    assert check(topic) == [40]


@pytest.mark.parametrize("name", FORMATS)
def test_pages_of_rows(rosCas, name):
    """The messages of two definitions lie between each other for a while."""
    ticks = [(n, Float64(n)) for n in range(300)] + [(n, String("x" * 40)) for n in range(250, 700)]
    with rosCas.messageWriter(format=name, writer_id=7) as writer:
        for t, message in ticks:
            definition = definition_of(type(message))
            handle = writer.connect(api_connection("/p", definition, "/x"), bucket_ns=1000 * MS)
            writer.write(handle, T0 + t * MS, t, serialize(message))
    topic = rosCas.getTopic("/p")
    assert len(topic.tables) == 2
    check(topic)
    check(topic, Read(TimeRange(T0 + 400 * MS, T0 + 500 * MS)))
    assert check(topic, Read(TimeRange(T0 + 300 * MS)))


@pytest.mark.parametrize("name", FORMATS)
def test_statements_over_robots_that_recorded_at_the_same_time(rosCas, name):
    chance = random.Random(name)
    wanted = []
    with rosCas.messageWriter(format=name, writer_id=7) as writer:
        for node in ("a", "b", "c"):
            for n in range(chance.randint(300, 400)):
                message = chance.choice([Float64, Float32])(
                    chance.choice([0.0, -0.0, 1.5, float(n)])
                )
                definition = definition_of(type(message))
                handle = writer.connect(
                    api_connection("/p", definition, "/x"), node=node, bucket_ns=1000 * MS
                )
                t = T0 + (chance.randint(0, 5) + 7 * n) * MS
                writer.write(handle, t, n, serialize(message))
                wanted.append((t, node, 7 << 32 | n, handle.table.name, message.data))
    wanted.sort(key=lambda message: message[:4])
    rows = rosCas.executeCQL("select KEY, NODE, data from p")
    assert [(k.ns, k.node, k.seq, k.table, repr(d)) for k, _, d in rows] == [
        (*place, repr(data)) for *place, data in wanted
    ]
    assert [node for _, node, _ in rows] == [node for _, node, *_ in wanted]
    if name == "packed":
        topic = rosCas.getTopic("/p")
        assert max(check(topic)) > 200
    high = [data for *_, data in wanted if not data < 1]
    assert rosCas.executeCQL("select count(*), sum(data) from p where not data < 1") == [
        (len(high), math.fsum(high))
    ]
    by_node = {}
    for _, node, _, _, data in wanted:
        by_node.setdefault((node, data), []).append(data)
    grouped = rosCas.executeCQL("select NODE, data, count(*) from p group by NODE, data")
    assert repr(list(grouped)) == repr(
        [(node, values[0], len(values)) for (node, _), values in by_node.items()]
    )
    # The first of equal values: 0.0 and -0.0 are equal.
    least = next(data for *_, data in wanted if data == 0)
    assert repr(rosCas.executeCQL("select min(data) from p")) == f"[({least},)]"


@pytest.mark.parametrize("name", FORMATS)
def test_a_result_goes_on_after_each_of_its_rows(rosCas, name):
    chance = random.Random(name)
    with rosCas.messageWriter(format=name, writer_id=7) as writer:
        handle = writer.connect(api_connection("/p", definition_of(Float64), "/x"))
        for n in range(500):
            writer.write(handle, T0 + n // 2 * MS, n, serialize(Float64(n)))
    for where in ("", " where data > 100 and not data = 110"):
        wanted = rosCas.executeCQL(f"select data, KEY from p{where}")
        assert [row[0] for row in wanted] == [
            n for n in range(500) if not where or n > 100 and n != 110
        ]
        for count in chance.sample(range(1, len(wanted)), 5):
            result = rosCas.iterCQL(f"select data, KEY from p{where}")
            taken = [next(result) for _ in range(count)]
            key = taken[-1][1]
            assert result.position[:4] == (key.ns, key.node, key.seq, key.table)
            after = rosCas.iterCQL(f"select data, KEY from p{where}", after=result.cursor)
            assert taken + list(after) == wanted
