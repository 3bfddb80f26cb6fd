# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of fields out of stored messages, without making message objects.

An array of messages whose elements a statement asks for is unnested: the message gives one list of
values per element. Other arrays of messages on the way to a field give a list of its values.
"""

from __future__ import annotations

from typing import Any, Callable, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.plan import wirePlan
from cassandra_ros.query.fields import FieldRef, Step
from cassandra_ros.query.protocols import Row

Get = Callable[[Any], Any]
Array = Tuple[Step, ...]


class Extractor:
    """Reads the values of some fields of one message type.

    Args:
        definition: The type.
        refs: The fields.
        unnested: The arrays of messages to unnest, each inside the one before.
    """

    def __init__(
        self, definition: Definition, refs: Sequence[FieldRef], unnested: Sequence[Array]
    ) -> None:
        self._plan = wirePlan(definition)
        self._depth = len(unnested)
        known = {column.name: n for n, column in enumerate(self._plan.all_columns)}
        columns = [_columnOf(ref, known) for ref in refs]
        self._names = [name for name in columns if name]
        self._given = [name is not None for name in columns]
        self._gets = [
            _emptyGets(definition, ref, unnested) if name is None else _gets(ref, name, unnested)
            for ref, name in zip(refs, columns)
        ]
        self._read = self._plan.reader(self._names)
        numbers = {column.name: n for n, column in enumerate(self._plan.columns)}
        self._stored = [numbers[name] for name in self._names if name in numbers]
        held = sorted(set(self._stored))
        self._projected = [held.index(n) for n in self._stored]
        self.columns: Optional[list[str]] = None
        """The columns of format ``ros`` that hold the fields, in their order; None where one lies
        in no column."""
        if len(self._stored) == len(self._names):
            self.columns = [self._plan.columns[n].name for n in held]

    def values(self, row: Row) -> Iterator[list[Any]]:
        """Yield the values of a stored row: once, or once per element of the unnested array.

        Args:
            row: A stored row.

        Raises:
            CorruptMessage: The bytes are no message of the type.
        """
        found = iter(self._columns(row))
        values = [next(found) if given else [] for given in self._given]
        return self._unnest(0, values)

    def _columns(self, row: Row) -> list[Any]:
        """Values of the named columns, from the row's own where it has them."""
        if self.columns is not None and row.table.by_field:
            # A column that cannot give its field back is unset, also in an odd row.
            held = row.columns
            places = self._projected if len(held) == len(self.columns) else self._stored
            raw = [held[n] for n in places]
            if None not in raw:
                return [self._plan.value(n, r) for n, r in zip(self._stored, raw) if r is not None]
        return self._read(row.wire)

    def _unnest(self, level: int, values: list[Any]) -> Iterator[list[Any]]:
        current = list(values)
        inner = []
        for n, gets in enumerate(self._gets):
            if len(gets) > level:
                current[n] = gets[level](values[n])
                if len(gets) > level + 1:
                    inner.append(n)
        if level == self._depth:
            yield current
            return
        count = min((_count(current[n]) for n in inner), default=0)
        for element in range(count):
            one = list(current)
            for n in inner:
                one[n] = current[n][element]
            yield from self._unnest(level + 1, one)


def _count(values: Any) -> int:
    return len(values) if isinstance(values, (list, bytes)) else 0


def _columnOf(ref: FieldRef, known: Any) -> Optional[str]:
    """The column that holds a field: its own, or that of the array in whose blob it lies."""
    names = [step.name for step in ref.steps]
    for length in range(1, len(names) + 1):
        name = ".".join(names[:length])
        if name in known:
            return name
    return None  # an array of fixed length 0


def _emptyGets(definition: Definition, ref: FieldRef, unnested: Sequence[Array]) -> list[Get]:
    """As _gets for what lies in no column: an array of fixed length 0, or what is inside one."""
    msg_type, level = definition.type, -1
    for number, step in enumerate(ref.steps):
        field = next(f for f in definition.specs[msg_type].fields if f.name == step.name)
        if field.length == 0:
            if ref.steps[: number + 1] in unnested:
                level = list(unnested).index(ref.steps[: number + 1])
            break
        msg_type = field.type
    return [_itself] * (level + 2)


def _itself(value: Any) -> Any:
    return value


def _gets(ref: FieldRef, column: str, unnested: Sequence[Array]) -> list[Get]:
    """Functions from a column's value to the field's, one more than arrays are unnested."""
    ops = _operations(ref, len(column.split(".")), set(unnested))
    gets: list[Get] = []
    current: list[Union[Step, str]] = []
    for op in ops:
        if op is None:
            gets.append(_follow(current, None))
            current = []
        else:
            current.append(op)
    gets.append(_follow(current, _last(ref)))
    return gets


def _operations(ref: FieldRef, held: int, unnested: set[Array]) -> Iterator[Union[Step, str, None]]:
    """What to do with the value of a column that holds the first ``held`` steps.

    A step: take the element, or all elements, of this array. A name: take this field out of a
    message in a blob. None: the array is unnested here.
    """
    for n, step in enumerate(ref.steps):
        if n >= held:
            yield step.name
        if step.many:
            yield None if ref.steps[: n + 1] in unnested else step


def _follow(ops: Sequence[Union[Step, str]], last: Optional[Get]) -> Get:
    """Chain operations from the last to the first; what is missing stays None."""
    get: Get = last or _itself
    for op in reversed(ops):
        if isinstance(op, str):
            get = _inside(op, get)
        elif op.index is None:
            get = _each(get)
        else:
            get = _at(op.index, get)
    return get


def _inside(name: str, then: Get) -> Get:
    return lambda value: None if value is None else then(value[name])


def _each(then: Get) -> Get:
    def get(value: Any) -> Any:
        if isinstance(value, int):
            return []  # messages without bytes: their number is all that there is of them
        return None if value is None else [then(element) for element in value]

    return get


def _at(index: int, then: Get) -> Get:
    def get(value: Any) -> Any:
        if value is None or isinstance(value, int) or index >= len(value):
            return None
        return then(value[index])

    return get


def _last(ref: FieldRef) -> Optional[Get]:
    part: Optional[Get] = None
    if ref.part:
        which = 0 if ref.part == "secs" else 1
        part = lambda ns: None if ns is None else divmod(ns, SECOND_NS)[which]  # noqa: E731
    if ref.index is None:
        return part
    return _at(ref.index, part or (lambda value: value))
