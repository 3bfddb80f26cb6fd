# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Arrow types of messages: a message is a struct, as in its definition.

* Numbers and bools keep their types; text is ``string``, ``uint8[]`` is ``binary``.
* Other arrays are lists, arrays of messages lists of structs, whether their length is fixed or not.
* ``time`` is a timestamp in ns (UTC, without a zone), ``duration`` int64 ns, because DuckDB's
  INTERVAL holds only microseconds.
* Messages without any field, such as std_msgs/Empty, have no column.

Names of columns are unique without regard to case, because SQL does not distinguish it: of fields
``Data`` and ``data`` the second has column ``data_1``. A field has the same column in all
definitions of a topic; the definition that was stored first keeps its names.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any, Dict, Iterable, Iterator, Sequence

from cassandra_ros.errors import InvalidName
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Field, Specs
from cassandra_ros.query.arrays.array_types import MIXED, ArrayType, unite_types
from cassandra_ros.query.tree.field_names import nearest

if TYPE_CHECKING:
    import pyarrow

Wanted = Dict[str, Any]
"""Columns to make, by lower-case name: {} = the whole column, else the fields inside it."""
OWN_COLUMNS = ("KEY", "NODE", "RUN")
"""Columns of every topic: time (or name) of the message, robot, and run."""
_PRIMITIVES = {"float32": "float32", "float64": "float64", "bool": "bool_", "string": "string"}


def load_arrow(purpose: str) -> Any:
    """Return the module pyarrow; raises MissingDependency if it is not installed."""
    return optional_module("pyarrow", purpose)


def wanted_columns(paths: Iterable[Sequence[str]]) -> Wanted:
    """Return what to make for some paths, each the names from a column down to a field in it."""
    tree: Wanted = {}
    whole: list[Wanted] = []
    for path in paths:
        inside = tree
        for name in path:
            inside = inside.setdefault(name.lower(), {})
        whole.append(inside)
    for subtree in whole:  # a name of a whole message includes all names inside it
        subtree.clear()
    return tree


def check_columns(schema: pyarrow.Schema, names: Sequence[str]) -> None:
    """Check that a schema has the columns, and fields in them, of some dotted names.

    Raises:
        InvalidName: A name is missing; the text has similar ones.
    """
    for name in names:
        fields: Any = schema
        for word in str(name).split("."):
            by_name = {field.name.lower(): field for field in fields}
            if word.lower() not in by_name:
                text = f"there is no column {name!r:.80}"
                raise InvalidName(text + nearest(word, [field.name for field in fields]))
            fields = struct_of(by_name[word.lower()].type)


def struct_of(kind: Any) -> Sequence[Any]:
    """Return the fields of a struct type, or of the structs in a list; () = it is another type."""
    while hasattr(kind, "value_type"):
        kind = kind.value_type
    return list(kind) if kind.num_fields else ()


@dataclass(frozen=True)
class ArrowField:
    """A field of a message, and the column or struct field that holds it."""

    name: str
    """Name in Arrow."""
    path: str
    """Dotted path of the field in its message."""
    field: Field
    children: tuple[ArrowField, ...] = ()
    """Fields of the message, or of each message in the array, that are made; () = primitive."""

    @property
    def is_bytes(self) -> bool:
        """Whether it is uint8[], whose elements are not values of their own."""
        return self.field.is_array and self.field.base == "uint8"

    def type(self, arrow: Any) -> pyarrow.DataType:
        """Return its type in Arrow."""
        if self.is_bytes:
            return arrow.binary()
        value = self.value_type(arrow)
        return arrow.list_(value) if self.field.is_array else value

    def value_type(self, arrow: Any) -> pyarrow.DataType:
        """Return its type in Arrow, for an array the type of an element."""
        if self.children:
            return arrow.struct([(child.name, child.type(arrow)) for child in self.children])
        base = self.field.base
        if base == "time":
            return arrow.timestamp("ns")
        return getattr(arrow, _PRIMITIVES.get(base, "int64" if base == "duration" else base))()


