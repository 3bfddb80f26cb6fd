# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Syntax trees of statements. Positions are indexes into the text, for the caret in errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterator, Sequence, Union

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.protocols import Stays


@dataclass(eq=False)
class StatementError(Exception):
    """An error at a position of a statement; the caller converts it to InvalidQuery."""

    position: int
    reason: str


class DecimalText(float):
    """A float with its text, because a time needs all its digits."""

    text: str

    def __new__(cls, text: str) -> DecimalText:
        """Return the float of a decimal number."""
        value = super().__new__(cls, text)
        value.text = text
        return value


class TimeNs(int):
    """A time that a statement computes, as ``now()``: ns since 1970."""


class DurationNs(int):
    """A duration in a statement, as ``1h30m``: ns."""


class LengthText(str):
    """A length in a statement, as ``20m``: its text."""


DURATION_UNITS_NS = {
    **{"d": 86_400 * SECOND_NS, "h": 3600 * SECOND_NS, "m": 60 * SECOND_NS, "s": SECOND_NS},
    **{"ms": 10**6, "us": 10**3, "ns": 1},
}
"""Length of the units of durations in ns, longest first."""


def value_text(value: object) -> str:
    """Return a value as in a statement, at most 40 characters of it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, DurationNs):
        unit = next(
            name for name, ns in DURATION_UNITS_NS.items() if ns == 1 or (value and value % ns == 0)
        )
        return f"{value // DURATION_UNITS_NS[unit]}{unit}"
    quoted = isinstance(value, str) and not isinstance(value, LengthText)
    return f"'{str(value)[:40]}'" if quoted else str(value)[:40]


@dataclass(frozen=True)
class Literal:
    """A constant: int, float, str or bool; of a parameter also other types."""

    value: Any
    position: int
    bound: bool = True
    """False for a ``?`` or ``%s`` whose value is not bound yet, and for ``made``."""
    made: Call | None = None
    """Call of constants, parameters and ``now()`` from which binding computes the value."""

    @property
    def text(self) -> str:
        """The value as in a statement, see value_text; '?' until it is bound."""
        return value_text(self.value) if self.bound else "?"


@dataclass(frozen=True)
class PathPart:
    """One name of a dotted path, with the index after it."""

    name: str
    index: int | None
    """None = no index."""
    position: int


@dataclass(frozen=True)
class FieldPath:
    """A dotted field, like ``transforms[0].transform.translation.x``."""

    parts: tuple[PathPart, ...]
    position: int

    @property
    def text(self) -> str:
        """Path as the name of a column."""
        return path_text([(path_part.name, path_part.index) for path_part in self.parts])

    @property
    def dotted(self) -> str:
        """Dotted name of the field without indexes."""
        return ".".join(path_part.name for path_part in self.parts)


def path_text(names: Sequence[tuple[str, int | None]]) -> str:
    """Return names and their indexes (None = no index) as in a statement.

    A first name KEY, NODE or RUN is quoted, because unquoted these words have another meaning.
    """
    texts = [name if index is None else f"{name}[{index}]" for name, index in names]
    first = names[0][0]
    if first in OWN_WORDS:
        texts[0] = texts[0].replace(first, f'"{first}"', 1)
    return ".".join(texts)


@dataclass(frozen=True)
class KeyOperand:
    """``KEY``, the row key: the time by which rows are sorted, or the name of a message."""

    position: int
    text = "KEY"


@dataclass(frozen=True)
class NodeOperand:
    """``NODE``, the nodeID of the robot that produced a message."""

    position: int
    text = "NODE"


@dataclass(frozen=True)
class RunOperand:
    """``RUN``, the recording or import that stored a message."""

    position: int
    text = "RUN"


OWN_WORDS = (KeyOperand.text, NodeOperand.text, RunOperand.text)
"""Words with a meaning of their own; fields with such names are quoted."""

Operand = Union[FieldPath, KeyOperand, NodeOperand, RunOperand]
OPERANDS = (FieldPath, KeyOperand, NodeOperand, RunOperand)
ARITHMETIC = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3}
"""Precedence of each operator; ``neg`` is the minus before a value."""
AGGREGATES = ("count", "min", "max", "sum", "avg")
"""Aggregates of all rows. All except count also apply to an array in a row."""
QUANTIFIERS = ("any", "all")
FUNCTIONS = (*AGGREGATES, "len", "abs", "sqrt", "time", "now", *QUANTIFIERS, "near")
"""Functions that a statement may use; ANY, ALL and NEAR only in conditions."""


@dataclass(frozen=True)
class Call:
    """A value computed from others in a row: arithmetic, or a function."""

    function: str
    """One of ARITHMETIC, abs, sqrt, now, time (of KEY and a duration); for an array min, max, sum,
    avg, len (also for a text); during parsing also those of QUANTIFIERS, and count."""
    arguments: tuple[Term, ...]
    position: int
    depth: int = field(default=1, compare=False)
    """Nesting depth of calls."""

    @property
    def text(self) -> str:
        """Expression as the name of a column."""
        precedence = ARITHMETIC.get(self.function)
        if precedence is None:
            arguments = self.arguments[1:] if self.function == "time" else self.arguments
            return f"{self.function}({', '.join(argument.text for argument in arguments)})"
        # A right operand of equal precedence keeps its parentheses.
        texts = [
            _operand_text(argument, precedence + n) for n, argument in enumerate(self.arguments)
        ]
        if len(texts) == 1:
            return f"-({texts[0]})" if texts[0].startswith("-") else f"-{texts[0]}"
        return f"{texts[0]} {self.function} {texts[1]}"


def _operand_text(operand: Term, least: int) -> str:
    """Return the text of an operand, in parentheses if its precedence is below ``least``."""
    precedence = ARITHMETIC.get(operand.function, least) if isinstance(operand, Call) else least
    return operand.text if precedence >= least else f"({operand.text})"


Term = Union[FieldPath, KeyOperand, NodeOperand, RunOperand, Literal, Call]
"""Anything that has a value in a row."""


def inside(term: Term) -> Iterator[Term]:
    """Yield a term and all terms that it contains; not those in the ``made`` of a Literal."""
    yield term
    for argument in term.arguments if isinstance(term, Call) else ():
        yield from inside(argument)


def is_constant(term: Term) -> bool:
    """Return whether a term has the same value in every row."""
    return not any(isinstance(inner_term, OPERANDS) for inner_term in inside(term))


@dataclass(frozen=True)
class Aggregate:
    """An aggregate of all rows, as ``min(field)``."""

    function: str
    """One of AGGREGATES."""
    operand: Term | None
    """Aggregated term; None = ``*``, for count only."""
    position: int

    @property
    def text(self) -> str:
        """Aggregate as the name of a column."""
        return f"{self.function}({'*' if self.operand is None else self.operand.text})"


@dataclass(frozen=True)
class Selected:
    """A column that a statement selects, with its alias."""

    what: Term | Aggregate
    alias: str | None = None

    @property
    def text(self) -> str:
        """Name of the column."""
        return self.what.text if self.alias is None else self.alias

    @property
    def is_path(self) -> bool:
        """Whether it is a field or a message, which may have any number of fields."""
        return isinstance(self.what, FieldPath)


@dataclass(frozen=True)
class Compare:
    """``operand operator value``, with one of the operators = != < <= > >= LIKE CONTAINS."""

    operand: Term
    operator: str
    value: Literal

    @property
    def text(self) -> str:
        """Comparison as in a statement."""
        return f"{self.operand.text} {self.operator} {self.value.text}"


@dataclass(frozen=True)
class Relate:
    """``term operator term``, both varying from row to row; the operator is a sign, not a word."""

    operand: Term
    operator: str
    other: Term
    position: int
    """Position of the operator."""

    @property
    def text(self) -> str:
        """Comparison as in a statement."""
        return f"{self.operand.text} {self.operator} {self.other.text}"


@dataclass(frozen=True)
class Quantified:
    """``ANY(array) operator term`` and ``ALL``: a condition on one element, or on each."""

    operand: FieldPath
    every: bool
    """Whether it is ALL."""
    tests: tuple[tuple[str, Term], ...]
    """Pairs of operator (also LIKE) and the term that an element is compared with."""
    position: int
    either: bool = False
    """Whether one true test is enough (IN); else all must be true (BETWEEN)."""
    negated: bool = False
    """Whether the test of an element is negated (NOT IN, NOT BETWEEN, NOT LIKE)."""

    @property
    def text(self) -> str:
        """Comparison as in a statement."""
        word = "OR" if self.either else "AND"
        tests = f" {word} ".join(f"{sign} {term.text}" for sign, term in self.tests)
        tests = f"NOT ({tests})" if self.negated else tests
        return f"{'ALL' if self.every else 'ANY'}({self.operand.text}) {tests}"


@dataclass(frozen=True)
class OneOf:
    """``operand IN (…)``, or ``IN ?`` with a list as parameter."""

    operand: Term
    values: tuple[Literal, ...]
    whole: bool = False
    """Whether the only value is a parameter that is not bound yet, and is the list itself."""

    @property
    def text(self) -> str:
        """Comparison as in a statement, of a long list only the first five values."""
        values = [value.text for value in self.values[:5]]
        more = ", …" if len(self.values) > 5 else ""
        return f"{self.operand.text} IN ({', '.join(values)}{more})"


@dataclass(frozen=True)
class IsNull:
    """``operand IS NULL``."""

    operand: Term

    @property
    def text(self) -> str:
        """Condition as in a statement."""
        return f"{self.operand.text} IS NULL"


@dataclass(frozen=True)
class Near:
    """``NEAR(x, y, radius IN 'frame', 'robot')``: where the robot was at the time of a message."""

    values: tuple[Literal, ...]
    position: int
    stays: Stays | None = field(default=None, compare=False)
    """Times of the robot's stays; None until they are looked up."""

    @property
    def text(self) -> str:
        """Condition as in a statement."""
        return f"NEAR({', '.join(value.text for value in self.values)})"


