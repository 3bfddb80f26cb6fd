# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Aggregates of many values: count, min, max, sum, avg, of all rows or of one array.

The values are not kept. Without any value count is 0 and the others are None. min and max ignore
NaN, and keep the first of equal values. sum and avg are NaN if a value is, or if +inf and −inf
meet. Sums of integers are exact integers. Sums of floats, and all averages, are exact until they
are rounded once to a float (a sum beyond all floats is infinite). A bool counts as 0 or 1 in them.
"""

from __future__ import annotations

import math
import operator
from collections import defaultdict
from fractions import Fraction
from typing import Any, Callable

import numpy as np
from numpy.typing import NDArray

NumberColumn = NDArray[Any]
"""Numbers, times or bools, none of which is missing."""
_LOW_BITS = 26
"""Number of lower bits of a mantissa that are summed by themselves, so that 2^26 sums are exact."""
_MANTISSA_BITS = 53


class Count:
    """The number of values; the other aggregates have the same methods.

    The caller leaves missing values out.
    """

    _count = 0

    def add(self, value: Any) -> None:
        """Add a value."""
        self._count += 1

    def add_array(self, values: NumberColumn) -> None:
        """Add at most 2^26 values, in their order."""
        self._count += len(values)

    def value(self) -> object:
        """Return the result for the values so far."""
        return self._count


class _Extreme(Count):
    """The minimum or maximum."""

    def __init__(self, better: Callable[[Any, Any], bool]) -> None:
        self._better = better
        self._best: Any = None

    def add(self, value: Any) -> None:
        # NaN is not equal to itself.
        if value == value and (self._best is None or self._better(value, self._best)):
            self._best = value

    def add_array(self, values: NumberColumn) -> None:
        if values.dtype.kind == "f":
            values = values[values == values]
        if len(values):
            # Both find the first of equal values.
            at = values.argmin() if self._better is operator.lt else values.argmax()
            self.add(values[at].item())

    def value(self) -> object:
        return self._best


class _Sum(Count):
    """An exact sum or average; the sum of integers is an integer."""

    def __init__(self, mean: bool = False) -> None:
        self._mean = self._floats = mean
        """Whether the result is the average; whether it is a float."""
        # One fraction per row would take thirty times as long as integers.
        self._numerators: dict[int, int] = defaultdict(int)
        """Sum of the numerators, by denominator."""
        self._not_finite = 0.0
        """Sum of infinities and NaNs."""

    def add(self, value: int | float) -> None:
        self._count += 1
        if not isinstance(value, int):
            self._floats = True
            if not math.isfinite(value):
                self._not_finite += value
                return
        numerator, denominator = value.as_integer_ratio()
        self._numerators[denominator] += numerator

    def add_array(self, values: NumberColumn) -> None:
        self._count += len(values)
        if values.dtype.kind != "f":
            self._numerators[1] += _sum_of_integers(values)
            return
        self._floats = True
        with np.errstate(invalid="ignore"):  # a signalling NaN
            floats = values.astype(np.float64)
        finite = np.isfinite(floats)
        for value in floats[~finite].tolist():
            self._not_finite += value
        mantissas, exponents = np.frexp(floats[finite])
        whole = np.ldexp(mantissas, _MANTISSA_BITS).astype(np.int64)
        least = int(exponents.min(initial=0))
        # Sums of floats below 2^53 are exact.
        high = np.bincount(exponents - least, (whole >> _LOW_BITS).astype(np.float64))
        low = np.bincount(exponents - least, (whole & (2**_LOW_BITS - 1)).astype(np.float64))
        for n in np.flatnonzero((high != 0) | (low != 0)).tolist():
            numerator = (int(high[n]) << _LOW_BITS) + int(low[n])
            exponent = least + n - _MANTISSA_BITS
            self._numerators[1 << max(0, -exponent)] += numerator << max(0, exponent)

    def value(self) -> int | float | None:
        if not self._count:
            return None
        if self._not_finite != 0:
            return self._not_finite
        exact = sum((Fraction(n, d) for d, n in self._numerators.items()), Fraction())
        if not self._floats:
            return int(exact)
        try:
            return float(exact / self._count if self._mean else exact)
        except OverflowError:
            return math.inf if exact > 0 else -math.inf


def _sum_of_integers(values: NumberColumn) -> int:
    """Return the exact sum of integers or bools."""
    if values.dtype.itemsize < 8:
        return int(values.sum(dtype=np.int64))
    halves = values >> 32, values & 0xFFFFFFFF
    high, low = (int(half.sum()) for half in halves)
    return (high << 32) + low


TOTALS: dict[str, Callable[[], Count]] = {
    "count": Count,
    "min": lambda: _Extreme(operator.lt),
    "max": lambda: _Extreme(operator.gt),
    "sum": _Sum,
    "avg": lambda: _Sum(mean=True),
}
"""Makes an aggregate without values, by the name of its function."""


def total_of(function: str, values: Any) -> object:
    """Return the aggregate of some values, none missing, by one of the functions of TOTALS."""
    total = TOTALS[function]()
    for value in values:
        total.add(value)
    return total.value()
