# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The names of a statement in one table: which value stands where.

A topic may have several definitions. A field that one of them lacks is missing there, and only a
field that all of them lack is an error; so problems are collected over all tables.
"""

from __future__ import annotations

from typing import Any, Iterator, Optional, Sequence

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.builder import StatementError
from cassandra_ros.query.extract import Array, Extractor
from cassandra_ros.query.fields import FieldRef, allFields, fieldOf, fieldsOf
from cassandra_ros.query.literals import Comparable, fitToField, fitToText, fitToTime
from cassandra_ros.query.syntax import Key, Literal, Node, Operand, Path

KEY_PLACE, NODE_PLACE = 0, 1


class Findings:
    """What was found wrong in some table, and what was found right in another."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._problems: dict[int, StatementError] = {}
        self._fine: set[int] = set()

    def fine(self, position: int) -> None:
        """Note that what stands at a position makes sense in a table."""
        self._fine.add(position)

    def wrong(self, position: int, problem: StatementError) -> None:
        """Note that it makes none in a table."""
        self._problems.setdefault(position, problem)

    def check(self) -> None:
        """Raise InvalidQuery for the first thing that makes sense in no table."""
        for position, problem in sorted(self._problems.items()):
            if position not in self._fine:
                raise InvalidQuery(self._text, problem.position, problem.reason)


class Scope:
    """Finds the operands of a statement in one definition.

    Args:
        definition: None where the table has no usable one.
        findings: Collects problems.
        named: The rows are kept under names: KEY is text.
    """

    def __init__(
        self, definition: Optional[Definition], findings: Findings, named: bool = False
    ) -> None:
        self._definition = definition
        self._named = named
        self._findings = findings
        self._refs: list[FieldRef] = []
        self._unnested: list[Array] = []

    def locate(self, operand: Operand) -> Optional[int]:
        """Return the place of an operand's value; None where this definition lacks it."""
        if isinstance(operand, Key):
            return KEY_PLACE
        if isinstance(operand, Node):
            return NODE_PLACE
        ref = self._field(operand)
        return None if ref is None else self._place(ref)

    def fit(self, operand: Operand, literal: Literal) -> Optional[Comparable]:
        """Fit a literal to its operand; None where they cannot be compared here."""
        fitted: Optional[Comparable] = None
        try:
            if isinstance(operand, Key):
                fitted = fitToText(literal, "KEY") if self._named else fitToTime(literal)
            elif isinstance(operand, Node):
                fitted = fitToText(literal, "NODE")
            else:
                ref = self._field(operand)
                fitted = None if ref is None else fitToField(literal, ref)
        except StatementError as exc:
            self._findings.wrong(literal.position, exc)
            return None
        if fitted is not None:
            self._findings.fine(literal.position)
        return fitted

    def columns(self, path: Optional[Path]) -> list[tuple[str, FieldRef, int]]:
        """Return name, field and place of each field that a path (None = ``*``) selects."""
        if path is None:
            found = allFields(self._definition) if self._definition is not None else []
        else:
            found = self._fields(path)
        return [(ref.name, ref, self._place(ref)) for ref in found]

    def extractor(self) -> Optional[Extractor]:
        """Return what reads the fields that were located; None when there are none."""
        if self._definition is None or not self._refs:
            return None
        return Extractor(self._definition, self._refs, self._unnested)

    def rows(self, row: Any, extractor: Optional[Extractor]) -> Iterator[Sequence[Any]]:
        """Yield the values of a stored row, KEY and NODE first."""
        own = (row.name if self._named else row.t, row.node)
        if extractor is None:
            yield own
            return
        for values in extractor.values(row):
            yield (*own, *values)

    @property
    def width(self) -> int:
        """How many values there are, KEY and NODE included."""
        return 2 + len(self._refs)

    @property
    def unnests(self) -> bool:
        """Whether a message may give several rows, or none."""
        return bool(self._unnested)

    def _field(self, path: Path) -> Optional[FieldRef]:
        found = self._resolved(path, lambda definition: [fieldOf(path, definition)])
        return found[0] if found else None

    def _fields(self, path: Path) -> list[FieldRef]:
        return self._resolved(path, lambda definition: fieldsOf(path, definition))

    def _resolved(self, path: Path, resolve: Any) -> list[FieldRef]:
        try:
            if self._definition is None:
                raise StatementError(path.position, "the messages of this topic have no definition")
            found: list[FieldRef] = resolve(self._definition)
        except StatementError as exc:
            self._findings.wrong(path.position, exc)
            return []
        self._findings.fine(path.position)
        for ref in found:
            self._unnest(path, ref)
        return found

    def _unnest(self, path: Path, ref: FieldRef) -> None:
        """Unnest the arrays whose elements a path names (not those that it names whole)."""
        for array in ref.arrays:
            if len(array) >= len(path.parts) or array in self._unnested:
                continue
            inner = self._unnested[-1] if self._unnested else ()
            if array[: len(inner)] != inner:
                names = [".".join(step.name for step in a) for a in (inner, array)]
                problem = StatementError(
                    path.position,
                    f"the statement names fields inside two arrays of messages, {names[0]} and "
                    f"{names[1]}; ask for them in two statements, or name an element: "
                    f"{names[1]}[0]",
                )
                self._findings.wrong(-1 - path.position, problem)
                continue
            self._unnested.append(array)

    def _place(self, ref: FieldRef) -> int:
        if ref not in self._refs:
            self._refs.append(ref)
        return 2 + self._refs.index(ref)
