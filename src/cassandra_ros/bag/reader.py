# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read bags of format 2.0, chunk by chunk, without message classes."""

from __future__ import annotations

import os
from bisect import bisect_left, bisect_right
from collections import Counter
from contextlib import ExitStack
from difflib import get_close_matches
from typing import AbstractSet, Callable, Iterable, Iterator, Mapping, NamedTuple

import numpy as np

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.chunk import MIN_AT_ONCE, Longs, Places, decompress_chunk, find_messages
from cassandra_ros.bag.index import BagIndex
from cassandra_ros.errors import BagError, TopicNotFound
from cassandra_ros.keys import MAX_NS

LISTED = 10
"""Topics that an error names."""

Progress = Callable[[int, int], None]
"""Called with the messages and bytes that were handled since the last call."""


class RawMessage(NamedTuple):
    """A message as it lies in the bag."""

    position: int
    """Place among all messages of the bag, in the order of the file, from 0."""
    number: int
    """Key of BagReader.connections."""
    t_ns: int
    data: bytes


class Stretch(NamedTuple):
    """The messages of one connection in one chunk, in its order."""

    number: int
    """Key of BagReader.connections."""
    positions: Longs
    """Their places among all messages of the bag, in the order of the file, from 0."""
    times: Longs
    """ns."""
    wires: list[bytes]


class BagReader(BagIndex):
    """A bag that is open for reading; also a context manager.

    Memory: 40 bytes for each chunk of the bag, and while reading the largest chunk, packed and
    unpacked, with about 200 bytes for each of its messages.

    Attributes:
        connections: By number, in the order of the index. Like rosbag, we leave out those that
            no message refers to.
        counts: Messages of each connection, by number.
        message_count, chunk_count: Of the whole bag.
        start_ns, end_ns: Times of the first and the last message, ns; 0 in an empty bag.

    Raises:
        BagUnindexed: The bag was not closed properly, or is cut short.
        BagError: The file cannot be opened, is no bag of format 2.0, is encrypted, or its index
            is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        name = os.fspath(path)
        try:
            with ExitStack() as opened:
                super().__init__(opened.enter_context(open(name, "rb")), name)
                opened.pop_all()
        except OSError as exc:
            raise BagError(f"{name} cannot be read: {exc.strerror}") from exc

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def compressions(self) -> dict[str, int]:
        """Count the chunks of each compression (reads the header of every chunk)."""
        return dict(Counter(self._chunk_header(i)[0] for i in range(self.chunk_count)))

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
        first = bisect_right(self._column(4), start) - 1
        for message in self.chunk_messages(first, numbers):
            if message.position >= start:
                yield message
        for chunk in range(first + 1, self.chunk_count):
            yield from self.chunk_messages(chunk, numbers)

    def chunk_messages(
        self, chunk: int, numbers: AbstractSet[int] | None = None
    ) -> Iterator[RawMessage]:
        """Read the messages of one chunk; see messages."""
        info = self.chunk_info(chunk)
        if numbers is not None and numbers.isdisjoint(info.counts):
            return
        content, places = self.chunk_content(chunk)
        columns = zip(*(column.tolist() for column in places))
        for position, (number, t_ns, start, stop) in enumerate(columns, info.first):
            if numbers is None or number in numbers:
                yield RawMessage(position, number, t_ns, content[start:stop])

    def stretches(self, chunk: int, spans: Mapping[int, tuple[int, int]]) -> Iterator[Stretch]:
        """Read the messages of a chunk, connection by connection; see messages.

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
            chosen = np.flatnonzero(fits)
            ends = zip(places.starts[chosen].tolist(), places.stops[chosen].tolist())
            wires = [content[start:stop] for start, stop in ends]
            yield Stretch(number, info.first + chosen, places.times[chosen], wires)

    def chunk_content(self, chunk: int) -> tuple[bytes, Places]:
        """Read what a chunk holds, and where its messages lie in it; see messages.

        Their ids are those of ``connections``.
        """
        where, counts = self._where(chunk), self.chunk_info(chunk).counts
        compression, size, data_bytes = self._chunk_header(chunk)
        if compression == "none" and size != data_bytes:
            raise BagError(f"{where} is damaged: it states both {size} and {data_bytes} bytes")
        try:
            data = self._file.read(data_bytes)
        except OSError as exc:
            raise BagError(f"{where} cannot be read: {exc.strerror}") from exc
        content = decompress_chunk(compression, data, size, where)
        places = find_messages(content, where, self._offsets(counts))
        present, inverse, each = np.unique(places.ids, return_inverse=True, return_counts=True)
        numbers = [self.numbers.get(file_id, -1) for file_id in present.tolist()]
        ids = np.array(numbers, np.int64)[inverse]
        if dict(zip(numbers, each.tolist())) != counts:
            raise BagError(
                f"{where} is damaged: its {len(ids)} messages are not those that the index "
                f"lists; repair it with: rosbag reindex {self.path}"
            )
        return content, places._replace(ids=ids)

    def _offsets(self, counts: Mapping[int, int]) -> Longs | None:
        """Read where the index of the chunk before the file's position says that messages begin.

        None: it does not say so of all, or it takes longer than to look for them.
        """
        count = sum(counts.values())
        if count < MIN_AT_ONCE * max(1, len(counts)):
            return None
        found: list[Longs] = []
        try:
            for _ in counts:
                record = bagformat.read_record(self._file, bagformat.OP_INDEX, self.path)
                if record.data_bytes > 12 * count:
                    return None
                entries = np.frombuffer(self._file.read(record.data_bytes), "<u4")
                found.append(entries[2::3].astype(np.int64))
        except (BagError, OSError, ValueError):
            return None
        offsets = np.concatenate(found)
        return np.sort(offsets) if len(offsets) == count else None

    def _chunk_header(self, chunk: int) -> tuple[str, int, int]:
        where = self._where(chunk)
        self._file.seek(self._chunk(chunk)[0])
        fields, _, data_bytes = bagformat.read_record(self._file, bagformat.OP_CHUNK, where)
        compression = fields.get(b"compression", b"").decode("utf-8", "replace")
        return compression, bagformat.number(fields, b"size", where), data_bytes

    def _where(self, chunk: int) -> str:
        return f"{self.path}: chunk {chunk + 1} of {self.chunk_count}"


class Ordered(NamedTuple):
    """A message of a bag, comparable in the order of reading."""

    t_ns: int
    rank: int
    """Place of the connection in the bag's index."""
    position: int
    value: bytes
    """What was asked to be kept of the message."""


def read_in_order(
    reader: BagReader, keep: Callable[[RawMessage], bytes], numbers: AbstractSet[int] | None = None
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


def chosen_connections(reader: BagReader, topics: Iterable[str] | None) -> set[int]:
    """Return the numbers of the connections of some topics of a bag (None = of all)."""
    connections = reader.connections
    if topics is None:
        return set(connections)
    names = match_topics(topics, {c.topic for c in connections.values()}, reader.path)
    return {number for number, c in connections.items() if c.topic in names}
