# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of many messages as a pandas.DataFrame."""

from __future__ import annotations

from typing import Any

import numpy as np

from cassandra_ros.arguments import check_list
from cassandra_ros.arrays.gather import FieldArray, Fields, ReadRows, Where, gatherFields
from cassandra_ros.arrays.join import rowsOf
from cassandra_ros.arrays.optional import optionalModule
from cassandra_ros.query.protocols import Row, Source

_UNITS = {"time": "M8[ns]", "duration": "m8[ns]"}


def readFrame(topic: Source[Row], fields: Fields, where: Where, read: ReadRows) -> Any:
    """Return fields as a DataFrame, whose index is KEY.

    Arguments and errors are those of gatherFields.

    Raises:
        MissingDependency: pandas is not installed.
    """
    pandas = optionalModule("pandas", "toDataFrame")
    asked = None if fields is None else ["KEY", *check_list("fields", fields, "['linear.x']")]
    found = gatherFields(topic, asked, where, read)
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
