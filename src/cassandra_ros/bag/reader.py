# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read bags of format 2.0, chunk by chunk, without message classes."""

from __future__ import annotations

import os
from bisect import bisect_left, bisect_right
from collections import Counter
from difflib import get_close_matches
from typing import AbstractSet, BinaryIO, Callable, Iterable, Iterator, Mapping, NamedTuple

from cassandra_ros.bag import format as bagformat
from cassandra_ros.bag.chunk import ChunkMessage, decompress_chunk, find_messages
from cassandra_ros.bag.index import BagIndex, ChunkInfo, read_chunk_info, read_index
from cassandra_ros.errors import BagError, TopicNotFound
from cassandra_ros.messages.connection import Connection

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


class BagReader:
    """A bag that is open for reading; also a context manager.

    Memory: 40 bytes for each chunk of the bag, and while reading the largest chunk, packed and
    unpacked, with about 150 bytes for each of its messages.

    Args:
        path: The file.

    Raises:
        BagUnindexed: The bag was not closed properly, or is cut short.
        BagError: The file cannot be opened, is no bag of format 2.0, is encrypted, or its index
            is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        try:
            self._file: BinaryIO = open(self.path, "rb")
            self.file_bytes = os.fstat(self._file.fileno()).st_size
        except OSError as exc:
            raise BagError(f"{self.path} cannot be read: {exc.strerror}") from exc
        try:
            self._index: BagIndex = read_index(self._file, self.file_bytes, self.path)
        except (OSError, BagError) as exc:
            self._file.close()
            if isinstance(exc, BagError):
                raise
            raise BagError(f"{self.path} cannot be read: {exc.strerror}") from exc

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def connections(self) -> dict[int, Connection]:
        """Connections that have messages, by number, in the order of the index.

        Like rosbag, we leave out connections that no message refers to.
        """
        return {n: c for n, c in self._index.connections.items() if n in self.counts}

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each connection, by number."""
        return self._index.counts

    @property
    def message_count(self) -> int:
        """Messages in the bag."""
        return self._index.message_count

    @property
    def chunk_count(self) -> int:
        """Chunks in the bag."""
        return len(self._index)

    @property
    def start_ns(self) -> int:
        """Time of the first message, ns; 0 in an empty bag."""
        return min(self._index.chunks[1 :: BagIndex.PER_CHUNK], default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message, ns; 0 in an empty bag."""
        return max(self._index.chunks[2 :: BagIndex.PER_CHUNK], default=0)

    def compressions(self) -> dict[str, int]:
        """Count the chunks of each compression (reads the header of every chunk)."""
        return dict(Counter(self._chunk_header(i)[0] for i in range(self.chunk_count)))

    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read what the index says about a chunk.

        Args:
            chunk: In [0, chunk_count), in the order of the file.
        """
        first = chunk * BagIndex.PER_CHUNK
        info_pos, before = self._index.chunks[first + 3 : first + 5]
        where = f"{self.path}: the chunk info of chunk {chunk + 1}"
        self._file.seek(info_pos)
        info = read_chunk_info(self._file, self.file_bytes, self._index.numbers, where)
        return info._replace(first=before)

    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and last time in a chunk as the index has them, ns."""
        first = chunk * BagIndex.PER_CHUNK
        start_ns, end_ns = self._index.chunks[first + 1 : first + 3]
        return start_ns, end_ns

    def messages(
        self, numbers: AbstractSet[int] | None = None, start: int = 0
    ) -> Iterator[RawMessage]:
        """Read the messages in the order of the file.

        Args:
            numbers: Only these connections; None = all.
            start: Skip the messages whose position is lower.

        Yields:
            Messages, with their position among all of the bag.

        Raises:
            BagError: A chunk is damaged or contradicts the index; the text names it.
        """
        if start >= self.message_count:
            return
        first = bisect_right(self._index.chunks[4 :: BagIndex.PER_CHUNK], start) - 1
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
        content, found = self._load(chunk, info)
        mapping = self._index.numbers
        for position, (file_id, t_ns, start, stop) in enumerate(found, info.first):
            number = mapping[file_id]
            if numbers is None or number in numbers:
                yield RawMessage(position, number, t_ns, content[start:stop])

    def _load(self, chunk: int, info: ChunkInfo) -> tuple[bytes, list[ChunkMessage]]:
        compression, size, data_bytes = self._chunk_header(chunk)
        where = self._where(chunk)
        if compression == "none" and size != data_bytes:
            raise BagError(f"{where} is damaged: it states both {size} and {data_bytes} bytes")
        try:
            data = self._file.read(data_bytes)
        except OSError as exc:
            raise BagError(f"{where} cannot be read: {exc.strerror}") from exc
        if len(data) != data_bytes:
            raise bagformat.cut_short(where, self.file_bytes)
        content = decompress_chunk(compression, data, size, where)
        found = find_messages(content, where)
        counted = Counter(message.file_id for message in found)
        mapping = self._index.numbers
        if {mapping.get(file_id, -1): n for file_id, n in counted.items()} != info.counts:
            raise BagError(
                f"{where} is damaged: its {len(found)} messages are not those that the index "
                f"lists; repair it with: rosbag reindex {self.path}"
            )
        return content, found

    def _chunk_header(self, chunk: int) -> tuple[str, int, int]:
        where = self._where(chunk)
        self._file.seek(self._index.chunks[chunk * BagIndex.PER_CHUNK])
        record = bagformat.read_record(self._file, self.file_bytes, bagformat.OP_CHUNK, where)
        compression = record.fields.get(b"compression", b"").decode("utf-8", "replace")
        size = bagformat.number(record.fields, b"size", bagformat.U32, where)
        return compression, size, record.data_bytes

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
    order = sorted(range(reader.chunk_count), key=reader.chunk_times)
    waiting: list[Ordered] = []
    for place, chunk in enumerate(order):
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
        if place + 1 < len(order):
            next_ns = reader.chunk_times(order[place + 1])[0]
            ready = bisect_left(waiting, (next_ns,))
        else:
            ready = len(waiting)
        yield from waiting[:ready]
        del waiting[:ready]


def match_topics(names: Iterable[str], present: AbstractSet[str], where: str) -> set[str]:
    """Find topics by name, with or without the leading slash.

    Args:
        names: What was asked for.
        present: Topics that exist, spelt as they are stored.
        where: Where they should be, for the error's sentence.

    Raises:
        TopicNotFound: One of the names is not there; the text lists what is, the nearest first.
    """
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
    """Return the numbers of the connections of some topics of a bag (None = of all).

    Raises:
        TopicNotFound: The bag has no such topic.
    """
    connections = reader.connections
    if topics is None:
        return set(connections)
    names = match_topics(topics, {c.topic for c in connections.values()}, reader.path)
    return {number for number, c in connections.items() if c.topic in names}
