# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Message objects of many serialised messages at once, field by field.

genpy's deserialize reads one message at a time. Here numpy, struct and map read one field of all
messages at a time: the offsets of all messages move over the fields together, adjacent fields of
fixed size are cut out of all messages at once, and then the attributes are set one after the
other. Objects are made in batches of a few hundred: a larger batch would start Python's garbage
collector again and again. The objects equal those of genpy, also in the types of their values.
"""

from __future__ import annotations

import codecs
import struct
from collections import deque
from itertools import chain, islice, repeat
from types import MemberDescriptorType
from typing import Any, Callable, Iterator, NamedTuple, Sequence, Union

import genpy
import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition, attribute_name
from cassandra_ros.messages.shape import object_counts
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES, Field, Specs
from cassandra_ros.messages.wire.field_ends import fixed_size
from cassandra_ros.messages.wire.fields import (
    CannotBatch,
    ColumnList,
    ElementGroup,
    FieldValues,
    FixedFields,
    Offsets,
    PrimitiveArray,
    TextField,
    Wires,
)

MIN_TOGETHER = 24
"""Minimum number of messages made together. Fewer are faster one by one."""
MIN_LIVE = 4
"""Minimum average number of arrays, per element index, that are walked together if their elements
differ in size."""
MAX_OBJECTS = 500
"""Maximum number of objects made in one batch, below the threshold of Python's collector."""
_STAMPS: dict[str, tuple[Any, str]] = {
    "time": (genpy.Time, "uint32"),
    "duration": (genpy.Duration, "int32"),
}
_NUMBERS = frozenset(CODES) - frozenset(_STAMPS)
"""Types of numbers. All other types except string become objects."""


class _ElementArray:
    """An array of messages, times or strings."""

    def __init__(self, length: int | None, size: int | None, element: _ElementReader) -> None:
        self._length, self._size, self._element = length, size, element

    def read(self, group: ElementGroup, out: ColumnList) -> Offsets:
        """Append its column; return the offsets after it."""
        begins, counts = self._counts(group.wires, group.ats)
        most, total = int(counts.max()), int(counts.sum())
        group.checked(begins + counts * self._element.least)
        if not total:
            out.add(([] for _ in counts), 1)
            return begins
        firsts = np.cumsum(counts) - counts
        if self._size is None:
            ats, ends = self._walk(group.wires, begins, counts, firsts)
        else:
            within = np.arange(total) - np.repeat(firsts, counts)
            ats = np.repeat(begins, counts) + within * self._size
            ends = begins + counts * self._size
        period = group.period * most if most * len(counts) == total else total
        inner = ElementGroup(group.wires, ats, np.repeat(group.ends, counts), period)
        elements, _, objects = self._element.make(inner)
        lists = map(list, map(islice, repeat(elements), counts.tolist()))
        out.add(lists, 1 + objects * total / len(counts))
        return group.checked(ends)

    def _counts(self, wires: Wires, ats: Offsets) -> tuple[Offsets, Offsets]:
        """Return the offsets of the first elements, and the numbers of elements."""
        if self._length is None:
            return ats + 4, wires.lengths(ats)
        return ats, np.full(len(ats), self._length)

    def _walk(
        self, wires: Wires, begins: Offsets, counts: Offsets, firsts: Offsets
    ) -> tuple[Offsets, Offsets]:
        """Return the offset of each element, in order, and the offsets after the arrays."""
        if int(counts.sum()) < MIN_LIVE * int(counts.max()):
            raise CannotBatch
        ats, ends = np.empty(int(counts.sum()), np.int64), begins.copy()
        live = np.arange(len(counts))
        for n in range(int(counts.max())):
            live = live[counts[live] > n]
            at = ends[live]
            ats[firsts[live] + n] = at
            ends[live] = self._element.skip(wires, at)
        return ats, ends

    def skip(self, wires: Wires, ats: Offsets) -> Offsets:
        """Return the offsets after it."""
        begins, counts = self._counts(wires, ats)
        if self._size is not None:
            return begins + counts * self._size
        if not counts.any():
            return begins
        # ``read`` checks this too; here the check keeps a malformed count from looping for ever.
        if (begins + counts * self._element.least > len(wires.data)).any():
            raise CannotBatch
        return self._walk(wires, begins, counts, np.cumsum(counts) - counts)[1]


