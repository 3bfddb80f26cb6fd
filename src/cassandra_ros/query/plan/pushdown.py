# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Choice of the part of a condition that the server checks in each bucket: index, filter, or none.

The server only leaves out rows that cannot match; every returned row is checked again here. So a
comparison that CQL cannot express is dropped, OR becomes several queries whose rows are united, and
rows with inexact columns (``_odd``) are read in addition.

Comparisons become terms that are never stronger, because Cassandra compares differently: −0.0 is
less than 0.0 and NaN greater than all numbers, a double compared with a float32 column is rounded
to a float32, and a bound outside an integer column's range is an error. Therefore bounds are moved
outwards to the next value of the column's type; a value that the type cannot hold matches no row.

In a packed table the server checks blocks, by their zones. The returned blocks are unpacked, and
their messages filtered before they become rows.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from operator import ge, gt, le, lt
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

import numpy

from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import MAX_INDEXED_TEXT_BYTES
from cassandra_ros.messages.wire.cql_values import encode_value
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.messages.wire.zones import HIGH, LOW, zone_map
from cassandra_ros.query.plan.block_filter import Sift, compile_sift, float_neighbours
from cassandra_ros.query.plan.bounds import bounds_time
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.tree.field_names import FieldRef, field_of
from cassandra_ros.query.tree.literals import Comparable, fitting
from cassandra_ros.query.tree.syntax import (
    All,
    Compare,
    Either,
    Expression,
    FieldPath,
    Leaf,
    Negation,
    OneOf,
    StatementError,
    conjuncts,
    wants_array,
)
from cassandra_ros.read import Query, Terms

MAX_TERM_BYTES = 1024
"""Maximum size of a text that is compared with zones, bytes."""
ServerTerm = Tuple[str, str, bytes]
"""Column, operator and encoded value: one of Terms."""
Ways = Optional[Tuple[Terms, ...]]
"""Alternatives; each is a set of terms that must all hold. A matching row satisfies at least one.
None: any row may match. Empty: no row can match."""

