# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The part of WHERE that bounds what is read of a table: times, robots, runs, events, and fields.

DuckDB checks every row again, so what is found here may only be weaker than the statement: bounds
are included and moved outwards, and all else is left out. DuckDB compares unlike our own language:
NaN is greater than all numbers (``Pushdown`` is told), and numbers are compared as
float32 where a field is one.

A condition on a table holds for the rows that are read of it, unless the table is the right side of
an ASOF or positional join: there other rows would take the place of those left out. But what the
join compares bounds its right side too: with ``i.KEY >= f.KEY`` and ``i.KEY < t`` no fix after t is
joined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import reduce
from itertools import chain
from typing import AbstractSet, Any, Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from cassandra_ros.client.sql.topic_functions import table_names
from cassandra_ros.installation import optional_module
from cassandra_ros.query.tree.syntax import (
    All,
    Compare,
    Either,
    Expression,
    FieldPath,
    Literal,
    OneOf,
    PathPart,
)
from cassandra_ros.read import ALWAYS, LAST_NS, TimeRange

WIDER_NS = 2000
"""Number of ns by which bounds of times are moved outwards: DuckDB may compare them as us."""
_EXACT_FLOAT = 2**23
"""Integers below it stay exact where DuckDB compares them as float32."""
_MIRRORED = {"GT": "LT", "GTE": "LTE", "LT": "GT", "LTE": "GTE", "EQ": "EQ"}
_ZONED = ("TIMESTAMPTZ", "TIMESTAMPLTZ", "TIMETZ")
UNSURE = "unsure"
"""Mark of an interval of a tree whose text sqlglot may not have read whole."""
_BELOW, _ABOVE = ("LT", "LTE"), ("GT", "GTE")


@dataclass(frozen=True)
class ComparableColumn:
    """A column, or a field in it, with which a condition may compare."""

    kind: str
    """'key', 'node', 'run', 'event', 'time', 'text', 'bool', 'int', 'float32' or 'float64'."""
    path: str = ""
    """Dotted path of the field in the messages."""


ColumnOf = Callable[[Sequence[str]], "ComparableColumn | None"]
"""Function from the names in a statement to a column of a table; None: it has none, or no simple
one."""
Evaluate = Callable[[str, AbstractSet[str]], Any]
"""Function from an expression without columns, and the names of its parameters (in the expression
each has a p before it), to its value; None = it has none, or an error."""


@dataclass(frozen=True)
class PushedRead:
    """What is read of a table; None = not bounded."""

    time_range: TimeRange = ALWAYS
    nodes: frozenset[str] | None = None
    runs: frozenset[str] | None = None
    """Values of RUN."""
    events: frozenset[str] | None = None
    """Names of events; the messages lie in the time of one of them."""
    condition: Expression | None = None
    floats: frozenset[str] = frozenset()
    """Paths of the fields with a lower bound, which NaN exceeds in DuckDB."""

    def both(self, other: PushedRead) -> PushedRead:
        """Return what is read if both hold."""
        low = max(self.time_range.low, other.time_range.low)
        high = min(self.time_range.high, other.time_range.high)
        conditions = [c for c in (self.condition, other.condition) if c is not None]
        return PushedRead(
            TimeRange(low, high),
            _common(self.nodes, other.nodes),
            _common(self.runs, other.runs),
            # A message may lie in the time of several events: those of one side are enough.
            other.events if self.events is None else self.events,
            All(tuple(conditions)) if len(conditions) > 1 else next(iter(conditions), None),
            self.floats | other.floats,
        )

    def either(self, other: PushedRead) -> PushedRead:
        """Return what is read if one of both holds."""
        low = min(self.time_range.low, other.time_range.low)
        high = max(self.time_range.high, other.time_range.high)
        conditions = [_alternatives(read.condition) for read in (self, other)]
        return PushedRead(
            TimeRange(low, high),
            None if self.nodes is None or other.nodes is None else self.nodes | other.nodes,
            None if self.runs is None or other.runs is None else self.runs | other.runs,
            None if self.events is None or other.events is None else self.events | other.events,
            Either(tuple(chain.from_iterable(conditions))) if all(conditions) else None,
            self.floats | other.floats,
        )

    @property
    def empty(self) -> bool:
        """Whether no row can satisfy its time range."""
        return self.time_range.low > self.time_range.high


