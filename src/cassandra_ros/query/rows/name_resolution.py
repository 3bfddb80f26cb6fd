# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Names and conditions of a statement in one table: where each value is, and the check of a row.

The values of a row are KEY, NODE, RUN and its time (which differs from KEY if that is a name), then
those of the named fields, then the computed values. ``NameResolver`` finds their indexes and kinds.
A topic may have several definitions. A field that one of them lacks is missing in its messages;
only a field that all of them lack is an error. Therefore errors are collected over all tables
(``Findings``).

``compile_condition`` makes the final check of every row, whatever the store has filtered.
A comparison is true, false, or unknown if a value is missing: an index beyond the end of an array,
a field that the message's definition lacks, an unreadable message. NOT of unknown is unknown; AND
is false if one side is false, OR true if one side is true. Only rows for which the whole condition
is true match. So a missing value never matches, not even under NOT. Only ``IS NULL`` is never
unknown: it is true for a missing value. NaN, '' and an empty array are values. An unnested array of
messages without elements gives no row, so that its fields are not null either.

Values compare as in Python: int with float exactly, NaN as in IEEE 754 (equal to nothing, ``!=`` to
everything), −0.0 equal to 0, text by code points, times as integer nanoseconds. ``CONTAINS``
compares each element of an array of primitives in this way. ``LIKE`` compares the whole text with a
pattern: ``%`` stands for any text, also the empty one, ``_`` for exactly one code point, every
other character for itself. There is no escape character, and case matters.

Computed values (see ``tree/expressions``) and fields of the same message compare in the same way.
``ANY(array) < x`` is true if the comparison is true for one element, ``ALL`` if it is true for
every element, also of an empty array. NOT, IN and BETWEEN after them apply to the element.

