# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From wire bytes to a tree of plain values, as the text formats print it.

A message is a dict by the definition's field names, a time or duration a dict of secs and nsecs,
uint8[] and char[] are bytes, other arrays lists. What is too long for a text is never read: the
tree has the words of ``rostopic echo --noarr`` in its place.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Callable, Dict, Mapping, NamedTuple, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import PRIMITIVE_SIZES, Field, MessageSpec
from cassandra_ros.messages.tree.fields import (
    NUMBER_CODES,
    TIME_CODES,
    TIME_NAMES,
    isBytes,
    numberRuns,
    runStruct,
)
from cassandra_ros.messages.wire.skip import WIRE_ERRORS, compileFieldSkip, shortBuffer

Tree = Dict[str, Any]

# The least that things take in any text, in characters: what the budget is charged.
_NUMBER = 2
_FIELD = 4
_TIME = 10
_MANY = 1024
"""Numbers in an array from which it pays to look how long their text is."""


class TooLong(Exception):  # noqa: N818 - not an error: the next limits are tried
    """The text of a message would exceed the budget of its reader."""


class Budget:
    """What a tree may hold.

    Args:
        characters: Of the text; reading stops as soon as it must become longer.
        byte: What a byte of uint8[] or char[] takes at least, in characters.
        elements: Longer arrays are not read, only counted.
        text: Longer strings are not read, only counted; in bytes.
    """

    __slots__ = ("byte", "elements", "left", "shortened", "text")

    def __init__(self, characters: int, byte: int, elements: int, text: int) -> None:
        self.left = characters
        self.byte = byte
        self.elements = elements
        self.text = text
        self.shortened = False

    def charge(self, characters: int) -> None:
        """Take characters off.

        Raises:
            TooLong: There are not so many left.
        """
        self.left -= characters
        if self.left < 0:
            raise TooLong


class ReadTree(NamedTuple):
    """A message as plain values."""

    tree: Tree
    shortened: bool
    """Whether words stand in place of some array or string."""


_Read = Callable[[bytes, int, Budget], Tuple[Any, int]]
"""(wire bytes, offset, budget) -> value, offset behind it."""
_Step = Callable[[Tree, bytes, int, Budget], int]
"""(tree to fill, wire bytes, offset, budget) -> offset behind the fields."""
_Memo = Dict[str, Tuple[_Read, int]]

_length = struct.Struct("<I").unpack_from
_CONTINUATION = bytes(range(0x80, 0xC0))


class TreeReader:
    """Reads messages of one type, compiled from its definition."""

    def __init__(self, definition: Definition) -> None:
        self.type = definition.type
        self._read, self._weight = _message(definition.type, definition.specs, {})

    def read(self, wire: bytes, budget: Budget) -> ReadTree | None:
        """Return the tree of a message; surplus bytes are ignored, bad UTF-8 becomes U+FFFD.

        Args:
            wire: Any bytes.
            budget: A new one; it bounds memory and time.

        Returns:
            The tree, None where its text certainly has more characters.

        Raises:
            CorruptMessage: The bytes end before the message does.
        """
        try:
            budget.charge(self._weight)
            tree, _ = self._read(wire, 0, budget)
        except TooLong:
            return None
        except WIRE_ERRORS as exc:
            raise CorruptMessage(f"{len(wire)} bytes are no {self.type}: {exc}") from exc
        return ReadTree(tree, budget.shortened)


@lru_cache(maxsize=512)
def treeReader(definition: Definition) -> TreeReader:
    """Return the reader of a definition, compiled once per type and md5."""
    return TreeReader(definition)


def _message(name: str, specs: Mapping[str, MessageSpec], memo: _Memo) -> tuple[_Read, int]:
    """Return the reader of a message and what its text takes at least, arrays aside."""
    if name not in memo:
        weight = 0
        steps: list[_Step] = []
        for run in numberRuns(specs[name].fields):
            fixed = runStruct(run)
            if fixed is not None:
                weight += _FIELD * len(run)
                steps.append(_numbers_step([field.name for field in run], fixed))
            else:
                read, least = _field(run[0], specs, memo)
                weight += max(least, _FIELD)
                steps.append(_field_step(run[0].name, read))
        memo[name] = _fields(steps), max(weight, _FIELD)
    return memo[name]


