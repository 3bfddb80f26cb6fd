# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Our writer, read back by the rosbag module."""

from __future__ import annotations

import os
import resource
import subprocess

import pytest
from bag.test_reader import READABLE
from bag.truth import read_with_rosbag, string_connection, string_wire
from suites import sparing

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection


def copy(source, target, compression="none", chunk_bytes=768 * 1024):
    with BagReader(source) as reader, BagWriter(target, compression, chunk_bytes) as writer:
        for connection in reader.connections.values():
            writer.connection(connection, connection.number)
        for message in sorted(reader.messages(), key=lambda m: (m.t_ns, m.position)):
            writer.write(message.number, message.t_ns, message.data)


@pytest.mark.parametrize("name", sparing(READABLE, kept=READABLE[2:]))
def test_rosbag_reads_a_copy_like_the_original(bags, tmp_path, name):
    copy(bags / f"{name}.bag", tmp_path / "copy.bag")
    assert read_with_rosbag(tmp_path / "copy.bag") == read_with_rosbag(bags / f"{name}.bag")


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_all_twelve_connections_survive_any_chunking(bags, tmp_path, compression):
    copy(bags / "turtlesim_tf.bag", tmp_path / "copy.bag", compression, 5000)
    connections, messages = read_with_rosbag(tmp_path / "copy.bag")
    assert (connections, messages) == read_with_rosbag(bags / "turtlesim_tf.bag")
    assert len(connections) == 12
    with BagReader(tmp_path / "copy.bag") as reader:
        assert reader.chunk_count > 50
        chunks = range(reader.chunk_count)
        assert {reader._chunk_header(n)[0] for n in chunks} == {compression}


def test_connection_headers_are_kept_byte_for_byte(bags, tmp_path):
    copy(bags / "turtlesim_tf.bag", tmp_path / "copy.bag")
    with BagReader(bags / "turtlesim_tf.bag") as a, BagReader(tmp_path / "copy.bag") as b:
        assert a.connections == b.connections


def test_rosbag_info_and_check_accept_it(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path, "lz4") as writer:
        number = writer.connection(string_connection())
        for i in range(10):
            writer.write(number, 10**18 + i, string_wire("x"))
    info = subprocess.run(
        ["rosbag", "info", "-y", str(path)], capture_output=True, text=True, check=True
    ).stdout
    assert "messages: 10" in info
    assert "indexed: True" in info
    assert "compression: lz4" in info


def test_order_between_equal_times_is_that_of_the_connections(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        high = writer.connection(string_connection("/a"), 7)
        low = writer.connection(string_connection("/b"), 3)
        for i in range(3):
            writer.write(high, 5, string_wire(f"high {i}"))
            writer.write(low, 5, string_wire(f"low {i}"))
    connections, messages = read_with_rosbag(path)
    assert [number for number, _, _ in connections] == [3, 7]
    texts = [m.data[4:].decode() for m in messages]
    assert texts == ["low 0", "low 1", "low 2", "high 0", "high 1", "high 2"]


def test_two_identical_connections_stay_two(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        numbers = [writer.connection(string_connection()) for _ in range(2)]
        for number in (*numbers, numbers[0]):
            writer.write(number, 5, string_wire("x"))
    connections, messages = read_with_rosbag(path)
    assert numbers == [0, 1]
    assert connections[0][1:] == connections[1][1:]
    assert len(messages) == 3


def test_times_from_0_to_2106_and_topics_of_any_kind(tmp_path):
    path = tmp_path / "a.bag"
    topics = ["no_slash", "/ümläut/☃", "/quote'\"; DROP", "/new\nline"]
    times = [0, 1, 999_999_999, 4_117_995_776 * 10**9, MAX_NS]
    with BagWriter(path) as writer:
        for topic in topics:
            number = writer.connection(string_connection(topic))
            for t_ns in times:
                writer.write(number, t_ns, b"")
    _, messages = read_with_rosbag(path)
    assert [m.t_ns for m in messages] == sorted(times * len(topics))
    assert {m.topic for m in messages} == set(topics)
    with BagReader(path) as reader:
        assert sorted(m.t_ns for m in reader.messages()) == sorted(times * len(topics))


def test_the_name_appears_when_the_bag_is_complete(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(b"precious")
    with BagWriter(path) as writer:
        writer.write(writer.connection(string_connection()), 1, string_wire("x"))
        assert path.read_bytes() == b"precious"
        assert (tmp_path / "a.bag.active").exists()
    writer.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.bag"]
    assert len(read_with_rosbag(path)[1]) == 1


def test_an_error_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(b"precious")
    with pytest.raises(RuntimeError), BagWriter(path):
        raise RuntimeError("the store is gone")
    assert path.read_bytes() == b"precious"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bag"]


def test_an_empty_bag_is_a_bag(tmp_path):
    BagWriter(tmp_path / "a.bag").close()
    assert read_with_rosbag(tmp_path / "a.bag") == ([], [])


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(BagError, match="'zstd' is not a compression"):
        BagWriter(tmp_path / "a.bag", "zstd")
    with pytest.raises(BagError, match="No such file or directory"):
        BagWriter(tmp_path / "missing" / "a.bag")
    with BagWriter(tmp_path / "a.bag") as writer:
        writer.connection(Connection("/a", b"", 0), 0)
        with pytest.raises(BagError, match="connection number 0 is taken"):
            writer.connection(Connection("/b", b"", 0), 0)


@pytest.fixture
def little_room():
    """No file of this process may become larger than 64 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_without_room_is_said_and_nothing_stays(tmp_path, little_room):
    for size in (10, 2_000_000):
        writer = BagWriter(tmp_path / "a.bag")
        number = writer.connection(string_connection())
        with pytest.raises(BagError, match="cannot be written: File too large"):
            writer.write(number, 1, bytes(size))
            writer.close()
        writer.discard()
        assert not list(tmp_path.iterdir())


def test_no_file_of_others_is_written(tmp_path):
    left = tmp_path / "a.bag.active"
    left.write_bytes(b"of a recorder")
    with pytest.raises(BagError, match=r"a\.bag\.active exists: it is being written, or was left"):
        BagWriter(tmp_path / "a.bag")
    assert left.read_bytes() == b"of a recorder"
    with BagWriter(tmp_path / "b.bag"):
        with pytest.raises(BagError, match="exists: it is being written"):
            BagWriter(tmp_path / "b.bag")
    assert (tmp_path / "b.bag").exists()
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "."):
        with pytest.raises(BagError, match="is not a file that can be replaced"):
            BagWriter(tmp_path / name)
