# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bounds of a condition: what of it the store can check by the place of a row alone.

These are the spans of KEY, NODE and RUN. Only conjuncts are used for them, so they may be weaker
than the condition and are never stronger.
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
    """Rows outside of these cannot match."""

    low: int = 0
    """Least KEY, included, ns."""
    high: int = MAX_NS
    """Greatest KEY, included, ns."""
    node: Optional[str] = None
    """The one nodeID, None = all."""
    writers: Writers = None
    name: Optional[str] = None
    """The one name, None = all; only where messages are kept under names."""
    empty: bool = False
    """No row can match."""
    whole: bool = True
    """The bounds are the whole condition: every row inside matches."""
    spans: Optional[Spans] = None
    """Gives the stretches of KEY outside of which no row matches; None = nobody knows."""

    def within(self, low: Optional[int], high: Optional[int], node: Optional[str] = None) -> Bounds:
        """Narrow the bounds further."""
        low = self.low if low is None else max(self.low, low)
        high = self.high if high is None else min(self.high, high)
        clash = None not in (node, self.node) and node != self.node
        empty = self.empty or clash or low > high
        node = self.node if node is None else node
        return replace(self, low=low, high=high, node=node, empty=empty)

    def written(self, writers: Writers) -> Bounds:
        """Narrow the bounds to messages of some writers."""
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
    """Find the bounds of a statement, for messages of a node and some writers, named or not.

    RUN bounds nothing where nobody knows the runs.

    Raises:
        InvalidQuery: KEY, NODE or RUN is compared with what it cannot be.
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
    """Yield what KEY is compared with and looks like seconds: integers are ns."""
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
            return replace(bounds, empty=True)  # no message can be of such a node
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
