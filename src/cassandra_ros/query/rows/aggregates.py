# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values made of all rows, or of those of a group: see ``totals``. One pass, and no row is kept.

What is missing is left out everywhere but in ``count(*)``.
"""

from __future__ import annotations

from typing import Iterable, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.rows.projection import ResultRow
from cassandra_ros.query.tree.accumulators import TOTALS, Count
from cassandra_ros.query.tree.syntax import Aggregate, Select


class Aggregation:
    """The columns of a statement over all rows that it is given: aggregates, or the first value."""

    def __init__(self, select: Select) -> None:
        self._text = select.text
        self._asked = [column.what for column in select.columns or ()]
        self._totals: list[Union[Count, _First]] = [
            TOTALS[asked.function]() if isinstance(asked, Aggregate) else _First()
            for asked in self._asked
        ]

    def add(self, rows: Iterable[ResultRow]) -> None:
        """Take rows in; InvalidQuery: the values of a field have no order among them."""
        for row in rows:
            for total, asked, value in zip(self._totals, self._asked, row):
                try:
                    if value is not None:
                        total.add(value)
                except TypeError as exc:
                    reason = (
                        "the definitions of this topic hold values of different kinds there, "
                        f"which {asked.text.split('(')[0]} cannot compare ({exc})"
                    )
                    raise InvalidQuery(self._text, asked.position, reason) from None

    def values(self) -> ResultRow:
        """Return the values of the columns for the rows so far."""
        return tuple(total.value() for total in self._totals)


class _First:
    """The first value: of what the rows are grouped by, all are the same."""

    def __init__(self) -> None:
        self._value: object = None

    def add(self, value: object) -> None:
        if self._value is None:
            self._value = value

    def value(self) -> object:
        return self._value