``NEAR`` is unknown if no pose of the robot is known at the time. ``EVENT`` is true or false.
"""

from __future__ import annotations

import operator
import re
from functools import partial
from typing import Any, Callable, NamedTuple, Optional, Pattern, Sequence

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.tree.expressions import (
    INTEGER,
    NO_NUMBERS,
    Computed,
    Get,
    OperandPlace,
    compile_term,
    family,
    kind_name,
)
from cassandra_ros.query.tree.field_names import (
    Array,
    FieldRef,
    all_fields,
    counted_field,
    field_of,
    fields_of,
)
from cassandra_ros.query.tree.literals import (
    Comparable,
    fit_to_field,
    fit_to_kind,
    fit_to_text,
    fit_to_time,
)
from cassandra_ros.query.tree.syntax import (
    TIMED,
    Aggregate,
    All,
    Call,
    Compare,
    Comparison,
    Either,
    Expression,
    FieldPath,
    IsNull,
    KeyOperand,
    Literal,
    Negation,
    NodeOperand,
    OneOf,
    Operand,
    Quantified,
    Relate,
    RunOperand,
    Selected,
    StatementError,
    Term,
    Timed,
    given,
    inside,
    wants_array,
)

RowValues = Sequence[Any]
"""Values of one message, or of one element of its unnested array; None = missing."""
Check = Callable[[RowValues], Optional[bool]]
"""Function from the values of a row to the truth of a condition; None = unknown."""


_SWAPPED = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.gt,
    "<=": operator.ge,
    ">": operator.lt,
    ">=": operator.le,
}
"""Operators with swapped arguments, so that ``partial`` can bind the right operand."""


def compile_condition(expression: Expression | None, fields: NameResolver) -> Check:
    """Return the check of a condition; None is always true."""
    if expression is None:
        return lambda values: True
    if isinstance(expression, Negation):
        return _negation(compile_condition(expression.item, fields))
    if isinstance(expression, (All, Either)):
        checks = [compile_condition(item, fields) for item in expression.items]
        return _join_checks(checks, isinstance(expression, Either))
    if isinstance(expression, TIMED):
        return _stay_check(expression, *fields.whereabouts())
    if isinstance(expression, Relate):
        left, right = fields.compute(expression)
        return _relation_check(expression.operator, left, right)
    if isinstance(expression, Quantified):
        return _quantifier_check(expression, fields.locate(expression), fields.compute(expression))
    if not isinstance(expression.operand, Call):
        return _leaf_check(expression, fields.locate(expression), fields)
    (get,) = fields.compute(expression)
    if get is None:
        return _leaf_check(expression, None, fields)
    # The computed value alone is checked, as if a row had no other value.
    compute, check = get, _leaf_check(expression, 0, fields)
    return lambda values: check((compute(values),))


def _leaf_check(leaf: Compare | OneOf | IsNull, place: int | None, fields: NameResolver) -> Check:
    """Return the check of the value at index ``place``; None = the table lacks the operand."""
    if isinstance(leaf, IsNull):
        return (lambda values: True) if place is None else (lambda values: values[place] is None)
    # Also without the operand: this records whether the constants fit.
    constants = [fields.fit(leaf, value) for value in given(leaf)]
    if place is None:
        return lambda values: None
    if isinstance(leaf, Compare):
        return _comparison(place, leaf.operator, constants[0])
    return _membership(place, constants)


def _stay_check(leaf: Timed, node: int, run: int, time: int) -> Check:
    """Return the check of NEAR or EVENT from the indices of the three values that it needs."""
    if leaf.stays is None:  # the topic has no tables, and therefore no rows
        return lambda values: None
    holds = leaf.stays.holds
    return lambda values: holds(values[node], values[run], values[time])


def _relation_check(sign: str, left: Get | None, right: Get | None) -> Check:
    if left is None or right is None:
        return lambda values: None
    first, second, test = left, right, _SWAPPED[sign]

    def check(values: RowValues) -> bool | None:
        x, y = first(values), second(values)
        return None if x is None or y is None else bool(test(y, x))

    return check


def _quantifier_check(leaf: Quantified, place: int | None, gets: Sequence[Get | None]) -> Check:
    """Return the check of ANY or ALL. For an empty array ANY is false and ALL true.

    Args:
        place: Index of the array among the values; None = the table lacks it.
        gets: Function of each term that an element is compared with; None = it is missing.
    """
    operands = [get for get in gets if get is not None]
    if place is None or len(operands) < len(gets):
        return lambda values: None
    signs = [sign for sign, _ in leaf.tests]
    quantify = all if leaf.every else any
    fixed = None  # the test of an element, if it is the same for all rows
    if all(isinstance(term, Literal) for _, term in leaf.tests):
        fixed = _element_test(leaf, [_test(s, get(())) for s, get in zip(signs, operands)])

    def check(values: RowValues) -> bool | None:
        array = values[place]
        if array is None:
            return None
        test = fixed
        if test is None:
            terms = [get(values) for get in operands]
            if any(value is None for value in terms):
                return None
            test = _element_test(leaf, list(map(_test, signs, terms)))
        return quantify(map(test, array))

    return check


def _element_test(
    leaf: Quantified, tests: Sequence[Callable[[Any], bool]]
) -> Callable[[Any], bool]:
    """Return the test of an element: all tests, or one (``either``), and then negated."""
    if len(tests) == 1 and not leaf.negated:
        return tests[0]
    join, negated = any if leaf.either else all, leaf.negated
    return lambda element: join([test(element) for test in tests]) is not negated


def _test(sign: str, value: Any) -> Callable[[Any], bool]:
    """Return the test whether ``x sign value`` is true of an x."""
    return like_test(value) if sign == "LIKE" else partial(_SWAPPED[sign], value)


def _comparison(place: int, sign: str, constant: Comparable | None) -> Check:
    """Return the check of one comparison; None = the constant is of another kind."""
    if constant is None:
        return lambda values: None
    test = _holding(constant) if sign == "CONTAINS" else _test(sign, constant)

    def check(values: RowValues) -> bool | None:
        value = values[place]
        return None if value is None else test(value)

    return check


def _membership(place: int, constants: Sequence[Comparable | None]) -> Check:
    """Return the check of IN: like ``=`` with each value, joined by OR."""
    # NaN is left out: it equals nothing, but a set would find it by identity.
    members = frozenset(value for value in constants if value is not None and value == value)
    # A constant of another kind makes the result unknown, unless another constant is equal.
    otherwise = None if None in constants else False

    def check(values: RowValues) -> bool | None:
        value = values[place]
        return None if value is None else value in members or otherwise

    return check


def like_test(pattern: str) -> Callable[[str], bool]:
    """Return the function that matches a whole text with a pattern of LIKE.

    Its time is at most proportional to text times pattern. One regular expression with several
    ``.*`` could take exponential time, so each piece between two ``%`` is searched separately,
    at its first occurrence.
    """
    pieces = pattern.split("%")
    head, tail = _piece(pieces[0]), _piece(pieces[-1])
    if len(pieces) == 1:
        return lambda text: head.fullmatch(text) is not None
    middle = [_piece(piece) for piece in pieces[1:-1] if piece]

    def test(text: str) -> bool:
        match = head.match(text)
        for piece in middle:
            if match is None:
                return False
            match = piece.search(text, match.end())
        last = len(text) - len(pieces[-1])
        return match is not None and match.end() <= last and tail.match(text, last) is not None

    return test


def _piece(text: str) -> Pattern[str]:
    return re.compile("".join("." if c == "_" else re.escape(c) for c in text), re.DOTALL)


def _holding(value: Comparable) -> Callable[[Any], bool]:
    """Return the test of CONTAINS: whether an array has an element that equals the value."""
    if value != value:
        return lambda array: False
    # ``in`` accepts only ints from 0 to 255 for bytes.
    byte = isinstance(value, (int, float)) and 0 <= value <= 255 and value == int(value)

    def test(array: Any) -> bool:
        if isinstance(array, (bytes, bytearray)):
            return byte and int(value) in array
        return value in array

    return test


def _negation(inner: Check) -> Check:
    def check(values: RowValues) -> bool | None:
        truth = inner(values)
        return None if truth is None else not truth

    return check


def _join_checks(checks: list[Check], decisive: bool) -> Check:
    """Return the check of AND (decisive False) or OR (decisive True): one decisive part decides."""

    def check(values: RowValues) -> bool | None:
        result: bool | None = not decisive
        for inner in checks:
            truth = inner(values)
            if truth is decisive:
                return decisive
            if truth is None:
                result = None
        return result

    return check


KEY_PLACE, NODE_PLACE, RUN_PLACE, TIME_PLACE = 0, 1, 2, 3
"""Indices of these values among the values of a row."""
OWN_WIDTH = 4
"""Number of values of a row that are not fields."""
COUNT_KIND = "int64"
"""Kind of a count, which does not depend on the counted values."""
_REFUSED = -1
"""Largest mark of errors that a valid use in another table cannot excuse; marks go downwards."""
_PAIR_BITS = 32
"""Number of bits by which the first position is shifted in the mark of a pair of compared terms. A
pair needs a mark of its own, because BETWEEN compares a term twice, and each term may be valid
alone."""


class Findings:
    """Errors in some tables, and what is valid in another table, by marks.

    The mark of a term or a literal is its position in the statement; see also _REFUSED, _PAIR_BITS.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self.wrong: dict[int, StatementError] = {}
        """The first error of each mark."""
        self.valid: set[int] = set()

    def check(self) -> None:
        """Raise InvalidQuery for the first error that is not valid in another table."""
        for mark, problem in sorted(self.wrong.items()):
            if mark not in self.valid:
                raise InvalidQuery(self._text, problem.position, problem.reason)


