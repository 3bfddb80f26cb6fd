# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From the words that the grammar recognised to the tree of a statement."""

from __future__ import annotations

from typing import Any, NamedTuple, Optional, Union

from lark import Token, Transformer, v_args

from cassandra_ros.query.syntax import (
    Aggregate,
    All,
    Column,
    Compare,
    CreateIndex,
    DecimalText,
    Delete,
    DropIndex,
    Either,
    Expression,
    Indexed,
    IndexName,
    IsNull,
    Key,
    Literal,
    Negation,
    Node,
    OneOf,
    Operand,
    Part,
    Path,
    Placeholder,
    Truncate,
    Value,
    parts,
)

MAX_DEPTH = 100
MAX_DIGITS = 400
"""Of a number: Python converts longer ones in quadratic time, or refuses."""


class StatementError(Exception):
    """Something in a statement is wrong at a position; becomes an InvalidQuery."""

    def __init__(self, position: int, reason: str) -> None:
        super().__init__(reason)
        self.position = position
        self.reason = reason


class Parsed(NamedTuple):
    """The clauses of a SELECT, its values not bound yet."""

    columns: Optional[tuple[Column, ...]]
    topic: str
    topic_position: int
    condition: Optional[Expression]
    descending: bool
    limit: Optional[Value]


