# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Message objects of many serialised messages at once, field by field.

What genpy's deserialize does for one message in bytecode is done here for a field of all messages
by numpy, struct and map: the offsets of all messages move over their fields together, a run of
fields of fixed size is cut out of all messages at once, and slots are filled one after the other,
each in all objects. The objects are those that genpy would have made, to the types of their values.
"""

from __future__ import annotations

import codecs
import struct
from collections import deque
from itertools import chain, repeat
from types import MemberDescriptorType
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple, Union

import genpy
import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition, attribute_name
from cassandra_ros.messages.shape import object_counts
from cassandra_ros.messages.spec import CODES, PRIMITIVE_SIZES, Field, Specs
from cassandra_ros.messages.wire.skip import fixed_size

Cells = NDArray[np.uint8]
"""Bytes of many messages: (messages, size)."""
Places = NDArray[np.int64]
"""Where in the bytes the messages are, each at the same field."""
_Column = List[Any]
"""The values of a field in all messages."""

MIN_TOGETHER = 24
"""Fewer messages are quicker made one by one."""
MIN_LIVE = 4
"""Arrays whose elements differ in size are walked together if so many go on, on the average."""
MAX_PERIOD = 16
"""Elements of an array whose strings are looked at as if each had its own, which stays."""
_BYTES = ("uint8", "char")
_STAMPS: Dict[str, Tuple[Any, str]] = {
    "time": (genpy.Time, "uint32"),
    "duration": (genpy.Duration, "int32"),
}
_U4 = np.dtype("<u4")


class Unfit(Exception):
    """These messages have to be made one by one; some may be none."""


class _Wires:
    """Serialised messages, all in one buffer."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def cut(self, ats: Places, size: int) -> Cells:
        """Return so many bytes from each place on: (places, size)."""
        every: NDArray[Any] = np.ndarray(
            (len(self.data) - size + 1,), f"V{size}", self.data, 0, (1,)
        )
        return every[ats].view(np.uint8).reshape(len(ats), size)

    def lengths(self, ats: Places) -> Places:
        """Read the length of a string or array at each place."""
        every: NDArray[Any] = np.ndarray((len(self.data) - 3,), _U4, self.data, 0, (1,))
        return every[ats].astype(np.int64)

    def slices(self, ats: Places, ends: Places) -> List[bytes]:
        """Return the bytes from each place to its end."""
        data = self.data
        return [data[at:end] for at, end in zip(ats.tolist(), ends.tolist())]


class _Group(NamedTuple):
    """Messages, or elements of the arrays of messages, one after the other."""

    wires: _Wires
    ats: Places
    """Where they have been read to."""
    ends: Places
    """Where the messages end in which they lie."""
    period: int
    """So many make the same sequence again and again, if arrays are like each other."""

    def checked(self, ats: Places) -> Places:
        """Return places if they lie in their messages; else raises Unfit."""
        if (ats > self.ends).any():
            raise Unfit
        return ats


class _Run:
    """Fields of fixed size, one behind the other."""

    def __init__(self) -> None:
        self.size = 0
        self._readers: List[Callable[[Cells, int], _Column]] = []
        self._at: List[int] = []

    def add(self, type_: str, length: Optional[int]) -> None:
        """Add a field of a primitive type; length: of an array, None = it is none."""
        at, code = self.size, CODES[type_]
        self.size += PRIMITIVE_SIZES[type_] * (1 if length is None else length)
        if length is None:
            self._readers.append(_scalar(type_, at))
        else:
            self._readers.append(_array(type_, code, at, length))

    def read(self, group: _Group, out: List[_Column]) -> Places:
        """Append the columns of the fields; return where they end."""
        ends = group.checked(group.ats + self.size)
        cells = group.wires.cut(group.ats, self.size)
        out.extend(reader(cells, self.size) for reader in self._readers)
        return ends

    def skip(self, wires: _Wires, ats: Places) -> Places:
        """Return where they end."""
        return ats + self.size


def _scalar(type_: str, at: int) -> Callable[[Cells, int], _Column]:
    if type_ == "bool":
        return lambda cells, size: (cells[:, at] != 0).tolist()
    dtype = np.dtype("<" + CODES[type_])
    return lambda cells, size: np.ndarray((len(cells),), dtype, cells, at, (size,)).tolist()


