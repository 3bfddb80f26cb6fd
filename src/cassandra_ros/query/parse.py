# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements and conditions from text. Whatever the text: a tree, or InvalidQuery."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache
from numbers import Integral
from typing import (
    AbstractSet,
    Any,
    Collection,
    Iterable,
    Mapping,
    Optional,
    Sequence,
    Union,
)

from lark import Lark, Token, Transformer, UnexpectedInput, v_args
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from cassandra_ros.arguments import MAX_LIMIT
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.names import nearest
from cassandra_ros.query.syntax import (
    Aggregate,
    All,
    Change,
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
    KeyOperand,
    Literal,
    Negation,
    NodeOperand,
    OneOf,
    Operand,
    Part,
    Path,
    RunOperand,
    Select,
    Selected,
    StatementError,
    Truncate,
    given,
    leaves,
    parts,
)

SHORT_TEXT = 1000
"""Texts up to here are not parsed twice."""
MAX_STATEMENT = 1 << 20

_WORDS = {
    "NAME": "a field",
    "TOPIC": "a topic",
    "STAR": "*",
    "OPERATOR": "one of = != < <= > >=",
    "NUMBER": "a number",
    "INTEGER": "a whole number",
    "TEXT": "'text'",
    "PLACEHOLDER": "?",
    "LPAR": "'('",
    "RPAR": "')'",
    "LSQB": "'['",
    "RSQB": "']'",
    "COMMA": "','",
    "DOT": "'.'",
    "$END": "the end",
}
_KEPT_KEYWORDS = {"ASC", "DESC", "NOT", "LIKE", "CONTAINS"}
"""Those that the grammar leaves in the tree; the names of the others begin with '_'."""
_UNSAID = {"QUOTED", "_END", "FUNCTION", "TRUE", "FALSE"}
_NEVER_CHANGED = (
    "messages are never changed: addData and the recorder store new ones, DELETE removes them"
)
_INSTEAD = {
    "INSERT": _NEVER_CHANGED,
    "UPDATE": _NEVER_CHANGED,
    "ALTER": "renameTopic and setMeta change what is known of a topic",
    "USE": "connectToKeyspace chooses the keyspace",
    "CREATE TABLE": "addTopic makes a topic",
    "CREATE KEYSPACE": "connectToKeyspace makes a keyspace where it is missing",
    "DROP TABLE": "removeTopic removes a topic, TRUNCATE its messages",
}
"""What does here what other words do in CQL."""
_Not = Optional[Token]
MAX_DEPTH = 100
MAX_DIGITS = 400
"""Of a number: Python converts longer ones in quadratic time, or refuses."""


