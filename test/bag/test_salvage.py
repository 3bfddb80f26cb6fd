# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is read of damaged files: the index made anew, and chunks behind a damaged one."""

from __future__ import annotations

from functools import partial
from random import Random

import pytest
import rosbag
from bag.truth import string_connection, string_wire
from mcap.opcode import Opcode
from suites import sparing

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_format import walk
from cassandra_ros.files.bag.mcap_writer import McapWriter

SEC = 10**9
TIMES = [[5, 3, 9, 4], [8, 1, 2], [7, 6]]
"""Seconds of reception of the messages of each chunk, in the order of the file."""


@pytest.fixture(params=["none", "bz2", "lz4"])
def path(request, tmp_path):
    """A bag of three chunks; in none of them the first message is the oldest or newest alone."""
    path = tmp_path / "a.bag"
    with BagWriter(path, request.param) as writer:
        number = writer.connection(string_connection())
        for chunk, times in enumerate(TIMES):
            for t in times:
                writer.write(number, t * SEC, string_wire(f"{chunk} {t}"))
            writer._flush_chunk()
    return path


def chunks_of(path):
    """Return where each chunk of a sound bag begins and ends, bytes of the file."""
    with BagReader(path) as reader, open(path, "rb") as file:
        places = [reader.chunk_info(n).position for n in range(reader.chunk_count)]
        found = []
        for place in places:
            file.seek(place)
            bagformat.read_header(file, str(path))
            (size,) = bagformat.U32.unpack(file.read(4))
            found.append((place, file.tell() + size))
    return found


def cut(path, size):
    """Return a copy that is cut after a number of bytes."""
    other = path.with_name("cut.bag")
    other.write_bytes(path.read_bytes()[:size])
    return other


