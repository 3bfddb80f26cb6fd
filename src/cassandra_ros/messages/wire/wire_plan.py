# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Wire plans: conversion of serialised messages to columns in CQL's encoding, and back.

Wire bytes become columns by closures over structs, compiled once per definition. A segment becomes
a head (one little-endian unpack, one big-endian pack, one split into columns; returns the length of
the tail), the head's size, and a tail. Steps raise only struct.error, and allocate no more memory
than the buffer justifies. A step may return an offset after the end of the bytes: then the next
step fails, and the caller checks the last offset.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Callable, Container, Iterator, List, Optional, Sequence, Tuple, cast

from cassandra_ros.errors import CorruptMessage, InvalidExpression
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.cql_values import (
    EMPTY_LIST,
    TO_NS,
    compile_decoder,
    pack_equal,
    pack_list,
    pack_numbers,
    pack_varint,
)
from cassandra_ros.messages.wire.field_ends import Skip
from cassandra_ros.messages.wire.layout import (
    FieldColumn,
    FixedField,
    Segment,
    VariableField,
    columns_of,
    layout,
)
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS, EncodedColumns, compile_build

ColumnValues = List[Optional[bytes]]
"""Encoded columns of a message; None for a column that cannot hold its field exactly."""
_Head = Callable[[bytes, int, ColumnValues, List[int]], int]
"""(wire, offset, columns so far, marks of inexact columns) -> length of the tail."""
_Tail = Callable[[bytes, int, int, ColumnValues, List[int]], int]
"""(wire, offset, length, columns, marks) -> offset after the field."""
WalkStep = Tuple[_Head, int, Optional[_Tail]]
"""Head of a segment, size of what it reads in bytes, and tail; None = the segment has no tail."""

_unpack_length = struct.Struct("<I").unpack_from


def compile_walk(
    segments: Sequence[Segment], strict: bool, names: Container[str]
) -> list[WalkStep]:
    """Return the steps that convert a message to the columns named in ``names``.

    If strict, a column that cannot hold its field exactly is None and marked, else it holds the
    nearest value.
    """
    steps: list[WalkStep] = []
    for fixed, tail in segments:
        has_length = tail is not None and tail.has_count
        fields, codes = _choose(fixed, names)
        read = struct.Struct(codes + "I" * has_length)
        head = _head(read, fields, has_length, strict)
        steps.append((head, read.size, None if tail is None else _tail(tail, strict, names)))
    return steps


def walk_message(
    steps: Sequence[WalkStep], wire: bytes, at: int, out: ColumnValues, odd: list[int]
) -> int:
    """Append the columns of a message and the marks of inexact ones; return the offset after it.

    Any mark means that a column is inexact, whatever its number. The offset may lie after the end
    of the bytes.
    """
    for head, size, tail in steps:
        count = head(wire, at, out, odd)
        at += size
        if tail is not None:
            at = tail(wire, at, count, out, odd)
    return at


def _choose(fixed: Sequence[FixedField], names: Container[str]) -> tuple[list[FixedField], str]:
    """Return the wanted fields, and struct codes that read them and skip the other fields."""
    keeps = [f.column.name in names for f in fixed]
    codes = [f.little if k else f"{struct.calcsize(f.little)}x" for f, k in zip(fixed, keeps)]
    return [f for f, keep in zip(fixed, keeps) if keep], "<" + "".join(codes)