def _fields(steps: Sequence[_Step]) -> _Read:
    def read(wire: bytes, at: int, budget: Budget) -> tuple[Tree, int]:
        tree: Tree = {}
        for step in steps:
            at = step(tree, wire, at, budget)
        return tree, at

    return read


def _numbers_step(names: Sequence[str], fixed: struct.Struct) -> _Step:
    unpack, size = fixed.unpack_from, fixed.size

    def step(tree: Tree, wire: bytes, at: int, budget: Budget) -> int:
        tree.update(zip(names, unpack(wire, at)))
        return at + size

    return step


def _field_step(name: str, read: _Read) -> _Step:
    def step(tree: Tree, wire: bytes, at: int, budget: Budget) -> int:
        tree[name], at = read(wire, at, budget)
        return at

    return step


def _field(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> tuple[_Read, int]:
    if field.is_array:
        return _array(field, specs, memo), 0
    if field.type == "string":
        return _string, 0
    if field.type in TIME_CODES:
        return _time(TIME_CODES[field.type]), _TIME
    return _message(field.type, specs, memo)


def _string(wire: bytes, at: int, budget: Budget) -> tuple[str, int]:
    (size,) = _length(wire, at)
    at += 4
    end = at + size
    if end > len(wire):
        raise shortBuffer()
    if size > budget.text:
        budget.shortened = True
        return f"<string length: {_characters(wire, at, end)}>", end
    budget.charge(size)
    return wire[at:end].decode("utf-8", "replace"), end


def _characters(wire: bytes, at: int, end: int) -> int:
    """Count characters piece by piece: a string may be as large as a message."""
    pieces = (wire[i : min(i + 65536, end)] for i in range(at, end, 65536))
    return sum(len(piece.translate(None, _CONTINUATION)) for piece in pieces)


def _time(code: str) -> _Read:
    unpack = struct.Struct(code).unpack_from

    def read(wire: bytes, at: int, budget: Budget) -> tuple[Tree, int]:
        return dict(zip(TIME_NAMES, unpack(wire, at))), at + 8

    return read


_Elements = Callable[[bytes, int, int, Budget], Tuple[Any, int]]
"""(wire bytes, offset, number of elements, budget) -> value, offset behind it."""


def _array(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> _Read:
    length, skip, read_elements = field.length, compileFieldSkip(field, specs), None
    if field.base in NUMBER_CODES:
        weight = 0 if isBytes(field) else _NUMBER
        read_elements = _number_elements(field)
    else:
        element, least = _field(Field(field.name, field.type), specs, memo)
        weight, read_elements = max(least, _NUMBER), _elements(element)

    def read(wire: bytes, at: int, budget: Budget) -> tuple[Any, int]:
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


def _number_elements(field: Field) -> _Elements:
    code, size = NUMBER_CODES[field.base], PRIMITIVE_SIZES[field.base]

    def read(wire: bytes, at: int, count: int, budget: Budget) -> tuple[Any, int]:
        end = at + count * size
        if end > len(wire):
            raise shortBuffer()
        if code == "B":
            budget.charge(count * budget.byte)
            return wire[at:end], end
        values = list(struct.unpack_from(f"<{count}{code}", wire, at))
        if count >= _MANY:  # JSON has no blanks behind its commas
            budget.charge(len(str(values)) - count - count * _NUMBER)
        return values, end

    return read


def _elements(element: _Read) -> _Elements:
    def read(wire: bytes, at: int, count: int, budget: Budget) -> tuple[Any, int]:
        values = []
        for _ in range(count):
            value, at = element(wire, at, budget)
            values.append(value)
        return values, at

    return read
