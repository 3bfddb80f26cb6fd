# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A condition by itself, as ``where=`` takes it: which messages satisfy it."""

from __future__ import annotations

import logging
from itertools import islice
from typing import Any, Callable, Iterator, Optional, Sequence

from cassandra_ros.errors import CorruptMessage, InvalidKey, InvalidQuery, MessageNotFound
from cassandra_ros.keys import Position, isBehind
from cassandra_ros.query.bounds import Bounds, boundsOf
from cassandra_ros.query.builder import StatementError
from cassandra_ros.query.evaluate import compileCondition
from cassandra_ros.query.parse import parseCondition
from cassandra_ros.query.protocols import Row, RowT, Source, Table
from cassandra_ros.query.pushdown import Pushdown
from cassandra_ros.query.scope import Findings, Scope
from cassandra_ros.query.syntax import Expression

_log = logging.getLogger(__name__)

Test = Callable[[Row], bool]


class _TableTest:
    """Tells whether a row of one table satisfies a condition."""

    def __init__(self, expression: Expression, table: Table, findings: Findings) -> None:
        self._by_field = table.by_field
        self._scope = Scope(table.definition, findings, table.named)
        self._check = compileCondition(expression, self._scope.locate, self._scope.fit)
        self._extractor = self._scope.extractor()

    @property
    def columns(self) -> Optional[Sequence[str]]:
        """Columns of the table that it looks at; None = all."""
        if self._extractor is None:
            return ()
        return self._extractor.columns if self._by_field else None

    def __call__(self, row: Row) -> bool:
        values = self._scope.rows(row, self._extractor)
        found = readable(row, values, self._scope.width)
        return any(self._check(value) is True for value in found)


class Condition:
    """What stands behind WHERE, for the messages of one source.

    A message satisfies a condition on the elements of an array of messages when one element does.

    Args:
        text: The condition.
        params: Values of its ``?`` or ``%s``.
        nodeID: Only messages of this node; None = of all.

    Raises:
        InvalidQuery: The text is no condition, or the parameters do not fit.
    """

    def __init__(self, text: str, params: Sequence[Any] = (), nodeID: Optional[str] = None) -> None:
        self.text = text
        self._expression = parseCondition(text, params)
        self._node = nodeID

    @classmethod
    def ofStatement(
        cls, text: str, expression: Expression, nodeID: Optional[str] = None
    ) -> Condition:
        """Return the condition that stands in a statement; errors show the whole of it."""
        condition = cls.__new__(cls)
        condition.text, condition._expression, condition._node = text, expression, nodeID
        return condition

    def bounds(self, named: bool = False) -> Bounds:
        """Return what of it the store can check.

        Args:
            named: The messages are kept under names.

        Raises:
            InvalidQuery: KEY or NODE is compared with what it cannot be.
        """
        try:
            return boundsOf(self._expression, self._node, named)
        except StatementError as exc:
            raise InvalidQuery(self.text, exc.position, exc.reason) from None

    def test(self, tables: Sequence[Table]) -> Test:
        """Return a function that tells whether a stored row satisfies the condition.

        Args:
            tables: The TopicTables of the source.

        Raises:
            InvalidQuery: The condition names a field that no definition of the topic has, or
                compares one with a value of another kind.
        """
        testOf = self._tests(tables)
        return lambda row: testOf(row.table)(row)

    def _tests(self, tables: Sequence[Any]) -> Callable[[Any], _TableTest]:
        findings = Findings(self.text)
        tests = {t.name: _TableTest(self._expression, t, findings) for t in tables}
        findings.check()

        def testOf(table: Table) -> _TableTest:
            if table.name not in tests:  # made since
                tests[table.name] = _TableTest(self._expression, table, Findings(self.text))
            return tests[table.name]

        return testOf

    def rows(
        self,
        source: Source[RowT],
        key: Optional[int] = None,
        to_key: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        *,
        bare: bool = False,
    ) -> Iterator[RowT]:
        """Walk through the rows of a topic that satisfy the condition, in the order of time.

        Args:
            topic: A CassandraTopic.
            key: Lower end, included, ns; None = open.
            to_key: Upper end, included, ns; None = open.
            after: Begin behind this row.
            reverse: Newest first.
            bare: Only the keys are wanted: a row fetches its message when it is asked for.
        """
        tables = source.tables
        testOf = self._tests(tables)
        bounds = self.bounds(any(t.named for t in tables)).within(key, to_key)
        reading: Any = {"chooser": Pushdown(self._expression)}
        if bare:
            reading["columns"] = lambda table: testOf(table).columns
        rows = boundedRows(source, bounds, after, reverse, **reading)
        return (row for row in rows if testOf(row.table)(row))


def boundedRows(
    source: Source[RowT],
    bounds: Bounds,
    after: Optional[Position] = None,
    reverse: bool = False,
    limit: Optional[int] = None,
    **reading: Any,
) -> Iterator[RowT]:
    """Walk through the rows of a topic inside of bounds; ``reading`` goes on to source.rows."""
    if bounds.empty:
        return iter(())
    if bounds.name is None:
        direction: Any = {"after": after, "reverse": reverse, "limit": limit}
        rows: Iterator[RowT] = source.rows(
            bounds.low, bounds.high, nodeID=bounds.node, **direction, **reading
        )
        return rows
    try:
        every = source.versions(bounds.name, nodeID=bounds.node, reverse=reverse)
    except InvalidKey:
        return iter(())  # no message can have such a name
    found = (
        row
        for row in every
        if bounds.low <= row.t <= bounds.high and isBehind(row.position, after, reverse)
    )
    return islice(found, limit)


def readable(row: Row, values: Iterator[Sequence[Any]], width: int) -> list[Sequence[Any]]:
    """Return the values of a row; where its bytes are no message, its fields are missing."""
    try:
        return list(values)
    except MessageNotFound:
        return []  # removed since its columns were read
    except CorruptMessage as exc:
        _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
        key = row.name if row.table.named else row.t
        return [(key, row.node, *[None] * (width - 2))]