def _head(
    codes: struct.Struct, fields: Sequence[FixedField], has_length: bool, strict: bool
) -> _Head:
    """Return the head that reads the wanted fields of a segment by ``codes``."""
    unpack = codes.unpack_from
    if not fields:  # a struct of padding only still checks that the bytes exist
        return lambda wire, at, out, odd: (unpack(wire, at) or (0,))[-1]
    pack = struct.Struct(">" + "".join(f.big for f in fields) + "I" * has_length).pack
    cut = struct.Struct("".join(f"{f.cql_size}s" for f in fields) + "4x" * has_length).unpack
    stamps = [(i, TO_NS[f.special]) for i, f in enumerate(fields) if f.special in TO_NS]
    bools = [i for i, f in enumerate(fields) if f.special == "bool"]
    varints = [i for i, f in enumerate(fields) if f.special == "uint64"]

    def head(wire: bytes, at: int, out: ColumnValues, odd: list[int]) -> int:
        values = unpack(wire, at)
        out += cut(pack(*values))
        return values[-1]  # type: ignore[no-any-return]

    def special_head(wire: bytes, at: int, out: ColumnValues, odd: list[int]) -> int:
        values = list(unpack(wire, at))
        inexact = []
        for i in bools:
            if values[i] > 1:
                inexact.append(i)
        for i, convert in stamps:
            value = values[i]
            if not 0 <= value >> 32 < SECOND_NS:
                inexact.append(i)
            values[i] = convert(value)
        columns: Sequence[bytes | None] = cut(pack(*values))
        if varints or inexact:
            columns = cells = list(columns)
            for i in varints:
                cells[i] = pack_varint(values[i])
            if strict:
                odd += inexact
                for i in inexact:
                    cells[i] = None
        out += columns
        return values[-1]  # type: ignore[no-any-return]

    return special_head if stamps or bools or varints else head


def _tail(tail: VariableField, strict: bool, names: Container[str]) -> _Tail:
    """Return the tail for a variable field; it only skips a field of which no column is wanted."""
    skip, unit = tail.skip, tail.unit
    if not any(column.name in names for column in tail.columns):
        if tail.kind in ("text", "bytes"):
            return lambda wire, at, count, out, odd: at + count * unit
        back = 4 if tail.has_count else 0
        return lambda wire, at, count, out, odd: skip(wire, at - back)
    if tail.kind == "text" and strict:
        return _text
    if tail.kind in ("text", "bytes"):
        return _bytes(unit)
    if tail.kind == "wire":
        return _wire(skip)
    if tail.kind == "texts":
        return _texts(tail.length, strict)
    if len(tail.element) == 1 and tail.element[0].tail is None:
        return _numbers(tail.element[0].fixed, tail.length, strict, names)
    return _elements(tail, strict, names)


