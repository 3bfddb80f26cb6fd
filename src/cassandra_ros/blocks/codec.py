# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bytes of a block: many serialised messages, laid out so that they compress.

Behind a byte for the version and one for flags stands a zstd frame. In it come, each as planes
(all first bytes, all second bytes, …, little-endian): the differences of the key times, of the
``_seq``, the sizes, and where flag 1 is set the times of reception less the key times. Then come
the messages, those of equal size together, the smallest first, each group in the order of the
block; a group of at least 16 as planes too: what changes little from message to message lies side
by side, and a field at a fixed offset is some whole rows of a matrix. Where flag 2 is set, those of
at least 512 bytes, which are the last, are coded as words instead (words.py): scans take half.
Where flag 4 is set, each group of at least 16 that is not says how it is laid out (layouts.py).
Where flag 8 is set, there is no frame: all of it stands as it is, for zstd would save nothing.
"""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from cassandra_ros.blocks.layouts import Part, lay_out, read_layout
from cassandra_ros.blocks.words import code_words, decode_words, most_bytes
from cassandra_ros.errors import CorruptMessage

Longs = NDArray[np.int64]
Bytes = NDArray[np.uint8]

VERSION = 1
LEVEL = 1
"""Of zstd: higher ones take more time than the store."""
QUICK_LEVEL = -10
"""For what hardly compresses, as random numbers do: a third of the time, and as few bytes."""
HARDLY = 0.6
"""What a sample of that comes to, compressed, as part of it; of robots' data 0.05 to 0.3."""
SAMPLE, STRETCHES = 16 * 1024, 4
"""Bytes that are looked at, and in how many pieces; of blocks of four times as many or more."""
MIN_PLANES = 16
"""Fewer messages of a size stand as they are: text is not torn apart for nothing."""
FEW_SHARE = 64
"""Where less than one in so many messages is wanted, each is cut out by itself."""
LONG = 512
"""Bytes of a message that may be full of measured numbers."""
_RECEIVED, _WORDS, _LAYOUTS, _STORED = 1, 2, 4, 8
_KNOWN = _RECEIVED | _WORDS | _LAYOUTS | _STORED
_HEAD = 2
_I8, _U4 = np.dtype("<i8"), np.dtype("<u4")


class Group(NamedTuple):
    """The messages of a block that have the same size."""

    size: int
    members: Longs
    """Their positions in the block, ascending."""
    planes: Bytes
    """(size, members): row k holds byte k of every message."""


class Unpacked:
    """The messages of a block, in the order (time, ``_seq``).

    Attributes:
        times: Key times, ns.
        seqs: ``_seq`` of each.
        sizes: Serialised bytes of each.
        received: Times of reception, ns; None where those are the key times.
        groups: The messages by their size, the smallest first.
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
        # Sizes of which the messages stand one behind the other, however many they are.
        self._body, self._as_rows = body, as_rows

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def groups(self) -> Tuple[Group, ...]:
        """The messages by their size; no bytes are copied."""
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
        """All messages, those of a group one behind the other, and where each begins."""
        parts = [_turn(group.planes) for group in self.groups]
        starts, at = np.empty(len(self), np.int64), 0
        for (size, members, _), part in zip(self.groups, parts):
            starts[members] = np.arange(at, at + len(part), size) if size else at
            at += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts), starts

    def wire(self, position: int) -> bytes:
        """Return one message, serialised."""
        # To look at the others, too, would be most of the work.
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
        seqs: ``_seq`` of each.
        wires: Their serialised bytes.
        received: Times of reception, ns, where those are not the key times.
    """
    t = np.array(times, np.int64)
    sizes = np.fromiter(map(len, wires), np.int64, len(wires))
    parts: List[Part] = []
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


