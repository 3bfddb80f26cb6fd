# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What of a condition the store can check: the span of KEY, and NODE.

Only conjuncts are used, so the bounds may be weaker than the condition and are never stronger.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Iterator, Optional

from cassandra_ros.arguments import check_node
from cassandra_ros.errors import InvalidName
from cassandra_ros.keys import MAX_NS
from cassandra_ros.query.builder import StatementError
from cassandra_ros.query.literals import fitToText, fitToTime
from cassandra_ros.query.syntax import (
    All,
    Compare,
    Expression,
    Key,
    Literal,
    Node,
    OneOf,
    given,
    leaves,
)

_log = logging.getLogger(__name__)

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


def boundsOf(
    condition: Optional[Expression], node: Optional[str] = None, named: bool = False
) -> Bounds:
    """Find the bounds of a condition.

    Args:
        condition: Bound; None is always true.
        node: nodeID that was asked for besides, None = all.
        named: The messages are kept under names: KEY is text.

    Raises:
        StatementError: A value is no time, or NODE is compared with something else than text, or
            names are asked for their order.
    """
    bounds = Bounds().within(None, None, node)
    for part in _conjuncts(condition):
        bounds = _narrowed(bounds, part, named)
    if named:
        _refuseOrder(condition)
    return bounds


def _refuseOrder(condition: Optional[Expression]) -> None:
    for leaf in leaves(condition):
        if isinstance(leaf.operand, Key) and isinstance(leaf, Compare):
            if leaf.operator in _ORDERED:
                raise StatementError(
                    leaf.operand.position,
                    "KEY is a name here, and names have no order; compare it with =, IN or LIKE",
                )


def meantAsSeconds(condition: Optional[Expression]) -> Iterator[Literal]:
    """Yield what KEY is compared with and looks like seconds: integers are ns."""
    for comparison in leaves(condition):
        for found in given(comparison) if isinstance(comparison.operand, Key) else ():
            value = found.value if isinstance(found, Literal) else None
            if type(value) is int and 0 < value < SECONDS_BELOW:
                yield Literal(value, found.position)


def warnOfSeconds(condition: Optional[Expression]) -> None:
    """Log a warning where KEY is compared with what looks like seconds."""
    for found in meantAsSeconds(condition):
        _log.warning(
            "KEY is compared with %d, which means nanoseconds since 1970; did you mean "
            "seconds, %d.0?",
            *(found.value, found.value),
        )


def _conjuncts(condition: Optional[Expression]) -> Iterator[Expression]:
    if isinstance(condition, All):
        for item in condition.items:
            yield from _conjuncts(item)
    elif condition is not None:
        yield condition


def _narrowed(bounds: Bounds, part: Expression, named: bool) -> Bounds:
    if isinstance(part, Compare) and isinstance(part.value, Literal):
        if isinstance(part.operand, Node) and part.operator == "=":
            node = fitToText(part.value, "NODE")
            try:
                return bounds.within(None, None, check_node(node))
            except InvalidName:
                return replace(bounds, empty=True)  # no message can be of such a node
        if isinstance(part.operand, Key) and part.operator == "=" and named:
            name = fitToText(part.value, "KEY")
            clash = bounds.name not in (None, name)
            return replace(bounds, name=name, empty=bounds.empty or clash)
        if named:
            return replace(bounds, whole=False)
        if isinstance(part.operand, Key) and part.operator in ("=", *_ORDERED):
            ns = fitToTime(part.value)
            low = {"=": ns, ">=": ns, ">": ns + 1}.get(part.operator)
            high = {"=": ns, "<=": ns, "<": ns - 1}.get(part.operator)
            return bounds.within(low, high)
    if isinstance(part, OneOf) and isinstance(part.operand, Key) and not named:
        times = [fitToTime(value) for value in part.values if isinstance(value, Literal)]
        if times:
            bounds = bounds.within(min(times), max(times))
    return replace(bounds, whole=False)
