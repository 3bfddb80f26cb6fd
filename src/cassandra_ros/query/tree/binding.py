# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Binding of parameter values to a statement, and computation of constant expressions."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import (
    AbstractSet,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Optional,
    Sequence,
    Union,
    cast,
)

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.tree.change_statements import Change, Delete
from cassandra_ros.query.tree.expressions import fold
from cassandra_ros.query.tree.syntax import (
    LEAVES,
    Aggregate,
    Call,
    Compare,
    Expression,
    IsNull,
    Leaf,
    Literal,
    Near,
    Negation,
    OneOf,
    Quantified,
    Relate,
    Select,
    Term,
    TimeNs,
    inside,
    leaves,
    terms_of,
)


class Binding:
    """Replaces the placeholders of a statement by parameter values.

    All ``now()`` of a statement have the same value: this machine's time when it is bound.

    Args:
        text: The statement.
        params: Values of the parameters.
        terms: All terms that may contain placeholders.

    Raises:
        InvalidQuery: The parameters do not fit.
    """

    def __init__(
        self,
        text: str,
        params: Sequence[object],
        terms: Iterable[Term],
    ) -> None:
        given = [term for term in terms if isinstance(term, (Literal, Call))]
        # Most statements have no parameters and stay unchanged.
        self._fixed = all(isinstance(term, Literal) and term.bound for term in given)
        found = sorted(set(_placeholders(given)))  # BETWEEN repeats its operand in the tree
        _check_params(text, found, params)
        if len(found) != len(params):
            at = found[len(params)] if len(params) < len(found) else len(text)
            reason = f"the statement has {len(found)} parameters, {len(params)} were given"
            raise InvalidQuery(text, at, reason)
        self._text = text
        self._values = dict(zip(found, params))
        self._now = TimeNs(0 if self._fixed else time.time_ns())

    def select(self, select: Select) -> Select:
        """Bind a SELECT except for its LIMIT."""
        if self._fixed:
            return select
        columns, condition = select.columns, select.condition
        return replace(
            select,
            columns=columns and tuple(replace(c, what=self._what(c.what)) for c in columns),
            condition=None if condition is None else self.expression(condition),
            group=tuple(map(self._term, select.group)),
            order=tuple(replace(o, what=self._what(o.what)) for o in select.order),
        )

    def expression(self, item: Expression) -> Expression:
        """Bind a condition; StatementError: an expression in it cannot be computed."""
        if self._fixed:
            return item
        if isinstance(item, LEAVES):
            return self._leaf(item)
        if isinstance(item, Negation):
            return Negation(self.expression(item.item))
        return replace(item, items=tuple(map(self.expression, item.items)))

    def _leaf(self, leaf: Leaf) -> Expression:
        if isinstance(leaf, Near):
            return replace(leaf, values=tuple(map(self.value, leaf.values)))
        if isinstance(leaf, Quantified):
            tests = tuple((sign, self._term(term)) for sign, term in leaf.tests)
            return replace(leaf, tests=tests)
        operand = self._term(leaf.operand)
        if isinstance(leaf, Relate):
            return replace(leaf, operand=operand, other=self._term(leaf.other))
        if isinstance(leaf, IsNull):
            return IsNull(operand)
        if isinstance(leaf, Compare):
            return replace(leaf, operand=operand, value=self.value(leaf.value))
        values = tuple(map(self.value, leaf.values))
        return OneOf(operand, self._elements(*values) if leaf.whole else values)

    def value(self, value: Literal) -> Literal:
        """Bind one value."""
        if value.bound:
            return value
        at = value.position
        if value.made is None:
            return Literal(self._values[at], at)
        return cast(Literal, self._term(value.made))

    def _what(self, what: Union[Term, Aggregate]) -> Union[Term, Aggregate]:
        if not isinstance(what, Aggregate):
            return self._term(what)
        return what if what.operand is None else replace(what, operand=self._term(what.operand))

    def _term(self, term: Term) -> Term:
        if isinstance(term, Literal):
            return self.value(term)
        if not isinstance(term, Call):
            return term
        if term.function == "now":
            return Literal(self._now, term.position)
        call = replace(term, arguments=tuple(map(self._term, term.arguments)))
        values = all(isinstance(argument, Literal) for argument in call.arguments)
        return fold(call) if values else call

    def _elements(self, whole: Literal) -> tuple[Literal, ...]:
        if not isinstance(whole.value, (list, tuple, set, frozenset)):
            raise InvalidQuery(self._text, whole.position, "IN ? takes a list as its value")
        return tuple(Literal(element, whole.position) for element in whole.value)


def terms_of_condition(condition: Optional[Expression]) -> Iterator[Term]:
    """Yield the terms in the comparisons of a condition."""
    for leaf in leaves(condition):
        yield from terms_of(leaf)


def terms_of_statement(statement: Union[Select, Change]) -> Iterator[Term]:
    """Yield all terms of a statement that may contain parameters, except for its LIMIT."""
    if isinstance(statement, (Select, Delete)):
        yield from terms_of_condition(statement.condition)
    if isinstance(statement, Select):
        yield from statement.group
        columns = [column.what for column in statement.columns or ()]
        for what in columns + [part.what for part in statement.order]:
            found = what.operand if isinstance(what, Aggregate) else what
            yield from () if found is None else (found,)


def _placeholders(terms: Iterable[Term]) -> Iterator[int]:
    for term in terms:
        for part in inside(term):
            if isinstance(part, Literal) and not part.bound:
                yield from (part.position,) if part.made is None else _placeholders([part.made])


def _check_params(text: str, found: Sequence[int], params: object) -> None:
    unordered = (str, bytes, Mapping, AbstractSet)
    if isinstance(params, Collection) and not isinstance(params, unordered):
        return
    if isinstance(params, (str, bytes)) or not isinstance(params, Iterable):
        reason = f"one value: give [{params!r:.80}]"
    else:
        reason = f"a {type(params).__name__}"
    reason = f"the parameters are a list of values in the order of their ?, not {reason}"
    raise InvalidQuery(text, min(found, default=0), reason)