def _alternatives(condition: Expression | None) -> tuple[Expression, ...]:
    """Return the conditions of which one must hold; () = no condition.

    They are not nested, because a list of IN may have thousands.
    """
    if condition is None:
        return ()
    return condition.items if isinstance(condition, Either) else (condition,)


def _common(one: frozenset[str] | None, other: frozenset[str] | None) -> frozenset[str] | None:
    """Return the intersection of two sets; None = all."""
    if one is None or other is None:
        return other if one is None else one
    return one & other


UNBOUNDED_READ = PushedRead()


def pushed_reads(
    tree: Any, columns: Mapping[str, ColumnOf], evaluate: Evaluate
) -> dict[str, PushedRead]:
    """Return what is read of each table of a statement.

    Args:
        tree: The statement.
        columns: Finds columns, by name of the table as in the statement.
        evaluate: Computes constants as DuckDB does.
    """
    errors = optional_module("sqlglot.errors", "sql")
    try:
        reads = _reads(tree, columns, evaluate)
    except (errors.OptimizeError, RecursionError):  # DuckDB says what is wrong, if it is
        reads = {}
    return {name: _any_of(reads.get(name) or [UNBOUNDED_READ]) for name in columns}


def _reads(
    tree: Any, columns: Mapping[str, ColumnOf], evaluate: Evaluate
) -> dict[str, list[PushedRead]]:
    """Return what is read by each mention of each table; {} if one of them was not found."""
    finder = _ConditionFinder(columns, evaluate)
    scopes = optional_module("sqlglot.optimizer.scope", "sql")
    reads: dict[str, list[PushedRead]] = {name: [] for name in columns}
    for scope in scopes.traverse_scope(tree):
        for name, read in finder.of_scope(scope):
            reads[name].append(read)
    names = chain.from_iterable(map(table_names, tree.find_all(finder.exp.Table)))
    return reads if sum(map(len, reads.values())) == sum(n in columns for n in names) else {}


def _all_of(reads: Sequence[PushedRead]) -> PushedRead:
    """Return what is read if all hold."""
    return reduce(PushedRead.both, reads, UNBOUNDED_READ)


def _any_of(reads: Sequence[PushedRead]) -> PushedRead:
    """Return what is read if one of them holds; there must be one."""
    return reduce(PushedRead.either, reads)


