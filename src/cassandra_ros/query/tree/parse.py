# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parser of statements and conditions: a text and its parameters become a tree, or InvalidQuery.

``_Builder`` builds the tree while lark parses the text.
"""

from __future__ import annotations

import re
import time
from dataclasses import replace
from decimal import Decimal, localcontext
from functools import lru_cache
from itertools import chain
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
    cast,
)

from lark import Lark, Token, Transformer, UnexpectedInput, v_args
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from cassandra_ros.arguments import MAX_LIMIT
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.tree.expressions import fold
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.query.tree.syntax import (
    AGGREGATES,
    FUNCTIONS,
    LEAVES,
    QUANTIFIERS,
    UNITS,
    Aggregate,
    All,
    Call,
    Change,
    Compare,
    CreateIndex,
    DecimalText,
    Delete,
    DropIndex,
    DurationNs,
    Either,
    Expression,
    Indexed,
    IndexName,
    IsNull,
    KeyOperand,
    Leaf,
    Literal,
    Near,
    Negation,
    NodeOperand,
    OneOf,
    Operand,
    Ordering,
    Path,
    PathPart,
    Quantified,
    Relate,
    RunOperand,
    Select,
    Selected,
    StatementError,
    Term,
    TimeNs,
    Truncate,
    inside,
    is_constant,
    leaves,
    parts,
    terms_of,
)

_Not = Optional[Token]
MAX_DEPTH = 100
NEAR_VALUES = (3, 5)
"""Minimum and maximum number of arguments of NEAR."""
MAX_DIGITS = 400
"""Maximum number of digits of a number. Python's conversion of longer ones takes quadratic time."""


