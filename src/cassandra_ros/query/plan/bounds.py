# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bounds of a condition on KEY, NODE, RUN, NEAR and EVENT: which rows need not be read.

Only conditions joined by AND narrow the bounds. So the bounds may be weaker than the condition, but
are never stronger.

``NEAR(x, y, radius IN 'frame', 'robot')`` is true for a message if its robot was on the disk at
that time, false if it was elsewhere, and unknown if no pose of it is known. ``Table.places`` gives
access to the robots of the table's keyspace. ``EVENT 'name'`` is true for a message if its robot
had an event of this name at that time, else false; ``Table.events`` finds these.
"""

from __future__ import annotations

import heapq
import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import chain
from numbers import Real
from typing import Callable, Iterable, Iterator, NamedTuple, Sequence, Tuple, TypeVar

from cassandra_ros.arguments import check_node
from cassandra_ros.errors import InvalidName, InvalidOption, InvalidQuery
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import other_unit
from cassandra_ros.quantities import metres
from cassandra_ros.query.protocols import WGS84, Disk, RunNames, Stays, Table
from cassandra_ros.query.tree.literals import fit_to_text, fit_to_time
from cassandra_ros.query.tree.syntax import (
    TIMED,
    All,
    Compare,
    DurationNs,
    Either,
    Expression,
    InEvent,
    KeyOperand,
    Literal,
    Near,
    Negation,
    NodeOperand,
    OneOf,
    RunOperand,
    Select,
    StatementError,
    Timed,
    TimeNs,
    conjuncts,
    given,
    leaves,
)
from cassandra_ros.read import EVERYTHING, LAST_NS, Named, Read, TimeRange, Whose

_ORDERED = ("<", "<=", ">", ">=")
"""Operators that need an order of the values."""

NsRange = Tuple[int, int]
"""A time range, ns, both ends included."""
RangeSource = Callable[[int, int, bool], Iterator[NsRange]]
"""Function that yields disjoint time ranges in [low, high], ascending or (True) descending."""

_EARTH_NAMES = ("the latitude", "the longitude")
_NAMES = ("the frame", "the robot")
"""Names of the arguments of NEAR in error texts."""


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
    spans: RangeSource | None = None
    """Function that returns the ranges of KEY outside of which no row matches; None = unknown."""

    def reads(self) -> Iterator[Read]:
        """Yield the reads of the rows inside, in the direction of reading.

        One for each range of ``spans``, which is computed when the iterator is advanced.
        """
        read = self.read
        if self.empty:
            return
        # Messages under a name are found without their times.
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

    def within(self, low: int | None, high: int | None) -> Bounds:
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


def bounds_of(select: Select, read: Read = EVERYTHING, tables: Sequence[Table] = ()) -> Bounds:
    """Return the bounds of a statement, inside of a read.

    Args:
        select: The statement.
        read: Time range, nodes and writers of the messages that are read.
        tables: Tables of its topic, which may be in several keyspaces; without a table RUN does not
            narrow the bounds.

    Raises:
        InvalidQuery: KEY, NODE or RUN is compared with a value of another kind, or a KEY that is a
            name by < <= > or >=.
    """
    bounds = Bounds(read, empty=read.whose.empty).within(0, MAX_NS)
    named, runs = any(table.named for table in tables), distinct(table.runs for table in tables)
    try:
        for conjunct in conjuncts(select.condition):
            bounds = _narrow(bounds, conjunct, named, runs)
        for leaf in leaves(select.condition) if named else ():
            if not isinstance(leaf, Compare) or leaf.operator not in _ORDERED:
                continue
            if isinstance(leaf.operand, KeyOperand):
                reason = "is a name here, and names have no order; compare it with =, IN or LIKE"
                raise StatementError(leaf.operand.position, f"KEY {reason}")
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None
    return bounds


def in_another_unit(condition: Expression | None) -> Iterator[Literal]:
    """Yield the integers compared with KEY that look like s, ms or us; integers mean ns."""
    compared = (leaf for leaf in leaves(condition) if not isinstance(leaf, TIMED))
    keys = (leaf for leaf in compared if isinstance(leaf.operand, KeyOperand))
    for literal in chain.from_iterable(map(given, keys)):
        if other_unit(literal.value, MAX_NS):
            yield literal


def bounds_time(conjunct: Expression) -> bool:
    """Return whether a part of a condition only sets ends of the time range, if KEY is a time."""
    return (
        isinstance(conjunct, Compare)
        and isinstance(conjunct.operand, KeyOperand)
        and conjunct.operator in ("=", *_ORDERED)
    )


def _narrow(bounds: Bounds, conjunct: Expression, named: bool, runs: Sequence[RunNames]) -> Bounds:
    """Return bounds narrowed by one part of a condition that is joined by AND.

    They are no longer ``whole`` if the part says more than the bounds. ``named``: KEY is a name.
    """
    if (
        isinstance(conjunct, Compare)
        and isinstance(conjunct.operand, RunOperand)
        and conjunct.operator == "="
    ):
        if runs:
            name = fit_to_text(conjunct.value, "RUN")
            writers = frozenset().union(*(lookup.called(name) for lookup in runs))
            return bounds.of(Whose(None, writers))
    if (
        isinstance(conjunct, Compare)
        and isinstance(conjunct.operand, NodeOperand)
        and conjunct.operator == "="
    ):
        try:
            return bounds.of(Whose.of(check_node(fit_to_text(conjunct.value, "NODE"))))
        except InvalidName:
            return replace(bounds, empty=True)  # no message has an invalid nodeID
    if isinstance(conjunct, Compare) and isinstance(conjunct.operand, KeyOperand):
        if named and conjunct.operator == "=":
            return bounds.named(fit_to_text(conjunct.value, "KEY"))
        if not named and conjunct.operator in ("=", *_ORDERED):
            ns = fit_to_time(conjunct.value)
            low = {"=": ns, ">=": ns, ">": ns + 1}.get(conjunct.operator)
            high = {"=": ns, "<=": ns, "<": ns - 1}.get(conjunct.operator)
            return bounds.within(low, high)
    if isinstance(conjunct, OneOf) and isinstance(conjunct.operand, KeyOperand) and not named:
        times = list(map(fit_to_time, conjunct.values))
        if times:
            bounds = bounds.within(min(times), max(times))
    return replace(bounds, whole=False)


def with_stays(
    select: Select,
    tables: Sequence[Table],
    read: Read = EVERYTHING,
) -> Select:
    """Return the statement with the times of each NEAR and EVENT filled in.

    Args:
        select: The statement.
        tables: Tables of its topic.
        read: Time range, robot and runs of the messages that are read.

    Raises:
        InvalidQuery: An argument of NEAR or EVENT is invalid, or no poses are stored for NEAR.
    """
    condition = select.condition
    if condition is None or not any(isinstance(leaf, TIMED) for leaf in leaves(condition)):
        return select
    try:
        return replace(select, condition=_with_stays(condition, _ReadScope(tables, read)))
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None


def plan_of(select: Select, tables: Sequence[Table], read: Read) -> tuple[Select, Bounds]:
    """Return the statement as by ``with_stays``, and its bounds as by ``bounds_of``."""
    bounds = bounds_of(select, read, tables)
    return with_stays(select, tables, bounds.read), bounds


class _ReadScope(NamedTuple):
    """The messages that a statement reads."""

    tables: Sequence[Table]
    read: Read


def _with_stays(item: Expression, scope: _ReadScope) -> Expression:
    """Return a condition with its times, see with_stays; it raises StatementError."""
    if isinstance(item, TIMED):
        return _with_stays_of(item, scope)
    if isinstance(item, Negation):
        return Negation(_with_stays(item.item, scope))
    if isinstance(item, (All, Either)):
        return replace(item, items=tuple(_with_stays(inner, scope) for inner in item.items))
    return item


def _with_stays_of(leaf: Timed, scope: _ReadScope) -> Timed:
    # This checks the arguments, also those of a topic without tables.
    find = _event_finder(leaf, scope) if isinstance(leaf, InEvent) else _stay_finder(leaf, scope)
    if not scope.tables:
        return leaf
    try:
        return replace(leaf, stays=find(scope.tables))
    except (InvalidName, InvalidOption) as exc:
        raise StatementError(leaf.position, str(exc)) from exc


def _stay_finder(near: Near, scope: _ReadScope) -> Callable[[Sequence[Table]], Stays]:
    """Check NEAR; return the function that finds the stays of the robots of some tables."""
    disk, whose = disk_of(near), scope.read.whose

    def find(tables: Sequence[Table]) -> Stays:
        places, *others = distinct(table.places for table in tables)
        if others:
            reason = (
                "NEAR is answered by one store, which knows where its robots were: ask each alone"
            )
            raise StatementError(near.position, reason)
        return places.stays(disk, whose.node, whose.writers)

    return find


def _event_finder(leaf: InEvent, scope: _ReadScope) -> Callable[[Sequence[Table]], Stays]:
    """Check EVENT; return the function that finds the events of the robots of some tables."""
    name = leaf.name.value
    if not isinstance(name, str):
        reason = f"the name of an event is a text in quotes, as 'bump', not {leaf.name.text}"
        raise StatementError(leaf.name.position, reason)

    def find(tables: Sequence[Table]) -> Stays:
        first, *others = distinct(table.events for table in tables)
        return first.times(name, leaf.like, scope.read, others)

    return find


_T = TypeVar("_T")


def distinct(lookups: Iterable[_T]) -> list[_T]:
    """Return the lookups of the keyspaces of some tables, each once.

    Tables of one keyspace share the object, so it identifies the keyspace.
    """
    return list({id(lookup): lookup for lookup in lookups}.values())


def disk_of(near: Near) -> Disk:
    """Return the disk of a bound NEAR; StatementError: an argument is invalid."""
    radius = _radius(near.values[2])
    texts = [_text(name, value) for name, value in zip(_NAMES, near.values[3:])]
    frame, *robot = texts or [usual_frame(near.values[2].value)]
    frame = frame.lstrip("/")
    on_earth = frame == WGS84
    names, unit = (_EARTH_NAMES, "degrees") if on_earth else (("x", "y"), "metres")
    x, y = (_number(name, unit, value) for name, value in zip(names, near.values))
    return Disk(x, y, radius, frame, *robot)


def usual_frame(radius: object) -> str:
    """Return the frame of NEAR where none is named.

    It is the Earth for a radius with a unit, which is a text as 20m, and map for a number.
    """
    return WGS84 if isinstance(radius, str) else "map"


def _radius(literal: Literal) -> float:
    """Return a radius, m; StatementError: it is not a length, or negative."""
    if isinstance(literal.value, str):
        try:
            return metres(literal.value)
        except InvalidOption as exc:
            raise StatementError(literal.position, f"the radius {exc}") from exc
    radius = _number("the radius", "metres", literal)
    if radius < 0:
        raise StatementError(literal.position, "the radius is negative")
    return radius


def _number(name: str, unit: str, literal: Literal) -> float:
    """Return the value of a literal; StatementError, with name and unit: not a finite number."""
    value = literal.value
    if isinstance(value, Real) and not isinstance(value, (bool, DurationNs, TimeNs)):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    text = f"the duration {literal.text}" if isinstance(value, DurationNs) else literal.text
    reason = f"{name} is a number of {unit}, not {text}"
    raise StatementError(literal.position, reason)


def _text(name: str, literal: Literal) -> str:
    if isinstance(literal.value, str) and literal.value.strip("/"):
        return literal.value
    reason = f"{name} is a name in quotes, as 'base_link', not {literal.text}"
    raise StatementError(literal.position, reason)


def spans_of(condition: Expression | None) -> RangeSource | None:
    """Return the time ranges outside of which a condition is never true; None = all time.

    The ranges may be too long, never too short.
    """
    if isinstance(condition, TIMED) and condition.stays is not None:
        return condition.stays.spans
    if isinstance(condition, (All, Either)):
        all_sources = [spans_of(item) for item in condition.items]
        sources = [spans for spans in all_sources if spans is not None]
        if isinstance(condition, All):
            return _intersect(sources) if sources else None
        return _unite(sources) if len(sources) == len(all_sources) else None
    return None


def _intersect(sources: Sequence[RangeSource]) -> RangeSource:
    """Return the intersection: the ranges of one function are requested inside those of another."""
    first, rest = sources[0], sources[1:]
    if not rest:
        return first
    others = _intersect(rest)

    def spans(low: int, high: int, reverse: bool) -> Iterator[NsRange]:
        for start, end in first(low, high, reverse):
            yield from others(start, end, reverse)

    return spans


def _unite(sources: Sequence[RangeSource]) -> RangeSource:
    """Return the union; ranges that overlap or touch are joined."""
    if len(sources) == 1:
        return sources[0]

    def spans(low: int, high: int, reverse: bool) -> Iterator[NsRange]:
        sign = -1 if reverse else 1
        streams = [source(low, high, reverse) for source in sources]
        # Descending ranges are merged by their ends, ascending ones by their starts.
        ordered = heapq.merge(*streams, key=lambda span: sign * span[1 if reverse else 0])
        return merge_ranges(ordered)

    return spans


def merge_ranges(ranges: Iterable[NsRange]) -> Iterator[TimeRange]:
    """Yield time ranges, those that overlap or touch as one.

    Args:
        ranges: In the order of their starts, or in descending order of their ends.
    """
    merged: NsRange | None = None
    for low, high in ranges:
        if merged is not None and low <= merged[1] + 1 and merged[0] <= high + 1:
            merged = min(merged[0], low), max(merged[1], high)
            continue
        if merged is not None:
            yield TimeRange(*merged)
        merged = low, high
    if merged is not None:
        yield TimeRange(*merged)


def has_overlap(ranges: Sequence[NsRange], low: int, high: int) -> bool:
    """Return whether one of some time ranges, sorted and disjoint, touches [low, high]."""
    n = bisect_right(ranges, (high, LAST_NS)) - 1
    return n >= 0 and ranges[n][1] >= low
