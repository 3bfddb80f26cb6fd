# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What of a condition the server checks, bucket by bucket: by an index, by a filter, or nothing.

It only has to leave out what cannot match: every row that comes is checked again here. So what
cannot be said in CQL is left away, OR becomes several queries whose rows are united, and the rows
whose columns are not exact (``_odd``) are read besides.

Of a packed table the server checks blocks, by their zones; what it finds is unpacked, and sifted
before it becomes rows.
"""

from __future__ import annotations

from collections import Counter
from itertools import product
from typing import (
    Callable,
    Dict,
    FrozenSet,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from cassandra_ros.messages.index_field import MAX_TEXT_BYTES
from cassandra_ros.messages.wire.wire_plan import wire_plan
from cassandra_ros.messages.wire.zones import zone_map
from cassandra_ros.query.plan.block_filter import Sift, compile_sift
from cassandra_ros.query.plan.terms import (
    NEVER,
    Held,
    Term,
    Ways,
    span_of,
    ways_of,
    zone_span,
    zone_ways,
)
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.tree.field_names import FieldRef, field_of
from cassandra_ros.query.tree.literals import Comparable, fitting
from cassandra_ros.query.tree.syntax import (
    All,
    Compare,
    Either,
    Expression,
    Leaf,
    Negation,
    OneOf,
    Path,
    StatementError,
    wants_array,
)

PLANS = ("auto", "index", "filter", "client")
"""What may be pushed: whatever is quickest; the same, with every index; no index; nothing."""
MAX_QUERIES = 8
"""Of one bucket: more would cost more than reading it."""
FEW_VALUES = 4
"""Of IN: for more the server is asked for their span."""
FEW_SHARE = 0.02
"""Up to here it is quicker to fetch what a filter found than to let it answer with whole rows."""
FEW_ROWS = 20
DENSE_SHARE = 0.05
"""Where an index finds more of a bucket than this, a filter is quicker: it fetches row by row."""
DENSE_ROWS = 500
"""So few are no burden, whatever their share."""
ZONES_SHARE = 0.5
"""Where zones let more of the messages through than this, they are not asked any more."""
CROWDED_SHARE = 0.3
"""Where more of a bucket is wanted, it is read once instead of by several queries."""
Query = Tuple[Tuple[Term, ...], bool]
"""What the server is to check, all of it, and whether it finds the rows by an index."""
_ODD: Query = ((("_odd", "=", b"\x01"),), False)

Watch = Callable[[], None]
"""Is called again and again while something is read; what it raises ends that."""


def unwatched() -> None:
    """Watch nothing."""


class _Bucket(Protocol):
    """What one writer notes of a partition in the directory, as the store's BucketRow has it."""

    @property
    def rows(self) -> int: ...
    @property
    def odd(self) -> int: ...
    @property
    def closed(self) -> bool: ...
    @property
    def filled(self) -> FrozenSet[str]: ...


class Need(NamedTuple):
    """One comparison, as the server can check it."""

    leaf: Leaf
    filtered: Ways = None
    """By the column of format ``ros``."""
    shadow: str = ""
    """The column with an index on the field, '' = none."""
    indexed: Ways = None
    """By the index."""


Branch = Tuple[Need, ...]
"""Needs that all hold."""
Used = Dict[Tuple[int, str], Leaf]
"""Comparisons by their identity (they may be long) and the way."""


