# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bytes of a block: many serialised messages, arranged so that they compress well.

The first byte is the version, the second one the flags; a zstd frame follows. It holds, each as
planes (all first bytes, all second bytes, …, little-endian): the differences of the key times,
those of ``_seq``, the sizes, and with flag 1 the receive times minus the key times. The messages
follow in groups of equal size, the smallest first, each group in the order of the block. With
flag 2 messages of at least 512 bytes, which are the last, are coded as words instead: scans take
half the bytes. Each other group of at least 16 messages has its own layout; smaller ones are plain,
one message after the other. With flag 4 there is no frame, because zstd would save nothing.

**Layouts**, chosen for each group by a sample. The first byte of a group is its layout:

- Planes: bytes that change little from message to message are side by side, and a field at a fixed
  offset is some whole rows of a matrix. A plane that rises in equal steps, as counters and stamps
  do, is stored as the differences of its bytes. One bit for each plane follows the layout: stored
  as differences.
- Columns of 8 bytes, cut from the ends of the messages. A ``float64`` of a sensor with a few
  thousand different values then repeats as a whole, while in planes each of its eight bytes repeats
  alone.
- Rows: plain, one after the other. For long messages that planes would hardly make smaller, such as
  random ``float32``: turning them and back would take half the time of storing them.

**Words** of 4 bytes, for long messages full of measured ``float32``. A sensor counts millimetres or
steps of its converter, and its driver writes 1.234 or 812.0. As bytes such numbers look random; as
the integers 1234 and 812 they differ little from their neighbours. Messages are cut into words from
their ends, because the name of a frame, which makes their sizes odd, is at their beginnings. Each
word has a code:

- below ``_WHOLE`` it is the word itself: a length, a zero;
- ``_WHOLE``: a ``float32`` that is a whole number;
- ``_SCALED``: a ``float32`` that is a whole number divided by the scale of the block;
- ``_OTHER``: any other word.

