# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The names of a statement in one table: which value stands where.

A topic may have several definitions. A field that one of them lacks is missing there, and only a
field that all of them lack is an error; so problems are collected over all tables.
"""

from __future__ import annotations

from typing import Any, Iterator, Optional, Sequence, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.builder import StatementError
from cassandra_ros.query.extract import Array, Extractor
from cassandra_ros.query.fields import FieldRef, allFields, fieldOf, fieldsOf
from cassandra_ros.query.literals import Comparable, fitToField, fitToText, fitToTime
from cassandra_ros.query.protocols import Row
from cassandra_ros.query.syntax import Aggregate, Compare, IsNull, Key, Leaf, Literal, Node, Path

KEY_PLACE, NODE_PLACE = 0, 1
_BESIDE = -1
"""From here downwards are the marks of problems that no other table can make good."""
_NO_NUMBERS = ("string", "time", "duration")


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

    def locate(self, leaf: Leaf) -> Optional[int]:
        """Return the place of a comparison's operand; None where this definition lacks it."""
        if isinstance(leaf.operand, Key):
            return KEY_PLACE
        if isinstance(leaf.operand, Node):
            return NODE_PLACE
        ref = self._field(leaf.operand, wantsArray(leaf))
        return None if ref is None else self._place(ref)

    def fit(self, leaf: Leaf, literal: Literal) -> Optional[Comparable]:
        """Fit a literal to its operand; None where they cannot be compared here."""
        try:
            fitted = self._fitted(leaf, literal)
        except StatementError as exc:
            self._findings.wrong(literal.position, exc)
            return None
        if fitted is not None:
            self._findings.fine(literal.position)
        return fitted

    def aggregated(self, asked: Aggregate) -> Optional[tuple[int, str]]:
        """Return place and type of what an aggregate is made of; None where it is missing."""
        operand = asked.operand
        if isinstance(operand, Path):
            ref = self._field(operand)
            if ref is None:
                return None
            place, kind = self._place(ref), ref.type
        elif isinstance(operand, Node):
            place, kind = NODE_PLACE, "string"
        else:
            place, kind = KEY_PLACE, "string" if self._named else "time"
        if operand is not None and asked.function in ("sum", "avg") and kind in _NO_NUMBERS:
            problem = StatementError(
                operand.position,
                f"{operand.text} is a {kind}, and {asked.function} is for numbers; "
                "min, max and count take any field",
            )
            self._findings.wrong(asked.position, problem)
            return None
        self._findings.fine(asked.position)
        return place, kind

    def refuse(self, path: Path, reason: str) -> None:
        """Note that a path, although there is such a field, cannot stand where it does."""
        self._findings.wrong(_BESIDE - path.position, StatementError(path.position, reason))

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

    def rows(self, row: Row, extractor: Optional[Extractor]) -> Iterator[Sequence[Any]]:
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
    def refs(self) -> tuple[FieldRef, ...]:
        """The fields that were located so far, in the order of their values."""
        return tuple(self._refs)

    @property
    def unnested(self) -> tuple[Array, ...]:
        """The arrays of messages that are unnested, outermost first."""
        return tuple(self._unnested)

    @property
    def unnests(self) -> bool:
        """Whether a message may give several rows, or none."""
        return bool(self._unnested)

    def _fitted(self, leaf: Leaf, literal: Literal) -> Optional[Comparable]:
        operand, sign = leaf.operand, leaf.operator if isinstance(leaf, Compare) else ""
        if isinstance(operand, Path):
            ref = self._field(operand, wantsArray(leaf))
            if ref is None:
                return None
            if sign == "LIKE":
                _checkText(operand, ref.type)
            return fitToField(literal, ref)
        if sign == "CONTAINS":
            raise StatementError(
                operand.position, f"{operand.text} is not an array; compare it with ="
            )
        if self._named or isinstance(operand, Node):
            return fitToText(literal, operand.text)
        if sign == "LIKE":
            _checkText(operand, "time")
        return fitToTime(literal)

    def _field(self, path: Path, array: Optional[bool] = False) -> Optional[FieldRef]:
        found = self._resolved(path, lambda definition: [fieldOf(path, definition, array)])
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
                self._findings.wrong(_BESIDE - path.position, problem)
                continue
            self._unnested.append(array)

    def _place(self, ref: FieldRef) -> int:
        if ref not in self._refs:
            self._refs.append(ref)
        return 2 + self._refs.index(ref)


def wantsArray(leaf: Leaf) -> Optional[bool]:
    """Say whether a comparison's operand is an array as a whole; None = either."""
    if isinstance(leaf, IsNull):
        return None
    return isinstance(leaf, Compare) and leaf.operator == "CONTAINS"


def _checkText(operand: Union[Path, Key], kind: str) -> None:
    if kind != "string":
        raise StatementError(
            operand.position,
            f"{operand.text} is a {kind}, and LIKE is for text; compare it with = < > or BETWEEN",
        )
