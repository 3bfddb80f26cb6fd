# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where blocks end: by rules that follow from the messages of one connection alone."""

from __future__ import annotations

import itertools
import zlib
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from suites import search
from threads import together

from cassandra_ros.messages.formats.binary import CassandraTopic_binary
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.blocks.block_builder import (
    ALL_BYTES,
    ALONE_BYTES,
    BlockLimits,
    Builders,
    limits_for,
    make_block,
)
from cassandra_ros.store.blocks.codec import unpack_block
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES

SPAN, BUCKET = 50, 170
SMALL = BlockLimits(7, 100)


class Table:
    """What a builder needs of a table."""

    def __init__(self, name="t_1"):
        self.name = name
        self.metadata = TopicMetadata("/a", "x/Y", "", "packed", BUCKET, span_ns=SPAN)
        self.encoder = CassandraTopic_binary("x/Y", "", None)


class Cutter:
    """Cuts messages into blocks, and keeps those."""

    def __init__(self, most=SMALL):
        self.blocks = []
        self.gone = set()
        self.builders = Builders(most, self._put, lambda: None, self.gone)

    def _put(self, builder, block):
        self.blocks.append((builder.conn, block))

    def add(self, messages, conn=1):
        builder = self.builders.get(Table(), "", conn)
        for t, seq, wire in messages:
            assert builder.add_message(t, seq, wire)
        return builder


def rows(blocks):
    return [(conn, block.times, block.seqs, block.data, block.crc) for conn, block in blocks]


messages = st.lists(
    st.tuples(
        st.one_of(st.integers(-20, 40), st.sampled_from([0, 0, 1, SPAN, SPAN + 1, -1, 500])),
        st.one_of(st.integers(0, 30), st.sampled_from([99, 100, 101])),
    ),
    max_size=60,
)


def made(steps, first=1000):
    """Messages from steps of time and sizes, numbered as they come."""
    found, t = [], first
    for n, (step, size) in enumerate(steps):
        t = max(0, t + step)
        found.append((t, 1 << 32 | n, bytes([n % 256]) * size))
    return found


@given(messages)
def test_every_message_is_in_one_block_and_the_rules_hold(steps):
    every = made(steps)
    cutter = Cutter()
    cutter.add(every)
    cutter.builders.seal()
    assert not cutter.builders.filling and cutter.builders.nbytes == 0
    found = []
    for _, block in cutter.blocks:
        n, size = len(block.wires), sum(map(len, block.wires))
        assert 1 <= n <= SMALL.messages
        assert size <= SMALL.bytes or n == 1
        assert block.times[-1] - block.times[0] <= SPAN
        assert len({t // BUCKET for t in block.times}) == 1
        keys = list(zip(block.times, block.seqs))
        assert keys == sorted(keys) and (block.t, block.seq) == keys[0]
        assert zlib.crc32(block.data) == block.crc
        unpacked = unpack_block(block.data, n, size)
        assert unpacked.wires() == list(block.wires)
        assert unpacked.times.tolist() == list(block.times)
        assert unpacked.seqs.tolist() == list(block.seqs)
        assert unpacked.received is None
        found += zip(block.times, block.seqs, block.wires)
    assert sorted(found) == sorted(every)
    # Blocks have keys of their own: none is written over another.
    assert len({(block.t, block.seq) for _, block in cutter.blocks}) == len(cutter.blocks)


@given(messages, st.lists(st.integers(1, 60), max_size=60))
def test_messages_that_are_taken_together_end_in_the_same_blocks(steps, lengths):
    every, one, many = made(steps), Cutter(), Cutter()
    one.add(every)
    builder = many.builders.get(Table(), "", 1)
    for length in [*lengths, len(every)]:
        run, every = every[:length], every[length:]
        if run:
            times, seqs = (np.array(column, np.int64) for column in list(zip(*run))[:2])
            assert builder.add_messages(times, seqs, [wire for _, _, wire in run]) == len(run)
    assert rows(many.blocks) == rows(one.blocks) and many.builders.nbytes == one.builders.nbytes
    many.gone.add("t_1")
    assert builder.add_messages(np.array([10**9]), np.array([1 << 32]), [b""]) == 0


@given(messages, messages, st.data())
def test_blocks_do_not_depend_on_the_other_connections(one, two, data):
    alone = Cutter()
    alone.add(made(one), conn=1)
    alone.builders.seal()
    together = Cutter()
    parts = {1: iter(made(one)), 2: iter(made(two))}
    left = [1] * len(one) + [2] * len(two)
    for conn in data.draw(st.permutations(left)):
        together.add([next(parts[conn])], conn)
    together.builders.seal()
    assert rows(b for b in together.blocks if b[0] == 1) == rows(alone.blocks)


@given(messages, st.integers(0, 60))
def test_what_a_killed_import_leaves_is_written_over(steps, stop):
    """A block that was stored before it was full has the key of the full one."""
    every = made(steps)
    whole, killed = Cutter(), Cutter()
    whole.add(every)
    killed.add(every[:stop])
    for cutter in (whole, killed):
        cutter.builders.seal()
    store = {(b.t, b.seq): b for _, b in itertools.chain(killed.blocks, whole.blocks)}
    assert sorted(rows((1, b) for b in store.values())) == sorted(rows(whole.blocks))


@search(40)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=200), st.integers(1, 4))
def test_messages_of_several_threads_are_all_there(steps, threads):
    cutter = Cutter()
    every = made([(step, 3) for step in steps])
    parts = [every[n::threads] for n in range(threads)]
    together(*(partial(cutter.add, part) for part in parts))
    cutter.builders.seal()
    found = [seq for _, block in cutter.blocks for seq in block.seqs]
    assert sorted(found) == [seq for _, seq, _ in every]


