# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a statement says, as a tree. Positions are indexes into its text, for the caret."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Iterator, Optional, Sequence, Tuple, Union


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


@dataclass(frozen=True)
class Literal:
    """A value to compare with: int, float, str, bool; of a parameter also others."""

    value: Any
    position: int
    bound: bool = True
    """False: a ``?`` or ``%s`` whose value is still to come."""


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


@dataclass(frozen=True)
class Aggregate:
    """``min(field)`` and its like: one value made of those of all rows."""

    function: str
    """min, max, sum, avg or count."""
    operand: Optional[Operand]
    """None = ``*``, of count only."""
    position: int

    @property
    def text(self) -> str:
        """The aggregate as a column's name."""
        return f"{self.function}({'*' if self.operand is None else self.operand.text})"


@dataclass(frozen=True)
class Selected:
    """What a statement selects, and the name that it gives it."""

    what: Union[Operand, Aggregate]
    alias: Optional[str] = None

    @property
    def text(self) -> str:
        """The column's name."""
        return self.what.text if self.alias is None else self.alias


@dataclass(frozen=True)
class Compare:
    """``operand operator value``; the operator is one of = != < <= > >= LIKE CONTAINS."""

    operand: Operand
    operator: str
    value: Literal


@dataclass(frozen=True)
class OneOf:
    """``operand IN (…)``, or ``IN ?`` with a list as parameter."""

    operand: Operand
    values: tuple[Literal, ...]
    whole: bool = False
    """The one value is still to come, and is the list itself."""


@dataclass(frozen=True)
class IsNull:
    """``operand IS NULL``."""

    operand: Operand


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


Leaf = Union[Compare, OneOf, IsNull]
Expression = Union[Leaf, All, Either, Negation]


def parts(expression: Expression) -> tuple[Expression, ...]:
    """Return the conditions of which one is made."""
    if isinstance(expression, (All, Either)):
        return expression.items
    return (expression.item,) if isinstance(expression, Negation) else ()


def given(leaf: Leaf) -> tuple[Literal, ...]:
    """Return the values that a comparison compares with."""
    if isinstance(leaf, Compare):
        return (leaf.value,)
    return leaf.values if isinstance(leaf, OneOf) else ()


def leaves(expression: Optional[Expression]) -> Iterator[Leaf]:
    """Yield the comparisons of an expression, from left to right."""
    if isinstance(expression, (Compare, OneOf, IsNull)):
        yield expression
    elif expression is not None:
        for part in parts(expression):
            yield from leaves(part)


def wants_array(leaf: Leaf) -> Optional[bool]:
    """Say whether a comparison's operand is an array as a whole; None = either."""
    if isinstance(leaf, IsNull):
        return None
    return isinstance(leaf, Compare) and leaf.operator == "CONTAINS"


def conjuncts(expression: Optional[Expression]) -> Iterator[Expression]:
    """Yield the conditions that must all hold for one to hold."""
    if isinstance(expression, All):
        for item in expression.items:
            yield from conjuncts(item)
    elif expression is not None:
        yield expression


@dataclass(frozen=True)
class Select:
    """A SELECT statement with all its values bound."""

    text: str
    columns: Optional[tuple[Selected, ...]]
    """None = ``*``; either all of them are aggregates or none is."""
    topic: str
    topic_position: int
    condition: Optional[Expression]
    descending: bool = False
    limit: Optional[int] = None

    @property
    def aggregates(self) -> tuple[Aggregate, ...]:
        """What its columns are made of; empty where they are no aggregates."""
        found = (column.what for column in self.columns or ())
        return tuple(what for what in found if isinstance(what, Aggregate))

    @property
    def counts(self) -> bool:
        """Whether it asks for the number of rows, and for nothing else."""
        return bool(self.aggregates) and all(a.operand is None for a in self.aggregates)


@dataclass(frozen=True)
class Delete:
    """A DELETE statement with all its values bound."""

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
    """The name of an index: in lower case, unless it was quoted."""

    text: str
    position: int


@dataclass(frozen=True)
class Indexed:
    """``topic (field)``: what an index is on."""

    topic: str
    topic_position: int
    field: Path


@dataclass(frozen=True)
class CreateIndex:
    """A CREATE INDEX statement."""

    text: str
    on: Indexed
    name: Optional[IndexName]
    unless_exists: bool
    """IF NOT EXISTS."""


@dataclass(frozen=True)
class DropIndex:
    """A DROP INDEX statement."""

    text: str
    index: Union[IndexName, Indexed]
    if_exists: bool


Change = Union[Delete, Truncate, CreateIndex, DropIndex]
"""What changes the store."""
