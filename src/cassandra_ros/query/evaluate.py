# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a condition means. Whatever the store filters, this has the last word on every row.

A comparison is true, false, or unknown where the value is missing: an array that is too short, a
field that this definition of the topic lacks, a message that cannot be read. NOT keeps unknown;
AND is false when one side is, OR true when one side is; only rows for which the whole is true
match. So what is missing never matches, also not under NOT.

Values compare as Python compares them: int with float exactly, NaN as IEEE 754 says (equal to
nothing, ``!=`` to everything), −0.0 equal to 0, text by code point, times as integer nanoseconds.
"""

from __future__ import annotations

import operator
from typing import Any, Callable, Optional, Sequence

from cassandra_ros.query.literals import Comparable
from cassandra_ros.query.syntax import All, Compare, Either, Expression, Literal, Negation, Operand

Values = Sequence[Any]
"""The values of one message, or of one element of its array; None = missing."""
Check = Callable[[Values], Optional[bool]]
Locate = Callable[[Operand], Optional[int]]
"""Finds the place of an operand's value among the values; None where there is none."""
Fit = Callable[[Operand, Literal], Optional[Comparable]]
"""Fits a literal to its operand; None where it can never be compared."""

_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def compileCondition(expression: Optional[Expression], locate: Locate, fit: Fit) -> Check:
    """Make a function that tells whether values satisfy a condition.

    Args:
        expression: The condition, bound; None is always true.
        locate: Finds the place of an operand's value.
        fit: Fits the literals.
    """
    if expression is None:
        return lambda values: True
    if isinstance(expression, Negation):
        return _negation(compileCondition(expression.item, locate, fit))
    if isinstance(expression, (All, Either)):
        checks = [compileCondition(item, locate, fit) for item in expression.items]
        return _joined(checks, isinstance(expression, Either))
    place = locate(expression.operand)
    given = (expression.value,) if isinstance(expression, Compare) else expression.values
    listed = [fit(expression.operand, v) for v in given if isinstance(v, Literal)]
    if isinstance(expression, Compare):
        return _comparison(place, _OPERATORS[expression.operator], listed[0])
    return _membership(place, [value for value in listed if value is not None])


def _unknown(values: Values) -> Optional[bool]:
    return None


def _comparison(place: Optional[int], compare: Any, wanted: Optional[Comparable]) -> Check:
    if place is None or wanted is None:
        return _unknown

    def check(values: Values) -> Optional[bool]:
        value = values[place]
        return None if value is None else compare(value, wanted)

    return check


def _membership(place: Optional[int], listed: list[Comparable]) -> Check:
    if place is None:
        return _unknown
    # NaN equals nothing, yet a set finds it by identity.
    members = frozenset(value for value in listed if value == value)

    def check(values: Values) -> Optional[bool]:
        value = values[place]
        return None if value is None else value in members

    return check


def _negation(inner: Check) -> Check:
    def check(values: Values) -> Optional[bool]:
        found = inner(values)
        return None if found is None else not found

    return check


def _joined(checks: list[Check], decisive: bool) -> Check:
    """AND (decisive False) or OR (decisive True): one decisive part decides."""

    def check(values: Values) -> Optional[bool]:
        result: Optional[bool] = not decisive
        for part in checks:
            found = part(values)
            if found is decisive:
                return decisive
            if found is None:
                result = None
        return result

    return check
