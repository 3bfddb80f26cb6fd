# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a statement says, as a tree. Positions are indexes into its text, for the caret."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.protocols import Stays


@dataclass(eq=False)
class StatementError(Exception):
    """Something in a statement is wrong at a position; becomes an InvalidQuery."""

    position: int
    reason: str


class DecimalText(float):
    """A float that remembers how it was written: a time needs all its digits."""

    text: str

    def __new__(cls, text: str) -> DecimalText:
        """Read a decimal number."""
        value = super().__new__(cls, text)
        value.text = text
        return value


class TimeNs(int):
    """A time that a statement computes, as ``now()``: ns since 1970."""


class DurationNs(int):
    """A duration that stands in a statement, as ``1h30m``: ns."""


UNITS = {
    **{"d": 86_400 * SECOND_NS, "h": 3600 * SECOND_NS, "m": 60 * SECOND_NS, "s": SECOND_NS},
    **{"ms": 10**6, "us": 10**3, "ns": 1},
}
"""Those of durations, in ns, the longest first."""


def value_text(value: object) -> str:
    """Write a value as a statement does; of long ones the beginning."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, DurationNs):
        unit = next(name for name, ns in UNITS.items() if ns == 1 or (value and value % ns == 0))
        return f"{value // UNITS[unit]}{unit}"
    return f"'{value[:40]}'" if isinstance(value, str) else str(value)[:40]


@dataclass(frozen=True)
class Literal:
    """A value to compare with: int, float, str, bool; of a parameter also others."""

    value: Any
    position: int
    bound: bool = True
    """False: a ``?`` or ``%s`` whose value is still to come, or ``made``."""
    made: Optional[Call] = None
    """What gives the value, of parameters, values and ``now()``."""

    @property
    def text(self) -> str:
        """The value as a statement has it."""
        return value_text(self.value) if self.bound else "?"


@dataclass(frozen=True)
class Part:
    """One name of a dotted path, with the index behind it."""

    name: str
    index: Optional[int]
    position: int


@dataclass(frozen=True)
class Path:
    """A dotted field, like ``transforms[0].transform.translation.x``."""

    parts: tuple[Part, ...]
    position: int

    @property
    def text(self) -> str:
        """The path as a column's name."""
        return path_text([(part.name, part.index) for part in self.parts])

    @property
    def dotted(self) -> str:
        """The dotted name of the field without any index."""
        return ".".join(part.name for part in self.parts)


def path_text(names: Sequence[Tuple[str, Optional[int]]]) -> str:
    """Write names and their indexes as a statement does.

    A field that is called KEY, NODE or RUN stands in quotes, for without them these words are ours.
    """
    shown = [name if index is None else f"{name}[{index}]" for name, index in names]
    first = names[0][0]
    if first in OWN_WORDS:
        shown[0] = shown[0].replace(first, f'"{first}"', 1)
    return ".".join(shown)


@dataclass(frozen=True)
class KeyOperand:
    """``KEY``, the time under which a message lies."""

    position: int
    text = "KEY"


@dataclass(frozen=True)
class NodeOperand:
    """``NODE``, the entity that produced a message."""

    position: int
    text = "NODE"


@dataclass(frozen=True)
class RunOperand:
    """``RUN``, the recording or import that stored a message."""

    position: int
    text = "RUN"


OWN_WORDS = (KeyOperand.text, NodeOperand.text, RunOperand.text)
"""What stands for more than a field; a field of such a name is quoted."""

Operand = Union[Path, KeyOperand, NodeOperand, RunOperand]
OPERANDS = (Path, KeyOperand, NodeOperand, RunOperand)
ARITHMETIC = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3}
"""How closely each binds; ``neg`` is the minus before one value."""
AGGREGATES = ("count", "min", "max", "sum", "avg")
"""Made of all rows; of one array in a row all but count are, too."""
QUANTIFIERS = ("any", "all")
FUNCTIONS = (*AGGREGATES, "len", "abs", "sqrt", "time", "now", *QUANTIFIERS, "near")
"""Those that a statement may name; ANY, ALL and NEAR stand in conditions alone."""


