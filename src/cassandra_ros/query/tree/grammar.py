# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The parser of statements and conditions that lark makes of cql.lark.

lark takes a tenth of a second to compute the parser's tables from a grammar. So they are kept in
cql_tables.json, which `make setup GRAMMAR=1` writes: text and numbers only, as lark's own cache, a
pickle, is not. Tables of another grammar, or of another lark, are not used: they are computed then.

``_Builder`` builds the tree while lark parses the text: terms, then conditions of them, then
statements. Only this module and completion import lark at once: most programs parse nothing.
"""

from __future__ import annotations

import hashlib
import json
import pathlib
import re
from dataclasses import replace
from decimal import Decimal, localcontext
from functools import lru_cache
from typing import Any, Optional, Sequence

import lark
from lark import Lark, Token, Transformer, v_args

from cassandra_ros.query.tree.syntax import (
    AGGREGATES,
    DURATION_UNITS_NS,
    QUANTIFIERS,
    Aggregate,
    All,
    Call,
    Compare,
    CreateIndex,
    DecimalText,
    Delete,
    DropIndex,
    DurationNs,
    Either,
    Expression,
    FieldPath,
    Indexed,
    IndexName,
    InEvent,
    IsNull,
    KeyOperand,
    LengthText,
    Literal,
    Near,
    Negation,
    NodeOperand,
    OneOf,
    Operand,
    Ordering,
    PathPart,
    Quantified,
    Relate,
    RunOperand,
    Select,
    Selected,
    StatementError,
    Term,
    Truncate,
    is_constant,
    parts,
)

_GRAMMAR = pathlib.Path(__file__).with_name("cql.lark")
_TABLES = pathlib.Path(__file__).with_name("cql_tables.json")


@lru_cache(maxsize=1)
def grammar() -> Lark:
    """Return the parser of statements and conditions, made once."""
    try:
        tables = json.loads(_TABLES.read_text("ascii"), object_hook=_with_numbers)
    except FileNotFoundError:  # the package was copied without it
        return _compute_parser()
    if tables["origin"] != _origin():
        return _compute_parser()
    tables["data"]["options"]["transformer"] = _Builder()
    return Lark.load(tables)


def write_tables() -> None:
    """Compute the tables and keep them in the file beside the grammar."""
    data, memo = _compute_parser().memo_serialize([lark.lexer.TerminalDef, lark.grammar.Rule])
    data["options"] = {**data["options"], "transformer": None}
    tables = {"origin": _origin(), "data": data, "memo": memo}
    _TABLES.write_text(json.dumps(tables, separators=(",", ":")) + "\n", "ascii")


def _compute_parser() -> Lark:
    text, start = _GRAMMAR.read_text("utf-8"), ["statement", "lone_condition"]
    return Lark(text, parser="lalr", start=start, transformer=_Builder())


def _origin() -> str:
    """Return from what the tables were made: the version of lark, and the hash of the grammar."""
    return f"lark {lark.__version__} {hashlib.sha256(_GRAMMAR.read_bytes()).hexdigest()}"


def _with_numbers(table: dict[str, Any]) -> dict[Any, Any]:
    """Return a table with its numbers as keys, which JSON made texts."""
    return {int(key) if key.isdigit() else key: value for key, value in table.items()}


_Not = Optional[Token]
"""The word NOT; None = it is not there."""
MAX_DEPTH = 100
"""Maximum nesting depth of a condition, and of what is computed."""
NEAR_VALUES = (3, 5)
"""Minimum and maximum number of arguments of NEAR."""
MAX_DIGITS = 400
"""Maximum number of digits of a number. Python's conversion of longer ones takes quadratic time."""


