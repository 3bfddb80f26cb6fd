# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Execution of a SELECT statement, or of a condition alone, over the stored rows of a topic."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from typing import (
    Callable,
    Generator,
    Iterable,
    Iterator,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    TypeVar,
    Union,
)

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, decode_cursor, encode_cursor, is_after
from cassandra_ros.messages.stamps import is_time, iso_time, other_unit, to_ns
from cassandra_ros.printable import NOTEBOOK_ROWS, html_table
from cassandra_ros.query.arrays.batch import Batch, CheckOf, LeastOf, StackedBatch, Window
from cassandra_ros.query.arrays.result_columns import ResultColumns
from cassandra_ros.query.plan.bounds import (
    Bounds,
    NsRange,
    bounds_of,
    in_another_unit,
    spans_of,
    with_stays,
)
from cassandra_ros.query.plan.pushdown import Pushdown, Watch, unwatched
from cassandra_ros.query.protocols import Row, RowT_co, Source, Table
from cassandra_ros.query.rows.projection import Projections, ResultRow
from cassandra_ros.query.rows.result_groups import (
    Columns,
    analyse_select,
    columns_of,
    join_columns,
    make_groups,
    rows_of,
)
from cassandra_ros.query.tree.parse import parse_condition
from cassandra_ros.query.tree.syntax import Delete, Select
from cassandra_ros.read import EVERYBODY, EVERYTHING, Read, Whose
from cassandra_ros.topics.unknown_names import names_anything, warn_of_unknown_names

_log = logging.getLogger(__name__)

Cursor = Union[str, Position, None]
"""Text of ``QueryResult.cursor``, or the position of a message; None or '' = the beginning."""
_Rows = Generator[ResultRow, None, None]
_T = TypeVar("_T")
BatchReader = Callable[[Read, Optional[CheckOf]], Iterator[Batch]]
"""Function that reads the messages of a read that satisfy a condition as batches. The second
argument returns the check of the condition in a table; None = all messages satisfy it."""
LEAST_TOGETHER = 32
"""Minimum number of messages, for each portion in which they were read, of which columns are read.
Below it rows are faster."""
PART_ROWS = 256
"""Maximum number of rows, made of single messages, that are aggregated together."""
PART_BYTES = 256 * 1024
"""Size of their messages from which they are aggregated, bytes."""
_MAX_DIGITS = 18
"""Maximum number of digits of a number in a cursor."""


def rows_inside(source: Source[RowT_co], bounds: Bounds) -> Iterator[RowT_co]:
    """Yield the rows of a topic within bounds."""
    if bounds.read.only is None or bounds.empty:
        return chain.from_iterable(map(source.read, bounds.reads()))
    try:
        return source.read(bounds.read)
    except InvalidKey:
        return iter(())  # no message has an invalid name


class StatementSource(Source[RowT_co], Protocol[RowT_co]):
    """A topic that answers statements."""

    def in_order(self, read: Read, least: LeastOf) -> Iterator[RowT_co | Window]:
        """Yield the messages of ``read`` in the same order; many may come together.

        Args:
            read: What is read; ``only`` is not set.
            least: Minimum number of messages of a table that come together; see LeastOf.
        """


_Message = Union[Row, Window]
"""A row, or consecutive messages together."""


def _is_at(row: Row, place: Position, source: Source[RowT_co]) -> bool:
    """Return whether a row is at a position, also if the table of the position was replaced."""
    position = row.position
    if position[:3] != place[:3]:
        return False
    return position == place or place.table not in {table.name for table in source.tables}


