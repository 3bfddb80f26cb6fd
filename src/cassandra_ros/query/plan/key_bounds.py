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
from cassandra_ros.query.plan.near_conditions import RangeSource
from cassandra_ros.query.protocols import Runs
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
from cassandra_ros.read import EVERYTHING, Named, Read, TimeRange, Whose

_ORDERED = ("<", "<=", ">", ">=")


@dataclass(frozen=True)
class Bounds:
    """Rows outside these bounds cannot match."""

    read: Read
    """Reads the rows inside: the range of KEY, NODE, the writers of RUN, and the one name where
    messages are kept under names."""
    empty: bool = False
    """Whether no row can match."""
    whole: bool = True
    """Whether the bounds are the whole condition, so that every row inside matches."""
    spans: Optional[RangeSource] = None
    """Function that returns the ranges of KEY outside of which no row matches; None = unknown."""

    def reads(self) -> Iterator[Read]:
        """Yield the reads of the rows inside, in the direction of reading."""
        read = self.read
        if self.empty:
            return
        if self.spans is None or read.only is not None:
            yield read
            return
        low, high = read.time_range
        if read.after is not None and read.reverse:
            high = min(high, read.after.t)
        elif read.after is not None:
            low = max(low, read.after.t)
        for span in self.spans(low, high, read.reverse):
            yield replace(read, time_range=TimeRange(*span))

    def within(self, low: Optional[int], high: Optional[int]) -> Bounds:
        """Return the bounds narrowed to a time range; None = open."""
        first, last = self.read.time_range
        first = first if low is None else max(first, low)
        last = last if high is None else min(last, high)
        read = replace(self.read, time_range=TimeRange(first, last))
        return replace(self, read=read, empty=self.empty or first > last)

    def of(self, whose: Whose) -> Bounds:
        """Return the bounds narrowed to messages of some nodes and writers."""
        both = self.read.whose.both(whose)
        return replace(self, read=replace(self.read, whose=both), empty=self.empty or both.empty)

    def named(self, name: str) -> Bounds:
        """Return the bounds narrowed to the messages under a name."""
        clash = self.read.only not in (None, Named(name))
        return replace(self, read=replace(self.read, only=Named(name)), empty=self.empty or clash)


def bounds_of(
    select: Select, read: Read = EVERYTHING, named: bool = False, runs: Optional[Runs] = None
) -> Bounds:
    """Return the bounds of a statement, inside of a read.

    Args:
        select: The statement.
        read: Time range, nodes and writers of the messages that are read.
        named: Whether the messages are kept under names.
        runs: Finds runs by their names; without it RUN does not narrow the bounds.

    Raises:
        InvalidQuery: KEY, NODE or RUN is compared with a value of another kind.
    """
    bounds = Bounds(read, empty=read.whose.empty).within(0, MAX_NS)
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
            return bounds.of(Whose(None, runs.called(fit_to_text(part.value, "RUN"))))
    if isinstance(part, Compare) and isinstance(part.operand, NodeOperand) and part.operator == "=":
        try:
            return bounds.of(Whose.of(check_node(fit_to_text(part.value, "NODE"))))
        except InvalidName:
            return replace(bounds, empty=True)  # no message has an invalid nodeID
    if isinstance(part, Compare) and isinstance(part.operand, KeyOperand):
        if named and part.operator == "=":
            return bounds.named(fit_to_text(part.value, "KEY"))
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
