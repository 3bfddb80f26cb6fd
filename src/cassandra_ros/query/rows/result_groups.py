# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Result rows that are made from several rows: GROUP BY, aggregates, DISTINCT and ORDER BY.

``analyse_select`` analyses such a statement when the fields of its topic are known.
``min(ranges)`` of an array is a value of each row, ``min(range_min)`` of a number is one value of
all rows. A name in GROUP BY or ORDER BY may be an alias. Columns for grouping and key must be
computed even if they are not shown.

``make_groups`` makes the rows, of all columns of many rows at a time. Values are equal as in
conditions, but here NaN equals NaN, and missing is a value of its own. Groups and distinct rows
come in the order of their first row; groups of ``time(…)`` are returned as soon as they are
complete. Ordered rows are sorted by value, equal ones by KEY; NaN and, after it, missing values
come last, for ASC and DESC. Aggregates take one pass and keep no rows (``tree/accumulators``); they
ignore missing values, except ``count(*)``.

MEMORY_BYTES limits the rows that are kept: for ORDER BY about 2 n rows with LIMIT n, else all; one
row of each group; one of each set of equal rows.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, chain
from sys import getsizeof
from typing import Any, Callable, Iterable, Iterator, List, Sequence, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.projection import ResultRow
from cassandra_ros.query.tree.accumulators import TOTALS, Count, NumberColumn
from cassandra_ros.query.tree.field_names import field_of
from cassandra_ros.query.tree.syntax import (
    Aggregate,
    Call,
    FieldPath,
    Ordering,
    Select,
    Selected,
    StatementError,
    Term,
    is_constant,
)

What = Union[Term, Aggregate]
Column = Union[List[Any], NumberColumn]
"""The values of a column in some rows of the result: a list with None for a missing one, or an
array of numbers, of which none is missing."""
Columns = Sequence[Column]
"""The columns of some rows, in the order of reading."""


def columns_of(rows: Sequence[ResultRow]) -> Columns:
    """Return the columns of some rows."""
    return list(map(list, zip(*rows)))


def join_columns(parts: Sequence[Columns], order: NDArray[np.int64] | None) -> Columns:
    """Return the columns of several parts as one.

    Args:
        parts: The columns of each part, at least one.
        order: Index of each row among those of all parts; None = they are in this order.
    """
    if len(parts) == 1:
        return parts[0]
    joined: list[Column] = []
    for columns in zip(*parts):
        arrays = [column for column in columns if isinstance(column, np.ndarray)]
        if len(arrays) == len(columns) and len({array.dtype for array in arrays}) == 1:
            array = np.concatenate(arrays)
            joined.append(array if order is None else array[order])
        else:
            values = list(chain.from_iterable(map(listed, columns)))
            joined.append(values if order is None else [values[n] for n in order.tolist()])
    return joined


def rows_of(columns: Columns) -> Iterator[ResultRow]:
    """Return the rows of some columns."""
    return zip(*map(listed, columns))


def listed(column: Column) -> list[Any]:
    """Return the values of a column as objects of Python."""
    return column if isinstance(column, list) else column.tolist()


def analyse_select(select: Select, tables: Sequence[Table]) -> Select:
    """Return the analysed statement, with its ``hidden`` columns and ``Ordering.place``.

    Analysing it again changes nothing.

    Raises:
        InvalidQuery: A column has more than one value in a group; or a term of GROUP BY or ORDER BY
            is the same in every row, or cannot order these rows.
    """
    if select.hidden or not (select.aggregates or select.group or select.order):
        return select
    columns = select.columns
    if columns is not None:
        columns = tuple(replace(c, what=_in_each_row(c.what, tables)) for c in columns)
    order = tuple(replace(o, what=_in_each_row(o.what, tables)) for o in select.order)
    try:
        select = replace(select, columns=columns, order=order)
        select = _with_groups(select) if select.group else select
        _check_columns(select)
        return _with_order(select)
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None


def _in_each_row(what: What, tables: Sequence[Table]) -> What:
    """Return an aggregate of one array as a Call, which has a value in each row; else ``what``."""
    if isinstance(what, Aggregate) and what.function != "count":
        operand = what.operand
        if isinstance(operand, FieldPath) and any(_is_array(operand, t) for t in tables):
            return Call(what.function, (operand,), what.position)
    return what