A number is stored as an integer only if the division gives back each of its bits. The bytes are:
the scale; of each message the bytes before its first word; the codes; then of whole, scaled and
other words in turn the values as planes. Whole and scaled words are stored as differences from one
to the next, with the sign in the lowest bit.
"""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any, Callable, Mapping, NamedTuple, Sequence, Union

import numpy as np
import zstandard
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage

Bytes = NDArray[np.uint8]
BytesLike = Union[bytes, memoryview]
Mask = NDArray[np.bool_]

MAX_CONTENT_BYTES = 16 * 1024 * 1024
"""Maximum size of what a block says that it holds, packed and serialised, bytes. A larger one was
changed; blocks that this package writes have at most a thirtieth of it."""
_PLANES, _COLUMNS, _ROWS = 0, 1, 2
"""Layouts of a group: its first byte."""
_UNIT = 8
"""Number of bytes that layout columns keeps together."""
_SAMPLE_BYTES = 16 * 1024
"""Approximate size of the sample that decides the layout of a group, bytes."""
_SAMPLE_SHARE = 2
"""The sample is at most one in this number of messages of a group."""
_MIN_SAMPLE_WIRES = 16
"""Minimum number of messages in a sample."""
_UNSAMPLED_BYTES = 4 * 1024
"""Size of a group in bytes below which it is always planes: a sample would cost more than it
saves."""
_COLUMNS_RATIO = 0.97
"""Ratio of bytes below which columns are preferred to planes. Fields are read faster from
planes."""
_MIN_ROW_BYTES = 1024
"""Minimum size of a message that may be stored as rows, bytes."""
_PLANES_SAMPLE_PARTS = 4
"""Number of parts of such a message of which planes are tried."""
_PLANES_RATIO = 0.8
"""Ratio of compressed to plain bytes above which planes of such messages are not worth their
time."""


class LaidGroup(NamedTuple):
    """A group that was read."""

    data: BytesLike
    """Its planes, or its messages one after the other."""
    as_planes: bool
    length: int
    """Number of bytes that the group takes in the block."""
    rises: Mask | None = None
    """Which planes are stored as differences; None = no plane is."""


def lay_out(wires: Sequence[bytes], cost: Callable[[bytes], int]) -> Sequence[BytesLike]:
    """Return the layout of at least one message of at least one byte, as parts to be joined.

    Args:
        wires: Messages of equal size.
        cost: Returns the compressed size of some bytes.

    Returns:
        Parts, so that the plain messages of layout rows are not copied.
    """
    count, size = len(wires), len(wires[0])
    few = max(_MIN_SAMPLE_WIRES, min(count // _SAMPLE_SHARE, _SAMPLE_BYTES // size))
    if size >= _MIN_ROW_BYTES and _saves_little(_rows(wires[:few]), cost):
        return bytes((_ROWS,)), *wires
    rows = _rows(wires)
    if rows.nbytes < _UNSAMPLED_BYTES:
        # Zeros: layout planes, and no plane is stored as differences.
        return bytes(1 + (size + 7) // 8), np.ascontiguousarray(rows.T).tobytes()
    sample = rows[:few]
    # Differences pay for a byte whose step repeats more often than the byte itself.
    steps = np.diff(sample, axis=0)
    repeats = _counts(steps == 0)
    rises = _counts(steps[1:] == steps[:-1]) > repeats
    if size >= _UNIT:
        # For long messages only the ends are tried: trying all would cost more than packing.
        tried = slice(-max(_UNIT, _SAMPLE_BYTES // len(sample) // _UNIT * _UNIT), None)
        ends = sample[:, tried]
        planes, rising = np.array(ends.T, order="C"), rises[tried]
        planes[rising, 1:] = steps[:, tried].T[rising]
        if cost(_columns(ends)) < _COLUMNS_RATIO * cost(planes.tobytes()):
            return bytes((_COLUMNS,)), _columns(rows)
    planes = np.array(rows.T, order="C")  # always a copy: rows of one byte are planes already
    if rises.any():
        planes[rises, 1:] = np.diff(planes[rises], axis=1)
    return bytes((_PLANES,)), np.packbits(rises).tobytes(), planes.reshape(-1).data


def _rows(wires: Sequence[bytes]) -> Bytes:
    """Return messages of equal size as the rows of a matrix."""
    return np.frombuffer(b"".join(wires), np.uint8).reshape(len(wires), -1)


def read_layout(data: memoryview, size: int, count: int) -> LaidGroup:
    """Read the group at the beginning of some bytes.

    Raises:
        CorruptMessage: The bytes do not hold such a group.
    """
    kind = data[0] if len(data) else -1
    begin = 1 + (size + 7) // 8 if kind == _PLANES else 1
    end = begin + size * count
    if kind not in (_PLANES, _COLUMNS, _ROWS) or len(data) < end:
        raise CorruptMessage(f"a block does not hold {count} messages of {size} bytes as it says")
    if kind == _ROWS:
        return LaidGroup(data[begin:end], False, end)
    if kind == _COLUMNS:
        return LaidGroup(_from_columns(data[begin:end], size, count), False, end)
    rises = np.unpackbits(np.frombuffer(data, np.uint8, begin - 1, 1))[:size].astype(np.bool_)
    return LaidGroup(data[begin:end], True, end, rises if rises.any() else None)


def _saves_little(sample: Bytes, cost: Callable[[bytes], int]) -> bool:
    """Return whether planes of some messages hardly compress."""
    count, size = sample.shape
    width = min(size, _SAMPLE_BYTES // count) // _PLANES_SAMPLE_PARTS
    begins = range(0, size - width + 1, (size - width) // (_PLANES_SAMPLE_PARTS - 1))
    parts = np.concatenate([sample[:, begin : begin + width] for begin in begins], axis=1)
    return bool(cost(np.ascontiguousarray(parts.T).tobytes()) > _PLANES_RATIO * parts.size)


def _counts(mask: Mask) -> NDArray[np.int32]:
    """Return the number of true values in each column of a matrix."""
    # Row by row: numpy would go along columns one byte at a time.
    counts: NDArray[np.int32] = np.add.reduce(mask, axis=0, dtype=np.int32)
    return counts


def _columns(rows: Bytes) -> bytes:
    """Return messages, the rows of a matrix, in layout columns."""
    loose = rows.shape[1] % _UNIT  # bytes before the first column
    units = np.ascontiguousarray(rows[:, loose:]).view("<u8")
    return np.ascontiguousarray(rows[:, :loose].T).tobytes() + units.T.tobytes()


def _from_columns(data: memoryview, size: int, count: int) -> bytes:
    """Return the messages of layout columns, one after the other."""
    loose = size % _UNIT
    rows = np.empty((count, size), np.uint8)
    rows[:, :loose] = np.frombuffer(data, np.uint8, loose * count).reshape(loose, count).T
    units = np.frombuffer(data, "<u8", size // _UNIT * count, loose * count)
    turned = np.ascontiguousarray(units.reshape(-1, count).T)
    rows[:, loose:] = turned.view(np.uint8).reshape(count, size - loose)
    return rows.tobytes()


Words = NDArray[np.uint32]
Integers = NDArray[np.int32]

_WORD = np.dtype("<u4")
_WHOLE, _SCALED, _OTHER = 253, 254, 255
"""Codes of words; a smaller code is the word itself."""
_SCALES = (1000, 4000, 10_000)
"""Scales of values measured in millimetres, quarters of a millimetre and tenths."""
_SHIFTS = tuple(np.uint32(shift) for shift in (0, 8, 16, 24))
_WORDS_SAMPLE = 1024
"""Approximate number of words in the sample that is tried first."""
_WORDS_SAMPLE_WIRES = 16
"""Maximum number of messages of which this sample is taken."""


def code_words(wires: Sequence[bytes]) -> bytes | None:
    """Code serialised messages as words; None if most of their larger words are no such numbers."""
    scale = _find_scale(_words(wires[:: -(-len(wires) // _WORDS_SAMPLE_WIRES)]))
    if scale is None:
        return None
    words = _words(wires)
    codes = words.astype(np.uint8)
    large = np.flatnonzero(words >= _WHOLE)
    rest = words[large]
    whole, is_whole = _as_integers(rest, 1)
    scaled, is_scaled = _as_integers(rest, scale)
    kinds = np.full(len(rest), _OTHER, np.uint8)
    kinds[is_scaled] = _SCALED
    kinds[is_whole] = _WHOLE
    codes[large] = kinds
    loose = [wire[: len(wire) & 3] for wire in wires]  # the bytes before the first word
    parts = [scale.to_bytes(4, "little"), *loose, codes.tobytes()]
    for values, kind in ((whole, _WHOLE), (scaled, _SCALED)):
        steps = np.diff(values[np.flatnonzero(kinds == kind)], prepend=np.int32(0))
        # Zigzag: 0, -1, 1, -2, … become 0, 1, 2, 3, …
        parts.append(_word_planes((steps << 1 ^ steps >> 31).view(_WORD)))
    parts.append(_word_planes(rest[np.flatnonzero(kinds == _OTHER)]))
    return b"".join(parts)


def most_bytes(size: int) -> int:
    """Return the maximum length of the code of ``size`` bytes of messages, in any layout."""
    return 4 + size + size // 4


def decode_words(data: memoryview, sizes: Sequence[int]) -> bytes:
    """Return the messages, one after the other.

    Args:
        data: Result of code_words.
        sizes: Number of bytes of each message.

    Raises:
        CorruptMessage: The bytes do not hold such messages.
    """
    scale = int.from_bytes(data[:4], "little")
    loose, count = sum(size & 3 for size in sizes), sum(size >> 2 for size in sizes)
    at = 4 + loose
    codes = np.frombuffer(data, np.uint8)[at : at + count]
    positions = [np.flatnonzero(codes == kind) for kind in (_WHOLE, _SCALED, _OTHER)]
    if not scale or len(data) != at + count + 4 * sum(map(len, positions)):
        raise CorruptMessage("the words of a block are not as many as its messages have")
    words = codes.astype(_WORD)
    at += count
    for indices, by in zip(positions, (1, scale, None)):
        values = _words_of_planes(data, at, len(indices))
        at += 4 * len(indices)
        words[indices] = values if by is None else _as_floats(values, by)
    return _join_words(words.tobytes(), data[4 : 4 + loose], sizes)


def _words(wires: Sequence[bytes]) -> Words:
    """Return all words of messages, cut from the end of each message."""
    return np.frombuffer(b"".join([wire[len(wire) & 3 :] for wire in wires]), _WORD)


def _find_scale(words: Words) -> int | None:
    """Return the divisor of most of the larger words; None if there is no such divisor."""
    step = len(words) // _WORDS_SAMPLE | 1  # odd, because lengths and numbers may take turns
    sample = words[::step]
    sample = sample[sample >= _WHOLE]
    is_whole = _as_integers(sample, 1)[1]
    for scale in _SCALES:
        if 2 * np.count_nonzero(is_whole | _as_integers(sample, scale)[1]) > len(sample):
            return scale
    return None


def _as_integers(words: Words, scale: int) -> tuple[Integers, Mask]:
    """Return words as integers, and for which of them the integer is exact."""
    # A word that is not a number, or too large for an integer, does not come back as it was.
    with np.errstate(invalid="ignore", over="ignore"):
        integers = np.rint(words.view("<f4") * np.float32(scale)).astype(np.int32)
    return integers, _divide(integers, scale) == words


def _as_floats(zigzag: Words, scale: int) -> Words:
    """Return the ``float32`` words whose integers have these differences."""
    steps = (zigzag >> 1).view(np.int32) ^ -(zigzag & 1).view(np.int32)
    return _divide(np.cumsum(steps, dtype=np.int32), scale)


def _divide(integers: Integers, scale: int) -> Words:
    """Return the ``float32`` words of integers divided by a scale."""
    # IEEE 754 defines the result of a division: every machine computes the same bits.
    return (integers.astype("<f4") / np.float32(scale)).view(_WORD)


def _word_planes(words: Words) -> bytes:
    # Four passes over vectors are twice as fast as turning a matrix of four columns.
    return b"".join([(words >> shift).astype(np.uint8).tobytes() for shift in _SHIFTS])


def _words_of_planes(data: memoryview, at: int, count: int) -> Words:
    """Return the words whose planes begin at an offset."""
    words = np.zeros(count, _WORD)
    planes = np.frombuffer(data, np.uint8, 4 * count, at).reshape(4, count)
    for plane, shift in zip(planes, _SHIFTS):
        if plane.any():
            words |= plane.astype(np.uint32) << shift
    return words


def _join_words(words: bytes, loose: memoryview, sizes: Sequence[int]) -> bytes:
    """Put the bytes of each message that are not words before its words."""
    if not loose:
        return words
    parts: list[bytes] = []
    at = begin = 0
    for size in sizes:
        parts.append(bytes(loose[at : at + (size & 3)]))
        parts.append(words[begin : begin + (size & ~3)])
        at, begin = at + (size & 3), begin + (size & ~3)
    return b"".join(parts)


Longs = NDArray[np.int64]

VERSION = 1
"""Version of the blocks that this release writes, and the only one that it reads."""
LEVEL = 1
"""Level of zstd. Higher ones take more time than storing the bytes."""
QUICK_LEVEL = -10
"""Level of zstd for data that hardly compress, such as random numbers: as many bytes in a third of
the time."""
_QUICK_RATIO = 0.6
"""Ratio of compressed to plain bytes of a sample above which data hardly compress. Data of robots
have 0.05 to 0.3."""
_LEVEL_SAMPLE_BYTES = 16 * 1024
"""Size of the sample by which the level is chosen, bytes. Taken from blocks of at least four times
this size."""
_LEVEL_SAMPLE_PARTS = 4
"""Number of parts of this sample, spread over the block."""
MIN_PLANES = 16
"""Minimum number of messages of one size that are stored as planes. Fewer are stored plain, because
planes would only tear texts apart."""
SINGLE_CUT_RATIO = 64
"""Ratio of a block's messages to the read ones above which each is cut out by itself."""
LONG = 512
"""Minimum size of messages that may be coded as words, bytes."""
_RECEIVED, _WORDS, _STORED = 1, 2, 4
"""Flags of a block."""
_ALL_FLAGS = _RECEIVED | _WORDS | _STORED
_HEAD = 2
"""Number of bytes before the frame: version and flags."""
_I8, _U4 = np.dtype("<i8"), np.dtype("<u4")


