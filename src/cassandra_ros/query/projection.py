# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a statement makes of the rows of one table."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, Callable, Iterator, NamedTuple, Optional, Sequence, Tuple, Union

from cassandra_ros.errors import CorruptMessage, InvalidKey, MessageNotFound
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.compiled_rows import CompiledRows, compile_rows, compile_wire_rows
from cassandra_ros.query.evaluate import Check, Values, compile_condition
from cassandra_ros.query.extract import Extractor, Get, extractor_of
from cassandra_ros.query.literals import Comparable, fit_to_field, fit_to_text, fit_to_time
from cassandra_ros.query.names import Array, FieldRef, Findings, all_fields, field_of, fields_of
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.syntax import (
    Aggregate,
    Compare,
    KeyOperand,
    Leaf,
    Literal,
    NodeOperand,
    Operand,
    Path,
    RunOperand,
    Select,
    Selected,
    StatementError,
    wants_array,
)

_log = logging.getLogger(__name__)

KEY_PLACE, NODE_PLACE, RUN_PLACE = 0, 1, 2
_OWN_WIDTH = 3
_BESIDE = -1
"""From here downwards are the marks of problems that no other table can make good."""
_COUNTED = "int64"
"""Kind of a count: whatever is counted is not shown."""
_NO_NUMBERS = ("string", "time", "duration")

ResultRow = Tuple[Any, ...]
"""A value for each column of the result."""


class Output(NamedTuple):
    """One column of a result, in one table."""

    name: str
    place: int
    """Where its value stands among the values of a row."""
    kind: str
    """ROS type of a value; 'sum' is an integer of any size."""
    ref: Optional[FieldRef] = None
    """The field that it shows; None for KEY, NODE, RUN and what is computed."""


@dataclass(frozen=True)
class Projection:
    """Reads, filters and shows the rows of one table; made by ``compile``.

    The values of a row are its KEY, NODE and RUN, and those of the fields that the statement names.
    """

    groups: tuple[tuple[Output, ...], ...]
    """What each selected path gives: one column, or those of a whole message."""
    check: Check
    """The condition."""
    columns: Optional[Sequence[str]]
    """Columns of its table that are read, in their order; None = all."""
    unnested: tuple[Array, ...]
    """The arrays of messages each of whose elements is a row, outermost first."""
    named: bool
    """KEY is a name."""
    extractor: Optional[Extractor]
    width: int
    """How many values a row has."""
    runs: bool = False
    """RUN is named; else its value is ''."""
    shown: tuple[tuple[Optional[int], Optional[Get]], ...] = ()
    """For each column of the result its place (None: missing here), and how to show a value."""
    checked: frozenset[int] = frozenset()
    """Places of the values that the condition needs."""
    stored: int = 0
    """How many columns its table has."""

    @classmethod
    def compile(cls, select: Select, table: Table, findings: Findings) -> Projection:
        """Find out what a statement means in a table; findings collect what it names in vain."""
        names = _Names(table, findings)
        every = (Selected(KeyOperand(0)), None)
        asked = every if select.columns is None else select.columns
        groups = tuple(tuple(names.outputs(selected)) for selected in asked)
        checked: set[int] = set()

        def locate(leaf: Leaf) -> Optional[int]:
            place = names.locate(leaf)
            checked.update(() if place is None else (place,))
            return place

        check = compile_condition(select.condition, locate, names.fit)
        extractor = None
        columns: Optional[Sequence[str]] = ()
        if table.definition is not None and names.refs:
            extractor = extractor_of(table.definition, tuple(names.refs), tuple(names.unnested))
            columns = extractor.columns if table.by_field else None
        unnested, width = tuple(names.unnested), _OWN_WIDTH + len(names.refs)
        made = cls(groups, check, columns, unnested, table.named, extractor, width, names.runs)
        if table.by_field:
            made = replace(made, checked=frozenset(checked), stored=len(table.columns))
        return made.showing([[output.name for output in group] for group in groups])

    def showing(self, names: Sequence[Sequence[str]]) -> Projection:
        """Return one that shows these columns of each selected path, None where it lacks one."""
        shown: list[tuple[Optional[int], Optional[Get]]] = []
        for group, wanted in zip(self.groups, names):
            known = {output.name: (output.place, _show_of(output)) for output in group}
            shown += [known.get(name, (None, None)) for name in wanted]
        return replace(self, shown=tuple(shown))

    @cached_property
    def compiled(self) -> Optional[CompiledRows]:
        """What makes the rows of nearly all stored ones, and quickly."""
        if self.extractor is None:
            return None
        if not self.stored:
            read = self.extractor.whole()
            if read is None:
                return None
            return compile_wire_rows(read, self.own, self.check, self.shown, KEY_PLACE)
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
            own_width=_OWN_WIDTH,
            asked=len(self.columns),
            stored=self.stored,
        )

    def own(self, row: Row) -> tuple[Union[int, str], str, str]:
        """Return the values of a row that are of no field."""
        return (row.name if self.named else row.t, row.node, row.run if self.runs else "")

    def values(self, row: Row) -> Sequence[Values]:
        """Return the values of a row, once or for each unnested element; None = missing."""
        own = self.own(row)
        if self.extractor is None:
            return [own]
        try:
            return [(*own, *found) for found in self.extractor.values(row)]
        except MessageNotFound:
            return []  # removed since its columns were read
        except CorruptMessage as exc:
            _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
            return [(*own, *[None] * (self.width - _OWN_WIDTH))]

    def hits(self, row: Row) -> Iterator[bool]:
        """Say of each unnested element of a stored row whether it satisfies the condition."""
        return (self.check(values) is True for values in self.values(row))

    def hit(self, row: Row) -> bool:
        """Say whether a row, or one unnested element of it, satisfies the condition."""
        found = None if self.compiled is None else self.compiled(row)
        return any(self.hits(row)) if found is None else bool(found)

    def rows(self, row: Row) -> list[ResultRow]:
        """Return the rows of the result that a stored row gives."""
        found = None if self.compiled is None else self.compiled(row)
        if found is not None:
            return found
        return [self._row(row, v) for v in self.values(row) if self.check(v) is True]

    def _row(self, row: Row, values: Values) -> ResultRow:
        found: list[object] = []
        for place, show in self.shown:
            if place is None:
                found.append(None)
            elif place == KEY_PLACE and show is None:
                found.append(row.key)
            else:
                found.append(values[place] if show is None else show(values[place]))
        return tuple(found)


