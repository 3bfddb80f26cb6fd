# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A file of messages, whatever its format: connections, and messages chunk by chunk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import Counter
from difflib import get_close_matches
from functools import cached_property
from typing import AbstractSet, Callable, Iterable, Iterator, Mapping, NamedTuple, TypeVar

import numpy as np

from cassandra_ros.bag.bag_index import ChunkInfo
from cassandra_ros.bag.chunk import ChunkMessages, Longs
from cassandra_ros.bag.salvage import Salvaged
from cassandra_ros.errors import BagError, TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection

LISTED = 10
"""Topics that an error names."""
MAX_BATCH = 1 << 16
"""Maximum number of messages of a MessageBatch. A chunk may hold millions of empty ones."""
_AT_ONCE = 1 << 14
"""Number of messages of a chunk whose places are held as Python objects."""

MessageProgress = Callable[[int, int], None]
"""Called with the messages and bytes that were handled since the last call."""

Self = TypeVar("Self", bound="MessageFile")


class RawMessage(NamedTuple):
    """A message as it lies in the bag."""

    position: int
    """Place among all messages of the bag, in the order of the file, from 0."""
    number: int
    """Key of MessageFile.connections."""
    t_ns: int
    data: bytes


class MessageBatch(NamedTuple):
    """Messages of one connection that follow each other in one chunk, in its order."""

    number: int
    """Key of MessageFile.connections."""
    positions: Longs
    """Their places among all messages of the bag, in the order of the file, from 0."""
    times: Longs
    """ns."""
    wires: list[bytes]


class SentTimes(NamedTuple):
    """What an MCAP says of consecutive messages beside what a row of the store holds of each."""

    first: int
    """Position of the first of them."""
    delays: Longs
    """publish_time minus log_time of each, ns."""
    sequences: Longs


class MessageFile(ABC):
    """A bag or an MCAP that is open for reading; also a context manager.

    Attributes:
        path: Of the file, as it was given.
        connections: By number, in the order of the index. Like rosbag, we leave out those that
            no message refers to.
        counts: Messages of each connection, by number.
        message_count, chunk_count: Of the whole file.
        start_ns, end_ns: Times of the first and the last message, ns; 0 in an empty file.
        left_out: By topic the number of messages that are not of ROS 1, and what they are; they
            are in none of the above.
        extras: What else the file holds, in words, and how many of each.
        tells_sent: Whether chunk_sent has told something of a chunk so far.
    """

    salvaged = Salvaged()
    """Of a file that was opened to salvage it: what was damaged, and what can be read."""
    tells_sent = False
    path: str
    connections: dict[int, Connection]
    counts: Counter[int]
    message_count: int
    chunk_count: int
    start_ns: int
    end_ns: int

    @cached_property
    def left_out(self) -> dict[str, tuple[int, str]]:
        """See the class; none unless its reader notes some."""
        return {}

    @cached_property
    def extras(self) -> dict[str, int]:
        """See the class; none unless its reader notes some."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """Close the file; twice is harmless."""

    @abstractmethod
    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read what the index says about a chunk, in [0, chunk_count), in the file's order."""

    @abstractmethod
    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and last time in a chunk as the index has them, ns."""

    @abstractmethod
    def chunk_content(self, chunk: int) -> tuple[bytes, ChunkMessages]:
        """Read what a chunk holds, and where its messages lie in it; see messages.

        Their ids are those of ``connections``. Before each message stand 20 bytes or more that
        are no part of one.
        """

    def chunk_sent(self, chunk: int) -> SentTimes | None:
        """Tell when the messages of a chunk were sent, and as which of their publisher's.

        None: the file does not say, or nothing but that each was sent when it was received.
        """
        return None

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def messages(
        self, numbers: AbstractSet[int] | None = None, start: int = 0
    ) -> Iterator[RawMessage]:
        """Read the messages in the order of the file, of some connections or of all.

        Args:
            start: Skip the messages whose position is lower.

        Raises:
            BagError: A chunk is damaged or contradicts the index; the text names it.
        """
        if start >= self.message_count:
            return
        first = self.chunk_count - 1
        while self.chunk_info(first).first > start:
            first -= 1
        for chunk in range(first, self.chunk_count):
            for message in self.chunk_messages(chunk, numbers):
                if message.position >= start:
                    yield message

    def chunk_messages(
        self, chunk: int, numbers: AbstractSet[int] | None = None
    ) -> Iterator[RawMessage]:
        """Read the messages of one chunk; see messages."""
        info = self.chunk_info(chunk)
        if numbers is not None and numbers.isdisjoint(info.counts):
            return
        content, places = self.chunk_content(chunk)
        for first in range(0, len(places.ids), _AT_ONCE):
            columns = zip(*(column[first : first + _AT_ONCE].tolist() for column in places))
            for position, (number, t_ns, start, stop) in enumerate(columns, info.first + first):
                if numbers is None or number in numbers:
                    yield RawMessage(position, number, t_ns, content[start:stop])

    def batches(self, chunk: int, spans: Mapping[int, tuple[int, int]]) -> Iterator[MessageBatch]:
        """Read the messages of a chunk, connection by connection; see messages.

        At most MAX_BATCH come at once.

        Args:
            spans: Only these connections, and their messages from one time on and before another,
                ns.
        """
        info = self.chunk_info(chunk)
        wanted = [number for number in info.counts if number in spans]
        if not wanted:
            return
        content, places = self.chunk_content(chunk)
        for number in wanted:
            since, until = spans[number]
            fits = (places.ids == number) & (places.times >= since) & (places.times < until)
            every = np.flatnonzero(fits)
            for first in range(0, len(every), MAX_BATCH):
                chosen = every[first : first + MAX_BATCH]
                ends = zip(places.starts[chosen].tolist(), places.stops[chosen].tolist())
                wires = [content[start:stop] for start, stop in ends]
                yield MessageBatch(number, info.first + chosen, places.times[chosen], wires)


class Ordered(NamedTuple):
    """A message of a bag, comparable in the order of reading."""

    t_ns: int
    rank: int
    """Place of the connection in the bag's index."""
    position: int
    value: bytes
    """What was asked to be kept of the message."""


