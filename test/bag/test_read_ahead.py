# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What an import reads ahead: in order, bounded, with what ends the reading in its place."""

from __future__ import annotations

import threading
from queue import SimpleQueue

import numpy as np
import pytest

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import importer
from cassandra_ros.files.bag.importer import BatchReadAhead
from cassandra_ros.files.bag.message_file import MessageBatch


def batch(number, size):
    places = np.zeros(1, np.int64)
    return MessageBatch(number, places, places, [bytes(size)])


def test_batches_come_in_order_with_their_sizes():
    with BatchReadAhead(batch(n, n % 7) for n in range(500)) as ahead:
        assert [(s.number, size) for s, size in ahead] == [(n, n % 7) for n in range(500)]


def test_an_error_of_the_reader_is_raised_after_all_earlier_batches():
    def broken():
        yield from (batch(n, 10) for n in range(3))
        raise BagError("damaged")

    seen = []
    with pytest.raises(BagError, match="damaged"), BatchReadAhead(broken()) as ahead:
        seen += (s.number for s, _ in ahead)
    assert seen == [0, 1, 2]


def test_no_more_is_read_ahead_than_is_allowed(monkeypatch):
    monkeypatch.setattr(importer, "BATCHES_AHEAD_BYTES", 1000)
    read = SimpleQueue()

    def endless():
        for number in range(10**9):
            read.put(number)
            yield batch(number, 5000 if number == 1 else 300)

    with BatchReadAhead(endless()) as ahead:
        every = iter(ahead)
        for taken in range(20):
            # Held are three of 300 bytes, and the next one waits for room; or the large one alone.
            assert next(every)[0].number == taken
            while read.qsize() > 1:
                assert read.get() <= taken + 5
    assert not any(t.name == "cassandra_ros-bag" for t in threading.enumerate())


def test_who_takes_no_more_ends_the_reading():
    with pytest.raises(KeyboardInterrupt), BatchReadAhead(
        batch(n, 10**6) for n in range(99)
    ) as ahead:
        next(iter(ahead))
        raise KeyboardInterrupt
    assert not any(t.name == "cassandra_ros-bag" for t in threading.enumerate())
