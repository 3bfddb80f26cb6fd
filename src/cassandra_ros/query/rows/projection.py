# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of the result that one table's rows give for a statement.

The values of fields are read from the stored bytes without making message objects. An array of
messages whose elements a statement names is unnested: the message gives one list of values per
element. Any other array of messages on the path to a field gives a list of the field's values.
"""

from __future__ import annotations

import logging
import struct
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from operator import itemgetter
from typing import (
    Any,
    Callable,
    Container,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

from cassandra_ros.errors import CorruptMessage, InvalidKey, MessageNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.messages.wire.cql_values import CQL_CODES
from cassandra_ros.messages.wire.wire_builder import BUILD_ERRORS
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.rows.name_resolution import (
    COUNT_KIND,
    KEY_PLACE,
    OWN_WIDTH,
    Check,
    Findings,
    NameResolver,
    ResultColumn,
    RowValues,
)
from cassandra_ros.query.tree.expressions import Get
from cassandra_ros.query.tree.field_names import Array, FieldRef
from cassandra_ros.query.tree.syntax import Select

FieldValueList = List[Any]
"""Values of some fields."""


class ColumnField(NamedTuple):
    """A field that is in a column of format ``ros``: the whole value, or a part of it."""

    place: int
    """Index of the column among ``Extractor.columns``."""
    stored: int
    """Index of the column among all columns of the table."""
    decode: Get
    """Function from the column's bytes to the field's value; raises BUILD_ERRORS."""
    code: str
    """struct code of a number of fixed size that is returned unchanged, else ''."""


class FieldSource(NamedTuple):
    """The source of the values of a field."""

    column: str
    """Name of the column (or of a blob that is one) with the field; '' = no column holds it,
    because it lies in an array without elements."""
    gets: Sequence[Get]
    """Functions to the field's value, one for each level of unnesting: see _gets."""