_FieldReader = Union[FixedFields, PrimitiveArray, TextField, _ElementArray]


class _ObjectPlan(NamedTuple):
    """How the objects of one class are made from the columns of their fields."""

    cls: Any
    slots: list[tuple[Callable[[Any, Any], object], int | _ObjectPlan]]
    """For each field its setter, and the index of its column or how the message in it is made."""

    @property
    def size(self) -> int:
        """Number of objects made for one message, without those in its columns."""
        return 1 + sum(s.size for _, s in self.slots if not isinstance(s, int))

    def make(self, columns: Sequence[FieldValues], count: int) -> list[Any]:
        """Make the next ``count`` objects."""
        objects = list(map(object.__new__, repeat(self.cls, count)))
        for put, source in self.slots:
            values = columns[source] if isinstance(source, int) else source.make(columns, count)
            deque(map(put, objects, values), maxlen=0)
        return objects


class _ElementReader:
    """A message, time or string with all its fields.

    Attributes:
        least: Minimum size on the wire, bytes.
    """

    def __init__(self, steps: list[_FieldReader], objects: _ObjectPlan | None, least: int) -> None:
        self._steps, self._objects, self.least = steps, objects, least

    def make(self, group: ElementGroup) -> tuple[Iterator[Any], Offsets, float]:
        """Read objects or texts, which are made when the iterator is advanced.

        Returns:
            Iterator over them, the offsets after them, and the average number of objects in each.
        """
        columns, ats = ColumnList(), group.ats
        for step in self._steps:
            ats = step.read(group._replace(ats=ats), columns)
        if self._objects is None:
            return columns.columns[0], ats, 0
        weight = self._objects.size + columns.objects
        batches = _in_batches(self._objects, columns.columns, len(ats), int(MAX_OBJECTS / weight))
        return chain.from_iterable(batches), ats, weight

    def skip(self, wires: Wires, ats: Offsets) -> Offsets:
        """Return the offsets after them."""
        for step in self._steps:
            ats = step.skip(wires, ats)
        return ats


def _in_batches(
    objects: _ObjectPlan, columns: Sequence[FieldValues], count: int, most: int
) -> Iterator[list[Any]]:
    """Yield ``count`` objects in lists of at most ``most``, but at least one."""
    for first in range(0, count, max(1, most)):
        yield objects.make(columns, min(count - first, max(1, most)))


