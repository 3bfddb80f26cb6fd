# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bucket lengths that follow from the rates in a bag."""

from __future__ import annotations

import pytest
from bag.truth import string_connection, string_wire

from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.importer import table_lengths

SECOND = 10**9
MINUTE, HOUR, DAY = 60 * SECOND, 3600 * SECOND, 86_400 * SECOND


def lengths(path, messages, connections=1):
    with BagWriter(path, chunk_bytes=20_000) as writer:
        for i in range(connections):
            writer.connection(string_connection("/a", callerid=f"/node{i}"))
        for number, t_ns, size in messages:
            writer.write(number, t_ns, string_wire(b"x" * size))
    with BagReader(path) as reader:
        found = table_lengths(reader, read_content(reader).sizes)
        return {number: lengths.bucket_ns for number, lengths in found.items()}


def steady(rate_hz, seconds, size=100, start=10**18, number=0):
    return [(number, start + i * SECOND // rate_hz, size) for i in range(rate_hz * seconds)]


@pytest.mark.parametrize(
    "rate_hz, seconds, size, expected",
    [
        (1, 60, 100, DAY),
        (10, 60, 100, HOUR),
        (150, 30, 100, 10 * MINUTE),
        (1000, 20, 100, MINUTE),
        (1, 30, 15_000, HOUR),
        (30, 20, 50_000, 10 * SECOND),
    ],
)
def test_a_steady_topic(tmp_path, rate_hz, seconds, size, expected):
    found = lengths(tmp_path / "a.bag", steady(rate_hz, seconds, size))
    assert found == {0: expected}


def test_connections_of_one_table_count_together(tmp_path):
    messages = sorted(steady(100, 60) + steady(100, 60, number=1), key=lambda m: m[1])
    assert lengths(tmp_path / "a.bag", steady(100, 60)) == {0: 10 * MINUTE}
    both = lengths(tmp_path / "b.bag", messages, connections=2)
    assert both == {0: MINUTE, 1: MINUTE}


@pytest.mark.parametrize("size", [600_000, 500_000])
def test_messages_that_no_row_takes_are_foreseen(tmp_path, size):
    with BagWriter(tmp_path / "a.bag") as writer:
        writer.connection(string_connection("/a"))
        for n in range(3):
            writer.write(0, n * SECOND, string_wire(b"x" * size))
    with BagReader(tmp_path / "a.bag") as reader:
        assert table_lengths(reader, read_content(reader).sizes)[0].large == (size == 600_000)


def test_a_stray_stamp_does_not_hide_the_rate(tmp_path):
    found = lengths(tmp_path / "a.bag", [(0, 0, 100), *steady(1000, 30)])
    assert found == {0: MINUTE}


def test_one_message_and_equal_times(tmp_path):
    assert lengths(tmp_path / "a.bag", [(0, 5, 100)]) == {0: DAY}
    assert lengths(tmp_path / "b.bag", [(0, 5, 100)] * 200_000) == {0: SECOND}