@dataclass(frozen=True)
class InEvent:
    """``EVENT 'name'`` or ``EVENT LIKE 'pattern'``: whether the robot had such an event then."""

    name: Literal
    like: bool
    position: int
    stays: Stays | None = field(default=None, compare=False)
    """Times of the events; None until they are looked up."""

    @property
    def text(self) -> str:
        """Condition as in a statement."""
        return f"EVENT {'LIKE ' * self.like}{self.name.text}"


@dataclass(frozen=True)
class All:
    """Conditions joined by AND."""

    items: tuple[Expression, ...]

    @property
    def text(self) -> str:
        """Condition as in a statement, in parentheses."""
        return f"({' AND '.join(item.text for item in self.items)})"


@dataclass(frozen=True)
class Either:
    """Conditions joined by OR."""

    items: tuple[Expression, ...]

    @property
    def text(self) -> str:
        """Condition as in a statement, in parentheses."""
        return f"({' OR '.join(item.text for item in self.items)})"


@dataclass(frozen=True)
class Negation:
    """A negated condition."""

    item: Expression

    @property
    def text(self) -> str:
        """Condition as in a statement."""
        return f"NOT {self.item.text}"


Comparison = Union[Compare, OneOf, IsNull, Relate, Quantified]
"""Any condition with an operand."""
Timed = Union[Near, InEvent]
"""Any condition on the time and the robot of a message."""
TIMED = (Near, InEvent)
Leaf = Union[Comparison, Timed]
LEAVES = (Compare, OneOf, IsNull, Relate, Quantified, *TIMED)
Expression = Union[Leaf, All, Either, Negation]


