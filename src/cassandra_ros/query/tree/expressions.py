# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Computed values in statements: arithmetic, functions, and aggregates of one array.

If an operand is missing, the result is missing. Integers (a bool is 0 or 1) are exact; a product
with more than MAX_BITS is missing. Together with a float, and by ``/`` and ``sqrt``, numbers become
float64 as in IEEE 754: x / 0 is infinite, 0 / 0 and the square root of a negative number are NaN,
and numbers that are too large are infinite.

Times and durations are integer nanoseconds. A duration is the difference of two times, or a
duration times a number, rounded to a nanosecond, half to even. An undefined duration (1s / 0) is
missing, and so is one of 10^29 ns or more, where literals are not distinguished (3 million million
years). A plain number is not a duration: 5s is one, and ``field * 1s`` converts a number of
seconds.

min, max, sum and avg of an array are as those of rows (see ``accumulators``): without elements they
are missing, and len is 0.
"""

from __future__ import annotations

import math
import operator
from fractions import Fraction
from numbers import Integral, Real
from operator import itemgetter
from typing import Any, Callable, NamedTuple, Optional, Sequence

from cassandra_ros.messages.stamps import is_time
from cassandra_ros.query.tree.accumulators import total_of
from cassandra_ros.query.tree.literals import BEYOND_NS, fit_to_time, length_ns
from cassandra_ros.query.tree.syntax import (
    Call,
    DurationNs,
    FieldPath,
    Literal,
    Operand,
    StatementError,
    Term,
    TimeNs,
)

Get = Callable[[Any], Any]
"""Function from the values of a row (of OperandPlace.place) to one value; None = missing."""
INTEGER = "sum"
"""Kind of an integer of any size."""
MAX_BITS = 8192
"""Maximum size of a computed integer, bits. Python refuses to print more than 4300 digits."""
NO_NUMBERS = ("string", "time", "duration")


class Computed(NamedTuple):
    """A computed term for the rows of one table."""

    kind: str
    """ROS type, or INTEGER."""
    get: Get


class OperandPlace(NamedTuple):
    """Where an operand is in the rows of one table."""

    kind: str
    """ROS type; for an array the type of its elements."""
    place: int
    """Index of its value among the values of a row."""
    array: bool = False
    """Whether its value is a list, or the bytes of uint8[]."""


OperandFinder = Callable[[Operand, Optional[bool]], Optional[OperandPlace]]
"""Function that finds an operand; the flag says whether it must be an array (None = either). It
returns None if the table lacks the operand. StatementError: the operand is of another kind."""


def kind_name(kind: str) -> str:
    """Return the name of a kind for error texts."""
    named = {INTEGER: "an integer", "int64": "an int64"}
    return named.get(kind, f"{'an' if kind[0] in 'aeiu' and kind[:2] != 'ui' else 'a'} {kind}")


def family(kind: str) -> str:
    """Return the group of kinds that can be compared and computed with each other."""
    return kind if kind in NO_NUMBERS else "number"


def compile_term(term: Term, find: OperandFinder) -> Computed | None:
    """Compile a term to a function; None if the table lacks one of its fields.

    Raises:
        StatementError: The operation does not exist for operands of these kinds.
    """
    if isinstance(term, Literal):
        return _constant(term)
    if not isinstance(term, Call):
        field = find(term, False)
        return None if field is None else Computed(field.kind, itemgetter(field.place))
    if term.function in _OF_ARRAYS:
        return _of_array(term, find)
    if term.function == "time":
        _check_time_range(term.arguments[1])
    parts = _compile_all(term.arguments, find)
    operands = [operand for operand in parts if operand is not None]
    if len(operands) < len(parts):
        return None
    operands = _as_times(term, operands)
    families = tuple(family(operand.kind) for operand in operands)
    rule = _RULES.get((term.function, *families))
    if rule is None:
        raise StatementError(term.position, _reason(term, operands))
    kind, compute = rule
    if not kind:  # the operands are numbers
        kinds = [operand.kind for operand in operands]
        kind = "float64" if any(k.startswith("float") for k in kinds) else INTEGER
    gets = [operand.get for operand in operands]
    return Computed(kind, _unary(compute, *gets) if len(gets) == 1 else _binary(compute, *gets))


def _compile_all(terms: Sequence[Term], find: OperandFinder) -> list[Computed | None]:
    """Compile terms; all fields are looked up before the first error is raised."""
    parts: list[Computed | None] = []
    problems: list[StatementError] = []
    for term in terms:
        try:
            parts.append(compile_term(term, find))
        except StatementError as exc:
            problems.append(exc)
    if problems:
        raise problems[0]
    return parts


def fold(call: Call) -> Literal | Call:
    """Return the value of a call of constants only; StatementError: it has no value."""
    computed = compile_term(call, lambda operand, array: None)
    value = None if computed is None else computed.get(())
    if computed is None or value is None:
        raise StatementError(call.position, f"{call.text} cannot be computed")
    marks: dict[str, Callable[[int], object]] = {"time": TimeNs, "duration": DurationNs}
    return Literal(marks[computed.kind](value) if computed.kind in marks else value, call.position)


def _constant(literal: Literal) -> Computed:
    """Compile a bound literal; StatementError: nothing can be computed of its value."""
    value, kind = literal.value, ""
    length = length_ns(value)
    if length is not None:
        kind, value = "duration", length
    elif isinstance(value, TimeNs):
        kind, value = "time", int(value)
    elif is_time(value):
        kind, value = "time", fit_to_time(literal, literal.text)
    elif isinstance(value, str):
        kind = "string"
    elif isinstance(value, Integral) and not isinstance(value, bool):
        if int(value).bit_length() > MAX_BITS:
            raise StatementError(
                literal.position, f"integers in expressions have at most {MAX_BITS} bits"
            )
        kind, value = INTEGER, int(value)
    elif isinstance(value, Real) and not isinstance(value, bool):
        kind, value = "float64", float(value)
    if not kind:
        reason = (
            f"{literal.text} is not a number, time or duration, so it cannot be used in an "
            "expression"
        )
        raise StatementError(literal.position, reason)
    return Computed(kind, _always(value))


def _as_times(call: Call, parts: list[Computed]) -> list[Computed]:
    """Convert quoted times to times if they are added to or subtracted from times or durations."""
    if call.function not in ("+", "-") or not {p.kind for p in parts} & {"time", "duration"}:
        return parts
    return [
        Computed("time", _always(fit_to_time(argument, argument.text)))
        if isinstance(argument, Literal) and operand.kind == "string"
        else operand
        for argument, operand in zip(call.arguments, parts)
    ]


def _always(value: object) -> Get:
    """Return the function that gives one value for every row."""
    return lambda values: value


def _reason(call: Call, parts: list[Computed]) -> str:
    """Return why there is no rule for a call of these operands, as the text of an error."""
    kinds = " and ".join(kind_name(operand.kind) for operand in parts)
    sign = {"neg": "-"}.get(call.function, call.function)
    reason = f"{sign} cannot be computed of {kinds}"
    families = {family(operand.kind) for operand in parts}
    if call.function == "time":
        return "the messages of this topic are kept under names, so KEY is not a time"
    if families & {"time", "duration"} and "number" in families:
        return f"{reason}: a duration is written 5s or 500ms, and a number times 1s is one"
    return reason


def _unary(compute: Get, get: Get) -> Get:
    """Return the function of a row that computes a value of one operand, unless it is missing."""

    def value(values: Any) -> Any:
        x = get(values)
        return None if x is None else compute(x)

    return value


def _binary(compute: Callable[[Any, Any], Any], left: Get, right: Get) -> Get:
    def value(values: Any) -> Any:
        x = left(values)
        if x is None:
            return None
        y = right(values)
        return None if y is None else compute(x, y)

    return value


def _number(compute: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return ``compute`` for numbers; an integer beyond all floats becomes infinite."""

    def value(x: Any, y: Any) -> Any:
        try:
            return compute(x, y)
        except OverflowError:
            return compute(to_float(x), to_float(y))

    return value