NEVER: Ways = ()
"""The ways for a comparison that no row can satisfy."""
_BITS = {"tinyint": 8, "smallint": 16, "int": 32, "bigint": 64}
_RANGES = {cql_type: (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for cql_type, n in _BITS.items()}
_RANGES.update(boolean=(0, 1), varint=(0, 2**64 - 1))
"""Minimum and maximum of the integers in a column, by CQL type."""
_COMPARE = {"<": lt, "<=": le, ">": gt, ">=": ge}
_FLOATS: dict[str, numpy.dtype[Any]] = {
    "float": numpy.dtype(numpy.float32),
    "double": numpy.dtype(numpy.float64),
}


@dataclass(frozen=True)
class ServerColumn:
    """A column of a table, or one that carries an index."""

    column: str
    cql_type: str
    """CQL type of one value."""
    many: bool = False
    """Whether it is a list or set of values; only CONTAINS can be checked on it."""
    longest: int = 0
    """Maximum size of a text that is certainly in the column, bytes. Because of this limit ranges
    of texts are not checked."""


def ways_of(column: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the terms for a comparison of a column (= < <= > >= CONTAINS) with values.

    ``=`` and ``CONTAINS`` may have several values, one of which must match; the others have one.
    None for any other operator.
    """
    if operator == "=" or (operator == "CONTAINS" and column.many):
        return _equal(column, "CONTAINS" if column.many else "=", values)
    if column.many or operator not in ("<", "<=", ">", ">="):
        return None
    return _bound_ways(column, operator, values[0])


def span_of(column: ServerColumn, values: Sequence[Comparable]) -> Ways:
    """Return the terms for a number between the minimum and maximum of one or more values.

    None: a value is a text or NaN, or the column holds many values.
    """
    numbers = [v for v in values if not isinstance(v, str) and v == v]
    if column.many or not numbers or len(numbers) < len(values):
        return None
    low, high = min(numbers), max(numbers)
    return _both_hold(_bound_ways(column, ">=", low), _bound_ways(column, "<=", high))


def _both_hold(low: Ways, high: Ways) -> Ways:
    """Return the way in which two bounds hold, each of which has at most one way."""
    if NEVER in (low, high):
        return NEVER
    terms = tuple(term for ways in (low, high) for term in (ways[0] if ways else ()))
    return (terms,) if terms else None


def _equal(column: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the ways in which one of the values can be in a column, or among its elements."""
    ways: dict[Terms, None] = {}
    for value in values:
        raws = _exact(column, value)
        if raws is None:
            return None
        if len(raws) == 2 and not column.many:  # one query for −0.0 and 0.0
            ways[(column.column, ">=", raws[0]), (column.column, "<=", raws[1])] = None
        else:
            ways.update(dict.fromkeys(((column.column, operator, raw),) for raw in raws))
    return tuple(ways)


def _exact(column: ServerColumn, value: Comparable) -> list[bytes] | None:
    """Encode all values of a column's type that equal a value, at most two: −0.0 and 0.0.

    [] if there is no such value; None if a row with it may have no column, as for a long text.
    """
    if isinstance(value, str) != (column.cql_type == "text") or value != value:
        return []
    if isinstance(value, str):
        try:
            raw = encode_value("text", value)
        except UnicodeEncodeError:
            return None
        return [raw] if len(raw) <= column.longest else None
    if column.cql_type in _FLOATS:
        below, above = (_float(column.cql_type, value, upwards) for upwards in (True, False))
        if below == above:
            return [below]
        return [below, above] if value == 0 else []
    low, high = _RANGES[column.cql_type]
    if not low <= value <= high or value != int(value):
        return []
    return [encode_value(column.cql_type, int(value))]


def _bound_ways(column: ServerColumn, operator: str, value: Comparable) -> Ways:
    """Return the term for one of < <= > >=; None for texts and bools, and if all values pass."""
    if isinstance(value, str) or column.cql_type in ("text", "boolean"):
        return None
    if value != value:
        return NEVER
    upwards = operator in (">", ">=")
    if column.cql_type in _FLOATS:
        raw = _float(column.cql_type, value, upwards)
        return (((column.column, operator[0] + "=", raw),),)
    low, high = _RANGES[column.cql_type]
    if (value > high or (value == high and operator == ">")) if upwards else value < low:
        return NEVER
    if value <= low if upwards else value >= high:
        return None
    bound = math.ceil(value) if upwards else math.floor(value)
    return (((column.column, operator[0] + "=", encode_value(column.cql_type, bound)),),)


def _float(cql_type: str, value: Comparable, upwards: bool) -> bytes:
    """Encode the nearest float that is not greater (upwards) or not less than a value."""
    below, above = float_neighbours(_FLOATS[cql_type], value)
    number = float(below if upwards else above)
    # For the server −0.0 is less than 0.0: take the zero that lets both pass.
    return encode_value(cql_type, number if number else (-0.0 if upwards else 0.0))


def zone_ways(column: ServerColumn, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the terms on the zone columns for a block that may match a comparison.

    The zone columns hold the minimum and the maximum of the block. Operators and values as in
    ways_of, but zones say nothing of CONTAINS.
    """
    if operator == "=":
        ways = [_zone_around(column, value, value) for value in values]
        if None in ways:
            return None
        return tuple(dict.fromkeys(way[0] for way in ways if way))
    if operator not in ("<", "<=", ">", ">="):
        return None
    return _zone_bound_ways(column, operator, values[0])


def zone_span(column: ServerColumn, values: Sequence[Comparable]) -> Ways:
    """Return the terms on the zone columns for values between the minimum and maximum of some.

    Values of another kind than the column, and NaN, match nothing and are left out.
    """
    usable = [v for v in values if isinstance(v, str) == (column.cql_type == "text") and v == v]
    return _zone_around(column, min(usable), max(usable)) if usable else NEVER


def _zone_around(column: ServerColumn, low: Comparable, high: Comparable) -> Ways:
    """Return the terms for a block that may hold values from low to high, both included."""
    if low == high and column.cql_type != "text" and _exact(column, low) == []:
        return NEVER
    return _both_hold(_zone_bound_ways(column, ">=", low), _zone_bound_ways(column, "<=", high))


def _zone_bound_ways(column: ServerColumn, operator: str, value: Comparable) -> Ways:
    """Return the term on the maximum (> >=) or minimum (< <=) of a block; see Ways."""
    upwards = operator in (">", ">=")
    end = replace(column, column=(HIGH if upwards else LOW) + column.column)
    if isinstance(value, str) != (column.cql_type == "text"):
        return NEVER
    if isinstance(value, str):
        return _zone_text(end, operator, value)
    if column.cql_type != "boolean":
        return _bound_ways(end, operator, value)
    # If only true satisfies > or >=, the maximum of a matching block is true; false and < likewise.
    byte = 1 if upwards else 0
    if not (_COMPARE[operator](1, value) or _COMPARE[operator](0, value)):
        return NEVER
    if _COMPARE[operator](1 - byte, value):
        return None
    return (((end.column, "=", encode_value("boolean", byte)),),)


def _zone_text(end: ServerColumn, operator: str, value: str) -> Ways:
    """Return the term on a bound of texts; None for a text that the server cannot compare."""
    try:
        raw = encode_value("text", value)
    except UnicodeEncodeError:
        return None
    if len(raw) > MAX_TERM_BYTES:
        return None
    return (((end.column, operator[0] + "=", raw),),)


PLANS = ("auto", "index", "filter", "client")
"""Allowed plans: the fastest way; all indexes; filters without indexes; no check by the server."""
MAX_QUERIES = 8
"""Maximum number of server queries for one bucket. More would cost more than reading the bucket."""
FEW_VALUES = 4
"""Maximum number of values of an IN condition that are sent as they are. Longer lists are sent as
their range."""
SPARSE_BUCKET_SHARE = 0.02
"""Share of hits among a bucket's rows above which hits of later buckets are not fetched by key: the
server returns whole rows."""
SPARSE_BUCKET_ROWS = 20
"""Number of hits in a bucket up to which later ones are fetched by key, whatever their share."""
DENSE_SHARE = 0.05
"""Share of a bucket's rows above which filtering is faster than an index, which reads row by
row."""
DENSE_ROWS = 500
"""Number of rows up to which an index is used, whatever their share."""
ZONES_SHARE = 0.5
"""Share of unpacked messages above which zones are no longer checked."""
CROWDED_SHARE = 0.3
"""Share of matching rows above which a bucket is read once instead of by several queries."""
_ODD: Query = ((("_odd", "=", b"\x01"),), False)
"""The query of the rows with a field that no column holds exactly, so that no term finds them."""

Watch = Callable[[], None]
"""Function that is called repeatedly during a read; an exception from it ends the read."""


def unwatched() -> None:
    """Do nothing; the default of ``watch``."""


class _WriterEntry(Protocol):
    """The directory's entry of one writer for a bucket; see the store's BucketRow."""

    @property
    def rows(self) -> int:
        """Number of messages."""

    @property
    def odd(self) -> int:
        """Number of messages that only _ODD finds."""

    @property
    def closed(self) -> bool:
        """Whether the numbers are final."""

    @property
    def filled(self) -> frozenset[str]:
        """Columns with an index that have values in all its rows."""


class ServerCheck(NamedTuple):
    """One comparison, and the ways in which the server can check it."""

    leaf: Leaf
    filtered: Ways = None
    """Terms on the column of format ``ros``."""
    shadow: str = ""
    """Column with an index on the field; '' = no index."""
    indexed: Ways = None
    """Terms on the indexed column."""


Branch = Tuple[ServerCheck, ...]
"""Comparisons that must all hold."""
Used = Dict[Tuple[int, str], Leaf]
"""Comparisons that the server checked, by identity (comparing them may be slow) and way."""


class Pushdown:
    """Chooses for every bucket what the server checks; see Chooser in read.py.

    Args:
        expression: The bound condition; None is always true.
        plan: One of PLANS.
        watch: Called repeatedly, see Watch.
        tables: The present tables of the topic, for which the filters of blocks are made now; for
            others they are made when they are needed.
        nan: Paths of fields that satisfy a lower bound if they are NaN, as in SQL. Cassandra orders
            NaN in the same way; zones leave it out, and list the fields with a NaN.

    Attributes:
        indexed: Number of buckets read by an index.
        filtered: Number of buckets read by a filter without an index.
        whole: Number of buckets read whole.
        skipped: Number of buckets not read.
        blocks: Number of blocks read.
        unpacked: Number of messages in these blocks.
        kept: Number of these messages that became rows.
        held: Number of messages in all packed buckets of the read, as the directory counts.
        used: Comparisons that the server checked, with the way: 'index', 'filter' or 'zones'.
    """

    def __init__(
        self,
        expression: Expression | None,
        plan: str = "auto",
        watch: Watch = unwatched,
        tables: Sequence[Table] = (),
        nan: Collection[str] = (),
    ) -> None:
        if plan not in PLANS:
            raise ValueError(f"plan {plan!r} is not one of {', '.join(PLANS)}")
        self._expression = expression
        self._plan = plan
        self._watch = watch
        self._nan = sorted(nan)
        # By the table itself: two stores may have tables of one name, with other indexes.
        self._branches: dict[Table, list[Branch] | None] = {}
        """See _branches."""
        self._sifts: dict[Table, Sift | None] = {}
        # What earlier buckets of a table have taught, see ``learn``. With another plan than 'auto'
        # only ``_many`` counts.
        self._many: set[Table] = set()
        """Tables with so many hits that these are not fetched by key."""
        self._dense: set[Table] = set()
        """Tables with so many hits that no index is used."""
        self._crowded: set[Table] = set()
        """Tables with so many hits that a bucket is read whole, not by several queries."""
        self._idle: set[Table] = set()
        """Tables of which so many blocks were unpacked that no zones are checked."""
        self._opened: Counter[Table] = Counter()
        """Number of messages in the blocks that were unpacked."""
        self._passed: Counter[Table] = Counter()
        """Number of messages in the buckets given to ``learn``, as the directory counts."""
        self.indexed = self.filtered = self.whole = self.skipped = 0
        self.blocks = self.unpacked = self.kept = self.held = 0
        self.used: Used = {}
        for table in tables:
            if table.packed:
                self.sift(table)

    @property
    def checks(self) -> bool:
        """Whether there is a condition to check."""
        return self._expression is not None

    def choose(self, table: Table, bucket: Sequence[_WriterEntry]) -> Sequence[Query] | None:
        """Return the queries whose rows include all matching rows; None = read all rows.

        Empty: no row can match. It is called once for each bucket of the read, before its rows.
        """
        self._watch()
        queries = self._choose_queries(table, bucket)
        if table.packed:
            self.held += sum(row.rows for row in bucket)
        if queries is None:
            self.whole += 1
        elif any(indexed for _, indexed in queries):
            self.indexed += 1
        elif queries:
            self.filtered += 1
        else:
            self.skipped += 1
        return queries if queries is None else [*queries, *_nan_queries(table, self._nan)]

    def few(self, table: Table) -> bool:
        """Return whether only few rows were found so far."""
        return table not in self._many

    def learn(self, table: Table, bucket: Sequence[_WriterEntry], hits: int) -> None:
        """Record the rows found in a bucket; after many rows the next buckets are checked less.

        It is called after the last row of a bucket for which ``choose`` returned queries.
        """
        total = sum(row.rows for row in bucket)
        self._passed[table] += total
        opened = self._opened[table]  # 0 if each message has its own row
        if opened > DENSE_ROWS and opened > ZONES_SHARE * self._passed[table]:
            self._idle.add(table)
        if hits > SPARSE_BUCKET_ROWS and hits > SPARSE_BUCKET_SHARE * total:
            self._many.add(table)
        if hits > DENSE_ROWS and hits > DENSE_SHARE * total:
            self._dense.add(table)
            if hits > CROWDED_SHARE * total:
                self._crowded.add(table)

    def sift(self, table: Table) -> Sift | None:
        """Return the filter of blocks for a table; None if it would leave no message out."""
        if self._plan == "client" or self._expression is None or table.definition is None:
            return None
        if table not in self._sifts:
            # The read of a bucket has these ends already, so they need no check of a message.
            items = [item for item in conjuncts(self._expression) if not bounds_time(item)]
            self._sifts[table] = compile_sift(All(tuple(items)), table.definition, self._nan)
        return self._sifts[table]

    def opened(self, table: Table, messages: int, kept: int) -> None:
        """Record an unpacked block: its number of messages, and how many became rows."""
        self._watch()
        self._opened[table] += messages
        self.blocks += 1
        self.unpacked += messages
        self.kept += kept

    def _choose_queries(self, table: Table, bucket: Sequence[_WriterEntry]) -> list[Query] | None:
        """Return what ``choose`` returns, and record the comparisons in ``used``."""
        if self._plan == "client" or self._expression is None:
            return None
        if table not in self._branches:
            self._branches[table] = _branches(self._expression, table)
        branches = self._branches[table]
        if branches is None:
            return None
        if self._plan == "auto" and table in self._idle:
            return None
        dense = self._plan == "auto" and table in self._dense
        # An index must not hide a row, so all writers of the bucket must have filled its column.
        filled = frozenset.intersection(*(row.filled for row in bucket))
        if self._plan == "filter" or (dense and table.by_field):
            filled = frozenset()
        queries: list[Query] = []
        new_uses: Used = {}
        for branch in branches:
            more = self._queries(branch, filled, new_uses, "zones" if table.packed else "filter")
            if more is None or len(queries) + len(more) > MAX_QUERIES:
                return None
            queries.extend(more)
        if self._plan == "auto" and len(queries) > 1 and table in self._crowded:
            return None
        self.used.update(new_uses)
        # Of an open bucket the number of odd rows is not known yet.
        if any(row.odd or not row.closed for row in bucket):
            queries.append(_ODD)
        return queries

    def _queries(
        self, branch: Branch, filled: frozenset[str], uses: Used, way_without: str
    ) -> list[Query] | None:
        """Return the queries of one branch; None if the server cannot check any part of it.

        Empty: no row can match. What is checked is added to ``uses``, without an index as
        ``way_without``.
        """
        if any(NEVER in (check.filtered, check.indexed) for check in branch):
            return []
        usable = [c for c in branch if c.indexed is not None and c.shadow in filled]
        # An index with an equality finds fewer rows than one with a range.
        shadow = min(usable, key=_is_range).shadow if usable else ""
        ways, count = [], 1
        # The check by the index first: one that would make too many queries is left out.
        by_indexes = [bool(shadow) and c.shadow == shadow and c.indexed is not None for c in branch]
        pairs = sorted(zip(by_indexes, branch), key=lambda pair: not pair[0])
        for by_index, check in pairs:
            way = check.indexed if by_index else check.filtered
            if way is not None and count * len(way) <= MAX_QUERIES:
                count *= len(way)
                ways.append(way)
                uses[id(check.leaf), "index" if by_index else way_without] = check.leaf
        if not ways:
            return None
        return [(_compatible(sum(terms, ())), bool(shadow)) for terms in product(*ways)]


def _is_range(check: ServerCheck) -> bool:
    """Return whether an index has to find a range of values."""
    return any(term[1] not in ("=", "CONTAINS") for way in check.indexed or () for term in way)


def _compatible(terms: Sequence[ServerTerm]) -> tuple[ServerTerm, ...]:
    """Remove terms that the server refuses in combination: second bounds, bounds with =.

    More rows may pass then, but none that matches is lost.
    """
    equal = {column for column, operator, _ in terms if operator == "="}
    by_bound: dict[tuple[object, ...], ServerTerm] = {}
    for term in terms:
        column, operator, value = term
        if operator == "CONTAINS":
            by_bound.setdefault((column, operator, value), term)
        elif operator == "=" or column not in equal:
            by_bound.setdefault((column, operator), term)
    return tuple(by_bound.values())


def _branches(expression: Expression, table: Table) -> list[Branch] | None:
    """Convert a condition to the form (a AND b …) OR …; parts that do not fit are dropped.

    None: the server cannot check any part of it.
    """
    if isinstance(expression, Negation):
        return None
    if isinstance(expression, Either):
        branch_lists = [_branches(item, table) for item in expression.items]
        united = [branch for branches in branch_lists for branch in branches or ()]
        return None if None in branch_lists or len(united) > MAX_QUERIES else united
    if isinstance(expression, All):
        return _join_branches([_branches(item, table) for item in expression.items])
    check = _check_of(expression, table)
    return None if check.filtered is None and check.indexed is None else [(check,)]


def _join_branches(branch_lists: Sequence[list[Branch] | None]) -> list[Branch] | None:
    """Return the branches of conditions joined by AND; lists that make too many are dropped."""
    factors = sorted((branches for branches in branch_lists if branches is not None), key=len)
    if not factors:
        return None
    combinations: list[Branch] = [()]
    for branches in factors:
        if len(combinations) * len(branches) <= MAX_QUERIES:
            combinations = [one + other for one in combinations for other in branches]
    return combinations


def _check_of(leaf: Leaf, table: Table) -> ServerCheck:
    """Return how the server can check a leaf in a table."""
    if not isinstance(leaf, (Compare, OneOf)) or table.definition is None:
        return ServerCheck(leaf)
    if not isinstance(leaf.operand, FieldPath):
        return ServerCheck(leaf)
    operator = leaf.operator if isinstance(leaf, Compare) else "="
    try:
        ref = field_of(leaf.operand, table.definition, wants_array(leaf))
    except StatementError:
        # This definition lacks the field, and a missing value never matches.
        return ServerCheck(leaf, NEVER)
    values = list(fitting(leaf, ref))
    if not values:
        return ServerCheck(leaf, NEVER)
    if ref.part:
        return ServerCheck(leaf)
    if table.packed:
        return ServerCheck(leaf, _zone_ways(ref, table, operator, values))
    filtered = _ways(_column_of(ref, table), operator, values, FEW_VALUES)
    index = table.index_fields.get(ref.column)
    if index is None:
        return ServerCheck(leaf, filtered)
    shadow = ServerColumn(index.shadow, index.element_type, index.many, MAX_INDEXED_TEXT_BYTES)
    return ServerCheck(leaf, filtered, index.shadow, _ways(shadow, operator, values, MAX_QUERIES))


def _ways(
    column: ServerColumn | None, operator: str, values: Sequence[Comparable], most: int
) -> Ways:
    """Return the ways for a comparison; those for the range of the values if they are too many."""
    if column is None:
        return None
    ways = ways_of(column, operator, values)
    return ways if ways is None or len(ways) <= most else span_of(column, values)


def _zone_ways(ref: FieldRef, table: Table, operator: str, values: Sequence[Comparable]) -> Ways:
    """Return the ways for the blocks of a packed table, as _ways."""
    column = None if table.definition is None else _zone_columns(table.definition).get(ref.column)
    if column is None:
        return None
    ways = zone_ways(column, operator, values)
    return ways if ways is None or len(ways) <= FEW_VALUES else zone_span(column, values)


def _column_of(ref: FieldRef, table: Table) -> ServerColumn | None:
    """Return the column of format ``ros`` with a field's value or all its elements, or None."""
    if not table.by_field or table.definition is None:
        return None
    return _checkable(table.definition, table.longest_text).get(ref.column)


def _nan_queries(table: Table, fields: Iterable[str]) -> list[Query]:
    """Return the queries of the blocks in which one of some fields has a NaN: zones leave it out.

    The list is empty for a table in which each message has its own row.
    """
    if not table.packed or table.definition is None:
        return []
    zones = zone_map(table.definition).fields
    return [((("_nan", "CONTAINS", name.encode()),), False) for name in fields if name in zones]


@lru_cache(maxsize=256)
def _zone_columns(definition: Definition) -> dict[str, ServerColumn]:
    """Return the fields with zones, by name."""
    fields = zone_map(definition).fields
    return {name: ServerColumn(name, column.element_type) for name, column in fields.items()}


@lru_cache(maxsize=256)
def _checkable(definition: Definition, longest_text: int) -> dict[str, ServerColumn]:
    """Return the columns of format ``ros`` with a value or all elements of a field, by name."""
    return {
        column.name: ServerColumn(column.name, column.element_type, column.is_list, longest_text)
        for column in wire_plan(definition).columns
        if column.kind not in ("array", "wire")
    }
