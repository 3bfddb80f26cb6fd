# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Aggregates of all rows or of the rows of a group, in one pass, without keeping rows.

For the functions see ``tree/accumulators``. Missing values are ignored, except by ``count(*)``.
"""

from __future__ import annotations

from typing import Iterable, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.rows.projection import ResultRow
from cassandra_ros.query.tree.accumulators import TOTALS, Count
from cassandra_ros.query.tree.syntax import Aggregate, Select


class Aggregation:
    """The columns of a statement over several rows: aggregates, or the value of the first row."""

    def __init__(self, select: Select) -> None:
        self._text = select.text
        self._asked = [column.what for column in select.columns or ()]
        self._totals: list[Union[Count, _First]] = [
            TOTALS[asked.function]() if isinstance(asked, Aggregate) else _First()
            for asked in self._asked
        ]

    def add(self, rows: Iterable[ResultRow]) -> None:
        """Add rows; InvalidQuery: the values of a field cannot be compared with each other."""
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
    """The value of the first row, for GROUP BY terms, which have one value in a group."""

    def __init__(self) -> None:
        self._value: object = None

    def add(self, value: object) -> None:
        if self._value is None:
            self._value = value

    def value(self) -> object:
        return self._value