def _is_array(path: FieldPath, table: Table) -> bool:
    try:
        return table.definition is not None and field_of(path, table.definition, True).is_array
    except StatementError:
        return False


def _with_groups(select: Select) -> Select:
    """Put terms in place of aliases in GROUP BY, and add these terms to the hidden columns."""
    columns = select.columns or ()
    aliases = {c.alias: c.what for c in columns if c.alias and not isinstance(c.what, Aggregate)}
    terms = []
    for term in select.group:
        aliased = aliases.get(term.text) if isinstance(term, FieldPath) else None
        group_term = term if aliased is None or isinstance(aliased, Aggregate) else aliased
        if is_constant(group_term):
            raise StatementError(term.position, f"{term.text} is the same in every row")
        terms.append(group_term)
    return replace(select, group=tuple(terms), hidden=tuple(map(Selected, terms)))


def _check_columns(select: Select) -> None:
    """Refuse columns with more than one value in a group."""
    if not (select.group or select.aggregates):
        return
    if select.columns is None:
        reason = "selects the terms of GROUP BY, and aggregates of other fields, instead of *"
        raise StatementError(select.group[0].position, f"a statement with GROUP BY {reason}")
    texts = {term.text for term in select.group}
    for column in select.columns:
        what = column.what
        if isinstance(what, Aggregate) or what.text in texts:
            continue
        if not select.group:
            aggregate = select.aggregates[0]
            reason = "is one value made of all rows: it stands alone or beside other aggregates, "
            reason += f"not beside {what.text}, unless GROUP BY names that"
            raise StatementError(aggregate.position, f"{aggregate.text} {reason}")
        reason = f"{what.text} is not a term of GROUP BY; add it there, or "
        raise StatementError(what.position, f"{reason}take one value of it, as max({what.text})")


def _with_order(select: Select) -> Select:
    """Set the column of each ORDER BY item, a hidden one if it is not shown."""
    order, hidden = [], list(select.hidden)
    only_shown = _orders_by_shown(select)
    for key in select.order:
        place = _column_index(select, key.what)
        if not isinstance(key.what, Aggregate) and is_constant(key.what):
            raise StatementError(key.position, f"{key.what.text} is the same in every row")
        if place is None:
            if only_shown:
                how = "DISTINCT" if select.distinct else "aggregates"
                reason = f"with {how} rows are ordered by a column that is shown; select it, too"
                raise StatementError(key.position, f"{key.what.text} is not selected: {reason}")
            if isinstance(key.what, Aggregate):
                reason = "is one value made of all rows and cannot order them; with GROUP BY it is "
                reason += "one value of each group, by which groups are ordered if it is selected"
                raise StatementError(key.position, f"{key.what.text} {reason}")
            place = len(select.visible) + len(hidden)
            hidden.append(Selected(key.what))
        order.append(Ordering(key.what, key.descending, key.position, place))
    return replace(select, order=tuple(order), hidden=tuple(hidden))


def _orders_by_shown(select: Select) -> bool:
    """Return whether only a shown column, or a term of GROUP BY, can order the rows."""
    return bool(select.group or select.aggregates or select.distinct)


def _column_index(select: Select, what: What) -> int | None:
    """Return the index of a term among all columns, hidden ones included.

    None: there is no such column; where any term can order the rows, only aliases are looked up.
    """
    for index, selected in enumerate(select.asked):
        if selected is None:
            continue
        is_alias = selected.alias is not None and selected.alias == what.text
        if is_alias or (_orders_by_shown(select) and selected.what.text == what.text):
            return index
    return None