@v_args(inline=True)
class _Builder(Transformer):  # type: ignore[type-arg]
    """One method for each rule of the grammar, called while lark parses."""

    def select(
        self,
        distinct: Optional[Token],
        columns: Union[Token, tuple[Selected, ...]],
        topic: tuple[str, int],
        condition: Optional[Expression],
        group: Optional[tuple[Term, ...]],
        order: Optional[tuple[Ordering, ...]],
        limit: Optional[Literal],
    ) -> tuple[Select, Optional[Literal]]:
        shown = None if isinstance(columns, Token) else columns
        order, group = order or (), group or ()
        down = False
        if len(order) == 1 and isinstance(order[0].what, KeyOperand) and not group:
            down, order = order[0].descending, ()
        select = Select("", shown, *topic, condition, down, None, distinct is not None)
        return replace(select, group=group, order=order), limit

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
        # As in CQL, an unquoted name is in lower case.
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
        return columns

    def column(self, what: Term, alias: Optional[Token]) -> Selected:
        return Selected(_column(what), None if alias is None else _name(alias))

    def call(self, word: Token, argument: Union[None, Token, Term]) -> Call:
        function, at = word.lower(), _at(word)
        if function == "now":
            if argument is not None:
                raise StatementError(at, "now() takes nothing in its parentheses")
            return Call(function, (), at)
        if isinstance(argument, Token) and function == "count":
            return Call(function, (), at)
        if argument is None or isinstance(argument, Token):
            spot = at if argument is None else _at(argument)
            reason = f"{function} takes one {'duration' if function == 'time' else 'field'}"
            raise StatementError(spot, f"{reason}; only count takes *")
        given = (KeyOperand(at), argument) if function == "time" else (argument,)
        if function in QUANTIFIERS and not isinstance(argument, Path):
            reason = f"{word.upper()} takes an array, not {_part(argument).text}"
            raise StatementError(argument.position, reason)
        return _call(function, given, at)

    def binary(self, left: Term, sign: Token, right: Term) -> Call:
        return _call(str(sign), (left, right), _at(sign))

    def negative(self, minus: Token, term: Term) -> Call:
        return _call("neg", (term,), _at(minus))

    def topic(self, token: Token) -> tuple[str, int]:
        return _name(token), _at(token)

    def group(self, *terms: Term) -> tuple[Term, ...]:
        return tuple(_part(term) for term in terms)

    def order(self, *parts: Ordering) -> tuple[Ordering, ...]:
        return parts

    def ordering(self, what: Term, direction: Optional[Token]) -> Ordering:
        down = direction is not None and direction.type == "DESC"
        return Ordering(_column(what), down, what.position)

    def where(self, condition: Expression) -> Expression:
        """Refuse a condition so deeply nested that recursion would overflow the stack."""
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

    def compare(self, left: Term, operator: Token, right: Term) -> Expression:
        sign = "!=" if operator == "<>" else str(operator)
        return compared(left, sign, right, _at(operator))

    def match(self, operand: Term, negated: _Not, operator: Token, value: Term) -> Expression:
        sign = operator.upper()
        if _quantifies(operand) and sign == "LIKE":
            return _quantified(operand, [(sign, _value(value))], negated, False)
        return _unless(negated, Compare(_part(operand), sign, _value(value)))

    def one_of(self, operand: Term, negated: _Not, *values: Optional[Term]) -> Expression:
        listed = tuple(_value(v) for v in values if v is not None)
        if _quantifies(operand):
            return _quantified(operand, [("=", value) for value in listed], negated, True)
        return _unless(negated, OneOf(_part(operand), listed))

    def in_list(self, operand: Term, negated: _Not, values: Literal) -> Expression:
        if _quantifies(operand):
            reason = "beside ANY and ALL the values of IN stand in parentheses: IN (?, ?)"
            raise StatementError(values.position, reason)
        return _unless(negated, OneOf(_part(operand), (values,), whole=True))

    def between(self, operand: Term, negated: _Not, low: Term, high: Term) -> Expression:
        ends = ((">=", low), ("<=", high))
        if _quantifies(operand):
            return _quantified(operand, [(s, _part(end)) for s, end in ends], negated, False)
        inside = All(tuple(compared(operand, s, end, end.position) for s, end in ends))
        return _unless(negated, inside)

    def near(self, word: Token, *values: Optional[Term]) -> Near:
        given = tuple(_value(value) for value in values if value is not None)
        if not NEAR_VALUES[0] <= len(given) <= NEAR_VALUES[1]:
            reason = (
                f"NEAR takes 3 to 5 values, not {len(given)}: x, y, a radius in metres, a frame "
            )
            reason += "('map' where none is given) and a robot, as NEAR(2.5, 0, 1.5, 'odom')"
            raise StatementError(_at(word), reason)
        return Near(given, _at(word))

    def is_null(self, operand: Term, negated: _Not) -> Expression:
        return _unless(negated, IsNull(_part(operand)))

    def place(self, token: Token) -> Operand:
        return _OWN[str(token)](_at(token))

    def path(self, *parts: tuple[PathPart, ...]) -> Path:
        names = tuple(name for part in parts for name in part)
        return Path(names, names[0].position)

    def part(self, token: Token, index: Optional[Token]) -> tuple[PathPart, ...]:
        names = _name(token).split(".") if token.type == "QUOTED" else [str(token)]
        made = [PathPart(name, None, _at(token)) for name in names]
        if index is not None:
            made[-1] = PathPart(names[-1], _integer(index), _at(token))
        return tuple(made)

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


def _duration(token: Token) -> DurationNs:
    if len(token) > MAX_DIGITS:
        raise StatementError(_at(token), f"a duration has at most {MAX_DIGITS} digits")
    found = (Decimal(number) * UNITS[unit] for number, unit in _UNIT.findall(token))
    with localcontext() as context:
        context.prec = MAX_DIGITS + 20
        ns = int(sum(found, Decimal()).to_integral_value())
    return DurationNs(-ns if token.startswith("-") else ns)


_UNIT = re.compile(r"([0-9.]+)([a-z]+)")


def _call(function: str, arguments: tuple[Term, ...], position: int) -> Call:
    parts = arguments if function in QUANTIFIERS else tuple(map(_part, arguments))
    depth = 1 + max(part.depth if isinstance(part, Call) else 0 for part in parts)
    if depth > MAX_DEPTH:
        raise StatementError(position, f"what is computed is nested deeper than {MAX_DEPTH}")
    return Call(function, parts, position, depth)


def _quantifies(term: Term) -> bool:
    return isinstance(term, Call) and term.function in QUANTIFIERS


