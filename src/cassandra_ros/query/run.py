# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run a statement over the stored rows of a source."""

from __future__ import annotations

from typing import Any, Generator, Iterable, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.keys import Position, isBehind
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.aggregates import Totals
from cassandra_ros.query.bounds import Bounds, boundsOf, warnOfSeconds
from cassandra_ros.query.builder import StatementError
from cassandra_ros.query.conditions import boundedRows
from cassandra_ros.query.cursor import Place, readPlace
from cassandra_ros.query.plan import TablePlan, uniteColumns
from cassandra_ros.query.protocols import Row, Source, Table
from cassandra_ros.query.pushdown import Pushdown
from cassandra_ros.query.scope import Findings
from cassandra_ros.query.syntax import Select

Cursor = Union[str, Position, None]
_Rows = Generator[Tuple[Any, ...], None, None]


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
        findings = Findings(select.text)
        self.select = select
        self._plans = {
            t.name: TablePlan(select, t.definition, findings, t.named) for t in source.tables
        }
        findings.check()
        self._names = uniteColumns(select, list(self._plans.values()))
        self.columns = tuple(name for names in self._names for name in names)
        self.pushdown = Pushdown(None if bounds.whole else select.condition, plan)
        self._reading: Any = {"columns": self._columns, "chooser": self.pushdown}
        self.direct = bounds.whole and not any(p.unnests for p in self._plans.values())
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

    def __next__(self) -> tuple[Any, ...]:
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
            self.read += 1
            found = self._plan(row.table).rows(row)
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
            limit = left if self.direct else None
            return boundedRows(source, bounds, at, reverse, limit, **self._reading)
        # Begin with the message at the cursor: some of its rows may be still to come, and the
        # store goes on behind a position only upwards.
        narrowed = bounds.within(None, at.t) if reverse else bounds.within(at.t, None)
        rows = boundedRows(source, narrowed, None, reverse, **self._reading)
        return (
            row
            for row in rows
            if isBehind(row.position, at, reverse) or (place.skip and row.position == at)
        )

    def _aggregated(
        self, source: Source[Row], bounds: Bounds, place: Place, left: Optional[int]
    ) -> _Rows:
        if place.position is not None or left == 0:
            return
        self._place = _ENDED
        if self.counted and not bounds.empty:
            yield (self._countedByKey(source, bounds),) * len(self.select.aggregates)
            return
        totals = Totals(self.select)
        for row in boundedRows(source, bounds, **self._reading):
            self.read += 1
            totals.add(self._plan(row.table).rows(row))
        yield totals.values()

    def _countedByKey(self, source: Source[Row], bounds: Bounds) -> int:
        if any(table.named for table in source.tables):
            return int(source.countTopicData(nodeID=bounds.node))
        ends = (Stamp.fromNs(bounds.low), Stamp.fromNs(bounds.high))
        return int(source.countTopicData(*ends, bounds.node))

    def _columns(self, table: Table) -> Optional[Sequence[str]]:
        return self._plan(table).columns(table)

    def _plan(self, table: Table) -> TablePlan:
        if table.name not in self._plans:  # made since the statement was planned
            select = self.select
            findings = Findings(select.text)
            self._plans[table.name] = TablePlan(select, table.definition, findings, table.named)
            self._plans[table.name].follow(self._names)
        return self._plans[table.name]


def select_rows(
    select: Select,
    source: Source[Row],
    *,
    nodeID: Optional[str] = None,
    limit: Optional[int] = None,
    after: Cursor = None,
    plan: str = "auto",
) -> QueryResult:
    """Run a SELECT statement on the topic that it names.

    Args:
        select: The statement, its parameters bound.
        source: The source.
        nodeID: Only messages of this node; None = of all.
        limit: At most so many rows, besides the statement's LIMIT; None = no bound.
        after: ``cursor`` of an earlier result of the same statement: go on behind its last row.
        plan: What the server may check, one of pushdown.PLANS; the answer is always the same.

    Raises:
        InvalidQuery: The statement names what the topic has not.
        InvalidKey: ``after`` is no cursor.
    """
    try:
        named = any(table.named for table in source.tables)
        bounds = boundsOf(select.condition, nodeID, named)
    except StatementError as exc:
        raise InvalidQuery(select.text, exc.position, exc.reason) from None
    if not named:
        warnOfSeconds(select.condition)
    return QueryResult(select, source, bounds, readPlace(after), limit, plan)


class Rows(list):  # type: ignore[type-arg]
    """All rows of a result: a list of tuples that knows its columns."""

    def __init__(self, rows: Iterable[tuple[Any, ...]], columns: Sequence[str]) -> None:
        super().__init__(rows)
        self.columns = tuple(columns)
