# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bytes of a block: many serialised messages, arranged so that they compress well.

The first byte is the version, the second one the flags; a zstd frame follows. It holds, each as
planes (all first bytes, all second bytes, …, little-endian): the differences of the key times,
those of ``_seq``, the sizes, and with flag 1 the receive times minus the key times. The messages
follow in groups of equal size, the smallest first, each group in the order of the block. A group of
at least 16 messages is stored as planes too: bytes that change little from message to message are
side by side, and a field at a fixed offset is some whole rows of a matrix. With flag 2 messages of
at least 512 bytes, which are the last, are coded as words instead (words.py): scans take half the
bytes. With flag 4 each other group of at least 16 has its own layout (layouts.py). With flag 8
there is no frame, because zstd would save nothing.
"""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from cassandra_ros.blocks.layouts import BytesLike, lay_out, read_layout
from cassandra_ros.blocks.words import code_words, decode_words, most_bytes
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.tables.block_limits import MAX_CONTENT_BYTES

Longs = NDArray[np.int64]
Bytes = NDArray[np.uint8]

VERSION = 1
LEVEL = 1
"""Level of zstd. Higher ones take more time than storing the bytes."""
QUICK_LEVEL = -10
"""Level of zstd for data that hardly compress, such as random numbers: as many bytes in a third of
the time."""
HARDLY = 0.6
"""Ratio of compressed to plain bytes of a sample above which data hardly compress. Data of robots
have 0.05 to 0.3."""
SAMPLE, STRETCHES = 16 * 1024, 4
"""Size of the sample in bytes, and number of its parts. Taken from blocks of at least four times
this size."""
MIN_PLANES = 16
"""Minimum number of messages of one size that are stored as planes. Fewer are stored plain, because
planes would only tear texts apart."""
FEW_SHARE = 64
"""A read of less than one in FEW_SHARE messages of a block cuts each one out by itself."""
LONG = 512
"""Minimum size of messages that may be coded as words, bytes."""
_RECEIVED, _WORDS, _LAYOUTS, _STORED = 1, 2, 4, 8
_KNOWN = _RECEIVED | _WORDS | _LAYOUTS | _STORED
_HEAD = 2
_I8, _U4 = np.dtype("<i8"), np.dtype("<u4")


class Group(NamedTuple):
    """The messages of a block that have the same size."""

    size: int
    members: Longs
    """Positions of the messages in the block, ascending."""
    planes: Bytes
    """Matrix (size, members): row k holds byte k of every message."""


class Unpacked:
    """The messages of a block, in the order (time, ``_seq``).

    Attributes:
        times: Key times, ns.
        seqs: ``_seq`` of each message.
        sizes: Number of serialised bytes of each message.
        received: Receive times, ns; None = they equal the key times.
        groups: The messages by size, the smallest first.
    """

    def __init__(
        self,
        times: Longs,
        seqs: Longs,
        sizes: Longs,
        received: Optional[Longs],
        body: memoryview,
        as_rows: FrozenSet[int] = frozenset(),
    ) -> None:
        self.times, self.seqs, self.sizes, self.received = times, seqs, sizes, received
        # Sizes whose messages are stored one after the other, however many there are.
        self._body, self._as_rows = body, as_rows

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def groups(self) -> Tuple[Group, ...]:
        """The messages by size, the smallest first; no bytes are copied."""
        found: List[Group] = []
        at = 0
        for members in _members(self.sizes):
            size, count = int(self.sizes[members[0]]), len(members)
            flat = np.frombuffer(self._body, np.uint8, size * count, at)
            at += size * count
            as_planes = _as_planes(count) and size not in self._as_rows
            planes = flat.reshape(size, count) if as_planes else flat.reshape(count, size).T
            found.append(Group(size, members, planes))
        return tuple(found)

    @cached_property
    def _turned(self) -> Tuple[bytes, Longs]:
        """All messages, those of a group one after the other, and the offset of each."""
        parts = [_turn(group.planes) for group in self.groups]
        starts, at = np.empty(len(self), np.int64), 0
        for (size, members, _), part in zip(self.groups, parts):
            starts[members] = np.arange(at, at + len(part), size) if size else at
            at += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts), starts

    def wire(self, position: int) -> bytes:
        """Return one message, serialised."""
        # Looking at the other messages would be most of the work.
        size, alike = int(self.sizes[position]), self.sizes == self.sizes[position]
        count, place = np.count_nonzero(alike), np.count_nonzero(alike[:position])
        at = int(self.sizes[self.sizes < size].sum())
        if not _as_planes(count) or size in self._as_rows:
            return bytes(self._body[at + place * size : at + (place + 1) * size])
        return bytes(self._body[at + place : at + size * count : count])

    def wires(self, positions: Optional[Longs] = None) -> List[bytes]:
        """Return messages, serialised: those at some positions, None = all."""
        size = len(self._body) // max(1, len(self))
        if positions is None and size >= LONG and size in self._as_rows and len(self.groups) == 1:
            return [bytes(self._body[at : at + size]) for at in range(0, len(self._body), size)]
        turned = "_turned" in self.__dict__
        if positions is not None and not turned and FEW_SHARE * len(positions) < len(self):
            return [self.wire(position) for position in positions.tolist()]
        every, starts = self._turned
        ends = starts + self.sizes
        if positions is not None:
            starts, ends = starts[positions], ends[positions]
        return [every[start:end] for start, end in zip(starts.tolist(), ends.tolist())]


def pack_block(
    times: Sequence[int],
    seqs: Sequence[int],
    wires: Sequence[bytes],
    received: Optional[Sequence[int]] = None,
) -> bytes:
    """Pack messages that are sorted by (time, ``_seq``).

    Args:
        times: Key times, ns.
        seqs: ``_seq`` of each message.
        wires: The serialised messages.
        received: Receive times, ns; None = they equal the key times.
    """
    t = np.array(times, np.int64)
    sizes = np.fromiter(map(len, wires), np.int64, len(wires))
    parts: List[BytesLike] = []
    parts += _planes(_differences(t)), _planes(_differences(np.array(seqs, np.int64)))
    parts.append(_planes(sizes.astype("<u4")))
    if received is not None:
        parts.append(_planes(np.array(received, np.int64) - t))
    if (sizes != sizes[:1]).any():
        order = np.argsort(sizes, kind="stable")
        wires, sizes = [wires[n] for n in order.tolist()], sizes[order]
    short = int(np.searchsorted(sizes, LONG))
    words = code_words(wires[short:]) if short < len(wires) else None
    if words is not None:
        wires, sizes = wires[:short], sizes[:short]
    flags = (_RECEIVED if received is not None else 0) | (_WORDS if words is not None else 0)
    many = _many(sizes)
    if many:
        flags |= _LAYOUTS
    done = 0
    for begin, end in many:
        parts += [*wires[done:begin], *lay_out(wires[begin:end], _cost)]
        done = end
    parts += [*wires[done:], words or b""]
    return _finished(flags, parts, len(t))


def _finished(flags: int, parts: Sequence[BytesLike], messages: int) -> bytes:
    """Return the bytes of a block, compressed at the level that a sample suggests."""
    # If the bytes are stored plain they are not copied again.
    stored = b"".join([bytes((VERSION, flags | _STORED)), *parts])
    body = memoryview(stored)[_HEAD:]
    if len(body) >= 4 * SAMPLE:
        step = len(body) // STRETCHES
        starts = range(step // 2, len(body), step)
        sample = b"".join([body[at : at + SAMPLE // STRETCHES] for at in starts])
        if _cost(sample) > HARDLY * len(sample):
            # For small messages a frame already pays for the differences of times.
            long = len(body) > LONG * messages
            if long and len(_mine.quick.compress(sample)) >= len(sample):
                return stored
            return bytes((VERSION, flags)) + _mine.quick.compress(body)
    return bytes((VERSION, flags)) + _mine.compressor.compress(body)


def _many(sizes: Longs) -> List[Tuple[int, int]]:
    """Return the ranges of ascending sizes in which many messages have one size other than 0."""
    if not len(sizes):
        return []
    ends = np.append(np.flatnonzero(np.diff(sizes)) + 1, len(sizes))
    begins = np.append(0, ends[:-1])
    many = (ends - begins >= MIN_PLANES) & (sizes[begins] > 0)
    return list(zip(begins[many].tolist(), ends[many].tolist()))


def unpack_block(data: bytes, count: int, size: int) -> Unpacked:
    """Unpack a block.

    Args:
        data: Result of pack_block.
        count: Number of messages, as the block's row says.
        size: Number of serialised bytes of all messages, as the block's row says.

    Raises:
        CorruptMessage: The bytes are not such a block.
    """
    if len(data) < _HEAD or data[0] != VERSION or data[1] & ~_KNOWN:
        raise CorruptMessage(f"a block of {len(data)} bytes is of no version that is known here")
    received, coded = bool(data[1] & _RECEIVED), data[1] & (_WORDS | _LAYOUTS)
    begin = count * (20 + 8 * received)
    try:
        # Checked before memory is allocated: the frame's header has its length.
        packed = memoryview(data)[_HEAD:]
        stored = bool(data[1] & _STORED)
        content = len(packed) if stored else zstandard.frame_content_size(packed)
        if max(content, size) > MAX_CONTENT_BYTES:
            raise CorruptMessage(f"a block says that it holds {max(content, size)} bytes: too many")
        length = content - begin
        fits = length <= most_bytes(size) if coded else length == size
        if min(count, size, length) < 0 or not fits:
            raise CorruptMessage(f"a block does not hold {count} messages of {size} bytes")
        view = packed if stored else memoryview(_mine.decompressor.decompress(packed))
    except zstandard.ZstdError as exc:
        raise CorruptMessage(f"a block cannot be unpacked: {exc}") from exc
    times, seqs = np.add.accumulate(_numbers(view, 0, 2, count, _I8), axis=1)
    sizes = _numbers(view, 16 * count, 1, count, _U4)[0].astype(np.int64)
    if int(np.add.reduce(sizes)) != size:
        raise CorruptMessage(f"the messages of a block have {int(sizes.sum())} bytes, not {size}")
    arrivals = times + _numbers(view, 20 * count, 1, count, _I8)[0] if received else None
    if coded:
        return Unpacked(times, seqs, sizes, arrivals, *_decode(view[begin:], sizes, coded))
    return Unpacked(times, seqs, sizes, arrivals, view[begin:])


def _decode(body: memoryview, sizes: Longs, coded: int) -> Tuple[memoryview, FrozenSet[int]]:
    """Return the messages, and the sizes with many messages that are not planes but plain."""
    ordered = np.sort(sizes)
    short = int(np.searchsorted(ordered, LONG)) if coded & _WORDS else len(ordered)
    words = ordered[short:].tolist()
    as_rows: Set[int] = set(words)
    parts: List[BytesLike] = []
    done = 0
    for begin, end in _many(ordered[:short]) if coded & _LAYOUTS else ():
        size, between = int(ordered[begin]), int(ordered[done:begin].sum())
        laid = read_layout(body[between:], size, end - begin)
        if not laid.as_planes:
            as_rows.add(size)
        parts += body[:between], laid.data
        body, done = body[between + laid.length :], end
    rest = int(ordered[done:short].sum())
    parts += body[:rest], decode_words(body[rest:], words) if words else b""
    if not words and len(body) != rest:
        raise CorruptMessage(f"a block holds {len(body)} bytes where {rest} belong")
    found = [part for part in parts if len(part)]
    return memoryview(found[0] if len(found) == 1 else b"".join(found)), frozenset(as_rows)


def _members(sizes: Longs) -> List[Longs]:
    """Return the positions of the messages of each size, the smallest first."""
    if len(sizes) and (sizes == sizes[0]).all():
        return [np.arange(len(sizes))]
    order = np.argsort(sizes, kind="stable")
    ends = np.flatnonzero(np.diff(sizes[order])) + 1
    return np.split(order, ends) if len(sizes) else []


def _as_planes(count: int) -> bool:
    return count >= MIN_PLANES


def _differences(values: Longs) -> Longs:
    # The first value is a difference from 0. Sums and differences wrap in the same way.
    return np.diff(values, prepend=np.int64(0))


def _planes(values: NDArray[np.generic]) -> bytes:
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return _turn(np.ascontiguousarray(little).view(np.uint8).reshape(len(values), -1))


def _turn(matrix: Bytes) -> bytes:
    """Return the bytes of a matrix column by column."""
    # tobytes alone would go byte by byte, at a third of the speed.
    return np.ascontiguousarray(matrix.T).tobytes()


def _numbers(
    view: memoryview, at: int, columns: int, count: int, kind: np.dtype[np.generic]
) -> Longs:
    """Return columns of numbers that are stored one after the other: (columns, count)."""
    planes: Bytes = np.ndarray((columns, kind.itemsize, count), np.uint8, view, at)
    turned: Any = planes.transpose(0, 2, 1).copy()
    found: Longs = turned.view(kind).reshape(columns, count)
    return found


class _PerThread(threading.local):
    """zstd objects of a thread; two threads must not use one at the same time."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.quick = zstandard.ZstdCompressor(level=QUICK_LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_mine = _PerThread()


def _cost(data: bytes) -> int:
    return len(_mine.compressor.compress(data))
