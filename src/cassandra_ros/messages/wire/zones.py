# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Zone maps: the least and the greatest value of each field over the messages of a block.

They bound what a condition sees of a field: text as it is read (what is no UTF-8 replaced), times
as ns. NaN is in no order and left out; zeros are −0.0 below and 0.0 above, for Cassandra tells
them apart. A long text is bounded by what it begins with.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.plan import wire_plan
from cassandra_ros.messages.wire.values import encode_value

MAX_FIELDS = 64
MAX_TEXT_BYTES = 64
LOW, HIGH = "_min.", "_max."
"""What the names of the columns begin with; the field's column follows."""
_LAST = "\U0010ffff".encode("utf-8")
"""Above all other characters."""


class Zones(NamedTuple):
    """What is known of the values in a block."""

    values: Sequence[Optional[bytes]]
    """Encoded, in the order of the zone columns; None = unset, for there is no value."""
    nan: Tuple[str, ...]
    """Fields of which a value is NaN, sorted."""
    odd: bool
    """Some field may have values that the zones do not bound: read the block in any case."""


class ZoneMap:
    """Finds the bounds of the fields of one message type.

    Attributes:
        fields: The fields that have bounds, by their column of format ``ros``: those of one value,
            also inside of an array of messages; at most 64.
        columns: Name and CQL type of the columns that hold the bounds, two for each field.
    """

    def __init__(self, definition: Definition) -> None:
        self._plan = wire_plan(definition)
        able = [column for column in self._plan.all_columns if _has_bounds(column)]
        self.fields: Dict[str, FieldColumn] = {c.name: c for c in able[:MAX_FIELDS]}
        self._names = list(self.fields)
        self.columns = {
            prefix + name: column.element_type
            for name, column in self.fields.items()
            for prefix in (LOW, HIGH)
        }
        self._read = self._plan.reader(self._names)

    def measure(self, wires: Sequence[bytes]) -> Zones:
        """Find the bounds over some serialised messages; any bytes will do."""
        found: List[List[Any]] = [[] for _ in self._names]
        odd = False
        for wire in wires:
            try:
                values = self._read(wire)
            except CorruptMessage:
                odd = True
                continue
            for column, gathered, value in zip(self.fields.values(), found, values):
                gathered.extend(value if column.is_list else (value,))
        zones: List[Optional[bytes]] = []
        nan = []
        for name, values in zip(self._names, found):
            column = self.fields[name]
            real = [value for value in values if value == value]
            if len(real) < len(values):
                nan.append(name)
            low, high = bounds(column, real)
            odd = odd or (high is None and bool(real))
            zones += (low, high)
        return Zones(zones, tuple(sorted(nan)), odd)


def _has_bounds(column: FieldColumn) -> bool:
    many = column.is_list and not column.array
    return not many and column.kind not in ("array", "wire")


def bounds(column: FieldColumn, values: Iterable[Any]) -> Tuple[Optional[bytes], Optional[bytes]]:
    """Encode the least and the greatest of some values, without NaN; None: there is none."""
    every = list(values)
    if not every:
        return None, None
    low, high = min(every), max(every)
    if column.kind == "text":
        return _below(low), _above(high)
    if column.kind == "float":
        low, high = low or -0.0, high or 0.0
    return encode_value(column.element_type, low), encode_value(column.element_type, high)


def _below(text: str) -> bytes:
    raw = text.encode("utf-8")
    return raw if len(raw) <= MAX_TEXT_BYTES else _head(raw)


def _above(text: str) -> Optional[bytes]:
    raw = text.encode("utf-8")
    if len(raw) <= MAX_TEXT_BYTES:
        return raw
    head = _head(raw)
    # Nothing that begins so is greater, unless it goes on with the last character itself.
    return None if raw.startswith(_LAST, len(head)) else head + _LAST


def _head(raw: bytes) -> bytes:
    return raw[: MAX_TEXT_BYTES - len(_LAST)].decode("utf-8", "ignore").encode("utf-8")


zone_map = lru_cache(maxsize=512)(ZoneMap)
"""Returns the zone map of a definition, compiled once per type and md5."""
