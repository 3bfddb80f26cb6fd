# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Damaged and hostile bags: an error that says so, in little memory, whatever was changed."""

from __future__ import annotations

import bz2
import tracemalloc

import lz4.frame
import pytest
from bag.truth import string_connection, string_wire
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.message_file import read_in_order

MANY = search(600, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module", params=["none", "bz2", "lz4"])
def whole(request, tmp_path_factory):
    """Bytes of a bag of five chunks and two connections."""
    path = tmp_path_factory.mktemp("bags") / "a.bag"
    with BagWriter(path, request.param, chunk_bytes=1500) as writer:
        numbers = [writer.connection(string_connection(topic)) for topic in ("/a", "/b")]
        for i in range(100):
            writer.write(numbers[i % 2], 1_000_000 * i, string_wire(f"text {i}"))
    return path.read_bytes()


def read_all(path):
    with BagReader(path) as reader:
        return [(m.number, m.t_ns, m.data) for m in reader.messages()]


@MANY
@given(data=st.data())
def test_a_bag_that_is_cut_anywhere_is_refused(whole, tmp_path, data):
    path = tmp_path / "cut.bag"
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    with pytest.raises(BagError):
        read_all(path)


@MANY
@given(data=st.data())
def test_changed_bytes_give_an_error_or_a_bag(whole, tmp_path, data):
    changed = bytearray(whole)
    # The padding after the header is not used.
    places = st.one_of(st.integers(0, 100), st.integers(4096, len(whole) - 1))
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(places)] = data.draw(st.integers(0, 255))
    path = tmp_path / "changed.bag"
    path.write_bytes(changed)
    try:
        read_all(path)
    except BagError as exc:
        assert str(path) in str(exc)


@MANY
@given(content=st.binary(max_size=500))
def test_noise_after_the_magic_line_is_refused(tmp_path, content):
    path = tmp_path / "noise.bag"
    path.write_bytes(bagformat.MAGIC + content)
    with pytest.raises(BagError):
        read_all(path)


def test_a_corrupt_chunk_is_named(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path, "bz2", chunk_bytes=1000) as writer:
        number = writer.connection(string_connection())
        for i in range(100):
            writer.write(number, i, string_wire(f"text {i}"))
    with BagReader(path) as reader:
        position = reader.chunk_info(2).position
    changed = bytearray(path.read_bytes())
    changed[position + 120] ^= 0xFF
    path.write_bytes(changed)
    with BagReader(path) as reader:
        messages = reader.messages()
        with pytest.raises(BagError, match=f"{path}: chunk 3 of {reader.chunk_count} is damaged"):
            list(messages)
        assert len(list(reader.chunk_messages(1))) > 0


def make_bag(path, chunk_header, chunk_data, counts=((0, 1),), times=(5, 5)):
    """Write a bag of one chunk with exactly these bytes."""
    connection = (
        (b"op", b"\x07"),
        (b"topic", b"/chatter"),
        (b"conn", bagformat.U32.pack(0)),
    )
    info = (
        (b"op", b"\x06"),
        (b"ver", bagformat.U32.pack(1)),
        (b"chunk_pos", 13 + 4104),
        (b"start_time", bagformat.pack_time(times[0])),
        (b"end_time", bagformat.pack_time(times[1])),
        (b"count", bagformat.U32.pack(len(counts))),
    )
    chunk = bagformat.pack_record(chunk_header, chunk_data)
    header = bagformat.pack_fields(
        (
            (b"op", b"\x03"),
            (b"index_pos", 13 + 4104 + len(chunk)),
            (b"conn_count", bagformat.U32.pack(1)),
            (b"chunk_count", bagformat.U32.pack(1)),
        )
    )
    padding = b" " * (4096 - len(header))
    path.write_bytes(
        bagformat.MAGIC
        + bagformat.U32.pack(len(header))
        + header
        + bagformat.U32.pack(len(padding))
        + padding
        + chunk
        + bagformat.pack_record(connection, string_connection().header)
        + bagformat.pack_record(
            info, b"".join(bagformat.U32.pack(a) + bagformat.U32.pack(b) for a, b in counts)
        )
    )


def message_record(t=5, conn=0, data=b"\x01\0\0\0x", order=(b"op", b"conn", b"time")):
    fields = {b"op": b"\x02", b"conn": bagformat.U32.pack(conn), b"time": bagformat.pack_time(t)}
    return bagformat.pack_record([(name, fields[name]) for name in order], data)


def chunk_header(compression, size):
    return (
        (b"op", b"\x05"),
        (b"compression", compression),
        (b"size", bagformat.U32.pack(size)),
    )


