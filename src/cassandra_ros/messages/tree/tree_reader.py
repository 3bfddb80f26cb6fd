# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of wire bytes to a tree of plain values, as the text formats print it.

A message is a dict by the definition's field names, a time or duration a dict of secs and nsecs,
uint8[] and char[] are bytes, other arrays lists. An array or string that is too long for a text is
not read: the tree holds the text that ``rostopic echo --noarr`` prints in its place.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Callable, Dict, Iterator, List, Sequence, Tuple, Union

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES, Field
from cassandra_ros.messages.wire.field_ends import compile_field_skip, short_buffer

TIME_CODES = {"time": "<II", "duration": "<ii"}
NUMBER_CODES = {name: code for name, code in CODES.items() if name not in TIME_CODES}
"""struct codes of all primitive types except string, time and duration."""

MessageTree = Dict[str, "TreeValue"]
TreeValue = Union[bool, int, float, str, bytes, List["TreeValue"], MessageTree]

# Minimum number of characters of a value in any text format: the amount charged to the budget.
_NUMBER = 2
_FIELD = 4
_TIME = 10
_MANY = 1024
"""Minimum length of an array of numbers whose exact text length is computed and charged."""


class TooLong(Exception):  # noqa: N818 - not an error: the caller tries its next limits
    """The text of a message would exceed the budget."""


@dataclass
class Budget:
    """Limits on the size of a tree."""

    left: int
    """Characters still allowed; reading stops as soon as the text must become longer."""
    byte: int
    """Minimum number of characters for one byte of uint8[] or char[]."""
    elements: int
    """Maximum number of elements of an array that is read; longer arrays are replaced by a text."""
    text: int
    """Maximum size of a string that is read, bytes; longer strings are replaced by a text."""
    shortened: bool = False
    """Whether an array or string was replaced by a text."""

    def charge(self, characters: int) -> None:
        """Subtract characters; raise TooLong if fewer are left."""
        self.left -= characters
        if self.left < 0:
            raise TooLong


_ValueReader = Callable[[bytes, int, Budget], Tuple[TreeValue, int]]
"""(wire bytes, offset, budget) -> value, offset after it."""
_MessageReader = Callable[[bytes, int, Budget], Tuple[MessageTree, int]]
_FieldsReader = Callable[[MessageTree, bytes, int, Budget], int]
"""(tree to fill, wire bytes, offset, budget) -> offset after the fields."""
_ElementsReader = Callable[[bytes, int, int, Budget], Tuple[TreeValue, int]]
"""(wire bytes, offset, number of elements, budget) -> value, offset after it."""

_length = struct.Struct("<I").unpack_from
_CONTINUATION = bytes(range(0x80, 0xC0))


def number_runs(fields: Sequence[Field]) -> Iterator[tuple[list[Field], struct.Struct | None]]:
    """Yield runs of numbers (or bools) with the struct that reads the run; other fields alone."""

    def kind(field: Field) -> bool | str:
        number = not field.is_array and field.base in NUMBER_CODES
        return field.type == "bool" if number else field.name

    for key, run in groupby(fields, kind):
        together = list(run)
        codes = "" if isinstance(key, str) else [NUMBER_CODES[f.base] for f in together]
        yield together, struct.Struct("<" + "".join(codes)) if codes else None