class Aggregation:
    """The columns of a statement over several rows: aggregates, or the value of the first row."""

    def __init__(self, select: Select) -> None:
        self._text = select.text
        self._asked = [column.what for column in select.columns or ()]
        self._totals: list[Count | _First] = [
            TOTALS[what.function]() if isinstance(what, Aggregate) else _First()
            for what in self._asked
        ]

    def add(self, columns: Columns) -> None:
        """Add rows with all columns, from which missing values are left out.

        InvalidQuery: the values of a field cannot be compared with each other.
        """
        for total, what, column in zip(self._totals, self._asked, columns):
            try:
                if isinstance(column, list):
                    for value in column:
                        if value is not None:
                            total.add(value)
                else:
                    total.add_array(column)
            except TypeError as exc:
                reason = (
                    "the definitions of this topic hold values of different kinds there, "
                    f"which {what.text.split('(')[0]} cannot compare ({exc})"
                )
                raise InvalidQuery(self._text, what.position, reason) from None

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

    def add_array(self, values: NumberColumn) -> None:
        if len(values):
            self.add(values[0].item())

    def value(self) -> object:
        return self._value


MEMORY_BYTES = 256 * 1024 * 1024
"""Maximum memory for the kept rows of one statement, bytes, as Python counts it."""
TOTAL_BYTES = 1024
"""Approximate memory of one aggregate, bytes."""
LEAST_KEPT = 1000
"""Minimum number of kept rows at which rows beyond LIMIT are dropped."""


def make_groups(
    select: Select, names: Sequence[Sequence[str]], parts: Iterable[Columns], most: int | None
) -> Iterator[ResultRow]:
    """Make the rows of a result from rows with all columns, hidden ones included.

    Args:
        select: The analysed statement.
        names: Column names of each selected path, hidden ones included.
        parts: All columns of some rows at a time.
        most: Maximum number of rows that are taken; None = all.

    Raises:
        InvalidQuery: More than MEMORY_BYTES would have to be kept, or values to be ordered are of
            different kinds.
    """
    starts = [0, *accumulate(map(len, names))]
    width = starts[len(select.visible)]
    if select.group:
        rows = _group(select, parts, width)
    elif select.aggregates:
        rows = _total(select, parts)
    else:
        rows = chain.from_iterable(map(rows_of, parts))
    if select.distinct:
        rows = _distinct(select, rows, width)
    if select.order:
        places = [starts[key.place] for key in select.order]
        _check_single(select, names)
        rows = _order(select, rows, places, most)
    return (row[:width] for row in rows)


class _Memory:
    """The memory of the kept rows, with its limit.

    Args:
        position: Position in the statement that an error shows.
        remedy: What to do instead, as the end of the error text.
    """

    def __init__(self, select: Select, position: int, remedy: str) -> None:
        self._text, self._position, self._remedy = select.text, position, remedy
        self._bytes = 0

    def count_row(self, row: ResultRow, more: int = 0) -> None:
        """Count a kept row and ``more`` bytes.

        Raises:
            InvalidQuery: The limit is exceeded.
        """
        self._bytes += _size(row) + more
        if self._bytes > MEMORY_BYTES:
            reason = f"more than {MEMORY_BYTES // 2**20} MiB would have to be kept"
            raise InvalidQuery(self._text, self._position, f"{reason}; {self._remedy}")

    def clear(self) -> None:
        """Reset the count."""
        self._bytes = 0


def _size(row: ResultRow) -> int:
    """Return the approximate memory of a row, bytes; 32 for each element of a list."""
    size = getsizeof(row)
    for value in row:
        size += getsizeof(value) + (32 * len(value) if isinstance(value, list) else 0)
    return size


def _total(select: Select, parts: Iterable[Columns]) -> Iterator[ResultRow]:
    totals = Aggregation(select)
    for columns in parts:
        totals.add(columns)
    yield totals.values()


def _group(select: Select, parts: Iterable[Columns], width: int) -> Iterator[ResultRow]:
    """Yield a row for each group, with the values of GROUP BY after its columns.

    ``width``: Number of columns that are shown; those of GROUP BY follow in ``parts`` too.
    """
    remedy = "group by less, or by time(1h), or choose fewer rows by WHERE KEY > …"
    memory = _Memory(select, select.group[0].position, remedy)
    group_columns = slice(width, width + len(select.group))
    times = [n for n, t in enumerate(select.group) if isinstance(t, Call) and t.function == "time"]
    groups: dict[tuple[Any, ...], tuple[Aggregation, ResultRow]] = {}
    latest: Any = None
    for columns in parts:
        for key, members in _members(columns[group_columns]).items():
            # Rows are sorted by KEY, so the groups of another time are complete.
            if times and groups and key[times[0]] != latest:
                yield from _finish(groups)
                groups.clear()
                memory.clear()
            latest = key[times[0]] if times else None
            rows = [_chosen(column, members) for column in columns]
            if key not in groups:
                first = tuple([listed(column[:1])[0] for column in rows])
                memory.count_row(first, TOTAL_BYTES * len(first))
                groups[key] = (Aggregation(select), first[group_columns])
            groups[key][0].add(rows)
    yield from _finish(groups)


