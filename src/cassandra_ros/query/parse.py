# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements and conditions from text. Whatever the text: a tree, or InvalidQuery."""

from __future__ import annotations

import difflib
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

from lark import Lark, UnexpectedInput
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from cassandra_ros.arguments import MAX_LIMIT
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.builder import BUILDER, Parsed, StatementError
from cassandra_ros.query.syntax import (
    Change,
    Compare,
    Delete,
    Expression,
    IsNull,
    Leaf,
    Literal,
    Negation,
    OneOf,
    Placeholder,
    Select,
    Value,
    given,
    leaves,
)

MAX_STATEMENT = 1 << 20

_WORDS = {
    "NAME": "a field",
    "TOPIC": "a topic",
    "STAR": "*",
    "KEY": "KEY",
    "NODE": "NODE",
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


@lru_cache(maxsize=1)
def _grammar() -> Lark:
    return Lark.open(
        "cql.lark",
        rel_to=__file__,
        parser="lalr",
        start=["statement", "lone_condition"],
        transformer=BUILDER,
    )


def parseStatement(text: str, params: Sequence[Any] = ()) -> Union[Select, Change]:
    """Parse a statement and bind its parameters.

    Args:
        text: The statement.
        params: A value for each ``?`` or ``%s``, in their order.

    Raises:
        InvalidQuery: The text is no statement, or the parameters do not fit.
    """
    parsed: Union[Parsed, Change] = _parse(text, "statement")
    if isinstance(parsed, Parsed):
        return _select(text, parsed, params)
    if isinstance(parsed, Delete):
        condition = _boundCondition(text, parsed.condition, params)
        return replace(parsed, text=text, condition=condition)
    _Binding(text, [], params)
    return replace(parsed, text=text)


def parseSelect(text: str, params: Sequence[Any] = ()) -> Select:
    """Parse a statement that gives rows and changes nothing, as parseStatement does.

    Raises:
        InvalidQuery: As there; or it is another statement than SELECT.
    """
    statement = parseStatement(text, params)
    if isinstance(statement, Select):
        return statement
    raise InvalidQuery(
        text,
        len(text) - len(text.lstrip()),
        "this changes what is stored; here only SELECT can be asked, and executeCQL runs the "
        "others",
    )


def _select(text: str, parsed: Parsed, params: Sequence[Any]) -> Select:
    values = list(leaves(parsed.condition))
    binding = _Binding(text, [*_placeholders(values), *_of_limit(parsed.limit)], params)
    return Select(
        text=text,
        columns=parsed.columns,
        topic=parsed.topic,
        topic_position=parsed.topic_position,
        condition=None if parsed.condition is None else binding.expression(parsed.condition),
        descending=parsed.descending,
        limit=None if parsed.limit is None else _limit(text, binding.value(parsed.limit)),
    )


def parseCondition(text: str, params: Sequence[Any] = ()) -> Expression:
    """Parse a condition, what stands behind WHERE, and bind its parameters.

    Raises:
        InvalidQuery: The text is no condition, or the parameters do not fit.
    """
    return _boundCondition(text, _parse(text, "lone_condition"), params)


def _boundCondition(text: str, found: Expression, params: Sequence[Any]) -> Expression:
    binding = _Binding(text, list(_placeholders(list(leaves(found)))), params)
    return binding.expression(found)


def nearest(name: str, known: Sequence[str]) -> str:
    """Return ' (did you mean …?)' with the names most like one, or '' where none is."""
    lowered = {other.lower(): other for other in known}
    close = difflib.get_close_matches(name.lower(), lowered, n=3, cutoff=0.6)
    longer = [other for other in lowered if len(name) > 1 and other.startswith(name.lower())]
    return meant([lowered[other] for other in dict.fromkeys(close + longer)])


def meant(names: Sequence[str]) -> str:
    """Return ' (did you mean …?)' with up to three names, or '' where there are none."""
    return f" (did you mean {' or '.join(names[:3])}?)" if names else ""


class _Binding:
    """Puts the values of parameters where their placeholders stand."""

    def __init__(self, text: str, found: list[Placeholder], params: Sequence[Any]) -> None:
        _check_params(text, found, params)
        if len(found) != len(params):
            ordered = sorted(p.position for p in found)
            at = ordered[len(params)] if len(params) < len(found) else len(text)
            raise InvalidQuery(
                text, at, f"the statement has {len(found)} parameters, {len(params)} were given"
            )
        ordered = sorted(p.position for p in found)
        self._text = text
        self._values = dict(zip(ordered, params))

    def expression(self, item: Expression) -> Expression:
        if isinstance(item, Compare):
            return Compare(item.operand, item.operator, self.value(item.value))
        if isinstance(item, OneOf):
            return OneOf(item.operand, tuple(self._listed(item)))
        if isinstance(item, IsNull):
            return item
        if isinstance(item, Negation):
            return Negation(self.expression(item.item))
        return type(item)(tuple(self.expression(part) for part in item.items))

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


def _check_params(text: str, found: list[Placeholder], params: Any) -> None:
    unordered = (str, bytes, Mapping, AbstractSet)
    if isinstance(params, Collection) and not isinstance(params, unordered):
        return
    if isinstance(params, (str, bytes)) or not isinstance(params, Iterable):
        reason = f"one value: give [{params!r:.80}]"
    else:
        reason = f"a {type(params).__name__}"
    at = min((placeholder.position for placeholder in found), default=0)
    reason = f"the parameters are a list of values in the order of their ?, not {reason}"
    raise InvalidQuery(text, at, reason)


def _placeholders(comparisons: list[Leaf]) -> Iterator[Placeholder]:
    for item in comparisons:
        yield from (value for value in given(item) if isinstance(value, Placeholder))


def _of_limit(limit: Optional[Value]) -> list[Placeholder]:
    return [limit] if isinstance(limit, Placeholder) else []


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
    found = _word_at(text, position)
    if found[:1] in "'\"" and found and text.count(found[0], position) == 1:
        return position, f"the quote {found[0]} is not closed"
    if text.startswith("/*", position):
        return position, "the comment /* is not closed"
    keywords = [name.lstrip("_") for name in expected if _is_keyword(name)]
    shown = f"found {found!r}" if found else "the statement ends here"
    words = {**_WORDS, "NAME": "a name"} if "_ON" in expected else _WORDS
    wanted = ", ".join(sorted(words.get(name, name.lstrip("_")) for name in expected - _UNSAID))
    hint = _hint(text[:position], found, expected, previous) or nearest(found, keywords)
    return position, f"{shown}{hint}; expected {wanted or 'something else'}"


def _hint(before: str, found: str, expected: set[str], previous: str) -> str:
    """Return ' (…)' about a mistake that is known, or ''.

    Args:
        before: The statement as far as it is right.
        found: The word that is wrong.
        expected: The tokens that could stand there.
        previous: The token before it; '' where that is not known.
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


def _is_keyword(name: str) -> bool:
    return name.startswith("_") and name != "_END" or name in ("ASC", "DESC", "TABLE")


def _word_at(text: str, position: int) -> str:
    end = position
    while end < len(text) and (text[end].isalnum() or text[end] in "_/"):
        end += 1
    return text[position : max(end, position + 1)][:40]
