# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The writer id of an imported bag, computed from the whole content of the bag, and its runs.

A repeated import gets the same id, so it overwrites its own rows. Another bag, or the same bag for
another robot, gets another id. Name, folder, compression and chunks of the file do not matter.
The runs of a file are also found by its path, for class Bag.
"""

from __future__ import annotations

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from struct import Struct
from typing import Callable, Iterable, Mapping, NamedTuple, Sequence, Union

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cassandra_ros.errors import BagError, BagTooLarge
from cassandra_ros.files.bag.format import ChunkMessages
from cassandra_ros.files.bag.message_file import MessageFile, MessageProgress, PublishTimes
from cassandra_ros.keys import MAX_WRITER
from cassandra_ros.store.tables.registry import Run

CONTENT = "content"
"""Name of the label of an import's run that holds the digest of its bag."""

_SUMMARY = Struct("<QQQ")
_MESSAGE = Struct("<IQQ")
_HEAD = np.dtype([("rank", "<u4"), ("time", "<u8"), ("size", "<u8")])
"""The fields of _MESSAGE, for numpy."""
_LARGE_BYTES = 4096
"""Mean message size from which messages are hashed without copying them first, bytes."""
_AT_ONCE = 1 << 16
"""Maximum number of messages that are prepared for the hash at once."""
_NOTHING = ChunkMessages(*(np.zeros(0, np.int64) for _ in ChunkMessages._fields))
_HashInput = Union[bytes, memoryview]
"""Bytes that are added to a hash."""
_DAMAGED: list[_HashInput] = [_MESSAGE.pack(2**32 - 1, 2**64 - 1, 2**64 - 1)]
"""Hash input of a damaged chunk. No message can have this time."""


class BagContent(NamedTuple):
    """The results of one pass over all messages of a bag."""

    digest: str
    """64 hex digits that differ if a connection, a time or a byte of any message differs."""
    sizes: dict[int, int]
    """Size of the serialised messages by connection number, bytes."""

    def writer_id(self, node: str = "") -> int:
        """Return the writer id of an import for a robot: 1 to 2**31 - 1."""
        name = node.encode("utf-8", "surrogateescape")
        return _number(hashlib.sha256(self.digest.encode("ascii") + name))

    def is_of(self, run: Run) -> bool:
        """Say whether a run is an import of this content."""
        return run.labels.get(CONTENT) == self.digest


def read_content(
    reader: MessageFile,
    reading: MessageProgress | None = None,
    seen: Callable[[bytes, ChunkMessages], object] | None = None,
) -> BagContent:
    """Read all messages of a bag and hash them in the order of the file.

    A damaged chunk adds a fixed value to the hash: the import fails when it reaches this chunk,
    and one with salvage continues it.

    Args:
        reading: Callback for the messages that were read, called after each chunk.
        seen: Called with what ``chunk_content`` returns of each chunk that can be read.

    Raises:
        BagTooLarge: The bag would unpack to more bytes or records than the Allowance permits.
    """
    digest, rank = _begin(b"cassandra_ros bag 2", reader)
    sizes = dict.fromkeys(rank, 0)
    sent = hashlib.sha256()
    with ThreadPoolExecutor(1) as hashing:  # one chunk is hashed while the next one is read
        hashed = hashing.submit(_update, digest, [])
        for chunk in range(reader.chunk_count):
            messages = _NOTHING
            parts: Iterable[_HashInput] = _DAMAGED
            try:
                content, messages = reader.chunk_content(chunk)
                if chunk not in reader.salvaged.damaged:
                    parts = _parts(content, messages, rank)
                    sent.update(_publish_time_bytes(reader.chunk_publish_times(chunk)))
                if seen is not None:
                    seen(content, messages)
            except BagTooLarge:
                raise  # nothing of the file is stored yet
            except BagError:
                pass
            hashed.result()
            hashed = hashing.submit(_update, digest, parts)
            for number in np.unique(messages.ids).tolist():
                sizes[number] += int(messages.sizes[messages.ids == number].sum())
            if reading is not None:
                reading(len(messages.ids), int(messages.sizes.sum()))
    if reader.has_publish_times:
        digest.update(sent.digest())
    return BagContent(digest.hexdigest(), sizes)


def _publish_time_bytes(times: PublishTimes | None) -> bytes:
    """Return the hash input for publish times: those that are not 0, with their positions."""
    if times is None:
        return b""
    rows = np.stack([np.arange(len(times.delays)) + times.first, times.delays, times.sequences], 1)
    return bytes(rows[(rows[:, 1:] != 0).any(axis=1)].astype("<i8"))


def _update(digest: hashlib._Hash, parts: Iterable[_HashInput]) -> None:
    for data in parts:
        digest.update(data)