class _ConditionFinder:
    """Finds in a statement what bounds the rows of its tables.

    Args:
        columns: Finds columns, by name of the table.
        evaluate: Computes constants.
    """

    def __init__(self, columns: Mapping[str, ColumnOf], evaluate: Evaluate) -> None:
        self.exp = optional_module("sqlglot.expressions", "sql")
        self._columns = columns
        self._evaluate = evaluate

    def of_scope(self, scope: Any) -> Iterator[tuple[str, PushedRead]]:
        """Yield what is read of each table in FROM and JOIN of one SELECT."""
        exp, select = self.exp, scope.expression
        sources = {
            alias: source
            for alias, (_, source) in scope.selected_sources.items()
            if isinstance(source, exp.Table)
        }
        where = select.args.get("where") if isinstance(select, exp.Select) else None
        if where is None or self._pushes_nothing(select, sources.values()):
            for source in sources.values():
                yield from self._reads_of(source, UNBOUNDED_READ)
            return
        names = {alias: _Names(self, alias, sources, scope, select) for alias in sources}
        # What holds for each row of the result, as far as the row has one of the table.
        holds = {alias: self._where_bounds(where.this, names[alias]) for alias in sources}
        shifting = self._shifting_tables(select)
        # What is read: of a shifting table WHERE leaves nothing out, but a comparing join may.
        reads = {a: UNBOUNDED_READ if a in shifting else read for a, read in holds.items()}
        for join in self._comparing_joins(select):
            alias = join.this.alias_or_name
            if alias in names:
                implied = _all_of(list(self._implied_reads(join, alias, names, holds)))
                holds[alias] = holds[alias].both(implied)
                reads[alias] = reads[alias].both(implied)
        for alias, source in sources.items():
            yield from self._reads_of(source, reads[alias])

    def _reads_of(self, table: Any, read: PushedRead) -> Iterator[tuple[str, PushedRead]]:
        """Yield what is read for one table in FROM; for nearest of both topics."""
        for number, name in enumerate(table_names(table)):
            if name in self._columns:
                yield name, self._partners_read(table, read) if number else read

    def _partners_read(self, table: Any, read: PushedRead) -> PushedRead:
        """Return what is read of the second topic of nearest, given that of the first."""
        within = self._constant(table.this.expressions[2], "epoch_ns(CAST(({}) AS INTERVAL))")
        if within is None:
            return PushedRead(nodes=read.nodes)
        return PushedRead(read.time_range.wider(max(0, within)), read.nodes)

    def _pushes_nothing(self, select: Any, tables: Iterable[Any]) -> bool:
        """Return whether each row of the tables of a SELECT may be needed, whatever WHERE says."""
        exp, own_joins = self.exp, set(map(id, select.args.get("joins") or ()))
        if select.find(exp.TableSample) is not None:
            return True
        if any(table.args.get("alias") and table.args["alias"].columns for table in tables):
            return True  # the columns have other names
        if any(table.args.get("pivots") for table in tables):
            return True  # WHERE tests what is made of the rows
        # In parentheses: of these joins WHERE does not tell what may be left out.
        inner = (join for join in select.find_all(exp.Join) if id(join) not in own_joins)
        methods = {(j.method or "").upper() for j in inner if j.parent_select is select}
        return not methods <= {"", "NATURAL"}

    def _where_bounds(self, condition: Any, names: _Names) -> PushedRead:
        """Return what WHERE bounds of one table."""
        reads = (self._read_of(conjunct, names) for conjunct in self._conjuncts(condition))
        return _all_of([read for read in reads if read is not None])

    def _comparing_joins(self, select: Any) -> Sequence[Any]:
        """Return the joins of which the right side needs no rows but those that satisfy ON."""
        joins = select.args.get("joins") or ()
        kinds = [((join.method or "").upper(), (join.side or "").upper()) for join in joins]
        if any(m == "POSITIONAL" or (m == "ASOF" and s in ("RIGHT", "FULL")) for m, s in kinds):
            return ()
        return [join for join, (method, _) in zip(joins, kinds) if method in ("", "ASOF")]

    def _implied_reads(
        self, join: Any, alias: str, names: Mapping[str, _Names], holds: Mapping[str, PushedRead]
    ) -> Iterator[PushedRead]:
        """Yield the bounds of the right side that follow from those of the tables before it.

        They come from the comparisons in ON. A row of the right side that these bounds leave out
        joins no row that is read on the left, so the result is the same without it.
        """
        condition = join.args.get("on")
        for conjunct in () if condition is None else self._conjuncts(condition):
            operator = type(conjunct).__name__
            if operator not in _MIRRORED:
                continue
            for operand, other, sign in (
                (conjunct.left, conjunct.right, operator),
                (conjunct.right, conjunct.left, _MIRRORED[operator]),
            ):
                column = names[alias].column(operand)
                for other_alias, read in holds.items():
                    joined = names[other_alias].column(other) if other_alias != alias else None
                    if column is not None and joined is not None:
                        yield _implied_bounds(column, sign, joined, read)

    def _shifting_tables(self, select: Any) -> set[str]:
        """Return the tables of which other rows would be joined if some were left out."""
        aliases: set[str] = set()
        joins = select.args.get("joins") or ()
        for join in joins:
            method, side = (join.method or "").upper(), (join.side or "").upper()
            if method == "POSITIONAL" or (method == "ASOF" and side in ("RIGHT", "FULL")):
                source = select.args.get("from_") or select.args.get("from")
                joined = [*joins, *([] if source is None else [source])]
                return {source_or_join.this.alias_or_name for source_or_join in joined}
            if method not in ("", "NATURAL"):
                aliases.add(join.this.alias_or_name)
        return aliases

    def _conjuncts(self, node: Any) -> Iterator[Any]:
        """Yield the conditions that AND joins, also in parentheses."""
        node = node.unnest()
        for operand in node.flatten() if isinstance(node, self.exp.And) else ():
            yield from self._conjuncts(operand)
        if not isinstance(node, self.exp.And):
            yield node

    def _read_of(self, node: Any, names: _Names) -> PushedRead | None:
        """Return the bounds of a condition; None = it bounds nothing."""
        exp, node = self.exp, node.unnest()
        if isinstance(node, exp.And):
            both = (self._read_of(operand, names) for operand in (node.left, node.right))
            return _all_of([read for read in both if read is not None])
        if isinstance(node, exp.Or):
            one, two = (self._read_of(operand, names) for operand in (node.left, node.right))
            return None if one is None or two is None else one.either(two)
        if isinstance(node, exp.Between):
            low = self._comparison_bounds("GTE", node.this, node.args["low"], names)
            high = self._comparison_bounds("LTE", node.this, node.args["high"], names)
            return (low or UNBOUNDED_READ).both(high or UNBOUNDED_READ)
        if isinstance(node, exp.In) and node.expressions and not node.args.get("query"):
            value_reads = [
                self._comparison_bounds("EQ", node.this, value, names) for value in node.expressions
            ]
            reads = [read for read in value_reads if read is not None]
            return _any_of(reads) if len(reads) == len(value_reads) else None
        if isinstance(node, exp.In) and node.args.get("field") is not None:
            return self._in_event(node.this, node.args["field"], names)
        if isinstance(node, exp.ArrayContains):
            return self._in_event(node.expression, node.this, names)
        if isinstance(node, exp.Anonymous) and node.name.lower() == "list_contains":
            if len(node.expressions) == 2:  # as sqlglot for Python 3.8 reads it
                return self._in_event(node.expressions[1], node.expressions[0], names)
        operator = type(node).__name__
        if operator in _MIRRORED:
            read = self._comparison_bounds(operator, node.left, node.right, names)
            return read or self._comparison_bounds(
                _MIRRORED[operator], node.right, node.left, names
            )
        return None

    def _in_event(self, name: Any, listed: Any, names: _Names) -> PushedRead | None:
        """Return the bounds of a name that is one of those in a list."""
        column = names.column(listed)
        if column is None or column.kind != "event":
            return None
        value = self._constant(name)
        return PushedRead(events=frozenset([value])) if isinstance(value, str) else None

    def _comparison_bounds(
        self, operator: str, side: Any, other: Any, names: _Names
    ) -> PushedRead | None:
        """Return the bounds of ``side operator other``, a column and a constant; None = none."""
        column = names.column(side)
        if column is None or column.kind == "event":
            return None
        is_time = column.kind in ("key", "time")
        value = self._constant(other, "epoch_ns(CAST(({}) AS TIMESTAMP_NS))" if is_time else "{}")
        return None if value is None else _bounds(column, operator, value)

    def _constant(self, node: Any, wanted: str = "{}") -> Any:
        """Return the value of an expression; None = it has none, or is not constant.

        Args:
            wanted: Expression to compute, in which ``{}`` stands for the given one.
        """
        if not self._is_constant(node):
            return None
        exp = self.exp
        given = {placeholder.name for placeholder in node.find_all(exp.Placeholder)}
        # DuckDB takes no parameter that an expression lacks, and numbers without gaps.
        named = node.transform(
            lambda n: exp.Placeholder(this=f"p{n.name}") if isinstance(n, exp.Placeholder) else n
        )
        return self._evaluate(wanted.format(named.sql(dialect="duckdb")), given)

    def _is_constant(self, node: Any) -> bool:
        """Return whether an expression has one value that DuckDB can compute alone."""
        exp = self.exp
        calls = {"now", "today"}
        simple = (
            *(exp.Literal, exp.Boolean, exp.Neg, exp.Paren, exp.Cast, exp.DataType, exp.Interval),
            *(exp.Add, exp.Sub, exp.Mul, exp.Var, exp.Placeholder, exp.Identifier),
        )
        return all(
            (isinstance(term, simple) and not self._is_read_otherwise(term))
            or (isinstance(term, exp.Anonymous) and term.name.lower() in calls)
            for term in node.walk()
        )

    def _is_read_otherwise(self, node: Any) -> bool:
        """Return whether sqlglot may read a constant otherwise than DuckDB does."""
        if isinstance(node, self.exp.Interval):
            return bool(node.meta.get(UNSURE))
        # Of TIMESTAMPTZ '…'::TIMESTAMP it takes the casts in the wrong order.
        casts = isinstance(node, self.exp.Cast) and isinstance(node.this, self.exp.Cast)
        return casts and str(node.to.this.value).upper() in _ZONED


