# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a statement means, in plain Python over message objects of genpy.

Nothing of the package is used here: numbers are compared as fractions, text one code point after
the other, and every element of an array is chosen in its turn. A condition is a small tree, which
is written as CQL and evaluated.
"""

from __future__ import annotations

import functools
import itertools
import math
import random
from collections import namedtuple
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import genpy
import genpy.dynamic
import numpy

LIKE_KINDS = {kind: {kind} for kind in ("text", "time", "duration")}
LIKE_KINDS.update(dict.fromkeys(("number", "bool"), {"number", "bool"}))
"""By the kind of one side of a comparison those of the other."""
MISSING = type("Missing", (), {"__repr__": lambda self: "MISSING"})()
KEY, NODE, RUN = "KEY", "NODE", "RUN"
LONGEST_NS = 10**29
"""Limit of the length of a computed duration, ns."""
RUN_NAMES = {1: "dawn", 2: "noon's"}
"""Name of the run by writer; runs of other writers have no name, or do not exist."""
PARTS = {"time": "uint32", "duration": "int32"}
FIELD_KINDS = {"bool": "bool", "string": "text", "time": "time", "duration": "duration"}

Message = namedtuple("Message", "t node seq types value")
"""A stored message: value is an object of types.root, None where its bytes are no message."""


class Types:
    """The classes of a message type and of all that it uses, made by genpy from their text."""

    def __init__(self, name, text):
        self.name, self.text = name, text
        self.classes = genpy.dynamic.generate_dynamic(name, text)
        self.root = self.classes[name]
        self.md5sum = self.root._md5sum

    def fields(self, name):
        """Yield (attribute, type, length) of the fields of a type; length '' = any, None = one."""
        made = self.classes[name]
        for attribute, kind in zip(made.__slots__, made._slot_types):
            base, bracket, length = kind.partition("[")
            yield attribute, base, length[:-1] if bracket else None

    def field(self, name, attribute):
        """Return (type, length) of one field, None where there is no such one."""
        found = [f[1:] for f in self.fields(name) if f[0] == attribute]
        return found[0] if found else None


@dataclass(frozen=True)
class Path:
    """A field: names with their indexes; part is 'secs' or 'nsecs'."""

    steps: tuple[tuple[str, int | None], ...]
    part: str = ""

    @property
    def text(self):
        shown = [name if index is None else f"{name}[{index}]" for name, index in self.steps]
        return ".".join([*shown, self.part] if self.part else shown)

    def kind(self, types):
        """Return (kind, whether it is an array as a whole), None where there is no such field.

        Kinds are number, bool, text, time and duration.
        """
        name, array = types.name, False
        for attribute, index in self.steps:
            found = types.field(name, attribute) if "/" in name else None
            if found is None or (found[1] is None and index is not None):
                return None
            name, array = found[0], found[1] is not None and index is None
        if self.part:
            name = PARTS[name]
        return FIELD_KINDS.get(name, "number"), array

    def unnested(self, types):
        """List the arrays of messages inside of which it lies, outermost first."""
        name, found = types.name, []
        for n, (attribute, index) in enumerate(self.steps):
            known = types.field(name, attribute) if "/" in name else None
            if known is None or (known[1] is None and index is not None):
                return []
            name = known[0]
            many = known[1] is not None and index is None and "/" in name
            if many and n + 1 < len(self.steps):
                found.append(self.steps[: n + 1])
        return found


@dataclass(frozen=True)
class Value:
    """What an operand is compared with, and how that may be written."""

    wanted: Any
    """int, float, bool or str; times as ns."""
    kind: str
    """number, bool, text, time or duration: of a parameter or literal of this value."""
    texts: tuple[str, ...] = ()
    params: tuple[Any, ...] = field(default=(), compare=False)


@dataclass(frozen=True)
class Op:
    """What is computed: ``+ - * /``, neg, abs, sqrt, time; of an array len, min, max, sum, avg."""

    function: str
    arguments: tuple[Any, ...]
    kind: str
    """number, text, time or duration."""


@dataclass(frozen=True)
class Related:
    """Two operands beside one another."""

    left: Any
    sign: str
    right: Any


@dataclass(frozen=True)
class AnyAll:
    """ANY or ALL of an array; sign may be BETWEEN, IN and LIKE, values are operands or Values."""

    array: Path
    every: bool
    sign: str
    values: tuple[Any, ...]
    negated: bool = False


@dataclass(frozen=True)
class Leaf:
    """A comparison; sign is an operator in upper case, NULL for IS NULL."""

    operand: Any
    sign: str
    values: tuple[Value, ...] = ()
    negated: bool = False
    """NOT IN, NOT LIKE, IS NOT NULL …"""


@dataclass(frozen=True)
class Not:
    item: Any


@dataclass(frozen=True)
class Joined:
    """AND or OR of several."""

    word: str
    items: tuple[Any, ...]


def leaves(tree):
    if isinstance(tree, LEAVES):
        return [tree]
    items = [] if tree is None else [tree.item] if isinstance(tree, Not) else tree.items
    return [leaf for item in items for leaf in leaves(item)]


LEAVES = (Leaf, Related, AnyAll)


def operands_of(tree):
    """List what is named in a condition, an operand or a Value."""
    if isinstance(tree, Op):
        return [o for argument in tree.arguments for o in operands_of(argument)]
    if isinstance(tree, Related):
        return operands_of(tree.left) + operands_of(tree.right)
    if isinstance(tree, AnyAll):
        return [tree.array, *(o for value in tree.values for o in operands_of(value))]
    if isinstance(tree, Leaf):
        return operands_of(tree.operand)
    return [] if tree is None or isinstance(tree, Value) else [tree]


def compare(sign, value, wanted):
    if isinstance(value, str):
        beside = next(((a, b) for a, b in zip(value, wanted) if a != b), None)
        a, b = map(ord, beside) if beside else (len(value), len(wanted))
        order = (a > b) - (a < b)
    else:
        if value != value or wanted != wanted:
            return sign == "!="
        if math.inf in (abs(value), abs(wanted)):
            value, wanted = (x if abs(x) == math.inf else 0 for x in (value, wanted))
        else:
            value, wanted = Fraction(value), Fraction(wanted)
        order = (value > wanted) - (value < wanted)
    return {
        "=": order == 0,
        "!=": order != 0,
        "<": order < 0,
        "<=": order <= 0,
        ">": order > 0,
        ">=": order >= 0,
    }[sign]


def like(text, pattern):
    """Match from the left; where that fails the last % takes one code point more."""
    at = place = 0
    back = None
    while at < len(text):
        if place < len(pattern) and pattern[place] == "%":
            place += 1
            back = (at, place)
        elif place < len(pattern) and pattern[place] in ("_", text[at]):
            at, place = at + 1, place + 1
        elif back is not None:
            back = (back[0] + 1, back[1])
            at, place = back
        else:
            return False
    return set(pattern[place:]) <= {"%"}


def both(results):
    """AND of three values."""
    found = list(results)
    return False if False in found else None if None in found else True


def either(results):
    """OR of three values."""
    found = list(results)
    return True if True in found else None if None in found else False


def inverted(result):
    return None if result is None else not result


def comparable(kind, value):
    """Whether values of a kind of field can be compared with a value."""
    if kind in ("text", "time", "duration"):
        return value.kind == kind
    return value.kind == "number" or value.kind == kind == "bool"


class Row:
    """One message, with an element chosen of each array that the statement unnests."""

    def __init__(self, message, chosen):
        self.message, self.chosen = message, chosen

    def value(self, operand):
        """Return the value of an operand, times as ns; MISSING if the message has no such value."""
        if isinstance(operand, Value):
            return operand.wanted
        if isinstance(operand, Op):
            values = [self.value(argument) for argument in operand.arguments]
            kinds = [self.kind(argument) for argument in operand.arguments]
            return MISSING if MISSING in values else computed(operand.function, values, kinds)
        if operand == KEY:
            return self.message.t
        if operand == NODE:
            return self.message.node
        if operand == RUN:
            return RUN_NAMES.get(self.message.seq[0], str(self.message.seq[0]))
        if self.message.value is None or operand.kind(self.message.types) is None:
            return MISSING
        found = inside(self.message.value, operand.steps, self.chosen)
        if found is MISSING:
            return MISSING
        if operand.part:
            return divmod(found.to_nsec(), 10**9)[operand.part == "nsecs"]
        return plain(found)

    def kind(self, operand):
        if isinstance(operand, (Op, Value)):
            return operand.kind
        if operand in (KEY, NODE, RUN):
            return "time" if operand == KEY else "text"
        return (operand.kind(self.message.types) or (None,))[0]

    def holds(self, tree):
        """Return True, False, or None for unknown."""
        if tree is None:
            return True
        if isinstance(tree, Not):
            return inverted(self.holds(tree.item))
        if isinstance(tree, Joined):
            return {"AND": both, "OR": either}[tree.word](map(self.holds, tree.items))
        if isinstance(tree, Related):
            left, right = self.value(tree.left), self.value(tree.right)
            return None if MISSING in (left, right) else compare(tree.sign, left, right)
        if isinstance(tree, AnyAll):
            return self.quantified(tree)
        found = self.tested(tree)
        return inverted(found) if tree.negated else found

    def quantified(self, tree):
        array, wanted = self.value(tree.array), [self.value(value) for value in tree.values]
        if array is MISSING or not isinstance(array, (list, bytes)) or MISSING in wanted:
            return None
        if not {self.kind(value) for value in tree.values} <= LIKE_KINDS[self.kind(tree.array)]:
            return None
        found = [self.passes(tree.sign, element, wanted) != tree.negated for element in array]
        return all(found) if tree.every else any(found)

    @staticmethod
    def passes(sign, element, wanted):
        if sign == "BETWEEN":
            return compare(">=", element, wanted[0]) and compare("<=", element, wanted[1])
        if sign == "IN":
            return any(compare("=", element, value) for value in wanted)
        return like(element, *wanted) if sign == "LIKE" else compare(sign, element, *wanted)

    def tested(self, leaf):
        value, sign = self.value(leaf.operand), leaf.sign
        if sign == "NULL":
            return value is MISSING
        if value is MISSING:
            return None
        kind = self.kind(leaf.operand)
        if sign == "BETWEEN":
            return both(
                compare(s, value, v.wanted) if comparable(kind, v) else None
                for s, v in zip((">=", "<="), leaf.values)
            )
        if sign == "IN":
            return either(
                compare("=", value, v.wanted) if comparable(kind, v) else None for v in leaf.values
            )
        (wanted,) = leaf.values
        if not comparable(kind, wanted):
            return None
        if sign == "CONTAINS":
            # In some definition it may be no array.
            held = isinstance(value, (list, bytes))
            return contains(value, wanted.wanted) if held else None
        if sign == "LIKE":
            return like(value, wanted.wanted)
        return compare(sign, value, wanted.wanted)


def computed(function, values, kinds):
    """What a function makes of values that are all there."""
    if function in ("len", "min", "max", "sum", "avg"):
        if function in ("sum", "avg") and kinds[0] not in ("number", "bool"):
            return MISSING
        found = TOTALS[{"len": "count"}.get(function, function)](list(values[0]))
        return MISSING if found is None else found
    if function == "time":
        return values[0] // values[1] * values[1]
    if "time" in kinds or (kinds.count("duration") == len(kinds) and function != "/"):
        signs = {"neg": int.__neg__, "abs": abs, "+": int.__add__, "-": int.__sub__}
        found = signs[function](*values)
        return found if abs(found) < LONGEST_NS else MISSING
    if "duration" in kinds and kinds != ["duration", "duration"]:
        if kinds[0] != "duration":
            values = values[::-1]
        ns, factor = values
        if factor != factor or (function == "/" and factor == 0):
            return MISSING
        if abs(factor) == math.inf:
            return 0 if function == "/" else MISSING
        exact = Fraction(factor)
        found = round(ns * exact if function == "*" else ns / exact)
        return found if abs(found) < LONGEST_NS else MISSING
    return of_numbers(function, *values)


def of_numbers(function, x, y=0):
    whole = not isinstance(x, float) and not isinstance(y, float)
    if function == "sqrt":
        with numpy.errstate(all="ignore"):
            return float(numpy.sqrt(numpy.float64(rounded(x))))
    if function == "/" and whole and y:
        return rounded(Fraction(int(x), int(y))) if x else math.copysign(0.0, y)
    if function in ("neg", "abs"):
        return -x if function == "neg" or x < 0 or (x == 0 and str(x)[0] == "-") else +x
    if whole and function != "/":
        x, y = int(x), int(y)
        return {"+": x + y, "-": x - y, "*": x * y}[function]
    a, b = (numpy.float64(v if isinstance(v, float) else rounded(Fraction(v))) for v in (x, y))
    with numpy.errstate(all="ignore"):
        return float({"+": a + b, "-": a - b, "*": a * b, "/": a / b}[function])


def contains(values, wanted):
    if isinstance(wanted, str) or wanted != wanted or abs(wanted) == math.inf:
        return any(value == wanted for value in values)
    exact = Fraction(wanted)
    return any(value == exact for value in values)


def inside(value, steps, chosen):
    """Follow names, indexes and chosen elements through message objects."""
    for n, (name, index) in enumerate(steps):
        value = getattr(value, name)
        if index is None:
            index = chosen.get(steps[: n + 1])
        if index is not None:
            if index >= len(value):
                return MISSING
            value = value[index]
    return value


def plain(value):
    """Return what a query gives for the value of a message object's attribute."""
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return value.to_nsec()
    if isinstance(value, (list, tuple)):
        return [plain(element) for element in value]
    return value


