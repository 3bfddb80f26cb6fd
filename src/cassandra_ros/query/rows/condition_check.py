# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Meaning of conditions: the final check of every row, whatever the store has filtered.

A comparison is true, false, or unknown if a value is missing: an index beyond the end of an array,
a field that the message's definition lacks, an unreadable message. NOT of unknown is unknown; AND
is false if one side is false, OR true if one side is true. Only rows for which the whole condition
is true match. So a missing value never matches, not even under NOT. Only ``IS NULL`` is never
unknown: it is true for a missing value. NaN, '' and an empty array are values. An unnested array of
messages without elements gives no row, so that its fields are not null either.

Values compare as in Python: int with float exactly, NaN as in IEEE 754 (equal to nothing, ``!=`` to
everything), −0.0 equal to 0, text by code points, times as integer nanoseconds. ``CONTAINS``
compares each element of an array of primitives in this way. ``LIKE`` compares the whole text with a
pattern: ``%`` stands for any text, also the empty one, ``_`` for exactly one code point, every
other character for itself. There is no escape character, and case matters.

Computed values (see ``tree/expressions``) and fields of the same message compare in the same way.
``ANY(array) < x`` is true if the comparison is true for one element, ``ALL`` if it is true for
every element, also of an empty array. NOT, IN and BETWEEN after them apply to the element.

``NEAR`` is unknown if no pose of the robot is known at the time.
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

RowValues = Sequence[Any]
"""Values of one message, or of one element of its unnested array; None = missing."""
Check = Callable[[RowValues], Optional[bool]]


class ConditionNames(Protocol):
    """Lookup of the names in a condition, for the rows of one table."""

    def locate(self, leaf: Comparison) -> Optional[int]:
        """Return the index of a comparison's operand among the values; None if it has no index."""

    def whereabouts(self) -> Tuple[int, int, int]:
        """Return the indices of nodeID, run and time among the values."""

    def compute(self, leaf: Comparison) -> Sequence[Optional[Get]]:
        """Return the functions of a comparison's terms, except of an operand with an index.

        None stands for a term that is missing in this table, or cannot be compared.
        """

    def fit(self, leaf: Comparison, literal: Literal) -> Optional[Comparable]:
        """Convert a literal for comparison with its operand; None if they cannot be compared."""


_SWAPPED = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.gt,
    "<=": operator.ge,
    ">": operator.lt,
    ">=": operator.le,
}
"""Operators with swapped arguments, so that ``partial`` can bind the right operand."""


def compile_condition(expression: Optional[Expression], fields: ConditionNames) -> Check:
    """Return the function from values to the truth of a condition; None is always true."""
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


def _leaf(
    leaf: Union[Compare, OneOf, IsNull], place: Optional[int], fields: ConditionNames
) -> Check:
    if isinstance(leaf, IsNull):
        return (lambda values: True) if place is None else (lambda values: values[place] is None)
    listed = [fields.fit(leaf, value) for value in given(leaf)]
    if place is None:
        return lambda values: None
    if isinstance(leaf, Compare):
        return _comparison(place, leaf.operator, listed[0])
    return _membership(place, listed)


def _near(leaf: Near, node: int, run: int, time: int) -> Check:
    if leaf.stays is None:  # the topic has no tables, and therefore no rows
        return lambda values: None
    holds = leaf.stays.holds
    return lambda values: holds(values[node], values[run], values[time])


def _related(sign: str, left: Optional[Get], right: Optional[Get]) -> Check:
    if left is None or right is None:
        return lambda values: None
    first, second, test = left, right, _SWAPPED[sign]

    def check(values: RowValues) -> Optional[bool]:
        x, y = first(values), second(values)
        return None if x is None or y is None else bool(test(y, x))

    return check


def _quantified(leaf: Quantified, place: Optional[int], gets: Sequence[Optional[Get]]) -> Check:
    """Return the check of ANY or ALL. For an empty array ANY is false and ALL true."""
    known = [get for get in gets if get is not None]
    if place is None or len(known) < len(gets):
        return lambda values: None
    signs = [sign for sign, _ in leaf.tests]
    quantify = all if leaf.every else any
    fixed = None
    if all(isinstance(term, Literal) for _, term in leaf.tests):
        fixed = _element_test(leaf, [_test(s, get(())) for s, get in zip(signs, known)])

    def check(values: RowValues) -> Optional[bool]:
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
    """Return the check of IN: like ``=`` with each value, joined by OR."""
    # NaN is left out: it equals nothing, but a set would find it by identity.
    members = frozenset(value for value in listed if value is not None and value == value)
    otherwise = (
        None if None in listed else False
    )  # a value of another kind makes the result unknown

    def check(values: RowValues) -> Optional[bool]:
        value = values[place]
        return None if value is None else value in members or otherwise

    return check


def _tested(place: int, test: Callable[[Any], bool]) -> Check:
    def check(values: RowValues) -> Optional[bool]:
        value = values[place]
        return None if value is None else test(value)

    return check


def _like(pattern: str) -> Callable[[str], bool]:
    """Return the function that matches a whole text with a pattern of LIKE.

    Its time is at most proportional to text times pattern. One regular expression with several
    ``.*`` could take exponential time, so each piece between two ``%`` is searched separately,
    at its first occurrence.
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
    # ``in`` accepts only ints from 0 to 255 for bytes.
    byte = isinstance(wanted, (int, float)) and 0 <= wanted <= 255 and wanted == int(wanted)

    def test(array: Any) -> bool:
        if isinstance(array, (bytes, bytearray)):
            return byte and int(wanted) in array
        return wanted in array

    return test


def _negation(inner: Check) -> Check:
    def check(values: RowValues) -> Optional[bool]:
        found = inner(values)
        return None if found is None else not found

    return check


def _joined(checks: list[Check], decisive: bool) -> Check:
    """Return the check of AND (decisive False) or OR (decisive True): one decisive part decides."""

    def check(values: RowValues) -> Optional[bool]:
        result: Optional[bool] = not decisive
        for part in checks:
            found = part(values)
            if found is decisive:
                return decisive
            if found is None:
                result = None
        return result

    return check
