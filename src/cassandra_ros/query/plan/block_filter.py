# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conditions on whole blocks of messages, with numpy: masks of the messages that may match.

A mask may be true for messages that do not match, but is never false for one that does. It is sure
of numbers, bools, times and equal texts outside arrays of messages, and of ANY and ALL of an array
of numbers, in messages that share their layout with others. If an array of messages is unnested, a
message passes if any element may match. Other conditions (NOT, LIKE, NULL, KEY, arithmetic) leave
no message out. ``compile_condition`` checks the messages again of which a mask is not sure.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Collection, NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.message_stacks import (
    DTYPES,
    NumberArray,
    Stack,
    planes_of,
    stacker,
)
from cassandra_ros.query.protocols import UnpackedMessages
from cassandra_ros.query.tree.expressions import to_float
from cassandra_ros.query.tree.field_names import FieldRef, field_of
from cassandra_ros.query.tree.literals import fitting
from cassandra_ros.query.tree.syntax import (
    All,
    Call,
    Compare,
    Either,
    Expression,
    FieldPath,
    Leaf,
    Literal,
    Negation,
    OneOf,
    Quantified,
    StatementError,
    wants_array,
)
from cassandra_ros.read import Sifted

Mask = NDArray[np.bool_]
Sift = Callable[[UnpackedMessages], Sifted]
"""Function from a block to the messages that may match."""
_Mask = Callable[[Stack], Mask]


class _Test(NamedTuple):
    """A part of a condition."""

    mask: _Mask
    """Function from messages of one layout to a bool for each: it may match."""
    is_exact: bool
    """Whether a message for which it is true matches the part."""


_Compare = Callable[[NumberArray], Mask]
"""Function from numbers to a bool for each: the comparison is true."""
_Get = Callable[[Stack], NumberArray]

_WHOLE = {"uint32": "time", "int32": "duration"}
"""Type of the field by the type of its secs and nsecs."""


def compile_sift(
    expression: Expression, definition: Definition, nan: Collection[str] = ()
) -> Sift | None:
    """Return the filter of blocks of one type; None if the condition leaves no message out.

    A message that is in no stack passes: it is malformed, or few messages have its layout.

    Args:
        nan: Paths of fields that satisfy a lower bound if they are NaN.
    """
    refs: list[FieldRef] = []
    compiled, finder = _compile(expression, definition, refs, nan), stacker(definition)
    if compiled is None:
        return None
    test, is_exact = compiled
    # Fields before the first variable one have the same offset in messages of any size.
    by_head = all(_is_plain(ref) and ref.column in finder.head for ref in refs)

    def sift(block: UnpackedMessages) -> Sifted:
        mask, unsure = np.ones(len(block), np.bool_), np.ones(len(block), np.bool_)
        groups = [(planes_of(g.stored, g.rises), g.members) for g in block.groups]
        if by_head and len(groups) > 1:
            # What follows the heads may be malformed, so such a message has no fields at all.
            stacks = [finder.heads(groups)]
        else:
            stacks = [stack for group in groups for stack in finder.stacks(*group)[0]]
        with np.errstate(invalid="ignore"):  # signalling NaNs
            for stack in stacks:
                mask[stack.members] = test(stack)
                unsure[stack.members] = not (is_exact and stack.is_whole)
        return Sifted(None if mask.all() else mask, unsure)

    return sift


def _is_plain(ref: FieldRef) -> bool:
    return ref.index is None and not ref.is_array and not any(step.many for step in ref.steps)


def _compile(
    expression: Expression, definition: Definition, refs: list[FieldRef], nan: Collection[str]
) -> _Test | None:
    """Compile a condition to a test, and append the fields that it reads to ``refs``."""
    if isinstance(expression, Negation):
        return None
    if isinstance(expression, (All, Either)):
        all_tests = [_compile(item, definition, refs, nan) for item in expression.items]
        tests = [test for test in all_tests if test is not None]
        either, partly = isinstance(expression, Either), len(tests) < len(all_tests)
        if not tests or (either and partly):
            return None
        mask = _join([test.mask for test in tests], np.logical_or if either else np.logical_and)
        return _Test(mask, not partly and all(test.is_exact for test in tests))
    return _leaf_test(expression, definition, refs, nan)


def _join(tests: Sequence[_Mask], join: Any) -> _Mask:
    def test(stack: Stack) -> Mask:
        mask = tests[0](stack)
        for other in tests[1:]:
            mask = join(mask, other(stack))
        return mask

    return test


