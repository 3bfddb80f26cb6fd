# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a condition means. Whatever the store filters, this has the last word on every row.

A comparison is true, false, or unknown where the value is missing: an array that is too short, a
field that this definition of the topic lacks, a message that cannot be read. NOT keeps unknown;
AND is false when one side is, OR true when one side is; only rows for which the whole is true
match. So what is missing never matches, also not under NOT. ``IS NULL`` alone is never unknown:
it is true for what is missing. NaN, '' and an empty array are values. An array of messages without
elements gives no row, so that nothing inside it is null either.

Values compare as Python compares them: int with float exactly, NaN as IEEE 754 says (equal to
nothing, ``!=`` to everything), −0.0 equal to 0, text by code point, times as integer nanoseconds.
``CONTAINS`` compares each element of an array of primitives so; ``LIKE`` the whole text with a
pattern, in which ``%`` stands for any text, also none, ``_`` for exactly one code point, everything
else for itself; there is no escape character, and upper and lower case differ.
"""

from __future__ import annotations

import operator
import re
from functools import partial
from typing import Any, Callable, Optional, Pattern, Sequence

from cassandra_ros.query.literals import Comparable
from cassandra_ros.query.syntax import (
    All,
    Compare,
    Either,
    Expression,
    IsNull,
    Leaf,
    Literal,
    Negation,
    given,
)

Values = Sequence[Any]
"""The values of one message, or of one element of its array; None = missing."""
Check = Callable[[Values], Optional[bool]]
Locate = Callable[[Leaf], Optional[int]]
"""Finds the place of a comparison's operand among the values; None where there is none."""
Fit = Callable[[Leaf, Literal], Optional[Comparable]]
"""Fits a literal to its operand; None where it can never be compared."""

_SWAPPED = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.gt,
    "<=": operator.ge,
    ">": operator.lt,
    ">=": operator.le,
}
"""Their arguments are the other way round, so that ``partial`` can bind what is compared with."""


def compile_condition(expression: Optional[Expression], locate: Locate, fit: Fit) -> Check:
    """Make a function that tells whether values satisfy a condition; None is always true."""
    if expression is None:
        return lambda values: True
    if isinstance(expression, Negation):
        return _negation(compile_condition(expression.item, locate, fit))
    if isinstance(expression, (All, Either)):
        checks = [compile_condition(item, locate, fit) for item in expression.items]
        return _joined(checks, isinstance(expression, Either))
    place = locate(expression)
    if isinstance(expression, IsNull):
        return (lambda values: True) if place is None else (lambda values: values[place] is None)
    listed = [fit(expression, value) for value in given(expression)]
    if place is None:
        return lambda values: None
    if isinstance(expression, Compare):
        return _comparison(place, expression.operator, listed[0])
    return _membership(place, listed)


def _comparison(place: int, sign: str, wanted: Optional[Comparable]) -> Check:
    if wanted is None:
        return lambda values: None
    if sign == "LIKE":
        return _tested(place, _like(str(wanted)))
    if sign == "CONTAINS":
        return _tested(place, _holding(wanted))
    return _tested(place, partial(_SWAPPED[sign], wanted))


def _membership(place: int, listed: Sequence[Optional[Comparable]]) -> Check:
    """``IN``: as ``=`` with each value, joined by OR."""
    # NaN equals nothing, yet a set finds it by identity.
    members = frozenset(value for value in listed if value is not None and value == value)
    otherwise = None if None in listed else False  # of another kind: unknown

    def check(values: Values) -> Optional[bool]:
        value = values[place]
        return None if value is None else value in members or otherwise

    return check


def _tested(place: int, test: Callable[[Any], bool]) -> Check:
    def check(values: Values) -> Optional[bool]:
        value = values[place]
        return None if value is None else test(value)

    return check


def _like(pattern: str) -> Callable[[str], bool]:
    """Return a function that tells whether the whole of a text matches a pattern of LIKE.

    Its time is at worst that of text times pattern, whatever the pattern: one regular expression
    with several ``.*`` could take for ever, so each piece between two ``%`` is looked for by
    itself, where it comes first.
    """
    pieces = pattern.split("%")
    head, tail = _piece(pieces[0]), _piece(pieces[-1])
    if len(pieces) == 1:
        return lambda text: head.fullmatch(text) is not None
    middle = [_piece(piece) for piece in pieces[1:-1] if piece]

    def test(text: str) -> bool:
        found = head.match(text)
        for piece in middle:
            if found is None:
                return False
            found = piece.search(text, found.end())
        last = len(text) - len(pieces[-1])
        return found is not None and found.end() <= last and tail.match(text, last) is not None

    return test


def _piece(text: str) -> Pattern[str]:
    return re.compile("".join("." if c == "_" else re.escape(c) for c in text), re.DOTALL)


def _holding(wanted: Comparable) -> Callable[[Any], bool]:
    if wanted != wanted:
        return lambda array: False
    # Bytes take ints alone, and only those that a byte can be.
    byte = isinstance(wanted, (int, float)) and 0 <= wanted <= 255 and wanted == int(wanted)

    def test(array: Any) -> bool:
        if isinstance(array, (bytes, bytearray)):
            return byte and int(wanted) in array
        return wanted in array

    return test


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
