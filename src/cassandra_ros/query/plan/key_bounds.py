# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bounds of a condition on KEY, NODE and RUN, which the store checks without reading rows.

Only conditions joined by AND narrow the bounds. So the bounds may be weaker than the condition, but
are never stronger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import Iterator, Optional

from cassandra_ros.arguments import check_node
from cassandra_ros.errors import InvalidName, InvalidQuery
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import SECONDS_BELOW
from cassandra_ros.query.plan.nearby import Spans
from cassandra_ros.query.protocols import Runs
from cassandra_ros.query.source import Writers
from cassandra_ros.query.tree.literals import fit_to_text, fit_to_time
from cassandra_ros.query.tree.syntax import (
    Compare,
    Expression,
    KeyOperand,
    Literal,
    Near,
    NodeOperand,
    OneOf,
    RunOperand,
    Select,
    StatementError,
    conjuncts,
    given,
    leaves,
)

_ORDERED = ("<", "<=", ">", ">=")


@dataclass(frozen=True)
class Bounds:
    """Rows outside these bounds cannot match."""

    low: int = 0
    """Minimum KEY, included, ns since 1970."""
    high: int = MAX_NS
    """Maximum KEY, included, ns since 1970."""
    node: Optional[str] = None
    """The only nodeID; None = all."""
    writers: Writers = None
    name: Optional[str] = None
    """The only name; None = all. Only for messages that are kept under names."""
    empty: bool = False
    """Whether no row can match."""
    whole: bool = True
    """Whether the bounds are the whole condition, so that every row inside matches."""
    spans: Optional[Spans] = None
    """Function that returns the ranges of KEY outside of which no row matches; None = unknown."""

    def within(self, low: Optional[int], high: Optional[int], node: Optional[str] = None) -> Bounds:
        """Return narrower bounds."""
        low = self.low if low is None else max(self.low, low)
        high = self.high if high is None else min(self.high, high)
        clash = None not in (node, self.node) and node != self.node
        empty = self.empty or clash or low > high
        node = self.node if node is None else node
        return replace(self, low=low, high=high, node=node, empty=empty)

    def written(self, writers: Writers) -> Bounds:
        """Return the bounds narrowed to messages of some writers."""
        if writers is not None and self.writers is not None:
            writers = writers & self.writers
        writers = self.writers if writers is None else writers
        return replace(self, writers=writers, empty=self.empty or writers == frozenset())


def bounds_of(
    select: Select,
    node: Optional[str] = None,
    named: bool = False,
    writers: Writers = None,
    runs: Optional[Runs] = None,
) -> Bounds:
    """Return the bounds of a statement, for messages of a node and some writers.

    Args:
        select: The statement.
        node, writers: Robot and runs whose messages are read; None = all.
        named: Whether the messages are kept under names.
        runs: Finds runs by their names; without it RUN does not narrow the bounds.

    Raises:
        InvalidQuery: KEY, NODE or RUN is compared with a value of another kind.
    """
    bounds = Bounds(node=node).written(writers)
    try:
        for part in conjuncts(select.condition):
            bounds = _narrowed(bounds, part, named, runs)
        for leaf in leaves(select.condition) if named else ():
            if not isinstance(leaf, Compare) or leaf.operator not in _ORDERED:
                continue
            if isinstance(leaf.operand, KeyOperand):
                reason = "is a name here, and names have no order; compare it with =, IN or LIKE"
                raise StatementError(leaf.operand.position, f"KEY {reason}")
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None
    return bounds


def meant_as_seconds(condition: Optional[Expression]) -> Iterator[Literal]:
    """Yield the integers compared with KEY that look like seconds; integers mean ns."""
    compared = (leaf for leaf in leaves(condition) if not isinstance(leaf, Near))
    keys = (leaf for leaf in compared if isinstance(leaf.operand, KeyOperand))
    for literal in chain.from_iterable(map(given, keys)):
        if type(literal.value) is int and 0 < literal.value < SECONDS_BELOW:
            yield literal


def _narrowed(bounds: Bounds, part: Expression, named: bool, runs: Optional[Runs]) -> Bounds:
    if isinstance(part, Compare) and isinstance(part.operand, RunOperand) and part.operator == "=":
        if runs is not None:
            return bounds.written(runs.called(fit_to_text(part.value, "RUN")))
    if isinstance(part, Compare) and isinstance(part.operand, NodeOperand) and part.operator == "=":
        try:
            return bounds.within(None, None, check_node(fit_to_text(part.value, "NODE")))
        except InvalidName:
            return replace(bounds, empty=True)  # no message has an invalid nodeID
    if isinstance(part, Compare) and isinstance(part.operand, KeyOperand):
        if named and part.operator == "=":
            name = fit_to_text(part.value, "KEY")
            clash = bounds.name not in (None, name)
            return replace(bounds, name=name, empty=bounds.empty or clash)
        if not named and part.operator in ("=", *_ORDERED):
            ns = fit_to_time(part.value)
            low = {"=": ns, ">=": ns, ">": ns + 1}.get(part.operator)
            high = {"=": ns, "<=": ns, "<": ns - 1}.get(part.operator)
            return bounds.within(low, high)
    if isinstance(part, OneOf) and isinstance(part.operand, KeyOperand) and not named:
        times = list(map(fit_to_time, part.values))
        if times:
            bounds = bounds.within(min(times), max(times))
    return replace(bounds, whole=False)