def to_float(value: Any) -> float:
    """Return a number as a float; an integer beyond all floats is infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _divide(x: Any, y: Any) -> float:
    """Return x / y as IEEE 754 defines it, where Python raises an error."""
    if y == 0:
        sign = math.copysign(1.0, y) * (1 if x > 0 else -1)
        return math.nan if x == 0 or x != x else sign * math.inf
    try:
        return float(x / y)
    except OverflowError:
        if isinstance(x, int) and isinstance(y, int):
            return math.inf if (x > 0) == (y > 0) else -math.inf
        return to_float(x) / to_float(y)


def _root(x: Any) -> float:
    if x < 0:
        return math.nan
    try:
        return math.sqrt(x)
    except OverflowError:
        return to_float(math.isqrt(x))


def _multiply(x: Any, y: Any) -> Any:
    """Return x * y; None for an integer of too many bits."""
    product = x * y
    return None if isinstance(product, int) and product.bit_length() > MAX_BITS else product


def _bounded(ns: int) -> int | None:
    """Return a duration; None for one beyond all literals, see BEYOND_NS."""
    return ns if abs(ns) < BEYOND_NS else None


def _scale(ns: int, factor: Any) -> int | None:
    if isinstance(factor, float) and not math.isfinite(factor):
        return None
    return _bounded(round(ns * Fraction(factor)))


def _divide_length(ns: int, divisor: Any) -> int | None:
    if divisor == 0 or divisor != divisor:
        return None
    return 0 if abs(divisor) == math.inf else _bounded(round(ns / Fraction(divisor)))


def _check_time_range(length: Term) -> None:
    """Check the argument of ``time``: a constant duration longer than 0."""
    constant = isinstance(length, Literal) and _constant(length)
    if not constant or constant.kind != "duration" or constant.get(()) <= 0:
        reason = f"time takes a duration longer than 0, as time(10s), not {length.text}"
        raise StatementError(length.position, reason)


_ADD, _SUBTRACT = _number(operator.add), _number(operator.sub)
_RULES: dict[tuple[str, ...], tuple[str, Callable[..., Any]]] = {
    ("+", "number", "number"): ("", _ADD),
    ("+", "time", "duration"): ("time", operator.add),
    ("+", "duration", "time"): ("time", operator.add),
    ("+", "duration", "duration"): ("duration", lambda a, b: _bounded(a + b)),
    ("-", "number", "number"): ("", _SUBTRACT),
    ("-", "time", "time"): ("duration", operator.sub),
    ("-", "time", "duration"): ("time", operator.sub),
    ("-", "duration", "duration"): ("duration", lambda a, b: _bounded(a - b)),
    ("*", "number", "number"): ("", _number(_multiply)),
    ("*", "duration", "number"): ("duration", _scale),
    ("*", "number", "duration"): ("duration", lambda factor, ns: _scale(ns, factor)),
    ("/", "number", "number"): ("float64", _divide),
    ("/", "duration", "number"): ("duration", _divide_length),
    ("/", "duration", "duration"): ("float64", _divide),
    ("neg", "number"): ("", operator.neg),
    ("neg", "duration"): ("duration", operator.neg),
    ("abs", "number"): ("", abs),
    ("abs", "duration"): ("duration", abs),
    ("sqrt", "number"): ("float64", _root),
    ("time", "time", "duration"): ("time", lambda t, length: t - t % length),
}
"""Result kind and function, by operator and operand kinds. Kind '' = float64 if an operand is a
float, else INTEGER."""
_OF_ARRAYS = ("len", "min", "max", "sum", "avg")


def _of_array(call: Call, find: OperandFinder) -> Computed | None:
    """Compile one of _OF_ARRAYS, as compile_term does; ``len`` also of a text."""
    array, function = call.arguments[0], call.function
    if not isinstance(array, FieldPath):
        reason = f"{function} takes an array here, and {array.text} is not an array"
        raise StatementError(array.position, reason)
    field = find(array, None if function == "len" else True)
    if field is None:
        return None
    if function == "len":
        if not field.array and field.kind != "string":
            reason = f"{array.text} is {kind_name(field.kind)}: len is for arrays and text"
            raise StatementError(call.position, reason)
        return Computed(INTEGER, _unary(len, itemgetter(field.place)))
    if function in ("sum", "avg") and field.kind in NO_NUMBERS:
        reason = f"{array.text} holds values of type {field.kind}, and {function} is for numbers"
        raise StatementError(call.position, reason)
    total = "float64" if field.kind.startswith("float") else INTEGER
    kind = {"sum": total, "avg": "float64"}.get(function, field.kind)
    get = itemgetter(field.place)
    return Computed(kind, _unary(lambda values: total_of(function, values), get))
