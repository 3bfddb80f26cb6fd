# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values made of all rows: count, min, max, sum, avg. One pass, and no row is kept.

What is missing is left out everywhere but in ``count(*)``. Without any value count is 0 and the
others None. min and max leave NaN out, too, and keep the first of equals; sum and avg are NaN when
one value is, or when +inf and −inf meet. Sums of integers are exact integers; those of floats, and
every average, are exact until they are rounded once to a float (a sum beyond all floats is
infinite). A bool counts as 0 or 1 in them.
"""

from __future__ import annotations

import math
import operator
from typing import Any, Callable, Optional, Sequence, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.syntax import Select

_BITS = 1074
"""Every finite float is a multiple of 2 ** -1074."""


class Totals:
    """The aggregates of a statement, over the rows that it is given.

    Args:
        select: A statement whose columns are aggregates.
    """

    def __init__(self, select: Select) -> None:
        self._select = select
        self._totals = [_TOTALS[asked.function]() for asked in select.aggregates]

    def add(self, rows: Sequence[tuple[Any, ...]]) -> None:
        """Take rows in; each has a value for every aggregate.

        Raises:
            InvalidQuery: The values of a field are of kinds that have no order among them.
        """
        for row in rows:
            for n, value in enumerate(row):
                if value is not None:
                    try:
                        self._totals[n].add(value)
                    except TypeError as exc:
                        asked = self._select.aggregates[n]
                        raise InvalidQuery(
                            self._select.text,
                            asked.position,
                            "the definitions of this topic hold values of different kinds there, "
                            f"which {asked.function} cannot compare ({exc})",
                        ) from None

    def values(self) -> tuple[Any, ...]:
        """Return the aggregates of the rows so far."""
        return tuple(total.value() for total in self._totals)


class _Count:
    def __init__(self) -> None:
        self._count = 0

    def add(self, value: Any) -> None:
        self._count += 1

    def value(self) -> int:
        return self._count


class _Extreme:
    def __init__(self, better: Callable[[Any, Any], bool]) -> None:
        self._better = better
        self._best: Any = None

    def add(self, value: Any) -> None:
        # A NaN is not equal to itself.
        if value == value and (self._best is None or self._better(value, self._best)):
            self._best = value

    def value(self) -> Any:
        return self._best


class _Sum:
    """An exact sum: one integer for integers, one of multiples of 2 ** -1074 for floats."""

    def __init__(self, mean: bool = False) -> None:
        self._mean = mean
        self._count = 0
        self._whole = 0
        self._fine = 0
        self._odd = 0.0
        """Sum of infinities and NaNs."""
        self._floats = mean

    def add(self, value: Union[int, float]) -> None:
        self._count += 1
        if isinstance(value, int):
            self._whole += value
        elif math.isfinite(value):
            self._floats = True
            numerator, denominator = value.as_integer_ratio()
            self._fine += numerator << (_BITS + 1 - denominator.bit_length())
        else:
            self._floats = True
            self._odd += value

    def value(self) -> Optional[Union[int, float]]:
        if not self._count:
            return None
        if not self._floats:
            return self._whole
        if self._odd != 0:
            return self._odd
        total = (self._whole << _BITS) + self._fine
        try:
            return total / ((self._count if self._mean else 1) << _BITS)
        except OverflowError:
            return math.inf if total > 0 else -math.inf


_TOTALS: dict[str, Callable[[], Any]] = {
    "count": _Count,
    "min": lambda: _Extreme(operator.lt),
    "max": lambda: _Extreme(operator.gt),
    "sum": _Sum,
    "avg": lambda: _Sum(mean=True),
}