class Extractor:
    """Reads the values of some fields of one message type from stored messages.

    Each unnested array of messages lies inside the previous one. It gives a level of unnesting:
    level 0 is the message, level 1 an element of the first array.

    Attributes:
        refs: The fields.
        columns: Columns of format ``ros`` that hold the fields, in order; None if a field has no
            column.
    """

    def __init__(
        self, definition: Definition, refs: Sequence[FieldRef], unnested: Sequence[Array]
    ) -> None:
        self.refs = refs
        self._plan = wire_plan(definition)
        self._depth = len(unnested)
        column_names = {column.name for column in self._plan.all_columns}
        self._sources = [_source(definition, ref, unnested, column_names) for ref in refs]
        # What depends on them alone, for the loops over messages.
        read_names = [source.column for source in self._sources if source.column]
        self._read = self._plan.reader(read_names)
        numbers = {column.name: n for n, column in enumerate(self._plan.columns)}
        self.columns: list[str] | None = None
        self._places: list[tuple[int, int]] = []
        """For each field its column among all columns of the table, and among ``columns``; [] if
        there are no ``columns``."""
        if numbers.keys() >= set(read_names):
            self.columns = sorted(set(read_names), key=numbers.__getitem__)
            self._places = [(numbers[name], self.columns.index(name)) for name in read_names]
        self._conversions, self._inner = zip(*map(self._level, range(self._depth + 1)))

    def _level(self, level: int) -> tuple[Sequence[tuple[int, Get]], Sequence[int]]:
        """Return what is done with the values of a level of unnesting.

        Returns:
            The indices of the values to convert, and the conversions; and the indices of the values
            that are lists over the elements of the next level.
        """
        gets = [(n, source.gets) for n, source in enumerate(self._sources)]
        conversions = [(n, g[level]) for n, g in gets if level < len(g) and g[level] is not itself]
        return conversions, [n for n, g in gets if level + 1 < len(g)]

    @property
    def _is_whole(self) -> bool:
        """Whether nothing is unnested, and each field has a column."""
        return not self._depth and all(source.column for source in self._sources)

    @cached_property
    def direct(self) -> list[ColumnField] | None:
        """How each field is read from its column; None if that is impossible."""
        if self.columns is None or not self._is_whole:
            return None
        return [
            self._direct(place, stored, source.gets[0])
            for (stored, place), source in zip(self._places, self._sources)
        ]

    @cached_property
    def whole(self) -> Callable[[bytes], FieldValueList] | None:
        """Function that reads all fields of a serialised message; None if unnested.

        The function raises CorruptMessage.
        """
        if not self._is_whole:
            return None
        read, conversions = self._read, self._conversions[0]
        if not conversions:
            return read

        def values(wire: bytes) -> FieldValueList:
            fields = read(wire)
            for n, get in conversions:
                fields[n] = get(fields[n])
            return fields

        return values

    def _direct(self, place: int, stored: int, get: Get) -> ColumnField:
        column, decode = self._plan.columns[stored], self._plan.decoder(stored)
        if get is not itself:
            return ColumnField(place, stored, lambda raw: get(decode(raw)), "")
        number = column.kind not in ("text", "bool", "array", "wire") and not column.is_list
        code = CQL_CODES.get(column.element_type, "") if number else ""
        return ColumnField(place, stored, decode, code[1:])

    def values(self, row: Row) -> Iterator[FieldValueList]:
        """Yield the values of a row, once or per unnested element.

        CorruptMessage: malformed row. It is raised by the call, not by the iterator.
        """
        columns = row.columns
        if self.columns is not None and columns and row.table.by_field:
            # Also in a row marked odd, a column that cannot hold its field exactly is unset.
            is_part = len(columns) == len(self.columns)
            cells = [columns[place if is_part else stored] for stored, place in self._places]
            if None not in cells:
                pairs = zip(self._places, cells)
                return self._every(
                    [self._plan.value(n, cell) for (n, _), cell in pairs if cell is not None]
                )
        return self.wire_values(row.wire)

    def wire_values(self, wire: bytes) -> Iterator[FieldValueList]:
        """Yield the values of a serialised message, once or per unnested element.

        CorruptMessage: malformed message; raised as by ``values``.
        """
        return self._every(self._read(wire))

    def cell_values(self, cells: Sequence[bytes]) -> Iterator[FieldValueList]:
        """Yield the values of a message of which ``columns`` were read.

        CorruptMessage: malformed column; raised as by ``values``.
        """
        return self._every([self._plan.value(n, cells[place]) for n, place in self._places])

    def _every(self, column_values: FieldValueList) -> Iterator[FieldValueList]:
        columns = iter(column_values)
        # A field without a column lies in an array without elements.
        values = [next(columns) if source.column else [] for source in self._sources]
        return self._unnest(0, values)

    def _unnest(self, level: int, values: FieldValueList) -> Iterator[FieldValueList]:
        """Yield the values of the elements inside those of a level; it changes the list."""
        for n, get in self._conversions[level]:
            values[n] = get(values[n])
        if level == self._depth:
            yield values
            return
        inner = self._inner[level]
        for element in range(min([_count(values[n]) for n in inner], default=0)):
            element_values = list(values)
            for n in inner:
                element_values[n] = values[n][element]
            yield from self._unnest(level + 1, element_values)


extractor_of = lru_cache(maxsize=256)(Extractor)
"""Returns the extractor of a definition and its fields, compiled once."""


def _count(values: object) -> int:
    return len(values) if isinstance(values, (list, bytes)) else 0


def _source(
    definition: Definition, ref: FieldRef, unnested: Sequence[Array], column_names: Container[str]
) -> FieldSource:
    """Return where a field comes from: its own column, or a blob that contains it."""
    names = [step.name for step in ref.steps]
    for count in range(1, len(names) + 1):
        column = ".".join(names[:count])
        if column in column_names:
            return FieldSource(column, _gets(ref, count, unnested))
    return FieldSource("", _empty_gets(definition, ref, unnested))