class _ObjectCompiler:
    """Compiles a checked definition to steps.

    CannotBatch: the classes are not as genpy makes them.
    """

    def __init__(self, cls: Any, definition: Definition) -> None:
        self._cls, self._root = cls, definition.type
        self._specs: Specs = definition.specs
        if object_counts(self._root, self._specs) is not None:
            raise CannotBatch  # it contains messages without bytes

    def element(self, type_: str) -> _ElementReader:
        """Compile a message type, 'time', 'duration' or 'string'."""
        if type_ == "string":
            return _ElementReader([TextField()], None, PRIMITIVE_SIZES["string"])
        steps: list[_FieldReader] = []
        columns: list[int] = [0]
        objects = self._objects(type_, steps, columns)
        return _ElementReader(steps, objects, max(1, _least(type_, self._specs)))

    def _objects(self, type_: str, steps: list[_FieldReader], columns: list[int]) -> _ObjectPlan:
        """Append the steps that read a message. ``columns`` holds the number of columns so far."""
        cls, fields = self._class(type_)
        slots: list[tuple[Callable[[Any, Any], object], int | _ObjectPlan]] = []
        for field in fields:
            put = getattr(cls, attribute_name(field.name)).__set__
            if not field.is_array and field.type != "string" and field.type not in _NUMBERS:
                slots.append((put, self._objects(field.type, steps, columns)))
                continue
            slots.append((put, columns[0]))
            columns[0] += 1
            self._field(field, steps)
        return _ObjectPlan(cls, slots)

    def _field(self, field: Field, steps: list[_FieldReader]) -> None:
        """Append the step that reads a field, or add a field of fixed size to the last step."""
        if field.type == "string" and not field.is_array:
            steps.append(TextField())
        elif field.type not in _NUMBERS:
            size = fixed_size(field.type, self._specs)
            steps.append(_ElementArray(field.length, size, self.element(field.type)))
        elif field.is_array and field.length is None:
            steps.append(PrimitiveArray(field.type))
        else:
            last = steps[-1] if steps else None
            if not isinstance(last, FixedFields):
                last = FixedFields()
                steps.append(last)
            last.add(field.type, field.length if field.is_array else None)

    def _class(self, type_: str) -> tuple[Any, Sequence[Field]]:
        """Return the class and the fields of a type; CannotBatch: it is not as genpy makes it."""
        if type_ in _STAMPS:
            cls, half = _STAMPS[type_]
            fields: Sequence[Field] = [Field("secs", half), Field("nsecs", half)]
        else:
            cls, fields = self._nested_class(type_), self._specs[type_].fields
        names = [attribute_name(field.name) for field in fields]
        plain = (
            list(cls.__slots__) == names
            and cls.__dictoffset__ == 0
            and cls.__new__ is object.__new__
            and cls.__setattr__ is object.__setattr__
            and all(isinstance(getattr(cls, n, None), MemberDescriptorType) for n in names)
        )
        if not plain:
            raise CannotBatch
        return cls, fields

    def _nested_class(self, type_: str) -> Any:
        """Return the class of which genpy's generated code makes the objects of a nested type."""
        if type_ == self._root:
            return self._cls
        package, _, name = type_.partition("/")
        namespace = self._cls.deserialize.__globals__
        try:
            generated = namespace.get(f"_{package}__{name}")
            return getattr(namespace[package].msg, name) if generated is None else generated
        except (KeyError, AttributeError) as exc:
            raise CannotBatch from exc


def _least(type_: str, specs: Specs) -> int:
    """Return the minimum size of a message on the wire, bytes."""
    if type_ in PRIMITIVE_SIZES:
        return PRIMITIVE_SIZES[type_]
    return sum(
        4
        if f.is_array and f.length is None
        else (f.length or 0 if f.is_array else 1) * _least(f.type, specs)
        for f in specs[type_].fields
    )


class ObjectMaker:
    """Makes the objects of one class from serialised messages.

    Args:
        cls: Message class.
        definition: Definition of the class.

    Raises:
        CannotBatch: The class is not as genpy makes it, or a few bytes could mean very many
            objects.
    """

    def __init__(self, cls: Any, definition: Definition) -> None:
        self._cls = cls
        self._whole = _ObjectCompiler(cls, definition).element(definition.type)
        self._stamps = [
            attribute_name(field.name)
            for field in definition.root.fields
            if field.type in _STAMPS and not field.is_array
        ]

    def make(self, data: bytes, starts: Offsets, sizes: Offsets) -> Iterator[Any]:
        """Make the objects of at least one message, at any offsets in a buffer.

        Raises:
            CannotBatch: The messages differ too much, or one is malformed. Raised before the first
                object.
        """
        group = ElementGroup(Wires(data), starts, starts + sizes, 1)
        try:
            objects, *_ = self._whole.make(group)
        except (IndexError, ValueError, struct.error) as exc:  # a length exceeds the buffer
            raise CannotBatch from exc
        codecs.lookup_error("rosmsg").msg_type = self._cls._type  # type: ignore[attr-defined]
        return map(self._canonical, objects) if self._stamps else objects

    def _canonical(self, message: Any) -> Any:
        """Return a message whose own times have nsecs within a second."""
        # genpy makes the times in the message itself canonical, but not those in nested messages.
        for name in self._stamps:
            stamp = getattr(message, name)
            if not 0 <= stamp.nsecs < SECOND_NS:
                stamp.canon()
        return message