def _leaf_test(
    leaf: Leaf, definition: Definition, refs: list[FieldRef], nan: Collection[str]
) -> _Test | None:
    """Compile a leaf like _compile; None if it leaves no message out."""
    if isinstance(leaf, Quantified):
        return _quantifier_test(leaf, definition, refs)
    if isinstance(leaf, Compare) and isinstance(leaf.operand, Call):
        # The minimum or maximum satisfies such a comparison only if some element does.
        call = leaf.operand
        of_array = call.function in ("min", "max") and leaf.operator != "LIKE"
        array = call.arguments[0] if of_array else None
        if isinstance(array, FieldPath):
            test = _elements_test(array, leaf.operator, leaf.value, np.any, definition, refs)
            return None if test is None else test._replace(is_exact=False)
    if not isinstance(leaf, (Compare, OneOf)) or not isinstance(leaf.operand, FieldPath):
        return None
    operator = leaf.operator if isinstance(leaf, Compare) else "="
    try:
        ref = field_of(leaf.operand, definition, wants_array(leaf))
    except StatementError:
        return _NEVER  # this definition lacks the field, and a missing value never matches
    refs.append(ref)
    values = list(fitting(leaf, ref))
    takes_nan = ref.column in nan and operator in (">", ">=") and ref.type in _FLOATS
    if not values:
        return None if takes_nan else _NEVER
    is_single = not any(step.many for step in ref.steps)
    if ref.type == "string":
        mask = _text_mask(ref, operator, [v for v in values if isinstance(v, str)])
        return None if mask is None else _Test(mask, is_single)
    get = _getter(ref)
    if get is None or operator == "LIKE":
        return None
    compare = _number_test(ref, operator, [v for v in values if not isinstance(v, str)])
    if takes_nan:
        compare = _or_nan(compare)
    return _Test(lambda stack: np.logical_or.reduce(compare(get(stack))), is_single)


def _quantifier_test(
    leaf: Quantified, definition: Definition, refs: list[FieldRef]
) -> _Test | None:
    """Compile ANY or ALL with one test of constants; None for any other."""
    if len(leaf.tests) != 1 or leaf.negated:
        return None
    ((operator, value),) = leaf.tests
    if not isinstance(value, Literal) or operator == "LIKE":
        return None
    join = np.all if leaf.every else np.any
    return _elements_test(leaf.operand, operator, value, join, definition, refs)


def _elements_test(
    array: FieldPath,
    operator: str,
    value: Literal,
    join: Any,
    definition: Definition,
    refs: list[FieldRef],
) -> _Test | None:
    """Compile a test of the elements of an array of numbers; ``join`` is np.any or np.all."""
    try:
        ref = field_of(array, definition, array=True)
    except StatementError:
        return _NEVER
    get = _getter(ref)
    if ref.type == "string" or get is None:
        return None
    numbers = list(fitting(Compare(array, operator, value), ref))
    if not numbers:
        return _NEVER
    refs.append(ref)
    compare = _number_test(ref, operator, numbers)
    return _Test(lambda stack: join(compare(get(stack)), axis=0), True)


_NS = ("time", "duration")
_FLOATS = ("float32", "float64")


def _never(stack: Stack) -> Mask:
    """Return that no message of a stack matches."""
    return np.zeros(stack.planes.shape[1], np.bool_)


_NEVER = _Test(_never, True)


def _chosen_offsets(ref: FieldRef) -> slice | None:
    """Return which of the offsets that a layout lists for a field a path selects; None: unknown."""
    many = [step for step in ref.steps if step.many]
    indexes = [step.index for step in many if step.index is not None]
    if not indexes:
        return slice(None)
    # Inside another array the index of an element does not determine its offset.
    return slice(indexes[0], indexes[0] + 1) if len(many) == 1 else None


def _getter(ref: FieldRef) -> _Get | None:
    """Return the function that reads a number: (offsets, messages); None: unknown offsets."""
    base = _WHOLE[ref.type] if ref.part else ref.type
    path, chosen = ref.column, _chosen_offsets(ref)
    many = any(step.many for step in ref.steps)
    index = ref.index
    if chosen is None or (many and (ref.is_array or index is not None)):
        return None
    if ref.is_array:
        return lambda stack: stack.array(path, base)
    if index is not None:
        at = index
        return _time_part(ref.part, lambda stack: stack.element(path, at, base))
    return _time_part(ref.part, lambda stack: stack.numbers(path, base, chosen))


def _time_part(time_part: str, get: _Get) -> _Get:
    """Return the function that reads secs or nsecs of a time, or the whole time."""
    if time_part == "secs":
        return lambda stack: get(stack) // SECOND_NS
    if time_part == "nsecs":
        return lambda stack: get(stack) % SECOND_NS
    return get