def _members(columns: Columns) -> dict[tuple[Any, ...], list[int]]:
    """Return the indices of the rows of each group, the groups in the order of their first row."""
    members: dict[tuple[Any, ...], list[int]] = {}
    for n, key in enumerate(zip(*map(_identities, columns))):
        members.setdefault(key, []).append(n)
    return members


def _identities(column: Column) -> Iterator[Any]:
    """Yield what ``_identity`` returns for each value of a column."""
    latest: Any = None
    identity = None
    for value in listed(column):
        if value is not latest:  # one object stands for many rows, as a rounded time
            latest, identity = value, _identity(value)
        yield identity


def _chosen(column: Column, members: Sequence[int]) -> Column:
    """Return the values of a column in some rows, in their order."""
    if len(members) == len(column):
        return column
    if isinstance(column, list):
        return [column[n] for n in members]
    return column[members]


def _finish(
    groups: dict[tuple[Any, ...], tuple[Aggregation, ResultRow]],
) -> Iterator[ResultRow]:
    return ((*totals.values(), *by) for totals, by in groups.values())


def _distinct(select: Select, rows: Iterable[ResultRow], width: int) -> Iterator[ResultRow]:
    remedy = "select fewer columns, or choose fewer rows by WHERE KEY > …"
    memory = _Memory(select, len(select.text) - len(select.text.lstrip()), remedy)
    keys = set()
    for row in rows:
        key = tuple(map(_identity, row[:width]))
        if key not in keys:
            keys.add(key)
            memory.count_row(row, getsizeof(key))
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
    for key in select.order:
        if len(names[key.place]) != 1:
            reason = f"{key.what.text} has {len(names[key.place])} fields; name one of them"
            raise InvalidQuery(select.text, key.position, reason)


_SortKey = Tuple[Any, ...]


def _order(
    select: Select, rows: Iterable[ResultRow], places: Sequence[int], most: int | None
) -> Iterator[ResultRow]:
    """Yield rows sorted by the columns at ``places``, one for each item of ORDER BY."""
    remedy = "choose fewer rows by WHERE KEY > …, select fewer columns, or add a LIMIT"
    memory = _Memory(select, select.order[0].position, remedy)
    key = _key_of(select.order, places)
    enough = None if most is None else max(2 * most, LEAST_KEPT)
    buffer: list[tuple[_SortKey, ResultRow]] = []
    try:
        for row in rows:
            buffer.append((key(row), row))
            if enough is not None and len(buffer) > enough:
                buffer = _first_sorted(buffer, most)
                memory.clear()
                for _, other in buffer:
                    memory.count_row(other)
            else:
                memory.count_row(row)
        pairs = _first_sorted(buffer, most)
    except TypeError as exc:
        reason = f"the definitions of this topic hold values of different kinds there ({exc})"
        raise InvalidQuery(select.text, select.order[0].position, reason) from None
    yield from (row for _, row in pairs)


def _first_sorted(
    pairs: list[tuple[_SortKey, ResultRow]], most: int | None
) -> list[tuple[_SortKey, ResultRow]]:
    pairs.sort(key=lambda pair: pair[0])  # stable: equal rows keep their order
    return pairs[:most]


def _key_of(order: Sequence[Ordering], places: Sequence[int]) -> Callable[[ResultRow], _SortKey]:
    pairs = [(place, key.descending) for place, key in zip(places, order)]
    return lambda row: tuple([_rank(row[place], down) for place, down in pairs])


def _rank(value: Any, descending: bool) -> tuple[int, Any]:
    """Return the sort key of a value: NaN, and then missing, comes last in both directions."""
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