def read_in_order(
    reader: MessageFile,
    keep: Callable[[RawMessage], bytes],
    numbers: AbstractSet[int] | None = None,
) -> Iterator[Ordered]:
    """Yield the messages of a bag in the order in which rosbag reads them.

    Chunks are read by their first time, each once. Held in memory are the largest chunk, and
    about 250 bytes beside the kept value for each message that a later chunk may still precede:
    one or two chunks' worth in a recorded bag, all of the bag when every chunk spans all of it.

    Raises:
        BagError: A chunk is damaged, or holds times that the index denies.
    """
    rank = {number: place for place, number in enumerate(reader.connections)}
    order = sorted(range(reader.chunk_count), key=reader.chunk_times)
    starts = [reader.chunk_times(chunk)[0] for chunk in order]
    waiting: list[Ordered] = []
    for chunk, next_ns in zip(order, [*starts[1:], MAX_NS + 1]):
        start_ns, end_ns = reader.chunk_times(chunk)
        for message in reader.chunk_messages(chunk, numbers):
            if not start_ns <= message.t_ns <= end_ns:
                raise BagError(
                    f"{reader.path}: chunk {chunk + 1} holds a message outside the times that "
                    f"the index states; repair it with: rosbag reindex {reader.path}"
                )
            entry = Ordered(message.t_ns, rank[message.number], message.position, keep(message))
            waiting.append(entry)
        waiting.sort()  # runs that are in order already cost one comparison a message
        ready = bisect_left(waiting, (next_ns,))
        yield from waiting[:ready]
        del waiting[:ready]


def match_topics(names: Iterable[str], present: AbstractSet[str], where: str) -> set[str]:
    """Find topics by name, with or without the leading slash; TopicNotFound lists what is there."""
    found: set[str] = set()
    for name in names:
        matches = {name} & present or {t for t in present if t.strip("/") == name.strip("/")}
        if not matches:
            raise TopicNotFound(f"there is no topic {name} in {where}; {_listing(name, present)}")
        found |= matches
    return found


def _listing(name: str, present: AbstractSet[str]) -> str:
    if not present:
        return "it has none"
    near = get_close_matches(name, sorted(present), n=LISTED, cutoff=0.4)
    every = [*near, *sorted(present - set(near))]
    more = f" and {len(every) - LISTED} more" if len(every) > LISTED else ""
    return f"it has {', '.join(every[:LISTED])}{more} ({len(every)} topics)"


def chosen_connections(reader: MessageFile, topics: Iterable[str] | None) -> set[int]:
    """Return the numbers of the connections of some topics of a bag (None = of all)."""
    connections = reader.connections
    if topics is None:
        return set(connections)
    names = match_topics(topics, {c.topic for c in connections.values()}, reader.path)
    return {number for number, c in connections.items() if c.topic in names}