class _Names:
    """The names in one SELECT, and which of them mean columns of one of its tables.

    Args:
        finder: The finder.
        alias: Alias of this table in the SELECT.
        sources: All tables of the SELECT, by alias.
        scope: The scope of the SELECT: subqueries are sources of it, too.
        of: The SELECT.
    """

    def __init__(
        self, finder: _ConditionFinder, alias: str, sources: Mapping[str, Any], scope: Any, of: Any
    ) -> None:
        self._exp = finder.exp
        self._alias = alias.lower()
        self._columns_of = {
            name.lower(): finder._columns.get(table_names(source)[0])
            for name, source in sources.items()
        }
        self._others = {name.lower() for name in scope.selected_sources} - {self._alias}
        # Unqualified names are resolved only where all tables are known.
        self._whole = len(sources) == len(scope.selected_sources) == len(self._columns_of)
        self._whole = self._whole and None not in self._columns_of.values()
        # A name that SELECT gives may hide a column.
        self._given = {output.alias.lower() for output in of.expressions if output.alias}

    def column(self, node: Any) -> ComparableColumn | None:
        """Return the column of the table that an expression is; None = it is not one."""
        chain = self._chain(node.unnest())
        if not chain:
            return None
        find_own = self._columns_of[self._alias]
        if find_own is None:
            return None
        if len(chain) > 1 and chain[0].lower() == self._alias:
            return find_own(chain[1:])
        aliases = {name for name, find in self._columns_of.items() if find and find(chain[:1])}
        is_other = chain[0].lower() in self._given or chain[0].lower() in self._others
        if is_other or not self._whole or aliases - {self._alias}:
            return None
        return find_own(chain)

    def _chain(self, node: Any) -> list[str]:
        """Return the names of a dotted name, from the left; [] = it is another expression."""
        exp, names = self._exp, []
        while isinstance(node, exp.Dot) and isinstance(node.expression, exp.Identifier):
            names.append(node.expression.name)
            node = node.this
        if not isinstance(node, exp.Column):
            return []
        return [*(column_name.name for column_name in node.parts), *reversed(names)]


