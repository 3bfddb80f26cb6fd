# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The writer id of an import: from the content of the bag, not from its container."""

from __future__ import annotations

import shutil

import pytest
from bag.truth import string_connection, string_wire

from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.identity import read_content


def write(path, messages, connections=None, **options):
    with BagWriter(path, **options) as writer:
        for connection in connections or [string_connection("/a"), string_connection("/b")]:
            writer.connection(connection)
        for number, t_ns, text in messages:
            writer.write(number, t_ns, string_wire(text))
    return path


def identify(path, nodeID=""):
    with BagReader(path) as reader:
        return read_content(reader).writer_id(nodeID)


MESSAGES = [(i % 2, i, f"text {i}") for i in range(3000)]


@pytest.fixture
def original(tmp_path):
    return write(tmp_path / "a.bag", MESSAGES)


def test_name_compression_and_chunks_do_not_count(original, tmp_path):
    expected = identify(original)
    shutil.copy(original, tmp_path / "b.bag")
    assert identify(tmp_path / "b.bag") == expected
    for compression in ("none", "bz2", "lz4"):
        for chunk_bytes in (1_000, 10_000_000):
            path = write(
                tmp_path / "c.bag", MESSAGES, compression=compression, chunk_bytes=chunk_bytes
            )
            assert identify(path) == expected


def test_it_is_a_writer_id(original):
    assert 0 < identify(original) < 2**31


def changed(place, **values):
    number, t_ns, text = MESSAGES[place]
    new = (values.get("number", number), values.get("t_ns", t_ns), values.get("text", text))
    return [*MESSAGES[:place], new, *MESSAGES[place:][1:]]


@pytest.mark.parametrize(
    "messages",
    [
        changed(0, text="other"),
        changed(999, text="other"),
        changed(1001, text="text 1002"),
        changed(1001, t_ns=1002),
        changed(1001, number=0),
        changed(3, t_ns=4),
        changed(3, number=0),
        changed(2000, text="other"),
        changed(2999, text="other"),
        MESSAGES[:-1],
        [MESSAGES[1], MESSAGES[0], *MESSAGES[2:]],
    ],
)
def test_content_and_order_count(original, tmp_path, messages):
    assert identify(write(tmp_path / "b.bag", messages)) != identify(original)


def test_connections_and_node_count(original, tmp_path):
    expected = identify(original)
    assert identify(original, "husky") != expected
    assert identify(original, "husky") == identify(original, "husky")
    others = [string_connection("/a", callerid="/x"), string_connection("/b")]
    assert identify(write(tmp_path / "b.bag", MESSAGES, others)) != expected
    others = [string_connection("/a"), string_connection("/c")]
    assert identify(write(tmp_path / "b.bag", MESSAGES, others)) != expected


def test_connections_without_messages_do_not_count(original, tmp_path):
    more = [string_connection("/a"), string_connection("/b"), string_connection("/c")]
    assert identify(write(tmp_path / "b.bag", MESSAGES, more)) == identify(original)


@pytest.mark.suite("all", "it reads each bag")
def test_every_test_bag_has_its_own(bags):
    found = [identify(p) for p in sorted(bags.glob("*.bag")) if "truncated" not in p.name]
    assert len(set(found)) == len(found)


def test_the_pass_tells_how_far_it_is_and_what_it_read(tmp_path):
    told = []
    path = write(
        tmp_path / "a.bag", [(i % 2, i, "x" * 996) for i in range(500)], chunk_bytes=10_000
    )
    with BagReader(path) as reader:
        content = read_content(reader, lambda *counts: told.append(counts))
        assert len(told) == reader.chunk_count > 40
    assert tuple(map(sum, zip(*told))) == (500, 500_000)
    assert content.sizes == {0: 250_000, 1: 250_000}


def test_a_chunk_without_messages_does_not_count(tmp_path):
    expected = identify(write(tmp_path / "a.bag", MESSAGES[:2]))
    with BagWriter(tmp_path / "b.bag") as writer:
        for topic in ("/a", "/b"):
            writer.connection(string_connection(topic))
        chunk = [(b"op", bagformat.OP_CHUNK), (b"compression", b"none"), (b"size", 0)]
        times = [(b"start_time", 0), (b"end_time", 1 << 32)]
        place = (b"chunk_pos", writer._file.tell())
        info = [(b"op", bagformat.OP_CHUNK_INFO), (b"ver", 1), place, *times, (b"count", 0)]
        writer._file.write(bagformat.pack_record(chunk, b""))
        writer._infos.write(bagformat.pack_record(info, b""))
        writer._chunk_count += 1
        for number, t_ns, text in MESSAGES[:2]:
            writer.write(number, t_ns, string_wire(text))
    with BagReader(tmp_path / "b.bag") as reader:
        assert reader.chunk_count == 2
    assert identify(tmp_path / "b.bag") == expected


def test_content_after_the_damage_changes_the_writer_id(original, tmp_path):
    """An import of some topics never comes to a damaged chunk that holds none of them."""
    found = set()
    for name, text in (("a", "text 2999"), ("b", "text 2998"), ("c", "text 2997")):
        path = write(tmp_path / name, changed(2999, text=text), chunk_bytes=10_000)
        with BagReader(path) as reader:
            place = reader.chunk_info(3).position
        with path.open("r+b") as file:
            file.seek(place)
            file.write(bytes(100))
        found.add(identify(path))
    assert len(found | {identify(original)}) == 4
