# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Analysis of a SELECT when the fields of its topic are known.

``min(ranges)`` of an array is a value of each row, ``min(range_min)`` of a number is one value of
all rows. A name in GROUP BY or ORDER BY may be an alias. Columns for grouping and ordering must be
computed even if they are not shown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Optional, Sequence, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.tree.field_names import field_of
from cassandra_ros.query.tree.syntax import (
    Aggregate,
    Call,
    Ordering,
    Path,
    Select,
    Selected,
    StatementError,
    Term,
    is_constant,
)

What = Union[Term, Aggregate]


def analyse_select(select: Select, tables: Sequence[Table]) -> Select:
    """Return the analysed statement, with its ``hidden`` columns.

    Analysing it again changes nothing.

    Raises:
        InvalidQuery: A shown or ordering column has more than one value in a group.
    """
    if select.hidden or not (select.aggregates or select.group or select.order):
        return select
    splitter = _AggregateSplitter(tables)
    columns = select.columns
    if columns is not None:
        columns = tuple(replace(c, what=splitter.of(c.what)) for c in columns)
    order = tuple(replace(o, what=splitter.of(o.what)) for o in select.order)
    try:
        select = replace(select, columns=columns, order=order)
        select = _grouped(select) if select.group else select
        _check_columns(select)
        return _ordered(select)
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None


class _AggregateSplitter:
    """Distinguishes aggregates of one array from aggregates of all rows."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self._tables = tables

    def of(self, what: What) -> What:
        if isinstance(what, Aggregate) and what.function != "count":
            operand = what.operand
            if isinstance(operand, Path) and any(_is_array(operand, t) for t in self._tables):
                return Call(what.function, (operand,), what.position)
        return what


def _is_array(path: Path, table: Table) -> bool:
    try:
        return table.definition is not None and field_of(path, table.definition, True).is_array
    except StatementError:
        return False


def _grouped(select: Select) -> Select:
    """Add the GROUP BY terms to the hidden columns."""
    columns = select.columns or ()
    aliases = {c.alias: c.what for c in columns if c.alias and not isinstance(c.what, Aggregate)}
    terms = []
    for term in select.group:
        named = aliases.get(term.text) if isinstance(term, Path) else None
        found = term if named is None or isinstance(named, Aggregate) else named
        if is_constant(found):
            raise StatementError(term.position, f"{term.text} is the same in every row")
        terms.append(found)
    return replace(select, group=tuple(terms), hidden=tuple(map(Selected, terms)))


def _check_columns(select: Select) -> None:
    """Refuse columns with more than one value in a group."""
    if not (select.group or select.aggregates):
        return
    if select.columns is None:
        reason = "selects the terms of GROUP BY, and aggregates of other fields, instead of *"
        raise StatementError(select.group[0].position, f"a statement with GROUP BY {reason}")
    known = {term.text for term in select.group}
    for column in select.columns:
        what = column.what
        if isinstance(what, Aggregate) or what.text in known:
            continue
        if not select.group:
            one = select.aggregates[0]
            reason = "is one value made of all rows: it stands alone or beside other aggregates, "
            reason += f"not beside {what.text}, unless GROUP BY names that"
            raise StatementError(one.position, f"{one.text} {reason}")
        reason = f"{what.text} is not a term of GROUP BY; add it there, or "
        raise StatementError(what.position, f"{reason}take one value of it, as max({what.text})")


def _ordered(select: Select) -> Select:
    """Set the column of each ORDER BY item, a hidden one if it is not shown."""
    placed, hidden = [], list(select.hidden)
    every = len(select.visible)
    limited = bool(select.group or select.aggregates or select.distinct)
    for part in select.order:
        place = _place(select, part.what)
        if not isinstance(part.what, Aggregate) and is_constant(part.what):
            raise StatementError(part.position, f"{part.what.text} is the same in every row")
        if place is None:
            if limited:
                how = "DISTINCT" if select.distinct else "aggregates"
                reason = f"with {how} rows are ordered by a column that is shown; select it, too"
                raise StatementError(part.position, f"{part.what.text} is not selected: {reason}")
            if isinstance(part.what, Aggregate):
                reason = "is one value made of all rows and cannot order them; with GROUP BY it is "
                reason += "one value of each group, by which groups are ordered if it is selected"
                raise StatementError(part.position, f"{part.what.text} {reason}")
            place = every + len(hidden)
            hidden.append(Selected(part.what))
        placed.append(Ordering(part.what, part.descending, part.position, place))
    return replace(select, order=tuple(placed), hidden=tuple(hidden))


def _place(select: Select, what: What) -> Optional[int]:
    """Return the index of a term among all columns, hidden ones included, or None."""
    limited = bool(select.group or select.aggregates or select.distinct)
    for place, selected in enumerate(select.asked):
        if selected is None:
            continue
        called = selected.alias is not None and selected.alias == what.text
        if called or (limited and selected.what.text == what.text):
            return place
    return None
