# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Zone maps: minimum and maximum of each field over the messages of a block.

They bound the values that a condition compares: text as it is read (bytes that are not UTF-8
replaced), times as ns. NaN has no order and is left out. A minimum of zero is −0.0 and a maximum
0.0, because Cassandra distinguishes them. A long text is bounded by its beginning.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.cql_values import number_encoder
from cassandra_ros.messages.wire.field_ends import compile_skip
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.message_stacks import (
    NumberArray,
    Stack,
    by_size,
    read_numbers,
    stacker,
)
from cassandra_ros.messages.wire.wire_plan import wire_plan

MAX_FIELDS = 64
"""Maximum number of fields with bounds."""
MAX_BOUND_TEXT_BYTES = 64
"""Maximum size of a text that is stored as the minimum or maximum of a block, bytes."""
MAX_WALKED = 256
"""Maximum number of values of a message that is measured alone. Beyond it, numpy is faster."""
LOW, HIGH = "_min.", "_max."
"""Prefixes of the names of the zone columns, before the name of the field's column."""
_Candidates = Dict[str, List[Any]]
"""Candidate values for minimum and maximum, by field."""
_Ends = Tuple[Optional[bytes], Optional[bytes]]
"""Encoded minimum and maximum; None = unset, or (maximum) no text is great enough."""
_LAST = "\U0010ffff".encode("utf-8")
"""The greatest character, encoded."""


class Zones(NamedTuple):
    """Bounds of the values in a block."""

    values: Sequence[bytes | None]
    """Encoded bounds in the order of the zone columns; None = unset, because no message has a
    value."""
    nan: tuple[str, ...]
    """Names of the fields with a NaN value, sorted."""
    odd: bool
    """Whether a field may have values outside its bounds: the block must then always be read."""


NO_ZONES = Zones((), (), False)
"""The bounds where no field has any."""


class ZoneMap:
    """Computes the bounds of the fields of one message type. Threads share it.

    Attributes:
        fields: Columns of format ``ros`` whose fields have bounds, by name: fields of one value,
            also inside an array of messages; at most 64.
        columns: CQL type of the columns that hold the bounds, by name; two for each field.
    """

    def __init__(self, definition: Definition) -> None:
        plan = wire_plan(definition)
        able = [column for column in plan.all_columns if _has_bounds(column)]
        self.fields: dict[str, FieldColumn] = {c.name: c for c in able[:MAX_FIELDS]}
        self.columns = {
            prefix + name: column.element_type
            for name, column in self.fields.items()
            for prefix in (LOW, HIGH)
        }
        self._encoders = [(name, _ends_encoder(column)) for name, column in self.fields.items()]
        """Name of each field, and the function that encodes the ends of its values."""
        self._stacker = stacker(definition)
        self._read = plan.reader(list(self.fields))
        self._by_head = all(name in self._stacker.head for name in self.fields)
        """Whether all fields have the same offsets in messages of all sizes."""
        self._few = True
        """Whether no message that was measured alone had more than MAX_WALKED values. It only
        chooses the faster way, so threads need no lock for it."""
        self._skip = compile_skip(definition.type, definition.specs)
        self._texts = [name for name, column in self.fields.items() if column.kind == "text"]
        self._numbers: dict[str, list[str]] = {}
        """Field names by primitive type."""
        for name, column in self.fields.items():
            if column.kind != "text":
                self._numbers.setdefault(column.field_type, []).append(name)

    def measure(self, wires: Sequence[bytes]) -> Zones:
        """Return the bounds over some serialised messages; any bytes are accepted."""
        candidates: _Candidates = {name: [] for name in self.fields}
        nan: set[str] = set()
        if len(wires) == 1 and self._few:
            odd = not self._add_one(wires[0], candidates, nan)
            self._few = sum(map(len, candidates.values())) <= MAX_WALKED
        elif self._by_head and len(set(map(len, wires))) > 1:
            odd = self._add_heads(wires, candidates, nan)
        else:
            odd = self._add_sizes(wires, candidates, nan)
        zones: list[bytes | None] = []
        for name, encode in self._encoders:
            low, high = encode(candidates[name])
            # For these texts no upper bound can be stored, so they may lie above any value.
            odd = odd or (high is None and bool(candidates[name]))
            zones += (low, high)
        return Zones(zones, tuple(sorted(nan)), odd)

    def _add_heads(self, wires: Sequence[bytes], candidates: _Candidates, nan: set[str]) -> bool:
        """Add the bounds of messages of any size; return whether one is malformed."""
        stack = self._stacker.heads_of([wire for wire in wires if self._is_one(wire)])
        if len(stack.members):
            self._add_stack(stack, candidates, nan)
        return len(stack.members) < len(wires)

    def _is_one(self, wire: bytes) -> bool:
        """Return whether bytes are a well-formed message."""
        try:
            self._skip(wire, 0)
        except struct.error:
            return False
        return True

    def _add_sizes(self, wires: Sequence[bytes], candidates: _Candidates, nan: set[str]) -> bool:
        """Add the bounds of messages size by size; return whether one is malformed."""
        odd = False
        for members, planes in by_size(wires):
            stacks, rest = self._stacker.stacks(planes, members)
            for stack in stacks:
                self._add_stack(stack, candidates, nan)
            for n in rest.tolist():
                odd = not self._add_one(wires[n], candidates, nan) or odd
        return odd

    def _add_stack(self, stack: Stack, candidates: _Candidates, nan: set[str]) -> None:
        """Add the bounds of messages of one layout."""
        for name in self._texts:
            candidates[name] += [raw.decode("utf-8", "replace") for raw in stack.texts(name)]
        for base, names in self._numbers.items():
            ats = [stack.layout.numbers(name) for name in names]
            owners = [name for name, offsets in zip(names, ats) for _ in range(len(offsets))]
            if not owners:
                continue
            values = read_numbers(stack.planes, np.concatenate(ats), base)
            low, high, without = _ends(values)
            for name, *ends, is_nan, has_value in zip(owners, low, high, *without):
                if is_nan:
                    nan.add(name)
                if has_value:
                    candidates[name] += ends

    def _add_one(self, wire: bytes, candidates: _Candidates, nan: set[str]) -> bool:
        """Add the values of one message; return whether it is well-formed."""
        try:
            values = self._read(wire)
        except CorruptMessage:
            return False
        for column, value in zip(self.fields.values(), values):
            for element in value if column.is_list else (value,):
                if element == element:
                    candidates[column.name].append(element)
                else:
                    nan.add(column.name)
        return True