def read(path, chunks):
    """Check what is salvaged: the messages of the first chunks, each with its true times."""
    with BagReader(path, salvage=True) as reader:
        assert reader.chunk_count == chunks
        for n, times in enumerate(TIMES[:chunks]):
            info = reader.chunk_info(n)
            assert (info.start_ns, info.end_ns) == (min(times) * SEC, max(times) * SEC)
        assert (reader.start_ns, reader.end_ns) == (
            min(map(min, TIMES[:chunks])) * SEC,
            max(map(max, TIMES[:chunks])) * SEC,
        )
        # A chunk whose times are told wrong is refused here.
        assert [m.t_ns // SEC for m in reader.messages()] == sum(TIMES[:chunks], [])
        return reader.salvaged


def test_times_out_of_order_in_a_chunk(path):
    begin, _ = chunks_of(path)[-1]
    salvaged = read(cut(path, begin), len(TIMES) - 1)
    assert salvaged.why
    assert not salvaged.lost_bytes


@pytest.mark.parametrize("chunks", range(1, len(TIMES) + 1))
def test_a_chunk_that_ends_with_the_file_is_whole(path, chunks):
    """Its recorder died between the chunk and its index records."""
    _, end = chunks_of(path)[chunks - 1]
    salvaged = read(cut(path, end), chunks)
    assert (salvaged.messages, salvaged.lost_bytes) == (sum(map(len, TIMES[:chunks])), 0)
    assert salvaged.cuts == {}
    assert salvaged.why == "has no index, because it was not closed"


@pytest.mark.parametrize("chunks", range(1, len(TIMES) + 1))
def test_a_chunk_that_lacks_its_last_byte_is_cut(path, chunks):
    _, end = chunks_of(path)[chunks - 1]
    short = cut(path, end - 1)
    with BagReader(short, salvage=True) as reader:
        assert (reader.salvaged.lost_bytes, reader.salvaged.cuts) != (0, {})
        told = [m.t_ns // SEC for m in reader.messages()]
    # The last bytes of a compressed chunk may be a checksum.
    whole, every = sum(TIMES[: chunks - 1], []), sum(TIMES[:chunks], [])
    assert len(whole) <= len(told)
    assert told == every[: len(told)]


def spoil(path, begin, end):
    """Overwrite 160 bytes in the middle of a range of a file, more than a message has.

    In a chunk that is not compressed they begin with a record: of other bytes nothing tells that
    they are wrong.
    """
    raw = bytearray(path.read_bytes())
    middle = (begin + end) // 2 - 80
    record = raw.find(b"\x26\0\0\0\x04\0\0\0op=\x02", middle, end)
    part = slice(max(record, middle), max(record, middle) + 160)
    raw[part] = bytes(byte ^ 0xFF for byte in raw[part])
    path.write_bytes(raw)


def long_bag(path, compression="none"):
    """Write a bag of ten chunks with two connections, the second from the third chunk on."""
    with BagWriter(path, compression, chunk_bytes=2000) as writer:
        numbers = [writer.connection(string_connection(name)) for name in ("/a", "/b")]
        for n in range(200):
            text = f"{n} {Random(n).getrandbits(200):x}"
            writer.write(numbers[n % 2 if n > 45 else 0], n * SEC, string_wire(text))
    return path


def long_mcap(path, compression):
    with McapWriter(path, compression, chunk_bytes=2000) as writer:
        numbers = [writer.connection(string_connection(name)) for name in ("/a", "/b")]
        for n in range(200):
            text = f"{n} {Random(n).getrandbits(200):x}"
            writer.write(numbers[n % 2 if n > 45 else 0], n * SEC, string_wire(text))
    return path


def mcap_chunks(path):
    with open(path, "rb") as file:
        return [(r.start + 60, r.stop) for r in walk(file) if r.kind == Opcode.CHUNK]


MAKERS = {
    "bag none": (partial(long_bag, compression="none"), chunks_of),
    "bag bz2": (partial(long_bag, compression="bz2"), chunks_of),
    "bag lz4": (partial(long_bag, compression="lz4"), chunks_of),
    "mcap none": (partial(long_mcap, compression="none"), mcap_chunks),
    "mcap zstd": (partial(long_mcap, compression="zstd"), mcap_chunks),
}


def truth_of(path):
    """Return messages by position, and the positions of each chunk."""
    with open_file(path) as reader:
        messages = {m.position: (m.number, m.t_ns, m.data) for m in reader.messages()}
        firsts = [reader.chunk_info(n).first for n in range(reader.chunk_count)]
    return messages, [range(*pair) for pair in zip(firsts, [*firsts[1:], len(messages)])]


@pytest.mark.parametrize("hit", [(0,), (2,), (1, 2, 4), (-1,)])
@pytest.mark.parametrize("kind", MAKERS)
def test_only_the_damaged_chunks_are_lost(tmp_path, kind, hit):
    make, places = MAKERS[kind]
    path = make(tmp_path / f"a.{kind[:4].strip()}")
    messages, chunks = truth_of(path)
    for number in hit:
        spoil(path, *places(path)[number])
    with open_file(path, salvage=True) as reader:
        found = {m.position: (m.number, m.t_ns, m.data) for m in reader.messages()}
        assert found.items() <= messages.items()
        damaged = {position for number in hit for position in chunks[number]}
        assert messages.keys() - found.keys() <= damaged
        assert reader.message_count == len(found) == reader.salvaged.messages < len(messages)
        assert sum(reader.counts.values()) == len(found)
        assert 0 < reader.salvaged.lost_bytes < path.stat().st_size
        told = reader.salvaged.told("a.bag")
        assert ("before and after the damage" in told) == (hit != (-1,))
        for number in range(reader.chunk_count):
            assert sum(reader.chunk_info(number).counts.values()) == len(
                list(reader.chunk_messages(number))
            )
        digest = read_content(reader).digest
    with open_file(path) as reader:
        assert read_content(reader).digest == digest


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_chunks_behind_damage_are_found_without_an_index(tmp_path, compression):
    """A recorder was killed, and a page of its file is damaged."""
    path = long_bag(tmp_path / "a.bag", compression)
    messages, chunks = truth_of(path)
    places = chunks_of(path)
    spoil(path, *places[1])
    raw = path.read_bytes()
    path.write_bytes(raw[: places[5][1]])
    with open_file(path, salvage=True) as reader:
        found = [(m.number, m.t_ns, m.data) for m in reader.messages()]
        lost = [messages[position] for position in chunks[1]]
        kept = [messages[position] for number in (0, 2, 3, 4, 5) for position in chunks[number]]
        assert [each for each in found if each not in lost] == kept
        assert "before and after the damage" in reader.salvaged.told("a.bag")


def test_a_chunk_whose_header_is_destroyed_is_passed_over(tmp_path):
    path = long_bag(tmp_path / "a.bag")
    messages, chunks = truth_of(path)
    begin, _ = chunks_of(path)[3]
    raw = path.read_bytes()
    for name, end in (("index", len(raw)), ("none", raw.rindex(b"\x04\0\0\0op=\x04"))):
        spoiled = raw[:begin] + b"\xff" * 40 + raw[begin + 40 : end]
        (tmp_path / name).write_bytes(spoiled)
        with open_file(tmp_path / name, salvage=True) as reader:
            found = [(m.number, m.t_ns, m.data) for m in reader.messages()]
        assert found == [m for position, m in messages.items() if position not in chunks[3]]


def test_an_empty_bag_is_whole(tmp_path):
    path = tmp_path / "empty.bag"
    rosbag.Bag(str(path), "w").close()
    with BagReader(path, salvage=True) as reader:
        assert (reader.message_count, reader.salvaged.why) == (0, "")


@pytest.mark.parametrize("size", [13, 20, 4_000])
def test_of_a_bag_that_ends_in_its_header_nothing_is_salvaged(tmp_path, size):
    path = tmp_path / "empty.bag"
    rosbag.Bag(str(path), "w").close()
    with pytest.raises(BagError, match="no message that can be salvaged"):
        BagReader(cut(path, size), salvage=True)


@pytest.mark.parametrize(
    "kind", sparing(["bag none", "bag lz4", "mcap zstd"], kept=["bag lz4", "mcap zstd"])
)
@pytest.mark.parametrize("format", sparing(["packed", "ros"], kept=["packed"]))
def test_an_import_that_ended_at_damage_goes_on_with_salvage(rosCas, tmp_path, kind, format):
    make, places = MAKERS[kind]
    path = make(tmp_path / f"a.{kind[:4].strip()}")
    messages, chunks = truth_of(path)
    spoil(path, *places(path)[3])
    with pytest.raises(BagError, match=r"The same import with --salvage"):
        import_bag(rosCas, path, format=format)
    before = sum(info.count for info in rosCas.info())
    assert 0 < before < len(messages)
    report = import_bag(rosCas, path, salvage=True)
    assert len(messages) - len(chunks[3]) <= report.messages < len(messages)
    (run,) = rosCas.runs()
    assert sum(info.count for info in rosCas.info()) == report.messages
    wires = [row.wire for name in ("/a", "/b") for row in rosCas.getTopic(name).rows()]
    assert len(set(wires)) == len(wires) == report.messages
    assert verify_bag(rosCas, path, salvage=True).equal
    assert import_bag(rosCas, path, salvage=True).messages == report.messages
    assert sum(info.count for info in rosCas.info()) == report.messages