def _empty_gets(definition: Definition, ref: FieldRef, unnested: Sequence[Array]) -> list[Get]:
    """Return what _gets does for a field inside an array of fixed length 0, without a column."""
    msg_type = definition.type
    for number, step in enumerate(ref.steps, 1):
        field = next(f for f in definition.specs[msg_type].fields if f.name == step.name)
        if field.length == 0 and ref.steps[:number] in unnested:
            return [itself] * (list(unnested).index(ref.steps[:number]) + 2)
        if field.length == 0:
            break
        msg_type = field.type
    return [itself]


def _gets(ref: FieldRef, step_count: int, unnested: Sequence[Array]) -> list[Get]:
    """Return the functions from a column's value to the field's, one per level of unnesting.

    The first ``step_count`` steps lead to the column; the other steps lead into a blob. The first
    function gives the value of level 0: for an unnested array a list, of whose elements the next
    function gives the value of level 1, and so on.
    """
    gets: list[Get] = []
    get = _element_or_part(ref)
    for n, step in reversed(list(enumerate(ref.steps))):
        if step.many and ref.steps[: n + 1] in unnested:
            gets.append(get)
            get = itself
        elif step.many:
            get = _each(get) if step.index is None else _at(step.index, get)
        if n >= step_count:
            get = _inside(step.name, get)
    return [get, *reversed(gets)]


def _inside(name: str, then: Get) -> Get:
    """Return the function from a message, as a dict, to what ``then`` makes of its field."""
    return lambda value: None if value is None else then(value[name])


def _each(then: Get) -> Get:
    """Return the function from a list to what ``then`` makes of each element."""

    def get(value: Any) -> object:
        if isinstance(value, int):
            return []  # only the number of messages without bytes is stored
        return None if value is None else [then(element) for element in value]

    return get


def _at(index: int, then: Get) -> Get:
    """Return the function from a list to what ``then`` makes of one element; None = too short."""

    def get(value: Any) -> object:
        if value is None or isinstance(value, int) or index >= len(value):
            return None
        return then(value[index])

    return get


def _element_or_part(ref: FieldRef) -> Get:
    """Return the function from a field to what a path names of it: an element, secs, nsecs."""
    get = _PARTS[ref.part]
    return get if ref.index is None else _at(ref.index, get)


def itself(value: object) -> object:
    """Return the value."""
    return value


_PARTS: dict[str, Get] = {
    "": itself,
    "secs": lambda ns: None if ns is None else ns // SECOND_NS,
    "nsecs": lambda ns: None if ns is None else ns % SECOND_NS,
}


_log = logging.getLogger(__name__)

_Stored = TypeVar("_Stored")
"""A serialised message, or some of its columns."""
ResultRow = Tuple[Any, ...]
"""One value for each column of the result."""
RowIdentity = Tuple[Union[int, str], str, str, int]
"""KEY, NODE and RUN of a row ('' if RUN is not needed), and its time, ns."""
_RawColumns = Sequence[Optional[bytes]]
"""Encoded columns of a row."""
_ResultRows = List[ResultRow]
_CompiledRows = Callable[[Row], Optional[_ResultRows]]
"""Function that returns the result rows of a stored row; None = use the general way."""
_ShownColumns = Sequence[Tuple[Optional[int], Optional[Get]]]
"""For each column of the result the index of its value (None: missing in this table), and the
conversion for display."""
_Show = Callable[[Row, List[Any]], ResultRow]
"""Function from the values of a row, which it may change, to a row of the result."""
_Fill = Callable[[_RawColumns, List[Any]], bool]
"""Function that sets the values of some fields; it returns False if one is missing."""
_FieldPlace = Tuple[int, int, ColumnField]
"""Index among the values, index among the columns, and the field's decoder."""
_NONE: _ResultRows = []
"""Shared empty result; callers do not change it."""