class Condition:
    """A condition (as after WHERE) on the messages of one source.

    Args:
        where: The condition, or the statement that contains it, which errors then show whole.
        params: Values of the ``?`` or ``%s`` in a text.

    Raises:
        InvalidQuery: The text is not a condition, or the parameters do not fit.
    """

    def __init__(self, where: str | Delete, params: Sequence[object] = ()) -> None:
        if isinstance(where, Delete):
            self._select = Select(where.text, (), "", 0, where.condition)
        else:
            self._select = Select(where, (), "", 0, parse_condition(where, params))

    def bounds(self, tables: Sequence[Table] = (), read: Read = EVERYTHING) -> Bounds:
        """Return the bounds of the condition in the tables of a topic, see bounds_of."""
        return bounds_of(self._select, read, tables)

    def test(self, tables: Sequence[Table], whose: Whose = EVERYBODY) -> Callable[[Row], bool]:
        """Return a function that checks the condition on a row of these tables.

        Args:
            whose: The robot and the runs whose messages are tested.

        Raises:
            InvalidQuery: The condition names a field that no definition of the topic has, or
                compares a field with a value of another kind.
        """
        bounds = self.bounds(tables, Read(whose=whose))
        select = with_stays(self._select, tables, bounds.read)
        return Projections(select, tables).hit

    def rows(
        self, source: Source[RowT_co], read: Read = EVERYTHING, *, bare: bool = False
    ) -> Iterator[RowT_co]:
        """Yield the rows of a read that satisfy the condition.

        Args:
            source: The topic whose rows are read.
            read: Which of its rows are read, in which order.
            bare: Whether the rows read their messages on request.
        """
        tables = source.tables
        select, projections, bounds = self._plan(tables, read)
        if bare:
            bounds = replace(bounds, read=replace(bounds.read, columns=projections.columns))
        rows = rows_inside(source, bounds)
        if not bounds.whole:
            rows = filter(projections.hit, rows)
        return self._told(rows, select, tables, bounds.read)

    def names_fields(self, tables: Sequence[Table]) -> bool:
        """Return whether the condition names a field that the messages of some tables have."""
        projections = Projections(self._select, tables)
        return any(projection.extractor is not None for projection in projections)

    def batches(
        self, tables: Sequence[Table], read: Read, read_batches: BatchReader
    ) -> Iterator[Batch]:
        """Yield the messages that satisfy the condition as batches.

        Args:
            tables: Tables of the topic.
            read: Which of its messages are read.
            read_batches: Reads the messages of the topic.
        """
        select, projections, bounds = self._plan(tables, read)
        check = None if bounds.whole else projections.of
        streams = (read_batches(span_read, check) for span_read in bounds.reads())
        return self._told(chain.from_iterable(streams), select, tables, bounds.read)

    def _plan(self, tables: Sequence[Table], read: Read) -> tuple[Select, Projections, Bounds]:
        """Return the bound condition, its check, and what is read for it."""
        bounds = self.bounds(tables, read)
        select = with_stays(self._select, tables, bounds.read)
        chooser = Pushdown(None if bounds.whole else select.condition)
        read = replace(bounds.read, chooser=chooser)
        bounds = replace(bounds, read=read, spans=spans_of(select.condition))
        return select, Projections(select, tables), bounds

    def _told(
        self, results: Iterator[_T], select: Select, tables: Sequence[Table], read: Read
    ) -> Iterator[_T]:
        told = names_anything(select.condition)
        return _warn_if_empty(results, select, tables, read) if told else results


def _warn_if_empty(
    rows: Iterator[_T], select: Select, tables: Sequence[Table], read: Read
) -> Iterator[_T]:
    """Yield rows, or batches; if none comes, warn of unknown names in the condition."""
    empty = True
    for row in rows:
        empty = False
        yield row
    if empty and read.wanted != 0:
        warn_of_unknown_names(select.condition, tables, read)


class ResultPlace(NamedTuple):
    """A place in a result: after some of the rows that the message at a position gives."""

    given: int
    """Number of rows returned so far, for the statement's LIMIT."""
    skip: int
    """Number of rows returned of the message at the position; 0 = all of them."""
    position: Position | None
    """Position of the message; None = the beginning."""

    @property
    def text(self) -> str:
        """Cursor text for ``read_cursor``; '' at the beginning."""
        at = self.position
        return "" if at is None else f"{self.given}.{self.skip}.{encode_cursor(at)}"


START = ResultPlace(0, 0, None)
"""The beginning of a result."""


def read_cursor(cursor: Cursor) -> ResultPlace:
    """Return the place that a cursor stands for; for a Position, the place after its message.

    Raises:
        InvalidKey: The cursor was not made by this package.
    """
    if cursor is None or cursor == "":
        return START
    if isinstance(cursor, Position):
        return ResultPlace(0, 0, cursor)
    number, _, rest = str(cursor).partition(".")
    skip, _, position = rest.partition(".")
    if not all(n.isascii() and n.isdigit() and len(n) <= _MAX_DIGITS for n in (number, skip)):
        raise InvalidKey(f"{str(cursor)[:80]!r} is not a cursor of this package")
    return ResultPlace(int(number), int(skip), decode_cursor(position))


