# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From columns back to wire bytes: the inverse of ``walk``, built the same way."""

from __future__ import annotations

import struct
from itertools import chain
from typing import Callable, Optional, Sequence, Sized, Tuple, cast

from cassandra_ros.messages.wire.layout import Fixed, Segment, Tail, cql_sizes
from cassandra_ros.messages.wire.values import (
    ns_to_duration,
    ns_to_time,
    split_equal,
    split_list,
    unpack_numbers,
)

Columns = Sequence[bytes]
"""Values in CQL's encoding; a None among them ends in TypeError."""
Head = Callable[[Columns, int], bytes]
"""(columns, length of the tail) -> bytes."""
BuildTail = Callable[[Columns], Tuple[int, bytes]]
"""Columns -> length of the field, its bytes."""
Step = Tuple[Optional[Head], Optional[BuildTail]]

BUILD_ERRORS = (struct.error, TypeError, ValueError, OverflowError, IndexError)
"""What columns that no message made can raise."""

_pack_length = struct.Struct("<I").pack


def compile_build(segments: Sequence[Segment]) -> list[Step]:
    """Return the steps that turn all columns of a type into a message."""
    steps: list[Step] = []
    first = 0
    for segment in segments:
        tail = segment.tail
        after = first + len(segment.fixed)
        head = _head(segment.fixed, first, after, tail is not None and tail.has_count)
        steps.append((head, None if tail is None else _build_tail(tail, after)))
        first = after + (len(tail.columns) if tail is not None else 0)
    return steps


def build_message(steps: Sequence[Step], columns: Sequence[bytes | None]) -> bytes:
    """Return the wire bytes of columns.

    Raises:
        struct.error, TypeError, ValueError, OverflowError, IndexError: They are no message.
    """
    parts: list[bytes] = []
    _append(steps, cast(Columns, columns), parts)
    return b"".join(parts)


def _append(steps: Sequence[Step], columns: Columns, parts: list[bytes]) -> None:
    for head, tail in steps:
        if tail is None:
            if head is not None:
                parts.append(head(columns, 0))
            continue
        count, data = tail(columns)
        if head is not None:
            parts.append(head(columns, count))
        parts.append(data)


def _head(fixed: Sequence[Fixed], first: int, after: int, has_length: bool) -> Head | None:
    if not fixed:
        return (lambda columns, count: _pack_length(count)) if has_length else None
    unpack = struct.Struct(">" + "".join(f.big for f in fixed)).unpack
    pack = struct.Struct("<" + "".join(f.little for f in fixed) + "I" * has_length).pack
    converts = {"time": ns_to_time, "duration": ns_to_duration}
    times = [(i, converts[f.special]) for i, f in enumerate(fixed) if f.special in converts]
    varints = [i for i, f in enumerate(fixed) if f.special == "uint64"]
    blobs = [(first + i, f.cql_size) for i, f in enumerate(fixed) if f.column.kind == "array"]

    def head(columns: Columns, count: int) -> bytes:
        for i, size in blobs:
            if len(columns[i]) != size:
                raise struct.error("a blob has another size than its array")
        return pack(*unpack(b"".join(columns[first:after])))

    def head_with_length(columns: Columns, count: int) -> bytes:
        for i, size in blobs:
            if len(columns[i]) != size:
                raise struct.error("a blob has another size than its array")
        return pack(*unpack(b"".join(columns[first:after])), count)

    def special_head(columns: Columns, count: int) -> bytes:
        for i, size in blobs:
            if len(columns[i]) != size:
                raise struct.error("a blob has another size than its array")
        own = columns[first:after]
        if varints:
            own = list(own)
            for i in varints:
                own[i] = int.from_bytes(own[i], "big", signed=True).to_bytes(8, "big")
        values = list(unpack(b"".join(own)))
        for i, convert in times:
            values[i] = convert(values[i])
        if has_length:
            values.append(count)
        return pack(*values)

    plain = head_with_length if has_length else head
    return special_head if times or varints else plain


def _build_tail(tail: Tail, index: int) -> BuildTail:
    if tail.kind in ("text", "bytes"):
        return _bytes(index, tail.unit)
    if tail.kind == "wire":
        return lambda columns: (0, columns[index])
    if tail.kind == "texts":
        return _texts(index, tail.length)
    if len(tail.element) == 1 and tail.element[0].tail is None:
        return _numbers(tail.element[0].fixed, index, tail.length)
    return _elements(tail, index)


def _bytes(index: int, unit: int) -> BuildTail:
    def tail(columns: Columns) -> tuple[int, bytes]:
        data = columns[index]
        count, rest = divmod(len(data), unit)
        if rest:
            raise struct.error("a blob ends within an element")
        return count, data

    return tail


def _texts(index: int, length: int | None) -> BuildTail:
    def tail(columns: Columns) -> tuple[int, bytes]:
        texts = split_list(columns[index])
        if length is not None and len(texts) != length:
            raise struct.error("a list has another length than its array")
        sizes = map(_pack_length, map(len, texts))
        return len(texts), b"".join(chain.from_iterable(zip(sizes, texts)))

    return tail


def _elements(field: Tail, first: int) -> BuildTail:
    """Elements of variable size: each is built as a message of its own."""
    after, length = first + len(field.columns), field.length
    steps = compile_build(field.element)
    splits = [
        split_list if size is None else split_equal(size) for size in cql_sizes(field.element)
    ]

    def tail(columns: Columns) -> tuple[int, bytes]:
        lists = [split(column) for split, column in zip(splits, columns[first:after])]
        count = _check_lengths(lists, length)
        parts: list[bytes] = []
        for row in zip(*lists):
            _append(steps, row, parts)
        return count, b"".join(parts)

    return tail


def _numbers(fixed: Sequence[Fixed], first: int, length: int | None) -> BuildTail:
    """Elements of fixed size: column by column, then all at once."""
    after = first + len(fixed)
    splits = [unpack_numbers(f) for f in fixed]
    pack = struct.Struct("<" + "".join(f.little for f in fixed)).pack

    def tail(columns: Columns) -> tuple[int, bytes]:
        lists = [split(column) for split, column in zip(splits, columns[first:after])]
        return _check_lengths(lists, length), b"".join(map(pack, *lists))

    return tail


def _check_lengths(lists: Sequence[Sized], length: int | None) -> int:
    count = len(lists[0])
    if any(len(values) != count for values in lists) or length not in (None, count):
        raise struct.error("the lists of an array of messages differ in length")
    return count