@dataclass(frozen=True)
class Projection:
    """Reads, checks and shows the rows of one table; made by ``compile``.

    The values of a row are its KEY, NODE and RUN, its time, and those of the named fields.
    """

    groups: tuple[tuple[ResultColumn, ...], ...]
    """Columns of each selected path: one, or those of all fields of a message."""
    check: Check
    """The condition."""
    columns: Sequence[str] | None
    """Columns of the table that are read, in order; None = all."""
    unnested: tuple[Array, ...]
    """Arrays of messages each of whose elements becomes a row, outermost first."""
    named: bool
    """Whether KEY is a name."""
    extractor: Extractor | None
    width: int
    """Number of values of a row."""
    runs: bool = False
    """Whether RUN is needed; else its value is ''."""
    shown: tuple[tuple[int | None, Get | None], ...] = ()
    """For each column of the result the index of its value (None: missing in this table), and the
    conversion for display."""
    checked: frozenset[int] = frozenset()
    """Indices of the values that the condition needs; only in format ``ros``."""
    stored: int = 0
    """Number of columns of the table in format ``ros``; 0 in another format."""
    computed: tuple[Get, ...] = ()
    """Functions of the computed values, which follow the others. They get the values of a row
    without computed ones."""

    @classmethod
    def compile(cls, select: Select, table: Table, findings: Findings) -> Projection:
        """Compile a statement for a table; ``findings`` collects the names that the table lacks."""
        names = NameResolver(table, findings)
        groups = [names.outputs(selected) for selected in select.visible]
        groups += [names.single(selected) for selected in select.hidden]
        checked, check = names.condition(select.condition)
        names.check_lengths()
        extractor = None
        columns: Sequence[str] | None = ()
        if table.definition is not None and names.refs:
            extractor = extractor_of(table.definition, tuple(names.refs), tuple(names.unnested))
            columns = extractor.columns if table.by_field else None
        unnested, width = tuple(names.unnested), OWN_WIDTH + len(names.refs)
        outputs, computed = _place_computed(groups, width)
        reader = cls(outputs, check, columns, unnested, table.named, extractor, width, names.runs)
        reader = replace(reader, computed=computed)
        if table.by_field:
            reader = replace(reader, checked=frozenset(checked), stored=len(table.columns))
        return reader.showing([[output.name for output in group] for group in groups])

    def showing(self, names: Sequence[Sequence[str]]) -> Projection:
        """Return a projection with these columns for each selected path, None for missing ones."""
        places: list[tuple[int | None, Get | None]] = []
        for group, group_names in zip(self.groups, names):
            by_name = {output.name: (output.place, _show_of(output)) for output in group}
            places += [by_name.get(name, (None, None)) for name in group_names]
        return replace(self, shown=tuple(places))

    @cached_property
    def compiled(self) -> _CompiledRows | None:
        """Fast function for the result rows of nearly all stored rows.

        None if something is unnested or, in format ``ros``, a field has no column. The fields of
        the condition are decoded first, the other fields only if the condition is true. For a row
        with a missing column or malformed values the function returns None, and the row is read in
        the general way.
        """
        if self.extractor is None:
            return None
        if not self.stored:
            read = self.extractor.whole
            if read is None:
                return None
            return _compile_wire_rows(read, self.own, self.check, self._show)
        direct = self.extractor.direct
        if direct is None or self.columns is None:
            return None
        places = range(OWN_WIDTH, OWN_WIDTH + len(direct))
        # The number of columns of a row tells whether it has all columns or those that are read.
        column_indices = {
            len(self.columns): [field.place for field in direct],
            self.stored: [field.stored for field in direct],
        }
        layouts = {
            count: _fills(list(zip(places, indices, direct)), self.checked)
            for count, indices in column_indices.items()
        }
        return _compile_rows(layouts, self.own, self.check, len(direct), self._show)

    @cached_property
    def _show(self) -> _Show:
        """Function from a row and its values, which it may change, to a row of the result."""
        return _compile_show(self.shown, self.computed)

    def own(self, row: Row) -> RowIdentity:
        """Return the values of a row that are not fields."""
        t = row.t
        return (row.name if self.named else t, row.node, row.run if self.runs else "", t)

    def values(self, row: Row) -> Iterator[RowValues]:
        """Yield the values of a row, once or for each unnested element; None = missing.

        Nothing for a message that is gone; of one that cannot be read all fields are missing.
        """
        try:
            identity = self.own(row)
        except MessageNotFound:
            return  # of several stores the only one with the message does not answer any more
        if self.extractor is None:
            yield identity
            return
        try:
            for fields in self.extractor.values(row):
                yield (*identity, *fields)
        except MessageNotFound:
            return  # the message was deleted after its columns were read
        except CorruptMessage as exc:
            _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
            yield (*identity, *[None] * (self.width - OWN_WIDTH))

    def hits(self, row: Row) -> Iterator[bool]:
        """Yield for each unnested element of a stored row whether it satisfies the condition."""
        return (self.check(values) is True for values in self.values(row))

    def hit(self, row: Row) -> bool:
        """Return whether a row, or one of its unnested elements, satisfies the condition."""
        rows = None if self.compiled is None else self.compiled(row)
        return any(self.hits(row)) if rows is None else bool(rows)

    def wire_values(self, identity: RowIdentity, wire: bytes | None) -> Iterator[RowValues]:
        """Yield the values of a message, like ``values``.

        Args:
            identity: Its KEY, NODE, RUN and time.
            wire: The serialised message; None = it cannot be read: all of its fields are missing.
        """
        read = None if self.extractor is None else self.extractor.wire_values
        return self._values_of(identity, read, wire)

    def cell_values(
        self, identity: RowIdentity, cells: Sequence[bytes] | None
    ) -> Iterator[RowValues]:
        """Yield the values of a message of format ``ros``, like ``values``.

        Args:
            identity: Its KEY, NODE, RUN and time.
            cells: The columns ``extractor.columns``; None = the message cannot be read.
        """
        read = None if self.extractor is None else self.extractor.cell_values
        return self._values_of(identity, read, cells)

    def _values_of(
        self,
        identity: RowIdentity,
        read: Callable[[_Stored], Iterator[FieldValueList]] | None,
        stored: _Stored | None,
    ) -> Iterator[RowValues]:
        """Yield what ``read`` gives of a stored message; None: all of its fields are missing."""
        if read is not None and stored is not None:
            try:
                for fields in read(stored):
                    yield (*identity, *fields)
                return
            except CorruptMessage as exc:
                _log.warning("a message at %s cannot be read: %s", identity[0], exc)
        yield (*identity, *[None] * (self.width - OWN_WIDTH))

    def passes(self, identity: RowIdentity, wire: bytes | None) -> bool:
        """Return whether a message, or one of its elements, satisfies the condition.

        The arguments are those of ``wire_values``.
        """
        return any(self.check(values) is True for values in self.wire_values(identity, wire))

    def rows(self, row: Row) -> Iterable[ResultRow]:
        """Return the rows of the result that a stored row gives; unnested elements lazily."""
        compiled = self.compiled
        rows = None if compiled is None else compiled(row)
        if rows is not None:
            return rows
        return (self._show(row, [*v]) for v in self.values(row) if self.check(v) is True)

    def complete(self, values: RowValues) -> RowValues:
        """Return the values of a row, followed by the computed ones."""
        return [*values, *[get(values) for get in self.computed]] if self.computed else values


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
        projections = {table: Projection.compile(select, table, findings) for table in tables}
        findings.check()
        self.names = [[selected.text] for selected in select.asked if selected is not None]
        if projections:
            same = zip(*(projection.groups for projection in projections.values()))
            all_names = [list(dict.fromkeys(o.name for o in chain(*groups))) for groups in same]
            # A column computed from fields of several definitions may be missing in all tables.
            self.names = [
                names or ([] if selected is None or selected.is_path else [selected.text])
                for names, selected in zip(all_names, select.asked)
            ]
        # By the table itself: two stores may have tables of one name, with other columns.
        self._by_table = {table: p.showing(self.names) for table, p in projections.items()}

    def __iter__(self) -> Iterator[Projection]:
        return iter(self._by_table.values())

    def of(self, table: Table) -> Projection:
        """Return the projection of a table, with the columns ``names`` whatever fields it has."""
        if table not in self._by_table:  # the table was added later
            projection = Projection.compile(self._select, table, Findings(self._select.text))
            self._by_table[table] = projection.showing(self.names)
        return self._by_table[table]

    def columns(self, table: Table) -> Sequence[str] | None:
        """Return the columns of a table that are read, in order; None = all."""
        return self.of(table).columns

    def hit(self, row: Row) -> bool:
        """Return whether a row, or one of its unnested elements, satisfies the condition."""
        return self.of(row.table).hit(row)


