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
    Iterator,
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
    Placeholder,
    Select,
    Selected,
    StatementError,
    Truncate,
    Value,
    given,
    leaves,
    parts,
)

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
_KEPT_KEYWORDS = {"ASC", "DESC", "TABLE", "NOT", "LIKE", "CONTAINS"}
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
        columns: Optional[tuple[Selected, ...]],
        topic: tuple[str, int],
        condition: Optional[Expression],
        descending: Optional[bool],
        limit: Optional[Value],
    ) -> tuple[Select, Optional[Value]]:
        return Select("", columns, *topic, condition, bool(descending)), limit

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

    def if_exists(self, *_not: Token) -> bool:
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

    def everything(self, _star: Token) -> None:
        return None

    def selected(self, *columns: Selected) -> tuple[Selected, ...]:
        one = [c.what for c in columns if isinstance(c.what, Aggregate)]
        many = [c.what for c in columns if not isinstance(c.what, Aggregate)]
        if one and many:
            raise StatementError(
                one[0].position,
                f"{one[0].text} is one value made of all rows: it stands alone or beside other "
                f"aggregates, not beside {many[0].text}",
            )
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

    def limit(self, count: Union[Token, Placeholder]) -> Value:
        return Literal(_integer(count), _at(count)) if isinstance(count, Token) else count

    def either(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else _shallow(Either(items), items)

    def all(self, *items: Expression) -> Expression:
        return items[0] if len(items) == 1 else _shallow(All(items), items)

    def negate(self, _not: Token, item: Expression) -> Expression:
        return _shallow(Negation(item), (item,))

    def compare(self, operand: Operand, operator: Token, value: Value) -> Compare:
        return Compare(operand, "!=" if operator == "<>" else str(operator), value)

    def match(self, operand: Operand, negated: _Not, operator: Token, value: Value) -> Expression:
        return _unless(negated, Compare(operand, operator.upper(), value))

    def one_of(self, operand: Operand, negated: _Not, *values: Optional[Value]) -> Expression:
        return _unless(negated, OneOf(operand, tuple(v for v in values if v is not None)))

    def in_list(self, operand: Operand, negated: _Not, values: Placeholder) -> Expression:
        return _unless(negated, OneOf(operand, (values,), whole=True))

    def between(self, operand: Operand, negated: _Not, low: Value, high: Value) -> Expression:
        inside = All((Compare(operand, ">=", low), Compare(operand, "<=", high)))
        return _unless(negated, inside)

    def is_null(self, operand: Operand, negated: _Not) -> Expression:
        return _unless(negated, IsNull(operand))

    def aggregate_as_condition(self, found: Aggregate) -> Operand:
        raise StatementError(
            found.position,
            f"{found.text} is made of the rows that satisfy the condition, so it cannot stand in "
            "it; select it, and compare its value in a second statement",
        )

    def key(self, token: Token) -> KeyOperand:
        return KeyOperand(_at(token))

    def node(self, token: Token) -> NodeOperand:
        return NodeOperand(_at(token))

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


def _unless(negated: _Not, item: Expression) -> Expression:
    return item if negated is None else Negation(item)


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
    """Parse a statement and bind its parameters.

    Args:
        text: The statement.
        params: A value for each ``?`` or ``%s``, in their order.

    Raises:
        InvalidQuery: The text is no statement, or the parameters do not fit.
    """
    found = _parse(text, "statement")
    parsed: Union[Select, Change]
    parsed, limit = found if isinstance(found, tuple) else (found, None)
    if not isinstance(parsed, (Select, Delete)):
        _Binding(text, params)
        return replace(parsed, text=text)
    bound = _Binding(text, params, parsed.condition, limit)
    if isinstance(parsed, Delete):
        return replace(parsed, text=text, condition=bound.expression(parsed.condition))
    condition = parsed.condition and bound.expression(parsed.condition)
    most = limit and _limit(text, bound.value(limit))
    return replace(parsed, text=text, condition=condition, limit=most)


def parse_select(text: str, params: Sequence[object] = ()) -> Select:
    """Parse a statement that gives rows and changes nothing, as parse_statement does.

    Raises:
        InvalidQuery: As there; or it is another statement than SELECT.
    """
    statement = parse_statement(text, params)
    if isinstance(statement, Select):
        return statement
    raise InvalidQuery(
        text,
        len(text) - len(text.lstrip()),
        "this changes what is stored; here only SELECT can be asked, and executeCQL runs the "
        "others",
    )


def parse_condition(text: str, params: Sequence[object] = ()) -> Expression:
    """Parse a condition, what stands behind WHERE, and bind its parameters.

    Raises:
        InvalidQuery: The text is no condition, or the parameters do not fit.
    """
    found: Expression = _parse(text, "lone_condition")
    return _Binding(text, params, found).expression(found)


class _Binding:
    """Puts the values of parameters where their placeholders stand.

    Args:
        text: The statement.
        params: The values.
        condition, limit: The clauses in which placeholders may stand.
    """

    def __init__(
        self,
        text: str,
        params: Sequence[object],
        condition: Optional[Expression] = None,
        limit: Optional[Value] = None,
    ) -> None:
        values = [value for leaf in leaves(condition) for value in given(leaf)]
        if limit is not None:
            values.append(limit)
        found = sorted(value.position for value in values if isinstance(value, Placeholder))
        _check_params(text, found, params)
        if len(found) != len(params):
            at = found[len(params)] if len(params) < len(found) else len(text)
            raise InvalidQuery(
                text, at, f"the statement has {len(found)} parameters, {len(params)} were given"
            )
        self._text = text
        self._values = dict(zip(found, params))

    def expression(self, item: Expression) -> Expression:
        if isinstance(item, Compare):
            return replace(item, value=self.value(item.value))
        if isinstance(item, OneOf):
            return OneOf(item.operand, tuple(self._listed(item)))
        if isinstance(item, IsNull):
            return item
        if isinstance(item, Negation):
            return Negation(self.expression(item.item))
        return replace(item, items=tuple(self.expression(part) for part in item.items))

    def value(self, value: Value) -> Literal:
        if isinstance(value, Literal):
            return value
        return Literal(self._values[value.position], value.position)

    def _listed(self, item: OneOf) -> Iterator[Literal]:
        values = [self.value(value) for value in item.values]
        if not item.whole:
            yield from values
            return
        (whole,) = values
        if not isinstance(whole.value, (list, tuple, set, frozenset)):
            raise InvalidQuery(self._text, whole.position, "IN ? takes a list as its value")
        for element in whole.value:
            yield Literal(element, whole.position)


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
        return _grammar().parse(text, start=start)
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None
    except UnexpectedInput as exc:
        raise InvalidQuery(text, *_explain(text, exc)) from None


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
