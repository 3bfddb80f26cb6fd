# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Result rows that are made from several rows: GROUP BY, aggregates, DISTINCT and ORDER BY.

Values are equal as in conditions, but here NaN equals NaN, and missing is a value of its own.
Groups and distinct rows come in the order of their first row; groups of ``time(…)`` are returned as
soon as they are complete. Ordered rows are sorted by value, equal ones by KEY; NaN and, after it,
missing values come last, for ASC and DESC. Aggregates take one pass and keep no rows
(``tree/accumulators``); they ignore missing values, except ``count(*)``.

MEMORY_BYTES limits the rows that are kept: for ORDER BY about 2 n rows with LIMIT n, else all; one
row of each group; one of each set of equal rows.
"""

from __future__ import annotations

from itertools import accumulate
from sys import getsizeof
from typing import Any, Callable, Iterable, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.rows.projection import ResultRow
from cassandra_ros.query.tree.accumulators import TOTALS, Count
from cassandra_ros.query.tree.syntax import Aggregate, Call, Ordering, Select


class Aggregation:
    """The columns of a statement over several rows: aggregates, or the value of the first row."""

    def __init__(self, select: Select) -> None:
        self._text = select.text
        self._asked = [column.what for column in select.columns or ()]
        self._totals: list[Union[Count, _First]] = [
            TOTALS[asked.function]() if isinstance(asked, Aggregate) else _First()
            for asked in self._asked
        ]

    def add(self, rows: Iterable[ResultRow]) -> None:
        """Add rows; InvalidQuery: the values of a field cannot be compared with each other."""
        for row in rows:
            for total, asked, value in zip(self._totals, self._asked, row):
                try:
                    if value is not None:
                        total.add(value)
                except TypeError as exc:
                    reason = (
                        "the definitions of this topic hold values of different kinds there, "
                        f"which {asked.text.split('(')[0]} cannot compare ({exc})"
                    )
                    raise InvalidQuery(self._text, asked.position, reason) from None

    def values(self) -> ResultRow:
        """Return the values of the columns for the rows so far."""
        return tuple(total.value() for total in self._totals)


class _First:
    """The value of the first row, for GROUP BY terms, which have one value in a group."""

    def __init__(self) -> None:
        self._value: object = None

    def add(self, value: object) -> None:
        if self._value is None:
            self._value = value

    def value(self) -> object:
        return self._value


MEMORY_BYTES = 256 * 1024 * 1024
"""Maximum memory for the kept rows of one statement, bytes, as Python counts it."""
TOTAL_BYTES = 1024
"""Approximate memory of one aggregate, bytes."""
LEAST_KEPT = 1000
"""Minimum number of kept rows at which rows beyond LIMIT are dropped."""


def make_groups(
    select: Select, names: Sequence[Sequence[str]], rows: Iterable[ResultRow], most: Optional[int]
) -> Iterator[ResultRow]:
    """Make the rows of a result from rows with all columns, hidden ones included.

    Args:
        select: The analysed statement.
        names: Column names of each selected path.
        rows: Rows with all columns.
        most: Maximum number of rows that are taken; None = all.

    Raises:
        InvalidQuery: More than MEMORY_BYTES would have to be kept, or values to be ordered are of
            different kinds.
    """
    starts = [0, *accumulate(map(len, names))]
    shown = starts[len(select.visible)]
    if select.group:
        rows = _grouped(select, rows, shown)
    elif select.aggregates:
        rows = _total(select, rows)
    if select.distinct:
        rows = _distinct(select, rows, shown)
    if select.order:
        places = [starts[part.place] for part in select.order]
        _check_single(select, names)
        rows = _ordered(select, rows, places, most)
    return (row[:shown] for row in rows)


class _Memory:
    """The memory of the kept rows, with its limit."""

    def __init__(self, select: Select, position: int, remedy: str) -> None:
        self._text, self._position, self._remedy = select.text, position, remedy
        self._bytes = 0

    def take(self, row: ResultRow, more: int = 0) -> None:
        """Count a row; InvalidQuery: the limit is exceeded."""
        self._bytes += _size(row) + more
        if self._bytes > MEMORY_BYTES:
            reason = f"more than {MEMORY_BYTES // 2**20} MiB would have to be kept"
            raise InvalidQuery(self._text, self._position, f"{reason}; {self._remedy}")

    def clear(self) -> None:
        """Reset the count."""
        self._bytes = 0


def _size(row: ResultRow) -> int:
    found = getsizeof(row)
    for value in row:
        found += getsizeof(value) + (32 * len(value) if isinstance(value, list) else 0)
    return found


def _total(select: Select, rows: Iterable[ResultRow]) -> Iterator[ResultRow]:
    totals = Aggregation(select)
    totals.add(rows)
    yield totals.values()


def _grouped(select: Select, rows: Iterable[ResultRow], shown: int) -> Iterator[ResultRow]:
    """Yield a row for each group, with the values of GROUP BY after its columns."""
    remedy = "group by less, or by time(1h), or choose fewer rows by WHERE KEY > …"
    memory = _Memory(select, select.group[0].position, remedy)
    widths = slice(shown, shown + len(select.group))
    times = [n for n, t in enumerate(select.group) if isinstance(t, Call) and t.function == "time"]
    groups: dict[Tuple[Any, ...], Tuple[Aggregation, ResultRow]] = {}
    latest: Any = None
    for row in rows:
        by = row[widths]
        key = tuple(map(_identity, by))
        if (
            times and groups and key[times[0]] != latest
        ):  # rows are sorted by KEY, so these groups are complete
            yield from _finished(groups)
            groups.clear()
            memory.clear()
        latest = key[times[0]] if times else None
        if key not in groups:
            memory.take(row, TOTAL_BYTES * len(row))
            groups[key] = (Aggregation(select), by)
        groups[key][0].add((row,))
    yield from _finished(groups)


def _finished(
    groups: dict[Tuple[Any, ...], Tuple[Aggregation, ResultRow]],
) -> Iterator[ResultRow]:
    return ((*totals.values(), *by) for totals, by in groups.values())


def _distinct(select: Select, rows: Iterable[ResultRow], shown: int) -> Iterator[ResultRow]:
    remedy = "select fewer columns, or choose fewer rows by WHERE KEY > …"
    memory = _Memory(select, len(select.text) - len(select.text.lstrip()), remedy)
    seen = set()
    for row in rows:
        key = tuple(map(_identity, row[:shown]))
        if key not in seen:
            seen.add(key)
            memory.take(row, getsizeof(key))
            yield row


def _identity(value: Any) -> Any:
    """Return a key that is equal, with equal hash, for equal values."""
    if isinstance(value, list):
        return tuple(map(_identity, value))
    if hasattr(value, "to_nsec"):
        return value.to_nsec()
    return _NAN if value != value else value


_NAN = object()


def _check_single(select: Select, names: Sequence[Sequence[str]]) -> None:
    for part in select.order:
        if len(names[part.place]) != 1:
            reason = f"{part.what.text} has {len(names[part.place])} fields; name one of them"
            raise InvalidQuery(select.text, part.position, reason)


Key = Tuple[Any, ...]


def _ordered(
    select: Select, rows: Iterable[ResultRow], places: Sequence[int], most: Optional[int]
) -> Iterator[ResultRow]:
    remedy = "choose fewer rows by WHERE KEY > …, select fewer columns, or add a LIMIT"
    memory = _Memory(select, select.order[0].position, remedy)
    key = _key_of(select.order, places)
    enough = None if most is None else max(2 * most, LEAST_KEPT)
    kept: list[Tuple[Key, ResultRow]] = []
    try:
        for row in rows:
            kept.append((key(row), row))
            if enough is not None and len(kept) > enough:
                kept = _first(kept, most)
                memory.clear()
                for _, other in kept:
                    memory.take(other)
            else:
                memory.take(row)
        found = _first(kept, most)
    except TypeError as exc:
        reason = f"the definitions of this topic hold values of different kinds there ({exc})"
        raise InvalidQuery(select.text, select.order[0].position, reason) from None
    yield from (row for _, row in found)


def _first(kept: list[Tuple[Key, ResultRow]], most: Optional[int]) -> list[Tuple[Key, ResultRow]]:
    kept.sort(key=lambda pair: pair[0])  # stable: equal rows keep their order
    return kept[:most]


def _key_of(order: Sequence[Ordering], places: Sequence[int]) -> Callable[[ResultRow], Key]:
    pairs = [(place, part.descending) for place, part in zip(places, order)]
    return lambda row: tuple([_rank(row[place], down) for place, down in pairs])


def _rank(value: Any, descending: bool) -> Tuple[int, Any]:
    if value is None or value != value:
        return (2 if value is None else 1), 0
    value = _identity(value)
    return 0, _Down(value) if descending else value


class _Down:
    """Reverses the order of a value."""

    __slots__ = ("_value",)

    def __init__(self, value: Any) -> None:
        self._value = value

    def __lt__(self, other: _Down) -> bool:
        return bool(other._value < self._value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Down) and bool(other._value == self._value)

    __hash__ = None  # type: ignore[assignment]
