# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A condition by itself, as ``where=`` takes it: which messages satisfy it.

Of any condition the store can check the span of KEY, and NODE: its bounds. Only conjuncts are used
for them, so they may be weaker than the condition and are never stronger.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from itertools import islice
from typing import Callable, Iterator, Optional, Sequence

from cassandra_ros.arguments import check_node
from cassandra_ros.errors import InvalidKey, InvalidName, InvalidQuery
from cassandra_ros.keys import MAX_NS, Position, is_behind
from cassandra_ros.query.literals import fit_to_text, fit_to_time
from cassandra_ros.query.parse import parse_condition
from cassandra_ros.query.projection import Projections
from cassandra_ros.query.protocols import Columns, Row, RowT, Source, Table, TopicChooser
from cassandra_ros.query.pushdown import Pushdown
from cassandra_ros.query.syntax import (
    All,
    Compare,
    Delete,
    Expression,
    KeyOperand,
    Literal,
    NodeOperand,
    OneOf,
    Select,
    StatementError,
    given,
    leaves,
)

_log = logging.getLogger(__name__)

Test = Callable[[Row], bool]
_ORDERED = ("<", "<=", ">", ">=")

SECONDS_BELOW = 10**12
"""An integer key below is 17 minutes after 1970, or was meant as seconds."""


@dataclass(frozen=True)
class Bounds:
    """Rows outside of these cannot match."""

    low: int = 0
    """Least KEY, included, ns."""
    high: int = MAX_NS
    """Greatest KEY, included, ns."""
    node: Optional[str] = None
    """The one nodeID, None = all."""
    name: Optional[str] = None
    """The one name, None = all; only where messages are kept under names."""
    empty: bool = False
    """No row can match."""
    whole: bool = True
    """The bounds are the whole condition: every row inside matches."""

    def within(self, low: Optional[int], high: Optional[int], node: Optional[str] = None) -> Bounds:
        """Narrow the bounds further."""
        found = replace(
            self,
            low=self.low if low is None else max(self.low, low),
            high=self.high if high is None else min(self.high, high),
        )
        if node is not None:
            clash = self.node is not None and self.node != node
            found = replace(found, node=node, empty=found.empty or clash)
        return replace(found, empty=found.empty or found.low > found.high)


def bounds_of(select: Select, node: Optional[str] = None, named: bool = False) -> Bounds:
    """Find the bounds of a statement.

    Args:
        select: The statement.
        node: nodeID that was asked for besides, None = all.
        named: The messages are kept under names: KEY is text.

    Raises:
        InvalidQuery: A value is no time, or NODE is compared with something else than text, or
            names are asked for their order.
    """
    bounds = Bounds().within(None, None, node)
    try:
        for part in _conjuncts(select.condition):
            bounds = _narrowed(bounds, part, named)
        for leaf in leaves(select.condition) if named else ():
            ordered = isinstance(leaf, Compare) and leaf.operator in _ORDERED
            if ordered and isinstance(leaf.operand, KeyOperand):
                raise StatementError(
                    leaf.operand.position,
                    "KEY is a name here, and names have no order; compare it with =, IN or LIKE",
                )
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None
    return bounds


def meant_as_seconds(condition: Optional[Expression]) -> Iterator[Literal]:
    """Yield what KEY is compared with and looks like seconds: integers are ns."""
    for comparison in leaves(condition):
        for found in given(comparison) if isinstance(comparison.operand, KeyOperand) else ():
            value = found.value if isinstance(found, Literal) else None
            if type(value) is int and 0 < value < SECONDS_BELOW:
                yield Literal(value, found.position)


def warn_of_seconds(condition: Optional[Expression]) -> None:
    """Log a warning where KEY is compared with what looks like seconds."""
    for found in meant_as_seconds(condition):
        _log.warning(
            "KEY is compared with %(ns)d, which means nanoseconds since 1970; did you mean "
            "seconds, %(ns)d.0?",
            {"ns": found.value},
        )


def _conjuncts(condition: Optional[Expression]) -> Iterator[Expression]:
    if isinstance(condition, All):
        for item in condition.items:
            yield from _conjuncts(item)
    elif condition is not None:
        yield condition