@v_args(inline=True)
class _Terms(Transformer):  # type: ignore[type-arg]
    """Builds fields, constants and what is computed of them.

    Here and below: a method for each rule of the grammar, which lark calls with what stands in the
    rule, None for an optional item that is absent. A StatementError ends the parsing.
    """

    def call(self, word: Token, argument: None | Token | Term) -> Call:
        """Make a call; ``argument`` is a Token for ``*``, None for empty parentheses."""
        function, at = word.lower(), _at(word)
        if function == "now":
            if argument is not None:
                raise StatementError(at, "now() takes nothing in its parentheses")
            return Call(function, (), at)
        if isinstance(argument, Token) and function == "count":
            return Call(function, (), at)
        if argument is None or isinstance(argument, Token):
            position = at if argument is None else _at(argument)
            reason = f"{function} takes one {'duration' if function == 'time' else 'field'}"
            raise StatementError(position, f"{reason}; only count takes *")
        arguments = (KeyOperand(at), argument) if function == "time" else (argument,)
        if function in QUANTIFIERS and not isinstance(argument, FieldPath):
            reason = f"{word.upper()} takes an array, not {_row_term(argument).text}"
            raise StatementError(argument.position, reason)
        return _call(function, arguments, at)

    def binary(self, left: Term, sign: Token, right: Term) -> Call:
        return _call(str(sign), (left, right), _at(sign))

    def negative(self, minus: Token, term: Term) -> Call:
        return _call("neg", (term,), _at(minus))

    def place(self, token: Token) -> Operand:
        return _OWN[str(token)](_at(token))

    def path(self, *groups: tuple[PathPart, ...]) -> FieldPath:
        path_parts = tuple(path_part for group in groups for path_part in group)
        return FieldPath(path_parts, path_parts[0].position)

    def part(self, token: Token, index: Token | None) -> tuple[PathPart, ...]:
        """Return one name of a path, or all names of a path that is quoted whole: "a.b"."""
        names = _name(token).split(".") if token.type == "QUOTED" else [str(token)]
        path_parts = [PathPart(name, None, _at(token)) for name in names]
        if index is not None:
            path_parts[-1] = PathPart(names[-1], _integer(index), _at(token))
        return tuple(path_parts)

    def literal(self, token: Token) -> Literal:
        if token.type == "PLACEHOLDER":
            return Literal(None, _at(token), bound=False)
        if token.type in ("TRUE", "FALSE"):
            return Literal(token.type == "TRUE", _at(token))
        if token.type == "TEXT":
            return Literal(token[1:-1].replace("''", "'"), _at(token))
        if token.type == "DURATION":
            return Literal(_duration(token), _at(token))
        whole = token.lstrip("+-").isdigit()
        return Literal(_integer(token) if whole else DecimalText(str(token)), _at(token))

    def length(self, token: Token) -> Literal:
        return Literal(LengthText(token), _at(token))