class Group(NamedTuple):
    """The messages of a block that have the same size."""

    size: int
    members: Longs
    """Positions of the messages in the block, ascending."""
    stored: Bytes
    """Matrix (size, members): row k holds byte k of every message, or differences of them."""
    rises: Mask | None
    """Which rows are stored as differences; None = no row is."""

    @property
    def planes(self) -> Bytes:
        """The matrix without differences."""
        if self.rises is None:
            return self.stored
        planes: Bytes = self.stored.copy()
        planes[self.rises] = np.add.accumulate(planes[self.rises], axis=1, dtype=np.uint8)
        return planes


class Unpacked:
    """The messages of a block, in the order (time, ``_seq``).

    Attributes:
        times: Key times, ns.
        seqs: ``_seq`` of each message.
        sizes: Number of serialised bytes of each message.
        received: Receive times, ns; None = they equal the key times.
        groups: The messages by size, the smallest first.

    Args:
        body, as_rows, rises: Result of ``_decode``.
    """

    def __init__(
        self,
        times: Longs,
        seqs: Longs,
        sizes: Longs,
        received: Longs | None,
        body: memoryview,
        as_rows: frozenset[int],
        rises: Mapping[int, Mask],
    ) -> None:
        self.times, self.seqs, self.sizes, self.received = times, seqs, sizes, received
        self._body, self._as_rows, self._rises = body, as_rows, rises

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The messages by size, the smallest first; no bytes are copied."""
        groups: list[Group] = []
        at = 0
        for members in members_by_size(self.sizes):
            size, count = int(self.sizes[members[0]]), len(members)
            flat = np.frombuffer(self._body, np.uint8, size * count, at)
            at += size * count
            as_planes = _as_planes(count) and size not in self._as_rows
            planes = flat.reshape(size, count) if as_planes else flat.reshape(count, size).T
            groups.append(Group(size, members, planes, self._rises.get(size)))
        return tuple(groups)

    @cached_property
    def _messages_by_size(self) -> tuple[bytes, Longs]:
        """All messages, those of a group one after the other, and the offset of each."""
        parts = [_transposed(group.planes) for group in self.groups]
        starts, at = np.empty(len(self), np.int64), 0
        for (size, members, *_), data in zip(self.groups, parts):
            starts[members] = np.arange(at, at + len(data), size) if size else at
            at += len(data)
        return parts[0] if len(parts) == 1 else b"".join(parts), starts

    def wire(self, position: int) -> bytes:
        """Return one message, serialised."""
        # Without ``groups``: making the other ones would be most of the work.
        size, alike = int(self.sizes[position]), self.sizes == self.sizes[position]
        count, place = np.count_nonzero(alike), np.count_nonzero(alike[:position])
        at = int(self.sizes[self.sizes < size].sum())  # where the group begins
        if size in self._rises:
            stored = np.frombuffer(self._body, np.uint8, size * count, at).reshape(size, count)
            head, rises = stored[:, : place + 1], self._rises[size]
            message = head[:, -1].copy()
            message[rises] = np.add.reduce(head[rises], axis=1, dtype=np.uint8)
            return message.tobytes()
        if not _as_planes(count) or size in self._as_rows:
            return bytes(self._body[at + place * size : at + (place + 1) * size])
        return bytes(self._body[at + place : at + size * count : count])

    def wires(self, positions: Longs | None = None) -> list[bytes]:
        """Return messages, serialised: those at some positions, None = all."""
        # One group of rows is cut as it lies there.
        size = len(self._body) // max(1, len(self))
        if positions is None and size >= LONG and size in self._as_rows and len(self.groups) == 1:
            return [bytes(self._body[at : at + size]) for at in range(0, len(self._body), size)]
        is_turned = "_messages_by_size" in self.__dict__  # an earlier call has computed it
        if (
            positions is not None
            and not is_turned
            and SINGLE_CUT_RATIO * len(positions) < len(self)
        ):
            return [self.wire(position) for position in positions.tolist()]
        messages, starts = self._messages_by_size
        ends = starts + self.sizes
        if positions is not None:
            starts, ends = starts[positions], ends[positions]
        return [messages[start:end] for start, end in zip(starts.tolist(), ends.tolist())]


def pack_block(
    times: Sequence[int],
    seqs: Sequence[int],
    wires: Sequence[bytes],
    received: Sequence[int] | None = None,
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
    parts: list[BytesLike] = []
    parts += _planes(_differences(t)), _planes(_differences(np.array(seqs, np.int64)))
    parts.append(_planes(sizes.astype("<u4")))
    if received is not None:
        parts.append(_planes(np.array(received, np.int64) - t))
    if (sizes != sizes[:1]).any():
        order = np.argsort(sizes, kind="stable")
        wires, sizes = [wires[n] for n in order.tolist()], sizes[order]
    first_long = int(np.searchsorted(sizes, LONG))
    words = code_words(wires[first_long:]) if first_long < len(wires) else None
    if words is not None:
        wires, sizes = wires[:first_long], sizes[:first_long]
    flags = (_RECEIVED if received is not None else 0) | (_WORDS if words is not None else 0)
    start = 0
    for begin, end in _many(sizes):
        parts += [*wires[start:begin], *lay_out(wires[begin:end], _cost)]
        start = end
    parts += [*wires[start:], words or b""]
    return _finish(flags, parts, len(t))


def _finish(flags: int, parts: Sequence[BytesLike], messages: int) -> bytes:
    """Return the bytes of a block, compressed at the level that a sample suggests, or plain.

    Args:
        parts: What the frame holds, to be joined.
        messages: Number of messages.
    """
    # If the bytes are stored plain they are not copied again.
    stored = b"".join([bytes((VERSION, flags | _STORED)), *parts])
    body = memoryview(stored)[_HEAD:]
    if len(body) >= 4 * _LEVEL_SAMPLE_BYTES:
        step = len(body) // _LEVEL_SAMPLE_PARTS
        starts = range(step // 2, len(body), step)
        length = _LEVEL_SAMPLE_BYTES // _LEVEL_SAMPLE_PARTS
        sample = b"".join([body[at : at + length] for at in starts])
        if _cost(sample) > _QUICK_RATIO * len(sample):
            # For small messages a frame already pays for the differences of times.
            long = len(body) > LONG * messages
            if long and len(_zstd.quick.compress(sample)) >= len(sample):
                return stored
            return bytes((VERSION, flags)) + _zstd.quick.compress(body)
    return bytes((VERSION, flags)) + _zstd.compressor.compress(body)


def _many(sizes: Longs) -> list[tuple[int, int]]:
    """Return the ranges [begin, end) of ascending sizes in which many have one size other than 0.

    These are the groups that have a layout.
    """
    if not len(sizes):
        return []
    if sizes[0] == sizes[-1]:
        return [(0, len(sizes))] if len(sizes) >= MIN_PLANES and sizes[0] > 0 else []
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
        CorruptMessage: The bytes are not such a block, or one of another version.
    """
    if data and data[0] != VERSION:
        raise CorruptMessage(
            f"a block has version {data[0]}, and this release of cassandra_ros reads only version "
            f"{VERSION}: if another release wrote it, export the topic with that one"
        )
    if len(data) < _HEAD or data[1] & ~_ALL_FLAGS:
        raise CorruptMessage(f"a block of {len(data)} bytes has no flags, or unknown ones")
    received, words = bool(data[1] & _RECEIVED), bool(data[1] & _WORDS)
    begin = count * (20 + 8 * received)  # of the messages: times, seqs and sizes have 8 + 8 + 4
    try:
        # Checked before memory is allocated: the frame's header has its length.
        packed = memoryview(data)[_HEAD:]
        stored = bool(data[1] & _STORED)
        content = len(packed) if stored else zstandard.frame_content_size(packed)
        if max(content, size) > MAX_CONTENT_BYTES:
            raise CorruptMessage(f"a block says that it holds {max(content, size)} bytes: too many")
        length = content - begin
        if min(count, size, length) < 0 or length > most_bytes(size):
            raise CorruptMessage(f"a block does not hold {count} messages of {size} bytes")
        view = packed if stored else memoryview(_zstd.decompressor.decompress(packed))
    except zstandard.ZstdError as exc:
        raise CorruptMessage(f"a block cannot be unpacked: {exc}") from exc
    times, seqs = np.add.accumulate(_numbers(view, 0, 2, count, _I8), axis=1)
    sizes = _numbers(view, 16 * count, 1, count, _U4)[0].astype(np.int64)
    if int(np.add.reduce(sizes)) != size:
        raise CorruptMessage(f"the messages of a block have {int(sizes.sum())} bytes, not {size}")
    arrivals = times + _numbers(view, 20 * count, 1, count, _I8)[0] if received else None
    return Unpacked(times, seqs, sizes, arrivals, *_decode(view[begin:], sizes, words))


