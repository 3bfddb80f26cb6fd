# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of Arrow as Python values that are exact: times in ns are Stamps."""

from __future__ import annotations

from datetime import timedelta
from decimal import Decimal
from typing import Any, Sequence

import numpy as np

from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Stamp, length_from_ns

_LONGEST = timedelta(seconds=2**31)
"""Length from which an interval is no duration of ROS."""


def python_rows(arrow: Any, batch: Any) -> list[tuple[Any, ...]]:
    """Return the rows of a batch.

    A struct is a dict, a list a list; a time in ns a Stamp, or numpy.datetime64 outside of ROS
    time; an interval a timedelta; an integer of any size an int.
    """
    columns = [_values(arrow, column) for column in batch.columns]
    return list(zip(*columns)) if columns else [()] * batch.num_rows


def _values(arrow: Any, array: Any) -> Sequence[Any]:
    """Return the values of an array, see python_rows; None for NULL."""
    types, kind = arrow.types, array.type
    if types.is_dictionary(kind):
        return _values(arrow, array.dictionary_decode())
    if types.is_timestamp(kind) and kind.unit == "ns" and kind.tz is None:
        return [_time(ns) for ns in array.cast(arrow.int64()).to_pylist()]
    if types.is_struct(kind):
        names = [field.name for field in kind]
        parts = [_values(arrow, column) for column in array.flatten()]
        rows = [dict(zip(names, values)) for values in zip(*parts)]
        return _with_nulls(array, rows)
    if types.is_list(kind) or types.is_fixed_size_list(kind):
        return [_values(arrow, element.values) if element.is_valid else None for element in array]
    if types.is_decimal(kind):
        return [_number(value) for value in array.to_pylist()]
    if types.is_interval(kind):
        return [_length(value) for value in array.to_pylist()]
    values: Sequence[Any] = array.to_pylist()
    return values


def _with_nulls(array: Any, rows: list[Any]) -> list[Any]:
    if not array.null_count:
        return rows
    return [row if valid else None for row, valid in zip(rows, array.is_valid().to_pylist())]


def _time(ns: int | None) -> Any:
    if ns is None:
        return None
    return Stamp.from_ns(ns) if 0 <= ns <= MAX_NS else np.datetime64(ns, "ns")


def _number(value: Decimal | None) -> Any:
    """Return a decimal without a fraction's digits, as that of a sum of integers, as an int."""
    if value is None:
        return None
    return int(value) if value.as_tuple().exponent == 0 else value


def _length(value: Any) -> Any:
    """Return an interval without months as a timedelta, which is exact to DuckDB's microseconds."""
    if value is None or value.months:
        return value
    return timedelta(days=value.days, microseconds=value.nanoseconds // 1000)


def printable_value(value: Any) -> Any:
    """Return a value of a row as what the outputs of the command line and of services can show.

    Intervals without months are durations, as in executeCQL; longer ones than a duration of ROS
    can hold, those with months, dates and other types of DuckDB are texts.
    """
    if isinstance(value, dict):
        return {str(name): printable_value(element) for name, element in value.items()}
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return [printable_value(element) for element in value]
    if value is None or isinstance(value, (bool, int, float, str, bytes, Stamp)):
        return value
    if isinstance(value, Decimal) and Decimal(float(value)) == value:
        return float(value)
    if isinstance(value, timedelta) and abs(value) < _LONGEST:
        return length_from_ns(value // timedelta(microseconds=1) * 1000)
    return str(value)