class ColumnNames:
    """Names of the columns of a topic, given in the order in which its fields are asked for."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, str]] = {}
        """Path of a message with a dot behind it, '' = the whole message → field → column."""

    def of(self, prefix: str, field: str) -> str:
        """Return the name in Arrow of a field of the message at a path, as in ``_names``."""
        names = self._names.setdefault(prefix, {})
        if field not in names:
            reserved = () if prefix else OWN_COLUMNS
            lower_names = {name.lower() for name in (*reserved, *names.values())}
            names[field] = _free_name(field, lower_names)
        return names[field]


def fields_of(
    definition: Definition | None, wanted: Wanted | None, names: ColumnNames | None = None
) -> tuple[ArrowField, ...]:
    """Return the fields of a message type that have columns.

    Args:
        definition: None = the definition is not usable; there are no columns.
        wanted: The columns to make; None = all.
        names: Names of the columns in all definitions of the topic; None = this is its only one.
    """
    if definition is None:
        return ()
    all_fields = _fields(definition.type, definition.specs, "", names or ColumnNames())
    return tuple(all_fields if wanted is None else _prune(all_fields, wanted))


def _fields(msg_type: str, specs: Specs, prefix: str, names: ColumnNames) -> list[ArrowField]:
    """Return the fields with columns of the message at path ``prefix`` ('' or 'a.b.')."""
    columns: list[ArrowField] = []
    for field in specs[msg_type].fields:
        path, children = prefix + field.name, []
        if not field.is_primitive:
            children = _fields(field.type, specs, path + ".", names)
            if not children:
                continue
        columns.append(ArrowField(names.of(prefix, field.name), path, field, tuple(children)))
    return columns


def count_leaves(fields: Iterable[ArrowField]) -> int:
    """Return the number of fields that are no messages, also in messages."""
    return sum(count_leaves(field.children) if field.children else 1 for field in fields)


def _free_name(name: str, lower_names: set[str]) -> str:
    """Return a name, with the first number that makes it new without regard to case."""
    number, free = 0, name
    while free.lower() in lower_names:
        number += 1
        free = f"{name}_{number}"
    return free


def _prune(fields: Sequence[ArrowField], wanted: Wanted) -> Iterator[ArrowField]:
    """Yield the wanted fields, with the wanted fields inside them."""
    for field in fields:
        inside = wanted.get(field.name.lower())
        if inside is None:
            continue
        children = tuple(_prune(field.children, inside)) if inside else ()
        # Without one of the named fields the whole message is made: the names may mean another.
        yield ArrowField(field.name, field.path, field.field, children or field.children)


def unite_schemas(arrow: Any, schemas: Sequence[pyarrow.Schema]) -> pyarrow.Schema:
    """Return a schema with the columns of one or more schemas, of types that hold all values."""
    struct = reduce(
        lambda one, other: _unite(arrow, one, other), [arrow.struct(list(s)) for s in schemas]
    )
    return arrow.schema(list(struct))


def _unite(arrow: Any, one: pyarrow.DataType, other: pyarrow.DataType) -> pyarrow.DataType:
    """Return the type that holds the values of two; text (JSON) if they have nothing in common."""
    if one == other:
        return one
    types = arrow.types
    if types.is_struct(one) and types.is_struct(other):
        fields = {field.name.lower(): field for field in one}
        for field in other:
            same = fields.get(field.name.lower(), field)
            kind = _unite(arrow, same.type, field.type)
            fields[field.name.lower()] = arrow.field(same.name, kind)
        return arrow.struct(list(fields.values()))
    if types.is_list(one) and types.is_list(other):
        return arrow.list_(_unite(arrow, one.value_type, other.value_type))
    if _is_number(types, one) and _is_number(types, other):
        kinds = [ArrayType(kind.to_pandas_dtype()().dtype.name) for kind in (one, other)]
        common = unite_types(kinds).kind
        if common != MIXED:
            return getattr(arrow, common)()
    return arrow.string()


def _is_number(types: Any, kind: pyarrow.DataType) -> bool:
    return bool(types.is_integer(kind) or types.is_floating(kind))


def adapt(arrow: Any, array: pyarrow.Array, kind: pyarrow.DataType) -> pyarrow.Array:
    """Return the values of an array as those of a united type, see unite_schemas.

    Where definitions have types that have nothing in common, the values are JSON texts.
    """
    if array.type == kind:
        return array
    types, array_type = arrow.types, array.type
    if types.is_struct(array_type) and types.is_struct(kind):
        return _adapt_struct(arrow, array, kind)
    if types.is_list(array_type) and types.is_list(kind):
        values = adapt(arrow, array.values, kind.value_type)
        buffers = array.buffers()[:2]
        return arrow.Array.from_buffers(
            kind, len(array), buffers, offset=array.offset, children=[values]
        )
    if types.is_string(kind):
        plain = array.cast(arrow.int64()) if types.is_timestamp(array_type) else array
        texts = [None if value is None else _as_json(value) for value in plain.to_pylist()]
        return arrow.array(texts, kind)
    return array.cast(kind)


def _adapt_struct(arrow: Any, array: pyarrow.Array, kind: pyarrow.DataType) -> pyarrow.Array:
    places = {field.name.lower(): n for n, field in enumerate(array.type)}
    children = []
    for field in kind:
        place = places.get(field.name.lower())
        if place is None:
            children.append(arrow.nulls(len(array), field.type))
        else:
            children.append(adapt(arrow, array.field(place), field.type))
    validity = array.buffers()[0]
    return arrow.Array.from_buffers(kind, len(array), [validity], children=children)


def _as_json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, default=_hex)


def _hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)