def _decode(
    body: memoryview, sizes: Longs, has_words: bool
) -> tuple[memoryview, frozenset[int], Mapping[int, Mask]]:
    """Return the messages of a block by ascending size, without layouts and words.

    Returns:
        Their bytes: each group is planes, or one message after the other.
        Sizes whose messages lie one after the other, however many there are.
        Size → which planes of its group are stored as differences, if any are.
    """
    lengths = np.sort(sizes)
    first_word = int(np.searchsorted(lengths, LONG)) if has_words else len(lengths)
    words = lengths[first_word:].tolist()
    as_rows: set[int] = set(words)
    rises: dict[int, Mask] = {}
    parts: list[BytesLike] = []
    start = 0
    for begin, end in _many(lengths[:first_word]):
        size, between = int(lengths[begin]), int(lengths[start:begin].sum())
        laid = read_layout(body[between:], size, end - begin)
        if not laid.as_planes:
            as_rows.add(size)
        if laid.rises is not None:
            rises[size] = laid.rises
        parts += body[:between], laid.data
        body, start = body[between + laid.length :], end
    rest = int(lengths[start:first_word].sum())
    parts += body[:rest], decode_words(body[rest:], words) if words else b""
    if not words and len(body) != rest:
        raise CorruptMessage(f"a block holds {len(body)} bytes where {rest} belong")
    chunks = [chunk for chunk in parts if len(chunk)]
    messages = memoryview(chunks[0] if len(chunks) == 1 else b"".join(chunks))
    return messages, frozenset(as_rows), rises