def _text_mask(ref: FieldRef, operator: str, values: Sequence[str]) -> _Mask | None:
    """Compile a test for equal texts; None for values that bytes cannot be compared with."""
    chosen, path = _chosen_offsets(ref), ref.column
    many = any(step.many for step in ref.steps)
    if ref.index is not None:
        chosen = None if many else slice(ref.index, ref.index + 1)
    elif ref.is_array and many and chosen != slice(None):
        chosen = None  # earlier elements may hold any number of texts
    if operator not in ("=", "CONTAINS") or chosen is None:
        return None
    # Bytes that are not UTF-8 are read as this character.
    if any("\N{REPLACEMENT CHARACTER}" in value for value in values):
        return None
    # Texts that were read contain no surrogates.
    raws = {v.encode("utf-8") for v in values if v.isascii() or _has_utf8(v)}
    where: slice = chosen

    def test(stack: Stack) -> Mask:
        mask = _never(stack)
        for at, size in stack.layout.texts.get(path, [])[where]:
            for raw in raws:
                if len(raw) == size:
                    same = stack.planes[at : at + size] == np.frombuffer(raw, np.uint8)[:, None]
                    mask |= same.all(axis=0)
        return mask

    return test


def _has_utf8(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _number_test(ref: FieldRef, operator: str, values: Sequence[Any]) -> _Compare:
    """Compile the comparison of a field's numbers with the values of a condition."""
    dtype = np.dtype(np.int64) if ref.part or ref.type in _NS else DTYPES[ref.type]
    if operator in ("=", "CONTAINS"):
        return _one_of(dtype, values)
    return _comparison(dtype, operator, values[0])


def _comparison(dtype: np.dtype[Any], operator: str, value: Any) -> _Compare:
    """Compile a comparison (not =) of numbers of a type that is exact, like Python's."""
    below, above = _neighbours(dtype, value)
    if value != value:
        return _all_true if operator == "!=" else _all_false
    if operator == "!=":
        return _all_true if below is None or below != above else lambda x: x != below
    # A value between two numbers of the type equals none of them, so the neighbour itself passes.
    # NaN never does.
    closed = operator in ("<=", ">=") or below is None or above is None or below != above
    if operator in ("<", "<="):
        if below is None:
            return _all_false
        return (lambda x: x <= below) if closed else lambda x: x < below
    if above is None:
        return _all_false
    return (lambda x: x >= above) if closed else lambda x: x > above


def _or_nan(compare: _Compare) -> _Compare:
    return lambda numbers: compare(numbers) | np.isnan(numbers)


def _all_true(numbers: NumberArray) -> Mask:
    return np.ones(numbers.shape, np.bool_)


def _all_false(numbers: NumberArray) -> Mask:
    return np.zeros(numbers.shape, np.bool_)


def _one_of(dtype: np.dtype[Any], values: Sequence[Any]) -> _Compare:
    """Compile the test whether a number equals one of some values, as exact as _comparison."""
    numbers = []
    for value in values:
        below, above = _neighbours(dtype, value) if value == value else (None, None)
        if below is not None and below == above:
            numbers.append(below)
    if len(numbers) == 1:
        only = numbers[0]
        return lambda x: x == only
    array = np.array(numbers, dtype)
    return lambda x: np.isin(x, array)


def _neighbours(dtype: np.dtype[Any], value: Any) -> tuple[Any, Any]:
    """Return the largest number of a type that is <= a value, and the smallest that is >= it.

    They are equal if the type can hold the value. None: the type has no such number.
    """
    if value != value:
        return None, None
    if dtype.kind == "f":
        return float_neighbours(dtype, value)
    ends = np.iinfo(dtype)
    low, high = int(ends.min), int(ends.max)
    below = high if value > high else None if value < low else math.floor(value)
    above = low if value < low else None if value > high else math.ceil(value)
    return (
        None if below is None else dtype.type(below),
        None if above is None else dtype.type(above),
    )


def float_neighbours(dtype: np.dtype[Any], value: Any) -> tuple[Any, Any]:
    """Return the largest float of a type that is <= a value, and the smallest that is >= it."""
    with np.errstate(over="ignore"):
        near = dtype.type(to_float(value))
        # Converted to Python numbers, which compare exactly.
        if float(near) == value:
            return near, near
        if float(near) < value:
            return near, np.nextafter(near, dtype.type(math.inf))
        return np.nextafter(near, dtype.type(-math.inf)), near
