# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Groups of a block are laid out as they compress best, and come back as they were."""

from __future__ import annotations

import numpy as np
import pytest
import zstandard

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.wire.message_stacks import planes_of
from cassandra_ros.store.blocks.codec import lay_out, pack_block, read_layout, unpack_block

RNG = np.random.default_rng(3)
COUNT = 400


def cost(data):
    return len(zstandard.ZstdCompressor(level=1).compress(data))


def laid_out(rows):
    return b"".join(lay_out([row.tobytes() for row in rows], cost))


def columns_of(*columns):
    """Messages of some columns, each (COUNT,), one behind the other."""
    parts = [np.ascontiguousarray(c).view(np.uint8).reshape(COUNT, -1) for c in columns]
    return np.ascontiguousarray(np.concatenate(parts, axis=1))


NUMBERS = np.arange(COUNT, dtype="<u4") + 250
FEW = RNG.random(12)
GROUPS = {
    "counters": columns_of(NUMBERS, NUMBERS * 3, RNG.random(COUNT)),
    "few values": columns_of(NUMBERS, RNG.choice(FEW, COUNT), RNG.choice(FEW, COUNT), NUMBERS),
    "odd size": columns_of(RNG.choice(FEW, COUNT), RNG.choice(FEW, COUNT), NUMBERS)[:, 1:],
    "random": RNG.integers(0, 256, (COUNT, 30), np.uint8),
    "one byte": columns_of(np.arange(COUNT, dtype=np.uint16).astype(np.uint8)),
    "many of one byte": np.arange(5000).astype(np.uint8)[:, None],
    "small": RNG.integers(0, 256, (16, 3), np.uint8),
    "seven bytes": np.tile(NUMBERS[:, None].astype(np.uint8), (1, 7)),
    "long and random": RNG.random((COUNT // 8, 300), np.float32).view(np.uint8),
    "large": np.tile(columns_of(NUMBERS, RNG.choice(FEW, COUNT)), (1, 60)),
}


@pytest.mark.parametrize("name", GROUPS)
def test_a_group_comes_back(name):
    rows = GROUPS[name]
    count, size = rows.shape
    data = laid_out(rows)
    laid = read_layout(memoryview(data + b"next"), size, count)
    assert laid.length == len(data)
    expected = np.ascontiguousarray(rows.T) if laid.as_planes else rows
    if laid.rises is None:
        assert bytes(laid.data) == expected.tobytes()
    else:
        stored = np.frombuffer(laid.data, np.uint8).reshape(size, count)
        assert planes_of(stored, laid.rises)[:].tobytes() == expected.tobytes()
    wires = [row.tobytes() for row in rows] + [b"other"]
    packed = pack_block(range(len(wires)), range(len(wires)), wires)
    found = unpack_block(packed, len(wires), sum(map(len, wires)))
    assert found.wires() == wires
    assert [found.wire(n) for n in range(len(wires))] == wires
    groups = [group for group in found.groups if len(group.members) > 1]
    assert [group.planes.tobytes() for group in groups] == [rows.T.tobytes()]
    planes = [planes_of(group.stored, group.rises) for group in groups]
    assert [p[:].tobytes() for p in planes] == [rows.T.tobytes()]
    for part in (slice(1, 3), slice(None), np.array([[0], [size - 1]])):
        assert (planes[0][part] == rows.T[part]).all()
    for part in (0, count - 1, np.arange(count) % 3 == 0):
        assert (planes[0][:, part] == rows.T[:, part]).all()


def test_what_compresses_best_is_taken():
    counters, few = (laid_out(GROUPS[n]) for n in ("counters", "few values"))
    assert counters[0] == 0 and counters[1] != 0 and few[0] == 1
    for name, data in (("counters", counters), ("few values", few)):
        assert cost(data) < 0.9 * cost(np.ascontiguousarray(GROUPS[name].T).tobytes())


def test_long_ones_that_planes_hardly_save_stand_as_they_are():
    random = GROUPS["long and random"]
    assert laid_out(random) == b"\x02" + random.tobytes()
    # It is looked at in several places: noise at one end is not all.
    for part in (slice(300), slice(-300, None)):
        half = random.copy()
        half[:, part] = 0
        half[:, 600:900] = 0
        assert laid_out(half)[0] == 0


@pytest.mark.parametrize("spoil", ["kind", "cut", "empty"])
def test_what_is_no_group_is_refused(spoil):
    rows = GROUPS["few values"]
    data = laid_out(rows)
    data = {"kind": b"\x03" + data[1:], "cut": data[:-1], "empty": b""}[spoil]
    with pytest.raises(CorruptMessage):
        read_layout(memoryview(data), rows.shape[1], rows.shape[0])


def test_bytes_besides_the_messages_are_refused():
    wires = [b"12"] * 20
    body = zstandard.ZstdDecompressor().decompress(pack_block(range(20), range(20), wires)[2:])
    data = b"\x01\x00" + zstandard.ZstdCompressor().compress(body + b"x")
    with pytest.raises(CorruptMessage, match="belong"):
        unpack_block(data, 20, 40)
