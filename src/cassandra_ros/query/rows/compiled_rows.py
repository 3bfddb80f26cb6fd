# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of a result straight out of stored ones: a function for a statement.

It is compiled for what most statements are: nothing is unnested. Of format ``ros`` every field has
to have a column; what the condition needs is decoded first, the rest only where it is true. Of a
row that lacks one of the columns, or is malformed, it says nothing: that row is read as any other.
"""

from __future__ import annotations

import struct
from operator import itemgetter
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS
from cassandra_ros.query.protocols import Row
from cassandra_ros.query.rows.evaluate import Check
from cassandra_ros.query.rows.extract import Direct, Get

Held = Sequence[Optional[bytes]]
"""Columns of a row."""
ResultRows = List[Tuple[Any, ...]]
CompiledRows = Callable[[Row], Optional[ResultRows]]
"""Returns what a stored row gives; None where it cannot say."""
Shown = Sequence[Tuple[Optional[int], Optional[Get]]]
"""For each column of the result its place (None: missing here), and how to show a value."""
_Fill = Callable[[Held, List[Any]], bool]
"""Puts the values of some fields into their places; False: one is missing."""
_Part = Tuple[int, int, Direct]
"""Place among the values, place among the columns, how to read it."""
_NONE: ResultRows = []
"""Nobody changes it."""


def compile_rows(
    direct: Sequence[Direct],
    own: Callable[[Row], Tuple[Any, ...]],
    check: Check,
    checked: Sequence[int],
    shown: Shown,
    key_place: int,
    computed: Sequence[Get] = (),
    *,
    own_width: int,
    asked: int,
    stored: int,
) -> CompiledRows:
    """Make the function for one statement and table.

    Args:
        direct: The fields, in the order of their values, which come behind those of ``own``.
        own: Gives the values of a row that are of no field.
        checked: Places of the values that the condition needs.
        key_place: Where KEY stands, which is shown as the row's key.
        computed: Gives of the values those that stand behind them, for what is shown alone.
        own_width: How many values are of no field.
        asked, stored: How many columns a row has that was asked for the fields alone, and as a
            whole.
    """
    places = range(own_width, own_width + len(direct))
    spots = {asked: [d.asked for d in direct], stored: [d.stored for d in direct]}
    layouts = {n: _fills(list(zip(places, each, direct)), checked) for n, each in spots.items()}
    return _compile_rows(
        layouts, own, check, len(direct), _compile_show(shown, key_place, computed)
    )


def compile_wire_rows(
    read: Callable[[bytes], List[Any]],
    own: Callable[[Row], Tuple[Any, ...]],
    check: Check,
    shown: Shown,
    key_place: int,
    computed: Sequence[Get] = (),
) -> CompiledRows:
    """As compile_rows, of a table whose rows hold serialised messages, which ``read`` reads."""
    show = _compile_show(shown, key_place, computed)

    def rows(row: Row) -> Optional[ResultRows]:
        try:
            values = [*own(row), *read(row.wire)]
        except (CorruptMessage, MessageNotFound):
            return None
        return [show(row, values)] if check(values) is True else _NONE

    return rows


def _compile_rows(
    layouts: Dict[int, Tuple[_Fill, _Fill]],
    own: Callable[[Row], Tuple[Any, ...]],
    check: Check,
    fields: int,
    show: Callable[[Row, List[Any]], Tuple[Any, ...]],
) -> CompiledRows:
    blank = [None] * fields

    def rows(row: Row) -> Optional[ResultRows]:
        held = row.columns
        fills = layouts.get(len(held))
        if fills is None:
            return None
        values: List[Any] = [*own(row), *blank]
        try:
            if not fills[0](held, values):
                return None
            if check(values) is not True:
                return _NONE
            if not fills[1](held, values):
                return None
        except BUILD_ERRORS:
            return None
        return [show(row, values)]

    return rows


def _fills(parts: Sequence[_Part], checked: Sequence[int]) -> Tuple[_Fill, _Fill]:
    """Return what reads the fields that are checked, and what reads the others.

    Where a number is checked all numbers are read: together they cost hardly more than one.
    """
    number = any(place in checked and direct.code for place, _, direct in parts)
    first = [p for p in parts if p[0] in checked or (number and p[2].code)]
    return _compile_fill(first), _compile_fill([part for part in parts if part not in first])


def _compile_fill(parts: Sequence[_Part]) -> _Fill:
    numbers = [part for part in parts if part[2].code]
    if len(numbers) < 2:  # what takes all at once wants two
        numbers = []
    others = [(place, at, d.decode) for place, at, d in parts if not (d.code and numbers)]
    fills = [_others(others)] if others else []
    fills += [_numbers(numbers)] if numbers else []
    if not fills:
        return lambda held, values: True
    if len(fills) == 1:
        return fills[0]
    return lambda held, values: fills[0](held, values) and fills[1](held, values)


def _others(parts: Sequence[Tuple[int, int, Get]]) -> _Fill:
    def fill(held: Held, values: List[Any]) -> bool:
        for place, at, decode in parts:
            raw = held[at]
            if raw is None:
                return False
            values[place] = decode(raw)
        return True

    return fill


def _numbers(parts: Sequence[_Part]) -> _Fill:
    take = itemgetter(*(at for _, at, _ in parts))
    unpack = struct.Struct(">" + "".join(d.code for _, _, d in parts)).unpack
    places = [place for place, _, _ in parts]
    first, end = places[0], places[-1] + 1
    together = places == list(range(first, end))

    def fill(held: Held, values: List[Any]) -> bool:
        raws = take(held)
        if None in raws:
            return False
        if together:
            values[first:end] = unpack(b"".join(raws))
            return True
        for place, value in zip(places, unpack(b"".join(raws))):
            values[place] = value
        return True

    return fill


def _compile_show(
    shown: Shown, key_place: int, computed: Sequence[Get] = ()
) -> Callable[[Row, List[Any]], Tuple[Any, ...]]:
    """Return what makes a row of the result of the values of a stored one, which it may change."""
    if computed:
        inner = _compile_show(shown, key_place)
        return lambda row, values: inner(row, [*values, *[get(values) for get in computed]])
    keys = [n for n, (place, get) in enumerate(shown) if place == key_place and get is None]
    made: Dict[Tuple[int, Get], int] = {}
    gets, copies = [], []
    for n, (place, get) in enumerate(shown):
        if place is not None and get:
            first = made.setdefault((place, get), n)
            # A column that is named twice is made once.
            if first == n:
                gets.append((n, get))
            else:
                copies.append((n, first))
    # A key is put behind the values.
    places = [-1 if n in keys else place for n, (place, _) in enumerate(shown)]
    if None in places or len(places) < 2:
        take = _take(places)
    else:
        take = itemgetter(*places)

    def show(row: Row, values: List[Any]) -> Tuple[Any, ...]:
        if keys:
            values.append(row.key)
        if not gets:
            return take(values)
        found = list(take(values))
        for n, get in gets:
            found[n] = get(found[n])
        for n, first in copies:
            found[n] = found[first]
        return tuple(found)

    return show


def _take(places: Sequence[Optional[int]]) -> Callable[[List[Any]], Tuple[Any, ...]]:
    return lambda values: tuple([None if place is None else values[place] for place in places])