def _part(term: Term) -> Term:
    """Return a term that is allowed anywhere, else raise StatementError."""
    if not isinstance(term, Call):
        return term
    if term.function in QUANTIFIERS:
        word = term.function.upper()
        reason = f"stands alone on one side of a comparison, as {word}(ranges) < 0.2"
        raise StatementError(term.position, f"{word}({term.arguments[0].text}) {reason}")
    if term.function == "count":
        shown = term.arguments[0].text if term.arguments else "*"
        reason = f"count({shown}) is made of all rows, so it stands alone in SELECT and ORDER BY: "
        reason += "select it, and compare or compute in a second statement"
        raise StatementError(term.position, reason)
    return term


def _column(term: Term) -> Union[Term, Aggregate]:
    """Return the term or aggregate of a column of a result."""
    if isinstance(term, Call) and term.function in AGGREGATES:
        operand = _part(term.arguments[0]) if term.arguments else None
        return Aggregate(term.function, operand, term.position)
    return _part(term)


def _value(term: Term) -> Literal:
    """Return a constant term; it is computed when the parameters are bound."""
    if isinstance(term, Literal):
        return term
    if isinstance(term, Call) and is_constant(_part(term)):
        return Literal(None, term.position, bound=False, made=term)
    reason = f"{_part(term).text} differs from row to row, but here a constant is needed; "
    raise StatementError(term.position, f"{reason}text stands in quotes: 'text'")


_FLIPPED = {"=": "=", "!=": "!=", "<": ">", "<=": ">=", ">": "<", ">=": "<="}


def compared(left: Term, sign: str, right: Term, position: int) -> Expression:
    """Return the comparison of two terms; if only one is a field, it becomes the left operand."""
    if _quantifies(right) and not _quantifies(left):
        left, sign, right = right, _FLIPPED[sign], left
    if _quantifies(left):
        return _quantified(left, [(sign, _part(right))], None, False)
    left, right = _part(left), _part(right)
    if isinstance(right, Path) and right.text.lower() == "null":
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


def _quantified(
    term: Term, tests: Sequence[tuple[str, Term]], negated: _Not, either: bool
) -> Expression:
    call = term
    if not isinstance(call, Call) or not isinstance(call.arguments[0], Path):
        raise AssertionError("the grammar lets nothing else through")
    every, array = call.function == "all", call.arguments[0]
    made = [(sign, _value(to) if is_constant(to) else to) for sign, to in tests]
    sign, first = made[0] if made else ("", None)
    if sign == "=" and len(made) == 1 and isinstance(first, Literal) and not (every or negated):
        return Compare(
            array, "CONTAINS", first
        )  # equivalent, and the planner can use it more often
    return Quantified(array, every, tuple(made), call.position, either, negated is not None)


def tree_builder() -> Transformer[Token, object]:
    """Return the transformer; it has no state, so that threads can share it."""
    return _Builder()


SHORT_TEXT = 1000
"""Maximum length of a text whose tree is cached, characters."""
MAX_STATEMENT = 1 << 20

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
_KEPT_KEYWORDS = {"ASC", "DESC", "NOT", "LIKE", "CONTAINS"}
"""Keywords that stay in the tree; the grammar's names of all other keywords begin with '_'."""
_UNSAID = {"QUOTED", "_END", "FUNCTION", "NEAR", "TRUE", "FALSE"}
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


@lru_cache(maxsize=1)
def grammar() -> Lark:
    """Return the grammar of statements and conditions, compiled once."""
    return Lark.open(
        "cql.lark",
        rel_to=__file__,
        parser="lalr",
        start=["statement", "lone_condition"],
        transformer=tree_builder(),
    )


def parse_statement(text: str, params: Sequence[object] = ()) -> Union[Select, Change]:
    """Parse a statement and bind its parameters, one value for each ``?`` or ``%s``, in order.

    Raises:
        InvalidQuery: The text is not a statement, or the parameters do not fit.
    """
    found = _parse(text, "statement")
    parsed, limit = found if isinstance(found, tuple) else (found, None)
    terms = chain(terms_of_statement(parsed), [] if limit is None else [limit])
    bound = Binding(text, params, terms)
    try:
        if isinstance(parsed, Select):
            parsed = bound.select(parsed)
        elif isinstance(parsed, Delete):
            parsed = replace(parsed, condition=bound.expression(parsed.condition))
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None
    if limit is not None:
        parsed = replace(parsed, limit=_limit(text, bound.value(limit)))
    statement: Union[Select, Change] = replace(parsed, text=text)
    return statement


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
    found: Expression = _parse(text, "lone_condition")
    try:
        return Binding(text, params, terms_of_condition(found)).expression(found)
    except StatementError as exc:
        raise InvalidQuery(text, exc.position, exc.reason) from None


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
    return grammar().parse(text, start=start)


