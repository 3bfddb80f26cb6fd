# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Long messages as words of 4 bytes, for messages full of measured ``float32``.

A sensor counts millimetres or steps of its converter, and its driver writes 1.234 or 812.0. As
bytes such numbers look random; as the integers 1234 and 812 they differ little from their
neighbours. Messages are cut into words from their ends, because the name of a frame, which makes
their sizes odd, is at their beginnings. Each word has a code:

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

from typing import List, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]
Integers = NDArray[np.int32]

_WORD = np.dtype("<u4")
_WHOLE, _SCALED, _OTHER = 253, 254, 255
_SCALES = (1000, 4000, 10_000)
"""Scales of values measured in millimetres, quarters of a millimetre and tenths."""
_SHIFTS = tuple(np.uint32(shift) for shift in (0, 8, 16, 24))
_SAMPLE, _WIRES = 1024, 16
"""Number of words in the sample that is tried first, and number of its messages."""


def code_words(wires: Sequence[bytes]) -> Optional[bytes]:
    """Code serialised messages; return None if most of their words are not such numbers."""
    scale = _find_scale(_words(wires[:: -(-len(wires) // _WIRES)]))
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
    loose = [wire[: len(wire) & 3] for wire in wires]
    parts = [scale.to_bytes(4, "little"), *loose, codes.tobytes()]
    for values, kind in ((whole, _WHOLE), (scaled, _SCALED)):
        steps = np.diff(values[np.flatnonzero(kinds == kind)], prepend=np.int32(0))
        parts.append(_planes((steps << 1 ^ steps >> 31).view(_WORD)))
    parts.append(_planes(rest[np.flatnonzero(kinds == _OTHER)]))
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
    places = [np.flatnonzero(codes == kind) for kind in (_WHOLE, _SCALED, _OTHER)]
    if not scale or len(data) != at + count + 4 * sum(map(len, places)):
        raise CorruptMessage("the words of a block are not as many as its messages have")
    words = codes.astype(_WORD)
    at += count
    for place, by in zip(places, (1, scale, None)):
        found = _from_planes(data, at, len(place))
        at += 4 * len(place)
        words[place] = found if by is None else _as_floats(found, by)
    return _joined(words.tobytes(), data[4 : 4 + loose], sizes)


def _words(wires: Sequence[bytes]) -> Words:
    return np.frombuffer(b"".join([wire[len(wire) & 3 :] for wire in wires]), _WORD)


def _find_scale(words: Words) -> Optional[int]:
    """Return the divisor of most of the larger words; None if there is no such divisor."""
    step = len(words) // _SAMPLE | 1  # odd, because lengths and numbers may take turns
    sample = words[::step]
    sample = sample[sample >= _WHOLE]
    is_whole = _as_integers(sample, 1)[1]
    for scale in _SCALES:
        if 2 * np.count_nonzero(is_whole | _as_integers(sample, scale)[1]) > len(sample):
            return scale
    return None


def _as_integers(words: Words, scale: int) -> Tuple[Integers, NDArray[np.bool_]]:
    """Return words as integers, and for which of them the integer is exact."""
    # A word that is not a number, or too large for an integer, does not come back as it was.
    with np.errstate(invalid="ignore", over="ignore"):
        integers = np.rint(words.view("<f4") * np.float32(scale)).astype(np.int32)
    return integers, _divided(integers, scale) == words


def _as_floats(zigzag: Words, scale: int) -> Words:
    steps = (zigzag >> 1).view(np.int32) ^ -(zigzag & 1).view(np.int32)
    return _divided(np.cumsum(steps, dtype=np.int32), scale)


def _divided(integers: Integers, scale: int) -> Words:
    # IEEE 754 defines the result of a division: every machine computes the same bits.
    return (integers.astype("<f4") / np.float32(scale)).view(_WORD)


def _planes(words: Words) -> bytes:
    # Four passes over vectors are twice as fast as turning a matrix of four columns.
    return b"".join([(words >> shift).astype(np.uint8).tobytes() for shift in _SHIFTS])


def _from_planes(data: memoryview, at: int, count: int) -> Words:
    words = np.zeros(count, _WORD)
    planes = np.frombuffer(data, np.uint8, 4 * count, at).reshape(4, count)
    for plane, shift in zip(planes, _SHIFTS):
        if plane.any():
            words |= plane.astype(np.uint32) << shift
    return words


def _joined(words: bytes, loose: memoryview, sizes: Sequence[int]) -> bytes:
    """Put the bytes of each message that are no words before its words."""
    if not loose:
        return words
    parts: List[bytes] = []
    at = begin = 0
    for size in sizes:
        parts.append(bytes(loose[at : at + (size & 3)]))
        parts.append(words[begin : begin + (size & ~3)])
        at, begin = at + (size & 3), begin + (size & ~3)
    return b"".join(parts)