def rows_of(message, operands):
    """Yield the rows of a message in a statement that names these operands."""
    if message.value is None:
        yield Row(message, {})
        return
    named = [o for operand in operands for o in operands_of(operand)]
    found = [a for o in named if isinstance(o, Path) for a in o.unnested(message.types)]
    arrays = sorted(set(found), key=len)
    yield from (Row(message, chosen) for chosen in _chosen(message, arrays, {}))


def _chosen(message, arrays, chosen):
    if not arrays:
        yield chosen
        return
    array = inside(message.value, arrays[0], chosen)
    for n in range(0 if array is MISSING else len(array)):
        yield from _chosen(message, arrays[1:], {**chosen, arrays[0]: n})


@dataclass(frozen=True)
class Statement:
    """A SELECT: columns are operands, or (function, operand) with operand None for ``*``."""

    columns: tuple[Any, ...]
    condition: Any = None
    descending: bool = False
    limit: int | None = None
    distinct: bool = False
    group: tuple[Any, ...] = ()
    """Each of them is one of the columns."""
    order: tuple[tuple[Any, bool], ...] = ()
    """Column or operand, and whether the greatest comes first; with a group columns alone."""

    @property
    def aggregated(self):
        return not self.group and isinstance(self.columns[0], tuple)

    @property
    def operands(self):
        named = [c[1] if isinstance(c, tuple) else c for c in self.columns]
        named += [o for o, _ in self.order if not isinstance(o, tuple)]
        return [o for o in named if o is not None] + leaves(self.condition)

    def answer(self, messages):
        """Return the rows that the statement means, over messages in any order."""
        ordered = sorted(messages, key=lambda m: m[:3], reverse=self.descending)
        rows = [
            row
            for message in ordered
            for row in rows_of(message, self.operands)
            if row.holds(self.condition) is True
        ]
        if self.aggregated:
            return [tuple(canonical(self._total(rows, *column)) for column in self.columns)]
        found = self._grouped(rows) if self.group else [self._single(row) for row in rows]
        if self.distinct:
            shown = len(self.columns)
            found = list({tuple(map(alike, row[:shown])): row for row in found[::-1]}.values())
            found.sort(key=lambda row: row[-1])
        for place, (_, down) in reversed(list(enumerate(self.order))):
            at = place + len(self.columns)
            found.sort(key=functools.cmp_to_key(functools.partial(beside, at, down)))
        shown = (tuple(map(canonical, row[: len(self.columns)])) for row in found)
        return list(itertools.islice(shown, self.limit))

    def _single(self, row):
        """The columns, what they are ordered by, and a number that rises."""
        number = next(_NUMBERS)
        return (*map(row.value, (*self.columns, *(o for o, _ in self.order))), number)

    def _grouped(self, rows):
        groups = {}
        for row in rows:
            groups.setdefault(tuple(alike(row.value(o)) for o in self.group), []).append(row)
        found = []
        for members in groups.values():
            columns = (*self.columns, *(column for column, _ in self.order))
            values = [
                self._total(members, *c) if isinstance(c, tuple) else members[0].value(c)
                for c in columns
            ]
            found.append((*values, next(_NUMBERS)))
        return found

    @staticmethod
    def _total(rows, function, operand):
        if operand is None:
            return len(rows)
        values = [v for v in (row.value(operand) for row in rows) if v is not MISSING]
        return TOTALS[function](values)