@v_args(inline=True)
class _Conditions(_Terms):
    """Builds conditions."""

    def where(self, condition: Expression) -> Expression:
        """Refuse a condition so deeply nested that recursion would overflow the stack."""
        level, depth = [condition], 1
        while level:
            if depth > MAX_DEPTH:
                raise StatementError(0, f"the condition is nested deeper than {MAX_DEPTH}")
            level, depth = [inner for item in level for inner in parts(item)], depth + 1
        return condition

    def either(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else Either(items)

    def all(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else All(items)

    def negate(self, _not: Token, item: Expression) -> Negation:
        return Negation(item)

    def compare(self, left: Term, operator: Token, right: Term) -> Expression:
        sign = "!=" if operator == "<>" else str(operator)
        return compared(left, sign, right, _at(operator))

    def match(self, operand: Term, negated: _Not, operator: Token, value: Term) -> Expression:
        sign = operator.upper()
        if _quantifies(operand) and sign == "LIKE":
            return _make_quantified(operand, [(sign, _value(value))], negated, False)
        return _unless(negated, Compare(_varying(operand), sign, _value(value)))

    def one_of(self, operand: Term, negated: _Not, *values: Term | None) -> Expression:
        constants = tuple(_value(v) for v in values if v is not None)
        if _quantifies(operand):
            return _make_quantified(operand, [("=", value) for value in constants], negated, True)
        return _unless(negated, OneOf(_varying(operand), constants))

    def in_list(self, operand: Term, negated: _Not, values: Literal) -> Expression:
        if _quantifies(operand):
            reason = "beside ANY and ALL the values of IN stand in parentheses: IN (?, ?)"
            raise StatementError(values.position, reason)
        return _unless(negated, OneOf(_varying(operand), (values,), whole=True))

    def between(self, operand: Term, negated: _Not, low: Term, high: Term) -> Expression:
        ends = ((">=", low), ("<=", high))
        if _quantifies(operand):
            tests = [(s, _row_term(end)) for s, end in ends]
            return _make_quantified(operand, tests, negated, False)
        inside = All(tuple(compared(operand, s, end, end.position) for s, end in ends))
        return _unless(negated, inside)

    def near(self, word: Token, *values: Term | tuple[Term, ...] | None) -> Near:
        """Make NEAR of its terms; a tuple at the end holds those after IN, see ``frame``."""
        names = values[-1] if isinstance(values[-1], tuple) else ()
        terms = [term for term in values if term is not None and not isinstance(term, tuple)]
        if names and len(terms) != NEAR_VALUES[0]:
            reason = f"IN comes after x, y and the radius, not after {len(terms)} values"
            raise StatementError(names[0].position, f"{reason}, as NEAR(2.5, 0, 1.5 IN 'odom')")
        numbers = tuple(map(_value, [*terms, *names]))
        if not NEAR_VALUES[0] <= len(numbers) <= NEAR_VALUES[1]:
            reason = (
                f"NEAR takes 3 to 5 values, not {len(numbers)}: x, y, a radius in metres, a frame "
                "('map' where none is given) and a robot, as NEAR(2.5, 0, 1.5 IN 'odom'); or "
                "latitude, longitude and a radius with its unit, as NEAR(43.47, -80.54, 20m)"
            )
            raise StatementError(_at(word), reason)
        return Near(numbers, _at(word))

    def frame(self, *names: Term) -> tuple[Term, ...]:
        return names

    def event(self, word: Token, name: Term) -> InEvent:
        return InEvent(_value(name), False, _at(word))

    def event_like(self, word: Token, negated: _Not, _like: Token, pattern: Term) -> Expression:
        return _unless(negated, InEvent(_value(pattern), True, _at(word)))

    def is_null(self, operand: Term, negated: _Not) -> Expression:
        return _unless(negated, IsNull(_varying(operand)))


@v_args(inline=True)
class _Builder(_Conditions):
    """Builds statements: the whole syntax tree."""

    def select(
        self,
        distinct: Token | None,
        columns: Token | tuple[Selected, ...],
        topic: tuple[str, int],
        condition: Expression | None,
        group: tuple[Term, ...] | None,
        order: tuple[Ordering, ...] | None,
        limit: Literal | None,
    ) -> tuple[Select, Literal | None]:
        """Return the statement and its LIMIT, which is set when it is bound."""
        selection = None if isinstance(columns, Token) else columns
        order, group = order or (), group or ()
        down = False
        # Rows are read in the order of KEY anyway: that alone needs no sorting.
        if len(order) == 1 and isinstance(order[0].what, KeyOperand) and not group:
            down, order = order[0].descending, ()
        select = Select("", selection, *topic, condition, down, None, distinct is not None)
        return replace(select, group=group, order=order), limit

    def delete(self, topic: tuple[str, int], condition: Expression | None) -> Delete:
        if condition is not None:
            return Delete("", *topic, condition)
        reason = "DELETE takes a condition: WHERE KEY < …, say; every message of a topic is removed"
        raise StatementError(topic[1], f"{reason} by TRUNCATE")

    def truncate(self, topic: tuple[str, int]) -> Truncate:
        return Truncate("", *topic)

    def create_index(
        self, unless: object | None, name: IndexName | None, indexed: Indexed
    ) -> CreateIndex:
        return CreateIndex("", indexed, name, unless is not None)

    def drop_index(self, condition: object | None, index: IndexName | Indexed) -> DropIndex:
        return DropIndex("", index, condition is not None)

    def index_name(self, token: Token) -> IndexName:
        # As in CQL, an unquoted name is in lower case.
        return IndexName(_name(token) if token.type == "QUOTED" else token.lower(), _at(token))

    def indexed(self, topic: tuple[str, int], field: Operand) -> Indexed:
        if not isinstance(field, FieldPath):
            raise StatementError(field.position, f"{field.text} needs no index: rows lie by it")
        for path_part in field.parts:
            if path_part.index is not None:
                reason = f"an index is on all elements of an array: leave [{path_part.index}] out"
                raise StatementError(path_part.position, reason)
        return Indexed(*topic, field)

    def selected(self, *columns: Selected) -> tuple[Selected, ...]:
        return columns

    def column(self, what: Term, alias: Token | None) -> Selected:
        return Selected(_column(what), None if alias is None else _name(alias))

    def topic(self, token: Token) -> tuple[str, int]:
        return _name(token), _at(token)

    def group(self, *terms: Term) -> tuple[Term, ...]:
        return tuple(_row_term(term) for term in terms)

    def order(self, *parts: Ordering) -> tuple[Ordering, ...]:
        return parts

    def ordering(self, what: Term, direction: Token | None) -> Ordering:
        down = direction is not None and direction.type == "DESC"
        return Ordering(_column(what), down, what.position)


_OWN = {kind.text: kind for kind in (KeyOperand, NodeOperand, RunOperand)}
"""Operands by their words."""


def _at(token: Token) -> int:
    return token.start_pos or 0


def _unless(negated: _Not, item: Expression) -> Expression:
    return item if negated is None else Negation(item)


def _name(token: Token) -> str:
    return token[1:-1].replace('""', '"') if token.type == "QUOTED" else str(token)


def _integer(token: Token) -> int:
    if len(token) > MAX_DIGITS:
        raise StatementError(_at(token), f"a number has at most {MAX_DIGITS} digits")
    return int(token)


def _duration(token: Token) -> DurationNs:
    if len(token) > MAX_DIGITS:
        raise StatementError(_at(token), f"a duration has at most {MAX_DIGITS} digits")
    terms = (Decimal(number) * DURATION_UNITS_NS[unit] for number, unit in _UNIT.findall(token))
    with localcontext() as context:
        context.prec = MAX_DIGITS + 20
        ns = int(sum(terms, Decimal()).to_integral_value())
    return DurationNs(-ns if token.startswith("-") else ns)


_UNIT = re.compile(r"([0-9.]+)([a-z]+)")


def _call(function: str, arguments: tuple[Term, ...], position: int) -> Call:
    """Return a call of one or more terms; StatementError: it is nested too deeply."""
    if function not in QUANTIFIERS:
        arguments = tuple(map(_row_term, arguments))
    depth = 1 + max(argument.depth if isinstance(argument, Call) else 0 for argument in arguments)
    if depth > MAX_DEPTH:
        raise StatementError(position, f"what is computed is nested deeper than {MAX_DEPTH}")
    return Call(function, arguments, position, depth)


def _quantifies(term: Term) -> bool:
    return isinstance(term, Call) and term.function in QUANTIFIERS


def _row_term(term: Term) -> Term:
    """Return a term that has a value in a row; StatementError: it is ANY, ALL or count."""
    if not isinstance(term, Call):
        return term
    if term.function in QUANTIFIERS:
        word = term.function.upper()
        reason = f"stands alone on one side of a comparison, as {word}(ranges) < 0.2"
        raise StatementError(term.position, f"{word}({term.arguments[0].text}) {reason}")
    if term.function == "count":
        name = term.arguments[0].text if term.arguments else "*"
        reason = f"count({name}) is made of all rows, so it stands alone in SELECT and ORDER BY: "
        reason += "select it, and compare or compute in a second statement"
        raise StatementError(term.position, reason)
    return term


def _varying(term: Term) -> Term:
    """Return a term whose value differs from row to row, else raise StatementError."""
    term = _row_term(term)
    if is_constant(term):
        reason = "names no field: it is the same for each message"
        raise StatementError(term.position, f"{term.text} {reason}")
    return term


def _column(term: Term) -> Term | Aggregate:
    """Return the term or aggregate of a column of a result."""
    if isinstance(term, Call) and term.function in AGGREGATES:
        operand = _row_term(term.arguments[0]) if term.arguments else None
        return Aggregate(term.function, operand, term.position)
    return _row_term(term)


def _value(term: Term) -> Literal:
    """Return a constant as a Literal, else raise StatementError.

    A call of constants is computed when the parameters are bound.
    """
    if isinstance(term, Literal):
        return term
    if isinstance(term, Call) and is_constant(_row_term(term)):
        return Literal(None, term.position, bound=False, made=term)
    reason = f"{_row_term(term).text} differs from row to row, but here a constant is needed; "
    raise StatementError(term.position, f"{reason}text stands in quotes: 'text'")


_FLIPPED = {"=": "=", "!=": "!=", "<": ">", "<=": ">=", ">": "<", ">=": "<="}


def compared(left: Term, sign: str, right: Term, position: int) -> Expression:
    """Return the comparison of two terms by =, !=, <, <=, > or >=.

    If only one of them is a constant, it becomes the right operand; ANY and ALL the left one.
    """
    if _quantifies(right) and not _quantifies(left):
        left, sign, right = right, _FLIPPED[sign], left
    if _quantifies(left):
        return _make_quantified(left, [(sign, _row_term(right))], None, False)
    left, right = _row_term(left), _row_term(right)
    if isinstance(right, FieldPath) and right.text.lower() == "null":
        reason = "found 'null' (what is missing is found by IS NULL)"
        raise StatementError(right.position, reason)
    if is_constant(right):
        if is_constant(left):
            reason = "names no field, and the other operand names no field either"
            raise StatementError(left.position, f"{left.text} {reason}")
        return Compare(left, sign, _value(right))
    if is_constant(left):
        return Compare(right, _FLIPPED[sign], _value(left))
    return Relate(left, sign, right, position)


def _make_quantified(
    term: Term, tests: Sequence[tuple[str, Term]], negated: _Not, either: bool
) -> Expression:
    """Return the condition of ANY or ALL, whose call is ``term``; the others as in Quantified."""
    if not isinstance(term, Call) or not isinstance(term.arguments[0], FieldPath):
        raise AssertionError("the grammar lets nothing else through")
    every, array = term.function == "all", term.arguments[0]
    compares = [(sign, _value(other) if is_constant(other) else other) for sign, other in tests]
    sign, first = compares[0] if compares else ("", None)
    if sign == "=" and len(compares) == 1 and isinstance(first, Literal) and not (every or negated):
        # Equivalent, and the planner can use it more often.
        return Compare(array, "CONTAINS", first)
    return Quantified(array, every, tuple(compares), term.position, either, negated is not None)