def _array(type_: str, code: str, at: int, length: int) -> Callable[[Cells, int], _Column]:
    unit = length * PRIMITIVE_SIZES[type_]

    def read(cells: Cells, size: int) -> _Column:
        if not length:
            return [[] if type_ == "bool" else () for _ in cells]
        return _tuples(type_, cells, f"<{at}x{length}{code}{size - at - unit}x")

    def read_bytes(cells: Cells, size: int) -> _Column:
        found = struct.iter_unpack(f"<{at}x{length}s{size - at - length}x", cells.data)
        return list(chain.from_iterable(found))

    return read_bytes if type_ in _BYTES else read


def _tuples(type_: str, cells: Cells, layout: str) -> _Column:
    """Return what genpy makes of arrays: lists of bools, tuples of other numbers."""
    found = struct.iter_unpack(layout, cells.data)
    return list(map(list, found) if type_ == "bool" else found)


class _Numbers:
    """An array of primitives with its length."""

    def __init__(self, type_: str) -> None:
        self._type = type_
        self._unit, self._code = PRIMITIVE_SIZES[type_], CODES[type_]

    def read(self, group: _Group, out: List[_Column]) -> Places:
        """Append its column; return where it ends."""
        lengths = group.wires.lengths(group.ats)
        begins = group.ats + 4
        ends = group.checked(begins + self._unit * lengths)
        if self._type in _BYTES:
            out.append(group.wires.slices(begins, ends))
        elif lengths[0] and (lengths == lengths[0]).all():
            length = int(lengths[0])
            cells = group.wires.cut(begins, length * self._unit)
            out.append(_tuples(self._type, cells, f"<{length}{self._code}"))
        else:
            found = map(self._one, repeat(group.wires.data), begins.tolist(), lengths.tolist())
            out.append(list(map(list, found) if self._type == "bool" else found))
        return ends

    def _one(self, data: bytes, at: int, length: int) -> Tuple[Any, ...]:
        return struct.unpack_from(f"<{length}{self._code}", data, at)

    def skip(self, wires: _Wires, ats: Places) -> Places:
        """Return where it ends."""
        return ats + 4 + self._unit * wires.lengths(ats)


