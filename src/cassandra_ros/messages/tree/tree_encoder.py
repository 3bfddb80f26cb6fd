# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of a tree of plain values to wire bytes: the inverse of ``read``, built the same way.

Trees come from texts that anyone may have edited: a tree that does not fit the type is refused.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from operator import itemgetter
from typing import Any, Callable, Dict, List, Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Field
from cassandra_ros.messages.tree.tree_reader import NUMBER_CODES, TIME_CODES, number_runs
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS

AsBytes = Callable[[object], bytes]
"""Function from the text form of uint8[] or char[] to bytes; raises ValueError, TypeError."""

_ValueWriter = Callable[[object, List[bytes]], None]
"""(value, bytes so far) -> nothing; appends the value."""
_FieldsWriter = Callable[[Dict[str, object], List[bytes]], None]
"""(tree of a message, bytes so far) -> nothing; appends one or several fields."""

_ERRORS = (*BUILD_ERRORS, AttributeError, KeyError, RecursionError)
_pack_length = struct.Struct("<I").pack


def plain_bytes(value: object) -> bytes:
    """Return the bytes of uint8[] or char[], given as bytes or as a list of numbers.

    Raises ValueError or TypeError: it is neither.
    """
    if type(value) is bytes:
        return value
    values = _list(value, None)
    _check_bools(values, False)
    return bytes(values)


@lru_cache(maxsize=512)
def tree_encoder(
    definition: Definition, as_bytes: AsBytes = plain_bytes
) -> Callable[[object], bytes]:
    """Return the function that converts trees of a definition to wire bytes, compiled once.

    The function takes any object and raises CorruptMessage where the tree does not fit: a field is
    missing or unknown, a number is out of range, nsecs are not within a second, an array has
    another length than its field.
    """
    write = _EncoderCompiler(definition, as_bytes).message(definition.type)

    def build(tree: object) -> bytes:
        parts: list[bytes] = []
        try:
            write(tree, parts)
        except _ERRORS as exc:
            reason = f"{type(exc).__name__}: {str(exc)[:200]}"
            raise CorruptMessage(f"a text is no {definition.type}: {reason}") from exc
        return b"".join(parts)

    return build


class _EncoderCompiler:
    """Makes the functions that write messages of one definition."""

    def __init__(self, definition: Definition, as_bytes: AsBytes) -> None:
        self._specs = definition.specs
        self._as_bytes = as_bytes
        self._memo: dict[str, _ValueWriter] = {}

    def message(self, name: str) -> _ValueWriter:
        """Return the function for a message type, made once."""
        if name not in self._memo:
            fields = self._specs[name].fields
            steps = [self._step(run, fixed) for run, fixed in number_runs(fields)]

            def write(tree: object, parts: list[bytes]) -> None:
                mapping = _mapping(tree, len(fields))
                for step in steps:
                    step(mapping, parts)

            self._memo[name] = write
        return self._memo[name]

    def _step(self, run: Sequence[Field], fixed: struct.Struct | None) -> _FieldsWriter:
        """Return the function for what number_runs yields: a run of numbers, or another field."""
        if fixed is not None:
            return _numbers_step(run, fixed)
        name, write = run[0].name, self._field(run[0])
        return lambda tree, parts: write(tree[name], parts)

    def _field(self, field: Field) -> _ValueWriter:
        if field.is_array and field.base == "uint8":
            return _bytes(field.length, self._as_bytes)
        if field.is_array and field.base in NUMBER_CODES:
            return _numbers(NUMBER_CODES[field.base], field.length)
        if field.is_array:
            return _elements(self._field(Field(field.name, field.type)), field.length)
        if field.type == "string":
            return _string
        if field.type in TIME_CODES:
            return _time(TIME_CODES[field.type])
        return self.message(field.type)


def _list(value: object, length: int | None) -> list[Any]:
    if type(value) is not list or length not in (None, len(value)):
        raise ValueError("an array is not a list of its length")
    return value


def _mapping(tree: object, count: int) -> dict[str, object]:
    if type(tree) is not dict or len(tree) != count:
        raise ValueError(f"a message is not a mapping of its {count} fields")
    return tree


def _check_bools(values: Sequence[object], bools: bool) -> None:
    """Check that all values are bools, or that none is; else raise ValueError."""
    if bools:  # struct takes any object as a bool, and bools as numbers
        if not all(type(value) is bool for value in values):
            raise ValueError("a bool is neither true nor false")
    elif bool in map(type, values):
        raise ValueError("a number is true or false")


def _numbers_step(run: Sequence[Field], fixed: struct.Struct) -> _FieldsWriter:
    """Return the function for adjacent numbers, or adjacent bools, see number_runs."""
    pick = itemgetter(*[field.name for field in run])
    pack, single, bools = fixed.pack, len(run) == 1, run[0].type == "bool"

    def step(tree: dict[str, object], parts: list[bytes]) -> None:
        values = (pick(tree),) if single else pick(tree)
        _check_bools(values, bools)
        parts.append(pack(*values))

    return step


def _string(value: Any, parts: list[bytes]) -> None:
    data: bytes = value.encode()
    parts += (_pack_length(len(data)), data)


def _time(code: str) -> _ValueWriter:
    pack, pick = struct.Struct(code).pack, itemgetter("secs", "nsecs")

    def write(tree: object, parts: list[bytes]) -> None:
        values = pick(_mapping(tree, 2))
        _check_bools(values, False)
        if not 0 <= values[1] < SECOND_NS:
            raise ValueError("nsecs are not within a second")
        parts.append(pack(*values))

    return write


def _bytes(length: int | None, as_bytes: AsBytes) -> _ValueWriter:
    def write(value: object, parts: list[bytes]) -> None:
        data = as_bytes(value)
        if length not in (None, len(data)):
            raise ValueError("an array has another length than its field")
        if length is None:
            parts.append(_pack_length(len(data)))
        parts.append(data)

    return write


def _numbers(code: str, length: int | None) -> _ValueWriter:
    def write(value: object, parts: list[bytes]) -> None:
        values = _list(value, length)
        _check_bools(values, code == "?")
        if length is None:
            parts.append(_pack_length(len(values)))
        parts.append(struct.pack(f"<{len(values)}{code}", *values))

    return write


def _elements(element: _ValueWriter, length: int | None) -> _ValueWriter:
    def write(value: object, parts: list[bytes]) -> None:
        values = _list(value, length)
        if length is None:
            parts.append(_pack_length(len(values)))
        for one in values:
            element(one, parts)

    return write