_NUMBERS = itertools.count()


def alike(value):
    """What is equal for values that make one group."""
    if isinstance(value, (list, tuple, bytes)):
        return tuple(map(alike, value))
    return "NaN" if value is not MISSING and value != value else value


def beside(at, down, one, other):
    """Compare two rows; NaN sorts after all numbers, missing values last."""
    a, b = one[at], other[at]
    ranks = [2 if v is MISSING or v is None else 1 if v != v else 0 for v in (a, b)]
    if ranks != [0, 0]:
        return ranks[0] - ranks[1]
    order = compare(">", a, b) - compare("<", a, b)
    return -order if down else order


def _numbers(values):
    return [value for value in values if value == value]


def _sum(values):
    if not values:
        return None
    odd = [v for v in values if isinstance(v, float) and not math.isfinite(v)]
    if odd:
        return sum(odd)
    exact = sum(map(Fraction, values))
    return rounded(exact) if any(isinstance(v, float) for v in values) else int(exact)


def _mean(values):
    if not values:
        return None
    odd = [v for v in values if isinstance(v, float) and not math.isfinite(v)]
    return sum(odd) if odd else rounded(sum(map(Fraction, values)) / len(values))


def rounded(exact):
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


TOTALS = {
    "count": len,
    "min": lambda values: min(_numbers(values), default=None),
    "max": lambda values: max(_numbers(values), default=None),
    "sum": _sum,
    "avg": _mean,
}