class _Text:
    """A string with its length."""

    def read(self, group: _Group, out: List[_Column]) -> Places:
        """Append its column; return where it ends."""
        wires, begins = group.wires, group.ats + 4
        ends = group.checked(begins + wires.lengths(group.ats))
        period = group.period
        if period <= MAX_PERIOD and len(begins) > period:
            same = [_same(wires, begins[n::period], ends[n::period]) for n in range(period)]
            if None not in same:
                out.append([_decode(raw or b"") for raw in same] * (len(begins) // period))
                return ends
        out.append(list(map(_decode, wires.slices(begins, ends))))
        return ends

    def skip(self, wires: _Wires, ats: Places) -> Places:
        """Return where it ends."""
        return ats + 4 + wires.lengths(ats)


def _same(wires: _Wires, begins: Places, ends: Places) -> Optional[bytes]:
    """Return the bytes that stand at all places; None: they differ."""
    size = int(ends[0] - begins[0])
    if not (ends - begins == size).all():
        return None
    if not size:
        return b""
    cells = wires.cut(begins, size)
    return cells[0].tobytes() if (cells == cells[0]).all() else None


def _decode(raw: bytes) -> str:
    return raw.decode("utf-8", "rosmsg")  # as genpy: what is no UTF-8 is told of, and kept


class _Array:
    """An array of messages, times or strings."""

    def __init__(self, length: Optional[int], size: Optional[int], element: _Element) -> None:
        self._length, self._size, self._element = length, size, element

    def read(self, group: _Group, out: List[_Column]) -> Places:
        """Append its column; return where it ends."""
        begins, counts = self._counts(group.wires, group.ats)
        most, total = int(counts.max()), int(counts.sum())
        group.checked(begins + counts * self._element.least)
        if not total:
            out.append([[] for _ in counts])
            return begins
        firsts = np.cumsum(counts) - counts
        if self._size is None:
            ats, ends = self._walk(group.wires, begins, counts, firsts)
        else:
            within = np.arange(total) - np.repeat(firsts, counts)
            ats = np.repeat(begins, counts) + within * self._size
            ends = begins + counts * self._size
        period = group.period * most if most * len(counts) == total else total
        inner = _Group(group.wires, ats, np.repeat(group.ends, counts), period)
        found, _ = self._element.make(inner)
        bounds = zip(firsts.tolist(), (firsts + counts).tolist())
        out.append([found[first:last] for first, last in bounds])
        return group.checked(ends)

    def _counts(self, wires: _Wires, ats: Places) -> Tuple[Places, Places]:
        """Return where the elements begin, and how many they are."""
        if self._length is None:
            return ats + 4, wires.lengths(ats)
        return ats, np.full(len(ats), self._length)

    def _walk(
        self, wires: _Wires, begins: Places, counts: Places, firsts: Places
    ) -> Tuple[Places, Places]:
        """Return where each element begins, message by message, and where the arrays end."""
        if int(counts.sum()) < MIN_LIVE * int(counts.max()):
            raise Unfit
        ats, ends = np.empty(int(counts.sum()), np.int64), begins.copy()
        live = np.arange(len(counts))
        for n in range(int(counts.max())):
            live = live[counts[live] > n]
            at = ends[live]
            ats[firsts[live] + n] = at
            ends[live] = self._element.skip(wires, at)
        return ats, ends

    def skip(self, wires: _Wires, ats: Places) -> Places:
        """Return where it ends."""
        begins, counts = self._counts(wires, ats)
        if self._size is not None:
            return begins + counts * self._size
        if not counts.any():
            return begins
        # Checked as well when it is read; here lest it be walked for ever.
        if (begins + counts * self._element.least > len(wires.data)).any():
            raise Unfit
        return self._walk(wires, begins, counts, np.cumsum(counts) - counts)[1]


_Step = Union[_Run, _Numbers, _Text, _Array]


class _Objects(NamedTuple):
    """How objects are made of the columns of their fields."""

    cls: Any
    slots: List[Tuple[Callable[[Any, Any], object], Union[int, _Objects]]]
    """What sets a field, and the number of its column, or how the message in it is made."""

    def make(self, columns: Sequence[_Column], count: int) -> _Column:
        """Make so many objects."""
        made = list(map(object.__new__, repeat(self.cls, count)))
        for put, source in self.slots:
            values = columns[source] if isinstance(source, int) else source.make(columns, count)
            deque(map(put, made, values), maxlen=0)
        return made


class _Element:
    """A message, time or string, with all that it holds.

    Attributes:
        least: Bytes that it takes at least.
    """

    def __init__(self, steps: List[_Step], objects: Optional[_Objects], least: int) -> None:
        self._steps, self._objects, self.least = steps, objects, least

    def make(self, group: _Group) -> Tuple[_Column, Places]:
        """Make the objects, or texts; return where they end, too."""
        columns: List[_Column] = []
        ats = group.ats
        for step in self._steps:
            ats = step.read(group._replace(ats=ats), columns)
        objects = self._objects
        return columns[0] if objects is None else objects.make(columns, len(ats)), ats

    def skip(self, wires: _Wires, ats: Places) -> Places:
        """Return where they end."""
        for step in self._steps:
            ats = step.skip(wires, ats)
        return ats


class _Compiler:
    """Turns a checked definition into steps; Unfit: its classes are not as genpy makes them."""

    def __init__(self, cls: Any, definition: Definition) -> None:
        self._cls, self._root = cls, definition.type
        self._specs: Specs = definition.specs
        if object_counts(self._root, self._specs) is not None:
            raise Unfit  # messages without bytes in others

    def element(self, type_: str) -> _Element:
        """Compile a message type, 'time', 'duration' or 'string'."""
        if type_ == "string":
            return _Element([_Text()], None, PRIMITIVE_SIZES["string"])
        steps: List[_Step] = []
        columns: List[int] = [0]
        objects = self._objects(type_, steps, columns)
        return _Element(steps, objects, max(1, _least(type_, self._specs)))

    def _objects(self, type_: str, steps: List[_Step], columns: List[int]) -> _Objects:
        """Add the steps that read a message; columns: how many there are so far."""
        cls, fields = self._class(type_)
        slots: List[Tuple[Callable[[Any, Any], object], Union[int, _Objects]]] = []
        for field in fields:
            put = getattr(cls, attribute_name(field.name)).__set__
            if not field.is_array and field.type != "string" and field.type not in CODES_ALONE:
                slots.append((put, self._objects(field.type, steps, columns)))
                continue
            slots.append((put, columns[0]))
            columns[0] += 1
            self._field(field, steps)
        return _Objects(cls, slots)

    def _field(self, field: Field, steps: List[_Step]) -> None:
        if field.type == "string" and not field.is_array:
            steps.append(_Text())
        elif field.type not in CODES_ALONE:
            size = _fixed(field.type, self._specs)
            steps.append(_Array(field.length, size, self.element(field.type)))
        elif field.is_array and field.length is None:
            steps.append(_Numbers(field.type))
        else:
            last = steps[-1] if steps else None
            if not isinstance(last, _Run):
                last = _Run()
                steps.append(last)
            last.add(field.type, field.length if field.is_array else None)

    def _class(self, type_: str) -> Tuple[Any, Sequence[Field]]:
        """Return the class of a type and its fields."""
        if type_ in _STAMPS:
            cls, half = _STAMPS[type_]
            fields: Sequence[Field] = [Field("secs", half), Field("nsecs", half)]
        else:
            cls, fields = self._found(type_), self._specs[type_].fields
        names = [attribute_name(field.name) for field in fields]
        plain = (
            list(cls.__slots__) == names
            and cls.__dictoffset__ == 0
            and cls.__new__ is object.__new__
            and cls.__setattr__ is object.__setattr__
            and all(isinstance(getattr(cls, n, None), MemberDescriptorType) for n in names)
        )
        if not plain:
            raise Unfit
        return cls, fields

    def _found(self, type_: str) -> Any:
        """Return the class that genpy's code makes objects of, where it names a type."""
        if type_ == self._root:
            return self._cls
        package, _, name = type_.partition("/")
        known = self._cls.deserialize.__globals__
        try:
            generated = known.get(f"_{package}__{name}")
            return getattr(known[package].msg, name) if generated is None else generated
        except (KeyError, AttributeError) as exc:
            raise Unfit from exc


CODES_ALONE = frozenset(CODES) - frozenset(_STAMPS)
"""Types of numbers: what else is no string becomes an object."""


def _fixed(type_: str, specs: Specs) -> Optional[int]:
    return PRIMITIVE_SIZES[type_] if type_ in _STAMPS else fixed_size(type_, specs)


def _least(type_: str, specs: Specs) -> int:
    """Return the bytes that a message takes at least."""
    if type_ in PRIMITIVE_SIZES:
        return PRIMITIVE_SIZES[type_]
    return sum(
        4
        if f.is_array and f.length is None
        else (f.length or 0 if f.is_array else 1) * _least(f.type, specs)
        for f in specs[type_].fields
    )


class ObjectMaker:
    """Makes the objects of one class out of serialised messages.

    Args:
        cls: A class of messages.
        definition: What it says of itself.

    Raises:
        Unfit: Something is not as genpy makes it, or one object could hold too many others.
    """

    def __init__(self, cls: Any, definition: Definition) -> None:
        self._cls = cls
        self._whole = _Compiler(cls, definition).element(definition.type)
        self._stamps = [
            attribute_name(field.name)
            for field in definition.root.fields
            if field.type in _STAMPS and not field.is_array
        ]

    def make(self, data: bytes, starts: Places, sizes: Places) -> List[Any]:
        """Make the objects of messages that lie anywhere in a buffer, at least one.

        Raises:
            Unfit: They are too different, or one of them is none.
        """
        codecs.lookup_error("rosmsg").msg_type = self._cls._type  # type: ignore[attr-defined]
        group = _Group(_Wires(data), starts, starts + sizes, 1)
        try:
            made, _ = self._whole.make(group)
        except (IndexError, ValueError, struct.error) as exc:  # a length points out of the buffer
            raise Unfit from exc
        for name in self._stamps:
            for stamp in self._odd_stamps(made, name):
                stamp.canon()
        return made

    def _odd_stamps(self, made: List[Any], name: str) -> Iterator[Any]:
        # genpy makes the fields of the message itself canonical, not those of its messages.
        for each in made:
            stamp = getattr(each, name)
            if not 0 <= stamp.nsecs < SECOND_NS:
                yield stamp