def _parts(
    content: bytes, messages: ChunkMessages, rank: Mapping[int, int]
) -> Iterable[_HashInput]:
    """Return the hash input for a chunk: connection, time, size and bytes of each message."""
    count = len(messages.ids)
    if count <= _AT_ONCE:
        return _parts_at_once(content, messages, rank)
    firsts = range(0, count, _AT_ONCE)
    pages = (ChunkMessages(*(column[n : n + _AT_ONCE] for column in messages)) for n in firsts)
    return chain.from_iterable(_parts_at_once(content, page, rank) for page in pages)


def _parts_at_once(
    content: bytes, messages: ChunkMessages, rank: Mapping[int, int]
) -> list[_HashInput]:
    if not len(messages.ids):
        return []
    heads = np.empty(len(messages.ids), _HEAD)
    heads["rank"] = [rank[number] for number in messages.ids.tolist()]
    heads["time"], heads["size"] = messages.times, messages.sizes
    begins = messages.starts - _HEAD.itemsize
    first, last = int(begins[0]), int(messages.stops[-1])
    if last - first >= _LARGE_BYTES * len(heads):
        view = memoryview(content)
        spans = zip(messages.starts.tolist(), messages.stops.tolist())
        data = [view[start:stop] for start, stop in spans]
        return [head_or_data for pair in zip(map(bytes, heads), data) for head_or_data in pair]
    # Small messages are joined, because each update of the hash costs as much as hashing some
    # hundred bytes. The head is written over the end of the record's header, which is longer.
    changed = np.frombuffer(content, np.uint8)[first:last].copy()
    raw = heads.view(np.uint8).reshape(len(heads), -1)
    sliding_window_view(changed, _HEAD.itemsize, writeable=True)[begins - first] = raw
    small = changed.tobytes()
    ends = zip((begins - first).tolist(), (messages.stops - first).tolist())
    return [b"".join([small[begin:stop] for begin, stop in ends])]


def _begin(head: bytes, reader: MessageFile) -> tuple[hashlib._Hash, dict[int, int]]:
    """Hash the index of a bag. Return the hash, and the position of each connection by number."""
    digest = hashlib.sha256(head)
    connections = reader.connections
    for connection in connections.values():
        digest.update(_with_length(connection.topic.encode("utf-8")))
        digest.update(_with_length(connection.header))
    count = reader.message_count + reader.salvaged.missing
    digest.update(_SUMMARY.pack(count, reader.start_ns, reader.end_ns))
    return digest, {number: place for place, number in enumerate(connections)}


def _with_length(text: bytes) -> bytes:
    return len(text).to_bytes(8, "little") + text


def _number(digest: hashlib._Hash) -> int:
    return int.from_bytes(digest.digest(), "little") % MAX_WRITER + 1


_MOST_NAMED = 3
"""Maximum number of runs named in an error text."""


def source_of(path: str | os.PathLike[str]) -> str:
    """Return the absolute path of a file as it is stored with a run; invalid UTF-8 becomes �."""
    return os.fsencode(os.path.abspath(path)).decode("utf-8", "replace")


def runs_of_file(runs: Sequence[Run], path: str) -> list[Run]:
    """Return the runs whose source is this file, with or without symbolic links in the path."""
    ways = {source_of(path), source_of(_real(path))}
    return [run for run in runs if run.source and ways & {run.source, _real(run.source)}]


def _real(path: str) -> str:
    try:
        return os.path.realpath(path)
    except ValueError:  # the path contains NUL, so there is no such file
        return path


def runs_meant(runs: Sequence[Run], name: str) -> list[Run]:
    """Return the runs that a file name of class Bag means; [] = no run.

    These are the runs whose source is this file. If no run has it and no such file exists here,
    they are the runs with this name or writer id.
    """
    file_runs = runs_of_file(runs, name)
    if file_runs or os.path.isfile(name):
        return file_runs
    return [run for run in runs if name and name in (run.name, str(run.writer))]


def describe_same_name(runs: Sequence[Run], path: str) -> str:
    """Name the runs of other files that have this base name; '' = no other file has it."""
    name = os.path.basename(path)
    alike = [run for run in runs if run.name == name and name]
    descriptions = [
        f"{run.source} (open it as Bag({run.source!r}) or Bag('{run.writer}'))"
        if run.source
        else f"no file (open it as Bag('{run.writer}'))"
        for run in alike[:_MOST_NAMED]
    ]
    if len(alike) > _MOST_NAMED:
        descriptions.append(f"{len(alike) - _MOST_NAMED} more")
    if not descriptions:
        return ""
    return f"the stored run {name!r:.80} is of {', of '.join(descriptions)}"
