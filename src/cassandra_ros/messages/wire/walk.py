# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From wire bytes to columns: closures over structs, compiled once per definition.

A segment becomes a head (one little-endian unpack, one big-endian pack, one split into columns;
returns the length of the tail), the head's size, and a tail. No step raises anything but
struct.error, and none allocates more than the buffer justifies.
"""

from __future__ import annotations

import struct
from typing import Callable, Container, Iterator, List, Optional, Sequence, Tuple, cast

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.wire.layout import Fixed, Segment, Tail, cql_sizes
from cassandra_ros.messages.wire.skip import short_buffer
from cassandra_ros.messages.wire.values import (
    EMPTY_LIST,
    TO_NS,
    pack_equal,
    pack_list,
    pack_numbers,
    pack_varint,
)

Out = List[Optional[bytes]]
Head = Callable[[bytes, int, Out, List[int]], int]
"""(wire, offset, columns so far, marks of inexact columns) -> length of the tail."""
WalkTail = Callable[[bytes, int, int, Out, List[int]], int]
"""(wire, offset, length, columns, marks) -> offset behind the field."""
Step = Tuple[Optional[Head], int, Optional[WalkTail]]

_unpack_length = struct.Struct("<I").unpack_from


def compile_walk(
    segments: Sequence[Segment], strict: bool = True, wanted: Container[str] | None = None
) -> list[Step]:
    """Return the steps that turn a message into columns.

    Args:
        segments: Layout of the type.
        strict: Whether a column that cannot hold its field exactly is None and marked;
            else it holds the nearest value.
        wanted: Names of the columns to be made; None makes all.
    """
    return [_step(segment, strict, wanted) for segment in segments]


def _step(segment: Segment, strict: bool, wanted: Container[str] | None) -> Step:
    tail = segment.tail
    kept = [wanted is None or f.column.name in wanted for f in segment.fixed]
    has_length = tail is not None and tail.has_count
    head, size = _head(segment.fixed, kept, has_length, strict)
    if tail is None:
        return head, size, None
    if wanted is not None and not any(c.name in wanted for c in tail.columns):
        return head, size, _skip_tail(tail)
    return head, size, _walk_tail(tail, strict, wanted)


def _head(
    fixed: Sequence[Fixed], kept: Sequence[bool], has_length: bool, strict: bool
) -> tuple[Head | None, int]:
    used = [f for f, keep in zip(fixed, kept) if keep]
    codes = [f.little if k else f"{struct.calcsize(f.little)}x" for f, k in zip(fixed, kept)]
    wire = struct.Struct("<" + "".join(codes) + "I" * has_length)
    unpack = wire.unpack_from
    if not used:  # () where nothing but padding is skipped, which must be there all the same
        return (
            lambda wire, at, out, odd: (unpack(wire, at) or (0,))[-1]
        ) if wire.size else None, wire.size
    cql = struct.Struct(">" + "".join(f.big for f in used) + "I" * has_length)
    split = struct.Struct("".join(f"{f.cql_size}s" for f in used) + "4x" * has_length)
    if any(f.special for f in used):
        return _special_head(wire, cql, split, used, strict), wire.size
    pack, cut = cql.pack, split.unpack

    def head(wire: bytes, at: int, out: Out, odd: list[int]) -> int:
        values = unpack(wire, at)
        out += cut(pack(*values))
        return values[-1]  # type: ignore[no-any-return]

    return head, wire.size


def _special_head(
    wire: struct.Struct,
    cql: struct.Struct,
    split: struct.Struct,
    used: Sequence[Fixed],
    strict: bool,
) -> Head:
    unpack, pack, cut = wire.unpack_from, cql.pack, split.unpack
    stamps = [(i, TO_NS[f.special]) for i, f in enumerate(used) if f.special in TO_NS]
    bools = [i for i, f in enumerate(used) if f.special == "bool"]
    varints = [i for i, f in enumerate(used) if f.special == "uint64"]

    def head(wire: bytes, at: int, out: Out, odd: list[int]) -> int:
        values = list(unpack(wire, at))
        inexact = []
        for i, convert in stamps:
            value = values[i]
            if not 0 <= value >> 32 < SECOND_NS:
                inexact.append(i)
            values[i] = convert(value)
        for i in bools:
            if values[i] > 1:
                inexact.append(i)
        columns: Sequence[bytes | None] = cut(pack(*values))
        if varints or inexact:
            columns = own = list(columns)
            for i in varints:
                own[i] = pack_varint(values[i])
            if strict:
                odd += inexact
                for i in inexact:
                    own[i] = None
        out += columns
        return values[-1]  # type: ignore[no-any-return]

    return head


def _skip_tail(tail: Tail) -> WalkTail:
    skip, back = tail.skip, 4 if tail.has_count else 0
    return lambda wire, at, count, out, odd: skip(wire, at - back)


def _walk_tail(tail: Tail, strict: bool, wanted: Container[str] | None) -> WalkTail:
    if tail.kind == "text":
        return _text if strict else _bytes(1)
    if tail.kind == "bytes":
        return _bytes(tail.unit)
    if tail.kind == "wire":
        return _wire(tail)
    if tail.kind == "texts":
        return _texts(tail.length, strict)
    kept = [i for i, c in enumerate(tail.columns) if wanted is None or c.name in wanted]
    if len(tail.element) == 1 and tail.element[0].tail is None:
        walk = _numbers(tail.element[0].fixed, tail.length, strict)
    else:
        walk = _elements(tail, strict)
    return walk if len(kept) == len(tail.columns) else _choose(walk, kept)


def _choose(walk: WalkTail, kept: Sequence[int]) -> WalkTail:
    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        columns: Out = []
        at = walk(wire, at, count, columns, odd)
        out.extend(columns[i] for i in kept)
        return at

    return tail


def _text(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
    end = at + count
    text = wire[at:end]
    if len(text) != count:
        raise short_buffer()
    out.append(text if _is_utf8(text) else None)
    if out[-1] is None:
        odd.append(1)
    return end


def _is_utf8(text: bytes) -> bool:
    if text.isascii():
        return True
    try:
        text.decode()  # Cassandra's own check is laxer
    except UnicodeDecodeError:
        return False
    return True


def _bytes(unit: int) -> WalkTail:
    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        end = at + count * unit
        if end > len(wire):
            raise short_buffer()
        out.append(wire[at:end])
        return end

    return tail


def _wire(field: Tail) -> WalkTail:
    skip = field.skip

    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        end = skip(wire, at)
        out.append(wire[at:end])
        return end

    return tail


def _texts(length: int | None, strict: bool) -> WalkTail:
    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        texts = []
        for _ in range(count if length is None else length):
            start = at + 4
            at = start + _unpack_length(wire, at)[0]
            if at > len(wire):
                raise short_buffer()
            texts.append(wire[start:at])
        if strict and not all(map(_is_utf8, texts)):
            odd.append(1)
            out.append(None)
        else:
            out.append(pack_list(texts))
        return at

    return tail


def _numbers(fixed: Sequence[Fixed], length: int | None, strict: bool) -> WalkTail:
    """Elements of fixed size: all at once, column by column."""
    element = struct.Struct("<" + "".join(f.little for f in fixed))
    encoders = [pack_numbers(f, strict) for f in fixed]
    unpack, size = element.iter_unpack, element.size

    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        if length is not None:
            count = length
        end = at + count * size
        if end > len(wire):
            raise short_buffer()
        if not count:
            out.extend([EMPTY_LIST] * len(encoders))
            return end
        for encode, values in zip(encoders, zip(*unpack(wire[at:end]))):
            column = encode(values)
            if column is None:
                odd.append(1)
            out.append(column)
        return end

    return tail


def _elements(field: Tail, strict: bool) -> WalkTail:
    """Elements of variable size: each as a message of its own, then turned into lists."""
    steps, length = compile_walk(field.element, strict), field.length
    encoders = [
        pack_list if size is None else pack_equal(size) for size in cql_sizes(field.element)
    ]

    def tail(wire: bytes, at: int, count: int, out: Out, odd: list[int]) -> int:
        rows: list[Out] = []
        marks: list[int] = []
        for _ in range(count if length is None else length):
            row: Out = []
            for head, size, rest in steps:
                number = head(wire, at, row, marks) if head is not None else 0
                at += size
                if rest is not None:
                    at = rest(wire, at, number, row, marks)
            rows.append(row)
        if not rows:
            out.extend([EMPTY_LIST] * len(encoders))
            return at
        columns = cast("Iterator[Sequence[bytes]]", zip(*rows))  # a None in them has its mark
        if marks:
            odd += marks
            for encode, column in zip(encoders, columns):
                out.append(None if None in column else encode(column))
        else:
            out.extend([encode(column) for encode, column in zip(encoders, columns)])
        return at

    return tail
