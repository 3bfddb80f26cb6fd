# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parser of statements and conditions: a text and its parameters become a tree, or InvalidQuery."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from numbers import Integral
from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
    cast,
)

from cassandra_ros.arguments import MAX_LIMIT, plain_value
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.tree.expressions import fold
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.query.tree.syntax import (
    FUNCTIONS,
    LEAVES,
    Aggregate,
    Call,
    Change,
    Compare,
    Delete,
    Expression,
    InEvent,
    IsNull,
    Leaf,
    Literal,
    Near,
    Negation,
    OneOf,
    Quantified,
    Relate,
    Select,
    StatementError,
    Term,
    TimeNs,
    inside,
    leaves,
    terms_of,
)

if TYPE_CHECKING:
    from lark import UnexpectedInput

SHORT_TEXT = 1000
"""Maximum length of a text whose tree is cached, characters."""
MAX_STATEMENT = 1 << 20
"""Maximum length of a statement, characters."""

_WORDS = {
    "NAME": "a field",
    "TOPIC": "a topic",
    "STAR": "*",
    "OPERATOR": "one of = != < <= > >=",
    "NUMBER": "a number",
    "DURATION": "a duration",
    "PLUS": "+",
    "MINUS": "-",
    "SLASH": "/",
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
"""Tokens in the words of error texts; other tokens are shown by their names."""
_KEPT_KEYWORDS = {"ASC", "DESC", "NOT", "LIKE", "CONTAINS"}
"""Keywords that stay in the tree; the grammar's names of all other keywords begin with '_'."""
_UNSAID = {"QUOTED", "_END", "FUNCTION", "NEAR", "EVENT", "TRUE", "FALSE"}
"""Tokens that error texts leave out, to stay short."""
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
"""What to use instead of CQL statements that this language lacks."""


def parse_statement(text: str, params: Sequence[object] = ()) -> Select | Change:
    """Parse a statement and bind its parameters, one value for each ``?`` or ``%s``, in order.

    Raises:
        InvalidQuery: The text is not a statement, or the parameters do not fit.
    """
    tree = _parse(text, "statement")
    statement, limit = tree if isinstance(tree, tuple) else (tree, None)
    terms = chain(terms_of_statement(statement), [] if limit is None else [limit])
    bound = Binding(text, params, terms)
    try:
        if isinstance(statement, Select):
            statement = bound.select(statement)
        elif isinstance(statement, Delete):
            statement = replace(statement, condition=bound.expression(statement.condition))
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None
    if limit is not None:
        statement = replace(statement, limit=_limit(text, bound.value(limit)))
    result: Select | Change = replace(statement, text=text)
    return result


def parse_select(text: str, params: Sequence[object] = ()) -> Select:
    """Parse a SELECT statement and bind its parameters, like parse_statement.

    Raises:
        InvalidQuery: As in parse_statement, or the text is another statement.
    """
    statement = parse_statement(text, params)
    if isinstance(statement, Select):
        return statement
    reason = "this changes what is stored; only SELECT is allowed here; executeCQL runs "
    raise InvalidQuery(text, len(text) - len(text.lstrip()), f"{reason}other statements")


def parse_condition(text: str, params: Sequence[object] = ()) -> Expression:
    """Parse a condition, as it follows WHERE, and bind its parameters.

    Raises:
        InvalidQuery: The text is not a condition, or the parameters do not fit.
    """
    condition: Expression = _parse(text, "lone_condition")
    try:
        return Binding(text, params, terms_of_condition(condition)).expression(condition)
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None


def _limit(text: str, most: Literal) -> int:
    """Return the value of a bound LIMIT; InvalidQuery: it is not a number of rows."""
    is_whole = isinstance(most.value, Integral) and not isinstance(most.value, bool)
    if not is_whole or not 1 <= most.value <= MAX_LIMIT:
        reason = f"LIMIT takes a whole number of at least 1 and at most {MAX_LIMIT}"
        raise InvalidQuery(text, most.position, reason)
    return int(most.value)


def _parse(text: str, start: str) -> Any:
    """Return the tree of a text by a start rule of the grammar, its values not bound yet.

    A SELECT gives the pair of its tree and its LIMIT (None = it has none).

    Raises:
        InvalidQuery: The text is not what the rule describes.
    """
    from lark import UnexpectedInput  # by the first statement: most programs parse none

    if not isinstance(text, str):
        raise InvalidQuery(f"{text!r:.200}", 0, f"a statement is text, not {type(text).__name__}")
    if len(text) > MAX_STATEMENT:
        raise InvalidQuery(text[:200], 0, f"a statement has at most {MAX_STATEMENT} characters")
    try:
        return (_parse_cached if len(text) <= SHORT_TEXT else _parse_text)(text, start)
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None
    except UnexpectedInput as exc:
        raise InvalidQuery(text, *_explain(text, exc)) from None


def _parse_text(text: str, start: str) -> Any:
    from cassandra_ros.query.tree.grammar import grammar

    return grammar().parse(text, start=start)


# A tree is never changed, so all statements with one text share it.
_parse_cached = lru_cache(maxsize=256)(_parse_text)


def _explain(text: str, error: UnexpectedInput) -> tuple[int, str]:
    """Return the position of a syntax error, and the expected words."""
    from lark.exceptions import UnexpectedCharacters, UnexpectedToken

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
    word = _word(text[position:])
    if word == "(" and previous == "NAME" and "DOT" in expected:
        reason = f"there is no function {last}{nearest(str(last), FUNCTIONS)}; the functions are "
        return last.start_pos or 0, f"{reason}{', '.join(FUNCTIONS)}"
    if word[:1] in "'\"" and word and text.count(word[0], position) == 1:
        return position, f"the quote {word[0]} is not closed"
    if text.startswith("/*", position):
        return position, "the comment /* is not closed"
    keywords = [
        name.lstrip("_")
        for name in expected - {"_END"}
        if name.startswith("_") or name in _KEPT_KEYWORDS
    ]
    finding = f"found {word!r}" if word else "the statement ends here"
    words = {**_WORDS, "NAME": "a name"} if "_ON" in expected else _WORDS
    choice = ", ".join(sorted(words.get(name, name.lstrip("_")) for name in expected - _UNSAID))
    hint = _hint(text[:position], word, expected, previous) or nearest(word, keywords)
    return position, f"{finding}{hint}; expected {choice or 'something else'}"


def _hint(before: str, word: str, expected: set[str], previous: str) -> str:
    """Return ' (…)' with the remedy for a known mistake, or ''.

    ``word`` follows ``before`` and the token ``previous`` ('' = unknown), but is not ``expected``.
    """
    words = f"{before} {word}".upper().split()
    instead = _INSTEAD.get(" ".join(words)) if expected & {"_SELECT", "_INDEX"} else None
    if instead:
        return f" ({instead})"
    if previous == "_DELETE":
        return " (messages are removed whole: DELETE FROM topic WHERE …)"
    if previous == "STAR" and word == ",":
        return " (* stands alone: it gives KEY and every field)"
    if word.upper() == "NULL" and "NUMBER" in expected:
        return " (what is missing is found by IS NULL)"
    return ""


def _word(text: str) -> str:
    """Return the first word or sign of a text, at most 40 characters."""
    match = re.match(r"[\w/]{1,40}", text)
    return match.group() if match else text[:1]


class Binding:
    """Replaces the placeholders of a statement by parameter values.

    All ``now()`` of a statement have the same value: this machine's time when it is bound.

    Args:
        text: The statement.
        params: Values of the parameters.
        terms: All terms that may contain placeholders.

    Raises:
        InvalidQuery: The parameters do not fit.
    """

    def __init__(
        self,
        text: str,
        params: Sequence[object],
        terms: Iterable[Term],
    ) -> None:
        fillable = [term for term in terms if isinstance(term, (Literal, Call))]
        # Most statements have no parameters and no calls, and stay unchanged.
        self._fixed = all(isinstance(term, Literal) and term.bound for term in fillable)
        positions = sorted(set(_placeholders(fillable)))  # BETWEEN repeats its operand in the tree
        _check_params(text, positions, params)
        if len(positions) != len(params):
            at = positions[len(params)] if len(params) < len(positions) else len(text)
            reason = f"the statement has {len(positions)} parameters, {len(params)} were given"
            raise InvalidQuery(text, at, reason)
        self._text = text
        self._values = dict(zip(positions, map(plain_value, params)))
        """Value of each placeholder, by its position."""
        self._now = TimeNs(0 if self._fixed else time.time_ns())

    def select(self, select: Select) -> Select:
        """Bind a SELECT except for its LIMIT."""
        if self._fixed:
            return select
        columns, condition = select.columns, select.condition
        return replace(
            select,
            columns=columns and tuple(replace(c, what=self._what(c.what)) for c in columns),
            condition=None if condition is None else self.expression(condition),
            group=tuple(map(self._term, select.group)),
            order=tuple(replace(o, what=self._what(o.what)) for o in select.order),
        )

    def expression(self, item: Expression) -> Expression:
        """Bind a condition.

        StatementError: an expression in it cannot be computed. InvalidQuery: ``IN ?`` has no list.
        """
        if self._fixed:
            return item
        if isinstance(item, LEAVES):
            return self._leaf(item)
        if isinstance(item, Negation):
            return Negation(self.expression(item.item))
        return replace(item, items=tuple(map(self.expression, item.items)))

    def _leaf(self, leaf: Leaf) -> Expression:
        if isinstance(leaf, Near):
            return replace(leaf, values=tuple(map(self.value, leaf.values)))
        if isinstance(leaf, InEvent):
            return replace(leaf, name=self.value(leaf.name))
        if isinstance(leaf, Quantified):
            tests = tuple((sign, self._term(term)) for sign, term in leaf.tests)
            return replace(leaf, tests=tests)
        operand = self._term(leaf.operand)
        if isinstance(leaf, Relate):
            return replace(leaf, operand=operand, other=self._term(leaf.other))
        if isinstance(leaf, IsNull):
            return IsNull(operand)
        if isinstance(leaf, Compare):
            return replace(leaf, operand=operand, value=self.value(leaf.value))
        values = tuple(map(self.value, leaf.values))
        return OneOf(operand, self._elements(*values) if leaf.whole else values)

    def value(self, value: Literal) -> Literal:
        """Bind one value; StatementError: it cannot be computed."""
        if value.bound:
            return value
        at = value.position
        if value.made is None:
            return Literal(self._values[at], at)
        return cast(Literal, self._term(value.made))

    def _what(self, what: Term | Aggregate) -> Term | Aggregate:
        """Bind what a column or an item of ORDER BY consists of."""
        if not isinstance(what, Aggregate):
            return self._term(what)
        return what if what.operand is None else replace(what, operand=self._term(what.operand))

    def _term(self, term: Term) -> Term:
        """Bind a term; a call of constants only becomes its value."""
        if isinstance(term, Literal):
            return self.value(term)
        if not isinstance(term, Call):
            return term
        if term.function == "now":
            return Literal(self._now, term.position)
        call = replace(term, arguments=tuple(map(self._term, term.arguments)))
        constant = all(isinstance(argument, Literal) for argument in call.arguments)
        return fold(call) if constant else call

    def _elements(self, whole: Literal) -> tuple[Literal, ...]:
        """Return the values of ``IN ?``, all at the position of the placeholder."""
        if not isinstance(whole.value, (list, tuple, set, frozenset)):
            raise InvalidQuery(self._text, whole.position, "IN ? takes a list as its value")
        return tuple(Literal(element, whole.position) for element in whole.value)


def terms_of_condition(condition: Expression | None) -> Iterator[Term]:
    """Yield the terms in the leaves of a condition."""
    for leaf in leaves(condition):
        yield from terms_of(leaf)


def terms_of_statement(statement: Select | Change) -> Iterator[Term]:
    """Yield all terms of a statement that may contain parameters, except for its LIMIT."""
    if isinstance(statement, (Select, Delete)):
        yield from terms_of_condition(statement.condition)
    if isinstance(statement, Select):
        yield from statement.group
        columns = [column.what for column in statement.columns or ()]
        for what in columns + [ordering.what for ordering in statement.order]:
            operand = what.operand if isinstance(what, Aggregate) else what
            yield from () if operand is None else (operand,)


def _placeholders(terms: Iterable[Term]) -> Iterator[int]:
    """Yield the positions of the placeholders in terms, also of those in a Literal's ``made``."""
    for term in terms:
        for inner in inside(term):
            if isinstance(inner, Literal) and not inner.bound:
                yield from (
                    (inner.position,) if inner.made is None else _placeholders([inner.made])
                )


def _check_params(text: str, positions: Sequence[int], params: object) -> None:
    """Check that the parameters are a collection with an order."""
    unordered = (str, bytes, Mapping, AbstractSet)
    if isinstance(params, Collection) and not isinstance(params, unordered):
        return
    if isinstance(params, (str, bytes)) or not isinstance(params, Iterable):
        reason = f"one value: give [{params!r:.80}]"
    else:
        reason = f"a {type(params).__name__}"
    reason = f"the parameters are a list of values in the order of their ?, not {reason}"
    raise InvalidQuery(text, min(positions, default=0), reason)