def _implied_bounds(
    column: ComparableColumn, operator: str, joined: ComparableColumn, read: PushedRead
) -> PushedRead:
    """Return what ``column operator joined`` says of a column, if ``read`` holds for the other."""
    if column.kind != joined.kind:
        return UNBOUNDED_READ
    if column.kind == "key":
        low, high = read.time_range
        return PushedRead(
            TimeRange(0 if operator in _BELOW else low, LAST_NS if operator in _ABOVE else high)
        )
    if operator == "EQ" and column.kind == "node":
        return PushedRead(nodes=read.nodes)
    if operator == "EQ" and column.kind == "run":
        return PushedRead(runs=read.runs)
    return UNBOUNDED_READ


def _bounds(column: ComparableColumn, operator: str, value: Any) -> PushedRead | None:
    """Return the bounds of ``column operator value``; None = it bounds nothing."""
    if column.kind == "key":
        return _time_bounds(operator, value)
    if column.kind in ("node", "run"):
        if operator != "EQ" or not isinstance(value, str):
            return None
        texts = frozenset([value])
        return PushedRead(nodes=texts) if column.kind == "node" else PushedRead(runs=texts)
    return _CONDITIONS[column.kind](column, operator, value)


def _time_bounds(operator: str, ns: int) -> PushedRead:
    """Return the bounds of ``KEY operator ns``; a time before 1970 may leave an empty range."""
    low, high = max(0, ns - WIDER_NS), min(LAST_NS, ns + WIDER_NS)
    return PushedRead(
        TimeRange(
            0 if operator in _BELOW else low,
            LAST_NS if operator in _ABOVE else max(high, -1),
        )
    )