_NOWHERE = Position(0, "", 0, "")
"""Position of rows that are made from several rows; only their number is used."""


class QueryResult(Iterator[tuple]):  # type: ignore[type-arg]  # rows are tuples of any values
    """The rows of a SELECT statement, read when the iterator is advanced.

    Args:
        select: The statement with its parameters bound.
        source: The topic that the statement names.
        whose: Nodes and writers whose messages are read.
        limit: Maximum number of rows in addition to the statement's LIMIT; None = no limit.
        after: ``cursor`` of an earlier result of the same statement: continue after its last row.
            Groups, distinct rows and rows in another order than KEY's are computed again for it.
        plan: What the server may check, one of pushdown.PLANS; the answer does not depend on it.
        watch: See pushdown.Watch.

    Attributes:
        columns: Names of the columns.
        direct: Whether looking for one more row is cheap: every message from the store gives a row,
            or all rows are known with the first.
        select: The statement.
        pushdown: Choice of what the server checks.
        read: Number of rows checked so far; in format packed those that are left after blocks were
            sifted.
        time_ranges: Number of time ranges that NEAR and EVENT have selected so far.
        counted: Whether the directory has the answer, so that no row is read.
        hints: Why no message is found, as far as that is known when all rows were taken.

    Raises:
        InvalidQuery: The statement names a field that the topic lacks.
        InvalidKey: ``after`` is not a cursor.
    """

    def __init__(
        self,
        select: Select,
        source: StatementSource[Row],
        whose: Whose = EVERYBODY,
        *,
        limit: int | None = None,
        after: Cursor = None,
        plan: str = "auto",
        watch: Watch = unwatched,
    ) -> None:
        tables = source.tables
        if select.gathers:
            select = analyse_select(select, tables)
        self._source, self._watch = source, watch
        bounds = bounds_of(select, Read(whose=whose), tables)
        self.select = select = with_stays(select, tables, bounds.read)
        if not any(table.named for table in tables):
            _warn_of_units(select, source)
        self._place = place = read_cursor(after)
        """Place at which a later result continues while ``_last`` is None."""
        self._given = self._skip = 0
        """The same while it is a message: its other fields, see ResultPlace."""
        self._last: Callable[[], Position] | None = None
        """Returns the position of the message that gave the last result row; None = no row was
        taken, or several messages gave it."""
        self._projections = Projections(select, tables)
        self._readers: dict[Table, ResultColumns | None] = {}
        visible_names = self._projections.names[: len(select.visible)]
        self.columns = tuple(name for names in visible_names for name in names)
        condition = None if bounds.whole else select.condition
        self.pushdown = Pushdown(condition, plan, watch, tables)
        unnested = any(projection.unnested for projection in self._projections)
        self.direct = select.gathers or (bounds.whole and not unnested)
        self.read = 0
        self.hints: list[str] = []
        self._matched = False
        """Whether a message satisfied the condition so far."""
        self.counted = bool(select.counts and bounds.whole and bounds.read.only is None)
        rest = None if select.limit is None else max(0, select.limit - place.given)
        self._max_rows = min((n for n in (rest, limit) if n is not None), default=None)
        """Maximum number of rows of this result; None = no limit."""
        read = replace(
            bounds.read,
            reverse=select.descending,
            columns=self._projections.columns,
            chooser=self.pushdown,
            wanted=None if select.gathers else self._max_rows,
        )
        self._spans, self.time_ranges = spans_of(select.condition), 0
        spans = None if self._spans is None else self._count_spans
        self._bounds = replace(bounds, read=read, spans=spans)
        self._rows = self._gather(place.given) if select.gathers else self._select_rows(place)
        if after in (None, "") and self._max_rows != 0 and names_anything(select.condition):
            self._rows = self._warn_if_unmatched(self._rows)

    def __iter__(self) -> Iterator[ResultRow]:
        return self._rows

    def __next__(self) -> ResultRow:
        return next(self._rows)

    def __repr__(self) -> str:
        return f"<QueryResult of {self.select.text!r}: rows of {', '.join(self.columns)}>"

    @property
    def bounded_by_place(self) -> bool:
        """Whether NEAR or EVENT selects only some time ranges."""
        return self._spans is not None

    @property
    def cursor(self) -> str:
        """Cursor to continue after the last row that was taken; '' at the beginning."""
        last = self._last
        return (self._place if last is None else ResultPlace(self._given, self._skip, last())).text

    @property
    def position(self) -> Position | None:
        """Position of the message of the last row.

        None: made of several messages, or no row taken.
        """
        return None if self._last is None else self._last()

    def close(self) -> None:
        """Stop reading. Can be repeated."""
        self._rows.close()

    def __enter__(self) -> QueryResult:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _warn_if_unmatched(self, rows: _Rows) -> _Rows:
        """Yield rows; if no message satisfies the condition, warn of unknown names."""
        for row in rows:
            # Where rows are gathered, ``_make_rows`` knows: count(*) gives a row in any case.
            self._matched |= not self.select.gathers
            yield row
        if not self._matched:
            condition, tables = self.select.condition, self._source.tables
            self.hints += warn_of_unknown_names(condition, tables, self._bounds.read)

    def _select_rows(self, place: ResultPlace) -> _Rows:
        """Yield the rows that single messages give, after a place."""
        count = place.given
        last = None if self._max_rows is None else count + self._max_rows
        if last == count:
            return
        cursor, table = place.position, None
        for row in self._messages(place):
            if isinstance(row, Window):
                window, columns = self._read_window(row)
                for n, result in enumerate(rows_of(columns)):
                    count += 1
                    self._given, self._skip = count, 0
                    self._last = partial(window.position_of, n)
                    yield result
                    if count == last:
                        return
                continue
            if row.table is not table:
                table = row.table
                rows = self._projections.of(table).rows
            results = iter(rows(row))
            values = next(results, None)
            if values is None:
                continue
            skip = place.skip if cursor is not None and _is_at(row, cursor, self._source) else 0
            number = 0
            while values is not None:
                next_values = next(results, None)
                number += 1
                if number > skip:
                    count += 1
                    # All rows of the message were returned: continue after it.
                    self._given, self._skip = count, 0 if next_values is None else number
                    self._last = partial(_position, row)
                    yield values
                    if count == last:
                        return
                values = next_values

    def _messages(self, place: ResultPlace) -> Iterator[_Message]:
        """Yield the messages after a place, with that at the place if some of its rows remain."""
        at, bounds = place.position, self._bounds
        reverse = bounds.read.reverse
        if at is None or not (place.skip or reverse):
            bounds = replace(bounds, read=replace(bounds.read, after=at))
            return self._read_together(bounds)
        # Begin with the message at the cursor, because some of its rows may be missing, and the
        # store can continue after a position only in ascending order.
        cut_bounds = bounds.within(None, at.t) if reverse else bounds.within(at.t, None)
        return (
            row
            for row in self._read(cut_bounds)
            if (
                place.skip if _is_at(row, at, self._source) else is_after(row.position, at, reverse)
            )
        )

    def _read(self, bounds: Bounds) -> Iterator[Row]:
        """Yield the messages within bounds, and count them."""
        for row in rows_inside(self._source, bounds):
            self.read += 1
            self._watch()
            yield row

    def _read_together(self, bounds: Bounds) -> Iterator[_Message]:
        """Yield the messages within bounds, many of them together, and count them."""
        if bounds.read.only is not None and not bounds.empty:
            yield from self._read(bounds)
            return
        for read in bounds.reads():
            for message in self._source.in_order(read, self._least):
                self.read += len(message) if isinstance(message, Window) else 1
                self._watch()
                yield message

    def _least(self, table: Table) -> int | None:
        """Return from how many messages of a table on columns of the result are read together."""
        return None if self._reader_of(table) is None else LEAST_TOGETHER

    def _reader_of(self, table: Table) -> ResultColumns | None:
        """Return what reads columns of the result from batches of a table; None = not possible."""
        if table not in self._readers:
            projection = self._projections.of(table)
            shared = self.select.gathers
            self._readers[table] = ResultColumns.of(table.definition, projection, shared=shared)
        return self._readers[table]

    def _read_window(self, window: Window) -> tuple[Window, Columns]:
        """Return the messages that satisfy the condition, and the columns of their rows."""
        batches: list[StackedBatch] = []
        parts: list[Columns] = []
        for batch in window.batches:
            reader = self._reader_of(batch.table)
            if reader is None:
                raise AssertionError("such messages come one by one")
            batch, columns = reader.read(batch, check=not self._bounds.whole)
            batches.append(batch)
            parts.append(columns)
        window = Window(batches)
        return window, join_columns(parts, window.order)

    def _count_spans(self, low: int, high: int, reverse: bool) -> Iterator[NsRange]:
        """Yield the time ranges of NEAR and EVENT, and count them."""
        for span in () if self._spans is None else self._spans(low, high, reverse):
            self.time_ranges += 1
            self._watch()
            yield span

    def _gather(self, count: int) -> _Rows:
        """Yield rows that are made from several rows, after the first ``count`` ones."""
        is_single = bool(self.select.aggregates) and not self.select.group
        if (count and is_single) or self._max_rows == 0:
            return
        last = None if self._max_rows is None else count + self._max_rows
        for row in islice(self._make_rows(last), count, last):
            count += 1
            self._place = ResultPlace(count, 0, _NOWHERE)
            yield row

    def _make_rows(self, most: int | None) -> Iterator[ResultRow]:
        """Yield all rows that are made from several rows; only the first ``most`` are needed."""
        select, bounds, projections = self.select, self._bounds, self._projections
        if self.counted and not bounds.empty:
            count = self._source.count(bounds.read)
            self._matched = count > 0
            return iter([(count,) * len(select.aggregates)])
        parts = self._parts(bounds)
        if not any(projections.names):  # DISTINCT of a field without fields
            self._matched = any(list(projections.of(m.table).rows(m)) for m in self._read(bounds))
            return iter([()] if self._matched else [])
        first = list(islice(parts, 1))
        self._matched = bool(first)
        return make_groups(select, projections.names, chain(first, parts), most)

    def _parts(self, bounds: Bounds) -> Iterator[Columns]:
        """Yield all columns of some rows at a time, in the order of reading."""
        rows: list[ResultRow] = []
        size = 0
        for message in self._read_together(bounds):
            if isinstance(message, Window):
                if rows:
                    yield columns_of(rows)
                    rows, size = [], 0
                window, columns = self._read_window(message)
                if len(window):
                    yield columns
                continue
            size += message.size
            for row in self._projections.of(message.table).rows(message):
                rows.append(row)
                if len(rows) >= PART_ROWS or size >= PART_BYTES:
                    yield columns_of(rows)
                    rows, size = [], 0
        if rows:
            yield columns_of(rows)