def _finished(flags: int, parts: Sequence[Part], messages: int) -> bytes:
    """Return a block, compressed as a sample of it says."""
    # What is stored as it is, is copied no more.
    stored = b"".join([bytes((VERSION, flags | _STORED)), *parts])
    body = memoryview(stored)[_HEAD:]
    if len(body) >= 4 * SAMPLE:
        step = len(body) // STRETCHES
        starts = range(step // 2, len(body), step)
        sample = b"".join([body[at : at + SAMPLE // STRETCHES] for at in starts])
        if _cost(sample) > HARDLY * len(sample):
            # Of small messages the differences of times and the like are worth a frame.
            long = len(body) > LONG * messages
            if long and len(_mine.quick.compress(sample)) >= len(sample):
                return stored
            return bytes((VERSION, flags)) + _mine.quick.compress(body)
    return bytes((VERSION, flags)) + _compressor().compress(body)


def _many(sizes: Longs) -> List[Tuple[int, int]]:
    """Return of sizes that ascend from where to where many are the same, and not 0."""
    if not len(sizes):
        return []
    ends = np.append(np.flatnonzero(np.diff(sizes)) + 1, len(sizes))
    begins = np.append(0, ends[:-1])
    many = (ends - begins >= MIN_PLANES) & (sizes[begins] > 0)
    return list(zip(begins[many].tolist(), ends[many].tolist()))


def unpack_block(data: bytes, count: int, size: int) -> Unpacked:
    """Unpack a block.

    Args:
        data: What pack_block gave.
        count: How many messages it holds, as its row says.
        size: Their serialised bytes together, as its row says.

    Raises:
        CorruptMessage: The bytes are no such block.
    """
    if len(data) < _HEAD or data[0] != VERSION or data[1] & ~_KNOWN:
        raise CorruptMessage(f"a block of {len(data)} bytes is of no version that is known here")
    received, coded = bool(data[1] & _RECEIVED), data[1] & (_WORDS | _LAYOUTS)
    begin = count * (20 + 8 * received)
    try:
        # Before anything is made room for: the frame itself says how long it is.
        packed = memoryview(data)[_HEAD:]
        stored = bool(data[1] & _STORED)
        length = (len(packed) if stored else zstandard.frame_content_size(packed)) - begin
        fits = length <= most_bytes(size) if coded else length == size
        if min(count, size, length) < 0 or not fits:
            raise CorruptMessage(f"a block does not hold {count} messages of {size} bytes")
        view = packed if stored else memoryview(_decompressor().decompress(packed))
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
    """Return messages as planes or as they stand, and the sizes of which many stand as they are."""
    ordered = np.sort(sizes)
    short = int(np.searchsorted(ordered, LONG)) if coded & _WORDS else len(ordered)
    words = ordered[short:].tolist()
    as_rows: Set[int] = set(words)
    parts: List[Part] = []
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
    # The first one from 0. Sums and differences wrap in the same way.
    return np.diff(values, prepend=np.int64(0))


def _planes(values: NDArray[np.generic]) -> bytes:
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return _turn(np.ascontiguousarray(little).view(np.uint8).reshape(len(values), -1))


def _turn(matrix: Bytes) -> bytes:
    """Return the bytes of a matrix column by column."""
    # Turned first: tobytes alone would go through it byte by byte, at a third of the speed.
    return np.ascontiguousarray(matrix.T).tobytes()


def _numbers(
    view: memoryview, at: int, columns: int, count: int, kind: np.dtype[np.generic]
) -> Longs:
    """Return columns of numbers that lie one behind the other: (columns, count)."""
    planes: Bytes = np.ndarray((columns, kind.itemsize, count), np.uint8, view, at)
    turned: Any = planes.transpose(0, 2, 1).copy()
    found: Longs = turned.view(kind).reshape(columns, count)
    return found


class _PerThread(threading.local):
    """What zstd works with; none of it may be used by two threads at once."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.quick = zstandard.ZstdCompressor(level=QUICK_LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_mine = _PerThread()


def _cost(data: bytes) -> int:
    return len(_compressor().compress(data))


def _compressor() -> zstandard.ZstdCompressor:
    return _mine.compressor


def _decompressor() -> zstandard.ZstdDecompressor:
    return _mine.decompressor