def _text(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
    """Append a text; it is the _Tail for a strict walk."""
    end = at + count
    text = wire[at:end]
    if _is_utf8(text):
        out.append(text)
    else:
        out.append(None)
        odd.append(1)
    return end


def _is_utf8(text: bytes) -> bool:
    if text.isascii():
        return True
    try:
        text.decode()  # stricter than Cassandra's own check
    except UnicodeDecodeError:
        return False
    return True


def _bytes(unit: int) -> _Tail:
    """Return the tail for an array of numbers, or a text that need not be UTF-8."""

    def tail(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
        end = at + count * unit
        out.append(wire[at:end])
        return end

    return tail


def _wire(skip: Skip) -> _Tail:
    """Return the tail for a field whose column is all of its bytes."""

    def tail(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
        end = skip(wire, at)
        out.append(wire[at:end])
        return end

    return tail


def _texts(length: int | None, strict: bool) -> _Tail:
    """Return the tail for string[]; length: of a fixed array."""

    def tail(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
        texts = []
        for _ in range(count if length is None else length):
            start = at + 4
            at = start + _unpack_length(wire, at)[0]
            texts.append(wire[start:at])
        if strict and not all(map(_is_utf8, texts)):
            odd.append(1)
            out.append(None)
        else:
            out.append(pack_list(texts))
        return at

    return tail


def _numbers(
    fixed: Sequence[FixedField], length: int | None, strict: bool, names: Container[str]
) -> _Tail:
    """Return the tail for elements of fixed size: all at once, column by column."""
    fields, codes = _choose(fixed, names)
    unpack, size = struct.Struct(codes).iter_unpack, struct.calcsize(codes)
    encoders = [pack_numbers(f, strict) for f in fields]

    def tail(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
        end = at + (count if length is None else length) * size
        if at == end:
            out.extend([EMPTY_LIST] * len(encoders))
        for encode, values in zip(encoders, zip(*unpack(wire[at:end]))):
            column = encode(values)
            if column is None:
                odd.append(1)
            out.append(column)
        return end

    return tail


def _elements(field: VariableField, strict: bool, names: Container[str]) -> _Tail:
    """Return the tail for elements of variable size: each is walked like a message."""
    steps, length = compile_walk(field.element, strict, names), field.length
    sizes = [size for column, size in columns_of(field.element) if column.name in names]
    encoders = [pack_list if size is None else pack_equal(size) for size in sizes]

    def tail(wire: bytes, at: int, count: int, out: ColumnValues, odd: list[int]) -> int:
        rows: list[ColumnValues] = []
        marks: list[int] = []
        for _ in range(count if length is None else length):
            row: ColumnValues = []
            at = walk_message(steps, wire, at, row, marks)
            rows.append(row)
        if not rows:
            out.extend([EMPTY_LIST] * len(encoders))
        columns = cast("Iterator[Sequence[bytes]]", zip(*rows))  # a None among them is marked
        for encode, column in zip(encoders, columns):
            out.append(None if marks and None in column else encode(column))
        odd += marks
        return at

    return tail


MAX_COLUMNS = 64
"""Maximum number of columns of a table in format ``ros``."""


class WirePlan:
    """Compiled conversions for the bytes of one message type.

    Attributes:
        columns: The columns in wire order. If all fields would need more than 64, only the first
            64 scalar ones; arrays would otherwise be stored twice.
        all_columns: The columns of all fields.
        complete: Whether every field has a column, so that ``build`` works.
    """

    def __init__(self, definition: Definition) -> None:
        self.definition = definition
        self._segments = layout(definition.type, definition.specs)
        self.all_columns: tuple[FieldColumn, ...] = tuple(c for c, _ in columns_of(self._segments))
        scalars = [c for c in self.all_columns if c.is_scalar]
        self.complete = len(self.all_columns) <= MAX_COLUMNS
        self.columns = self.all_columns if self.complete else tuple(scalars[:MAX_COLUMNS])
        names = {column.name for column in self.columns}
        self._steps = compile_walk(self._segments, True, names)
        self._build = compile_build(self._segments)
        self._decoders = [compile_decoder(c, definition.specs) for c in self.columns]
        self._scalar_at = [i for i, c in enumerate(self.columns) if c.is_scalar]
        self._scalar_steps = compile_walk(self._segments, True, {c.name for c in scalars} & names)

    def walk(self, wire: bytes) -> tuple[ColumnValues, bool]:
        """Return the columns of a message in CQL's encoding, and whether they are inexact.

        Any bytes are accepted. A column that cannot hold its field exactly is None. The columns are
        also inexact if surplus bytes follow, or if the bytes are malformed (then all columns are
        None).
        """
        out, odd = _walk(self._steps, wire)
        return [None] * len(self.columns) if out is None else out, odd

    def walk_scalars(self, wire: bytes) -> tuple[ColumnValues, bool]:
        """Return the columns like ``walk``, but lists and arrays as None: for a large message."""
        out, odd = _walk(self._scalar_steps, wire)
        columns: ColumnValues = [None] * len(self.columns)
        for i, column in zip(self._scalar_at, out or ()):
            columns[i] = column
        return columns, odd or len(self._scalar_at) < len(columns)

    def build(self, columns: Sequence[bytes | None]) -> bytes:
        """Return the message of columns; CorruptMessage: a column is missing or malformed."""
        name = self.definition.type
        if not self.complete or len(columns) != len(self.columns):
            raise CorruptMessage(f"a row of {name} has {len(columns)} columns, not all its fields")
        parts: list[bytes] = []
        try:
            for step in self._build:
                step(cast(EncodedColumns, columns), parts)
            return b"".join(parts)
        except BUILD_ERRORS as exc:
            missing = [c.name for c, v in zip(self.columns, columns) if v is None]
            why = f"column {missing[0]} is missing" if missing else str(exc)
            raise CorruptMessage(f"the columns of a row are no {name}: {why}") from exc

    def value(self, index: int, raw: bytes) -> Any:
        """Return the Python value of a column, see compile_decoder; raises CorruptMessage."""
        try:
            return self._decoders[index](raw)
        except BUILD_ERRORS as exc:
            name = self.columns[index].name
            raise CorruptMessage(f"column {name} of a row is malformed: {exc}") from exc

    def decoder(self, index: int) -> Callable[[bytes], Any]:
        """Return the function from a column to its Python value; it raises BUILD_ERRORS."""
        return self._decoders[index]

    def column(self, name: str) -> FieldColumn | None:
        """Return the column of ``all_columns`` that holds a field, or None."""
        return next((column for column in self.all_columns if column.name == name), None)

    def reader(self, names: Sequence[str]) -> Callable[[bytes], list[Any]]:
        """Return the function from wire bytes to the Python values of some of ``all_columns``.

        A field that ``walk`` returns as None is read as its nearest value: bool byte 2 as True,
        nsecs of 10**9 and more carried over to seconds, text that is not UTF-8 with U+FFFD. The
        function raises CorruptMessage; an unknown name raises InvalidExpression.
        """
        steps, places = self._compile_cut(names)
        columns = {column.name: column for column in self.all_columns}
        decoders = [compile_decoder(columns[name], self.definition.specs) for name in names]
        picks = list(zip(places, decoders))

        def read(wire: bytes) -> list[Any]:
            out, _ = _walk(steps, wire)
            if out is None:
                raise self._no_message(wire)
            return [decode(out[i]) for i, decode in picks]  # type: ignore[arg-type]

        return read

    def picker(self, name: str) -> Callable[[bytes], bytes | None]:
        """Return the function from wire bytes to one of ``all_columns``, in CQL's encoding.

        It returns None if the column cannot hold the field exactly, or the bytes are malformed.
        """
        steps = compile_walk(self._segments, True, (name,))

        def pick(wire: bytes) -> bytes | None:
            out, _ = _walk(steps, wire)
            return None if out is None else out[0]

        return pick

    def cutter(self, names: Sequence[str]) -> Callable[[bytes], list[bytes]]:
        """Return the function from wire bytes to some of ``all_columns``, in CQL's encoding.

        Like ``reader``, but not decoded: a column may be bool byte 2, or text that is not UTF-8.
        """
        steps, places = self._compile_cut(names)

        def cut(wire: bytes) -> list[bytes]:
            out, _ = _walk(steps, wire)
            if out is None:
                raise self._no_message(wire)
            return [out[i] for i in places]  # type: ignore[misc]

        return cut

    def _compile_cut(self, names: Sequence[str]) -> tuple[list[WalkStep], list[int]]:
        """Return the steps that read the named columns, and the index of each in their output."""
        columns = [column.name for column in self.all_columns if column.name in names]
        for name in names:
            if name not in columns:
                raise InvalidExpression(f"{self.definition.type} has no field {name!r}")
        return compile_walk(self._segments, False, columns), [columns.index(name) for name in names]

    def _no_message(self, wire: bytes) -> CorruptMessage:
        return CorruptMessage(f"{len(wire)} bytes are no {self.definition.type}")


def _walk(steps: Sequence[WalkStep], wire: bytes) -> tuple[ColumnValues | None, bool]:
    """Return the columns of a message (None: malformed bytes), and whether they are inexact."""
    out: ColumnValues = []
    odd: list[int] = []
    try:
        end = walk_message(steps, wire, 0, out, odd)
    except struct.error:
        return None, True
    return (out if end <= len(wire) else None), bool(odd) or end != len(wire)


wire_plan = lru_cache(maxsize=512)(WirePlan)
"""Returns the plan of a definition, compiled once per type and md5."""