@pytest.mark.parametrize(
    "order", [(b"op", b"conn", b"time"), (b"conn", b"op", b"time"), (b"time", b"conn", b"op")]
)
def test_header_fields_stand_in_any_order(tmp_path, order):
    record = message_record(order=order)
    make_bag(tmp_path / "a.bag", chunk_header(b"none", len(record)), record)
    assert read_all(tmp_path / "a.bag") == [(0, 5, b"\x01\0\0\0x")]


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("compression", [b"bz2", b"lz4"])
def test_a_bomb_is_not_unpacked(tmp_path, compression):
    pack = bz2.compress if compression == b"bz2" else lz4.frame.compress
    make_bag(tmp_path / "a.bag", chunk_header(compression, 1000), pack(bytes(300_000_000)))
    tracemalloc.start()
    with pytest.raises(BagError, match="chunk 1 of 1 is damaged: it unpacks to more than 1000"):
        read_all(tmp_path / "a.bag")
    with pytest.raises(BagError, match="no message that can be salvaged"):
        BagReader(tmp_path / "a.bag", salvage=True)
    assert tracemalloc.get_traced_memory()[1] < 50_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("compression", [b"none", b"bz2", b"lz4"])
def test_sizes_that_are_not_true_take_no_memory(tmp_path, compression):
    record = message_record()
    pack = {b"none": bytes, b"bz2": bz2.compress, b"lz4": lz4.frame.compress}[compression]
    make_bag(tmp_path / "a.bag", chunk_header(compression, 0xFFFFFFFF), pack(record))
    tracemalloc.start()
    with pytest.raises(BagError, match="damaged"):
        read_all(tmp_path / "a.bag")
    assert tracemalloc.get_traced_memory()[1] < 50_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("compression", [b"none", b"bz2", b"lz4"])
@pytest.mark.parametrize("more", [-1, 1, 3, 10**6])
def test_a_chunk_has_the_length_that_it_states(tmp_path, compression, more):
    """The message in it is whole, so nothing else would tell."""
    pack = {b"none": bytes, b"bz2": bz2.compress, b"lz4": lz4.frame.compress}[compression]
    record, path = message_record(), tmp_path / "a.bag"
    make_bag(path, chunk_header(compression, len(record)), pack(record))
    assert read_all(path) == [(0, 5, b"\x01\0\0\0x")]
    make_bag(path, chunk_header(compression, len(record) + more), pack(record))
    with pytest.raises(BagError, match=f"{path}: chunk 1 of 1 is damaged: it .* bytes"):
        read_all(path)


def test_a_chunk_that_the_index_lists_twice_is_refused(tmp_path):
    """Its messages would be there twice."""
    record, path = message_record(), tmp_path / "a.bag"
    make_bag(path, chunk_header(b"none", len(record)), record)
    whole = path.read_bytes()
    with BagReader(path) as reader:
        info_pos = reader._chunk(0)[3]
    twice = whole.replace(b"chunk_count=" + bagformat.U32.pack(1), b"chunk_count=\2\0\0\0")
    path.write_bytes(twice + whole[info_pos:])
    with pytest.raises(BagError, match="is damaged: its index places a chunk at byte"):
        read_all(path)


@pytest.mark.parametrize("t", [4, 5, 7, 8])
def test_a_message_outside_the_times_of_its_chunk_is_refused(tmp_path, t):
    """Messages are put in order by them: another one would come too late."""
    record, path = message_record(t), tmp_path / "a.bag"
    make_bag(path, chunk_header(b"none", len(record)), record, times=(5, 7))
    with BagReader(path) as reader:
        messages = read_in_order(reader, lambda message: message.data)
        if 5 <= t <= 7:
            assert [message.t_ns for message in messages] == [t]
        else:
            with pytest.raises(BagError, match=f"{path}: chunk 1 holds a message outside"):
                list(messages)


def test_what_contradicts_itself_is_refused(tmp_path):
    path = tmp_path / "a.bag"
    record = message_record()
    cases = [
        (chunk_header(b"zstd", len(record)), record, {}, "compressed with 'zstd'"),
        (chunk_header(b"none", len(record)), record, {"counts": ((0, 2),)}, "index lists"),
        (chunk_header(b"none", len(record)), record, {"counts": ((7, 1),)}, "connection 7"),
        (chunk_header(b"none", len(record) - 1), record[:-1], {}, "damaged"),
        (chunk_header(b"none", len(record) + 3), record + b"abc", {}, "damaged"),
    ]
    foreign = message_record(conn=9)
    cases.append((chunk_header(b"none", len(foreign)), foreign, {}, "index lists"))
    late = message_record()
    late = late.replace(bagformat.pack_time(5), b"\xff\xff\xff\xff\xff\xff\xff\xff")
    cases.append((chunk_header(b"none", len(late)), late, {}, "damaged"))
    for header, data, more, text in cases:
        make_bag(path, header, data, **more)
        with pytest.raises(BagError, match=text):
            read_all(path)


def test_a_header_that_counts_too_few_chunks_is_damage(whole, tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(whole)
    with BagReader(path) as reader:
        count = reader.chunk_count
    true, less = (b"chunk_count=" + bagformat.U32.pack(n) for n in (count, count - 1))
    assert whole.count(true) == 1
    path.write_bytes(whole.replace(true, less))
    with pytest.raises(BagError, match=f"its header counts {count - 1} chunks, and its index"):
        BagReader(path)
    with BagReader(path, salvage=True) as reader:
        assert reader.message_count == 100
        assert reader.salvaged.lost_bytes == 0
