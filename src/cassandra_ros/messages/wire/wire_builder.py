# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of columns to wire bytes: the inverse of ``walk``, built the same way."""

from __future__ import annotations

import struct
from itertools import chain
from typing import Callable, List, Sequence, Sized

from cassandra_ros.messages.wire.cql_values import FROM_NS, split_equal, split_list, unpack_numbers
from cassandra_ros.messages.wire.layout import FixedField, Segment, VariableField, columns_of

EncodedColumns = Sequence[bytes]
"""Column values in CQL's encoding; a None among them raises TypeError."""
BuildStep = Callable[[EncodedColumns, List[bytes]], None]
"""(columns, wire bytes so far) -> nothing; appends one or several fields."""

BUILD_ERRORS = (struct.error, TypeError, ValueError, OverflowError, IndexError)
"""Exceptions that malformed columns can raise."""

_pack_length = struct.Struct("<I").pack


def compile_build(segments: Sequence[Segment]) -> list[BuildStep]:
    """Return the steps that build a message from its columns."""
    steps: list[BuildStep] = []
    first = 0  # index of the next segment's first column
    for fixed, tail in segments:
        if fixed:
            steps.append(_fixed(fixed, first))
            first += len(fixed)
        if tail is not None:
            steps.append(_tail(tail, first))
            first += len(tail.columns)
    return steps


def _fixed(fixed: Sequence[FixedField], first: int) -> BuildStep:
    """Return the step for adjacent fields of fixed size, whose columns begin at ``first``."""
    after = first + len(fixed)
    unpack = struct.Struct(">" + "".join(f.big for f in fixed)).unpack
    pack = struct.Struct("<" + "".join(f.little for f in fixed)).pack
    times = [(i, FROM_NS[f.special]) for i, f in enumerate(fixed) if f.special in FROM_NS]
    varints = [i for i, f in enumerate(fixed) if f.special == "uint64"]
    blobs = [(i, f.cql_size) for i, f in enumerate(fixed) if f.column.kind == "array"]

    def step(columns: EncodedColumns, parts: list[bytes]) -> None:
        cells = columns[first:after]
        for i, size in blobs:
            if len(cells[i]) != size:
                raise struct.error("a blob has another size than its array")
        if varints:
            cells = list(cells)
            for i in varints:
                cells[i] = int.from_bytes(cells[i], "big", signed=True).to_bytes(8, "big")
        values: Sequence[int] = unpack(b"".join(cells))
        if times:
            values = changed = list(values)
            for i, convert in times:
                changed[i] = convert(changed[i])
        parts.append(pack(*values))

    return step


def _tail(tail: VariableField, index: int) -> BuildStep:
    """Return the step for a field of variable size, whose columns begin at ``index``."""
    if tail.kind in ("text", "bytes"):
        return _bytes(index, tail.unit)
    if tail.kind == "wire":
        return lambda columns, parts: parts.append(columns[index])
    if tail.kind == "texts":
        return _texts(index, tail.length)
    if len(tail.element) == 1 and tail.element[0].tail is None:
        return _numbers(tail.element[0].fixed, index, tail.length)
    return _elements(tail, index)


def _bytes(index: int, unit: int) -> BuildStep:
    """Return the step for a text or an array of numbers, whose length prefix counts ``unit``."""

    def step(columns: EncodedColumns, parts: list[bytes]) -> None:
        data = columns[index]
        count, rest = divmod(len(data), unit)
        if rest:
            raise struct.error("a blob ends within an element")
        parts += (_pack_length(count), data)

    return step


def _texts(index: int, length: int | None) -> BuildStep:
    """Return the step for string[]; length: of a fixed array, which has no length prefix."""

    def step(columns: EncodedColumns, parts: list[bytes]) -> None:
        texts = split_list(columns[index])
        if length not in (None, len(texts)):
            raise struct.error("a list has another length than its array")
        if length is None:
            parts.append(_pack_length(len(texts)))
        parts.extend(chain.from_iterable(zip(map(_pack_length, map(len, texts)), texts)))

    return step


def _elements(tail: VariableField, first: int) -> BuildStep:
    """Return the step for elements of variable size: each is built like a message."""
    after, length, steps = first + len(tail.columns), tail.length, compile_build(tail.element)
    sizes = [size for _, size in columns_of(tail.element)]
    splits = [split_list if size is None else split_equal(size) for size in sizes]

    def step(columns: EncodedColumns, parts: list[bytes]) -> None:
        lists = [split(column) for split, column in zip(splits, columns[first:after])]
        _count(lists, length, parts)
        for row in zip(*lists):
            for build in steps:
                build(row, parts)

    return step


def _numbers(fixed: Sequence[FixedField], first: int, length: int | None) -> BuildStep:
    """Return the step for elements of fixed size: column by column, then all packed at once."""
    after, splits = first + len(fixed), [unpack_numbers(f) for f in fixed]
    pack = struct.Struct("<" + "".join(f.little for f in fixed)).pack

    def step(columns: EncodedColumns, parts: list[bytes]) -> None:
        lists = [split(column) for split, column in zip(splits, columns[first:after])]
        _count(lists, length, parts)
        parts.extend(map(pack, *lists))

    return step


def _count(lists: Sequence[Sized], length: int | None, parts: list[bytes]) -> None:
    """Check that all lists have the length of their array; write the length of a variable array."""
    count = len(lists[0])
    if any(len(values) != count for values in lists) or length not in (None, count):
        raise struct.error("the lists of an array of messages differ in length")
    if length is None:
        parts.append(_pack_length(count))
