# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who wrote the rows of an imported bag: a writer id that follows from the bag's whole content.

A repeated import gets the same id and so overwrites its own rows; another bag, or the same bag
for another node, gets another id. Name, place, compression and chunking of the file do not count.
"""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from struct import Struct
from typing import AbstractSet, Iterable, Mapping, NamedTuple, Union

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cassandra_ros.bag.chunk import ChunkMessages
from cassandra_ros.bag.message_file import MessageFile, MessageProgress, SentTimes
from cassandra_ros.errors import BagError, BagTooLarge
from cassandra_ros.keys import MAX_WRITER
from cassandra_ros.tables.registry import Run

CONTENT = "content"
"""Label of an import's run: the digest of its bag."""

_SUMMARY = Struct("<QQQ")
_MESSAGE = Struct("<IQQ")
_HEAD = np.dtype([("rank", "<u4"), ("time", "<u8"), ("size", "<u8")])
"""The same, for many messages at once."""
_LARGE_BYTES = 4096
"""Messages of this size are hashed where they lie."""
_AT_ONCE = 1 << 16
"""Maximum number of messages that are made ready for the hash at once."""
_NOTHING = ChunkMessages(*(np.zeros(0, np.int64) for _ in ChunkMessages._fields))
_Part = Union[bytes, memoryview]
_DAMAGED: list[_Part] = [_MESSAGE.pack(2**32 - 1, 2**64 - 1, 2**64 - 1)]
"""In place of a chunk; no message has this time."""


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


def read_content(reader: MessageFile, reading: MessageProgress | None = None) -> BagContent:
    """Read all messages of a bag and hash them in the order of the file.

    A chunk that is damaged counts as such. Nothing of it can be stored: the import that reaches it
    fails, and says where. ``reading`` is told how far it is, after each chunk.

    Raises:
        BagTooLarge: The bag would unpack to more than is allowed.
    """
    digest, rank = _begin(b"cassandra_ros bag 2", reader)
    sizes, latest = dict.fromkeys(rank, 0), dict.fromkeys(rank, 0)
    unordered: set[int] = set()
    sent = hashlib.sha256()
    with ThreadPoolExecutor(1) as hashing:  # one chunk is hashed while the next one is read
        hashed = hashing.submit(_update, digest, [])
        for chunk in range(reader.chunk_count):
            places = _NOTHING
            parts: Iterable[_Part] = _DAMAGED
            try:
                content, places = reader.chunk_content(chunk)
                parts = _parts(content, places, rank)
                _add_times(places, reader.chunk_times(chunk), latest, unordered)
                sent.update(_sent(reader.chunk_sent(chunk)))
            except BagTooLarge:
                raise  # before anything of the file is stored
            except BagError:
                pass
            hashed.result()
            hashed = hashing.submit(_update, digest, parts)
            for number in np.unique(places.ids).tolist():
                sizes[number] += int(places.sizes[places.ids == number].sum())
            if reading is not None:
                reading(len(places.ids), int(places.sizes.sum()))
    if reader.tells_sent:
        digest.update(sent.digest())
    return BagContent(digest.hexdigest(), sizes, unordered)


def _sent(told: SentTimes | None) -> bytes:
    """Return what is hashed of when messages were sent: of those of which there is something."""
    if told is None:
        return b""
    rows = np.stack([np.arange(len(told.delays)) + told.first, told.delays, told.sequences], 1)
    return bytes(rows[(rows[:, 1:] != 0).any(axis=1)].astype("<i8"))


def _update(digest: hashlib._Hash, parts: Iterable[_Part]) -> None:
    for part in parts:
        digest.update(part)


def _parts(content: bytes, places: ChunkMessages, rank: Mapping[int, int]) -> Iterable[_Part]:
    """Return what is hashed of a chunk: of each message connection, time and size, its bytes."""
    count = len(places.ids)
    if count <= _AT_ONCE:
        return _parts_at_once(content, places, rank)
    firsts = range(0, count, _AT_ONCE)
    pages = (ChunkMessages(*(column[n : n + _AT_ONCE] for column in places)) for n in firsts)
    return chain.from_iterable(_parts_at_once(content, page, rank) for page in pages)


def _parts_at_once(content: bytes, places: ChunkMessages, rank: Mapping[int, int]) -> list[_Part]:
    if not len(places.ids):
        return []
    heads = np.empty(len(places.ids), _HEAD)
    heads["rank"] = [rank[number] for number in places.ids.tolist()]
    heads["time"], heads["size"] = places.times, places.sizes
    begins = places.starts - _HEAD.itemsize
    first, last = int(begins[0]), int(places.stops[-1])
    if last - first >= _LARGE_BYTES * len(heads):
        view, spans = memoryview(content), zip(places.starts.tolist(), places.stops.tolist())
        data = [view[start:stop] for start, stop in spans]
        return [part for each in zip(map(bytes, heads), data) for part in each]
    # Of small ones at once: each update costs as much as some hundred bytes. What a record of the
    # bag has before its message is longer than what is to stand there.
    changed = np.frombuffer(content, np.uint8)[first:last].copy()
    raw = heads.view(np.uint8).reshape(len(heads), -1)
    sliding_window_view(changed, _HEAD.itemsize, writeable=True)[begins - first] = raw
    small = changed.tobytes()
    ends = zip((begins - first).tolist(), (places.stops - first).tolist())
    return [b"".join([small[begin:stop] for begin, stop in ends])]


def _add_times(
    places: ChunkMessages, ends: tuple[int, int], latest: dict[int, int], unordered: set[int]
) -> None:
    """Note the connections of a chunk of which messages are not in the order of their times."""
    for number in np.unique(places.ids).tolist():
        times = places.times[places.ids == number]
        if (np.diff(times, prepend=latest[number]) < 0).any() or not (
            ends[0] <= times.min() and times.max() <= ends[1]
        ):
            unordered.add(number)
        latest[number] = int(times[-1])


def _begin(head: bytes, reader: MessageFile) -> tuple[hashlib._Hash, dict[int, int]]:
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