def test_a_large_message_is_alone():
    cutter = Cutter(BlockLimits())
    sizes = [10, ALONE_BYTES, ALONE_BYTES + 1, 10, 10, LARGE_MESSAGE_CHUNK_BYTES + 1, 10]
    cutter.add([(1000 + n, n, bytes(size)) for n, size in enumerate(sizes)])
    # The large ones do not wait.
    assert [len(block.wires) for _, block in cutter.blocks] == [2, 1, 2, 1]
    cutter.builders.seal()
    assert [len(block.wires) for _, block in cutter.blocks] == [2, 1, 2, 1, 1]
    large = cutter.blocks[3][1]
    assert large.in_chunks and large.data == b"" and large.crc == zlib.crc32(large.wire)


def test_a_full_block_does_not_wait():
    cutter = Cutter(BlockLimits())
    cutter.add([(1000, n, b"x") for n in range(1024)])
    assert [len(block.wires) for _, block in cutter.blocks] == [1024]


def test_a_message_that_would_pass_the_bytes_begins_the_next():
    cutter = Cutter(BlockLimits())
    cutter.add([(1000, n, bytes(60 * 1024)) for n in range(5)])
    assert [len(block.wires) for _, block in cutter.blocks] == [4]


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize("first", [3 * BUCKET - SPAN, 3 * BUCKET - SPAN // 2, 3 * BUCKET - 1])
def test_a_block_ends_with_its_bucket(together, first):
    """The last nanosecond of a bucket belongs to it, the next one begins another bucket."""
    end = 3 * BUCKET
    times = sorted({first, end - 1, end})
    assert [t // BUCKET for t in times] == [2] * (len(times) - 1) + [3]
    cutter = Cutter()
    builder = cutter.add([(t, n, b"") for n, t in enumerate(times)] if not together else [])
    if together:
        every = np.array(times, np.int64)
        assert builder.add_messages(every, np.arange(len(times)), [b""] * len(times)) == len(times)
    cutter.builders.seal()
    assert [list(block.times) for _, block in cutter.blocks] == [times[:-1], [end]]


@pytest.mark.parametrize("together", [False, True])
def test_a_block_is_as_long_as_its_span(together):
    """Both of its ends belong to it, the nanosecond after it does not."""
    times = [2 * BUCKET, 2 * BUCKET + SPAN, 2 * BUCKET + SPAN + 1]
    cutter = Cutter()
    builder = cutter.add([(t, n, b"") for n, t in enumerate(times)] if not together else [])
    if together:
        assert builder.add_messages(np.array(times, np.int64), np.arange(3), [b""] * 3) == 3
    cutter.builders.seal()
    assert [list(block.times) for _, block in cutter.blocks] == [times[:2], times[2:]]


def test_times_of_reception_are_kept():
    block = make_block(Table(), 1, [7, 5], [1, 2], [b"a", b"bc"], [100, 200])
    assert (block.times, block.seqs, block.received) == ([5, 7], [2, 1], [200, 100])
    assert unpack_block(block.data, 2, 3).received.tolist() == [200, 100]
    large = make_block(Table(), 1, [5], [2], [bytes(LARGE_MESSAGE_CHUNK_BYTES + 1)], [200])
    assert unpack_block(large.data, 1, 0).received.tolist() == [200]


def test_who_writes_a_message_anew_gets_what_was_taken():
    told = []
    cutter = Cutter()
    key_time = lambda received, wire: received // 10  # noqa: E731
    again = lambda *message: told.append(message)  # noqa: E731
    builder = cutter.builders.get(Table(), "", 1, key_time, again)
    sent = [(1020, 2, b"b"), (1010, 1, b"a"), (1030, 3, b"c")]
    for message in sent:
        assert builder.add_message(*message)
    cutter.builders.seal()
    for _, block in cutter.blocks:
        for again in block.rewriters():
            again()
    assert sorted(told) == sorted(sent)


def test_nothing_is_taken_for_a_table_that_is_gone():
    cutter = Cutter()
    builder = cutter.add([(1000, 1, b"a")])
    cutter.gone.add("t_1")
    assert builder.add_message(1001, 2, b"b")  # joins what waits, and goes where that goes
    assert not builder.add_message(5000, 3, b"c")
    assert [block.seqs for _, block in cutter.blocks] == [[1, 2]]


@pytest.mark.parametrize("connections", [0, 1, 10, 256, 257, 2000, 4096, 100_000])
def test_limits_bound_the_memory(connections):
    found = limits_for(connections)
    assert 16 * 1024 <= found.bytes <= 256 * 1024 and 64 <= found.messages <= 1024
    assert found == BlockLimits() or connections > 256
    if connections <= 4096:
        assert found.bytes * connections <= ALL_BYTES