class Projections:
    """The projections of a statement, one for each table of a topic, also of those made since.

    Attributes:
        names: The columns of each selected path, over all tables.

    Raises:
        InvalidQuery: The statement names what no table has.
    """

    def __init__(self, select: Select, tables: Sequence[Table]) -> None:
        self._select = select
        findings = Findings(select.text)
        made = {table.name: Projection.compile(select, table, findings) for table in tables}
        findings.check()
        columns = select.columns or (Selected(KeyOperand(0)),)
        self.names = [[selected.text] for selected in columns]
        if made:
            same = zip(*(projection.groups for projection in made.values()))
            self.names = [list(dict.fromkeys(o.name for o in chain(*groups))) for groups in same]
        self._made = {name: each.showing(self.names) for name, each in made.items()}

    def __iter__(self) -> Iterator[Projection]:
        return iter(self._made.values())

    def of(self, table: Table) -> Projection:
        """Return the projection of a table; ``names`` are its columns, whatever it has."""
        if table.name not in self._made:  # made since
            projection = Projection.compile(self._select, table, Findings(self._select.text))
            self._made[table.name] = projection.showing(self.names)
        return self._made[table.name]

    def columns(self, table: Table) -> Optional[Sequence[str]]:
        """Return the columns of a table that are read, in their order; None = all."""
        return self.of(table).columns

    def hit(self, row: Row) -> bool:
        """Say whether a row, or one unnested element of it, satisfies the condition."""
        return self.of(row.table).hit(row)


