# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a statement selects, by name and type: the columns of its tables."""

from __future__ import annotations

from typing import Any, Iterator, NamedTuple, Optional, Sequence, Union

from cassandra_ros.arrays.array_types import ArrayType, typeOf, uniteTypes
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.evaluate import compileCondition
from cassandra_ros.query.fields import FieldRef
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.scope import Findings, Scope
from cassandra_ros.query.syntax import Aggregate, Column, Key, Node, Select


class Output(NamedTuple):
    """One column of a statement's result, in one table."""

    name: str
    what: Union[FieldRef, Key, Node, Aggregate]
    kind: ArrayType
    place: int = 0
    """Of a field: where its value stands among the scope's."""


def outputsOf(
    select: Select, scope: Scope, definition: Optional[Definition], named: bool
) -> list[list[Output]]:
    """List the columns that each selected path gives, once the condition has been located.

    Args:
        select: The statement.
        scope: Where the names of the condition have been looked up already.
        definition: Of the table.
        named: KEY is a name.
    """
    columns = select.columns
    if columns is None:
        key = Output("KEY", Key(0), _keyType(named))
        every = scope.columns(None)
        return [[key], list(_fields(every, scope, definition, None))]
    found: list[Any] = []
    for column in columns:
        what = column.what
        if isinstance(what, (Key, Node, Aggregate)):
            found.append(what)
        else:
            found.append(scope.columns(what))
    # Types are known when all has been located: what is unnested shows only then.
    return [
        [Output(column.text, what, _ownType(what, scope, definition, named))]
        if isinstance(what, (Key, Node, Aggregate))
        else list(_fields(what, scope, definition, column))
        for column, what in zip(columns, found)
    ]


def columnTypes(select: Select, tables: Sequence[Table]) -> list[tuple[str, ArrayType]]:
    """Return name and type of each column of the result of a statement.

    Args:
        select: The statement.
        tables: The tables of its topic.
    """
    found = []
    for table in tables:
        findings = Findings(select.text)
        scope = Scope(table.definition, findings, table.named)
        compileCondition(select.condition, scope.locate, scope.fit)
        found.append(outputsOf(select, scope, table.definition, table.named))
    return [(name, uniteTypes(kinds)) for name, kinds in uniteOutputs(found)]


def uniteOutputs(tables: Sequence[Sequence[Sequence[Output]]]) -> list[tuple[str, list[ArrayType]]]:
    """Return the names of all tables' columns in their order, each with its types."""
    united: list[tuple[str, list[ArrayType]]] = []
    for groups in zip(*tables):
        names: dict[str, list[ArrayType]] = {}
        for group in groups:
            for output in group:
                names.setdefault(output.name, []).append(output.kind)
        united += names.items()
    return united


def _fields(
    found: Sequence[Any], scope: Scope, definition: Any, column: Optional[Column]
) -> Iterator[Output]:
    for name, ref, place in found:
        alias = None if column is None else column.alias
        yield Output(alias or name, ref, typeOf(ref, definition, scope.unnested), place)


def _keyType(named: bool) -> ArrayType:
    return ArrayType("string" if named else "time")


def _ownType(
    what: Union[Key, Node, Aggregate], scope: Scope, definition: Any, named: bool
) -> ArrayType:
    if isinstance(what, Key):
        return _keyType(named)
    if isinstance(what, Node):
        return ArrayType("string")
    if what.function == "count":
        return ArrayType("int64")
    if what.function == "avg":
        return ArrayType("float64")
    if isinstance(what.operand, (Key, Node)):
        return _ownType(what.operand, scope, definition, named)
    found = scope.columns(what.operand)
    if not found:
        return ArrayType("mixed")
    kind = typeOf(found[0][1], definition, scope.unnested)
    if what.function != "sum":
        return kind
    return ArrayType("float64" if kind.kind.startswith("float") else "sum")
