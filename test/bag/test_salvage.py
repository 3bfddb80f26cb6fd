# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index that is made anew: times of each chunk, and a file that ends with a chunk."""

from __future__ import annotations

import pytest
from bag.truth import string_connection, string_wire

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.bag_reader import BagReader
from cassandra_ros.bag.bag_writer import BagWriter

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
    assert salvaged.cut is None
    assert salvaged.why == "has no index, for it was not closed"


@pytest.mark.parametrize("chunks", range(1, len(TIMES) + 1))
def test_a_chunk_that_lacks_its_last_byte_is_cut(path, chunks):
    _, end = chunks_of(path)[chunks - 1]
    short = cut(path, end - 1)
    with BagReader(short, salvage=True) as reader:
        assert (reader.salvaged.lost_bytes, reader.salvaged.cut) != (0, None)
        told = [m.t_ns // SEC for m in reader.messages()]
    # The last bytes of a compressed chunk may be a checksum.
    whole, every = sum(TIMES[: chunks - 1], []), sum(TIMES[:chunks], [])
    assert len(whole) <= len(told)
    assert told == every[: len(told)]
