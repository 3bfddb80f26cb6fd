# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of many messages as a pandas.DataFrame."""

from __future__ import annotations

from typing import Any

import numpy as np

from cassandra_ros.query.array_join import rowsOf
from cassandra_ros.query.arrays import FieldArray, Fields
from cassandra_ros.query.optional import optionalModule

_UNITS = {"time": "M8[ns]", "duration": "m8[ns]"}


def loadPandas() -> Any:
    """Import pandas.

    Raises:
        MissingDependency: It is not installed.
    """
    return optionalModule("pandas", "toDataFrame")


def withKey(fields: Fields) -> Fields:
    """Return what is to be gathered: KEY, which becomes the index, and the fields."""
    if fields is None:
        return None
    return ["KEY", fields] if isinstance(fields, str) else ["KEY", *fields]


def makeFrame(found: dict[str, FieldArray]) -> Any:
    """Make a DataFrame of arrays; ``KEY`` becomes its index.

    Args:
        found: The arrays, ``KEY`` among them. Arrays are given away: their memory is used.
    """
    pandas = loadPandas()
    key = found.pop("KEY")
    times = key.kind.kind == "time"
    index = pandas.Index(key.values.view("M8[ns]") if times else key.values, name="KEY")
    columns = {name: _series(pandas, array) for name, array in found.items()}
    return pandas.DataFrame(columns, index=index)


def _series(pandas: Any, array: FieldArray) -> Any:
    """Return the values of one column, as pandas says best what is missing."""
    kind, values, missing = array
    if kind.depth:
        return rowsOf(values, missing)
    if kind.kind in _UNITS:
        values = values.view(_UNITS[kind.kind])
        if missing is not None:
            values[missing] = np.array("NaT", values.dtype)
    elif missing is not None and values.dtype.kind == "f":
        values[missing] = np.nan
    elif missing is not None and values.dtype.kind in "iu":
        return pandas.arrays.IntegerArray(values, missing)
    elif missing is not None and values.dtype.kind == "b":
        return pandas.arrays.BooleanArray(values, missing)
    return values
