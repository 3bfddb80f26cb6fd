# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Field values of stored messages, read without making message objects.

An array of messages whose elements a statement names is unnested: the message gives one list of
values per element. Any other array of messages on the path to a field gives a list of the field's
values.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Callable, Container, Iterator, List, NamedTuple, Optional, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.cql_values import CQL_CODES
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.query.protocols import Row
from cassandra_ros.query.tree.field_names import Array, FieldRef

Get = Callable[[Any], Any]
FieldValueList = List[Any]
"""Values of some fields."""


class ColumnField(NamedTuple):
    """A field that is a column of format ``ros``, or part of one."""

    asked: int
    """Index of the column among ``Extractor.columns``."""
    stored: int
    """Index of the column among all columns of the table."""
    decode: Get
    """Function from the column's bytes to the field's value; raises BUILD_ERRORS."""
    code: str
    """struct code of a number of fixed size that is returned unchanged, else ''."""


class Extractor:
    """Reads the values of some fields of one message type from stored messages.

    Each unnested array of messages lies inside the previous one.

    Attributes:
        columns: Columns of format ``ros`` that hold the fields, in order; None if a field has no
            column.
    """

    def __init__(
        self, definition: Definition, refs: Sequence[FieldRef], unnested: Sequence[Array]
    ) -> None:
        self._plan = wire_plan(definition)
        self._depth = len(unnested)
        known = {column.name for column in self._plan.all_columns}
        held = [_held_steps(ref, known) for ref in refs]
        names = [".".join(s.name for s in ref.steps[:n]) for ref, n in zip(refs, held) if n]
        self._given = [n > 0 for n in held]
        gets = [
            _gets(ref, n, unnested) if n else _empty_gets(definition, ref, unnested)
            for ref, n in zip(refs, held)
        ]
        levels = range(self._depth + 1)
        self._steps = [
            [(n, g[at]) for n, g in enumerate(gets) if at < len(g) and g[at] is not _itself]
            for at in levels
        ]
        """For each level of unnesting the indices of the values to convert, and the conversions."""
        self._inner = [[n for n, g in enumerate(gets) if len(g) > at] for at in levels[1:]]
        """For each level the indices of the values that are lists over the elements of its
        array."""
        self._read = self._plan.reader(names)
        numbers = {column.name: n for n, column in enumerate(self._plan.columns)}
        self._stored = [numbers[name] for name in names if name in numbers]
        asked = sorted(set(self._stored))
        self._projected = [asked.index(n) for n in self._stored]
        self.columns: Optional[list[str]] = None
        if len(self._stored) == len(names):
            self.columns = [self._plan.columns[n].name for n in asked]
        self._gets = [each[0] for each in gets]

    def direct(self) -> Optional[list[ColumnField]]:
        """Return how each field is read from its column; None if that is impossible."""
        if self.columns is None or self._depth or not all(self._given):
            return None
        found = zip(self._projected, self._stored, self._gets)
        return [self._direct(asked, stored, get) for asked, stored, get in found]

    def whole(self) -> Optional[Callable[[bytes], FieldValueList]]:
        """Return the function that reads all fields of a serialised message; None if unnested.

        The function raises CorruptMessage.
        """
        if self._depth or not all(self._given):
            return None
        read, steps = self._read, self._steps[0]
        if not steps:
            return read

        def values(wire: bytes) -> FieldValueList:
            found = read(wire)
            for n, get in steps:
                found[n] = get(found[n])
            return found

        return values

    def _direct(self, asked: int, stored: int, get: Get) -> ColumnField:
        column, decode = self._plan.columns[stored], self._plan.decoder(stored)
        if get is not _itself:
            return ColumnField(asked, stored, lambda raw: get(decode(raw)), "")
        number = column.kind not in ("text", "bool", "array", "wire") and not column.is_list
        code = CQL_CODES.get(column.element_type, "") if number else ""
        return ColumnField(asked, stored, decode, code[1:])

    def values(self, row: Row) -> Iterator[FieldValueList]:
        """Yield the values of a row, once or per unnested element.

        CorruptMessage: malformed row.
        """
        found = iter(self._columns(row))
        return self._unnest(0, [next(found) if given else [] for given in self._given])

    def _columns(self, row: Row) -> FieldValueList:
        """Return the values of the columns, from the row's columns if they are set."""
        held = row.columns
        if self.columns is not None and held and row.table.by_field:
            # Also in a row marked odd, a column that cannot hold its field exactly is unset.
            places = self._projected if len(held) == len(self.columns) else self._stored
            raw = [held[n] for n in places]
            if None not in raw:
                return [self._plan.value(n, r) for n, r in zip(self._stored, raw) if r is not None]
        return self._read(row.wire)

    def _unnest(self, level: int, values: FieldValueList) -> Iterator[FieldValueList]:
        for n, get in self._steps[level]:
            values[n] = get(values[n])
        if level == self._depth:
            yield values
            return
        inner = self._inner[level]
        for element in range(min([_count(values[n]) for n in inner], default=0)):
            one = list(values)
            for n in inner:
                one[n] = values[n][element]
            yield from self._unnest(level + 1, one)