def _narrowed(bounds: Bounds, part: Expression, named: bool) -> Bounds:
    if isinstance(part, Compare) and isinstance(part.value, Literal):
        if isinstance(part.operand, NodeOperand) and part.operator == "=":
            node = fit_to_text(part.value, "NODE")
            try:
                return bounds.within(None, None, check_node(node))
            except InvalidName:
                return replace(bounds, empty=True)  # no message can be of such a node
        if isinstance(part.operand, KeyOperand) and part.operator == "=" and named:
            name = fit_to_text(part.value, "KEY")
            clash = bounds.name not in (None, name)
            return replace(bounds, name=name, empty=bounds.empty or clash)
        if named:
            return replace(bounds, whole=False)
        if isinstance(part.operand, KeyOperand) and part.operator in ("=", *_ORDERED):
            ns = fit_to_time(part.value)
            low = {"=": ns, ">=": ns, ">": ns + 1}.get(part.operator)
            high = {"=": ns, "<=": ns, "<": ns - 1}.get(part.operator)
            return bounds.within(low, high)
    if isinstance(part, OneOf) and isinstance(part.operand, KeyOperand) and not named:
        times = [fit_to_time(value) for value in part.values if isinstance(value, Literal)]
        if times:
            bounds = bounds.within(min(times), max(times))
    return replace(bounds, whole=False)


class Condition:
    """What stands behind WHERE, for the messages of one source.

    A message satisfies a condition on the elements of an array of messages when one element does.

    Args:
        text: The condition.
        params: Values of its ``?`` or ``%s``.
        node: Only messages of this node; None = of all.

    Raises:
        InvalidQuery: The text is no condition, or the parameters do not fit.
    """

    def __init__(
        self, text: str, params: Sequence[object] = (), node: Optional[str] = None
    ) -> None:
        self._select = Select(text, (), "", 0, parse_condition(text, params))
        self._node = node

    @classmethod
    def of_statement(cls, statement: Delete, node: Optional[str] = None) -> Condition:
        """Return the condition that stands in a statement; errors show the whole of it."""
        condition = cls.__new__(cls)
        condition._select = Select(statement.text, (), "", 0, statement.condition)
        condition._node = node
        return condition

    def bounds(self, named: bool = False) -> Bounds:
        """Return what of it the store can check.

        Args:
            named: The messages are kept under names.

        Raises:
            InvalidQuery: KEY or NODE is compared with what it cannot be.
        """
        return bounds_of(self._select, self._node, named)

    def test(self, tables: Sequence[Table]) -> Test:
        """Return a function that tells whether a stored row satisfies the condition.

        Args:
            tables: Those of the source.

        Raises:
            InvalidQuery: The condition names a field that no definition of the topic has, or
                compares one with a value of another kind.
        """
        projections = Projections(self._select, tables)
        return lambda row: any(projections.of(row.table).hits(row))

    def rows(
        self,
        source: Source[RowT],
        key: Optional[int] = None,
        to_key: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        *,
        bare: bool = False,
    ) -> Iterator[RowT]:
        """Walk through the rows of a topic that satisfy the condition, in the order of time.

        Args:
            source: The topic.
            key: Lower end, included, ns; None = open.
            to_key: Upper end, included, ns; None = open.
            after: Begin behind this row.
            reverse: Newest first.
            bare: Only the keys are wanted: a row fetches its message when it is asked for.
        """
        tables = source.tables
        projections = Projections(self._select, tables)
        bounds = self.bounds(any(t.named for t in tables)).within(key, to_key)
        rows = bounded_rows(
            source,
            bounds,
            after,
            reverse,
            columns=(lambda table: projections.of(table).columns) if bare else None,
            chooser=Pushdown(self._select.condition),
        )
        return (row for row in rows if any(projections.of(row.table).hits(row)))


def bounded_rows(
    source: Source[RowT],
    bounds: Bounds,
    after: Optional[Position] = None,
    reverse: bool = False,
    limit: Optional[int] = None,
    *,
    columns: Optional[Columns],
    chooser: TopicChooser,
) -> Iterator[RowT]:
    """Walk through the rows of a topic inside of bounds; see Source.rows."""
    if bounds.empty:
        return iter(())
    if bounds.name is None:
        return source.rows(
            bounds.low,
            bounds.high,
            nodeID=bounds.node,
            limit=limit,
            after=after,
            reverse=reverse,
            columns=columns,
            chooser=chooser,
        )
    try:
        every = source.versions(bounds.name, nodeID=bounds.node, reverse=reverse)
    except InvalidKey:
        return iter(())  # no message can have such a name
    found = (
        row
        for row in every
        if bounds.low <= row.t <= bounds.high and is_behind(row.position, after, reverse)
    )
    return islice(found, limit)