def _ends(values: NumberArray) -> tuple[list[Any], list[Any], tuple[list[bool], list[bool]]]:
    """Return for each row minimum, maximum, whether it has NaN, and whether it has other values."""
    nan = values != values if values.dtype.kind == "f" else None
    if nan is None or not nan.any():
        without = [False] * len(values), [True] * len(values)
        return values.min(axis=1).tolist(), values.max(axis=1).tolist(), without
    # numpy.fmin would forget the values before a signalling NaN.
    low = np.where(nan, np.inf, values).min(axis=1)
    high = np.where(nan, -np.inf, values).max(axis=1)
    return low.tolist(), high.tolist(), (nan.any(axis=1).tolist(), (~nan).any(axis=1).tolist())


def _has_bounds(column: FieldColumn) -> bool:
    """Return whether a field has one value in a message, or in an element of an array of them."""
    many = column.is_list and not column.array
    return not many and column.kind not in ("array", "wire")


def _ends_encoder(column: FieldColumn) -> Callable[[Sequence[Any]], _Ends]:
    """Return the function that encodes the minimum and maximum of values without NaN."""
    if column.kind == "text":
        return _text_ends
    encode, is_float = number_encoder(column.element_type), column.kind == "float"

    def ends(values: Sequence[Any]) -> _Ends:
        if not values:
            return None, None
        low, high = min(values), max(values)
        return encode(low or -0.0 if is_float else low), encode(high or 0.0 if is_float else high)

    return ends


def _text_ends(values: Sequence[str]) -> _Ends:
    """Return an encoded text that is not greater than the texts, and one that is not less."""
    return (_below(min(values)), _above(max(values))) if values else (None, None)


def _below(text: str) -> bytes:
    """Return a text of at most MAX_BOUND_TEXT_BYTES that is not greater, encoded."""
    raw = text.encode("utf-8")
    return raw if len(raw) <= MAX_BOUND_TEXT_BYTES else _head(raw)


def _above(text: str) -> bytes | None:
    """Return a text of at most MAX_BOUND_TEXT_BYTES that is not less, encoded; None = no such."""
    raw = text.encode("utf-8")
    if len(raw) <= MAX_BOUND_TEXT_BYTES:
        return raw
    head = _head(raw)
    # No text with this beginning is greater, unless it continues with the greatest character.
    return None if raw.startswith(_LAST, len(head)) else head + _LAST


def _head(raw: bytes) -> bytes:
    """Return the beginning of an encoded text, cut between characters, with space for _LAST."""
    return raw[: MAX_BOUND_TEXT_BYTES - len(_LAST)].decode("utf-8", "ignore").encode("utf-8")


zone_map = lru_cache(maxsize=512)(ZoneMap)
"""Returns the zone map of a definition, compiled once per type and md5."""