_parsed_before = lru_cache(maxsize=256)(_parsed)  # a tree is never changed


def _explain(text: str, error: UnexpectedInput) -> tuple[int, str]:
    """Return the position of a syntax error, and the expected words."""
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
    if found == "(" and previous == "NAME" and "DOT" in expected:
        reason = f"there is no function {last}{nearest(str(last), FUNCTIONS)}; the functions are "
        return last.start_pos or 0, f"{reason}{', '.join(FUNCTIONS)}"
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
    """Return ' (…)' with the remedy for a known mistake, or ''.

    ``found`` follows ``before`` and the token ``previous`` ('' = unknown), but is not ``expected``.
    """
    words = f"{before} {found}".upper().split()
    instead = _INSTEAD.get(" ".join(words)) if expected & {"_SELECT", "_INDEX"} else None
    if instead:
        return f" ({instead})"
    if previous == "_DELETE":
        return " (messages are removed whole: DELETE FROM topic WHERE …)"
    if previous == "STAR" and found == ",":
        return " (* stands alone: it gives KEY and every field)"
    if found.upper() == "NULL" and "NUMBER" in expected:
        return " (what is missing is found by IS NULL)"
    return ""


def _word(text: str) -> str:
    """Return the first word or sign of a text, at most 40 characters."""
    found = re.match(r"[\w/]{1,40}", text)
    return found.group() if found else text[:1]


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
        given = [term for term in terms if isinstance(term, (Literal, Call))]
        # Most statements have no parameters and stay unchanged.
        self._fixed = all(isinstance(term, Literal) and term.bound for term in given)
        found = sorted(set(_placeholders(given)))  # BETWEEN repeats its operand in the tree
        _check_params(text, found, params)
        if len(found) != len(params):
            at = found[len(params)] if len(params) < len(found) else len(text)
            reason = f"the statement has {len(found)} parameters, {len(params)} were given"
            raise InvalidQuery(text, at, reason)
        self._text = text
        self._values = dict(zip(found, params))
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
        """Bind a condition; StatementError: an expression in it cannot be computed."""
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
        """Bind one value."""
        if value.bound:
            return value
        at = value.position
        if value.made is None:
            return Literal(self._values[at], at)
        return cast(Literal, self._term(value.made))

    def _what(self, what: Union[Term, Aggregate]) -> Union[Term, Aggregate]:
        if not isinstance(what, Aggregate):
            return self._term(what)
        return what if what.operand is None else replace(what, operand=self._term(what.operand))

    def _term(self, term: Term) -> Term:
        if isinstance(term, Literal):
            return self.value(term)
        if not isinstance(term, Call):
            return term
        if term.function == "now":
            return Literal(self._now, term.position)
        call = replace(term, arguments=tuple(map(self._term, term.arguments)))
        values = all(isinstance(argument, Literal) for argument in call.arguments)
        return fold(call) if values else call

    def _elements(self, whole: Literal) -> tuple[Literal, ...]:
        if not isinstance(whole.value, (list, tuple, set, frozenset)):
            raise InvalidQuery(self._text, whole.position, "IN ? takes a list as its value")
        return tuple(Literal(element, whole.position) for element in whole.value)


def terms_of_condition(condition: Optional[Expression]) -> Iterator[Term]:
    """Yield the terms in the comparisons of a condition."""
    for leaf in leaves(condition):
        yield from terms_of(leaf)


def terms_of_statement(statement: Union[Select, Change]) -> Iterator[Term]:
    """Yield all terms of a statement that may contain parameters, except for its LIMIT."""
    if isinstance(statement, (Select, Delete)):
        yield from terms_of_condition(statement.condition)
    if isinstance(statement, Select):
        yield from statement.group
        columns = [column.what for column in statement.columns or ()]
        for what in columns + [part.what for part in statement.order]:
            found = what.operand if isinstance(what, Aggregate) else what
            yield from () if found is None else (found,)


def _placeholders(terms: Iterable[Term]) -> Iterator[int]:
    for term in terms:
        for part in inside(term):
            if isinstance(part, Literal) and not part.bound:
                yield from (part.position,) if part.made is None else _placeholders([part.made])


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