class Pushdown:
    """Decides for every bucket what the server is to check; see Chooser in store/scan.py.

    Args:
        expression: The condition, bound; None is always true.
        plan: One of PLANS.
        watch: See Watch.

    Attributes:
        indexed, filtered, whole, skipped: How many buckets were read by an index, by a filter
            alone, whole, and not at all.
        blocks, unpacked, kept: How many blocks were read, how many messages they held, and how
            many of those became rows.
        held: How many messages the directory counts in packed buckets that were read.
        used: The comparisons that the server checked, each with the way: 'index', 'filter' or
            'zones'.
    """

    def __init__(
        self,
        expression: Optional[Expression],
        plan: str = "auto",
        watch: Watch = unwatched,
    ) -> None:
        if plan not in PLANS:
            raise ValueError(f"plan {plan!r} is none of {', '.join(PLANS)}")
        self._expression = expression
        self._plan = plan
        self._watch = watch
        self._branches: dict[str, Optional[list[Branch]]] = {}
        self._sifts: dict[str, Optional[Sift]] = {}
        self._many: set[str] = set()
        self._dense: set[str] = set()
        self._crowded: set[str] = set()
        self._idle: set[str] = set()
        self._opened: Counter[str] = Counter()
        self._passed: Counter[str] = Counter()
        self.indexed = self.filtered = self.whole = self.skipped = 0
        self.blocks = self.unpacked = self.kept = self.held = 0
        self.used: Used = {}

    @property
    def checks(self) -> bool:
        """Whether there is anything to check."""
        return self._expression is not None

    def choose(self, table: Table, bucket: Sequence[_Bucket]) -> Optional[Sequence[Query]]:
        """Return the queries whose rows include those that match; None = all rows."""
        self._watch()
        chosen = self._chosen(table, bucket)
        if table.packed:
            self.held += sum(row.rows for row in bucket)
        if chosen is None:
            self.whole += 1
        elif any(indexed for _, indexed in chosen):
            self.indexed += 1
        elif chosen:
            self.filtered += 1
        else:
            self.skipped += 1
        return chosen

    def few(self, table: Table) -> bool:
        """Say whether little was found so far."""
        return table.name not in self._many

    def learn(self, table: Table, bucket: Sequence[_Bucket], found: int) -> None:
        """Do less in the next buckets where much was found in this one."""
        every = sum(row.rows for row in bucket)
        if table.packed:
            opened, passed = self._opened[table.name], self._passed[table.name] + every
            self._passed[table.name] = passed
            if opened > DENSE_ROWS and opened > ZONES_SHARE * passed:
                self._idle.add(table.name)
        if found > FEW_ROWS and found > FEW_SHARE * every:
            self._many.add(table.name)
        if found > DENSE_ROWS and found > DENSE_SHARE * every:
            self._dense.add(table.name)
            if found > CROWDED_SHARE * every:
                self._crowded.add(table.name)

    def sift(self, table: Table) -> Optional[Sift]:
        """Return what leaves out messages of blocks that cannot match; None = nothing does."""
        if self._plan == "client" or self._expression is None or table.definition is None:
            return None
        if table.name not in self._sifts:
            self._sifts[table.name] = compile_sift(self._expression, table.definition)
        return self._sifts[table.name]

    def opened(self, table: Table, messages: int, kept: int) -> None:
        """Take note of a block that was unpacked, and how many of its messages became rows."""
        self._watch()
        self._opened[table.name] += messages
        self.blocks += 1
        self.unpacked += messages
        self.kept += kept

    def _chosen(self, table: Table, bucket: Sequence[_Bucket]) -> Optional[list[Query]]:
        if self._plan == "client" or self._expression is None:
            return None
        if table.name not in self._branches:
            self._branches[table.name] = _branches(self._expression, table)
        branches = self._branches[table.name]
        if branches is None:
            return None
        if self._plan == "auto" and table.name in self._idle:
            return None
        dense = self._plan == "auto" and table.name in self._dense
        filled = frozenset.intersection(*(row.filled for row in bucket))
        if self._plan == "filter" or (dense and table.by_field):
            filled = frozenset()
        queries: list[Query] = []
        used: Used = {}
        for branch in branches:
            found = self._queries(branch, filled, used, "zones" if table.packed else "filter")
            if found is None or len(queries) + len(found) > MAX_QUERIES:
                return None
            queries.extend(found)
        if self._plan == "auto" and len(queries) > 1 and table.name in self._crowded:
            return None
        self.used.update(used)
        if any(row.odd or not row.closed for row in bucket):
            queries.append(_ODD)
        return queries

    def _queries(
        self, branch: Branch, filled: frozenset[str], used: Used, way_without: str
    ) -> Optional[list[Query]]:
        """Return the queries for one branch; None where the server cannot check anything of it."""
        if any(NEVER in (need.filtered, need.indexed) for need in branch):
            return []
        usable = [n for n in branch if n.indexed is not None and n.shadow in filled]
        # The index on what is to be equal finds less than one on a range.
        shadow = min(usable, key=_is_range).shadow if usable else ""
        ways, count = [], 1
        chosen = [
            (bool(shadow) and n.shadow == shadow and n.indexed is not None, n) for n in branch
        ]
        for by_index, need in sorted(chosen, key=lambda found: not found[0]):
            way = need.indexed if by_index else need.filtered
            if way is not None and count * len(way) <= MAX_QUERIES:
                count *= len(way)
                ways.append(way)
                used[id(need.leaf), "index" if by_index else way_without] = need.leaf
        if not ways:
            return None
        return [(_compatible(sum(terms, ())), bool(shadow)) for terms in product(*ways)]


