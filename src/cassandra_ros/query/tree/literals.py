# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of literals to the values that fields are compared with.

Times are compared as integer nanoseconds: an int means nanoseconds, a decimal number seconds, text
ISO 8601. Numbers stay unchanged, because Python compares int and float exactly, and NaN as IEEE
754.
"""

from __future__ import annotations

import math
from contextlib import suppress
from decimal import Decimal
from numbers import Integral, Real
from typing import Any, Callable, Iterator, Union

import numpy as np

from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.stamps import length_object_ns, seconds_to_ns, to_ns
from cassandra_ros.query.tree.field_names import FieldRef
from cassandra_ros.query.tree.syntax import (
    DecimalText,
    DurationNs,
    Leaf,
    Literal,
    StatementError,
    TimeNs,
    given,
    value_text,
)

Comparable = Union[int, float, str]

BEYOND_NS = 10**29
"""Limit beyond all times and lengths, ns; also used for infinities."""


def fit_to_field(literal: Literal, ref: FieldRef) -> Comparable:
    """Return the value to compare a field with; StatementError: no such value."""
    return fit_to_kind(literal, ref.type, ref.name, f"a {ref.type}{'[]' if ref.is_array else ''}")


def fit_to_kind(literal: Literal, kind: str, name: str, is_a: str) -> Comparable:
    """Return the value to compare a value of a kind (a primitive ROS type, or INTEGER) with.

    ``name`` and ``is_a`` say in error texts what it is compared with. StatementError: the literal
    is of another kind.
    """
    if kind == "time":
        return fit_to_time(literal, name)
    fit, description = _FITS.get(kind, (_number, "a number"))
    value = fit(literal.value)
    if value is None:
        reason = f"{name} is {is_a}; compare it with {description}, not with {_show(literal.value)}"
        raise StatementError(literal.position, reason)
    return value


def fitting(leaf: Leaf, ref: FieldRef) -> Iterator[Comparable]:
    """Yield the values that a field is compared with, without those of another kind."""
    for literal in given(leaf):
        with suppress(StatementError):  # a literal of another kind equals no value of the field
            yield fit_to_field(literal, ref)


def fit_to_time(literal: Literal, name: str = "KEY") -> int:
    """Return the ns since 1970 of a literal; StatementError: not a time.

    Numbers may be outside ROS time: the comparison is then simply true or false.
    """
    if length_ns(literal.value) is not None:
        reason = f"{name} is a time, {literal.text} a duration; now() - {literal.text} would be one"
        raise StatementError(literal.position, reason)
    ns = _number_to_ns(literal.value)
    if ns is not None:
        return ns
    try:
        return to_ns(literal.value)
    except InvalidKey as exc:
        raise StatementError(literal.position, f"{name} is a time, but {exc}") from None


def fit_to_text(literal: Literal, name: str) -> str:
    """Return the text to compare NODE, or a KEY that is a name, with.

    StatementError: not a text.
    """
    if isinstance(literal.value, str):
        return literal.value
    reason = f"{name} is text; compare it with 'text', not {_show(literal.value)}"
    raise StatementError(literal.position, reason)


def _number(value: object) -> Comparable | None:
    if isinstance(value, (bool, TimeNs, DurationNs, np.timedelta64)):
        return None
    if isinstance(value, Integral):
        return int(value)
    return float(value) if isinstance(value, Real) else None


def _bool(value: object) -> Comparable | None:
    return value if isinstance(value, bool) else _number(value)


def _text(value: object) -> Comparable | None:
    return value if isinstance(value, str) else None


def _number_to_ns(value: object) -> int | None:
    """Return the ns of an int (nanoseconds) or another number (seconds); None: NaN, or no number.

    Seconds beyond all times, also infinite ones, become ±BEYOND_NS.
    """
    if isinstance(value, bool) or not isinstance(value, (Real, Decimal)):
        return None
    if isinstance(value, Integral):
        return int(value)
    try:
        rough = float(value)
        if abs(rough) > BEYOND_NS / 10**9:
            return int(math.copysign(1, rough)) * BEYOND_NS
        # The written seconds are used, because a float is only precise to 200 ns for today's times.
        exact = Decimal(value.text) if isinstance(value, DecimalText) else value
        return seconds_to_ns(exact)
    except (InvalidKey, ArithmeticError, TypeError):
        return None  # NaN


def length_ns(value: Any) -> int | None:
    """Return the ns of an object whose type is a length of time; None for other types.

    None also for a length that ns cannot express (NaT, or a part of a ns).
    """
    if isinstance(value, DurationNs):
        return int(value)
    with suppress(InvalidKey):
        return length_object_ns(value)
    return None


def _duration(value: Any) -> Comparable | None:
    ns = length_ns(value)
    # A TimeNs is an int, and numpy.timedelta64 is registered as one, but neither means ns here.
    if ns is not None or isinstance(value, (TimeNs, np.timedelta64)):
        return ns
    return _number_to_ns(value)


_FITS: dict[str, tuple[Callable[[object], Comparable | None], str]] = {
    "bool": (_bool, "true or false"),
    "string": (_text, "'text'"),
    "duration": (_duration, "500ms, say, or a number (integer nanoseconds, decimal seconds)"),
}
"""Conversion of a literal (None: of another kind) and accepted values for error texts, by field
type."""


def _show(value: object) -> str:
    if isinstance(value, str):
        return f"text {value[:40]!r}"
    return value_text(value) if isinstance(value, (bool, DurationNs)) else repr(value)[:60]
