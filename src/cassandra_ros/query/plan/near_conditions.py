# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""NEAR in a condition: its arguments, the robots' stays, and the time ranges that may match.

``NEAR(x, y, radius, 'frame', 'robot')`` is true for a message if its robot was on the disk at that
time, false if it was elsewhere, and unknown if no pose of it is known. ``Table.places`` gives
access to the robots of the table's keyspace.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from numbers import Real
from typing import Callable, Iterator, NamedTuple, Optional, Sequence, Tuple

from cassandra_ros.errors import InvalidOption, InvalidQuery
from cassandra_ros.query.protocols import Disk, Table
from cassandra_ros.query.tree.syntax import (
    All,
    DurationNs,
    Either,
    Expression,
    Literal,
    Near,
    Negation,
    Select,
    StatementError,
    TimeNs,
    leaves,
)
from cassandra_ros.read import EVERYBODY, Whose

NsRange = Tuple[int, int]
"""A time range, ns, both ends included."""
RangeSource = Callable[[int, int, bool], Iterator[NsRange]]
"""Function that yields disjoint time ranges in [low, high], ascending or (True) descending."""

_METRES = ("x", "y", "the radius")
_NAMES = ("the frame", "the robot")


def with_stays(
    select: Select,
    tables: Sequence[Table],
    whose: Whose = EVERYBODY,
) -> Select:
    """Return the statement with the stays of each NEAR filled in.

    Args:
        select: The statement.
        tables: Tables of its topic.
        whose: Robot and runs whose messages are read.

    Raises:
        InvalidQuery: An argument of NEAR is invalid, or no poses are stored for it.
    """
    condition = select.condition
    if condition is None or not any(isinstance(leaf, Near) for leaf in leaves(condition)):
        return select
    try:
        return replace(select, condition=_with_stays(condition, _ReadScope(tables, whose)))
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None


class _ReadScope(NamedTuple):
    """The messages that a statement reads."""

    tables: Sequence[Table]
    whose: Whose


def _with_stays(item: Expression, asked: _ReadScope) -> Expression:
    if isinstance(item, Near):
        return _with_stays_of(item, asked)
    if isinstance(item, Negation):
        return Negation(_with_stays(item.item, asked))
    if isinstance(item, (All, Either)):
        return replace(item, items=tuple(_with_stays(each, asked) for each in item.items))
    return item


def _with_stays_of(near: Near, asked: _ReadScope) -> Near:
    disk = disk_of(near)
    if not asked.tables:
        return near
    try:
        places, whose = asked.tables[0].places, asked.whose
        return replace(near, stays=places.stays(disk, whose.node, whose.writers))
    except InvalidOption as exc:
        raise StatementError(near.position, str(exc)) from exc


def disk_of(near: Near) -> Disk:
    """Return the disk of a bound NEAR; StatementError: an argument is invalid."""
    x, y, radius = (_metres(name, value) for name, value in zip(_METRES, near.values))
    texts = [_text(name, value) for name, value in zip(_NAMES, near.values[3:])]
    if radius < 0:
        raise StatementError(near.values[2].position, "the radius is negative")
    return Disk(x, y, radius, *texts)


def _metres(name: str, literal: Literal) -> float:
    value = literal.value
    if isinstance(value, Real) and not isinstance(value, (bool, DurationNs, TimeNs)):
        try:
            metres = float(value)
        except OverflowError:
            metres = math.inf
        if math.isfinite(metres):
            return metres
    reason = f"{name} is a number of metres, not {literal.text}"
    raise StatementError(literal.position, reason)


def _text(name: str, literal: Literal) -> str:
    if isinstance(literal.value, str) and literal.value.strip("/"):
        return literal.value
    reason = f"{name} is a name in quotes, as 'base_link', not {literal.text}"
    raise StatementError(literal.position, reason)


def spans_of(condition: Optional[Expression]) -> Optional[RangeSource]:
    """Return the time ranges outside of which a condition is never true; None = all time.

    The ranges may be too long, never too short.
    """
    if isinstance(condition, Near) and condition.stays is not None:
        return condition.stays.spans
    if isinstance(condition, (All, Either)):
        found = [spans_of(item) for item in condition.items]
        known = [spans for spans in found if spans is not None]
        if isinstance(condition, All):
            return _both(known) if known else None
        return _united(known) if len(known) == len(found) else None
    return None


def _both(every: Sequence[RangeSource]) -> RangeSource:
    """Return the intersection: the ranges of one function are requested inside those of another."""
    first, rest = every[0], every[1:]
    if not rest:
        return first
    others = _both(rest)

    def spans(low: int, high: int, reverse: bool) -> Iterator[NsRange]:
        for start, end in first(low, high, reverse):
            yield from others(start, end, reverse)

    return spans


def _united(every: Sequence[RangeSource]) -> RangeSource:
    if len(every) == 1:
        return every[0]

    def spans(low: int, high: int, reverse: bool) -> Iterator[NsRange]:
        sign = -1 if reverse else 1
        streams = [each(low, high, reverse) for each in every]
        last: Optional[NsRange] = None
        # Descending ranges are merged by their ends, ascending ones by their starts.
        for span in heapq.merge(*streams, key=lambda span: sign * span[1 if reverse else 0]):
            if last is not None and last[0] <= span[1] + 1 and span[0] - 1 <= last[1]:
                last = min(last[0], span[0]), max(last[1], span[1])
                continue
            if last is not None:
                yield last
            last = span
        if last is not None:
            yield last

    return spans
