# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Common part of the readers of bags and MCAP files: connections, and messages chunk by chunk.

``Allowance`` limits the unpacked size of files and the number of their records: repeated bytes pack
to almost nothing, so a bag of some kilobytes may hold gigabytes of messages that fill memory and
disk, or millions of records that take minutes to read.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import AbstractSet, Callable, Iterable, Iterator, Mapping, NamedTuple, TypeVar

import numpy as np

from cassandra_ros.errors import BagError, BagTooLarge, TopicNotFound
from cassandra_ros.files.bag.format import ChunkMessages, Longs
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection

MAX_CHUNK_BYTES = 2**28
"""Maximum size of the content of a compressed chunk, bytes. rosbag closes a chunk at 768 KB, and
MCAP's writers at some MB; only a single larger message makes a larger one."""
MAX_PLAIN_BYTES = 2**30
"""Maximum size of a chunk that is not compressed, bytes: the file itself is as large."""
MAX_RATIO = 1000
"""Maximum ratio of the content of all chunks to the size of the file. It counts from
MAX_CHUNK_BYTES of content on."""
MAX_RECORDS = 2**19
"""Maximum number of records in the chunks of a file that has fewer bytes than that; a larger file
has at most as many records as bytes. A recorded message takes more, for its time is another one,
but millions of equal records pack to almost nothing, and each takes microseconds to read."""
MAX_TRUSTED_BYTES = 2**32 - 1
"""Maximum size of a chunk's content where large chunks are allowed, bytes: a bag can state no
larger size."""


class Allowance:
    """Counts the bytes and records of the chunks of a file; refuses those above the limits.

    The reader counts each chunk once, however often it is read.

    Args:
        file_bytes: Size of the file.
        large_chunks: The user trusts the file: a chunk may have up to MAX_TRUSTED_BYTES of
            content, and the file may unpack to any size and number of records.
    """

    def __init__(self, file_bytes: int, large_chunks: bool = False) -> None:
        self._large_chunks = large_chunks
        self._most = max(MAX_CHUNK_BYTES, MAX_RATIO * file_bytes)
        self._taken = 0
        self._most_records = max(MAX_RECORDS, file_bytes)
        self._records = 0

    def count_chunk(self, compression: str, size: int, packed: int, where: str) -> None:
        """Count a chunk before it is unpacked. The caller unpacks at most ``size`` bytes of it.

        Args:
            compression: Name of the compression that the chunk states.
            size: Size of the content that the chunk states, bytes.
            packed: Size of the chunk in the file, bytes.
            where: Name of the chunk in the error text.

        Raises:
            BagTooLarge: The chunk is too large, or all chunks up to this one are.
        """
        largest, most = max(size, packed), self.most(compression)
        if largest > most:
            raise BagTooLarge(
                f"{where} states {largest} bytes of content; chunks of over {most} bytes are not "
                f"read{self._remedy()}"
            )
        self._taken += size
        if self._taken > self._most and not self._large_chunks:
            raise BagTooLarge(
                f"{where} makes {self._taken} bytes of content up to here; a file that unpacks to "
                f"more than {MAX_RATIO} times its size is not read{self._remedy()}"
            )

    def count_records(self, where: str, number: int) -> None:
        """Count records of chunks, while they are read for the first time.

        Args:
            where: Name of the chunk in the error text.
            number: Number of records since the last call.

        Raises:
            BagTooLarge: They are too many.
        """
        self._records += number
        if self._records > self._most_records and not self._large_chunks:
            raise BagTooLarge(
                f"{where}: the file has over {self._most_records} records up to here; more records "
                f"than bytes, from {MAX_RECORDS} on, are not read{self._remedy()}"
            )

    def most(self, compression: str) -> int:
        """Return the maximum size of a chunk's content, bytes; '' is no compression, as 'none'."""
        if self._large_chunks:
            return MAX_TRUSTED_BYTES
        return MAX_PLAIN_BYTES if compression in ("", "none") else MAX_CHUNK_BYTES

    def _remedy(self) -> str:
        if self._large_chunks:
            return ""
        return (
            ", for such files are damaged, or made to fill the memory and the disk; if you trust "
            "this one: --allow-large-chunks"
        )


