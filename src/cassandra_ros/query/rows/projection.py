# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of the result that one table's rows give for a statement."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, Iterable, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.errors import CorruptMessage, InvalidKey, MessageNotFound
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.rows.compiled_rows import CompiledRows, compile_rows, compile_wire_rows
from cassandra_ros.query.rows.condition_check import Check, RowValues
from cassandra_ros.query.rows.field_extractor import Extractor, extractor_of
from cassandra_ros.query.rows.name_resolution import (
    COUNTED,
    KEY_PLACE,
    OWN_WIDTH,
    NameResolver,
    Output,
)
from cassandra_ros.query.tree.expressions import Get
from cassandra_ros.query.tree.field_names import Array, Findings
from cassandra_ros.query.tree.syntax import Select

_log = logging.getLogger(__name__)

ResultRow = Tuple[Any, ...]
"""One value for each column of the result."""
RowIdentity = Tuple[Union[int, str], str, str, int]
"""KEY, NODE and RUN of a row, and its time, ns."""


@dataclass(frozen=True)
class Projection:
    """Reads, checks and shows the rows of one table; made by ``compile``.

    The values of a row are its KEY, NODE and RUN, its time, and those of the named fields.
    """

    groups: tuple[tuple[Output, ...], ...]
    """Columns of each selected path: one, or those of all fields of a message."""
    check: Check
    """The condition."""
    columns: Optional[Sequence[str]]
    """Columns of the table that are read, in order; None = all."""
    unnested: tuple[Array, ...]
    """Arrays of messages each of whose elements becomes a row, outermost first."""
    named: bool
    """Whether KEY is a name."""
    extractor: Optional[Extractor]
    width: int
    """Number of values of a row."""
    runs: bool = False
    """Whether RUN is needed; else its value is ''."""
    shown: tuple[tuple[Optional[int], Optional[Get]], ...] = ()
    """For each column of the result the index of its value (None: missing in this table), and the
    conversion for display."""
    checked: frozenset[int] = frozenset()
    """Indices of the values that the condition needs."""
    stored: int = 0
    """Number of columns of the table."""
    computed: tuple[Get, ...] = ()
    """Functions of the computed values, which follow the others."""

    @classmethod
    def compile(cls, select: Select, table: Table, findings: Findings) -> Projection:
        """Compile a statement for a table; ``findings`` collects the names that the table lacks."""
        names = NameResolver(table, findings)
        groups = [names.outputs(selected) for selected in select.visible]
        groups += [names.single(selected) for selected in select.hidden]
        checked, check = names.condition(select.condition)
        names.check_lengths()
        extractor = None
        columns: Optional[Sequence[str]] = ()
        if table.definition is not None and names.refs:
            extractor = extractor_of(table.definition, tuple(names.refs), tuple(names.unnested))
            columns = extractor.columns if table.by_field else None
        unnested, width = tuple(names.unnested), OWN_WIDTH + len(names.refs)
        placed, computed = _place_computed(groups, width)
        made = cls(placed, check, columns, unnested, table.named, extractor, width, names.runs)
        made = replace(made, computed=computed)
        if table.by_field:
            made = replace(made, checked=frozenset(checked), stored=len(table.columns))
        return made.showing([[output.name for output in group] for group in groups])

    def showing(self, names: Sequence[Sequence[str]]) -> Projection:
        """Return a projection with these columns for each selected path, None for missing ones."""
        shown: list[tuple[Optional[int], Optional[Get]]] = []
        for group, wanted in zip(self.groups, names):
            known = {output.name: (output.place, _show_of(output)) for output in group}
            shown += [known.get(name, (None, None)) for name in wanted]
        return replace(self, shown=tuple(shown))

    @cached_property
    def compiled(self) -> Optional[CompiledRows]:
        """Fast function for the rows of nearly all stored rows; see compiled_rows."""
        if self.extractor is None:
            return None
        if not self.stored:
            read = self.extractor.whole()
            if read is None:
                return None
            return compile_wire_rows(
                read, self.own, self.check, self.shown, KEY_PLACE, self.computed
            )
        direct = self.extractor.direct()
        if direct is None or self.columns is None:
            return None
        return compile_rows(
            direct,
            self.own,
            self.check,
            tuple(self.checked),
            self.shown,
            KEY_PLACE,
            self.computed,
            own_width=OWN_WIDTH,
            asked=len(self.columns),
            stored=self.stored,
        )

    def own(self, row: Row) -> RowIdentity:
        """Return the values of a row that are not fields."""
        t = row.t
        return (row.name if self.named else t, row.node, row.run if self.runs else "", t)

    def values(self, row: Row) -> Iterator[RowValues]:
        """Yield the values of a row, once or for each unnested element; None = missing."""
        own = self.own(row)
        if self.extractor is None:
            yield own
            return
        try:
            for found in self.extractor.values(row):
                yield (*own, *found)
        except MessageNotFound:
            return  # the message was deleted after its columns were read
        except CorruptMessage as exc:
            _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
            yield (*own, *[None] * (self.width - OWN_WIDTH))

    def hits(self, row: Row) -> Iterator[bool]:
        """Yield for each unnested element of a stored row whether it satisfies the condition."""
        return (self.check(values) is True for values in self.values(row))

    def hit(self, row: Row) -> bool:
        """Return whether a row, or one of its unnested elements, satisfies the condition."""
        found = None if self.compiled is None else self.compiled(row)
        return any(self.hits(row)) if found is None else bool(found)

    def rows(self, row: Row) -> Iterable[ResultRow]:
        """Return the rows of the result that a stored row gives; unnested elements lazily."""
        compiled = self.compiled
        found = None if compiled is None else compiled(row)
        if found is not None:
            return found
        return (self._row(row, v) for v in self.values(row) if self.check(v) is True)

    def complete(self, values: RowValues) -> RowValues:
        """Return the values of a row, followed by the computed ones."""
        return [*values, *[get(values) for get in self.computed]] if self.computed else values

    def _row(self, row: Row, values: RowValues) -> ResultRow:
        values = self.complete(values)
        found: list[object] = []
        made: dict[int, object] = {}
        for place, show in self.shown:
            if place is None:
                found.append(None)
            elif place == KEY_PLACE and show is None:
                found.append(row.key)
            elif show is None:
                found.append(values[place])
            else:
                # A column that is selected twice is computed once.
                if place not in made:
                    made[place] = show(values[place])
                found.append(made[place])
        return tuple(found)


