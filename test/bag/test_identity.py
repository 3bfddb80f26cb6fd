# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The writer id of an import: from the content of the bag, not from its container."""

from __future__ import annotations

import shutil

import pytest
from bag.truth import string_connection, string_wire

from cassandra_ros.bag.identity import SAMPLE, bagWriterId
from cassandra_ros.bag.reader import BagReader
from cassandra_ros.bag.writer import BagWriter


def write(path, messages, connections=None, **options):
    with BagWriter(path, **options) as writer:
        for connection in connections or [string_connection("/a"), string_connection("/b")]:
            writer.connection(connection)
        for number, t_ns, text in messages:
            writer.write(number, t_ns, string_wire(text))
    return path


def identify(path, nodeID=""):
    with BagReader(path) as reader:
        return bagWriterId(reader, nodeID)


MESSAGES = [(i % 2, i, f"text {i}") for i in range(3 * SAMPLE)]


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
        changed(SAMPLE - 1, text="other"),
        changed(3, t_ns=4),
        changed(3, number=0),
        changed(2 * SAMPLE, text="other"),
        changed(3 * SAMPLE - 1, text="other"),
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


def test_every_test_bag_has_its_own(bags):
    found = [identify(p) for p in sorted(bags.glob("*.bag")) if "truncated" not in p.name]
    assert len(set(found)) == len(found)


def test_large_messages_are_not_collected(tmp_path):
    seen = []
    path = write(tmp_path / "a.bag", [(0, i, "x" * 1000) for i in range(SAMPLE)])
    with BagReader(path) as reader:
        bagWriterId(reader, "", lambda message: seen.append(message.position))
    assert seen == [*range(SAMPLE), *range(SAMPLE)]