LISTED = 10
"""Maximum number of topics named in an error text."""
MAX_BATCH = 1 << 16
"""Maximum number of messages of a MessageBatch. A chunk may hold millions of empty messages."""
_AT_ONCE = 1 << 14
"""Maximum number of messages whose offsets are converted to Python integers at once."""

MessageProgress = Callable[[int, int], None]
"""Callback (messages, bytes): the numbers of messages and bytes handled since the last call."""

Self = TypeVar("Self", bound="MessageFile")


class FileMessage(NamedTuple):
    """A serialised message of a bag."""

    position: int
    """Index of the message among all messages of the bag in the order of the file, from 0."""
    number: int
    """Connection number."""
    t_ns: int
    """Receive time, ns."""
    data: bytes


class MessageBatch(NamedTuple):
    """Consecutive messages of one connection in one chunk."""

    number: int
    """Connection number."""
    positions: Longs
    """Position of each message, see FileMessage."""
    times: Longs
    """Receive time of each message, ns."""
    wires: list[bytes]
    """The serialised messages."""


class PublishTimes(NamedTuple):
    """publish_time and sequence of consecutive messages of an MCAP."""

    first: int
    """Position of the first message, see FileMessage."""
    delays: Longs
    """publish_time minus log_time of each message, ns."""
    sequences: Longs
    """Sequence number of each message."""


class ChunkInfo(NamedTuple):
    """The entry of the index for one chunk."""

    position: int
    """Offset in the file at which the record of the chunk begins, bytes."""
    start_ns: int
    end_ns: int
    """First and last receive time, as the index states them, ns."""
    counts: dict[int, int]
    """Number of messages in the chunk by connection number; every value is at least 1."""
    first: int
    """Number of messages in all chunks before this one: the position of its first message."""


class CutChunk(NamedTuple):
    """The part of a damaged chunk of a bag that can be read."""

    compression: str
    data_pos: int
    """Offset in the file at which the compressed content begins."""
    data_bytes: int
    """Size of the compressed content, bytes; 0 = nothing can be read."""
    content_bytes: int
    """Size of the unpacked content before the damage, bytes."""


@dataclass
class SalvageReport:
    """The damage of a bag, and how much of the bag can be read."""

    messages: int = 0
    """Number of messages that can be read."""
    why: str = ""
    """Description of the damage; '' = all chunks are complete."""
    lost_bytes: int = 0
    """Maximum number of bytes of the file that cannot be read; 0 if only the index is missing.

    A damaged compressed chunk counts with all its bytes, although some of them can be read.
    """
    behind: bool = False
    """Whether chunks after the first damage are read."""
    cuts: dict[int, CutChunk] = field(default_factory=dict)
    """What can be read of damaged chunks of a bag, by chunk number."""
    missing: int = 0
    """Number of messages that the index of the file lists, and that cannot be read."""
    damaged: set[int] = field(default_factory=set)
    """Chunks of which the index of the file lists messages that cannot be read. The others keep
    their positions, so the import of the file with and without salvage is one import."""

    def add(self, why: str, lost_bytes: int = 0) -> None:
        """Note damage, perhaps after other damage: the first description stays, bytes add up."""
        self.end(self.why or why, self.lost_bytes + lost_bytes)

    def end(self, why: str, lost_bytes: int = 0) -> None:
        """Note damage and its number of lost bytes in place of what was noted before."""
        self.why = why
        self.lost_bytes = lost_bytes

    def told(self, path: str) -> str:
        """Return a sentence about the damage and what can be read; '' if nothing is damaged."""
        if not self.why:
            return ""
        loss, where = "no message that the file holds is lost", "up to there"
        if self.lost_bytes:
            loss = f"at most {self.lost_bytes} bytes after them are lost"
        if self.behind:
            loss = f"{self.missing or f'at most {self.lost_bytes} bytes'} are lost"
            where = "before and after the damage"
        return f"{path} {self.why}: {self.messages} messages {where} are read, {loss}"


