# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""CQL's encoding of lists: int32 number of elements, then int32 length and bytes of each."""

from __future__ import annotations

import struct
from itertools import chain, repeat
from typing import Any, Callable, Iterable, Sequence

from cassandra_ros.messages.wire.layout import Fixed

EMPTY_LIST = b"\0\0\0\0"
SECOND_NS = 1_000_000_000
LOW = 0xFFFFFFFF

_count = struct.Struct(">i").pack
_length = struct.Struct(">i").unpack_from


def packVarint(value: int) -> bytes:
    """Encode a value >= 0 as CQL varint: two's complement in as few bytes as hold it."""
    return value.to_bytes(value.bit_length() // 8 + 1, "big")


def packList(values: Sequence[bytes]) -> bytes:
    """Encode a list of encoded elements."""
    sizes = map(_count, map(len, values))
    return _count(len(values)) + b"".join(chain.from_iterable(zip(sizes, values)))


def splitList(raw: bytes) -> list[bytes]:
    """Return the encoded elements of a list.

    Raises:
        struct.error: It is no list.
    """
    (count,) = _length(raw, 0)
    values = []
    at = 4
    for _ in range(count):
        (size,) = _length(raw, at)
        at += 4
        end = at + size
        if size < 0 or end > len(raw):
            raise struct.error("a list column has a malformed element")
        values.append(raw[at:end])
        at = end
    if at != len(raw):
        raise struct.error("a list column has surplus bytes")
    return values


def packEqual(size: int) -> Callable[[Sequence[bytes]], bytes]:
    """Return the encoder of a list of at least one, whose encoded elements all have this size."""
    prefix = _count(size)
    return lambda values: _count(len(values)) + prefix + prefix.join(values)


def splitEqual(size: int) -> Callable[[bytes], list[bytes]]:
    """Return the inverse of packEqual; it raises struct.error."""
    encode, unit = packEqual(size), size + 4

    def split(raw: bytes) -> list[bytes]:
        if raw == EMPTY_LIST:
            return []
        values = [raw[at : at + size] for at in range(8, len(raw), unit)]
        if len(raw) % unit != 4 or encode(values) != raw:  # the last one may be cut
            raise struct.error("a list column has a malformed element")
        return values

    return split


def unpackNumbers(fixed: Fixed) -> Callable[[bytes], Sequence[Any]]:
    """Return the inverse of packNumbers: from a list to the wire codes of its elements.

    It raises struct.error and OverflowError.
    """
    if fixed.special == "uint64":
        return lambda raw: [int.from_bytes(v, "big", signed=True) for v in splitList(raw)]
    size, unpack = fixed.cql_size, struct.Struct(">i" + fixed.big).iter_unpack

    def split(raw: bytes) -> Sequence[Any]:
        (count,) = _length(raw, 0)
        if len(raw) != 4 + count * (size + 4):
            raise struct.error("a list column has a malformed element")
        if not count:
            return ()
        sizes, values = zip(*unpack(raw[4:]))
        if sizes.count(size) != count:
            raise struct.error("a list column has a malformed element")
        return values

    if fixed.special in ("time", "duration"):
        convert = nsToTime if fixed.special == "time" else nsToDuration
        return lambda raw: [convert(value) for value in split(raw)]
    return split


def packNumbers(fixed: Fixed, strict: bool) -> Callable[[Sequence[int]], bytes | None]:
    """Return the encoder of a list of fields of fixed size, read by their wire code.

    It gives None where a value cannot be held exactly and strict is set.
    """
    size = fixed.cql_size
    if fixed.special == "uint64":
        return lambda values: packList([packVarint(value) for value in values])
    pack = struct.Struct(">i" + fixed.big).pack

    def encode(values: Iterable[int], count: int) -> bytes:
        return _count(count) + b"".join(map(pack, repeat(size), values))

    if fixed.special == "bool":
        return lambda v: None if strict and max(v, default=0) > 1 else encode(v, len(v))
    if fixed.special:

        def encode_times(values: Sequence[int]) -> bytes | None:
            if strict and any(not 0 <= value >> 32 < SECOND_NS for value in values):
                return None
            return encode(map(convert, values), len(values))

        convert = timeToNs if fixed.special == "time" else durationToNs
        return encode_times
    return lambda values: encode(values, len(values))


def timeToNs(value: int) -> int:
    """Return the nanoseconds of a time read as one uint64."""
    return (value & LOW) * SECOND_NS + (value >> 32)


def durationToNs(value: int) -> int:
    """Return the nanoseconds of a duration read as one int64."""
    seconds = value & LOW
    return (seconds - ((seconds & 0x80000000) << 1)) * SECOND_NS + (value >> 32)


def nsToTime(ns: int) -> int:
    """Return the time of nanoseconds as the uint64 that lies on the wire."""
    seconds, rest = divmod(ns, SECOND_NS)
    if seconds >> 32:
        raise struct.error("a time is out of range")
    return rest << 32 | seconds


def nsToDuration(ns: int) -> int:
    """Return the duration of nanoseconds as the int64 that lies on the wire."""
    seconds, rest = divmod(ns, SECOND_NS)
    if not -0x80000000 <= seconds <= 0x7FFFFFFF:
        raise struct.error("a duration is out of range")
    return rest << 32 | (seconds & LOW)
