# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How the rows of one table become rows of a result."""

from __future__ import annotations

from typing import Any, Callable, Optional, Sequence, Tuple

from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.conditions import readable
from cassandra_ros.query.evaluate import compileCondition
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.scope import KEY_PLACE, NODE_PLACE, Findings, Scope
from cassandra_ros.query.syntax import Aggregate, Column, Key, Node, Path, Select

Show = Callable[[Any], Any]
_Column = Tuple[str, int, Optional[Show]]
"""Name, place among the values, how to show it."""


class TablePlan:
    """Reads, filters and shows the rows of one table.

    Args:
        select: The statement.
        definition: Of the table's messages, None where there is no usable one.
        findings: Collects what the statement names in vain.
        named: Its rows are kept under names.
    """

    def __init__(
        self,
        select: Select,
        definition: Optional[Definition],
        findings: Findings,
        named: bool = False,
    ) -> None:
        scope = Scope(definition, findings, named)
        self._groups = _groups(select, scope)
        self._check = compileCondition(select.condition, scope.locate, scope.fit)
        self._extractor = scope.extractor()
        self._scope = scope
        self.unnests = scope.unnests
        self.names = [[name for name, _, _ in group] for group in self._groups]
        """Columns of each selected path (one, or those of a whole message)."""
        self._shown: list[Optional[_Column]] = []
        self.follow(self.names)

    def columns(self, table: Table) -> Optional[Sequence[str]]:
        """Name the columns of its table that are read; None = all."""
        if self._extractor is None:
            return ()
        return self._extractor.columns if table.by_field else None

    def follow(self, names: Sequence[Sequence[str]]) -> None:
        """Show these columns of each path; those that the table lacks are None."""
        self._shown = []
        for group, wanted in zip(self._groups, names):
            known = {column[0]: column for column in group}
            self._shown.extend(known.get(name) for name in wanted)

    def rows(self, row: Row) -> list[tuple[Any, ...]]:
        """Return the rows of the result that a stored row gives."""
        scope = self._scope
        found = readable(row, scope.rows(row, self._extractor), scope.width)
        return [self._show(row, values) for values in found if self._check(values) is True]

    def _show(self, row: Row, values: Sequence[Any]) -> tuple[Any, ...]:
        shown: list[Any] = []
        for column in self._shown:
            if column is None:
                shown.append(None)
                continue
            _, place, show = column
            if place == KEY_PLACE:
                shown.append(row.key)
            else:
                value = values[place]
                shown.append(value if show is None or value is None else show(value))
        return tuple(shown)


def uniteColumns(select: Select, plans: Sequence[TablePlan]) -> list[list[str]]:
    """Return the columns of each selected path over all tables, and let the plans show them."""
    if not plans:
        return [[column.text] for column in select.columns or (Column(Key(0)),)]
    united: list[list[str]] = []
    for groups in zip(*(plan.names for plan in plans)):
        united.append(list(dict.fromkeys(name for group in groups for name in group)))
    for plan in plans:
        plan.follow(united)
    return united


def _groups(select: Select, scope: Scope) -> list[list[_Column]]:
    if select.columns is None:
        return [[("KEY", KEY_PLACE, None)], _fields(scope, None)]
    return [_group(column, scope) for column in select.columns]


def _group(column: Column, scope: Scope) -> list[_Column]:
    what = column.what
    if isinstance(what, Aggregate):
        found = scope.aggregated(what)
        return [(column.text, found[0], _SHOWS.get(found[1]))] if found else []
    if isinstance(what, Key):
        return [(column.text, KEY_PLACE, None)]
    if isinstance(what, Node):
        return [(column.text, NODE_PLACE, None)]
    fields = _fields(scope, what)
    if column.alias is None:
        return fields
    if len(fields) > 1:
        scope.refuse(what, f"{what.text} has {len(fields)} fields; AS gives a name to one")
    return [(column.alias, place, show) for _, place, show in fields[:1]]


def _fields(scope: Scope, path: Optional[Path]) -> list[_Column]:
    return [(name, place, _SHOWS.get(ref.type)) for name, ref, place in scope.columns(path)]


def _time(value: Any) -> Any:
    if isinstance(value, list):
        return [_time(element) for element in value]
    if value is None:
        return None
    try:
        return Stamp.fromNs(value)
    except InvalidKey:
        return value  # nsecs beyond a second at the very end of time


def _duration(value: Any) -> Any:
    if isinstance(value, list):
        return [_duration(element) for element in value]
    if value is None:
        return None
    origin = Stamp.fromNs(0)
    # genpy's Duration, without importing genpy here.
    return Stamp.fromNs(value) - origin if value >= 0 else origin - Stamp.fromNs(-value)


_SHOWS: dict[str, Show] = {"time": _time, "duration": _duration}