def _place_computed(
    groups: Sequence[Sequence[ResultColumn]], width: int
) -> tuple[tuple[tuple[ResultColumn, ...], ...], tuple[Get, ...]]:
    """Assign indices from ``width`` on to the computed values; return also their functions."""
    computed: list[Get] = []
    out_groups: list[tuple[ResultColumn, ...]] = []
    for group in groups:
        outputs = []
        for output in group:
            if output.compute is not None:
                computed.append(output.compute)
                output = output._replace(place=width + len(computed) - 1)
            outputs.append(output)
        out_groups.append(tuple(outputs))
    return tuple(out_groups), tuple(computed)


def _show_with(make: Get) -> Get:
    """Return the conversion of a value, and of the values in lists; a missing one stays None."""

    def show(value: object) -> object:
        if isinstance(value, list):
            return [show(element) for element in value]
        return None if value is None else make(value)

    return show


def _time(ns: int) -> Stamp | int:
    try:
        return Stamp.from_ns(ns)
    except InvalidKey:
        return ns  # outside ROS time: it was computed, or nsecs over a second go beyond its end


def _duration(ns: int) -> object:
    try:
        origin = Stamp.from_ns(0)
        # Same representation as genpy's Duration, without importing genpy here.
        return Stamp.from_ns(ns) - origin if ns >= 0 else origin - Stamp.from_ns(-ns)
    except InvalidKey:
        return ns  # a computed duration may be too long for genpy


