# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of a topic's table in SQL, with which a condition may compare."""

from __future__ import annotations

from typing import Any, Sequence

from cassandra_ros.client.sql.event_names import EVENT
from cassandra_ros.client.sql.pushed_conditions import ComparableColumn
from cassandra_ros.query.arrays.arrow_batches import ArrowSchema
from cassandra_ros.query.arrays.arrow_types import ArrowField
from cassandra_ros.query.protocols import Table

_OWN = {"key": "key", "node": "node", "run": "run"}
"""Column that each message has, in lower case -> kind of ComparableColumn."""


class TableColumns:
    """All columns of a topic.

    Args:
        tables: Tables of the topic.
        has_events: Whether it has the column EVENT.

    Attributes:
        schema: Their names and Arrow types.
    """

    def __init__(self, tables: Sequence[Table], has_events: bool = False) -> None:
        arrow_schema = ArrowSchema(tables)
        self._own = {**_OWN, EVENT.lower(): "event"} if has_events else _OWN
        self.schema: Any = arrow_schema.schema
        self._arrow = arrow_schema.arrow
        self._named = arrow_schema.named
        self._fields = list(arrow_schema.fields.values())

    def find(self, names: Sequence[str]) -> ComparableColumn | None:
        """Return a column, or a field in a message; None = no such column, or no simple one.

        No condition compares with an array or a struct, or with a field that has different paths in
        the definitions of the topic.

        Args:
            names: Name of the column, and of a field in each struct on the way, in any case.
        """
        own_kind = self._own.get(names[0].lower()) if len(names) == 1 else None
        if own_kind is not None:
            return ComparableColumn("text" if self._named and own_kind == "key" else own_kind)
        paths = {_path(fields, names) for fields in self._fields} - {None}
        kind = self._kind(names)
        if kind is None or len(paths) != 1:
            return None
        if kind == "text" and not all(_is_text(fields, names) for fields in self._fields):
            return None  # in some definition the field is not a string, and its text is shown
        return ComparableColumn(kind, paths.pop() or "")

    def _kind(self, names: Sequence[str]) -> str | None:
        """Return the kind of a column by its type in Arrow; None = missing, or not comparable."""
        fields: Any = self.schema
        kind = None
        for name in names:
            inside = {field.name.lower(): field for field in fields}
            if name.lower() not in inside:
                return None
            kind = inside[name.lower()].type
            fields = list(kind) if kind.num_fields and self._arrow.types.is_struct(kind) else ()
        return None if kind is None else self._kind_of(kind)

    def _kind_of(self, kind: Any) -> str | None:
        types = self._arrow.types
        tests = {
            "time": types.is_timestamp,
            "text": types.is_string,
            "bool": types.is_boolean,
            "int": types.is_integer,
            "float32": types.is_float32,
            "float64": types.is_float64,
        }
        return next((name for name, test in tests.items() if test(kind)), None)


def _is_text(fields: Sequence[ArrowField], names: Sequence[str]) -> bool:
    """Return whether a field is a string in a definition, or is not in it."""
    for number, name in enumerate(names, 1):
        field_column = next((field for field in fields if field.name.lower() == name.lower()), None)
        if field_column is None:
            return True
        if field_column.field.is_array or number == len(names):
            return field_column.field.base == "string" and not field_column.field.is_array
        fields = field_column.children
    return True


def _path(fields: Sequence[ArrowField], names: Sequence[str]) -> str | None:
    """Return the path of a field in the messages of one definition; None = it has no such field."""
    path = None
    for name in names:
        field_column = next((field for field in fields if field.name.lower() == name.lower()), None)
        if field_column is None or field_column.field.is_array:
            return None
        fields, path = field_column.children, field_column.path
    return path
