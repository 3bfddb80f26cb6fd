# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changed messages as wire bytes and as columns, and changed blocks of messages."""

from __future__ import annotations

import struct
from itertools import accumulate
from types import SimpleNamespace

import numpy as np
import pytest
import zstandard
from hostile.mutate import LONGS, changed_bytes
from messages.random_wire import DefinitionMaker, WireMaker, fuzzed, installedTypes

from cassandra_ros.messages.classes import installed_definition, message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.blocks.block_row import HEADER_COLUMNS, Block, read_block
from cassandra_ros.store.blocks.codec import VERSION, pack_block
from cassandra_ros.store.tables.checksum import crc32

TYPES = installedTypes()
BOMB_BYTES = 1 << 30
STORED = 4
"""Flag of a block whose messages are not compressed."""


def storages():
    """Every format, each with some installed types and some random ones."""
    found = [installed_definition(name) for name in TYPES[:: max(1, len(TYPES) // 25)]]
    found += [parse_definition(*DefinitionMaker(seed).make()) for seed in range(15)]
    made = [
        format_class(name)(each.type, each.md5sum, each) for each in found for name in FORMAT_NAMES
    ]
    for each in made:
        message_class(each.definition)
        each.encode_wire(b"")
    return made


@pytest.mark.suite("all", "a search")
def test_wire_buffers(give):
    every = storages()

    def attempt(chance):
        storage = chance.choice(every)
        maker = WireMaker(storage.definition, chance.getrandbits(32), odd=chance.random() < 0.5)
        wires = [maker.make() for _ in range(chance.choice((1, 1, 3, 20)))]
        at = chance.randrange(len(wires))
        changed = changed_bytes(chance, wires[at], range(0, len(wires[at]), 4), wires)
        wires[at] = fuzzed(wires[at], chance.getrandbits(32)) if chance.random() < 0.3 else changed
        storage.zones(wires)
        for wire, together in zip(wires, storage.encode_together(wires)):
            encoded = storage.encode_wire(wire)
            assert storage.decode_wire(encoded.columns, encoded.raw) == wire
            if together is not None and encoded.raw is None:
                assert together == b"".join(map(sized, encoded.columns))
        storage.decode(storage.encode_wire(wires[at]))

    give("wire buffers", 600, attempt)


def sized(column):
    return struct.pack(">i", -2) if column is None else struct.pack(">i", len(column)) + column


@pytest.mark.suite("all", "a search over changed inputs")
def test_columns(give):
    every = [storage for storage in storages() if storage.columns]

    def attempt(chance):
        storage = chance.choice(every)
        wire = WireMaker(storage.definition, chance.getrandbits(32)).make()
        columns = list(storage.encode_wire(wire).columns)
        if not columns:
            return
        for _ in range(chance.choice((1, 1, 3))):
            which = chance.randrange(len(columns))
            column = columns[which] or b""
            columns[which] = chance.choice((None, changed_bytes(chance, column)))
        rows = [b"".join(map(sized, columns)) for _ in range(3)]
        stops = np.array(list(accumulate(map(len, rows))), np.int64)
        starts = stops - [len(row) for row in rows]
        sizes = np.array([len(wire)] * 3, np.int64)
        together = storage.decode_together(b"".join(rows), starts, stops, sizes)
        assert all(found is None or type(found) is bytes for found in together)
        assert type(storage.decode_wire(columns, None)) is bytes

    give("columns", 3000, attempt)


TABLE = SimpleNamespace(name="t_1", metadata=SimpleNamespace(topic="/x"))


@pytest.mark.suite("all", "a search over changed inputs")
def test_blocks(give):
    """What a block's row says agrees with its bytes more often than chance would have it."""
    every = [storage for storage in storages() if storage.NAME == "packed"]
    bomb = make_bomb()

    def attempt(chance):
        storage = chance.choice(every)
        maker = WireMaker(storage.definition, chance.getrandbits(32))
        count = chance.choice((1, 2, 5, 17, 40, 200))
        wires = [maker.make() for _ in range(chance.choice((1, 3, count)))]
        wires = [chance.choice(wires) for _ in range(count)]
        times = sorted(chance.getrandbits(40) for _ in wires)
        seqs, size = list(range(count)), sum(map(len, wires))
        received = times if chance.random() < 0.3 else None
        data = changed_block(chance, pack_block(times, seqs, wires, received))
        if chance.random() < 0.02:
            data, times, size = bomb, [0] * chance.choice((1, 10**6)), BOMB_BYTES - 20
        row = block_row(chance, times, size, data)
        read = read_block(TABLE, row)
        if read is None:
            return
        block = Block(TABLE, "", read)
        low, high = sorted((chance.randrange(2**40), chance.randrange(2**40)))
        places = block.between((low, 0), (high, 5))
        rows = [*block.rows(places), *block.rows(np.arange(len(block)))]
        if block.unpacked is None:  # its bytes are in chunks
            assert all(each.columns == (None,) for each in rows)
        else:
            assert all(len(each.columns[0]) == each.size for each in rows)
        block.first((low, 0), (high, 5))
        if block.unpacked is not None and len(block):
            block.unpacked.wire(chance.randrange(len(block)))
            assert all(group.planes.shape[0] == group.size for group in block.unpacked.groups)

    give("blocks", 1500, attempt)


def make_bomb():
    """A block of some KB whose frame holds 1 GB of zeros."""
    packer = zstandard.ZstdCompressor().compressobj(size=BOMB_BYTES)
    parts = [packer.compress(bytes(1 << 20)) for _ in range(BOMB_BYTES >> 20)]
    return bytes([VERSION, 0]) + b"".join([*parts, packer.flush()])


def changed_block(chance, data):
    """Change the packed bytes, or those that the frame holds."""
    if data[1] & STORED or chance.random() < 0.3:
        return changed_bytes(chance, data, range(20))
    plain = zstandard.decompress(data[2:])
    plain = changed_bytes(chance, plain, range(0, len(plain), 7))
    flags = chance.choice((data[1], data[1], chance.randrange(8)))
    if chance.random() < 0.5:
        return bytes([data[0], flags | STORED]) + plain
    return bytes([data[0], flags & ~STORED]) + zstandard.compress(plain)


def block_row(chance, times, size, data):
    """Return the columns of the row of a block, one of them changed more often than not."""
    size = chance.choice((size, size, max(0, len(data) - 2 - 20 * len(times))))
    values = {
        "_t": struct.pack(">q", times[0]),
        "_seq": struct.pack(">q", 0),
        "_conn": struct.pack(">q", 5),
        "_size": struct.pack(">i", size % 2**31),
        "_last": struct.pack(">q", times[-1]),
        "_n": struct.pack(">i", len(times)),
        "_crc": struct.pack(">q", crc32(data)),
        "_nchunks": None,
        "_odd": None,
        "_gone": chance.choice((None, gone(chance, len(times)))),
        "_data": data,
    }
    if chance.random() < 0.5:
        name = chance.choice([name for name in values if name not in ("_data", "_gone", "_crc")])
        width = len(values[name] or b"1234")
        number = chance.choice((None, chance.choice(LONGS) % 256**width))
        values[name] = None if number is None else number.to_bytes(width, "big")
    names = [name.strip('" ') for name in HEADER_COLUMNS.split(",")]
    return tuple(values[name] for name in (*names, "_data"))


def gone(chance, count):
    """A set of positions as Cassandra encodes it: it is always well-formed."""
    places = [chance.choice((0, 1, count - 1, count, -1, 2**31 - 1)) for _ in range(3)]
    return struct.pack(">i", 3) + b"".join(struct.pack(">ii", 4, place) for place in places)
