# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run a statement over the stored rows of a source."""

from __future__ import annotations

from typing import Generator, Iterable, Iterator, NamedTuple, Optional, Sequence, Union

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, decode_cursor, encode_cursor, is_behind
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.aggregates import Aggregation
from cassandra_ros.query.conditions import Bounds, bounded_rows, bounds_of, warn_of_seconds
from cassandra_ros.query.projection import Projections, ResultRow
from cassandra_ros.query.protocols import Row, Source
from cassandra_ros.query.pushdown import Pushdown
from cassandra_ros.query.syntax import Select

Cursor = Union[str, Position, None]
_Rows = Generator[ResultRow, None, None]
_MAX_DIGITS = 18


class Place(NamedTuple):
    """Place in a result: behind some row of the message at a position."""

    given: int
    """Rows given so far, for the statement's LIMIT."""
    skip: int
    """Rows of the message at the position that were given; 0 = all."""
    position: Optional[Position]
    """None = the beginning."""

    @property
    def text(self) -> str:
        """The cursor that ``read_place`` understands; '' at the beginning."""
        at = self.position
        return "" if at is None else f"{self.given}.{self.skip}.{encode_cursor(at)}"


START = Place(0, 0, None)


def read_place(cursor: Union[str, Position, Place, None]) -> Place:
    """Read a cursor; a bare position means behind the message there.

    Raises:
        InvalidKey: It is none.
    """
    if cursor is None or cursor == "":
        return START
    if isinstance(cursor, Place):
        return cursor
    if isinstance(cursor, Position):
        return Place(0, 0, cursor)
    given, _, rest = str(cursor).partition(".")
    skip, _, position = rest.partition(".")
    if not all(n.isascii() and n.isdigit() and len(n) <= _MAX_DIGITS for n in (given, skip)):
        raise InvalidKey(f"{str(cursor)[:80]!r} is not a cursor of this package")
    return Place(int(given), int(skip), decode_cursor(position))


_ENDED = Place(1, 0, Position(0, "", 0, ""))
"""Behind the one row of aggregates."""


class QueryResult(Iterator[tuple]):  # type: ignore[type-arg]  # rows are tuples of any values
    """The rows of a statement, read while they are taken.

    Attributes:
        columns: Names of the columns.
        direct: Every message that the store gives is a row: to look for one more costs nothing.
        select: The statement.
        pushdown: What the server checks of it.
        read: How many rows have come from the server.
        counted: The directory knew the answer.
    """

    def __init__(
        self,
        select: Select,
        source: Source[Row],
        bounds: Bounds,
        place: Place,
        limit: Optional[int],
        plan: str = "auto",
    ) -> None:
        self.select = select
        self._projections = Projections(select, source.tables)
        self.columns = tuple(name for names in self._projections.names for name in names)
        self.pushdown = Pushdown(None if bounds.whole else select.condition, plan)
        self.direct = bounds.whole and not any(p.unnested for p in self._projections)
        self._place = place
        self.read = 0
        self.counted = bool(select.counts and bounds.whole and bounds.name is None)
        left = None if select.limit is None else max(0, select.limit - place.given)
        if limit is not None:
            left = limit if left is None else min(left, limit)
        read = self._aggregated if select.aggregates else self._selected
        self._rows = read(source, bounds, place, left)

    def __iter__(self) -> QueryResult:
        return self

    def __next__(self) -> ResultRow:
        return next(self._rows)

    @property
    def cursor(self) -> str:
        """Where to go on behind the last row that was taken; '' at the beginning."""
        return self._place.text

    def close(self) -> None:
        """Stop reading. Twice is harmless."""
        self._rows.close()

    def __enter__(self) -> QueryResult:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _selected(
        self, source: Source[Row], bounds: Bounds, place: Place, left: Optional[int]
    ) -> _Rows:
        given = place.given
        last = None if left is None else given + left
        if last == given:
            return
        for row in self._stored(source, bounds, place, left):
            found = self._projections.of(row.table).rows(row)
            for number in range(place.skip if row.position == place.position else 0, len(found)):
                given += 1
                # All rows of the message: go on behind it, without looking at it again.
                skip = 0 if number + 1 == len(found) else number + 1
                self._place = Place(given, skip, row.position)
                yield found[number]
                if given == last:
                    return

    def _stored(
        self, source: Source[Row], bounds: Bounds, place: Place, left: Optional[int]
    ) -> Iterator[Row]:
        reverse, at = self.select.descending, place.position
        if at is None or not (place.skip or reverse):
            return self._read(source, bounds, at, reverse, left if self.direct else None)
        # Begin with the message at the cursor: some of its rows may be still to come, and the
        # store goes on behind a position only upwards.
        narrowed = bounds.within(None, at.t) if reverse else bounds.within(at.t, None)
        return (
            row
            for row in self._read(source, narrowed, None, reverse)
            if is_behind(row.position, at, reverse) or (place.skip and row.position == at)
        )

    def _read(
        self,
        source: Source[Row],
        bounds: Bounds,
        after: Optional[Position] = None,
        reverse: bool = False,
        limit: Optional[int] = None,
    ) -> Iterator[Row]:
        rows = bounded_rows(
            source,
            bounds,
            after,
            reverse,
            limit,
            columns=lambda table: self._projections.of(table).columns,
            chooser=self.pushdown,
        )
        for row in rows:
            self.read += 1
            yield row

    def _aggregated(
        self, source: Source[Row], bounds: Bounds, place: Place, left: Optional[int]
    ) -> _Rows:
        if place.position is not None or left == 0:
            return
        self._place = _ENDED
        if self.counted and not bounds.empty:
            yield (self._counted_by_key(source, bounds),) * len(self.select.aggregates)
            return
        totals = Aggregation(self.select)
        for row in self._read(source, bounds):
            totals.add(self._projections.of(row.table).rows(row))
        yield totals.values()

    def _counted_by_key(self, source: Source[Row], bounds: Bounds) -> int:
        if any(table.named for table in source.tables):
            return source.countTopicData(nodeID=bounds.node)
        low, high = Stamp.from_ns(bounds.low), Stamp.from_ns(bounds.high)
        return source.countTopicData(low, high, bounds.node)


def select_rows(
    select: Select,
    source: Source[Row],
    *,
    node: Optional[str] = None,
    limit: Optional[int] = None,
    after: Cursor = None,
    plan: str = "auto",
) -> QueryResult:
    """Run a SELECT statement on the topic that it names.

    Args:
        select: The statement, its parameters bound.
        source: The source.
        node: Only messages of this node; None = of all.
        limit: At most so many rows, besides the statement's LIMIT; None = no bound.
        after: ``cursor`` of an earlier result of the same statement: go on behind its last row.
        plan: What the server may check, one of pushdown.PLANS; the answer is always the same.

    Raises:
        InvalidQuery: The statement names what the topic has not.
        InvalidKey: ``after`` is no cursor.
    """
    named = any(table.named for table in source.tables)
    bounds = bounds_of(select, node, named)
    if not named:
        warn_of_seconds(select.condition)
    return QueryResult(select, source, bounds, read_place(after), limit, plan)


class Rows(list):  # type: ignore[type-arg]
    """All rows of a result: a list of tuples that knows its columns."""

    def __init__(self, rows: Iterable[ResultRow], columns: Sequence[str]) -> None:
        super().__init__(rows)
        self.columns = tuple(columns)
