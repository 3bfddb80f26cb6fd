# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of a comparison to terms that the server checks; they are never stronger.

Cassandra compares differently: −0.0 is less than 0.0 and NaN greater than all numbers, a double
compared with a float32 column is rounded to a float32, and a bound outside an integer column's
range is an error. Therefore bounds are moved outwards to the next value of the column's type; a
value that the type cannot hold matches no row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from operator import ge, gt, le, lt
from typing import Any, Optional, Sequence, Tuple

import numpy

from cassandra_ros.messages.wire.cql_values import encode_value
from cassandra_ros.messages.wire.zones import HIGH, LOW
from cassandra_ros.query.tree.literals import Comparable

MAX_TERM_BYTES = 1024
"""Maximum size of a text that is compared with zones, bytes."""
ServerTerm = Tuple[str, str, bytes]
"""Column, operator and encoded value."""
Ways = Optional[Tuple[Tuple[ServerTerm, ...], ...]]
"""Alternatives; each is a set of terms that must all hold. A matching row satisfies at least one.
None: any row may match. Empty: no row can match."""

NEVER: Ways = ()
_BITS = {"tinyint": 8, "smallint": 16, "int": 32, "bigint": 64}
_RANGES = {cql_type: (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for cql_type, n in _BITS.items()}
_RANGES.update(boolean=(0, 1), varint=(0, 2**64 - 1))
_COMPARE = {"<": lt, "<=": le, ">": gt, ">=": ge}
_FLOATS: Any = {"float": numpy.float32, "double": numpy.float64}


@dataclass(frozen=True)
class ServerColumn:
    """A column of a table, or one that carries an index."""

    column: str
    cql_type: str
    """CQL type of one value."""
    many: bool = False
    """Whether it is a list or set of values; only CONTAINS can be checked on it."""
    longest: int = 0
    """Maximum size of a text that is certainly in the column, bytes. Because of this limit ranges
    of texts are not checked."""


def ways_of(held: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the terms for a comparison of a column (= < <= > >= CONTAINS) with values.

    ``=`` and ``CONTAINS`` may have several values, one of which must match.
    """
    if operator == "=" or (operator == "CONTAINS" and held.many):
        return _equal(held, "CONTAINS" if held.many else "=", values)
    if held.many or operator not in ("<", "<=", ">", ">="):
        return None
    return _bounded(held, operator, values[0])


def span_of(held: ServerColumn, values: Sequence[Comparable]) -> Ways:
    """Return the terms for a number between the minimum and maximum of some values."""
    numbers = [v for v in values if not isinstance(v, str) and v == v]
    if held.many or not numbers or len(numbers) < len(values):
        return None
    ways = [_bounded(held, ">=", min(numbers)), _bounded(held, "<=", max(numbers))]
    if NEVER in ways:
        return NEVER
    terms = tuple(term for way in ways for term in (way[0] if way else ()))
    return (terms,) if terms else None


def _equal(held: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    ways: dict[tuple[ServerTerm, ...], None] = {}
    for value in values:
        raws = _exact(held, value)
        if raws is None:
            return None
        if len(raws) == 2 and not held.many:  # one query for −0.0 and 0.0
            ways[(held.column, ">=", raws[0]), (held.column, "<=", raws[1])] = None
        else:
            ways.update(dict.fromkeys(((held.column, operator, raw),) for raw in raws))
    return tuple(ways)


def _exact(held: ServerColumn, value: Comparable) -> Optional[list[bytes]]:
    """Encode all values that equal one; None if the column may lack such a value."""
    if isinstance(value, str) != (held.cql_type == "text") or value != value:
        return []
    if isinstance(value, str):
        try:
            raw = encode_value("text", value)
        except UnicodeEncodeError:
            return None
        return [raw] if len(raw) <= held.longest else None
    if held.cql_type in _FLOATS:
        below, above = (_float(held.cql_type, value, upwards) for upwards in (True, False))
        if below == above:
            return [below]
        return [below, above] if value == 0 else []
    low, high = _RANGES[held.cql_type]
    if not low <= value <= high or value != int(value):
        return []
    return [encode_value(held.cql_type, int(value))]


def _bounded(held: ServerColumn, operator: str, value: Comparable) -> Ways:
    if isinstance(value, str) or held.cql_type in ("text", "boolean"):
        return None
    if value != value:
        return NEVER
    upwards = operator in (">", ">=")
    if held.cql_type in _FLOATS:
        raw = _float(held.cql_type, value, upwards)
        return (((held.column, operator[0] + "=", raw),),)
    low, high = _RANGES[held.cql_type]
    if (value > high or (value == high and operator == ">")) if upwards else value < low:
        return NEVER
    if value <= low if upwards else value >= high:
        return None
    bound = math.ceil(value) if upwards else math.floor(value)
    return (((held.column, operator[0] + "=", encode_value(held.cql_type, bound)),),)


def _float(cql_type: str, value: Comparable, upwards: bool) -> bytes:
    """Encode the nearest float that is not greater (upwards) or not less than a value."""
    kind = _FLOATS[cql_type]
    try:
        wide = float(value)
    except OverflowError:
        wide = math.inf if value > 0 else -math.inf  # type: ignore[operator]
    with numpy.errstate(over="ignore"):
        near = kind(wide)
        # Converted to Python numbers, which compare exactly.
        if (float(near) > value) if upwards else (float(near) < value):  # type: ignore[operator]
            near = numpy.nextafter(near, kind(-math.inf if upwards else math.inf))
    found = float(near)
    return encode_value(cql_type, found if found else (-0.0 if upwards else 0.0))


def zone_ways(held: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the terms on the zone columns for a block that may match a comparison.

    The zone columns hold the minimum and the maximum of the block.
    """
    if operator == "=":
        ways = [_zone_around(held, value, value) for value in values]
        if None in ways:
            return None
        return tuple(dict.fromkeys(way[0] for way in ways if way))
    if operator not in ("<", "<=", ">", ">="):
        return None
    return _zone_bounded(held, operator, values[0])


def zone_span(held: ServerColumn, values: Sequence[Comparable]) -> Ways:
    """Return the terms on the zone columns for values between the minimum and maximum of some."""
    fitting = [v for v in values if isinstance(v, str) == (held.cql_type == "text") and v == v]
    return _zone_around(held, min(fitting), max(fitting)) if fitting else NEVER


def _zone_around(held: ServerColumn, low: Comparable, high: Comparable) -> Ways:
    if low == high and held.cql_type != "text" and _exact(held, low) == []:
        return NEVER
    ways = [_zone_bounded(held, ">=", low), _zone_bounded(held, "<=", high)]
    if NEVER in ways:
        return NEVER
    terms = tuple(term for way in ways for term in (way[0] if way else ()))
    return (terms,) if terms else None


def _zone_bounded(held: ServerColumn, operator: str, value: Comparable) -> Ways:
    upwards = operator in (">", ">=")
    end = replace(held, column=(HIGH if upwards else LOW) + held.column)
    if isinstance(value, str) != (held.cql_type == "text"):
        return NEVER
    if isinstance(value, str):
        return _zone_text(end, operator, value)
    if held.cql_type != "boolean":
        return _bounded(end, operator, value)
    # A block has a value above false, or below true, only if that bound is the other value.
    wanted = 1 if upwards else 0
    if not (_COMPARE[operator](1, value) or _COMPARE[operator](0, value)):
        return NEVER
    if _COMPARE[operator](1 - wanted, value):
        return None
    return (((end.column, "=", encode_value("boolean", wanted)),),)


def _zone_text(end: ServerColumn, operator: str, value: str) -> Ways:
    try:
        raw = encode_value("text", value)
    except UnicodeEncodeError:
        return None
    if len(raw) > MAX_TERM_BYTES:
        return None
    return (((end.column, operator[0] + "=", raw),),)