@v_args(inline=True)
class _Builder(Transformer):  # type: ignore[type-arg]
    """One method per rule of the grammar, called while lark parses."""

    def select(
        self,
        columns: Union[Token, tuple[Selected, ...]],
        topic: tuple[str, int],
        condition: Optional[Expression],
        descending: Optional[bool],
        limit: Optional[Literal],
    ) -> tuple[Select, Optional[Literal]]:
        shown = None if isinstance(columns, Token) else columns
        return Select("", shown, *topic, condition, bool(descending)), limit

    def delete(self, topic: tuple[str, int], condition: Optional[Expression]) -> Delete:
        if condition is not None:
            return Delete("", *topic, condition)
        reason = "DELETE takes a condition: WHERE KEY < …, say; every message of a topic is removed"
        raise StatementError(topic[1], f"{reason} by TRUNCATE")

    def truncate(self, topic: tuple[str, int]) -> Truncate:
        return Truncate("", *topic)

    def create_index(
        self, unless: Optional[object], name: Optional[IndexName], indexed: Indexed
    ) -> CreateIndex:
        return CreateIndex("", indexed, name, unless is not None)

    def drop_index(
        self, condition: Optional[object], index: Union[IndexName, Indexed]
    ) -> DropIndex:
        return DropIndex("", index, condition is not None)

    def index_name(self, token: Token) -> IndexName:
        # As CQL has it.
        return IndexName(_name(token) if token.type == "QUOTED" else token.lower(), _at(token))

    def indexed(self, topic: tuple[str, int], field: Operand) -> Indexed:
        if not isinstance(field, Path):
            raise StatementError(field.position, f"{field.text} needs no index: rows lie by it")
        for part in field.parts:
            if part.index is not None:
                reason = f"an index is on all elements of an array: leave [{part.index}] out"
                raise StatementError(part.position, reason)
        return Indexed(*topic, field)

    def selected(self, *columns: Selected) -> tuple[Selected, ...]:
        one = [c.what for c in columns if isinstance(c.what, Aggregate)]
        many = [c.what for c in columns if not isinstance(c.what, Aggregate)]
        if one and many:
            reason = "is one value made of all rows: it stands alone or beside other aggregates, "
            reason += f"not beside {many[0].text}"
            raise StatementError(one[0].position, f"{one[0].text} {reason}")
        return columns

    def column(self, what: Union[Operand, Aggregate], alias: Optional[Token]) -> Selected:
        return Selected(what, None if alias is None else _name(alias))

    def aggregate(self, word: Token, operand: Union[Token, Operand]) -> Aggregate:
        function = word.lower()
        if not isinstance(operand, Token):
            return Aggregate(function, operand, _at(word))
        if function != "count":
            raise StatementError(_at(operand), f"{function} takes one field; only count takes *")
        return Aggregate(function, None, _at(word))

    def topic(self, token: Token) -> tuple[str, int]:
        return _name(token), _at(token)

    def order(self, _key: Token, direction: Optional[Token]) -> bool:
        return direction is not None and direction.type == "DESC"

    def where(self, condition: Expression) -> Expression:
        """Refuse what is nested so deep that walking it would overflow the stack."""
        level, depth = [condition], 1
        while level:
            if depth > MAX_DEPTH:
                raise StatementError(0, f"the condition is nested deeper than {MAX_DEPTH}")
            level, depth = [part for item in level for part in parts(item)], depth + 1
        return condition

    def either(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else Either(items)

    def all(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else All(items)

    def negate(self, _not: Token, item: Expression) -> Negation:
        return Negation(item)

    def compare(self, operand: Operand, operator: Token, value: Literal) -> Compare:
        return Compare(operand, "!=" if operator == "<>" else str(operator), value)

    def match(self, operand: Operand, negated: _Not, operator: Token, value: Literal) -> Expression:
        return _unless(negated, Compare(operand, operator.upper(), value))

    def one_of(self, operand: Operand, negated: _Not, *values: Optional[Literal]) -> Expression:
        return _unless(negated, OneOf(operand, tuple(v for v in values if v is not None)))

    def in_list(self, operand: Operand, negated: _Not, values: Literal) -> Expression:
        return _unless(negated, OneOf(operand, (values,), whole=True))

    def between(self, operand: Operand, negated: _Not, low: Literal, high: Literal) -> Expression:
        inside = All((Compare(operand, ">=", low), Compare(operand, "<=", high)))
        return _unless(negated, inside)

    def is_null(self, operand: Operand, negated: _Not) -> Expression:
        return _unless(negated, IsNull(operand))

    def aggregate_as_condition(self, found: Aggregate) -> Operand:
        reason = "is made of the rows that satisfy the condition, so it cannot stand in it; "
        reason += "select it, and compare its value in a second statement"
        raise StatementError(found.position, f"{found.text} {reason}")

    def place(self, token: Token) -> Operand:
        return _OWN[str(token)](_at(token))

    def path(self, *parts: tuple[Part, ...]) -> Path:
        names = tuple(name for part in parts for name in part)
        return Path(names, names[0].position)

    def part(self, token: Token, index: Optional[Token]) -> tuple[Part, ...]:
        names = _name(token).split(".") if token.type == "QUOTED" else [str(token)]
        made = [Part(name, None, _at(token)) for name in names]
        if index is not None:
            made[-1] = Part(names[-1], _integer(index), _at(token))
        return tuple(made)

    def literal(self, token: Token) -> Literal:
        if token.type == "PLACEHOLDER":
            return Literal(None, _at(token), bound=False)
        if token.type in ("TRUE", "FALSE"):
            return Literal(token.type == "TRUE", _at(token))
        if token.type == "TEXT":
            return Literal(token[1:-1].replace("''", "'"), _at(token))
        whole = token.lstrip("+-").isdigit()
        return Literal(_integer(token) if whole else DecimalText(str(token)), _at(token))


_OWN = {kind.text: kind for kind in (KeyOperand, NodeOperand, RunOperand)}


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


@lru_cache(maxsize=1)
def _grammar() -> Lark:
    return Lark.open(
        "cql.lark",
        rel_to=__file__,
        parser="lalr",
        start=["statement", "lone_condition"],
        transformer=_Builder(),  # holds no state, so threads may share it
    )


def parse_statement(text: str, params: Sequence[object] = ()) -> Union[Select, Change]:
    """Parse a statement and bind its parameters: a value for each ``?`` or ``%s``, in their order.

    Raises:
        InvalidQuery: The text is no statement, or the parameters do not fit.
    """
    found = _parse(text, "statement")
    parsed, limit = found if isinstance(found, tuple) else (found, None)
    bound = _Binding(text, params, getattr(parsed, "condition", None), limit)
    if isinstance(parsed, (Select, Delete)) and parsed.condition is not None:
        parsed = replace(parsed, condition=bound.expression(parsed.condition))
    if limit is not None:
        parsed = replace(parsed, limit=_limit(text, bound.value(limit)))
    statement: Union[Select, Change] = replace(parsed, text=text)
    return statement


def parse_select(text: str, params: Sequence[object] = ()) -> Select:
    """Parse a statement that gives rows and changes nothing, as parse_statement does.

    Raises:
        InvalidQuery: As there; or it is another statement than SELECT.
    """
    statement = parse_statement(text, params)
    if isinstance(statement, Select):
        return statement
    reason = "this changes what is stored; here only SELECT can be asked, and executeCQL runs "
    raise InvalidQuery(text, len(text) - len(text.lstrip()), f"{reason}the others")


def parse_condition(text: str, params: Sequence[object] = ()) -> Expression:
    """Parse a condition, what stands behind WHERE, and bind its parameters.

    Raises:
        InvalidQuery: The text is no condition, or the parameters do not fit.
    """
    found: Expression = _parse(text, "lone_condition")
    return _Binding(text, params, found).expression(found)


class _Binding:
    """Puts the values of parameters where their placeholders stand, in condition and limit."""

    def __init__(
        self,
        text: str,
        params: Sequence[object],
        condition: Optional[Expression],
        limit: Optional[Literal] = None,
    ) -> None:
        values = [value for leaf in leaves(condition) for value in given(leaf)]
        values += [] if limit is None else [limit]
        found = sorted(value.position for value in values if not value.bound)
        _check_params(text, found, params)
        if len(found) != len(params):
            at = found[len(params)] if len(params) < len(found) else len(text)
            reason = f"the statement has {len(found)} parameters, {len(params)} were given"
            raise InvalidQuery(text, at, reason)
        self._text = text
        self._values = dict(zip(found, params))

    def expression(self, item: Expression) -> Expression:
        if isinstance(item, Compare):
            return replace(item, value=self.value(item.value))
        if isinstance(item, OneOf):
            values = tuple(map(self.value, item.values))
            return OneOf(item.operand, self._elements(*values) if item.whole else values)
        if isinstance(item, IsNull):
            return item
        if isinstance(item, Negation):
            return Negation(self.expression(item.item))
        return replace(item, items=tuple(map(self.expression, item.items)))

    def value(self, value: Literal) -> Literal:
        at = value.position
        return value if value.bound else Literal(self._values[at], at)

    def _elements(self, whole: Literal) -> tuple[Literal, ...]:
        if not isinstance(whole.value, (list, tuple, set, frozenset)):
            raise InvalidQuery(self._text, whole.position, "IN ? takes a list as its value")
        return tuple(Literal(element, whole.position) for element in whole.value)


def _check_params(text: str, found: Sequence[int], params: object) -> None:
    unordered = (str, bytes, Mapping, AbstractSet)
    if isinstance(params, Collection) and not isinstance(params, unordered):
        return
    if isinstance(params, (str, bytes)) or not isinstance(params, Iterable):
        reason = f"one value: give [{params!r:.80}]"
    else:
        reason = f"a {type(params).__name__}"
    reason = f"the parameters are a list of values in the order of their ?, not {reason}"
    raise InvalidQuery(text, min(found, default=0), reason)


def _limit(text: str, most: Literal) -> int:
    whole = isinstance(most.value, Integral) and not isinstance(most.value, bool)
    if not whole or not 1 <= most.value <= MAX_LIMIT:
        reason = f"LIMIT takes a whole number of at least 1 and at most {MAX_LIMIT}"
        raise InvalidQuery(text, most.position, reason)
    return int(most.value)


def _parse(text: str, start: str) -> Any:
    if not isinstance(text, str):
        raise InvalidQuery(f"{text!r:.200}", 0, f"a statement is text, not {type(text).__name__}")
    if len(text) > MAX_STATEMENT:
        raise InvalidQuery(text[:200], 0, f"a statement has at most {MAX_STATEMENT} characters")
    try:
        return (_parsed_before if len(text) <= SHORT_TEXT else _parsed)(text, start)
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None
    except UnexpectedInput as exc:
        raise InvalidQuery(text, *_explain(text, exc)) from None


def _parsed(text: str, start: str) -> Any:
    return _grammar().parse(text, start=start)


_parsed_before = lru_cache(maxsize=256)(_parsed)  # a tree is never changed


def _explain(text: str, error: UnexpectedInput) -> tuple[int, str]:
    """Return where a text went wrong, and what would have been right."""
    expected: set[str] = set()
    position = len(text)
    if isinstance(error, UnexpectedCharacters):
        position, expected = error.pos_in_stream or 0, set(error.allowed or ())
    elif isinstance(error, UnexpectedToken):
        expected = set(error.accepts or error.expected or ())
        if error.token.type != "$END":
            position = error.token.start_pos or 0
    last = (getattr(error, "token_history", None) or [None])[-1]
    previous = "" if last is None else last.type
    found = _word(text[position:])
    if found[:1] in "'\"" and found and text.count(found[0], position) == 1:
        return position, f"the quote {found[0]} is not closed"
    if text.startswith("/*", position):
        return position, "the comment /* is not closed"
    keywords = [
        name.lstrip("_")
        for name in expected - {"_END"}
        if name.startswith("_") or name in _KEPT_KEYWORDS
    ]
    shown = f"found {found!r}" if found else "the statement ends here"
    words = {**_WORDS, "NAME": "a name"} if "_ON" in expected else _WORDS
    wanted = ", ".join(sorted(words.get(name, name.lstrip("_")) for name in expected - _UNSAID))
    hint = _hint(text[:position], found, expected, previous) or nearest(found, keywords)
    return position, f"{shown}{hint}; expected {wanted or 'something else'}"


def _hint(before: str, found: str, expected: set[str], previous: str) -> str:
    """Return ' (…)' about a mistake that is known, or ''.

    ``found`` stands behind ``before`` and the token ``previous`` ('' = unknown), not ``expected``.
    """
    words = f"{before} {found}".upper().split()
    instead = _INSTEAD.get(" ".join(words)) if expected & {"_SELECT", "_INDEX"} else None
    if instead:
        return f" ({instead})"
    if previous == "_DELETE":
        return " (messages are removed whole: DELETE FROM topic WHERE …)"
    if previous == "STAR" and found == ",":
        return " (* stands alone: it gives KEY and every field)"
    if found == "(" and "_FROM" in expected:
        return " (the functions are count, min, max, sum and avg)"
    if found.upper() == "NULL" and "NUMBER" in expected:
        return " (what is missing is found by IS NULL)"
    return ""


def _word(text: str) -> str:
    """The first word of a text, or its first sign; at most 40 characters."""
    found = re.match(r"[\w/]{1,40}", text)
    return found.group() if found else text[:1]
