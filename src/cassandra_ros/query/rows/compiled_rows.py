# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A compiled function from stored rows to rows of the result, for most statements.

It is used if nothing is unnested and, in format ``ros``, every field has a column. The fields of
the condition are decoded first, the other fields only if the condition is true. For a row with a
missing column or malformed values it returns None, and the row is read in the general way.
"""

from __future__ import annotations

import struct
from operator import itemgetter
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS
from cassandra_ros.query.protocols import Row
from cassandra_ros.query.rows.condition_check import Check
from cassandra_ros.query.rows.field_extractor import ColumnField, Get

RawColumns = Sequence[Optional[bytes]]
"""Encoded columns of a row."""
ResultRows = List[Tuple[Any, ...]]
CompiledRows = Callable[[Row], Optional[ResultRows]]
"""Function that returns the result rows of a stored row; None = use the general way."""
ShownColumns = Sequence[Tuple[Optional[int], Optional[Get]]]
"""For each column of the result the index of its value (None: missing in this table), and the
conversion for display."""
_Fill = Callable[[RawColumns, List[Any]], bool]
"""Function that sets the values of some fields; it returns False if one is missing."""
_FieldPlace = Tuple[int, int, ColumnField]
"""Index among the values, index among the columns, and the field's decoder."""
_NONE: ResultRows = []
"""Shared empty result; callers do not change it."""


def compile_rows(
    direct: Sequence[ColumnField],
    own: Callable[[Row], Tuple[Any, ...]],
    check: Check,
    checked: Sequence[int],
    shown: ShownColumns,
    key_place: int,
    computed: Sequence[Get] = (),
    *,
    own_width: int,
    asked: int,
    stored: int,
) -> CompiledRows:
    """Return the function for one statement and one table.

    Args:
        direct: Fields in the order of their values, which follow the values of ``own``.
        own: Returns the values of a row that are not fields.
        check: The condition.
        checked: Indices of the values that the condition needs.
        shown: See ShownColumns.
        key_place: Index of KEY, which is shown as the row's key.
        computed: Functions of the computed columns, whose values follow the others.
        own_width: Number of values that are not fields.
        asked: Number of columns of a row if only the needed columns are read.
        stored: Number of columns of a whole row.
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
    shown: ShownColumns,
    key_place: int,
    computed: Sequence[Get] = (),
) -> CompiledRows:
    """Like compile_rows, for a table whose rows hold serialised messages, read by ``read``."""
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


def _fills(parts: Sequence[_FieldPlace], checked: Sequence[int]) -> Tuple[_Fill, _Fill]:
    """Return the functions that set the checked fields, and the other fields.

    If one number is checked, all numbers are read: together they cost hardly more than one.
    """
    number = any(place in checked and direct.code for place, _, direct in parts)
    first = [p for p in parts if p[0] in checked or (number and p[2].code)]
    return _compile_fill(first), _compile_fill([part for part in parts if part not in first])


def _compile_fill(parts: Sequence[_FieldPlace]) -> _Fill:
    numbers = [part for part in parts if part[2].code]
    if len(numbers) < 2:  # itemgetter returns a tuple only for two and more
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
    def fill(held: RawColumns, values: List[Any]) -> bool:
        for place, at, decode in parts:
            raw = held[at]
            if raw is None:
                return False
            values[place] = decode(raw)
        return True

    return fill


def _numbers(parts: Sequence[_FieldPlace]) -> _Fill:
    take = itemgetter(*(at for _, at, _ in parts))
    unpack = struct.Struct(">" + "".join(d.code for _, _, d in parts)).unpack
    places = [place for place, _, _ in parts]
    first, end = places[0], places[-1] + 1
    together = places == list(range(first, end))

    def fill(held: RawColumns, values: List[Any]) -> bool:
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
    shown: ShownColumns, key_place: int, computed: Sequence[Get] = ()
) -> Callable[[Row, List[Any]], Tuple[Any, ...]]:
    """Return the function from the values of a row, which it may change, to a row of the result."""
    if computed:
        inner = _compile_show(shown, key_place)
        return lambda row, values: inner(row, [*values, *[get(values) for get in computed]])
    keys = [n for n, (place, get) in enumerate(shown) if place == key_place and get is None]
    made: Dict[Tuple[int, Get], int] = {}
    gets, copies = [], []
    for n, (place, get) in enumerate(shown):
        if place is not None and get:
            first = made.setdefault((place, get), n)
            # A column that is selected twice is computed once.
            if first == n:
                gets.append((n, get))
            else:
                copies.append((n, first))
    # The row's key is appended to the values.
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