class MessageFile(ABC):
    """A bag or an MCAP that is open for reading; also a context manager.

    Attributes:
        path: Path of the file, as it was given.
        connections: Connections by number, in the order of the index. Like rosbag, we leave out
            connections without messages.
        counts: Number of messages by connection number.
        message_count: Number of messages in the file.
        chunk_count: Number of chunks in the file.
        start_ns, end_ns: Times of the first and the last message, ns; 0 in an empty file.
        left_out: Topic -> number of its messages that cannot be stored, and the reason: they are
            no ROS 1 messages, the header of their connection is damaged, or their time lies after
            the year 2106. The attributes above do not count them.
        extras: Kind of other records, in words -> their number.
        has_publish_times: Whether chunk_publish_times has returned any times so far.
    """

    salvaged = SalvageReport()
    """The damage that was found when the file was opened with ``salvage``, if any. This object of
    the class is shared and stays empty: a reader that finds damage makes its own."""
    has_publish_times = False
    path: str
    connections: dict[int, Connection]
    counts: Counter[int]
    message_count: int
    chunk_count: int
    start_ns: int
    end_ns: int

    @cached_property
    def left_out(self) -> dict[str, tuple[int, str]]:
        """See the class; none unless ``leave_out`` notes some."""
        return {}

    @cached_property
    def events(self) -> list[Mapping[str, str]]:
        """Fields of the events in the file, see mcap_events; none unless its reader notes some."""
        return []

    @cached_property
    def extras(self) -> dict[str, int]:
        """See the class; none unless its reader notes some."""
        return {}

    def leave_out(self, topic: str, why: str, count: int) -> None:
        """Note messages of a topic that cannot be stored."""
        before, reasons = self.left_out.get(topic, (0, why))
        if why not in reasons:
            reasons += f"; {why}"
        self.left_out[topic] = before + count, reasons

    @abstractmethod
    def close(self) -> None:
        """Close the file. A second call does nothing."""

    @abstractmethod
    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Read the index entry of a chunk. Chunks are numbered from 0 in the order of the file."""

    @abstractmethod
    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and the last receive time in a chunk that the index states, ns."""

    @abstractmethod
    def chunk_content(self, chunk: int) -> tuple[bytes, ChunkMessages]:
        """Read a chunk. Return its content and the list of its messages.

        The connection ids in the list are the numbers in ``connections``; messages that are left
        out are not in the list. At least 20 bytes of the content before each message belong to no
        message: identity.py writes over them, in a copy of the content.

        Raises:
            BagError: The chunk is damaged or contradicts the index; the text names the chunk.
        """

    def chunk_publish_times(self, chunk: int) -> PublishTimes | None:
        """Return the publish times and sequence numbers of the messages of a chunk.

        Return None if the file has no such fields, or if each publish time is the receive time and
        each sequence number is 0.

        Raises:
            BagError: The chunk is damaged.
        """
        return None

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def messages(self, numbers: AbstractSet[int] | None = None) -> Iterator[FileMessage]:
        """Read messages in the order of the file.

        Args:
            numbers: Numbers of the connections to read; None = all.

        Raises:
            BagError: A chunk is damaged or contradicts the index; the text names the chunk.
        """
        for chunk in range(self.chunk_count):
            yield from self.chunk_messages(chunk, numbers)

    def chunk_messages(
        self, chunk: int, numbers: AbstractSet[int] | None = None
    ) -> Iterator[FileMessage]:
        """Read the messages of one chunk in the order of the chunk; see messages."""
        info = self.chunk_info(chunk)
        if numbers is not None and numbers.isdisjoint(info.counts):
            return
        content, messages = self.chunk_content(chunk)
        for first in range(0, len(messages.ids), _AT_ONCE):
            columns = zip(*(column[first : first + _AT_ONCE].tolist() for column in messages))
            for position, (number, t_ns, start, stop) in enumerate(columns, info.first + first):
                if numbers is None or number in numbers:
                    yield FileMessage(position, number, t_ns, content[start:stop])

    def batches(self, chunk: int, numbers: AbstractSet[int]) -> Iterator[MessageBatch]:
        """Read the messages of a chunk in batches, connection by connection; see messages.

        Args:
            numbers: Connections to read.
        """
        info = self.chunk_info(chunk)
        if numbers.isdisjoint(info.counts):
            return
        content, messages = self.chunk_content(chunk)
        for number in filter(numbers.__contains__, info.counts):
            rows = np.flatnonzero(messages.ids == number)
            for first in range(0, len(rows), MAX_BATCH):
                page = rows[first : first + MAX_BATCH]
                ends = zip(messages.starts[page].tolist(), messages.stops[page].tolist())
                wires = [content[start:stop] for start, stop in ends]
                yield MessageBatch(number, info.first + page, messages.times[page], wires)


