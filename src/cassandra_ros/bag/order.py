# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The order in which rosbag reads a bag: by time, then connection, then place in the file."""

from __future__ import annotations

from bisect import bisect_left
from typing import AbstractSet, Callable, Iterator, List, NamedTuple

from cassandra_ros.bag.reader import BagReader, RawMessage
from cassandra_ros.errors import BagError


class Ordered(NamedTuple):
    """A message of a bag, comparable in the order of reading."""

    t_ns: int
    rank: int
    """Place of the connection in the bag's index."""
    position: int
    value: bytes
    """What was asked to be kept of the message."""


def readInOrder(
    reader: BagReader,
    keep: Callable[[RawMessage], bytes],
    numbers: AbstractSet[int] | None = None,
) -> Iterator[Ordered]:
    """Yield the messages of a bag in the order in which rosbag reads them.

    Chunks are read by their first time, each once. Held in memory are the largest chunk, and
    about 250 bytes beside the kept value for each message that a later chunk may still precede:
    one or two chunks' worth in a recorded bag, all of the bag when every chunk spans all of it.

    Args:
        reader: The bag.
        keep: Makes what is kept of a message.
        numbers: Only these connections; None = all.

    Raises:
        BagError: A chunk is damaged, or holds times that the index denies.
    """
    rank = {number: place for place, number in enumerate(reader.connections)}
    order = sorted(range(reader.chunk_count), key=reader.chunkTimes)
    waiting: List[Ordered] = []
    for place, chunk in enumerate(order):
        start_ns, end_ns = reader.chunkTimes(chunk)
        for message in reader.chunkMessages(chunk, numbers):
            if not start_ns <= message.t_ns <= end_ns:
                raise BagError(
                    f"{reader.path}: chunk {chunk + 1} holds a message outside the times that "
                    f"the index states; repair it with: rosbag reindex {reader.path}"
                )
            entry = Ordered(message.t_ns, rank[message.number], message.position, keep(message))
            waiting.append(entry)
        waiting.sort()  # runs that are in order already cost one comparison a message
        if place + 1 < len(order):
            next_ns = reader.chunkTimes(order[place + 1])[0]
            ready = bisect_left(waiting, (next_ns,))
        else:
            ready = len(waiting)
        yield from waiting[:ready]
        del waiting[:ready]