def canonical(value):
    """Return a value such that the same is equal: NaN to NaN, −0.0 not to 0.0, 1 not to 1.0."""
    if value is MISSING or value is None:
        return None
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return value.to_nsec()
    if isinstance(value, (list, tuple)):
        return [canonical(element) for element in value]
    if isinstance(value, float):
        return f"float {value!r}"
    return f"bool {value}" if isinstance(value, bool) else value


class Writer:
    """Writes statements as CQL, each time in another way.

    Args:
        seed: Of the ways; 0 = the plainest.
    """

    def __init__(self, seed):
        self._random = random.Random(seed)
        self._plain = seed == 0
        self.params = []
        """Values of the ``?`` so far."""

    def statement(self, statement, topic):
        """Return the statement as text; its parameters are in ``params``."""
        columns = ",".join(self._gap(self._column(column)) for column in statement.columns)
        select = f"{self._word('select')} {self._word('distinct') if statement.distinct else ''}"
        text = f"{select} {columns} {self._word('from')} {topic}"
        if statement.condition is not None:
            text += f" {self._word('where')} {self.condition(statement.condition)}"
        if statement.group:
            text += f" {self._words('group by')} {', '.join(map(self._operand, statement.group))}"
        if statement.order:
            parts = [
                self._column(o) + (f" {self._word('desc')}" if down else "")
                for o, down in statement.order
            ]
            text += f" {self._words('order by')} {', '.join(parts)}"
        elif statement.group:
            pass
        elif statement.descending:
            text += f"{self._space()}{self._words('order by')} KEY {self._word('desc')}"
        elif self._chance(0.1):
            text += f" {self._words('order by')} KEY" + self._random.choice(["", " asc", " ASC"])
        if statement.limit is not None:
            text += f" {self._word('limit')} {self._limit(statement.limit)}"
        if self._chance(0.1):
            text += f" {self._words('allow filtering')}"
        return text + self._random.choice([";", " ;", "\n"]) if self._chance(0.1) else text

    def condition(self, tree):
        """Return a condition as text."""
        if isinstance(tree, LEAVES):
            text = self._leaf(tree)
            return f"({text})" if self._chance(0.1) else text
        if isinstance(tree, Not):
            return f"{self._word('not')} {self._inner(tree.item, (*LEAVES, Not))}"
        # AND binds closer than OR: only OR inside of AND needs its parentheses.
        closer = (*LEAVES, Not) if tree.word == "AND" else (*LEAVES, Not, Joined)
        joint = tree.word
        text = self._inner(tree.items[0], closer)
        for item in tree.items[1:]:
            text += f"{self._space()}{self._word(joint)} {self._inner(item, closer)}"
        return text

    def _inner(self, tree, bare):
        same = isinstance(tree, Joined) and tree.word == "OR"
        if isinstance(tree, bare) and not same and not self._chance(0.2):
            return self.condition(tree)
        return f"({self._gap(self.condition(tree))})"

    def _related(self, leaf):
        left, sign, right = self._term(leaf.left, 1), leaf.sign, self._term(leaf.right, 1)
        return f"{left}{self._gap(sign)}{right}"

    def _quantified(self, leaf):
        word = self._word("all" if leaf.every else "any")
        array, sign = f"{word}({self._operand(leaf.array)})", leaf.sign
        negation = f"{self._word('not')} " if leaf.negated else ""
        values = [self._term(value, 1) for value in leaf.values]
        if sign == "BETWEEN":
            return (
                f"{array} {negation}{self._word(sign)} {values[0]} {self._word('and')} {values[1]}"
            )
        if sign == "IN":
            return f"{array} {negation}{self._word(sign)} ({', '.join(values)})"
        if sign == "LIKE":
            return f"{array} {negation}{self._word(sign)} {values[0]}"
        if self._chance(0.2):
            flipped = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}.get(sign, sign)
            return f"{values[0]} {flipped} {array}"
        return f"{array} {sign} {values[0]}"

    def _term(self, term, closeness=0):
        """Write an operand, in parentheses where it binds less."""
        if isinstance(term, Value):
            return self._value(term)
        if not isinstance(term, Op):
            return self._operand(term)
        function, arguments = term.function, term.arguments
        if function in ("neg", "+", "-", "*", "/"):
            own = {"+": 2, "-": 2, "*": 3, "/": 3, "neg": 4}[function]
            if function == "neg":
                text = f"- {self._term(arguments[0], 5)}"
            else:
                left, right = self._term(arguments[0], own), self._term(arguments[1], own + 1)
                text = f"{left} {function} {right}"
            return f"({text})" if own < closeness or self._chance(0.1) else text
        inner = self._term(arguments[-1] if function == "time" else arguments[0])
        return f"{self._word(function)}({self._gap(inner)})"

    def _leaf(self, leaf):
        if isinstance(leaf, Related):
            return self._related(leaf)
        if isinstance(leaf, AnyAll):
            return self._quantified(leaf)
        operand, sign = self._operand(leaf.operand), leaf.sign
        negation = f"{self._word('not')} " if leaf.negated else ""
        if sign == "NULL":
            return f"{operand} {self._word('is')} {negation}{self._word('null')}"
        if sign == "BETWEEN":
            low, high = (self._value(value) for value in leaf.values)
            return f"{operand} {negation}{self._word('between')} {low} {self._word('and')} {high}"
        if sign == "IN":
            return f"{operand} {negation}{self._word('in')}{self._list(leaf.values)}"
        if sign in ("LIKE", "CONTAINS"):
            return f"{operand} {negation}{self._word(sign)} {self._value(leaf.values[0])}"
        if sign == "!=" and self._chance(0.3):
            sign = "<>"
        return f"{operand}{self._gap(sign)}{self._value(leaf.values[0])}"

    def _list(self, values):
        params = [self._param(value) for value in values]
        if None not in params and (not values or self._chance(0.4)):
            self.params.append([param for (param,) in params])
            return " ?"
        return self._gap("(" + ",".join(self._gap(self._value(value)) for value in values) + ")")

    def _param(self, value):
        return (self._random.choice(value.params),) if value.params else None

    def _value(self, value):
        texts = value.texts[:1] if self._plain else value.texts
        if not texts or (value.params and self._chance(0.4)):
            self.params.append(self._random.choice(value.params))
            return self._random.choice(["?", "%s"])
        return self._random.choice(texts)

    def _limit(self, limit):
        if self._chance(0.3):
            self.params.append(limit)
            return "?"
        return str(limit)

    def _column(self, column):
        if not isinstance(column, tuple):
            return self._operand(column)
        function, operand = column
        inner = "*" if operand is None else self._operand(operand)
        return f"{self._word(function)}({self._gap(inner)})"

    def _operand(self, operand):
        if isinstance(operand, Op):
            return self._term(operand)
        if operand in (KEY, NODE, RUN):
            return operand
        shown = [(name, "" if index is None else f"[{index}]") for name, index in operand.steps]
        if operand.part:
            shown.append((operand.part, ""))
        if self._chance(0.1):
            # In quotes; an index closes them.
            text = ".".join(name + index for name, index in shown)
            return '"' + text.replace("[", '"[').replace("].", ']."') + '"' * ("]" != text[-1])
        dot = self._random.choice([" . ", ".\n"]) if self._chance(0.05) else "."
        return dot.join(name + index for name, index in shown)

    def _words(self, words):
        return " ".join(map(self._word, words.split()))

    def _word(self, word):
        if self._plain:
            return word.lower()
        return self._random.choice([word.lower(), word.upper(), word.title()])

    def _gap(self, text):
        return f"{self._space()}{text}{self._space()}" if self._chance(0.5) else text

    def _space(self):
        return " " if self._plain else self._random.choice([" ", " ", "  ", "\n", "\t "])

    def _chance(self, probability):
        return not self._plain and self._random.random() < probability