class Projections:
    """The projections of a statement, one for each table of a topic, also for tables added later.

    Attributes:
        names: Column names of each selected path, over all tables, hidden columns last.

    Raises:
        InvalidQuery: The statement names a field that no table has.
    """

    def __init__(self, select: Select, tables: Sequence[Table]) -> None:
        self._select = select
        findings = Findings(select.text)
        made = {table.name: Projection.compile(select, table, findings) for table in tables}
        findings.check()
        self.names = [[selected.text] for selected in select.asked if selected is not None]
        if made:
            same = zip(*(projection.groups for projection in made.values()))
            found = [list(dict.fromkeys(o.name for o in chain(*groups))) for groups in same]
            # A column computed from fields of several definitions may be missing in all tables.
            self.names = [
                names or ([] if selected is None or selected.is_path else [selected.text])
                for names, selected in zip(found, select.asked)
            ]
        self._made = {name: each.showing(self.names) for name, each in made.items()}

    def __iter__(self) -> Iterator[Projection]:
        return iter(self._made.values())

    def of(self, table: Table) -> Projection:
        """Return the projection of a table, with the columns ``names`` whatever fields it has."""
        if table.name not in self._made:  # the table was added later
            projection = Projection.compile(self._select, table, Findings(self._select.text))
            self._made[table.name] = projection.showing(self.names)
        return self._made[table.name]

    def columns(self, table: Table) -> Optional[Sequence[str]]:
        """Return the columns of a table that are read, in order; None = all."""
        return self.of(table).columns

    def hit(self, row: Row) -> bool:
        """Return whether a row, or one of its unnested elements, satisfies the condition."""
        return self.of(row.table).hit(row)


def _place_computed(
    groups: Sequence[Sequence[Output]], width: int
) -> tuple[tuple[tuple[Output, ...], ...], tuple[Get, ...]]:
    """Assign indices after the other values to the computed values."""
    computed: list[Get] = []
    placed: list[tuple[Output, ...]] = []
    for group in groups:
        found = []
        for output in group:
            if output.compute is not None:
                computed.append(output.compute)
                output = output._replace(place=width + len(computed) - 1)
            found.append(output)
        placed.append(tuple(found))
    return tuple(placed), tuple(computed)


def _shown_as(make: Get) -> Get:
    def show(value: object) -> object:
        if isinstance(value, list):
            return [show(element) for element in value]
        return None if value is None else make(value)

    return show


def _time(ns: int) -> Union[Stamp, int]:
    try:
        return Stamp.from_ns(ns)
    except InvalidKey:
        return ns  # outside ROS time: computed, or nsecs over a second at its end


def _duration(ns: int) -> object:
    try:
        origin = Stamp.from_ns(0)
        # Same representation as genpy's Duration, without importing genpy here.
        return Stamp.from_ns(ns) - origin if ns >= 0 else origin - Stamp.from_ns(-ns)
    except InvalidKey:
        return ns  # a computed duration may be too long for genpy


_SHOWS = {"time": _shown_as(_time), "duration": _shown_as(_duration)}


def _show_of(output: Output) -> Optional[Get]:
    """Return the conversion of a value for display.

    None = unchanged, or KEY, shown as the row's key.
    """
    if output.place == KEY_PLACE:
        return _itself if output.kind == COUNTED else None
    return _SHOWS.get(output.kind)


def _itself(value: object) -> object:
    return value
