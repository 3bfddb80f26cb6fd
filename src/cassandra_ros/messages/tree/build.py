# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From a tree of plain values back to wire bytes: the inverse of ``tree``, built the same way.

Trees come from texts that anybody may have changed: all that is no message of the type is refused.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from operator import itemgetter
from typing import Any, Callable, Dict, List, Mapping, Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Field, MessageSpec
from cassandra_ros.messages.tree.fields import (
    NUMBER_CODES,
    TIME_CODES,
    TIME_NAMES,
    isBytes,
    numberRuns,
    runStruct,
)
from cassandra_ros.messages.wire.lists import SECOND_NS

AsBytes = Callable[[Any], bytes]
"""From what a text holds for uint8[] and char[] to their bytes; raises ValueError, TypeError."""

_Write = Callable[[Any, List[bytes]], None]
"""(value, bytes so far) -> nothing."""
_Memo = Dict[str, _Write]

_ERRORS = (
    struct.error,
    AttributeError,
    KeyError,
    OverflowError,
    TypeError,
    ValueError,
    RecursionError,
)
_pack_length = struct.Struct("<I").pack


def plainBytes(value: Any) -> bytes:
    """Return the bytes of uint8[] or char[], given as such or as a list of numbers.

    Raises:
        ValueError, TypeError: They are neither.
    """
    if type(value) is bytes:
        return value
    values = _list(value, None)
    _check_bools(values, False)
    return bytes(values)


@lru_cache(maxsize=512)
def treeBuilder(
    definition: Definition, as_bytes: AsBytes = plainBytes
) -> Callable[[object], bytes]:
    """Return the function from trees of a definition to wire bytes, compiled once.

    It takes any object and raises CorruptMessage: fields are missing, there are others, a number
    is out of range, nsecs are not within a second, an array has another length, ...
    """
    write = _message(definition.type, definition.specs, as_bytes, {})

    def build(tree: object) -> bytes:
        parts: list[bytes] = []
        try:
            write(tree, parts)
        except _ERRORS as exc:
            reason = f"{type(exc).__name__}: {str(exc)[:200]}"
            raise CorruptMessage(f"a text is no {definition.type}: {reason}") from exc
        return b"".join(parts)

    return build


def _list(value: Any, length: int | None) -> list[Any]:
    if type(value) is not list or length not in (None, len(value)):
        raise ValueError("an array is no list of its length")
    return value


def _message(name: str, specs: Mapping[str, MessageSpec], as_bytes: AsBytes, memo: _Memo) -> _Write:
    if name not in memo:
        fields = specs[name].fields
        steps: list[_Write] = []
        for run in numberRuns(fields):
            fixed = runStruct(run)
            if fixed is not None:
                steps.append(_numbers_step(run, fixed))
            else:
                steps.append(_field_step(run[0].name, _field(run[0], specs, as_bytes, memo)))
        memo[name] = _fields(steps, len(fields))
    return memo[name]


def _fields(steps: Sequence[_Write], count: int) -> _Write:
    def write(tree: Any, parts: list[bytes]) -> None:
        _check_dict(tree, count)
        for step in steps:
            step(tree, parts)

    return write


def _check_dict(tree: Any, count: int) -> None:
    if type(tree) is not dict or len(tree) != count:
        raise ValueError(f"a message is no mapping of its {count} fields")


def _field_step(name: str, write: _Write) -> _Write:
    def step(tree: Any, parts: list[bytes]) -> None:
        write(tree[name], parts)

    return step


def _numbers_step(run: Sequence[Field], fixed: struct.Struct) -> _Write:
    pick = itemgetter(*(field.name for field in run))
    pack, single, bools = fixed.pack, len(run) == 1, run[0].type == "bool"

    def step(tree: Any, parts: list[bytes]) -> None:
        values = (pick(tree),) if single else pick(tree)
        _check_bools(values, bools)
        parts.append(pack(*values))

    return step


def _check_bools(values: Sequence[Any], bools: bool) -> None:
    if bools:  # struct takes anything for a bool, and bools for numbers
        if not all(type(value) is bool for value in values):
            raise ValueError("a bool is neither true nor false")
    elif bool in map(type, values):
        raise ValueError("a number is true or false")


def _field(
    field: Field, specs: Mapping[str, MessageSpec], as_bytes: AsBytes, memo: _Memo
) -> _Write:
    if field.is_array:
        return _array(field, specs, as_bytes, memo)
    if field.type == "string":
        return _string
    if field.type in TIME_CODES:
        return _time(TIME_CODES[field.type])
    return _message(field.type, specs, as_bytes, memo)


def _string(value: Any, parts: list[bytes]) -> None:
    data = value.encode()
    parts.append(_pack_length(len(data)))
    parts.append(data)


def _time(code: str) -> _Write:
    pack, pick = struct.Struct(code).pack, itemgetter(*TIME_NAMES)

    def write(tree: Any, parts: list[bytes]) -> None:
        _check_dict(tree, 2)
        values = pick(tree)
        _check_bools(values, False)
        if not 0 <= values[1] < SECOND_NS:
            raise ValueError("nsecs are not within a second")
        parts.append(pack(*values))

    return write


def _array(
    field: Field, specs: Mapping[str, MessageSpec], as_bytes: AsBytes, memo: _Memo
) -> _Write:
    if isBytes(field):
        return _bytes(field.length, as_bytes)
    if field.base in NUMBER_CODES:
        return _numbers(NUMBER_CODES[field.base], field.length)
    length, element = field.length, _field(Field(field.name, field.type), specs, as_bytes, memo)

    def write(value: Any, parts: list[bytes]) -> None:
        values = _list(value, length)
        if length is None:
            parts.append(_pack_length(len(values)))
        for one in values:
            element(one, parts)

    return write


def _bytes(length: int | None, as_bytes: AsBytes) -> _Write:
    def write(value: Any, parts: list[bytes]) -> None:
        data = as_bytes(value)
        if length is None:
            parts.append(_pack_length(len(data)))
        elif len(data) != length:
            raise ValueError("an array has another length than its field")
        parts.append(data)

    return write


def _numbers(code: str, length: int | None) -> _Write:
    def write(value: Any, parts: list[bytes]) -> None:
        values = _list(value, length)
        _check_bools(values, code == "?")
        if length is None:
            parts.append(_pack_length(len(values)))
        parts.append(struct.pack(f"<{len(values)}{code}", *values))

    return write