def parts(expression: Expression) -> tuple[Expression, ...]:
    """Return the conditions that AND, OR or NOT joins directly; () for a leaf."""
    if isinstance(expression, (All, Either)):
        return expression.items
    return (expression.item,) if isinstance(expression, Negation) else ()


def given(leaf: Leaf) -> tuple[Literal, ...]:
    """Return the values that the operand of a Compare or OneOf is compared with, else ()."""
    if isinstance(leaf, Compare):
        return (leaf.value,)
    return leaf.values if isinstance(leaf, OneOf) else ()


def terms_of(leaf: Leaf) -> tuple[Term, ...]:
    """Return all terms in a comparison, in NEAR or in EVENT."""
    if isinstance(leaf, Near):
        return leaf.values
    if isinstance(leaf, InEvent):
        return (leaf.name,)
    if isinstance(leaf, Relate):
        return (leaf.operand, leaf.other)
    tests = leaf.tests if isinstance(leaf, Quantified) else ()
    return (leaf.operand, *given(leaf), *(term for _, term in tests))


def leaves(expression: Expression | None) -> Iterator[Leaf]:
    """Yield the leaves of a condition, from left to right; none of None."""
    if isinstance(expression, LEAVES):
        yield expression
    elif expression is not None:
        for inner in parts(expression):
            yield from leaves(inner)