@dataclass(frozen=True)
class Call:
    """A value that is computed of others in a row: arithmetic, or a function."""

    function: str
    """One of ARITHMETIC, abs, sqrt, now, time (of KEY and a duration); of an array len, min, max,
    sum, avg; while a statement is parsed also those of QUANTIFIERS, and count."""
    arguments: tuple[Term, ...]
    position: int
    depth: int = field(default=1, compare=False)
    """So many calls stand in one another."""

    @property
    def text(self) -> str:
        """What is computed, as a column's name."""
        own = ARITHMETIC.get(self.function)
        if own is None:
            shown = self.arguments[1:] if self.function == "time" else self.arguments
            return f"{self.function}({', '.join(argument.text for argument in shown)})"
        # What binds as closely keeps its parentheses on the right.
        texts = [_within(argument, own + n) for n, argument in enumerate(self.arguments)]
        if len(texts) == 1:
            return f"-({texts[0]})" if texts[0].startswith("-") else f"-{texts[0]}"
        return f"{texts[0]} {self.function} {texts[1]}"


def _within(argument: Term, closeness: int) -> str:
    least = ARITHMETIC.get(argument.function, closeness) if isinstance(argument, Call) else None
    return argument.text if least is None or least >= closeness else f"({argument.text})"


Term = Union[Path, KeyOperand, NodeOperand, RunOperand, Literal, Call]
"""What has a value in a row."""


def inside(term: Term) -> Iterator[Term]:
    """Yield a term and all of which it is made."""
    yield term
    for argument in term.arguments if isinstance(term, Call) else ():
        yield from inside(argument)


def is_constant(term: Term) -> bool:
    """Say whether a term has the same value in every row."""
    return not any(isinstance(part, OPERANDS) for part in inside(term))


@dataclass(frozen=True)
class Aggregate:
    """``min(field)`` and its like: one value made of those of all rows."""

    function: str
    """One of AGGREGATES."""
    operand: Optional[Term]
    """None = ``*``, of count only."""
    position: int

    @property
    def text(self) -> str:
        """The aggregate as a column's name."""
        return f"{self.function}({'*' if self.operand is None else self.operand.text})"


@dataclass(frozen=True)
class Selected:
    """What a statement selects, and the name that it gives it."""

    what: Union[Term, Aggregate]
    alias: Optional[str] = None

    @property
    def text(self) -> str:
        """The column's name."""
        return self.what.text if self.alias is None else self.alias

    @property
    def is_path(self) -> bool:
        """Whether it is a field, or a message, which may have any number of fields."""
        return isinstance(self.what, Path)


@dataclass(frozen=True)
class Compare:
    """``operand operator value``; the operator is one of = != < <= > >= LIKE CONTAINS."""

    operand: Term
    operator: str
    value: Literal


@dataclass(frozen=True)
class Relate:
    """``term operator term`` where both differ from row to row; the operator is no word."""

    operand: Term
    operator: str
    other: Term
    position: int
    """Of the operator."""

    @property
    def text(self) -> str:
        """The comparison as a statement has it."""
        return f"{self.operand.text} {self.operator} {self.other.text}"


@dataclass(frozen=True)
class Quantified:
    """``ANY(array) operator term``, and ``ALL``: what holds for one element, or for each."""

    operand: Path
    every: bool
    """ALL."""
    tests: tuple[tuple[str, Term], ...]
    """Operator (also LIKE) and what an element is compared with."""
    position: int
    either: bool = False
    """One test that holds is enough (IN); else an element passes all (BETWEEN)."""
    negated: bool = False
    """NOT IN, NOT BETWEEN, NOT LIKE: of the element, inside of ANY and ALL."""

    @property
    def text(self) -> str:
        """The comparison as a statement has it."""
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
    """The one value is still to come, and is the list itself."""


@dataclass(frozen=True)
class IsNull:
    """``operand IS NULL``."""

    operand: Term


@dataclass(frozen=True)
class Near:
    """``NEAR(x, y, radius, 'frame', 'robot')``: where the robot was when a message came."""

    values: tuple[Literal, ...]
    position: int
    stays: Optional[Stays] = field(default=None, compare=False)
    """When it was there; None until somebody who knows says so."""

    @property
    def text(self) -> str:
        """The condition as a statement has it."""
        return f"NEAR({', '.join(value.text for value in self.values)})"


