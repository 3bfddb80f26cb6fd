# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Wire plans: conversion of serialised messages to columns in CQL's encoding, and back."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Callable, Sequence, cast

from cassandra_ros.errors import CorruptMessage, InvalidExpression
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.cql_values import compile_decoder
from cassandra_ros.messages.wire.layout import FieldColumn, columns_of, layout
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS, EncodedColumns, compile_build
from cassandra_ros.messages.wire.wire_walk import ColumnValues, WalkStep, compile_walk, walk_message

MAX_COLUMNS = 64


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
        """Return the scalar columns of a large message; lists and arrays are None."""
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
        found = [column.name for column in self.all_columns if column.name in names]
        for name in names:
            if name not in found:
                raise InvalidExpression(f"{self.definition.type} has no field {name!r}")
        return compile_walk(self._segments, False, found), [found.index(name) for name in names]

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