def members_by_size(sizes: Longs) -> list[Longs]:
    """Return the positions of the messages of each size, the smallest first."""
    if len(sizes) and (sizes == sizes[0]).all():
        return [np.arange(len(sizes))]
    order = np.argsort(sizes, kind="stable")
    ends = np.flatnonzero(np.diff(sizes[order])) + 1
    return np.split(order, ends) if len(sizes) else []


def _as_planes(count: int) -> bool:
    """Return whether a group of this number of messages has a layout."""
    return count >= MIN_PLANES


def _differences(values: Longs) -> Longs:
    # The first value is a difference from 0. Sums and differences wrap in the same way.
    return np.diff(values, prepend=np.int64(0))


def _planes(values: NDArray[np.generic]) -> bytes:
    """Return numbers as planes: all lowest bytes, all second bytes, and so on."""
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return _transposed(np.ascontiguousarray(little).view(np.uint8).reshape(len(values), -1))


def _transposed(matrix: Bytes) -> bytes:
    """Return the bytes of a matrix column by column."""
    # tobytes alone would go byte by byte, at a third of the speed.
    return np.ascontiguousarray(matrix.T).tobytes()


def _numbers(
    view: memoryview, at: int, columns: int, count: int, kind: np.dtype[np.generic]
) -> Longs:
    """Return columns of numbers that are stored as planes one after the other: (columns, count)."""
    planes: Bytes = np.ndarray((columns, kind.itemsize, count), np.uint8, view, at)
    turned: Any = planes.transpose(0, 2, 1).copy()
    numbers: Longs = turned.view(kind).reshape(columns, count)
    return numbers


class _PerThread(threading.local):
    """zstd objects of a thread; two threads must not use one at the same time."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.quick = zstandard.ZstdCompressor(level=QUICK_LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_zstd = _PerThread()


def _cost(data: bytes) -> int:
    """Return the compressed size of some bytes."""
    return len(_zstd.compressor.compress(data))