def _position(row: Row) -> Position:
    return row.position


def _warn_of_units(select: Select, source: Source[Row]) -> None:
    """Warn of integers compared with KEY that were probably meant in s, ms or us."""
    for literal in in_another_unit(select.condition):
        first = next(iter(source.read(Read(wanted=1))), None)
        unit_text = "" if first is None else other_unit(literal.value, first.t)
        if unit_text:
            _log.warning(
                "KEY is compared with %s, which means nanoseconds since 1970, long before the "
                "first message; %s",
                literal.value,
                unit_text,
            )


class Rows(list):  # type: ignore[type-arg]
    """All rows of a result: a list of tuples with the names of its columns."""

    def __init__(self, rows: Iterable[ResultRow], columns: Sequence[str]) -> None:
        super().__init__(rows)
        self.columns = tuple(columns)

    def __repr__(self) -> str:
        if len(self) <= NOTEBOOK_ROWS:
            return super().__repr__()
        first = super().__getitem__(slice(NOTEBOOK_ROWS))
        return f"[{', '.join(map(repr, first))}, … {len(self)} rows of {', '.join(self.columns)}]"

    def _repr_html_(self) -> str:
        first = [list(map(_show, row)) for row in super().__getitem__(slice(NOTEBOOK_ROWS))]
        return html_table(self.columns, first, of=len(self))


def _show(value: object) -> object:
    return iso_time(to_ns(value)) if is_time(value) else value