_SHOWS = {"time": _show_with(_time), "duration": _show_with(_duration)}


def _show_of(output: ResultColumn) -> Get | None:
    """Return the conversion of a value for display.

    None = unchanged, or KEY, shown as the row's key.
    """
    if output.place == KEY_PLACE:
        return itself if output.kind == COUNT_KIND else None
    return _SHOWS.get(output.kind)


def _compile_wire_rows(
    read: Callable[[bytes], list[Any]],
    identify: Callable[[Row], RowIdentity],
    check: Check,
    show: _Show,
) -> _CompiledRows:
    """Compile the function for a table whose rows hold serialised messages, read by ``read``."""

    def rows(row: Row) -> _ResultRows | None:
        try:
            values = [*identify(row), *read(row.wire)]
        except (CorruptMessage, MessageNotFound):
            return None
        return [show(row, values)] if check(values) is True else _NONE

    return rows


def _compile_rows(
    layouts: dict[int, tuple[_Fill, _Fill]],
    identify: Callable[[Row], RowIdentity],
    check: Check,
    fields: int,
    show: _Show,
) -> _CompiledRows:
    """Compile the function for a table with a column for each field.

    Args:
        layouts: For each number of columns that a row may have what sets the fields that the
            condition needs, and what sets the others.
        fields: Number of fields, whose values follow those of ``identify``.
    """
    blank = [None] * fields

    def rows(row: Row) -> _ResultRows | None:
        columns = row.columns
        fills = layouts.get(len(columns))
        if fills is None:
            return None
        try:
            values: list[Any] = [*identify(row), *blank]
            if not fills[0](columns, values):
                return None
            if check(values) is not True:
                return _NONE
            if not fills[1](columns, values):
                return None
        except (*BUILD_ERRORS, MessageNotFound):
            return None
        return [show(row, values)]

    return rows