class TreeReader:
    """Reads messages of one type, compiled from its definition."""

    def __init__(self, definition: Definition) -> None:
        self.type, self._specs = definition.type, definition.specs
        self._memo: dict[str, tuple[_MessageReader, int]] = {}
        self._read, self._weight = self._message(definition.type)

    def read(self, wire: bytes, budget: Budget) -> MessageTree | None:
        """Return the tree of a message, or None if its text certainly exceeds the budget.

        Surplus bytes are ignored, bad UTF-8 becomes U+FFFD. The budget must be new: it limits
        memory and time, and holds afterwards whether something was shortened. CorruptMessage: the
        bytes end early.
        """
        try:
            budget.charge(self._weight)
            return self._read(wire, 0, budget)[0]
        except TooLong:
            return None
        except struct.error as exc:
            raise CorruptMessage(f"{len(wire)} bytes are no {self.type}: {exc}") from exc

    def _message(self, name: str) -> tuple[_MessageReader, int]:
        """Return the reader of a message type and the minimum length of its text, made once.

        Arrays and strings do not count: they are charged when they are read.
        """
        if name not in self._memo:
            weight = 0
            steps: list[_FieldsReader] = []
            for run, fixed in number_runs(self._specs[name].fields):
                if fixed is not None:
                    weight += _FIELD * len(run)
                    steps.append(_numbers_step([field.name for field in run], fixed))
                else:
                    read, least = self._field(run[0])
                    weight += max(least, _FIELD)
                    steps.append(_field_step(run[0].name, read))

            def read_message(wire: bytes, at: int, budget: Budget) -> tuple[MessageTree, int]:
                tree: MessageTree = {}
                for step in steps:
                    at = step(tree, wire, at, budget)
                return tree, at

            self._memo[name] = read_message, max(weight, _FIELD)
        return self._memo[name]

    def _field(self, field: Field) -> tuple[_ValueReader, int]:
        """Return the reader of a field and the minimum length of its text, as _message."""
        if field.is_array:
            return self._array(field), 0
        if field.type == "string":
            return _string, 0
        if field.type in TIME_CODES:
            return _time(TIME_CODES[field.type]), _TIME
        return self._message(field.type)

    def _array(self, field: Field) -> _ValueReader:
        """Return the reader of an array; in place of one that is too long it gives a text."""
        length, skip = field.length, compile_field_skip(field, self._specs)
        if field.base in NUMBER_CODES:
            weight, read_elements = 0 if field.base == "uint8" else _NUMBER, _number_elements(field)
        else:
            element, least = self._field(Field(field.name, field.type))
            weight, read_elements = max(least, _NUMBER), _elements(element)

        def read(wire: bytes, at: int, budget: Budget) -> tuple[TreeValue, int]:
            start, count = at, length
            if count is None:
                (count,) = _length(wire, at)
                at += 4
            if count > budget.elements:
                budget.shortened = True
                return f"<array type: {field.type}, length: {count}>", skip(wire, start)
            budget.charge(count * weight)
            return read_elements(wire, at, count, budget)

        return read


tree_reader = lru_cache(maxsize=512)(TreeReader)
"""Returns the reader of a definition, compiled once per type and md5."""


def _numbers_step(names: Sequence[str], fixed: struct.Struct) -> _FieldsReader:
    unpack, size = fixed.unpack_from, fixed.size

    def step(tree: MessageTree, wire: bytes, at: int, budget: Budget) -> int:
        tree.update(zip(names, unpack(wire, at)))
        return at + size

    return step


def _field_step(name: str, read: _ValueReader) -> _FieldsReader:
    def step(tree: MessageTree, wire: bytes, at: int, budget: Budget) -> int:
        tree[name], at = read(wire, at, budget)
        return at

    return step


def _string(wire: bytes, at: int, budget: Budget) -> tuple[TreeValue, int]:
    """Read a string, or a text in place of one that is too long; it is a _ValueReader."""
    (size,) = _length(wire, at)
    at += 4
    end = at + size
    if end > len(wire):
        raise short_buffer()
    if size > budget.text:
        budget.shortened = True
        return f"<string length: {_characters(wire, at, end)}>", end
    budget.charge(size)
    return wire[at:end].decode("utf-8", "replace"), end


def _characters(wire: bytes, at: int, end: int) -> int:
    """Return the number of characters, counted in pieces: a string may fill the whole message."""
    pieces = (wire[i : min(i + 65536, end)] for i in range(at, end, 65536))
    return sum(len(piece.translate(None, _CONTINUATION)) for piece in pieces)


def _time(code: str) -> _ValueReader:
    unpack = struct.Struct(code).unpack_from
    return lambda wire, at, budget: (dict(zip(("secs", "nsecs"), unpack(wire, at))), at + 8)


def _number_elements(field: Field) -> _ElementsReader:
    code, size = NUMBER_CODES[field.base], PRIMITIVE_SIZES[field.base]

    def read(wire: bytes, at: int, count: int, budget: Budget) -> tuple[TreeValue, int]:
        end = at + count * size
        if end > len(wire):
            raise short_buffer()
        if code == "B":
            budget.charge(count * budget.byte)
            return wire[at:end], end
        values = list(struct.unpack_from(f"<{count}{code}", wire, at))
        if count >= _MANY:  # JSON has no blanks after its commas
            budget.charge(len(str(values)) - count - count * _NUMBER)
        return values, end

    return read


def _elements(element: _ValueReader) -> _ElementsReader:
    def read(wire: bytes, at: int, count: int, budget: Budget) -> tuple[TreeValue, int]:
        values: list[TreeValue] = []
        for _ in range(count):
            value, at = element(wire, at, budget)
            values.append(value)
        return values, at

    return read
