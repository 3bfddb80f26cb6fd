# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The order in which rosbag reads a bag: receive time, connection number, position in the bag."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from typing import Callable, Iterator

from cassandra_ros.messages.stamps import Stamp, Time
from cassandra_ros.topics.stored_row import StoredRow

HELD_BYTES = 32 << 20
"""Maximum size of the messages of one receive time that are sorted in memory, bytes. If there are
more, they are read again, once for each connection."""
_ROW_BYTES = 1000
"""Approximate memory that a row needs in addition to its message, bytes."""

Read = Callable[["Time | None", "Time | None"], Iterator[StoredRow]]
"""Function that reads the rows of a time range (ends included) in the order of receive time."""


def in_bag_order(read: Read, start: Time | None, end: Time | None) -> Iterator[StoredRow]:
    """Yield the rows that ``read`` returns; rows of equal time are sorted by connection number.

    Memory: the messages of one receive time, at most HELD_BYTES and one message. Above that limit
    the messages of this time are read again, once for each connection.
    """
    for t_ns, same in groupby(read(start, end), attrgetter("received")):
        rows: list[StoredRow] = []
        numbers: set[int] = set()
        held = 0
        for row in same:
            numbers.add(_number(row))
            held += row.size + _ROW_BYTES
            if held <= HELD_BYTES:
                rows.append(row)
            else:
                rows.clear()
        if held <= HELD_BYTES:
            yield from rows if len(numbers) == 1 else sorted(rows, key=_number)
            continue
        at = Stamp.from_ns(t_ns)
        for number in sorted(numbers):
            yield from (row for row in read(at, at) if _number(row) == number)


def _number(row: StoredRow) -> int:
    return row.connection.number