def _fills(fields: Sequence[_FieldPlace], checked: Container[int]) -> tuple[_Fill, _Fill]:
    """Return the functions that set the checked fields, and the other fields.

    If one number is checked, all numbers are read: together they cost hardly more than one.
    """
    number = any(place in checked and direct.code for place, _, direct in fields)
    first = [f for f in fields if f[0] in checked or (number and f[2].code)]
    return _compile_fill(first), _compile_fill([f for f in fields if f not in first])


def _compile_fill(fields: Sequence[_FieldPlace]) -> _Fill:
    """Return the function that sets these fields; numbers of fixed size together."""
    numbers = [f for f in fields if f[2].code]
    if len(numbers) < 2:  # itemgetter returns a tuple only for two and more
        numbers = []
    others = [(place, at, d.decode) for place, at, d in fields if not (d.code and numbers)]
    fills = [_others(others)] if others else []
    fills += [_numbers(numbers)] if numbers else []
    if not fills:
        return lambda columns, values: True
    if len(fills) == 1:
        return fills[0]
    return lambda columns, values: fills[0](columns, values) and fills[1](columns, values)


def _others(fields: Sequence[tuple[int, int, Get]]) -> _Fill:
    """Return what sets fields one by one: index of the value, index of the column, decoder."""

    def fill(columns: _RawColumns, values: list[Any]) -> bool:
        for place, at, decode in fields:
            raw = columns[at]
            if raw is None:
                return False
            values[place] = decode(raw)
        return True

    return fill


def _numbers(fields: Sequence[_FieldPlace]) -> _Fill:
    """Return what sets two or more numbers of fixed size by one struct."""
    pick = itemgetter(*(at for _, at, _ in fields))
    unpack = struct.Struct(">" + "".join(d.code for _, _, d in fields)).unpack
    places = [place for place, _, _ in fields]
    first, end = places[0], places[-1] + 1
    together = places == list(range(first, end))

    def fill(columns: _RawColumns, values: list[Any]) -> bool:
        raws = pick(columns)
        if None in raws:
            return False
        if together:
            values[first:end] = unpack(b"".join(raws))
            return True
        for place, value in zip(places, unpack(b"".join(raws))):
            values[place] = value
        return True

    return fill


def _compile_show(columns: _ShownColumns, computed: Sequence[Get] = ()) -> _Show:
    """Return the function from the values of a row, which it may change, to a row of the result."""
    if computed:
        inner = _compile_show(columns)
        return lambda row, values: inner(row, [*values, *[get(values) for get in computed]])
    keys = [n for n, (place, get) in enumerate(columns) if place == KEY_PLACE and get is None]
    firsts: dict[tuple[int, Get], int] = {}
    gets, copies = [], []
    for n, (place, get) in enumerate(columns):
        if place is not None and get:
            first = firsts.setdefault((place, get), n)
            # A column that is selected twice is computed once.
            if first == n:
                gets.append((n, get))
            else:
                copies.append((n, first))
    # The row's key is appended to the values.
    places = [-1 if n in keys else place for n, (place, _) in enumerate(columns)]
    if None in places or len(places) < 2:  # itemgetter gives no None, and no tuple of one
        pick = _picker(places)
    else:
        pick = itemgetter(*places)

    def show(row: Row, values: list[Any]) -> tuple[Any, ...]:
        if keys:
            values.append(row.key)
        if not gets:
            return pick(values)
        cells = list(pick(values))
        for n, get in gets:
            cells[n] = get(cells[n])
        for n, first in copies:
            cells[n] = cells[first]
        return tuple(cells)

    return show


def _picker(places: Sequence[int | None]) -> Callable[[list[Any]], tuple[Any, ...]]:
    """Return the function that picks the values at some indices, None for a missing one."""
    return lambda values: tuple([None if place is None else values[place] for place in places])