@v_args(inline=True)
class _Builder(Transformer):  # type: ignore[type-arg]
    """One method per rule of the grammar, called while lark parses."""

    def select(
        self,
        columns: Optional[tuple[Column, ...]],
        topic: tuple[str, int],
        condition: Optional[Expression],
        descending: Optional[bool],
        limit: Optional[Value],
    ) -> Parsed:
        return Parsed(columns, *topic, condition, bool(descending), limit)

    def delete(self, topic: tuple[str, int], condition: Optional[Expression]) -> Delete:
        if condition is None:
            raise StatementError(
                topic[1],
                "DELETE takes a condition: WHERE KEY < …, say; every message of a topic is removed "
                "by TRUNCATE",
            )
        return Delete("", *topic, condition)

    def truncate(self, *words: Union[Token, tuple[str, int]]) -> Truncate:
        last = words[-1]
        return Truncate("", *(self.topic(last) if isinstance(last, Token) else last))

    def create_index(
        self, unless: Optional[bool], name: Optional[IndexName], indexed: Indexed
    ) -> CreateIndex:
        return CreateIndex("", indexed, name, bool(unless))

    def drop_index(self, condition: Optional[bool], index: Union[IndexName, Indexed]) -> DropIndex:
        return DropIndex("", index, bool(condition))

    drop_index_on = drop_index

    def if_exists(self) -> bool:
        return True

    if_not_exists = if_exists

    def index_name(self, token: Token) -> IndexName:
        # As CQL has it.
        return IndexName(_name(token) if token.type == "QUOTED" else token.lower(), _at(token))

    def indexed(self, topic: tuple[str, int], field: Operand) -> Indexed:
        if not isinstance(field, Path):
            raise StatementError(field.position, f"{field.text} needs no index: rows lie by it")
        for part in field.parts:
            if part.index is not None:
                raise StatementError(
                    part.position,
                    f"an index is on all elements of an array: leave [{part.index}] out",
                )
        return Indexed(*topic, field)

    def lone_condition(self, condition: Expression) -> Expression:
        return condition

    def everything(self, _star: Token) -> None:
        return None

    def selected(self, *columns: Column) -> tuple[Column, ...]:
        one = [c.what for c in columns if isinstance(c.what, Aggregate)]
        many = [c.what for c in columns if not isinstance(c.what, Aggregate)]
        if one and many:
            raise StatementError(
                one[0].position,
                f"{one[0].text} is one value made of all rows: it stands alone or beside other "
                f"aggregates, not beside {many[0].text}",
            )
        return columns

    def column(self, what: Union[Operand, Aggregate], alias: Optional[Token]) -> Column:
        if alias is None:
            return Column(what)
        return Column(what, _name(alias))

    def aggregate(self, word: Token, operand: Union[Token, Operand]) -> Aggregate:
        function = word.lower()
        if not isinstance(operand, Token):
            return Aggregate(function, operand, _at(word))
        if function != "count":
            raise StatementError(_at(operand), f"{function} takes one field; only count takes *")
        return Aggregate(function, None, _at(word))

    def topic(self, token: Token) -> tuple[str, int]:
        return _name(token), _at(token)

    def where(self, condition: Expression) -> Expression:
        return condition

    def order(self, _key: Token, direction: Optional[Token]) -> bool:
        return direction is not None and direction.type == "DESC"

    def limit(self, count: Any) -> Value:
        return count if isinstance(count, Placeholder) else Literal(_integer(count), _at(count))

    # ------------------------------------------------------------------ conditions

    def either(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else _shallow(Either(items), items)

    def all(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else _shallow(All(items), items)

    def negate(self, item: Expression) -> Expression:
        return _shallow(Negation(item), (item,))

    def compare(self, operand: Operand, operator: Token, value: Value) -> Compare:
        return Compare(operand, "!=" if operator == "<>" else str(operator), value)

    def one_of(self, operand: Operand, *values: Optional[Value]) -> OneOf:
        return OneOf(operand, tuple(value for value in values if value is not None))

    def none_of(self, operand: Operand, *values: Optional[Value]) -> Negation:
        return Negation(self.one_of(operand, *values))

    def in_list(self, operand: Operand, values: Placeholder) -> OneOf:
        return OneOf(operand, (values,), whole=True)

    def not_in_list(self, operand: Operand, values: Placeholder) -> Negation:
        return Negation(OneOf(operand, (values,), whole=True))

    def between(self, operand: Operand, low: Value, high: Value) -> All:
        return All((Compare(operand, ">=", low), Compare(operand, "<=", high)))

    def not_between(self, operand: Operand, low: Value, high: Value) -> Negation:
        return Negation(self.between(operand, low, high))

    def like(self, operand: Operand, pattern: Value) -> Compare:
        return Compare(operand, "LIKE", pattern)

    def not_like(self, operand: Operand, pattern: Value) -> Negation:
        return Negation(self.like(operand, pattern))

    def contains(self, operand: Operand, value: Value) -> Compare:
        return Compare(operand, "CONTAINS", value)

    def not_contains(self, operand: Operand, value: Value) -> Negation:
        return Negation(self.contains(operand, value))

    def is_null(self, operand: Operand) -> IsNull:
        return IsNull(operand)

    def is_not_null(self, operand: Operand) -> Negation:
        return Negation(IsNull(operand))

    def aggregate_as_condition(self, found: Aggregate) -> Operand:
        raise StatementError(
            found.position,
            f"{found.text} is made of the rows that satisfy the condition, so it cannot stand in "
            "it; select it, and compare its value in a second statement",
        )

    # ------------------------------------------------------------------ names and values

    def key(self, token: Token) -> Key:
        return Key(_at(token))

    def node(self, token: Token) -> Node:
        return Node(_at(token))

    def path(self, *parts: tuple[Part, ...]) -> Path:
        names = tuple(name for part in parts for name in part)
        return Path(names, names[0].position)

    def part(self, token: Token, index: Optional[Token]) -> tuple[Part, ...]:
        names = _name(token).split(".") if token.type == "QUOTED" else [str(token)]
        made = [Part(name, None, _at(token)) for name in names]
        if index is not None:
            made[-1] = Part(names[-1], _integer(index), _at(token))
        return tuple(made)

    def number(self, token: Token) -> Literal:
        if token.lstrip("+-").isdigit():
            return Literal(_integer(token), _at(token))
        return Literal(DecimalText(str(token)), _at(token))

    def text(self, token: Token) -> Literal:
        return Literal(token[1:-1].replace("''", "'"), _at(token))

    def true(self, token: Token) -> Literal:
        return Literal(True, _at(token))

    def false(self, token: Token) -> Literal:
        return Literal(False, _at(token))

    def placeholder(self, token: Token) -> Placeholder:
        return Placeholder(_at(token))


def _at(token: Token) -> int:
    return token.start_pos or 0


def _name(token: Token) -> str:
    return token[1:-1].replace('""', '"') if token.type == "QUOTED" else str(token)


def _integer(token: Token) -> int:
    if len(token) > MAX_DIGITS:
        raise StatementError(_at(token), f"a number has at most {MAX_DIGITS} digits")
    return int(token)


def _shallow(made: Expression, items: tuple[Expression, ...]) -> Expression:
    """Return made unless it is nested so deep that walking it would overflow the stack."""
    level, depth = list(items), 1
    while level:
        level = [part for item in level for part in parts(item)]
        depth += 1
        if depth > MAX_DEPTH:
            raise StatementError(0, f"the condition is nested deeper than {MAX_DEPTH}")
    return made


BUILDER = _Builder()
"""Makes the tree; holds no state, so threads may share it."""