def wants_array(leaf: Comparison) -> bool | None:
    """Return whether a comparison's operand must be a whole array; None = either."""
    if isinstance(leaf, IsNull):
        return None
    return isinstance(leaf, Quantified) or getattr(leaf, "operator", "") == "CONTAINS"


def conjuncts(expression: Expression | None) -> Iterator[Expression]:
    """Yield the conditions that are joined by AND at the top of a condition; none of None."""
    if isinstance(expression, All):
        for item in expression.items:
            yield from conjuncts(item)
    elif expression is not None:
        yield expression


@dataclass(frozen=True)
class Ordering:
    """One item of ORDER BY."""

    what: Term | Aggregate
    descending: bool
    position: int
    place: int = -1
    """Index of the column in ``Select.asked``; -1 until ``analyse_select`` sets it."""


@dataclass(frozen=True)
class Select:
    """A SELECT statement. What ``parse_statement`` returns has its text, and all values bound."""

    text: str
    columns: tuple[Selected, ...] | None
    """Selected columns; None = ``*``."""
    topic: str
    topic_position: int
    condition: Expression | None
    descending: bool = False
    """Whether rows are read from the last KEY to the first."""
    limit: int | None = None
    distinct: bool = False
    group: tuple[Term, ...] = ()
    """Terms of GROUP BY."""
    order: tuple[Ordering, ...] = ()
    """Items of ORDER BY, unless it is KEY alone."""
    hidden: tuple[Selected, ...] = ()
    """Columns that are computed but not shown, after the shown ones; see
    query/rows/result_groups.py."""

    @property
    def aggregates(self) -> tuple[Aggregate, ...]:
        """Aggregates among its columns."""
        terms = (column.what for column in self.columns or ())
        return tuple(what for what in terms if isinstance(what, Aggregate))

    @property
    def visible(self) -> tuple[Selected | None, ...]:
        """Columns that are shown; None = every field."""
        return (Selected(KeyOperand(0)), None) if self.columns is None else self.columns

    @property
    def asked(self) -> tuple[Selected | None, ...]:
        """All columns, hidden ones included."""
        return (*self.visible, *self.hidden)

    @property
    def counts(self) -> bool:
        """Whether only the number of all rows is selected."""
        alone = bool(self.aggregates) and not (self.group or self.order)
        return alone and all(a.operand is None for a in self.aggregates)

    @property
    def gathers(self) -> bool:
        """Whether rows of the result differ from the rows of the topic in number or order."""
        return bool(self.aggregates or self.group or self.order or self.distinct)


@dataclass(frozen=True)
class Delete:
    """A DELETE statement; text and values as in Select."""

    text: str
    topic: str
    topic_position: int
    condition: Expression


@dataclass(frozen=True)
class Truncate:
    """A TRUNCATE statement."""

    text: str
    topic: str
    topic_position: int


@dataclass(frozen=True)
class IndexName:
    """Name of an index; in lower case unless it was quoted."""

    text: str
    position: int


@dataclass(frozen=True)
class Indexed:
    """``topic (field)``: the indexed field."""

    topic: str
    topic_position: int
    field: FieldPath


@dataclass(frozen=True)
class CreateIndex:
    """A CREATE INDEX statement."""

    text: str
    on: Indexed
    name: IndexName | None
    unless_exists: bool
    """Whether the statement has IF NOT EXISTS."""


@dataclass(frozen=True)
class DropIndex:
    """A DROP INDEX statement."""

    text: str
    index: IndexName | Indexed
    if_exists: bool


Change = Union[Delete, Truncate, CreateIndex, DropIndex]
"""Any statement that changes the store."""
