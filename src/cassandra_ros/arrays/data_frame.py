# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of many messages as a pandas.DataFrame.

pandas and pyarrow are imported when the first DataFrame is made, because nothing else needs them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cassandra_ros.arrays.column_values import rows_of
from cassandra_ros.arrays.field_arrays import FieldArray
from cassandra_ros.installation import optional_module

_UNITS = {"time": "M8[ns]", "duration": "m8[ns]"}


def as_frame(fields: dict[str, FieldArray]) -> Any:
    """Return gathered fields, KEY among them, as a DataFrame with index KEY."""
    pandas = optional_module("pandas", "toDataFrame")
    key = fields.pop("KEY")
    times = key.kind.kind == "time"
    index = pandas.Index(key.values.view("M8[ns]") if times else key.values, name="KEY")
    columns = {name: _series(pandas, array) for name, array in fields.items()}
    return pandas.DataFrame(columns, index=index)


def _series(pandas: Any, array: FieldArray) -> Any:
    """Return the values of one column, with missing values in pandas' form for the type."""
    kind, values, missing = array
    if kind.depth:
        return rows_of(values, missing)
    if kind.kind in _UNITS:
        values = values.view(_UNITS[kind.kind])
        values[missing] = np.array("NaT", values.dtype)
    elif missing.any() and values.dtype.kind in "iu":
        return pandas.arrays.IntegerArray(values, missing)
    elif missing.any() and values.dtype.kind == "b":
        return pandas.arrays.BooleanArray(values, missing)
    elif values.dtype.kind == "f":
        values[missing] = np.nan
    return values
