# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who wrote the rows of an imported bag: a writer id that follows from the bag's whole content.

A repeated import gets the same id and so overwrites its own rows; another bag, or the same bag
for another node, gets another id. Name, place, compression and chunking of the file do not count.
"""

from __future__ import annotations

import hashlib
from itertools import chain, takewhile
from struct import Struct
from typing import AbstractSet, NamedTuple

from cassandra_ros.bag.chunk import ChunkMessage
from cassandra_ros.bag.reader import BagReader, Progress
from cassandra_ros.errors import BagError
from cassandra_ros.keys import MAX_WRITER
from cassandra_ros.store.registry import Run

EARLIER_SAMPLE = 1000
"""Messages at each end of the bag that counted for an id of an earlier release."""

CONTENT = "content"
"""Label of an import's run: the digest of its bag. Runs of earlier releases have none."""

_SUMMARY = Struct("<QQQ")
_MESSAGE = Struct("<IQQ")
_AT_ONCE_BYTES = 1 << 20
_DAMAGED_CHUNK = _MESSAGE.pack(2**32 - 1, 2**64 - 1, 2**64 - 1)
"""No message has this time."""


class BagContent(NamedTuple):
    """What one pass over all messages of a bag tells."""

    digest: str
    """64 hex digits that differ when a connection, time or byte of any message differs."""
    sizes: dict[int, int]
    """Serialised bytes by number of the connection."""
    unordered: AbstractSet[int] = frozenset()
    """Connections of which some message is older than the one before it in the file, or lies at a
    time that the index denies."""

    def writer_id(self, node: str = "") -> int:
        """Return the writer id of an import for a node: an int in [1, 2**31 - 1]."""
        name = node.encode("utf-8", "surrogateescape")
        return _number(hashlib.sha256(self.digest.encode("ascii") + name))

    def is_of(self, run: Run) -> bool:
        """Say whether a run is an import of this content."""
        return run.labels.get(CONTENT) == self.digest


def read_content(reader: BagReader, reading: Progress | None = None) -> BagContent:
    """Read all messages of a bag and hash them in the order of the file.

    A chunk that is damaged counts as such. Nothing of it can be stored: the import that reaches it
    fails, and says where. ``reading`` is told how far it is, after each chunk.
    """
    digest, rank = _begin(b"cassandra_ros bag 2", reader)
    sizes, latest, unordered = dict.fromkeys(rank, 0), dict.fromkeys(rank, 0), set()
    for chunk in range(reader.chunk_count):
        before = sum(sizes.values())
        try:
            found = _add_chunk(digest, reader, chunk, rank, sizes)
            count, (start_ns, end_ns) = len(found), reader.chunk_times(chunk)
            for file_id, t_ns, _, _ in found:
                number = reader.numbers[file_id]
                if t_ns < latest[number] or not start_ns <= t_ns <= end_ns:
                    unordered.add(number)
                latest[number] = t_ns
        except BagError:
            digest.update(_DAMAGED_CHUNK)
            count = 0
        if reading is not None:
            reading(count, sum(sizes.values()) - before)
    return BagContent(digest.hexdigest(), sizes, unordered)


def _add_chunk(
    digest: hashlib._Hash,
    reader: BagReader,
    chunk: int,
    rank: dict[int, int],
    sizes: dict[int, int],
) -> list[ChunkMessage]:
    """Hash the messages of a chunk, add up their sizes, and return where they lie."""
    content, found = reader.chunk_content(chunk)
    numbers, pack = reader.numbers, _MESSAGE.pack
    # Of many small ones at once: each update costs as much as some hundred bytes.
    parts: list[bytes] = []
    waiting = 0
    for file_id, t_ns, start, stop in found:
        number, size = numbers[file_id], stop - start
        sizes[number] += size
        parts.append(pack(rank[number], t_ns, size))
        waiting += size
        if waiting <= _AT_ONCE_BYTES:
            parts.append(content[start:stop])
        else:
            digest.update(b"".join(parts))
            digest.update(memoryview(content)[start:stop])
            parts.clear()
            waiting = 0
    digest.update(b"".join(parts))
    return found


def is_earlier(run: Run) -> bool:
    """Say whether a run is an import by an earlier release, which did not note the content."""
    return run.kind == "import" and CONTENT not in run.labels


def earlier_writer_id(reader: BagReader, node: str) -> int:
    """Compute the writer id that an earlier release gave to a bag's import.

    Only the first and the last 1,000 messages counted: bags that differ in between share it.
    """
    name = node.encode("utf-8", "surrogateescape")
    digest, rank = _begin(b"cassandra_ros bag 1" + _with_length(name), reader)
    first = takewhile(lambda message: message.position < EARLIER_SAMPLE, reader.messages())
    last = reader.messages(start=max(0, reader.message_count - EARLIER_SAMPLE))
    for message in chain(first, last):
        digest.update(_MESSAGE.pack(rank[message.number], message.t_ns, len(message.data)))
        digest.update(message.data)
    return _number(digest)


def _begin(head: bytes, reader: BagReader) -> tuple[hashlib._Hash, dict[int, int]]:
    """Hash what the index says of a bag; return the hash and each connection's place in it."""
    digest = hashlib.sha256(head)
    connections = reader.connections
    for connection in connections.values():
        digest.update(_with_length(connection.topic.encode("utf-8")))
        digest.update(_with_length(connection.header))
    digest.update(_SUMMARY.pack(reader.message_count, reader.start_ns, reader.end_ns))
    return digest, {number: place for place, number in enumerate(connections)}


def _with_length(text: bytes) -> bytes:
    return len(text).to_bytes(8, "little") + text


def _number(digest: hashlib._Hash) -> int:
    return int.from_bytes(digest.digest(), "little") % MAX_WRITER + 1
