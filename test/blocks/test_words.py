# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Long messages coded as words come back bit by bit, whatever numbers or none they hold."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.blocks.codec import (
    LONG,
    MIN_PLANES,
    code_words,
    decode_words,
    most_bytes,
    pack_block,
    unpack_block,
)

# What an integer does not give back: -0.0, NaNs of any bits, infinities, what is too large.
ODD = [0x80000000, 0x7FC00000, 0x7F800001, 0xFFFFFFFF, 0x7F800000, 0xFF800000, 0x4F000000]
ODD += [0xCF000000, 0x4EFFFFFF, 0x7F7FFFFF, 1, 0x807FFFFF, 252, 253, 254, 255, 256]


def as_word(number):
    return int(np.float32(number).view(np.uint32))


@st.composite
def messages(draw):
    """Messages of which most words are a number divided by the same scale."""
    scale = np.float32(draw(st.sampled_from([1, 1000, 4000, 10_000])))
    measured = st.integers(-(2**24), 2**24).map(lambda n: as_word(np.float32(n) / scale))
    words = st.integers(0, 9) | st.sampled_from(ODD) | st.integers(0, 2**32 - 1) | measured
    most = draw(measured)
    message = st.tuples(st.binary(max_size=3), st.lists(words, max_size=20), st.integers(40, 50))
    return [
        head + struct.pack(f"<{len(values) + n}I", *values, *[most] * n)
        for head, values, n in draw(st.lists(message, min_size=1, max_size=5))
    ]


@given(messages())
def test_words_come_back(wires):
    code = code_words(wires)
    if code is None:  # zeros alone are no numbers
        return
    sizes = [len(wire) for wire in wires]
    assert len(code) <= most_bytes(sum(sizes))
    assert decode_words(memoryview(code), sizes) == b"".join(wires)


def test_every_odd_word_comes_back():
    wire = b"x" + struct.pack(f"<{len(ODD) + 100}I", *ODD, *map(as_word, range(1, 101)))
    assert decode_words(memoryview(code_words([wire])), [len(wire)]) == wire


def test_the_bytes_stay_as_they_are():
    # Stored blocks must be readable for ever.
    words = [3, as_word(7), as_word(1.5), as_word(1.501), as_word(5), 0xFFFFFFFF]
    code = code_words([b"ab" + struct.pack("<6I", *words)])
    whole, scaled = bytes([14, 3]) + bytes(6), bytes([184, 2, 11, 0]) + bytes(4)
    other = b"\xff" * 4
    assert code == b"\xe8\x03\0\0ab" + bytes([3, 253, 254, 254, 253, 255]) + whole + scaled + other


@pytest.mark.parametrize("kind", ["random", "text", "bytes", "doubles", "empty"])
def test_what_is_not_measured_is_left_as_it_is(kind):
    rng = np.random.default_rng(1)
    wires = {
        "random": rng.random(500, np.float32).tobytes(),
        "text": b"nothing but text " * 40,
        "bytes": rng.integers(0, 256, 2000, np.uint8).tobytes(),
        "doubles": rng.random(500).tobytes(),
        "empty": bytes(1000),
    }
    assert code_words([wires[kind]]) is None


@pytest.mark.parametrize("spoil", ["scale", "code", "cut", "longer", "size", "none"])
def test_what_is_no_code_is_refused(spoil):
    wire = np.arange(1, 200, dtype="<f4").tobytes()
    code, sizes = bytearray(code_words([wire])), [len(wire)]
    if spoil == "scale":
        code[:4] = bytes(4)
    elif spoil == "code":
        code[10] = 7
    elif spoil == "cut":
        del code[-1]
    elif spoil == "longer":
        code += b"\0"
    elif spoil == "size":
        sizes = [len(wire) + 1]
    else:
        del code[3:]
    with pytest.raises(CorruptMessage):
        decode_words(memoryview(code), sizes)


def scans():
    """Scans of two sizes in turn, with echoes as a sensor of mm counts them, and short messages."""
    rng = np.random.default_rng(2)
    wires = []
    for n in range(3 * MIN_PLANES):
        millimetres = np.cumsum(rng.integers(-20, 20, 300 + n % 2)) + 5000
        ranges = (millimetres / 1000).astype("<f4")
        wires.append(b"scan%d" % n if n % 3 == 0 else b"\x01odd" + ranges.tobytes())
    return wires


def test_a_block_codes_its_long_messages():
    wires = scans()
    size = sum(map(len, wires))
    data = pack_block(range(len(wires)), range(len(wires)), wires)
    assert data[:2] == b"\x01\x02" and len(data) < 0.4 * size
    found = unpack_block(data, len(wires), size)
    assert found.wires() == wires
    assert [found.wire(n) for n in range(len(wires))] == wires
    for group in found.groups:
        for n, position in enumerate(group.members.tolist()):
            assert group.planes[:, n].tobytes() == wires[position]
    assert {group.size >= LONG for group in found.groups} == {False, True}


def test_a_block_of_other_sizes_is_refused():
    wires = scans()
    data = pack_block(range(len(wires)), range(len(wires)), wires)
    with pytest.raises(CorruptMessage):
        unpack_block(data, len(wires), sum(map(len, wires)) + 4)
    with pytest.raises(CorruptMessage):
        unpack_block(data[:1] + b"\0" + data[2:], len(wires), sum(map(len, wires)))