class ResultColumn(NamedTuple):
    """One column of a result, in one table."""

    name: str
    place: int
    """Index of its value among the values of a row."""
    kind: str
    """ROS type of a value; 'sum' is an integer of any size."""
    ref: FieldRef | None = None
    """Field that it shows; None for KEY, NODE, RUN and computed columns."""
    compute: Get | None = None
    """Function that computes its value, if the value has no index yet."""


class NameResolver:
    """Resolves the names of a statement in one table.

    An error is recorded in ``findings``, not raised: what is missing here may be in another table.
    """

    def __init__(self, table: Table, findings: Findings) -> None:
        self._definition = table.definition
        self._named = table.named
        self._findings = findings
        self.refs: list[FieldRef] = []
        """Fields found so far, in the order of their values."""
        self._places: dict[FieldRef, int] = {}
        """Index of each field's value among the values of a row."""
        self._used: set[int] = set()
        """Indices of the values that the condition needs, see ``condition``."""
        self._counted: list[tuple[FieldPath, Array]] = []
        """Arrays of messages of which len is taken, with their paths in the statement."""
        self.unnested: list[Array] = []
        """Arrays of messages whose elements are named, outermost first."""
        self.runs = False
        """Whether RUN is needed."""

    def outputs(self, selected: Selected | None) -> Sequence[ResultColumn]:
        """Return the columns of one selected path (None = every field) that the table has."""
        if selected is None:
            return self._outputs_of(
                () if self._definition is None else all_fields(self._definition)
            )
        what = selected.what
        if isinstance(what, Aggregate):
            return self._aggregate(what, selected.text)
        if not isinstance(what, FieldPath):
            return self.single(selected)
        columns = self._outputs_of(
            self._resolve(what, lambda definition: fields_of(what, definition))
        )
        if selected.alias is None:
            return columns
        if len(columns) > 1:
            self._refuse(what, f"{what.text} has {len(columns)} fields; AS gives a name to one")
        return [output._replace(name=selected.alias) for output in columns[:1]]

    def single(self, selected: Selected) -> Sequence[ResultColumn]:
        """Return the column of one term, as of GROUP BY; [] = the table lacks it."""
        what = selected.what
        if isinstance(what, Aggregate):
            raise AssertionError("aggregates are ordered by the columns that show them")
        column = self._output(what)
        return [] if column is None else [column._replace(name=selected.text)]

    def _outputs_of(self, refs: Sequence[FieldRef]) -> list[ResultColumn]:
        return [ResultColumn(ref.name, self._place(ref), ref.type, ref) for ref in refs]

    def _aggregate(self, aggregate: Aggregate, name: str) -> Sequence[ResultColumn]:
        """Return the column of the values that are aggregated; [] = the table lacks them.

        Its kind is that of the aggregate.
        """
        operand, function = aggregate.operand, aggregate.function
        column = self._output(operand or KeyOperand(0))
        if column is None:
            return []
        if operand is not None and function in ("sum", "avg") and column.kind in NO_NUMBERS:
            reason = f"{operand.text} is a {column.kind}, and {function} is for numbers; "
            problem = StatementError(operand.position, reason + "min, max and count take any field")
            self._findings.wrong.setdefault(aggregate.position, problem)
            return []
        self._findings.valid.add(aggregate.position)
        if function in ("min", "max"):
            return [column._replace(name=name)]
        total = "float64" if column.kind.startswith("float") else INTEGER
        kinds = {"count": COUNT_KIND, "avg": "float64", "sum": total}
        return [column._replace(name=name, kind=kinds[function], ref=None)]

    def _output(self, term: Term, array: bool | None = False) -> ResultColumn | None:
        """Return the column of one term; None if the table lacks it."""
        if isinstance(term, (Literal, Call)):
            calc = self._compile(term)
            return (
                None if calc is None else ResultColumn(term.text, -1, calc.kind, compute=calc.get)
            )
        if isinstance(term, FieldPath):
            refs = self._resolve(term, lambda definition: [field_of(term, definition, array)])
            return self._outputs_of(refs)[0] if refs else None
        if isinstance(term, NodeOperand):
            return ResultColumn(term.text, NODE_PLACE, "string")
        if isinstance(term, RunOperand):
            self.runs = True
            return ResultColumn(term.text, RUN_PLACE, "string")
        return ResultColumn(term.text, KEY_PLACE, "string" if self._named else "time")

    def _compile(self, term: Term) -> Computed | None:
        """Return the function that computes a term from a row's values.

        Return None if the table lacks a field of the term, or a type does not fit. The findings
        note the reason, or that the parts of the term are right: a statement is refused only if a
        part of it is right in no table.
        """
        try:
            computed = compile_term(term, self._find)
        except StatementError as exc:
            self._findings.wrong.setdefault(exc.position, exc)
            computed = None
        if computed is not None:
            self._findings.valid.update(part.position for part in inside(term))
        else:
            self._note_valid_parts(term)
        return computed

    def _note_valid_parts(self, term: Term) -> None:
        """Note which calls among the arguments of a term are right, though the term is not.

        If another definition lacks them, that is not an error then.
        """
        if isinstance(term, Call):
            for argument in term.arguments:
                if isinstance(argument, Call):
                    self._compile(argument)

    def _find(self, operand: Operand, array: bool | None) -> OperandPlace | None:
        """Find an operand, see OperandFinder; errors are recorded."""
        if array is None and isinstance(operand, FieldPath):
            return self._find_counted(operand)
        column = self._output(operand, array)
        if column is None:
            return None
        self._used.add(column.place)
        return OperandPlace(
            column.kind, column.place, column.ref is not None and column.ref.is_array
        )

    def _find_counted(self, path: FieldPath) -> OperandPlace | None:
        """Return a field with one value per element, also for an array of messages."""
        refs = self._resolve(path, lambda definition: [counted_field(path, definition)])
        if not refs:
            return None
        (ref,) = refs
        array = ref.steps[: len(path.parts)]
        self._used.add(self._place(ref))
        if not array[-1].many:
            return OperandPlace(ref.type, self._place(ref), ref.is_array)
        self._counted.append((path, array))
        return OperandPlace(ref.type, self._place(ref), True)

    def check_lengths(self) -> None:
        """Refuse len() of an array that is unnested; to be called when all names are resolved."""
        for path, array in self._counted:
            if array in self.unnested:
                reason = f"names fields inside of {path.text}, so that each element is a row; "
                reason += "ask for their number in another statement"
                self._refuse(path, f"the statement takes len({path.text}) and {reason}")

    def condition(self, expression: Expression | None) -> tuple[frozenset[int], Check]:
        """Compile a condition; return the indices of the values that it needs, and its check."""
        self._used.clear()
        check = compile_condition(expression, self)
        return frozenset(self._used), check

    def locate(self, leaf: Comparison) -> int | None:
        """Return the index of a comparison's operand; None if the table lacks it."""
        column = self._output(leaf.operand, wants_array(leaf))
        if column is None:
            return None
        self._used.add(column.place)
        return column.place

    def whereabouts(self) -> tuple[int, int, int]:
        """Return the indices of node, run and time, which identify the robot's position."""
        self.runs = True
        return NODE_PLACE, RUN_PLACE, TIME_PLACE

    def compute(self, leaf: Comparison) -> Sequence[Get | None]:
        """Return the functions of a comparison's terms, each None if it is missing.

        Of Quantified one for each of its tests, of Relate both, of others that of the operand.
        """
        if isinstance(leaf, Quantified):
            return self._tests(leaf)
        first = self._compile(leaf.operand)
        if not isinstance(leaf, Relate):
            return [None if first is None else first.get]
        other = self._compile(leaf.other)
        if first is None or other is None:
            self._hint_at_quotes(leaf, first)
            return [None, None]
        if not self._are_alike(leaf.operand, first.kind, leaf.other, other.kind, leaf.position):
            return [None, None]
        return [first.get, other.get]

    def _tests(self, leaf: Quantified) -> Sequence[Get | None]:
        """Return the function of each term that an element of the array is compared with."""
        array = self._output(leaf.operand, array=True)
        return [self._comparison_value(leaf, array, sign, term) for sign, term in leaf.tests]

    def _comparison_value(
        self, leaf: Quantified, array: ResultColumn | None, sign: str, term: Term
    ) -> Get | None:
        # The term is resolved even if the array is missing: naming its fields may unnest arrays.
        calc = None if isinstance(term, Literal) else self._compile(term)
        if array is None:
            return None
        if isinstance(term, Literal):
            value = self._fit_literal(Compare(leaf.operand, sign, term), array, term)
            return None if value is None else lambda values: value
        if calc is None or not self._are_alike(
            leaf.operand, array.kind, term, calc.kind, leaf.position
        ):
            return None
        return calc.get

    def _are_alike(self, left: Term, kind: str, right: Term, other: str, position: int) -> bool:
        """Return whether values of two kinds can be compared; record an error if not."""
        mark = (left.position + 1) << _PAIR_BITS | right.position
        if family(kind) == family(other):
            self._findings.valid.add(mark)
            return True
        reason = f"{left.text} is {kind_name(kind)} and {right.text} {kind_name(other)}"
        problem = StatementError(position, f"{reason}: they cannot be compared")
        self._findings.wrong.setdefault(mark, problem)
        return False

    def _hint_at_quotes(self, leaf: Relate, left: Computed | None) -> None:
        """Extend the error for an unknown field that may be a text without quotes."""
        other = leaf.other
        problem = self._findings.wrong.get(other.position)
        single = isinstance(other, FieldPath) and len(other.parts) == 1
        if problem and single and left is not None and left.kind == "string":
            reason = f"{problem.reason}; text stands in quotes: '{other.text}'"
            self._findings.wrong[other.position] = StatementError(problem.position, reason)

    def fit(self, leaf: Comparison, literal: Literal) -> Comparable | None:
        """Convert a literal for comparison with its operand.

        None if they cannot be compared here.
        """
        column = self._output(leaf.operand, wants_array(leaf))
        return None if column is None else self._fit_literal(leaf, column, literal)

    def _fit_literal(
        self, leaf: Comparison, column: ResultColumn, literal: Literal
    ) -> Comparable | None:
        """Convert a literal for comparison with a column; an error is recorded, and gives None."""
        try:
            value = _fit(column, leaf, literal)
        except StatementError as exc:
            self._findings.wrong.setdefault(literal.position, exc)
            return None
        self._findings.valid.add(literal.position)
        return value

    def _resolve(
        self, path: FieldPath, resolve: Callable[[Definition], Sequence[FieldRef]]
    ) -> Sequence[FieldRef]:
        """Return the fields that ``resolve`` gives for a path, or () and record the error."""
        try:
            if self._definition is None:
                raise StatementError(path.position, "the messages of this topic have no definition")
            self._unnest_inside(path, fields_of(path, self._definition))
            refs = resolve(self._definition)
        except StatementError as exc:
            self._findings.wrong.setdefault(path.position, exc)
            return ()
        self._findings.valid.add(path.position)
        return refs

    def _unnest_inside(self, path: FieldPath, refs: Sequence[FieldRef]) -> None:
        """Unnest the arrays of messages on a path, wherever the path is used."""
        for ref in refs:
            # Only arrays whose elements the path names, not those that it names whole.
            for array in ref.arrays:
                if len(array) < len(path.parts) and array not in self.unnested:
                    self._unnest(path, array)
                    self._place(ref)  # its values give the number of elements

    def _unnest(self, path: FieldPath, array: Array) -> None:
        """Add an array to the unnested ones, if it lies inside the innermost of them."""
        inner = self.unnested[-1] if self.unnested else ()
        if array[: len(inner)] == inner:
            self.unnested.append(array)
            return
        names = [".".join(step.name for step in a) for a in (inner, array)]
        self._refuse(
            path,
            f"the statement names fields inside two arrays of messages, {names[0]} and "
            f"{names[1]}; ask for them in two statements, or name an element: {names[1]}[0]",
        )

    def _refuse(self, path: FieldPath, reason: str) -> None:
        """Record an error: the field exists, but the path is not allowed at this place."""
        self._findings.wrong.setdefault(
            _REFUSED - path.position, StatementError(path.position, reason)
        )

    def _place(self, ref: FieldRef) -> int:
        """Return the index of a field's value; a new field gets the next one."""
        place = self._places.get(ref)
        if place is None:
            place = self._places[ref] = OWN_WIDTH + len(self.refs)
            self.refs.append(ref)
        return place


def _fit(column: ResultColumn, leaf: Comparison, literal: Literal) -> Comparable:
    """Return a literal for comparison with a column; StatementError: they cannot be compared."""
    operand, sign = leaf.operand, leaf.operator if isinstance(leaf, Compare) else ""
    if sign == "CONTAINS" and column.ref is None:
        reason = f"{operand.text} is not an array; compare it with ="
        raise StatementError(operand.position, reason)
    if sign == "LIKE" and column.kind != "string":
        reason = f"is {kind_name(column.kind)}, and LIKE is for text"
        reason += "; compare it with = < > or BETWEEN"
        raise StatementError(operand.position, f"{operand.text} {reason}")
    if column.ref is not None:
        return fit_to_field(literal, column.ref)
    if column.compute is not None:
        return fit_to_kind(literal, column.kind, operand.text, kind_name(column.kind))
    return fit_to_text(literal, operand.text) if column.kind == "string" else fit_to_time(literal)