class _Names:
    """Finds the fields that a statement names in one table, while it is compiled."""

    def __init__(self, table: Table, findings: Findings) -> None:
        self._definition = table.definition
        self._named = table.named
        self._findings = findings
        self.refs: list[FieldRef] = []
        """The fields that were found so far, in the order of their values."""
        self._places: dict[FieldRef, int] = {}
        self.unnested: list[Array] = []
        """The arrays of messages whose elements are named, outermost first."""
        self.runs = False
        """RUN is named."""

    def outputs(self, selected: Optional[Selected]) -> Sequence[Output]:
        """Return the columns that one selected path gives; None = every field."""
        if selected is None:
            return self._shown(() if self._definition is None else all_fields(self._definition))
        what = selected.what
        if isinstance(what, Aggregate):
            return self._aggregated(what, selected.text)
        if not isinstance(what, Path):
            own = self._output(what)
            return [] if own is None else [own._replace(name=selected.text)]
        found = self._shown(self._resolved(what, lambda definition: fields_of(what, definition)))
        if selected.alias is None:
            return found
        if len(found) > 1:
            self._refuse(what, f"{what.text} has {len(found)} fields; AS gives a name to one")
        return [output._replace(name=selected.alias) for output in found[:1]]

    def _shown(self, refs: Sequence[FieldRef]) -> list[Output]:
        return [Output(ref.name, self._place(ref), ref.type, ref) for ref in refs]

    def _aggregated(self, asked: Aggregate, name: str) -> Sequence[Output]:
        operand, function = asked.operand, asked.function
        found = self._output(operand or KeyOperand(0))
        if found is None:
            return []
        if operand is not None and function in ("sum", "avg") and found.kind in _NO_NUMBERS:
            reason = f"{operand.text} is a {found.kind}, and {function} is for numbers; "
            problem = StatementError(operand.position, reason + "min, max and count take any field")
            self._findings.wrong.setdefault(asked.position, problem)
            return []
        self._findings.fine.add(asked.position)
        if function in ("min", "max"):
            return [found._replace(name=name)]
        total = "float64" if found.kind.startswith("float") else "sum"
        kinds = {"count": _COUNTED, "avg": "float64", "sum": total}
        return [Output(name, found.place, kinds[function])]

    def _output(self, operand: Operand, array: Optional[bool] = False) -> Optional[Output]:
        """Return the column of one operand; None where the table lacks it."""
        if isinstance(operand, NodeOperand):
            return Output(operand.text, NODE_PLACE, "string")
        if isinstance(operand, RunOperand):
            self.runs = True
            return Output(operand.text, RUN_PLACE, "string")
        if isinstance(operand, KeyOperand):
            return Output(operand.text, KEY_PLACE, "string" if self._named else "time")
        found = self._resolved(operand, lambda definition: [field_of(operand, definition, array)])
        return self._shown(found)[0] if found else None

    def locate(self, leaf: Leaf) -> Optional[int]:
        """Return the place of a comparison's operand; None where the table lacks it."""
        found = self._output(leaf.operand, wants_array(leaf))
        return None if found is None else found.place

    def fit(self, leaf: Leaf, literal: Literal) -> Optional[Comparable]:
        """Fit a literal to its operand; None where they cannot be compared here."""
        found = self._output(leaf.operand, wants_array(leaf))
        if found is None:
            return None
        try:
            fitted = _fitted(found, leaf, literal)
        except StatementError as exc:
            self._findings.wrong.setdefault(literal.position, exc)
            return None
        self._findings.fine.add(literal.position)
        return fitted

    def _resolved(
        self, path: Path, resolve: Callable[[Definition], list[FieldRef]]
    ) -> list[FieldRef]:
        try:
            if self._definition is None:
                raise StatementError(path.position, "the messages of this topic have no definition")
            found = resolve(self._definition)
        except StatementError as exc:
            self._findings.wrong.setdefault(path.position, exc)
            return []
        self._findings.fine.add(path.position)
        for ref in found:
            # Those whose elements the path names, not those that it names whole.
            for array in ref.arrays:
                if len(array) < len(path.parts) and array not in self.unnested:
                    self._unnest(path, array)
        return found

    def _unnest(self, path: Path, array: Array) -> None:
        inner = self.unnested[-1] if self.unnested else ()
        if array[: len(inner)] == inner:
            self.unnested.append(array)
            return
        names = [".".join(step.name for step in a) for a in (inner, array)]
        self._refuse(
            path,
            f"the statement names fields inside two arrays of messages, {names[0]} and "
            f"{names[1]}; ask for them in two statements, or name an element: {names[1]}[0]",
        )

    def _refuse(self, path: Path, reason: str) -> None:
        """Note that a path, although there is such a field, cannot stand where it does."""
        self._findings.wrong.setdefault(
            _BESIDE - path.position, StatementError(path.position, reason)
        )

    def _place(self, ref: FieldRef) -> int:
        place = self._places.get(ref)
        if place is None:
            place = self._places[ref] = _OWN_WIDTH + len(self.refs)
            self.refs.append(ref)
        return place


def _fitted(found: Output, leaf: Leaf, literal: Literal) -> Comparable:
    operand, sign = leaf.operand, leaf.operator if isinstance(leaf, Compare) else ""
    if sign == "CONTAINS" and found.ref is None:
        reason = f"{operand.text} is not an array; compare it with ="
        raise StatementError(operand.position, reason)
    if sign == "LIKE" and found.kind != "string":
        reason = f"is a {found.kind}, and LIKE is for text; compare it with = < > or BETWEEN"
        raise StatementError(operand.position, f"{operand.text} {reason}")
    if found.ref is not None:
        return fit_to_field(literal, found.ref)
    return fit_to_text(literal, operand.text) if found.kind == "string" else fit_to_time(literal)


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
        return ns  # nsecs beyond a second at the very end of time


def _duration(ns: int) -> object:
    origin = Stamp.from_ns(0)
    # genpy's Duration, without importing genpy here.
    return Stamp.from_ns(ns) - origin if ns >= 0 else origin - Stamp.from_ns(-ns)


_SHOWS = {"time": _shown_as(_time), "duration": _shown_as(_duration)}


def _show_of(output: Output) -> Optional[Get]:
    """Return how to show a value; None = as it is, of KEY the row's key."""
    if output.place == KEY_PLACE:
        return _itself if output.kind == _COUNTED else None
    return _SHOWS.get(output.kind)


def _itself(value: object) -> object:
    return value