extractor_of = lru_cache(maxsize=256)(Extractor)
"""Returns the extractor of a definition and its fields, compiled once."""


def _count(values: object) -> int:
    return len(values) if isinstance(values, (list, bytes)) else 0


def _held_steps(ref: FieldRef, known: Container[str]) -> int:
    """Return the number of steps to the column with a field: its own, or a blob that contains it.

    0: there is no such column, because the field is inside an array of fixed length 0.
    """
    names = [step.name for step in ref.steps]
    every = range(1, len(names) + 1)
    return next((n for n in every if ".".join(names[:n]) in known), 0)


def _empty_gets(definition: Definition, ref: FieldRef, unnested: Sequence[Array]) -> list[Get]:
    """Return what _gets does for a field inside an array of fixed length 0, without a column."""
    msg_type = definition.type
    for number, step in enumerate(ref.steps, 1):
        field = next(f for f in definition.specs[msg_type].fields if f.name == step.name)
        if field.length == 0 and ref.steps[:number] in unnested:
            return [_itself] * (list(unnested).index(ref.steps[:number]) + 2)
        if field.length == 0:
            break
        msg_type = field.type
    return [_itself]


def _gets(ref: FieldRef, held: int, unnested: Sequence[Array]) -> list[Get]:
    """Return the functions from a column's value to the field's, one per level of unnesting.

    The first ``held`` steps lead to the column; the other steps lead into a blob.
    """
    gets: list[Get] = []
    get = _last(ref)
    for n, step in reversed(list(enumerate(ref.steps))):
        if step.many and ref.steps[: n + 1] in unnested:
            gets.append(get)
            get = _itself
        elif step.many:
            get = _each(get) if step.index is None else _at(step.index, get)
        if n >= held:
            get = _inside(step.name, get)
    return [get, *reversed(gets)]


def _itself(value: object) -> object:
    return value


def _inside(name: str, then: Get) -> Get:
    return lambda value: None if value is None else then(value[name])


def _each(then: Get) -> Get:
    def get(value: Any) -> object:
        if isinstance(value, int):
            return []  # only the number of messages without bytes is stored
        return None if value is None else [then(element) for element in value]

    return get


def _at(index: int, then: Get) -> Get:
    def get(value: Any) -> object:
        if value is None or isinstance(value, int) or index >= len(value):
            return None
        return then(value[index])

    return get


def _last(ref: FieldRef) -> Get:
    get = _PARTS[ref.part]
    return get if ref.index is None else _at(ref.index, get)


_PARTS: dict[str, Get] = {
    "": _itself,
    "secs": lambda ns: None if ns is None else ns // SECOND_NS,
    "nsecs": lambda ns: None if ns is None else ns % SECOND_NS,
}