def _is_range(need: Need) -> bool:
    return any(term[1] not in ("=", "CONTAINS") for way in need.indexed or () for term in way)


def _compatible(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Leave out what the server refuses beside others: a second bound, or one beside =."""
    equal = {column for column, operator, _ in terms if operator == "="}
    kept: dict[Tuple[object, ...], Term] = {}
    for term in terms:
        column, operator, value = term
        if operator == "CONTAINS":
            kept.setdefault((column, operator, value), term)
        elif operator == "=" or column not in equal:
            kept.setdefault((column, operator), term)
    return tuple(kept.values())


def _branches(expression: Expression, table: Table) -> Optional[list[Branch]]:
    """Bring a condition into the form (a AND b …) OR …, weaker where it cannot be said."""
    if isinstance(expression, Negation):
        return None
    if isinstance(expression, Either):
        found = [_branches(item, table) for item in expression.items]
        every = [branch for branches in found for branch in branches or ()]
        return None if None in found or len(every) > MAX_QUERIES else every
    if isinstance(expression, All):
        return _joined([_branches(item, table) for item in expression.items])
    need = _need(expression, table)
    return None if need.filtered is None and need.indexed is None else [(need,)]


def _joined(found: Sequence[Optional[list[Branch]]]) -> Optional[list[Branch]]:
    known = sorted((branches for branches in found if branches is not None), key=len)
    if not known:
        return None
    joined: list[Branch] = [()]
    for branches in known:
        if len(joined) * len(branches) <= MAX_QUERIES:
            joined = [one + other for one in joined for other in branches]
    return joined


def _need(leaf: Leaf, table: Table) -> Need:
    if not isinstance(leaf, (Compare, OneOf)) or table.definition is None:
        return Need(leaf)
    if not isinstance(leaf.operand, Path):
        return Need(leaf)
    operator = leaf.operator if isinstance(leaf, Compare) else "="
    try:
        ref = field_of(leaf.operand, table.definition, wants_array(leaf))
    except StatementError:
        return Need(leaf, NEVER)  # missing here, and what is missing never matches
    values = list(fitting(leaf, ref))
    if not values or ref.part:
        return Need(leaf, None if values else NEVER)
    if table.packed:
        return Need(leaf, _zone_ways(ref, table, operator, values))
    filtered = _ways(_column_of(ref, table), operator, values, FEW_VALUES)
    index = table.index_fields.get(ref.column)
    if index is None:
        return Need(leaf, filtered)
    carried = Held(index.shadow, index.element_type, index.many, MAX_TEXT_BYTES)
    return Need(leaf, filtered, index.shadow, _ways(carried, operator, values, MAX_QUERIES))


def _ways(held: Optional[Held], operator: str, values: Sequence[Comparable], most: int) -> Ways:
    if held is None:
        return None
    found = ways_of(held, operator, values)
    return found if found is None or len(found) <= most else span_of(held, values)


def _zone_ways(ref: FieldRef, table: Table, operator: str, values: Sequence[Comparable]) -> Ways:
    column = None if table.definition is None else zone_map(table.definition).fields.get(ref.column)
    if column is None:
        return None
    held = Held(column.name, column.element_type)
    found = zone_ways(held, operator, values)
    return found if found is None or len(found) <= FEW_VALUES else zone_span(held, values)


def _column_of(ref: FieldRef, table: Table) -> Optional[Held]:
    """Return the column of format ``ros`` that holds a field, or all its elements."""
    if not table.by_field:
        return None
    columns = {column.name: column for column in wire_plan(table.definition).columns}
    column = columns.get(ref.column)
    if column is None or column.kind in ("array", "wire"):
        return None
    return Held(column.name, column.element_type, column.is_list, table.longest_text)