def _time_condition(column: ComparableColumn, operator: str, ns: int) -> PushedRead:
    return _between(column, operator, ns - WIDER_NS, ns + WIDER_NS)


def _text_condition(column: ComparableColumn, operator: str, value: Any) -> PushedRead | None:
    # A text with a backslash may be one whose bytes are not UTF-8.
    if operator != "EQ" or not isinstance(value, str) or "\\" in value:
        return None
    return PushedRead(condition=OneOf(_path(column), (Literal(value, 0),)))


def _bool_condition(column: ComparableColumn, operator: str, value: Any) -> PushedRead | None:
    if operator != "EQ" or not isinstance(value, bool):
        return None
    return PushedRead(condition=Compare(_path(column), "=", Literal(value, 0)))


def _int_condition(column: ComparableColumn, operator: str, value: Any) -> PushedRead | None:
    if isinstance(value, bool) or not isinstance(value, (int, float, Decimal)):
        return None
    if isinstance(value, float) and not abs(value) < _EXACT_FLOAT:
        return None
    return _between(column, operator, math.floor(value), math.ceil(value))


def _float_condition(column: ComparableColumn, operator: str, value: Any) -> PushedRead | None:
    if isinstance(value, bool) or not isinstance(value, (int, float, Decimal)):
        return None
    dtype = np.dtype(column.kind).type
    try:
        with np.errstate(over="ignore"):
            near = dtype(float(value))
            low = float(np.nextafter(near, dtype(-math.inf)))
            high = float(np.nextafter(near, dtype(math.inf)))
    except OverflowError:
        return None
    if not (math.isfinite(low) and math.isfinite(high)):
        return None
    read = _between(column, operator, low, high)
    return replace(read, floats=frozenset([column.path])) if operator in _ABOVE else read


_CONDITIONS: Mapping[str, Callable[[ComparableColumn, str, Any], PushedRead | None]] = {
    "time": _time_condition,
    "text": _text_condition,
    "bool": _bool_condition,
    "int": _int_condition,
    "float32": _float_condition,
    "float64": _float_condition,
}
"""Makes the condition on a field, by the kind of its column."""


def _between(column: ComparableColumn, operator: str, low: Any, high: Any) -> PushedRead:
    """Return the bounds of ``column operator value``, where low <= value <= high."""
    path = _path(column)
    bounds: list[Expression] = []
    if operator not in _BELOW:
        bounds.append(Compare(path, ">=", Literal(low, 0)))
    if operator not in _ABOVE:
        bounds.append(Compare(path, "<=", Literal(high, 0)))
    return PushedRead(condition=bounds[0] if len(bounds) == 1 else All(tuple(bounds)))


def _path(column: ComparableColumn) -> FieldPath:
    return FieldPath(tuple(PathPart(name, None, 0) for name in column.path.split(".")), 0)
