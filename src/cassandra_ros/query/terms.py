# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A comparison as the server can check it: never stronger than what was asked.

Cassandra compares otherwise than we do: −0.0 is less than 0.0 and NaN more than all, a float32
column takes a double for the float32 nearest to it, and a bound beyond an integer column's range
is an error. So bounds go outwards to the next value that the column can hold; what it cannot
hold cannot match.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Optional, Sequence, Tuple

import numpy

from cassandra_ros.messages.wire.values import encode_value
from cassandra_ros.query.literals import Comparable

Term = Tuple[str, str, bytes]
"""Column, operator and encoded value."""
Ways = Optional[Tuple[Tuple[Term, ...], ...]]
"""Each way is a set of terms that all hold; what matches does so in one way at least. None: any row
may match. Empty: none can."""

NEVER: Ways = ()
_INTEGERS = {"tinyint": 8, "smallint": 16, "int": 32, "bigint": 64}
_FLOATS: Any = {"float": numpy.float32, "double": numpy.float64}


@dataclass(frozen=True)
class Held:
    """A column of a table, or one that carries an index."""

    column: str
    cql_type: str
    """Of one value."""
    many: bool = False
    """A list or set of values, which can only be asked for one that it contains."""
    longest: int = 0
    """Texts of more bytes may be missing, so that a range of texts is never asked for."""


def waysOf(held: Held, operator: str, values: Sequence[Comparable]) -> Ways:
    """Say how the server can check that a column compares so with one of some values.

    Args:
        held: The column.
        operator: One of = < <= > >= CONTAINS.
        values: One; for ``=`` and ``CONTAINS`` also several, of which one is to match.
    """
    if operator == "=" or (operator == "CONTAINS" and held.many):
        return _equal(held, "CONTAINS" if held.many else "=", values)
    if held.many or operator not in ("<", "<=", ">", ">="):
        return None
    return _bounded(held, operator, values[0])


def spanOf(held: Held, values: Sequence[Comparable]) -> Ways:
    """Say how the server can check that a number lies between the outermost of some."""
    numbers = [v for v in values if not isinstance(v, str) and v == v]
    if held.many or not numbers or len(numbers) < len(values):
        return None
    ways = [_bounded(held, ">=", min(numbers)), _bounded(held, "<=", max(numbers))]
    if NEVER in ways:
        return NEVER
    terms = tuple(term for way in ways for term in (way[0] if way else ()))
    return (terms,) if terms else None


def _equal(held: Held, operator: str, values: Sequence[Comparable]) -> Ways:
    ways: dict[tuple[Term, ...], None] = {}
    for value in values:
        raws = _exact(held, value)
        if raws is None:
            return None
        if len(raws) == 2 and not held.many:  # both zeros, in one query
            ways[(held.column, ">=", raws[0]), (held.column, "<=", raws[1])] = None
        else:
            ways.update(dict.fromkeys(((held.column, operator, raw),) for raw in raws))
    return tuple(ways)


def _exact(held: Held, value: Comparable) -> Optional[list[bytes]]:
    """Encode all that equals a value; None where the column may lack what does."""
    if held.cql_type == "text":
        return _text(held, value)
    if isinstance(value, str) or value != value:
        return []
    if held.cql_type == "boolean":
        return [encode_value("boolean", bool(value))] if value in (0, 1) else []
    if held.cql_type in _FLOATS:
        below, above = (_float(held.cql_type, value, upwards) for upwards in (True, False))
        if below == above:
            return [below]
        return [below, above] if value == 0 else []
    low, high = _range(held.cql_type)
    if not low <= value <= high or value != int(value):
        return []
    return [encode_value(held.cql_type, int(value))]


def _text(held: Held, value: Comparable) -> Optional[list[bytes]]:
    if not isinstance(value, str):
        return []
    try:
        raw = encode_value("text", value)
    except UnicodeEncodeError:
        return None
    return [raw] if len(raw) <= held.longest else None


def _bounded(held: Held, operator: str, value: Comparable) -> Ways:
    if isinstance(value, str) or held.cql_type in ("text", "boolean"):
        return None
    if value != value:
        return NEVER
    upwards = operator in (">", ">=")
    if held.cql_type in _FLOATS:
        raw = _float(held.cql_type, value, upwards)
        return (((held.column, operator[0] + "=", raw),),)
    low, high = _range(held.cql_type)
    if (value > high or (value == high and operator == ">")) if upwards else value < low:
        return NEVER
    if value <= low if upwards else value >= high:
        return None
    bound = math.ceil(value) if upwards else math.floor(value)
    return (((held.column, operator[0] + "=", encode_value(held.cql_type, bound)),),)


def _range(cql_type: str) -> tuple[int, int]:
    bits = _INTEGERS.get(cql_type)
    return (0, 2**64 - 1) if bits is None else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _float(cql_type: str, value: Comparable, upwards: bool) -> bytes:
    """Encode the nearest float that is not above (upwards) or not below a value."""
    kind = _FLOATS[cql_type]
    try:
        wide = float(value)
    except OverflowError:
        wide = math.inf if value > 0 else -math.inf  # type: ignore[operator]
    with numpy.errstate(over="ignore"):
        near = kind(wide)
        # As Python numbers, for they compare exactly.
        if (float(near) > value) if upwards else (float(near) < value):  # type: ignore[operator]
            near = numpy.nextafter(near, kind(-math.inf if upwards else math.inf))
    found = float(near)
    return encode_value(cql_type, found if found else (-0.0 if upwards else 0.0))
