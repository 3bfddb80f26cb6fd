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

What is computed (see ``computed``) and fields of one message compare with one another in the same
way. ``ANY(array) < x`` is true where it is for one element, ``ALL`` where it is for each of them,
also where there is none; NOT, IN and BETWEEN behind them ask about the element.

``NEAR`` is unknown where no pose of the robot is known at the time.
"""

from __future__ import annotations

import operator
import re
from functools import partial
from typing import Any, Callable, Optional, Pattern, Protocol, Sequence, Tuple, Union

from cassandra_ros.query.tree.expressions import Get
from cassandra_ros.query.tree.literals import Comparable
from cassandra_ros.query.tree.syntax import (
    All,
    Call,
    Compare,
    Comparison,
    Either,
    Expression,
    IsNull,
    Literal,
    Near,
    Negation,
    OneOf,
    Quantified,
    Relate,
    given,
)

Values = Sequence[Any]
"""The values of one message, or of one element of its array; None = missing."""
Check = Callable[[Values], Optional[bool]]


class Fields(Protocol):
    """What a condition names, in the rows of one table."""

    def locate(self, leaf: Comparison) -> Optional[int]:
        """Find the place of a comparison's operand among the values; None where there is none."""

    def whereabouts(self) -> Tuple[int, int, int]:
        """Return the places of nodeID, run and time among the values."""

    def compute(self, leaf: Comparison) -> Sequence[Optional[Get]]:
        """Return what computes the terms of a comparison, but for an operand with a place.

        None for what is missing here, or can never be compared.
        """

    def fit(self, leaf: Comparison, literal: Literal) -> Optional[Comparable]:
        """Fit a literal to its operand; None where it can never be compared."""


_SWAPPED = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.gt,
    "<=": operator.ge,
    ">": operator.lt,
    ">=": operator.le,
}
"""Their arguments are the other way round, so that ``partial`` can bind what is compared with."""


def compile_condition(expression: Optional[Expression], fields: Fields) -> Check:
    """Make a function that tells whether values satisfy a condition; None is always true."""
    if expression is None:
        return lambda values: True
    if isinstance(expression, Negation):
        return _negation(compile_condition(expression.item, fields))
    if isinstance(expression, (All, Either)):
        checks = [compile_condition(item, fields) for item in expression.items]
        return _joined(checks, isinstance(expression, Either))
    if isinstance(expression, Near):
        return _near(expression, *fields.whereabouts())
    if isinstance(expression, Relate):
        left, right = fields.compute(expression)
        return _related(expression.operator, left, right)
    if isinstance(expression, Quantified):
        return _quantified(expression, fields.locate(expression), fields.compute(expression))
    if not isinstance(expression.operand, Call):
        return _leaf(expression, fields.locate(expression), fields)
    (get,) = fields.compute(expression)
    if get is None:
        return _leaf(expression, None, fields)
    compute, check = get, _leaf(expression, 0, fields)
    return lambda values: check((compute(values),))


def _leaf(leaf: Union[Compare, OneOf, IsNull], place: Optional[int], fields: Fields) -> Check:
    if isinstance(leaf, IsNull):
        return (lambda values: True) if place is None else (lambda values: values[place] is None)
    listed = [fields.fit(leaf, value) for value in given(leaf)]
    if place is None:
        return lambda values: None
    if isinstance(leaf, Compare):
        return _comparison(place, leaf.operator, listed[0])
    return _membership(place, listed)


def _near(leaf: Near, node: int, run: int, time: int) -> Check:
    if leaf.stays is None:  # of a topic without tables: it has no rows
        return lambda values: None
    holds = leaf.stays.holds
    return lambda values: holds(values[node], values[run], values[time])


def _related(sign: str, left: Optional[Get], right: Optional[Get]) -> Check:
    if left is None or right is None:
        return lambda values: None
    first, second, test = left, right, _SWAPPED[sign]

    def check(values: Values) -> Optional[bool]:
        x, y = first(values), second(values)
        return None if x is None or y is None else bool(test(y, x))

    return check


def _quantified(leaf: Quantified, place: Optional[int], gets: Sequence[Optional[Get]]) -> Check:
    """ANY and ALL: of an array without elements ANY is false and ALL true."""
    known = [get for get in gets if get is not None]
    if place is None or len(known) < len(gets):
        return lambda values: None
    signs = [sign for sign, _ in leaf.tests]
    quantify = all if leaf.every else any
    fixed = None
    if all(isinstance(term, Literal) for _, term in leaf.tests):
        fixed = _element_test(leaf, [_test(s, get(())) for s, get in zip(signs, known)])

    def check(values: Values) -> Optional[bool]:
        array = values[place]
        if array is None:
            return None
        test = fixed
        if test is None:
            wanted = [get(values) for get in known]
            if any(value is None for value in wanted):
                return None
            test = _element_test(leaf, list(map(_test, signs, wanted)))
        return quantify(map(test, array))

    return check


def _element_test(
    leaf: Quantified, tests: Sequence[Callable[[Any], bool]]
) -> Callable[[Any], bool]:
    if len(tests) == 1 and not leaf.negated:
        return tests[0]
    join, negated = any if leaf.either else all, leaf.negated
    return lambda element: join([test(element) for test in tests]) is not negated


def _test(sign: str, wanted: Any) -> Callable[[Any], bool]:
    return _like(wanted) if sign == "LIKE" else partial(_SWAPPED[sign], wanted)


def _comparison(place: int, sign: str, wanted: Optional[Comparable]) -> Check:
    if wanted is None:
        return lambda values: None
    return _tested(place, _holding(wanted) if sign == "CONTAINS" else _test(sign, wanted))


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
