# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The order in which rosbag reads a bag: by time of reception, connection, place in the bag."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from typing import Callable, Iterator

from cassandra_ros.messages.stamps import Stamp, Time
from cassandra_ros.topics.stored_row import StoredRow

HELD_BYTES = 32 << 20
"""Most bytes of messages of one time that are held to be sorted; more are read once more."""
_ROW_BYTES = 1000
"""About what a row takes beside its message."""

Read = Callable[["Time | None", "Time | None"], Iterator[StoredRow]]
"""Reads the rows between two times, both included, in the order of their reception."""


def in_bag_order(read: Read, start: Time | None, end: Time | None) -> Iterator[StoredRow]:
    """Yield the rows that ``read`` reads, those of equal times by number of their connection.

    Memory: the messages of one time, up to HELD_BYTES and one message. Where there are more, those
    of the time are read anew for each connection.
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
