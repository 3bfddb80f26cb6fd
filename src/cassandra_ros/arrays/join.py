# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Arrays of batches and of tables joined to one."""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from cassandra_ros.arrays.array_types import ArrayType
from cassandra_ros.arrays.values import Values, objectsOf


def emptyValues(kind: ArrayType, count: int) -> Values:
    """Return values of which all are missing."""
    dtype = np.dtype(object) if kind.cells else kind.dtype
    shape = (count, kind.length) if kind.depth == 1 and kind.length is not None else (count,)
    values = np.full(shape, None, object) if dtype.kind == "O" else np.zeros(shape, dtype)
    return Values(values, np.ones(count, bool) if count else None)


def joinValues(parts: Sequence[Values], kind: ArrayType) -> Values:
    """Lay values of one type after each other."""
    if not parts:
        return emptyValues(kind, 0)
    values = np.concatenate([part.values for part in parts])
    if all(part.missing is None for part in parts):
        return Values(values)
    marks = [
        np.zeros(len(part.values), bool) if part.missing is None else part.missing for part in parts
    ]
    return Values(values, np.concatenate(marks))


def castValues(found: Values, own: ArrayType, kind: ArrayType) -> Values:
    """Turn the values of one table into the type that holds those of all.

    Args:
        found: The values.
        own: Their type.
        kind: What uniteTypes made of it and others.
    """
    values, missing = found
    if own == kind or own.depth > 1:
        return found
    if kind.depth == 1 and not kind.cells or own.depth == kind.depth == 0:
        values = values.astype(kind.dtype)
        if missing is not None and values.dtype.kind == "O":
            values[missing] = None
        return Values(values, missing)
    if own.depth == 0:
        return Values(rowsOf(values.astype(object), missing), missing)  # beside arrays
    cells = rowsOf(values, missing)
    dtype = own.dtype if kind.depth == 0 else kind.dtype
    return Values(objectsOf([c if c is None else c.astype(dtype) for c in cells]), missing)


def rowsOf(values: Any, missing: Any) -> Any:
    """Return an array of objects, one a row: the rows of an array, None where one is missing."""
    rows = objectsOf(list(values))
    if missing is not None:
        rows[missing] = None
    return rows
