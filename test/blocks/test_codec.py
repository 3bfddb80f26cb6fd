# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Blocks give back what was packed into them, and bytes that are no block are refused."""

from __future__ import annotations

import random
import tracemalloc

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.blocks.codec import (
    LEVEL,
    MIN_PLANES,
    QUICK_LEVEL,
    VERSION,
    pack_block,
    unpack_block,
)

LONG = st.integers(-(2**63), 2**63 - 1)
WIRES = st.binary(max_size=6) | st.binary(min_size=4, max_size=4)


@st.composite
def blocks(draw):
    wires = draw(st.lists(WIRES, min_size=1, max_size=40))
    count = len(wires)
    times, seqs = (draw(st.lists(LONG, min_size=count, max_size=count)) for _ in range(2))
    received = draw(st.none() | st.lists(LONG, min_size=count, max_size=count))
    return times, seqs, wires, received


@given(blocks())
def test_round_trip(block):
    times, seqs, wires, received = block
    size = sum(map(len, wires))
    found = unpack_block(pack_block(times, seqs, wires, received), len(wires), size)
    assert (found.times.tolist(), found.seqs.tolist()) == (times, seqs)
    assert (None if found.received is None else found.received.tolist()) == received
    assert found.sizes.tolist() == [len(wire) for wire in wires]
    assert found.wires() == wires
    assert [found.wire(n) for n in range(len(found))] == wires
    assert sorted(n for group in found.groups for n in group.members.tolist()) == list(
        range(len(wires))
    )
    for group in found.groups:
        size, members, planes = group.size, group.members, group.planes
        assert planes.shape == (size, len(members))
        for n, position in enumerate(members.tolist()):
            assert planes[:, n].tobytes() == wires[position]


@pytest.mark.parametrize(("bits", "level"), [(8, QUICK_LEVEL), (2, LEVEL)])
def test_what_hardly_compresses_is_packed_quickly(bits, level):
    rng = random.Random(1)
    wires = [bytes(rng.getrandbits(bits) for _ in range(400)) for _ in range(250)]
    data = pack_block(range(250), range(250), wires)
    assert data == pack_block(range(250), range(250), wires)
    body = zstandard.ZstdDecompressor().decompress(data[2:])
    assert data[2:] == zstandard.ZstdCompressor(level=level).compress(body)
    assert unpack_block(data, 250, 100_000).wires() == wires


@pytest.mark.parametrize("sizes", [[5_000] * 40, range(5_000, 5_040), [100_000]])
def test_long_ones_that_do_not_compress_are_stored_as_they_are(sizes):
    rng = np.random.default_rng(1)
    wires = [rng.random(size // 4 + 1, np.float32).tobytes()[:size] for size in sizes]
    count, size = len(wires), sum(sizes)
    data = pack_block(range(count), range(count), wires, range(5, count + 5))
    assert data[1] & 4 and b"".join(wires) in data
    found = unpack_block(data, count, size)
    assert found.wires() == wires and [found.wire(n) for n in range(count)] == wires
    assert (found.times.tolist(), found.received.tolist()) == (
        list(range(count)),
        list(range(5, count + 5)),
    )
    for spoilt in (data[:-1], data + b"x", data[:2]):
        with pytest.raises(CorruptMessage):
            unpack_block(spoilt, count, size)


def test_the_bytes_stay_as_they_are():
    # What has other bytes is another version.
    wires = [bytes((n, 7, 255 - n)) for n in range(MIN_PLANES)] + [b"", b"text"]
    data = pack_block(range(100, 118), range(5, 23), wires, range(90, 108))
    assert data[:2] == b"\x01\x01"
    body = zstandard.ZstdDecompressor().decompress(data[2:])
    count = len(wires)
    assert body[:count] == b"\x64" + b"\x01" * (count - 1)
    sizes = body[16 * count : 17 * count]
    assert sizes == b"\x03" * MIN_PLANES + b"\x00\x04"
    received = body[20 * count : 21 * count]
    assert received == b"\xf6" * count
    messages = bytes(range(16)) + b"\x07" * 16 + bytes(range(255, 239, -1)) + b"text"
    assert body[28 * count :] == b"\0\0" + messages


@pytest.mark.parametrize("version", [0, VERSION + 1])
def test_a_block_of_another_version_is_refused(version):
    data = bytes([version]) + pack_block([1], [3], [b"ab"])[1:]
    with pytest.raises(CorruptMessage, match=f"version {version}, .* only version {VERSION}: .*"):
        unpack_block(data, 1, 2)


@pytest.mark.parametrize("spoil", ["empty", "flags", "frame", "cut", "count", "size"])
def test_what_is_no_block_is_refused(spoil):
    data, count, size = pack_block([1, 2], [3, 4], [b"ab", b"c"]), 2, 3
    if spoil == "empty":
        data = b""
    elif spoil == "flags":
        data = data[:1] + b"\x10" + data[2:]
    elif spoil == "frame":
        data = data[:2] + b"nonsense"
    elif spoil == "cut":
        data = data[:-3]
    elif spoil == "count":
        count = 3
    else:
        size = 4
    with pytest.raises(CorruptMessage):
        unpack_block(data, count, size)


def test_a_frame_that_claims_to_be_huge_takes_no_memory():
    # Its own header says 2**62 bytes: no memory is reserved for them.
    params = zstandard.ZstdCompressionParameters.from_level(1)
    frame = zstandard.ZstdCompressor(compression_params=params).compress(b"x")
    huge = b"\x28\xb5\x2f\xfd\xe0" + (2**62).to_bytes(8, "little") + frame[6:]
    with pytest.raises(CorruptMessage):
        unpack_block(b"\x01\x00" + huge, 1, 1)


@pytest.mark.parametrize("count, size", [(1, -5), (-1, 35)])
def test_fewer_than_no_bytes_or_messages_are_refused(count, size):
    data = b"\x01\x00" + zstandard.ZstdCompressor().compress(bytes(15))
    with pytest.raises(CorruptMessage):
        unpack_block(data, count, size)


@pytest.mark.parametrize("count", [1, 10**6])
def test_a_bomb_is_not_unpacked(count):
    """A row may say anything of its block, also that it holds a gigabyte, which its frame does."""
    size = 1 << 30
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    parts = [packer.compress(bytes(1 << 20)) for _ in range(size >> 20)]
    data = bytes([VERSION, 0]) + b"".join([*parts, packer.flush()])
    assert len(data) < 200_000
    tracemalloc.start()
    try:
        with pytest.raises(CorruptMessage, match="too many"):
            unpack_block(data, count, size - 20 * count)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_sizes_that_a_block_only_states_take_no_memory():
    """With words or layouts the packed bytes are fewer than those of the messages."""
    data = pack_block([5], [1], [b"x" * 600], None)
    for flags in range(16):
        with pytest.raises(CorruptMessage):
            unpack_block(bytes([VERSION, flags]) + data[2:], 1, 2**31 - 1)