class OrderedMessage(NamedTuple):
    """A message of a bag. Objects compare in the order in which rosbag reads the messages."""

    t_ns: int
    rank: int
    """Position of the connection in the bag's index."""
    position: int
    """Position of the message, see FileMessage."""
    value: bytes
    """Result of ``keep`` for the message, see read_in_order."""


def read_in_order(
    reader: MessageFile,
    keep: Callable[[FileMessage], bytes],
    numbers: AbstractSet[int] | None = None,
) -> Iterator[OrderedMessage]:
    """Yield the messages of a bag in the order in which rosbag reads them.

    Each chunk is read once, in the order of their first times. Memory: the largest chunk, and about
    250 bytes plus the kept value for each message that may come after one of a later chunk. In a
    recorded bag these are the messages of one or two chunks; if every chunk covers the whole time
    range, all messages of the bag.

    Args:
        keep: Function that computes the value to keep of each message.
        numbers: Numbers of the connections to read; None = all.

    Raises:
        BagError: A chunk is damaged, or has times outside the time range that the index states.
    """
    rank = {number: place for place, number in enumerate(reader.connections)}
    order = sorted(range(reader.chunk_count), key=reader.chunk_times)
    starts = [reader.chunk_times(chunk)[0] for chunk in order]
    waiting: list[OrderedMessage] = []
    for chunk, next_ns in zip(order, [*starts[1:], MAX_NS + 1]):
        start_ns, end_ns = reader.chunk_times(chunk)
        for message in reader.chunk_messages(chunk, numbers):
            if not start_ns <= message.t_ns <= end_ns:
                raise BagError(
                    f"{reader.path}: chunk {chunk + 1} holds a message outside the times that "
                    f"the index states; repair it with: rosbag reindex {reader.path}"
                )
            entry = OrderedMessage(
                message.t_ns, rank[message.number], message.position, keep(message)
            )
            waiting.append(entry)
        waiting.sort()  # sorted runs of messages cost one comparison per message
        # A tuple of the time alone sorts before all messages of this time.
        ready = bisect_left(waiting, (next_ns,))
        yield from waiting[:ready]
        del waiting[:ready]


def match_topics(names: Iterable[str], present: AbstractSet[str], where: str) -> set[str]:
    """Return the topics of these names, with or without the leading slash.

    Raises:
        TopicNotFound: There is no such topic; the text lists the topics that exist.
    """
    topics: set[str] = set()
    for name in names:
        matches = {name} & present or {t for t in present if t.strip("/") == name.strip("/")}
        if not matches:
            raise TopicNotFound(f"there is no topic {name} in {where}; {_listing(name, present)}")
        topics |= matches
    return topics


def _listing(name: str, present: AbstractSet[str]) -> str:
    """Return in words which topics there are, those with names like ``name`` first."""
    if not present:
        return "it has none"
    near = get_close_matches(name, sorted(present), n=LISTED, cutoff=0.4)
    topics = [*near, *sorted(present - set(near))]
    more = f" and {len(topics) - LISTED} more" if len(topics) > LISTED else ""
    return f"it has {', '.join(topics[:LISTED])}{more} ({len(topics)} topics)"


def topics_of(reader: MessageFile, names: Iterable[str] | None) -> set[str]:
    """Return the topics of a bag that have one of these names; None = all topics.

    Topics whose messages are left out are among them.
    """
    present = {c.topic for c in reader.connections.values()} | reader.left_out.keys()
    return present if names is None else match_topics(names, present, reader.path)


def connections_of_topics(reader: MessageFile, topics: Iterable[str] | None) -> set[int]:
    """Return the numbers of the connections of some topics of a bag; None = all topics."""
    chosen = topics_of(reader, topics)
    return {number for number, c in reader.connections.items() if c.topic in chosen}