@dataclass(frozen=True)
class All:
    """Conditions joined by AND."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Either:
    """Conditions joined by OR."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Negation:
    """NOT."""

    item: Expression


Comparison = Union[Compare, OneOf, IsNull, Relate, Quantified]
"""What has an operand."""
Leaf = Union[Comparison, Near]
LEAVES = (Compare, OneOf, IsNull, Relate, Quantified, Near)
Expression = Union[Leaf, All, Either, Negation]


def parts(expression: Expression) -> tuple[Expression, ...]:
    """Return the conditions of which one is made."""
    if isinstance(expression, (All, Either)):
        return expression.items
    return (expression.item,) if isinstance(expression, Negation) else ()


def given(leaf: Leaf) -> tuple[Literal, ...]:
    """Return the values that an operand is compared with in a Compare or a OneOf."""
    if isinstance(leaf, Compare):
        return (leaf.value,)
    return leaf.values if isinstance(leaf, OneOf) else ()


def terms_of(leaf: Leaf) -> tuple[Term, ...]:
    """Return all that stands in a comparison."""
    if isinstance(leaf, Near):
        return leaf.values
    if isinstance(leaf, Relate):
        return (leaf.operand, leaf.other)
    tests = leaf.tests if isinstance(leaf, Quantified) else ()
    return (leaf.operand, *given(leaf), *(term for _, term in tests))


def leaves(expression: Optional[Expression]) -> Iterator[Leaf]:
    """Yield the comparisons of an expression, from left to right."""
    if isinstance(expression, LEAVES):
        yield expression
    elif expression is not None:
        for part in parts(expression):
            yield from leaves(part)


def wants_array(leaf: Comparison) -> Optional[bool]:
    """Say whether a comparison's operand is an array as a whole; None = either."""
    if isinstance(leaf, IsNull):
        return None
    return isinstance(leaf, Quantified) or getattr(leaf, "operator", "") == "CONTAINS"


def conjuncts(expression: Optional[Expression]) -> Iterator[Expression]:
    """Yield the conditions that must all hold for one to hold."""
    if isinstance(expression, All):
        for item in expression.items:
            yield from conjuncts(item)
    elif expression is not None:
        yield expression


@dataclass(frozen=True)
class Ordering:
    """One part of ORDER BY."""

    what: Union[Term, Aggregate]
    descending: bool
    position: int
    place: int = -1
    """Of the column, among ``Select.asked``; -1 until the statement is settled."""


@dataclass(frozen=True)
class Select:
    """A SELECT statement with all its values bound."""

    text: str
    columns: Optional[tuple[Selected, ...]]
    """None = ``*``."""
    topic: str
    topic_position: int
    condition: Optional[Expression]
    descending: bool = False
    """The rows are read from the last KEY to the first."""
    limit: Optional[int] = None
    distinct: bool = False
    group: tuple[Term, ...] = ()
    """GROUP BY."""
    order: tuple[Ordering, ...] = ()
    """ORDER BY of more than KEY alone."""
    hidden: tuple[Selected, ...] = ()
    """Columns that it needs and does not show, after the others; see plan/select_analysis.py."""

    @property
    def aggregates(self) -> tuple[Aggregate, ...]:
        """Those of its columns that are aggregates."""
        found = (column.what for column in self.columns or ())
        return tuple(what for what in found if isinstance(what, Aggregate))

    @property
    def visible(self) -> tuple[Optional[Selected], ...]:
        """The columns that it shows; None = every field."""
        return (Selected(KeyOperand(0)), None) if self.columns is None else self.columns

    @property
    def asked(self) -> tuple[Optional[Selected], ...]:
        """All columns, also the hidden."""
        return (*self.visible, *self.hidden)

    @property
    def counts(self) -> bool:
        """Whether it asks for the number of all rows, and for nothing else."""
        alone = bool(self.aggregates) and not (self.group or self.order)
        return alone and all(a.operand is None for a in self.aggregates)

    @property
    def gathers(self) -> bool:
        """Whether a row of the result is not simply one of the topic, in its order."""
        return bool(self.aggregates or self.group or self.order or self.distinct)
